"""The command doctor: what it says of a sound installation, and that it tells a broken one."""

import dataclasses
from importlib.metadata import version

import pytest
from proved import proved
from typer.testing import CliRunner

import handcal
from handcal.commands import _app
from handcal_sim.commands import doctor


def run():
    return CliRunner().invoke(_app.app, ["doctor"])


def test_a_sound_installation_works_and_its_versions_are_shown():
    done = run()
    assert done.exit_code == 0, done.output
    assert f"numpy {version('numpy')}" in done.stdout
    assert done.stdout.splitlines()[-1].startswith("handcal works: ")
    for extra in doctor.EXTRAS:
        assert f"  {extra}" in done.stdout


@pytest.mark.parametrize("error", [0.01, *proved(float("nan"))])
def test_a_wrong_number_fails(monkeypatch, error):
    """One gyro scale error off by 1 %, or no number at all."""
    sound = handcal.calibrate

    def wrong(*args, **kwargs):
        result = sound(*args, **kwargs)
        off = [
            dataclasses.replace(p, value=p.value + error) if p.effect == "gyro_scale" else p
            for p in result.parameters
        ]
        return dataclasses.replace(result, parameters=type(result.parameters)(off))

    monkeypatch.setattr(handcal, "calibrate", wrong)
    done = run()
    assert done.exit_code == 1
    assert "does NOT work" in done.stdout


def test_extras_are_those_of_the_package_and_what_is_missing_is_named(monkeypatch):
    provided = set(doctor.distribution("handcal").metadata.get_all("Provides-Extra"))
    assert set(doctor.EXTRAS) <= provided
    monkeypatch.setattr(doctor, "version", missing)
    assert doctor.lacking("live") == ["aiohttp", "segno", "trustme"]


def missing(name):
    raise doctor.PackageNotFoundError(name)

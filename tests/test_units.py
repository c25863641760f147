"""The units that people see: the usual ones by size, or those that --units asks for."""

import json
import sys

import pytest
from fake_result import fake_result

import handcal
from handcal.commands import _app
from handcal.estimate import calibration
from handcal.types import InputError
from handcal.units import showing, shown


@pytest.fixture
def calibrated(monkeypatch, capsys, tmp_path):
    """`handcal calibrate x --json` with further options: status, output, JSON."""
    units = []

    def load(*_, **options):
        units.append(options["units"])
        return fake_result().recording

    monkeypatch.setitem(handcal.__dict__, "load", load)
    monkeypatch.setattr(calibration, "calibrate_together", lambda *_, **__: (fake_result(),))

    def call(*options):
        path = tmp_path / "x.json"
        monkeypatch.setattr(
            sys, "argv", ["handcal", "calibrate", "x", "--json", str(path), *options]
        )
        with pytest.raises(SystemExit) as stop:
            _app.main()
        said = capsys.readouterr()
        document = json.loads(path.read_text()) if path.exists() else None
        return stop.value.code, said.out + said.err, document, units[-1:]

    return call


def test_units_are_asked_for_and_json_stays_si(calibrated):
    status, usual, document, _ = calibrated()
    assert status == 0
    assert "deg/s" in usual
    status, si, same, _ = calibrated("--units", "si")
    assert "rad/s" in si
    assert "deg/s" not in si
    assert same == document
    _, said, same, told = calibrated("--units", "mrad, m/s^2,ppm,accel=g")
    assert "mrad/s" in said
    assert "m/s²" in said
    assert "mg" not in said
    assert (same, told) == (document, [{"accel": "g"}])
    assert "rad/s" not in calibrated()[1]


def test_a_unit_that_nobody_knows_is_met_with_those_there_are(calibrated):
    status, said, _, told = calibrated("--units", "percnt")
    assert (status, told) == (2, [])
    assert "Did you mean percent?" in said


def test_units_are_those_asked_for_only_inside():
    with showing(["deg", "mg", "percent"]):
        assert (shown("rad", [1e-6]).unit, shown("1", [1e-6]).unit) == ("deg", "%")
        assert shown("rad/s/K", [1.0]).unit == "deg/s/K"
    assert (shown("rad", [1e-6]).unit, shown("1", [1e-6]).unit) == ("deg", "ppm")
    with pytest.raises(InputError), showing(["furlong"]):
        pass


def test_small_numbers_keep_their_digits():
    """Two digits of sigma, however small: 1e-7 seconds of arc is not 0.0000000."""
    with showing(["si"]):
        assert shown("rad", [1.0]).value(1.234e-9, 2e-11, sign=True) == "+1.234e−09"
        assert shown("rad", [1.0]).value(1.234e-3, 2e-5) == "0.001234"

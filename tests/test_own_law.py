"""A law without a name, found, written out, read in: then it is one like all others."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from strange_device import errs_by, turned
from typer.testing import CliRunner
from worlds import recording_of

import handcal
from handcal import user_effects
from handcal.commands import _app
from handcal.effects import catalogue
from handcal.recordings.export import TWINS, write_mcap
from handcal_sim.strangers import scene_of

ROOT = Path(__file__).resolve().parents[1]
KIND, DEVICE, LENGTH_S, OWN = "gyro_rate_force", 0, 30.0, "gyro_under_force"

pytestmark = pytest.mark.prove


def run(*arguments, fails=False):
    done = CliRunner().invoke(_app.app, [str(a) for a in arguments])
    assert done.exit_code == (2 if fails else 0), done.stderr
    return done


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A folder: two recordings of a device that errs, one as it would be without; the law that was
    found in the first, in effects/; what it adds to the second, and its channel."""
    folder = tmp_path_factory.mktemp("device")
    worlds = turned(DEVICE, (0, 1), LENGTH_S)
    (first, _), (second, strange) = errs_by(KIND, worlds, DEVICE)
    write_mcap(first, folder / "first.mcap")
    write_mcap(second, folder / "second.mcap")
    write_mcap(recording_of(worlds[1], "heading"), folder / "plain.mcap")
    (folder / "effects").mkdir()
    done = run("explain", folder / "first.mcap", "--write-effect", folder / f"effects/{OWN}.py")
    assert f"{OWN}.py: {strange.channel} += k * " in done.stderr
    return folder, strange


def own(folder):
    return "--effects-from", folder / "effects"


def column(strange):
    return "xyz".index(strange.channel[-1])


def product(strange):
    """Rate times force (n,) in the second recording, to which the law is proportional."""
    scene, out = scene_of(turned(DEVICE, (1,), LENGTH_S)[0]), 1.0
    for kind, axis in re.findall(r"(omega|f)_([xyz])", strange.formula):
        out = out * getattr(scene, kind)[:, "xyz".index(axis)]
    return out


def added(folder, name, beside="second.mcap"):
    """What one recording's gyro reads more than another's, (n, 3)."""
    one, other = (handcal.load(folder / f).imu.gyro for f in (name, beside))
    return one - other


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.fixture(scope="module")
def explained(told):
    """Of the second recording, with the law in the catalogue."""
    folder, _ = told
    run("explain", folder / "second.mcap", *own(folder), "--json", folder / "second.json",
        "--twin", folder / "twin.mcap", "--write-effect", folder / "none.py")  # fmt: skip
    return json.loads((folder / "second.json").read_text())


def test_explain_names_it(told, explained):
    assert explained["verdict"] == "explained"
    assert [m["effect"] for m in explained["missing"]] == [OWN]
    assert explained["unnamed"] == []
    assert "reads too much by k * omega_" in explained["missing"][0]["story"]
    # (there was nothing to write)
    assert not (told[0] / "none.py").exists()


def test_calibrate_knows_it_and_repeats_it(told):
    folder, strange = told
    given = ["calibrate", folder / "second.mcap"]
    result = folder / "calibration.json"
    run(*given, "--effects", OWN, "--only", *own(folder), "--json", result)
    (k,) = (p for p in json.loads(result.read_text())["parameters"] if p["effect"] == OWN)
    law = product(strange)
    true = float(np.vdot(strange.error, law) / np.vdot(law, law))
    assert k["shown"]
    assert k["value"] == pytest.approx(true, rel=0.02)
    run(*given, "--from", result, *own(folder), "--json", folder / "again.json")
    again = json.loads((folder / "again.json").read_text())
    (same,) = (p for p in again["parameters"] if p["effect"] == OWN)
    assert same["value"] == pytest.approx(k["value"], rel=1e-9)
    for command in (given, ["apply", folder / "second.mcap", "-o", folder / "x.mcap"]):
        done = run(*command, "--from", result, fails=True)
        assert f"'{OWN}'" in done.stderr
        assert "--effects-from with its folder" in done.stderr
    assert f"Unknown effect '{OWN}'" in run(*given, "--effects", OWN, fails=True).stderr


def test_beside_all_that_a_device_has_it_is_found_as_well_as_is_said(told, explained):
    """Sigmas are wider, as they have to be; what was explained alone is as above."""
    _, strange = told
    (k,) = (p for p in explained["parameters"] if p["effect"] == OWN)
    law = product(strange)
    true = float(np.vdot(strange.error, law) / np.vdot(law, law))
    assert abs(k["value"] - true) < 4.0 * k["sigma"] < 0.5 * abs(true)
    assert k["given_model"]["value"] == pytest.approx(true, rel=0.02)
    assert k["given_model"]["sigma"] < k["sigma"]


def test_apply_takes_it_off(told):
    folder, strange = told
    result, out = folder / "alone.json", folder / "corrected.mcap"
    run("calibrate", folder / "second.mcap", "--effects", OWN, "--only", *own(folder),
        "--json", result)  # fmt: skip
    run("apply", folder / "second.mcap", "--from", result, *own(folder), "-o", out)
    left = added(folder, "corrected.mcap", "plain.mcap")
    assert rms(left[:, column(strange)]) < 0.05 * rms(strange.error)


def test_apply_takes_off_what_was_explained_as_well_as_it_is_known(told, explained):
    """Of the law no more is left than its own sigma allows."""
    folder, strange = told
    (k,) = (p for p in explained["parameters"] if p["effect"] == OWN)
    out = folder / "corrected-too.mcap"
    run("apply", folder / "second.mcap", "--from", folder / "second.json", *own(folder), "-o", out)
    left = added(folder, "corrected-too.mcap", "plain.mcap")[:, column(strange)]
    law = product(strange)
    law = law - law.mean()
    assert abs(np.vdot(left, law) / np.vdot(law, law)) < 4.0 * k["sigma"]


def test_conceal_puts_it_in(told):
    folder, strange = told
    given = ["conceal", folder / "plain.mcap", "-o", folder / "concealed.mcap"]
    run(*given, "--effect", f"{OWN}=0.002", *own(folder))
    found = added(folder, "concealed.mcap", "plain.mcap")
    true = 0.002 * product(strange)
    assert rms(found[:, column(strange)] - true) < 0.05 * rms(true)
    assert rms(np.delete(found, column(strange), axis=1)) == 0.0


def test_the_twin_reads_it(told, explained):
    """Next to nothing of the gyro is left of what the model without the law cannot have read."""
    folder, _ = told
    assert explained["missing"]
    read, left = handcal.load(folder / "twin.mcap").imu, []
    for begin in TWINS:
        made = handcal.load(folder / "twin.mcap", topics={"imu": f"{begin}/imu"}).imu
        left.append(rms(read.gyro - made.gyro))
    assert left[1] < 0.2 * left[0]


def test_the_page_of_the_catalogue_has_it(told):
    spec = importlib.util.spec_from_file_location("make_effects", ROOT / "docs/make_effects.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with user_effects.effects_from(told[0] / "effects"):
        assert catalogue()[OWN].source == "found in first.mcap by handcal explain"
        assert f"`{OWN}=k`" in module.page()
    assert OWN not in module.page()

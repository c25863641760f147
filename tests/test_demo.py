"""The demo by its command, and its promise for seeds nobody chose."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import handcal
from handcal.commands import _app
from handcal_sim import write
from handcal_sim.commands.demo import CONCEALED, LEAST, MOST, concealing, off_by, truth_of


@pytest.mark.prove
def test_the_demo_writes_what_it_says_and_finds_the_truth(tmp_path):
    done = CliRunner().invoke(_app.app, ["demo", "--out", str(tmp_path / "a" / "b")])
    assert done.exit_code == 0, done.stderr
    assert all(line.startswith("handcal: ") for line in done.stderr.splitlines())
    names = [
        "recording.mcap", "explanation.html", "explanation.rrd", "explanation.json",
        "report.html", "dashboard.rrd", "calibration.json",
    ]  # fmt: skip
    for name in names:
        assert (tmp_path / "a" / "b" / name).stat().st_size > 1000
        assert name in done.stdout
    document = json.loads((tmp_path / "a" / "b" / "calibration.json").read_text())
    truth = truth_of(concealing(1))
    for p in document["parameters"]:
        true = truth.get((p["effect"], p["name"]), 0.0)
        assert abs(p["value"] - true) < 4 * p["sigma"]
    biases = {"gyro_bias", "accel_bias"}
    assert all(p["shown"] for p in document["parameters"] if p["effect"] in {*biases, CONCEALED})
    explanation = json.loads((tmp_path / "a" / "b" / "explanation.json").read_text())
    assert explanation["verdict"] == "explained"
    assert [m["effect"] for m in explanation["missing"]] == [CONCEALED]
    fit = explanation["fit"]
    assert fit["after"]["log_evidence"] - fit["before"]["log_evidence"] > 100
    (plain,) = [s for s in done.stdout.splitlines() if s.startswith("Biases alone:")]
    assert "not explained" in plain
    (told,) = [s for s in done.stdout.splitlines() if s.startswith("Explained:")]
    assert "the gyro scale error" in told


def test_another_seed_is_another_error_of_the_size_that_is_named():
    drawn = [[truth_of(concealing(s))[CONCEALED, a] for a in "xyz"] for s in (2, 3, 3)]
    assert drawn[1] == drawn[2] != drawn[0]
    assert np.all((np.abs(drawn) >= LEAST) & (np.abs(drawn) <= MOST))


@pytest.mark.prove
def test_estimates_cover_the_truth_as_often_as_they_claim(tmp_path):
    """Ninety estimates from ten seeds; each off by sigma, in the mean of squares."""
    off = []
    for seed in range(100, 110):
        world = concealing(seed)
        write(world, tmp_path / "x.mcap")
        result = handcal.calibrate(handcal.load(tmp_path / "x.mcap"), [CONCEALED])
        off += [off_by(p, truth_of(world)) for p in result.parameters]
    print(np.round(np.reshape(off, (10, -1)), 1))
    assert 0.6 < np.mean(np.square(off)) < 1.8
    assert np.max(np.abs(off)) < 5

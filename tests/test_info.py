"""``handcal info``: the numbers of recordings whose stamps, rests and turns are known, what rests
and turns can and cannot teach, and the command from outside."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import format_files
import numpy as np
import pytest
from lab_world import command
from rich.console import Console
from sample_recording import sample
from typer.testing import CliRunner
from worlds import recording_of

import handcal
from handcal.commands import _app
from handcal.compiled import so3
from handcal.design.seen import Seen, seen
from handcal.effects import select
from handcal.recordings.overview import overview
from handcal.show.info import Info, print_info, strip, unit_sentences
from handcal.types import Imu, Recording, Series
from handcal_sim import simulate

SEALED = Path(__file__).resolve().parents[1] / "recordings" / "sealed_06.mcap"
G, HZ = 9.80665, 100.0
X, Y, Z = np.eye(3)


def turned(*turns: tuple[np.ndarray, float], rest_s: float = 5.0, seed: int = 0) -> Recording:
    """Rest, then for each (axis of the body, degrees) a turn of 3 s and a rest."""
    rng = np.random.default_rng(seed)
    rate = [np.zeros((round(rest_s * HZ), 3))]
    for axis, degrees in turns:
        u = (np.arange(300) + 0.5) / 300
        profile = np.radians(degrees) * (1 - np.cos(2 * np.pi * u)) / 3.0
        rate += [profile[:, None] * axis, np.zeros((round(rest_s * HZ), 3))]
    w = np.vstack(rate)
    C, now = [], np.eye(3)
    for step in so3.rotations(w / HZ):
        C.append(now)
        now = now @ step
    f = np.array([c.T @ [0.0, 0.0, G] for c in C])
    n = len(w)
    gyro, accel = w + rng.normal(0, 1e-3, (n, 3)), f + rng.normal(0, 1e-2, (n, 3))
    return Recording("made", Imu(np.arange(n) / HZ, gyro, accel, np.ones(n, dtype=bool)))


def of(found: tuple[Seen, ...], effect: str) -> tuple[str, ...]:
    return next(s.shown for s in found if s.effect.id == effect)


def test_turns_are_as_they_were_made() -> None:
    o = overview(turned((X, 90.0), (Y, -180.0), (Z, 360.0), (Z, -45.0)))
    assert len(o.rests) == 5
    made = {"x": (90.0, 0.0), "y": (0.0, 180.0), "z": (360.0, 45.0)}
    for t in o.turns:
        # what turns slower than 8 deg/s is not counted: a quarter of a second at either end
        np.testing.assert_allclose(np.degrees([t.forward, t.backward]), made[t.axis], atol=3.0)
    assert np.degrees(o.turns[2].fastest) == pytest.approx(240.0, abs=1.0)
    assert o.gravity == pytest.approx(G, abs=0.01)
    assert o.turning[0] < 0.1 * min(o.turning[1:])


def test_gaps_jitter_and_range_are_found() -> None:
    whole = turned((X, 90.0))
    rng = np.random.default_rng(0)
    t = whole.imu.t + rng.normal(0, 5e-4, len(whole.imu.t))
    keep = (np.arange(len(t)) < 200) | (np.arange(len(t)) >= 250)
    valid = np.arange(len(t)) != 700
    imu = Imu(t[keep], whole.imu.gyro[keep], whole.imu.accel[keep], valid[keep])
    o = overview(replace(whole, imu=imu, streams={"mag": Series(t[::10], np.ones((130, 3)))}))
    first, mag = o.streams
    assert (first.gaps, first.readings, mag.readings) == (1, len(t) - 50, 130)
    assert first.longest_s == pytest.approx(0.51, abs=0.005)
    assert first.at_s == pytest.approx(1.99, abs=0.005)
    # of steps between two stamps, each with this jitter
    assert first.jitter_s == pytest.approx(5e-4 * np.sqrt(2), rel=0.1)
    assert mag.rate_hz == pytest.approx(10.0, rel=0.05)
    assert o.saturated == 1


def test_one_rest_teaches_the_gyros_bias_and_the_accelerometers_along_gravity() -> None:
    found = seen(overview(turned()))
    assert of(found, "gyro_bias") == ("x", "y", "z")
    assert of(found, "accel_bias") == ("z",)
    for none in ("gyro_scale", "gyro_misalignment", "accel_scale", "lever_arm"):
        assert of(found, none) == ()


def test_turns_about_the_vertical_teach_nothing_of_the_gyro_but_those_about_x_its_scale() -> None:
    """Gravity does not see a turn about itself, and what x and y read of it looks, whatever the
    angle, like a bias of the accelerometer: (exp(i a) - 1) m / i is (exp(i a) - 1) b."""
    found = seen(overview(turned((Z, 360.0), (Z, 90.0), (Z, 135.0))))
    assert of(found, "gyro_scale") == ()
    assert of(found, "gyro_misalignment") == ()
    assert of(seen(overview(turned((X, 360.0), (X, 360.0)))), "gyro_scale") == ("x",)


def test_six_sides_teach_the_accelerometer() -> None:
    turns = [(X, 90.0)] * 4 + [(Y, 90.0)] * 4 + [(X, 45.0), (Y, 45.0), (X, 90.0), (Y, 60.0)]
    found = seen(overview(turned(*turns)))
    for all_three in ("accel_bias", "accel_scale", "accel_misalignment", "lever_arm"):
        assert len(of(found, all_three)) == 3, all_three
    # each turned back and forth about one axis leaves the others' scales hidden
    assert {"x", "y"} <= set(of(found, "gyro_scale"))


@pytest.mark.prove
def test_iron_needs_the_field_from_all_sides() -> None:
    rng = np.random.default_rng(0)
    recording = turned((X, 90.0))
    u = rng.normal(size=(400, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    t = np.linspace(0, recording.duration_s, 400)
    sphere, spot = ({"mag": Series(t, 4.8e-5 * v + [1e-5, 0, 0])} for v in (u, u * 0.01 + X))
    assert len(of(seen(overview(replace(recording, streams=sphere))), "mag_hard_iron")) == 3
    assert of(seen(overview(replace(recording, streams=spot))), "mag_soft_iron") == ()
    assert all(s.effect.id != "mag_hard_iron" for s in seen(overview(recording)))


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_it_says_is_shown_a_calibration_does_observe(seed: int) -> None:
    recording = recording_of(simulate("free-hand", seed=seed, duration_s=40.0))
    found = seen(overview(recording))
    effects = ["gyro_scale", "accel_scale", "lever_arm"]
    result = handcal.calibrate(recording, effects, assume="fixed-point")
    own = {(p.effect, p.name): p.shown for p in result.parameters}
    claims = [own[s.effect.id, name] for s in found for name in s.shown if s.effect.id in effects]
    assert claims
    assert all(claims)


def test_units_are_doubted_where_the_motion_does_not_tell() -> None:
    assert "full scale are right" in unit_sentences(overview(turned((X, 90.0), (Y, 90.0))))[1]
    all_three = turned(*[(a, 90.0) for a in (X, Y, Z, X, Y, Z)])
    assert "axes are right" in unit_sentences(overview(all_three))[1]
    assert "does not tell" in unit_sentences(overview(turned()))[1]


def test_the_command(tmp_path: Path) -> None:
    source = tmp_path / "a.mcap"
    handcal.api.Recording.of(turned((X, 90.0), (Y, 90.0))).write(source)
    page, numbers = tmp_path / "a.html", tmp_path / "a.json"
    done = CliRunner().invoke(
        _app.app, ["info", str(source), "--report", str(page), "--json", str(numbers)]
    )
    assert done.exit_code == 0, done.output
    assert "3 rests" in done.output
    told = json.loads(numbers.read_text())
    assert told["schema"] == "handcal/info/1"
    assert [s["stream"] for s in told["streams"]] == ["imu"]
    assert len(told["rests"]) == 3
    shown = {e["effect"]: e["shown"] for e in told["could_teach"]}
    assert shown["gyro_bias"] == ["x", "y", "z"]
    assert "<svg" in page.read_text()
    alone = CliRunner().invoke(_app.app, ["info", str(source), "--json", "-"])
    assert json.loads(alone.stdout)["turns"] == told["turns"]
    assert CliRunner().invoke(_app.app, ["info", str(tmp_path / "no.mcap")]).exit_code != 0


@pytest.mark.parametrize("width", [60, 140])
def test_it_fits_the_terminal(width: int) -> None:
    o = overview(turned((X, 90.0)))
    console = Console(width=width, record=True, file=io.StringIO())
    print_info(Info("made", "SI", o, seen(o)), console)
    assert max(map(len, console.export_text().splitlines())) <= width
    assert len(strip(o)) == 60


def test_a_long_topic_cuts_no_other_column() -> None:
    """PX4's IMU is of two topics, which together are as long as three columns."""
    o = overview(turned((X, 90.0)))
    streams = tuple(replace(s, topic="sensor_gyro, sensor_accel") for s in o.streams)
    console = Console(width=80, record=True, file=io.StringIO())
    print_info(Info("made", "SI", replace(o, streams=streams), seen(o)), console)
    assert "…" not in console.export_text()


def test_real_recordings_are_told(real_recordings: Path) -> None:
    o = overview(handcal.load(real_recordings / "xio_fusion.csv"))
    assert 5 <= len(o.rests) <= 20
    # a little over 1,000 deg about z, by its README
    assert np.degrees(o.turns[2].forward - o.turns[2].backward) == pytest.approx(1035, abs=60)


def test_a_held_point_teaches_without_rests() -> None:
    """Turned in the hand for a minute, with a rest at either end: `explain` finds the gyro's and
    the accelerometer's errors in it, so it may not be said to teach none."""
    found = seen(overview(handcal.load(SEALED)))
    for told in ("gyro_scale", "accel_scale", "gyro_misalignment", "accel_misalignment"):
        assert len(of(found, told)) == len(select([told])[0].parameters), told


@pytest.mark.parametrize("brand", ["Apple", "Google"])
def test_units_are_those_of_the_system_that_wrote_the_file(brand, tmp_path, monkeypatch, capsys):
    """Issue 75: of an Android file it spoke of iOS."""
    path = tmp_path / "export.zip"
    path.write_bytes(format_files.zipped(format_files.phyphox(sample(n=300), brand=brand)))
    status, out, _ = command(monkeypatch, capsys, "info", path, "--json", "-")
    assert status == 0
    stated = json.loads(out)["units"]["stated"]
    assert "iOS" not in stated
    assert ("9.81 to a g" in stated) == (brand == "Apple")

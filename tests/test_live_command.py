"""`handcal live` as it is typed: what does not go together, what is estimated, what a device file
brings, and that the end is what `calibrate` says of the recording."""

from __future__ import annotations

import json
import math
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from lab_world import command

from handcal.device import priors
from handcal.device.priors import Learned
from handcal.live import run
from handcal.live.ending import Ended
from handcal.recordings import append
from handcal.recordings.inputs import load
from handcal_sim import simulate, write


@pytest.mark.parametrize(
    ("typed", "why"),
    [
        (["--phyphox", "127.0.0.1:9", "--follow", "x.mcap"], "one source at a time"),
        (["--plain"], "--plain needs --lan"),
        (["--phyphox", "127.0.0.1:9"], "remote access"),
        (["--foxglove", "127.0.0.1:9"], "No Foxglove WebSocket"),
        (["--until", "gyro_scale=5"], None),
        (["--until", "gyro_scales=5%"], "unknown effect"),
        (["--effects", "gyro_scales"], "gyro_scale"),
        (["--model", "x"], "--priors"),
    ],
)
def test_what_does_not_go_together_is_said(monkeypatch, capsys, tmp_path, typed, why):
    if why is None:  # (it may be wanted so: nothing is said, and the next thing is wrong)
        typed, why = [*typed, "--plain"], "--plain needs --lan"
    status, _, said = command(monkeypatch, capsys, "live", "--out", tmp_path / "out", *typed)
    assert status == 2
    assert why in said
    assert not (tmp_path / "out" / "recording.mcap").exists()


def parameters(path: Path) -> dict[tuple[str, str], dict[str, float]]:
    held = json.loads(path.read_text("utf-8"))
    return {(p["effect"], p["name"]): p for p in held["parameters"]}


@pytest.mark.prove
def test_the_end_of_a_session_is_what_calibrate_says(monkeypatch, capsys, tmp_path):
    """With and without effects of one's own; begun with a device file, it knows more."""
    error = {"gyro_scale": [0.01, -0.008, 0.006]}
    for k, name in enumerate(("first", "second")):
        write(simulate("three-turns", seed=k, duration_s=30.0, effects=error),
              tmp_path / f"{name}.mcap")  # fmt: skip

    def typed(*arguments: object) -> str:
        status, out, said = command(monkeypatch, capsys, *arguments)
        assert status == 0, said
        return str(out)

    first, second, phone = tmp_path / "first.mcap", tmp_path / "second.mcap", tmp_path / "p.toml"
    typed("calibrate", first, "--effects", "gyro_scale", "--json", tmp_path / "r.json")
    typed("device", "add", phone, tmp_path / "r.json")
    sigma = {}
    for name, more in (
        ("plain", []),
        ("own", ["--effects", "gyro_scale,accel_scale"]),
        ("device", ["--device", phone]),
    ):
        out = tmp_path / name
        typed("live", "--from", second, "--speed", "0", "--out", out, *more)
        live = parameters(out / "calibration.json")
        effects = ",".join({e for e, _ in live if e not in ("gyro_bias", "accel_bias")})
        again = ["--device", phone] if name == "device" else []
        typed("calibrate", out / "recording.mcap", "--effects", effects, *again,
              "--json", tmp_path / "again.json")  # fmt: skip
        own = parameters(tmp_path / "again.json")
        assert own.keys() == live.keys()
        for key, p in live.items():
            assert abs(p["value"] - own[key]["value"]) < 0.1 * own[key]["sigma"], key
            assert p["sigma"] == pytest.approx(own[key]["sigma"], rel=0.02)
        sigma[name] = live["gyro_scale", "x"]["sigma"]
        assert (out / "exports" / "correction.py").exists()
        found = json.loads((out / "explanation.json").read_text("utf-8"))
        assert "gyro_scale" in {m["effect"] for m in found["missing"]}
    assert ("accel_scale", "x") in parameters(tmp_path / "own" / "calibration.json")
    assert sigma["device"] < 0.9 * sigma["plain"]


class Here:
    """A process behind that is none: what is asked of it is done at once."""

    def submit(self, work: Any, *given: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(work(*given))
        return done

    def shutdown(self, **_: Any) -> None: ...


def test_a_session_ends_when_enough_is_known(monkeypatch, capsys, tmp_path):
    """Before the recording does."""
    write(simulate("three-turns", seed=0, duration_s=10.0), tmp_path / "x.mcap")
    monkeypatch.setattr(run, "worker", Here)

    def finish(session: Any, *_: Any) -> Ended:
        session.recorder.close()
        return Ended("headline", (), ())

    monkeypatch.setattr(run, "finish", finish)
    status, out, said = command(monkeypatch, capsys, "live", "--from", tmp_path / "x.mcap",
                                "--speed", "1000", "--until", "gyro_bias=1deg/s",
                                "--out", tmp_path / "out")  # fmt: skip
    assert status == 0, said
    assert "headline" in out
    assert run.REACHED in said
    ns = append.held(tmp_path / "out" / "recording.mcap").streams["imu"][0]
    assert float(ns[-1] - ns[0]) / 1e9 < 8.0


@pytest.mark.prove
def test_a_whole_session_says_whether_enough_is_known(monkeypatch, capsys, tmp_path):
    """In time, with processes behind: it ends before the recording does. At once: at the end."""
    error = {"gyro_scale": [0.01, -0.008, 0.006]}
    write(simulate("three-turns", seed=0, duration_s=60.0, effects=error), tmp_path / "x.mcap")
    out = tmp_path / "out"
    typed = ("live", "--from", tmp_path / "x.mcap")
    status, told, said = command(monkeypatch, capsys, *typed, "--speed", "1", "--out", out,
                                 "--until", "gyro_scale=1%,gyro_bias=0.1deg/s")  # fmt: skip
    assert status == 0, said
    assert run.REACHED in said
    assert "All is known as well as was asked for" in told
    assert load(out / "recording.mcap").duration_s < 55.0
    for name in ("calibration.json", "explanation.json", "report.html", "exports/correction.py"):
        assert (out / name).exists(), name
        assert name in told
    scale = parameters(out / "calibration.json")["gyro_scale", "x"]
    assert scale["sigma"] < 0.01
    status, told, said = command(monkeypatch, capsys, *typed, "--speed", "0", "--out",
                                 tmp_path / "at-once", "--until", "gyro_scale=1ppm")  # fmt: skip
    assert status == 0, said
    assert "Not known as well as was asked for (--until): Gyro scale" in told, told


@pytest.mark.prove
def test_a_whole_session_begins_with_what_a_fleet_learned(monkeypatch, capsys, tmp_path):
    """It knows what `calibrate --priors` of the recording knows; a model that the file does not
    have is said before anything is recorded."""
    error = {"gyro_scale": [0.01, -0.008, 0.006]}
    write(simulate("three-turns", seed=3, duration_s=25.0, effects=error), tmp_path / "x.mcap")
    file, out = tmp_path / "fleet.toml", tmp_path / "out"
    learned = {("gyro_scale", a): Learned(v, 1e-5, 1e-4, 1e-5, math.inf, 40)
               for a, v in zip("xyz", error["gyro_scale"], strict=True)}  # fmt: skip
    priors.write(file, {"phone": learned, "other": learned},
                 {model: {"recordings": 80, "devices": 40} for model in ("phone",
                                                                            "other")})  # fmt: skip
    typed = ("live", "--from", tmp_path / "x.mcap", "--speed", "0", "--priors", file)
    for wrong in ((), ("--model", "phones")):
        status, _, said = command(monkeypatch, capsys, *typed, *wrong, "--out", out)
        assert (status, "other" in said or "phone" in said) == (2, True)
        assert not out.exists()
    status, told, said = command(monkeypatch, capsys, *typed, "--model", "phone", "--out", out)
    assert status == 0, said
    assert "calibration.json" in told
    live = parameters(out / "calibration.json")
    effects = ",".join({e for e, _ in live if e not in ("gyro_bias", "accel_bias")})
    status, _, said = command(
        monkeypatch, capsys, "calibrate", out / "recording.mcap", "--effects", effects, "--priors",
        file, "--model", "phone", "--json", tmp_path / "again.json",
    )  # fmt: skip
    assert status == 0, said
    own = parameters(tmp_path / "again.json")
    assert own.keys() == live.keys()
    for key, p in live.items():
        assert abs(p["value"] - own[key]["value"]) < 0.1 * own[key]["sigma"], key
    assert live["gyro_scale", "x"]["sigma"] < 1.1e-4
    held = json.loads((out / "calibration.json").read_text("utf-8"))
    assert held["priors"]["model"] == "phone"


@pytest.mark.prove
def test_a_whole_session_says_what_it_is_warned_of(monkeypatch, capsys, tmp_path):
    """A device file of another device: both disagree, which is told and stands in both files."""
    for k, (name, first) in enumerate((("other", 0.01), ("mine", -0.03))):
        write(simulate("three-turns", seed=k, duration_s=25.0,
                       effects={"gyro_scale": [first, -0.008, 0.006]}),
              tmp_path / f"{name}.mcap")  # fmt: skip
    phone, out = tmp_path / "p.toml", tmp_path / "out"
    for arguments in (
        ("calibrate", tmp_path / "other.mcap", "--effects", "gyro_scale", "--json",
         tmp_path / "r.json"),
        ("device", "add", phone, tmp_path / "r.json"),
    ):  # fmt: skip
        status, _, said = command(monkeypatch, capsys, *arguments)
        assert status == 0, said
    status, told, said = command(monkeypatch, capsys, "live", "--from", tmp_path / "mine.mcap",
                                 "--speed", "0", "--device", phone, "--out", out)  # fmt: skip
    assert status == 0, said
    assert f"--device {phone}" in (out / "report.html").read_text("utf-8")
    assert "Warning: This recording and what was known of" in told
    for name in ("explanation.json", "calibration.json"):
        warnings = json.loads((out / name).read_text("utf-8"))["warnings"]
        assert any("disagree about the gyro scale" in w for w in warnings), name

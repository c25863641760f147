"""`handcal live` as it is typed: what does not go together, what is estimated, what a device file
brings, and that the end is what `calibrate` says of the recording."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from lab_world import command

from handcal_sim import simulate, write


@pytest.mark.parametrize(
    ("typed", "why"),
    [
        (["--phyphox", "127.0.0.1:9", "--follow", "x.mcap"], "one source at a time"),
        (["--plain"], "--plain is for --lan"),
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
        typed, why = [*typed, "--plain"], "--plain is for --lan"
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

"""CONTRIBUTING.md followed to the letter: an effect, a format, an export and a command, each in
one file."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from worlds import recording_of

import handcal
from handcal import effects, exports
from handcal.commands import _app
from handcal.recordings import inputs
from handcal_sim import simulate

TEXT = (Path(__file__).resolve().parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")


def listing(heading: str) -> str:
    """The first block of Python under a heading."""
    section = TEXT[TEXT.index(f"## {heading}") :]
    found = re.search(r"```python\n(.*?)```", section, re.S)
    assert found is not None
    return found.group(1)


@pytest.fixture
def member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """Puts a listing into a folder that belongs to a package, for one test."""
    names: list[str] = []

    def put(package: str, name: str, heading: str) -> None:
        (tmp_path / f"{name}.py").write_text(listing(heading))
        module = importlib.import_module(package)
        monkeypatch.setattr(module, "__path__", [*module.__path__, str(tmp_path)])
        names.append(f"{package}.{name}")
        effects.installed.cache_clear()
        exports.formats.cache_clear()

    yield put
    for name in names:
        package, _, attribute = name.rpartition(".")
        sys.modules.pop(name, None)
        sys.modules[package].__dict__.pop(attribute, None)
    monkeypatch.undo()
    effects.installed.cache_clear()
    exports.formats.cache_clear()


def test_an_effect_is_one_file(member) -> None:
    member(effects.__name__, "gyro_cubic", "A new effect")
    recording = recording_of(simulate("free-hand", seed=0, duration_s=12.0), "heading")
    worse = handcal.conceal(recording, {"gyro_cubic": [2e-3, -1e-3, 1e-3]})
    assert np.abs(worse.imu.gyro - recording.imu.gyro).max() > 1e-4
    found = handcal.calibrate(worse, "gyro_cubic").parameters["gyro_cubic"]
    assert np.abs((found.values - [2e-3, -1e-3, 1e-3]) / found.sigmas).max() < 5.0


def test_a_format_is_one_file(member, tmp_path: Path) -> None:
    member(inputs.__name__, "made_up", "A new log format")
    imu = recording_of(simulate("static", seed=0, duration_s=4.0), "heading").imu
    file = tmp_path / "log.rec"
    table = np.column_stack([imu.t, imu.gyro, imu.accel])
    file.write_text("RECORDER\n" + "\n".join(" ".join(map(repr, r)) for r in table.tolist()))
    assert np.allclose(handcal.read(file).imu.gyro, imu.gyro, atol=0.0)
    out = tmp_path / "log.mcap"
    done = CliRunner().invoke(_app.app, ["import", str(file), "-o", str(out)])
    assert done.exit_code == 0, done.output
    (tmp_path / "other.xyz").write_text("something else")
    with pytest.raises(handcal.InputError, match="made-up recorder"):
        handcal.read(tmp_path / "other.xyz")


def test_an_export_is_one_file(member, tmp_path: Path) -> None:
    member(exports.__name__, "toml", "A new export")
    values = {"gyro_bias": [0.01, 0.0, -0.01], "gyro_scale": [0.25, 0.0, 0.0]}
    rows = [
        {"effect": i, "name": a, "value": v, "sigma": 1e-3, "unit": "1", "observable": True}
        for i, own in values.items()
        for a, v in zip("xyz", own, strict=True)
    ]
    result, out = tmp_path / "result.json", tmp_path / "gyro.toml"
    rows += [r | {"effect": "accel_bias", "value": 0.5, "unit": "m/s^2"} for r in rows[:3]]
    result.write_text(json.dumps({"schema": "handcal/calibration/1", "parameters": rows}))
    done = CliRunner().invoke(_app.app, ["export", str(result), "--to", "toml", "-o", str(out)])
    assert done.exit_code == 0, done.output
    found = tomllib.loads(out.read_text())
    assert found["gyro_bias"] == values["gyro_bias"]
    assert np.allclose(found["gyro"], np.diag([0.8, 1.0, 1.0]))
    assert "toml" in CliRunner().invoke(_app.app, ["export"]).output


def test_a_command_is_one_file(member, tmp_path: Path) -> None:
    member("handcal.commands", "duration", "A new command")
    runner = CliRunner()
    assert "Say how long a recording is." in runner.invoke(_app.app, ["--help"]).output
    recording = recording_of(simulate("static", seed=0, duration_s=4.0), "heading")
    handcal.api.Recording.of(recording).write(tmp_path / "x.mcap")
    done = runner.invoke(_app.app, ["duration", str(tmp_path / "x.mcap")])
    assert done.output == "4.0 s\n"

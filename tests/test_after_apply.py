"""`explain`, `apply`, `explain` again: what was found is gone, and nothing else has come up.

By the command line, as the docs say it; run by `make prove`. Ten recordings: eight of simulated
devices that err each in another way, two of real ones.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.prove

# Motion, and effects of about the catalogue's usual size.
SIMULATED = (
    ("free-hand", "gyro_scale=0.012,-0.008,0.01"),
    ("three-turns", "gyro_scale=0.01,0.01,-0.012"),
    ("free-hand", "accel_scale=0.01,-0.012,0.008",
     "gyro_misalignment=0.01,-0.008,0.006,0.01,-0.01,0.005"),
    ("free-hand", "heading_delay=0.15"),
    ("free-hand", "heading_hard_iron=0.15,0.1"),
    ("free-hand", "gyro_bandwidth=0.03"),
    ("free-hand", "accel_delay=0.02"),
    ("free-hand", "gyro_g_sensitivity=3e-4,0,0,0,-3e-4,0,0,2e-4,3e-4"),
)  # fmt: skip
REAL = ("raw/sensorlogger_android.zip", "sensor_logger_ios")


def handcal(*arguments: str | Path) -> str:
    """What a command says on both streams; it has to succeed."""
    command = [sys.executable, "-m", "handcal", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def explained(path: Path) -> tuple[str, set[str]]:
    """The verdict, and the effects that are missing, those among them that are as likely too."""
    out = path.with_suffix(".json")
    handcal("explain", path, "--json", out)
    found = json.loads(out.read_text(encoding="utf-8"))
    alike = [m["indistinguishable_from"] for m in found["missing"]]
    return found["verdict"], {m["effect"] for m in found["missing"]}.union(*alike)


def taken_off(said: str) -> set[str]:
    """The effects that `apply` says it took off."""
    return set(said.split(" removed from ")[0].rsplit(": ", 1)[-1].split(", "))


@pytest.mark.parametrize("number", range(len(SIMULATED)))
def test_a_simulated_device_has_nothing_left(number: int, tmp_path: Path) -> None:
    motion, *effects = SIMULATED[number]
    path, clean = tmp_path / "a.mcap", tmp_path / "clean.mcap"
    options = [part for effect in effects for part in ("--effect", effect)]
    handcal("simulate", motion, "-o", path, "--seed", str(number + 1), *options)
    before = explained(path)
    said = handcal("apply", path, "--from", path.with_suffix(".json"), "--biases", "-o", clean)
    after = explained(clean)
    print(f"{motion}, {', '.join(effects)}: {before}, then {after}")
    wanted = {effect.split("=")[0] for effect in effects}
    assert wanted <= before[1]
    assert wanted <= taken_off(said)
    assert after == ("nothing_missing", set())


@pytest.mark.parametrize("name", REAL)
def test_of_a_real_device_nothing_is_left_that_was_taken_off(
    name: str, real_recordings: Path, tmp_path: Path
) -> None:
    """Where it sits and its noise stay in the readings, which `apply` says; they may be found
    again."""
    path, clean = tmp_path / "a.mcap", tmp_path / "clean.mcap"
    handcal("import", real_recordings / name, "-o", path)
    before = explained(path)
    said = handcal("apply", path, "--from", path.with_suffix(".json"), "--biases", "-o", clean)
    after = explained(clean)
    taken = taken_off(said)
    print(f"{name}: {before}, taken {sorted(taken)}, then {after}")
    assert taken & before[1]
    assert not taken & after[1]
    assert after[1] <= before[1]

"""Sealed recordings: `python -m handcal_sim.seal DIR`.

A dozen small recordings with hidden errors, under names that tell nothing, and one file with
the answers: for those who want to try `explain` without having seen the truth. The order, and
what is hidden, comes from the system's entropy unless a seed is given; nothing is printed but
the files' names and sizes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal_sim import strangers
from handcal_sim.errors import SimulationError
from handcal_sim.mcap_writer import write
from handcal_sim.prove.draw import circumstances
from handcal_sim.prove.given import Circumstances, amplitudes, answer, completed, simulated
from handcal_sim.prove.suites import NEEDS, SIZES, Answer
from handcal_sim.scenario import World

ANSWERS = "answers.json"
# Kind, motion, s: three with nothing missing, five with one effect, two with two,
# one beyond the catalogue, and one whose motion cannot tell its effect from others.
_CONTENTS = (
    ("nothing", "z-turn", 30.0), ("nothing", "three-turns", 60.0), ("nothing", "free-hand", 84.0),
    ("one", "free-hand", 84.0), ("one", "free-hand", 84.0), ("one", "free-hand", 84.0),
    ("one", "free-hand", 84.0), ("one", "three-turns", 60.0),
    ("two", "free-hand", 84.0), ("two", "free-hand", 84.0),
    ("unknown", "free-hand", 84.0), ("gauge", "z-turn", 30.0),
)  # fmt: skip
# Sharply outside: no drift and no bump that noise of some colour would explain.
_STRANGE = (
    "accel_rate_temperature", "gyro_acceleration", "gyro_rate_force", "accel_rate",
    "gyro_scale_drift",
)  # fmt: skip
# In a turn at a steady rate about z, each of these is one and the same error of the gyro.
_GAUGE = "gyro_scale"
# Of a size that a minute shows for certain, and such that each leaves a trace of its own.
_PLAIN = sorted(set(SIZES) - {
    "earth_rate", "gravity", "accel_bias_walk", "gyro_bias_walk", "gyro_g_sensitivity",
    "accel_cross_products", "clock_rate",
})  # fmt: skip


def seal(folder: Path, seed: int) -> list[Path]:
    """Writes the recordings and the answers; the files. SimulationError if some are there."""
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / ANSWERS).exists() or list(folder.glob("sealed_*.mcap")):
        raise SimulationError(f"{folder} holds sealed recordings already")
    rng = np.random.default_rng([seed, 2])
    files, answers = [], {}
    for place, k in enumerate(rng.permutation(len(_CONTENTS))):
        kind, scenario, duration = _CONTENTS[int(k)]
        world, drawn = _drawn(kind, _small(scenario, duration, rng), rng)
        file = folder / f"sealed_{place + 1:02d}.mcap"
        write(world, file, truth=False)
        files.append(file)
        answers[file.name] = dataclasses.asdict(completed(world, drawn))
    document = {"schema": "handcal-sim/answers/1", "seed": seed, "recordings": answers}
    (folder / ANSWERS).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return [*files, folder / ANSWERS]


def _small(scenario: str, duration: float, rng: np.random.Generator) -> Circumstances:
    """A motion with everything that makes files large kept low. Streams come before effects,
    so that they tell nothing of these."""
    given = circumstances("one", rng)
    mag, pose, thermometer = (rng.random(3) < [0.2, 0.25, 0.5]).tolist()
    return replace(
        given, scenario=scenario, duration_s=duration, rate_hz=100.0 if duration < 40 else 50.0,
        heading_hz=0.0 if mag else 10.0, heading_sigma_deg=min(given.heading_sigma_deg, 6.0),
        sway=min(given.sway, 1.5), mag=mag, pose=pose and not mag, thermometer=thermometer,
        warming_K=float(rng.uniform(10.0, 18.0)),
    )  # fmt: skip


def _drawn(kind: str, given: Circumstances, rng: np.random.Generator) -> tuple[World, Answer]:
    if kind == "unknown":
        able = [s for s in _STRANGE if given.thermometer or s not in strangers.NEEDS_TEMPERATURE]
        stranger = str(rng.choice(able))
        world, strange = strangers.estrange(stranger, simulated(given, {}), rng)
        said = {"kind": stranger, **strangers.said_of(strange)}
        return world, answer("sealed", kind, given, {}, said)
    names = [_GAUGE] if kind == "gauge" else _some({"one": 1, "two": 2}.get(kind, 0), given, rng)
    effects = amplitudes(names, given, rng)
    return simulated(given, effects), answer("sealed", kind, given, effects)


def _some(count: int, given: Circumstances, rng: np.random.Generator) -> list[str]:
    """So many effects that this recording's streams can show."""
    able = [name for name in _PLAIN if NEEDS.get(name, frozenset()) <= given.streams]
    return [str(name) for name in rng.choice(able, count, replace=False)]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="Write sealed recordings and their answers.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int)
    asked = parser.parse_args()
    seed = asked.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    for file in seal(asked.folder, seed):
        print(f"{file}: {file.stat().st_size} bytes")


if __name__ == "__main__":
    main()

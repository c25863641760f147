"""What people do while a phone records: steps, walks, bumps, a table, a chair, a lift.

Each act changes a motion: it adds to the path of the hand, which stays four times
differentiable, adds a rotation, or halts the turning for a while.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import NONE, ONE, STILL, Motion, Scenario, Start, between, start_matrix
from handcal_sim.profiles import Array, Profile

Act = Callable[[Motion, Start, np.random.Generator], Motion]


def people(base: Scenario, acts: Sequence[Act]) -> Scenario:
    """This motion with these acts; nothing is promised of its rests any more."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        motion = base(duration, start, rng)
        for act in acts:
            motion = act(motion, start, rng)
        return replace(motion, name="people", rests=())

    return made


def one_axis(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """To and fro about a single axis of the body."""
    windows = [(2.0, duration - 2.0)]
    omega = 2.0 * math.pi * rng.uniform(0.1, 0.5)
    size = rng.uniform(0.5, 1.5)
    moving = profiles.gate(windows, 2.0)
    swing = profiles.sinusoids(np.array([omega]), np.array([[size]]), np.zeros((1, 1)))
    angle = profiles.along(np.eye(3)[rng.integers(3)], profiles.multiply(moving, swing))
    quick = profiles.along([size * omega / math.sqrt(2.0)], moving)
    return Motion("one-axis", duration, start_matrix(start), (angle,), STILL, ONE, quick,
                  between(windows, duration))  # fmt: skip


def steps_aside(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """Half a metre or so to any side within a second, up and down by some cm on the way."""
    at, lasts = _when(motion, rng), rng.uniform(0.8, 1.5)
    aside = profiles.along(_level(rng) * rng.uniform(0.4, 0.9), profiles.turn(at, at + lasts, 1.0))
    lift = profiles.gate([(at, at + lasts)], 0.5 * lasts)
    return _moved(motion, aside, profiles.along([0.0, 0.0, rng.uniform(0.01, 0.04)], lift))


def lifts(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """The hand goes up by 0.2 to 0.5 m within one or two seconds."""
    at, lasts = _when(motion, rng), rng.uniform(1.0, 2.0)
    up = profiles.turn(at, at + lasts, rng.uniform(0.2, 0.5))
    return _moved(motion, profiles.along([0.0, 0.0, 1.0], up))


def walks(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """Some metres ahead, rising and swaying with the steps."""
    at, lasts = _when(motion, rng), min(rng.uniform(4.0, 10.0), 0.4 * motion.duration_s)
    ahead = _level(rng)
    step = 2.0 * math.pi * rng.uniform(1.6, 2.0)
    side = np.array([-ahead[1], ahead[0], 0.0])
    sizes = np.stack([side * rng.uniform(0.01, 0.03), np.array([0.0, 0.0, 0.02])])
    gait = profiles.sinusoids(np.array([0.5 * step, step]), sizes, np.zeros((2, 3)))
    window = profiles.gate([(at, at + lasts)], 0.8)
    way = profiles.turn(at, at + lasts, lasts * rng.uniform(0.8, 1.2))
    return _moved(motion, profiles.along(ahead, way), profiles.multiply(window, gait))


def bumps(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """Against the table once to three times: some mm and a degree within a tenth of a second."""
    for _ in range(int(rng.integers(1, 4))):
        motion = _bumped(motion, _when(motion, rng), rng)
    return motion


def puts_down(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """Onto a table for some seconds, as it lay at first, and up again."""
    at, lasts = _when(motion, rng), min(rng.uniform(5.0, 10.0), 0.4 * motion.duration_s)
    there = profiles.gate([(at, at + lasts)], rng.uniform(1.2, 1.8))
    down = profiles.along([0.0, 0.0, -rng.uniform(0.2, 0.5)], there)
    motion = _halted(_moved(motion, down), at, at + lasts)
    lying = profiles.gate([(at + 1.8, at + lasts - 1.8)], 0.2)
    held = profiles.multiply(_less(lying), motion.held)
    return _bumped(replace(motion, held=held), at + 1.75, rng)


def drops_slowly(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """The arm tires: down by 0.2 to 0.6 m within 10 to 30 s."""
    lasts = min(rng.uniform(10.0, 30.0), 0.7 * motion.duration_s)
    at = rng.uniform(0.1, 0.25) * motion.duration_s
    down = profiles.turn(at, at + lasts, -rng.uniform(0.2, 0.6))
    return _moved(motion, profiles.along([0.0, 0.0, 1.0], down))


def stops_early(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """Turns for a third of the time or so, and holds still from then on."""
    at = rng.uniform(0.25, 0.5) * motion.duration_s
    return _halted(motion, at, motion.duration_s + 60.0)


def changes_hands(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """To the other hand, some 30 cm aside, which holds it at another angle."""
    at, lasts = _when(motion, rng), rng.uniform(0.8, 1.3)
    over = profiles.turn(at, at + lasts, 1.0)
    axis = rng.standard_normal(3)
    axis *= rng.uniform(0.3, 1.0) / np.linalg.norm(axis)
    moved = _moved(motion, profiles.along(_level(rng) * rng.uniform(0.2, 0.4), over))
    moved = replace(moved, stages=(*moved.stages, profiles.along(axis, over)))
    return _bumped(moved, at + 0.5 * lasts, rng)


def swivels(motion: Motion, start: Start, rng: np.random.Generator) -> Motion:
    """Sits on a swivel chair, which turns to and fro with person and phone."""
    omega = 2.0 * math.pi * rng.uniform(0.06, 0.2)
    swing = profiles.sinusoids(
        np.array([omega]), np.array([[rng.uniform(0.4, 1.4)]]), np.zeros((1, 1))
    )
    moving = profiles.gate([(1.0, motion.duration_s - 1.0)], 2.0)
    angle = profiles.multiply(moving, swing)
    first = profiles.constant([start.roll, start.pitch, start.heading])
    stages = (profiles.along([0.0, 0.0, 1.0], angle), first, *motion.stages)
    round_it = profiles.circle(angle, rng.uniform(0.3, 0.6), rng.uniform(-math.pi, math.pi))
    return replace(_moved(motion, round_it), C_start=np.eye(3), stages=stages)


def rides_a_lift(motion: Motion, _start: Start, rng: np.random.Generator) -> Motion:
    """One to three storeys up or down."""
    height = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 10.0)
    lasts = min(abs(height) / rng.uniform(0.8, 1.3) + 2.0, 0.6 * motion.duration_s)
    at = rng.uniform(0.1, 0.3) * motion.duration_s
    return _moved(motion, profiles.along([0.0, 0.0, height], profiles.turn(at, at + lasts, 1.0)))


def _when(motion: Motion, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.15, 0.5)) * motion.duration_s


def _level(rng: np.random.Generator) -> Array:
    """A horizontal direction (3,)."""
    angle = rng.uniform(-math.pi, math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _moved(motion: Motion, *ways: Profile) -> Motion:
    return replace(motion, path=profiles.add(motion.path, *ways))


def _less(gate: Profile) -> Profile:
    """1 less a gate."""
    return profiles.add(ONE, profiles.along([-1.0], gate))


def _bumped(motion: Motion, at: float, rng: np.random.Generator) -> Motion:
    ramp = rng.uniform(0.03, 0.06)
    bump = profiles.gate([(at, at + 2.0 * ramp)], ramp)
    way, axis = rng.standard_normal((2, 3))
    way *= rng.uniform(1e-3, 4e-3) / np.linalg.norm(way)
    axis *= math.radians(rng.uniform(0.3, 1.5)) / np.linalg.norm(axis)
    moved = _moved(motion, profiles.along(way, bump))
    return replace(moved, stages=(*moved.stages, profiles.along(axis, bump)))


def _halted(motion: Motion, start: float, end: float) -> Motion:
    """No turning from start to end; before and after that within a second or so."""
    going = _less(profiles.gate([(start, end)], 1.6))
    stages = tuple(profiles.multiply(going, stage) for stage in motion.stages)
    activity = profiles.add(NONE, profiles.multiply(going, motion.activity))
    return replace(motion, stages=stages, activity=activity)

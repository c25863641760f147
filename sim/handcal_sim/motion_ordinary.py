"""Short motions that people make with a device, often about one axis alone or to one side."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import NONE, ONE, STILL, Motion, Start, between, start_matrix
from handcal_sim.motion_phone import spaced
from handcal_sim.profiles import Profile

# On a table a device slides, but it hardly tilts: so much of what a hand would add.
_ON_A_TABLE = 0.15


def yaw_on_a_table(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """Lying on a table, turned by a quarter to a whole turn at a time, mostly the same way."""
    moves = spaced(duration, max(2, round(duration / 9.0)), rng)
    way = np.where(rng.random(len(moves)) < 0.8, start.direction, -start.direction)
    sizes = (way * rng.choice([0.5, 1.0, 2.0], len(moves)) * math.pi).tolist()
    angle = profiles.add(*(profiles.turn(a, b, s) for (a, b), s in zip(moves, sizes, strict=True)))
    quick = [profiles.turn_rate(a, b, s) for (a, b), s in zip(moves, sizes, strict=True)]
    lies = profiles.constant([start.roll, start.pitch, start.heading])
    return Motion(
        "yaw-on-a-table", duration, np.eye(3), (profiles.along([0.0, 0.0, 1.0], angle), lies),
        STILL, NONE, profiles.along([_ON_A_TABLE], profiles.add(*quick)),
        between(moves, duration),
    )  # fmt: skip


def two_axes(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """To and fro about two of the body's axes, one after the other and again, in the hand."""
    moves = spaced(duration, 4, rng)
    axes = rng.choice(3, 2, replace=False)
    angles, quick = [], []
    for k, window in enumerate(moves):
        omega, size = 2.0 * math.pi * rng.uniform(0.2, 0.6), rng.uniform(0.4, 1.4)
        swing = profiles.sinusoids(np.array([omega]), np.array([[size]]), np.zeros((1, 1)))
        moving = profiles.gate([window], 0.2 * (window[1] - window[0]))
        angles.append(profiles.along(np.eye(3)[axes[k % 2]], profiles.multiply(moving, swing)))
        quick.append(profiles.along([size * omega / math.sqrt(2.0)], moving))
    return Motion(
        "two-axes", duration, start_matrix(start), (profiles.add(*angles),), STILL, ONE,
        profiles.add(*quick), between(moves, duration),
    )  # fmt: skip


def six_sides(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """Laid onto each of its six sides for some seconds; between these lifted by some cm and
    tipped over, but never turned for turning's sake."""
    rest = duration / 6.0
    stages: list[Profile] = []
    quick, lifts, moves = [], [], []
    # Four sides about x, back to the first, and the other two about y.
    tips = [(0, 1.0), (0, 1.0), (0, 1.0), (None, 0.0), (1, 2.0)]
    for k, (axis, quarters) in enumerate(tips):
        at, lasts = (k + 1) * rest - 0.75, rng.uniform(1.2, 1.8)
        ways = [(0, 1.0), (1, 1.0)] if axis is None else [(axis, quarters)]
        for n, (i, q) in enumerate(ways):
            a = at + n * lasts / len(ways)
            b = a + lasts / len(ways)
            angle = start.direction * q * 0.5 * math.pi
            stages.append(profiles.along(np.eye(3)[i], profiles.turn(a, b, angle)))
            quick.append(profiles.turn_rate(a, b, angle))
        moves.append((at, at + lasts))
        aside = rng.uniform([-0.02, -0.02, 0.03], [0.02, 0.02, 0.08])
        lifts.append(profiles.along(aside, profiles.gate([(at, at + lasts)], 0.45 * lasts)))
    held = profiles.gate(moves, 0.3)
    return Motion(
        "six-sides", duration, start_matrix(start), tuple(stages), profiles.add(STILL, *lifts),
        held, profiles.add(NONE, *quick), between(moves, duration),
    )  # fmt: skip

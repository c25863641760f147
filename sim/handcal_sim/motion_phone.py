"""What people do with a phone to calibrate it: swings, turns with short rests, figures of eight.

Each goes about one joint (shoulder, elbow, wrist, or the middle of the phone), which stays in its
place but for the hand's sway: it is the held point, and the phone's place from it is the lever arm.
"""

from __future__ import annotations

import math

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import NONE, ONE, STILL, Motion, Scenario, Start, between, start_matrix
from handcal_sim.profiles import Array, Profile

Windows = list[tuple[float, float]]


def swings(largest_rad: float, hz: float) -> Scenario:
    """To and fro about each axis in turn, so far and so often but for a quarter."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        windows = spaced(duration, 3 * max(1, round(duration / 30.0)), rng)
        angles, quick = [], []
        for k, window in enumerate(windows):
            omega = 2.0 * math.pi * hz * rng.uniform(0.75, 1.25)
            size = largest_rad * rng.uniform(0.75, 1.25)
            swing = profiles.sinusoids(np.array([omega]), np.array([[size]]), np.zeros((1, 1)))
            moving = profiles.gate([window], 0.2 * (window[1] - window[0]))
            angles.append(profiles.along(np.eye(3)[k % 3], profiles.multiply(moving, swing)))
            quick.append(profiles.along([size * omega / math.sqrt(2.0)], moving))
        return _about_a_joint("swings", duration, start, angles, quick, windows)

    return made


def routine(quarters: bool) -> Scenario:
    """Yaw, roll and pitch: each a full turn, or four quarters with a short rest after each."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        each = 4 if quarters else 1
        cycle_s = 36.0 if quarters else 18.0
        count = 3 * each * max(1, round(duration / cycle_s))
        windows = spaced(duration, count, rng)
        angle = start.direction * 2.0 * math.pi / each
        angles = [
            profiles.along(np.eye(3)[(2, 0, 1)[k // each % 3]], profiles.turn(a, b, angle))
            for k, (a, b) in enumerate(windows)
        ]
        quick = [profiles.turn_rate(a, b, angle) for a, b in windows]
        return _about_a_joint("routine", duration, start, angles, quick, windows)

    return made


def figure_of_eight(largest_rad: float, hz: float) -> Scenario:
    """The joint bends once to and fro while it bends twice the other way; slowly rolling."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        rest = min(1.5, 0.1 * duration)
        windows = [(rest, duration - rest)]
        omega = 2.0 * math.pi * hz * rng.uniform(0.8, 1.2)
        turns = np.array([2.0 * omega, omega, rng.uniform(0.12, 0.2) * omega])
        size = largest_rad * rng.uniform([0.4, 0.8, 0.5], [0.7, 1.2, 0.9])
        eight = profiles.sinusoids(turns, np.diag(size), np.zeros((3, 3)))
        moving = profiles.gate(windows, min(2.0, 0.2 * (duration - 2.0 * rest)))
        quick = profiles.along([float(np.linalg.norm(turns * size)) / math.sqrt(2.0)], moving)
        angles = [profiles.multiply(moving, eight)]
        return _about_a_joint("figure-of-eight", duration, start, angles, [quick], windows)

    return made


def spaced(duration: float, count: int, rng: np.random.Generator) -> Windows:
    """So many movements with short rests before, between and after: from and to, s."""
    rests = rng.uniform(0.6, 1.4, count + 1)
    moves = rng.uniform(0.8, 1.2, count)
    rests *= min(1.0, 0.3 * duration / np.sum(rests))
    moves *= (duration - np.sum(rests)) / np.sum(moves)
    starts = np.cumsum(rests[:-1]) + np.concatenate([[0.0], np.cumsum(moves)[:-1]])
    return [(float(a), float(a + m)) for a, m in zip(starts, moves, strict=True)]


def _about_a_joint(
    name: str, duration: float, start: Start, angles: list[Profile], quick: list[Profile],
    windows: Windows,
) -> Motion:  # fmt: skip
    """angles: to be added (d = 3), only one axis away from whole turns at a time, or all as one."""
    return Motion(
        name, duration, start_matrix(start), (profiles.add(*angles),), STILL, ONE,
        profiles.add(NONE, *quick), between(windows, duration),
    )  # fmt: skip


def joint_to_phone(reach_m: float, rng: np.random.Generator) -> Array:
    """The phone's place (3,) from the joint in body axes, m: its length lies along the arm."""
    place: Array = rng.normal(0.0, 0.1 * reach_m, 3) + np.array([0.0, reach_m, 0.0])
    return place

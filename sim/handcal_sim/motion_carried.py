"""A phone that is carried about at will: the hand travels, the person steps, the phone turns."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import ONE, Motion, Scenario, Start, between, random_sinusoids, start_matrix
from handcal_sim.profiles import Profile


def strolled(duration: float, reach_m: float, rng: np.random.Generator) -> Profile:
    """A way through the room (d = 3), m: within reach of where it began, up and down by a third
    of that, and by a few cm with each step. It rests for 2 s at both ends."""
    omega, sin, cos = random_sinusoids(rng, 8, 0.04, 0.3, 3)
    sin, cos = sin / omega[:, None], cos / omega[:, None]
    widest = np.max(np.abs(profiles.sinusoids(omega, sin, cos)(np.arange(0.0, duration, 0.1))[0]))
    size = reach_m / widest * np.array([1.0, 1.0, 1.0 / 3.0])
    step = 2.0 * math.pi * rng.uniform(1.6, 2.0)
    height = np.array([[0.0, 0.0, rng.uniform(0.01, 0.025)]])
    bob = profiles.sinusoids(np.array([step]), height, np.zeros((1, 3)))
    roam = profiles.sinusoids(omega, sin * size, cos * size)
    moving = profiles.gate([(2.0, duration - 2.0)], 2.0)
    return profiles.multiply(moving, profiles.add(roam, bob))


def way_of(path: Profile, duration: float) -> float:
    """Length of a path, m."""
    steps = np.diff(path(np.arange(0.0, duration, 0.02))[0], axis=0)
    return float(np.sum(np.linalg.norm(steps, axis=1)))


def carried(path: Profile, rate_rad_s: float) -> Scenario:
    """Along this path, turning about all axes at this rate (rms of Euler rates)."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        windows = [(2.0, duration - 2.0)]
        moving = profiles.gate(windows, 2.0)
        omega, sin, cos = random_sinusoids(rng, 12, 0.05, 0.6, 3)
        size = rate_rad_s / math.sqrt(0.5 * np.sum(sin**2 + cos**2)) / omega[:, None]
        angles = profiles.multiply(moving, profiles.sinusoids(omega, size * sin, size * cos))
        return Motion(
            "carried", duration, start_matrix(start), (angles,), path, ONE,
            profiles.along([rate_rad_s], moving), between(windows, duration),
        )  # fmt: skip

    return made

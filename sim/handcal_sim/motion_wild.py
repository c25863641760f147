"""Wild motion: quick, wide and irregular turning about axes that change, with pauses."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import ONE, STILL, Motion, Scenario, Start, between, start_matrix
from handcal_sim.profiles import Array, Profile

LINES, LOW_HZ, HIGH_HZ = 24, 0.15, 5.0


def wild(rate_rad_s: float) -> Scenario:
    """Bouts of turning at this rate (rms of Euler rates, but for a third), each about axes of its
    own, and pauses of up to a few seconds between them."""

    def made(duration: float, start: Start, rng: np.random.Generator) -> Motion:
        windows = _bouts(duration, rng)
        angles, quick = [], []
        for window in windows:
            moving = profiles.gate([window], min(1.0, 0.25 * (window[1] - window[0])))
            rate = rate_rad_s * rng.uniform(0.7, 1.3)
            angles.append(profiles.multiply(moving, _irregular(rate, rng)))
            quick.append(profiles.along([rate], moving))
        return Motion(
            "wild", duration, start_matrix(start), (profiles.add(*angles),), STILL, ONE,
            profiles.add(*quick), between(windows, duration),
        )  # fmt: skip

    return made


def _bouts(duration: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """From and to of each bout, s: 3 to 12 s long, pauses of 0.3 to 3 s before, between, after."""
    bouts: list[tuple[float, float]] = []
    at = rng.uniform(1.0, 3.0)
    while not bouts or at + 5.0 < duration:
        end = min(at + rng.uniform(3.0, 12.0), duration - 1.0)
        bouts.append((float(at), float(end)))
        at = end + math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
    return bouts


def _irregular(rate_rad_s: float, rng: np.random.Generator) -> Profile:
    """Angles (d = 3) whose rates have this rms together and a spectrum that falls to a half
    about 2 Hz; one of the three axes turns most."""
    edges = np.geomspace(LOW_HZ, HIGH_HZ, LINES + 1)
    hz = rng.uniform(edges[:-1], edges[1:])
    share = rng.dirichlet([1.0, 1.0, 1.0])
    # Lines lie the denser the lower they are: amplitudes make up for that.
    weight = np.sqrt(hz / (1.0 + (hz / 2.0) ** 2))[:, None] * np.sqrt(share)
    sin, cos = weight * rng.standard_normal((2, LINES, 3))
    size = rate_rad_s / math.sqrt(0.5 * float(np.sum(sin**2 + cos**2)))
    omega: Array = 2.0 * math.pi * hz
    return profiles.sinusoids(omega, size * sin / omega[:, None], size * cos / omega[:, None])

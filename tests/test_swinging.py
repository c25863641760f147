"""What an accelerometer beside the IMU's origin adds keeps its velocity where noise is averaged out
of its derivatives: in wild motion its parts nearly cancel, and what is left tells where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from worlds import problem_of

from handcal.estimate.corrected import corrected_readings
from handcal.estimate.derivatives import AVERAGE_S, differentiated
from handcal.types import Array, Imu, Recording

RATE_HZ, SECONDS, FASTEST_HZ = 250.0, 20.0, 4.0
EFFECT = "size_effect"


def wild(rng: np.random.Generator) -> tuple[Recording, Array]:
    """Turning by tens of degrees four times a second about all axes, and its attitude (n, 3, 3)."""
    edges = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    hz = rng.uniform(0.2, FASTEST_HZ, (8, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (8, 3))
    angles = np.sum(0.8 / hz * np.sin(2.0 * np.pi * hz * edges[:, None, None] + phase), axis=1)
    ends = Rotation.from_euler("ZYX", angles)
    turn = (ends[:-1].inv() * ends[1:]).as_rotvec()
    C_nb = (ends[:-1] * Rotation.from_rotvec(0.5 * turn)).as_matrix()
    gyro = turn * RATE_HZ
    accel = -9.80665 * C_nb[:, 2, :]
    t = 0.5 * (edges[:-1] + edges[1:])
    return Recording("wild", Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))), C_nb


def drift(swings: bool) -> float:
    """By how much the velocity of an arm of one metre along x is off in the mean of each half
    second, at the most, over how fast its end moves (root mean square)."""
    recording, C_nb = wild(np.random.default_rng(0))
    problem, _ = problem_of(recording, [EFFECT], ("fixed_position",))
    (effect,) = problem.effects
    problem = replace(problem, effects=(replace(effect, swings=swings),))
    zero = np.zeros(3)
    done = corrected_readings(problem, np.zeros(problem.constants), zero, zero, C_nb)
    slopes = differentiated(done, np.zeros((len(C_nb), 6))).slopes
    assert slopes is not None
    # (the same place of all three accelerometers: xx, yx and zx)
    arm = slopes.dense(9)[:, 3:, [0, 3, 6]].sum(axis=2)
    at = np.searchsorted(recording.imu.t, problem.nodes.t)
    told = np.cumsum(np.einsum("nij,nj->ni", C_nb[at], arm), axis=0) / RATE_HZ
    true = np.einsum("nij,nj->ni", C_nb, np.cross(recording.imu.gyro, [1.0, 0.0, 0.0]))[at]
    short = round(AVERAGE_S[0] * RATE_HZ)
    off = (told - true + true[0])[short:-short]
    half = round(0.5 * RATE_HZ)
    means = np.abs(np.add.reduceat(off, np.arange(0, len(off) - half, half), axis=0)) / half
    return float((means - means[0]).max() / np.sqrt(np.mean(true**2)))


def test_the_velocity_of_an_arm_is_that_of_its_end() -> None:
    """Along axes that turn meanwhile, speeding up and the force towards the centre are averaged
    apart, and what is left grows with time."""
    # (a mean over 50 ms takes 6 % of what swings at 4 Hz; a peak is three times the rms)
    assert drift(swings=True) < 0.2
    assert drift(swings=False) > 1.0

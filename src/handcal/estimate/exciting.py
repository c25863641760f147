"""What of a motion counts as motion, and may excite an effect; what is a hand's sway, or noise."""

from __future__ import annotations

import numpy as np

from handcal.estimate.problem import Problem
from handcal.estimate.sampling import interpolated
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array

# Velocities that change within less, s, are a hand's tremor.
STEADY_S = 0.15


def held(problem: Problem) -> bool:
    """Whether the device turns about a point that wanders."""
    return any(o.wandering for o in problem.observations)


def unexciting(
    problem: Problem, nominal: Trajectory, d: Array, C_nb: Array | None
) -> tuple[Array | None, Array | None]:
    """What may excite no effect: the readings' noise, and a force without a hand's sway (see
    ``differentiated``)."""
    noise = _implied_noise(problem, nominal, d) if problem.navigated else None
    if C_nb is None or not held(problem):
        return noise, None
    return noise, _steady_force(problem, nominal, C_nb)


def _steady_force(problem: Problem, nominal: Trajectory, C_nb: Array) -> Array:
    """Specific force (n, 3) at the IMU's samples without what a point that wanders feels.

    The hand's sway is random, and how large it is nobody knows. An effect that makes it a
    little smaller would be favoured for that alone (looked at ten times a second, a scale error
    of the accelerometer by 8 nats in 84 s; at the usual rate, a law of small changes of the force
    alone, which is nearly all sway, by 40 nats in 30 s), so sway may not excite effects. Nor may
    what a hand does within less than ``STEADY_S``: its tremor is left in this velocity, and in
    slow turns the slope of its force was nine tenths of an accelerometer delay's information.
    """
    f_n = _changing(problem, nominal, nominal.v - _wandering(problem, nominal)) - problem.g_n
    return np.asarray(np.einsum("nji,nj->ni", C_nb, f_n))


def sway(problem: Problem, nominal: Trajectory, C_nb: Array) -> Array:
    """Force (n, 3) that a point that wanders adds at the IMU's samples."""
    a_n = _accelerated(problem, nominal, _wandering(problem, nominal))
    return np.asarray(np.einsum("nji,nj->ni", C_nb, a_n))


def _wandering(problem: Problem, nominal: Trajectory) -> Array:
    """Velocity (k, 3) at which the held point wanders at the epochs."""
    out, at = np.zeros_like(nominal.v), 0
    for observation in problem.observations:
        for state in observation.wandering:
            out += nominal.markov[:, at + state : at + state + 3]
        at += observation.markov.size if observation.markov is not None else 0
    return out


def _accelerated(problem: Problem, nominal: Trajectory, v: Array) -> Array:
    """Acceleration (n, 3) at the IMU's samples of velocities v (k, 3) at the epochs."""
    t = problem.nodes.t[nominal.node]
    a = np.diff(v, axis=0) / np.maximum(np.diff(t), 1e-6)[:, None]
    t_imu, middle = problem.recording.imu.t, 0.5 * (t[1:] + t[:-1])
    return interpolated(t_imu, middle, a)


def _changing(problem: Problem, nominal: Trajectory, v: Array) -> Array:
    """The same over ``STEADY_S`` about each sample."""
    t, t_imu = problem.nodes.t[nominal.node], problem.recording.imu.t
    ends = [np.clip(t_imu + s, t[0], t[-1]) for s in (-0.5 * STEADY_S, 0.5 * STEADY_S)]
    before, after = (interpolated(x, t, v) for x in ends)
    return np.asarray((after - before) / np.maximum(ends[1] - ends[0], 1e-6)[:, None])


def _implied_noise(problem: Problem, nominal: Trajectory, d: Array) -> Array:
    """Mean noise of gyro and accelerometer (n, 6) at the IMU's samples, interval by interval, of
    a problem whose readings were corrected with the nominal constants; d as in ``Linear``."""
    t = problem.nodes.t[nominal.node]
    dt = np.maximum(np.diff(t), 1e-6)[:, None]
    C_bn = nominal.C[1:].transpose(0, 2, 1)
    gyro = np.einsum("kij,kj->ki", C_bn, d[1:, 6:9]) / dt
    accel = np.einsum("kij,kj->ki", C_bn, d[1:, 3:6]) / dt
    at = np.clip(np.searchsorted(t, problem.recording.imu.t, side="right") - 1, 0, len(t) - 2)
    return np.hstack([gyro, accel])[at]

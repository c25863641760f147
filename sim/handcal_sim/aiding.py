"""What the other sensors read: heading, magnetometer, thermometer, poses, a trusted IMU."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim.companions import Heading, Magnetometer, Pose, Reference
from handcal_sim.motion import Motion, euler_matrix, evaluate, into, out_of
from handcal_sim.phone import HeadingErrors
from handcal_sim.profiles import Array
from handcal_sim.sensors import Earth, truth_at


def wrapped(angle: Array) -> Array:
    """The same angle in (-pi, pi]."""
    return math.pi - np.mod(math.pi - angle, 2.0 * math.pi)


def yaw(C_nb: Array) -> Array:
    """Heading of body x, counter-clockwise from east, rad."""
    angle: Array = np.arctan2(C_nb[..., 1, 0], C_nb[..., 0, 0])
    return angle


def heading_error(
    errors: HeadingErrors, heading: Array, t: Array, rng: np.random.Generator
) -> Array:
    """Errors (n,) of heading but for hard iron and white noise; heading: the true one, rad."""
    random = rng.standard_normal(len(t))
    stray = rng.random(len(t)) < errors.outliers
    anywhere = rng.uniform(-math.pi, math.pi, len(t))
    error = (
        errors.offset
        + errors.soft_iron[0] * np.sin(2.0 * heading)
        + errors.soft_iron[1] * np.cos(2.0 * heading)
        + errors.drift * t
        + _gauss_markov(errors.correlated, errors.correlated_tau_s, t, random)
    )
    return np.where(stray, anywhere, error)


def _gauss_markov(sigma: float, tau: float, t: Array, random: Array) -> Array:
    """Stationary noise of rms sigma, from standard normal numbers (n,)."""
    decay = np.exp(-np.diff(t) / tau)
    fresh = np.concatenate([[1.0], np.sqrt(1.0 - decay**2)]) * random
    state, values = 0.0, np.empty(len(t))
    for k, (keep, new) in enumerate(zip([0.0, *decay.tolist()], fresh.tolist(), strict=True)):
        values[k] = state = keep * state + new
    return sigma * values


def read_heading(
    sensor: Heading, errors: HeadingErrors, motion: Motion, t: Array, rng: np.random.Generator
) -> Array:
    """Yaw of body x (n, 1), rad in (-pi, pi]."""
    true = yaw(evaluate(motion, t - errors.delay_s).C_nb)
    iron = errors.hard_iron[0] * np.sin(true) + errors.hard_iron[1] * np.cos(true)
    white = sensor.sigma * rng.standard_normal(len(t))
    if sensor.passing is not None:
        iron = iron + sensor.passing(t - errors.delay_s)[:, 0]
    return wrapped(true + heading_error(errors, true, t, rng) + iron + white)[:, None]


def read_mag(
    sensor: Magnetometer,
    errors: HeadingErrors | None,
    motion: Motion,
    arm: Array,
    t: Array,
    rng: np.random.Generator,
) -> Array:
    """The field in body axes (n, 3), tesla, at a sensor at ``arm`` (3,) from the held point. Errors
    of heading turn the field it feels about up."""
    delay = 0.0 if errors is None else errors.delay_s
    k = evaluate(motion, t - delay)
    C_nb, place = k.C_nb, k.position + out_of(k.C_nb, arm)
    noise = sensor.sigma * rng.standard_normal((len(t), 3))
    turned = np.full(len(t), sensor.declination)
    if errors is not None:
        turned += heading_error(errors, yaw(C_nb), t, rng)
    zero = np.zeros(len(t))
    # axes n turned about up to those of the field, whose horizontal part is y
    C_mn = euler_matrix(zero, zero, turned)
    G = _symmetric(sensor.gradient)
    G[2, 2] = -G[0, 0] - G[1, 1]
    earth = sensor.strength * np.array([0.0, math.cos(sensor.dip), -math.sin(sensor.dip)])
    field_m = earth + out_of(C_mn, place) @ G
    if sensor.passing is not None:
        field_m = field_m + out_of(C_mn, sensor.passing(t - delay))
    field_b = into(C_mn @ C_nb, field_m)
    iron = sensor.hard_iron + np.where(t[:, None] >= sensor.step_at_s, sensor.step, 0.0)
    return field_b + field_b @ _symmetric(sensor.soft_iron) + iron + noise


def _symmetric(upper: Array) -> Array:
    """The symmetric matrix of which this is the diagonal and what lies above."""
    matrix: Array = np.triu(upper) + np.triu(upper, 1).T
    return matrix


def read_pose(sensor: Pose, motion: Motion, t: Array, rng: np.random.Generator) -> Array:
    """Position in the pose's world, m, and quaternion x y z w of C_wm: (n, 7)."""
    k = evaluate(motion, t - sensor.delay_s)
    position = k.position @ sensor.C_wn.T + sensor.sigma_m * rng.standard_normal((len(t), 3))
    shake = euler_matrix(*(sensor.sigma_rad * rng.standard_normal((3, len(t)))))
    C_wm = sensor.C_wn @ k.C_nb @ sensor.C_bm @ shake
    position *= 1.0 + sensor.scale
    if sensor.position_walk or sensor.attitude_walk:
        clock = _by_way(k.position, t) if sensor.by_way else t
        off, turn = _walked(clock, rng), euler_matrix(*(sensor.attitude_walk * _walked(t, rng)).T)
        position = np.einsum("nij,nj->ni", turn, position) + sensor.position_walk * off
        C_wm = turn @ C_wm
    position = position + np.where(t[:, None] >= sensor.lost_at_s, sensor.jump, 0.0)
    return np.hstack([position, quaternion(C_wm)])


def _by_way(position: Array, t: Array) -> Array:
    """A clock (n,) that goes with the way made along position (n, 3), and ends with t, s."""
    way = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
    clock: Array = t[0] + (t[-1] - t[0]) * way / max(way[-1], 1e-9)
    return clock


def _walked(t: Array, rng: np.random.Generator) -> Array:
    """Three random walks of unit density (n, 3), from zero at time zero."""
    dt = np.diff(t, prepend=0.0).clip(min=0.0)
    steps: Array = np.sqrt(dt)[:, None] * rng.standard_normal((len(t), 3))
    return np.cumsum(steps, axis=0)


def read_reference(
    sensor: Reference, motion: Motion, earth: Earth, t: Array, rng: np.random.Generator
) -> Array:
    """Gyro and accelerometer of the trusted IMU in its own axes (n, 6); on a table, what the
    table believes."""
    at = truth_at(motion.commanded or motion, earth, np.zeros(3), t)
    root = math.sqrt(sensor.clocking.rate_hz)
    size = np.repeat([sensor.gyro_noise * root, sensor.accel_noise * root], 3)
    noise = size * rng.standard_normal((len(t), 6))
    return np.hstack([into(sensor.C_br, at.omega), into(sensor.C_br, at.f)]) + noise


def quaternion(C: Array) -> Array:
    """Unit quaternions x y z w with w >= 0 (n, 4) of rotation matrices (n, 3, 3).

    The largest component is taken from the diagonal, the others from it: no cancellation.
    """
    d = np.stack([C[:, 0, 0], C[:, 1, 1], C[:, 2, 2]], axis=1)
    trace = d.sum(axis=1, keepdims=True)
    outer = np.empty((len(C), 4, 4))
    outer[:, range(4), range(4)] = np.hstack([1.0 + 2.0 * d - trace, 1.0 + trace])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[:, i, j] = outer[:, j, i] = C[:, i, j] + C[:, j, i]
        outer[:, k, 3] = outer[:, 3, k] = C[:, j, i] - C[:, i, j]
    row = np.argmax(outer[:, range(4), range(4)], axis=1)
    q = outer[np.arange(len(C)), row]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    positive: Array = np.where(q[:, 3:] < 0.0, -q, q)
    return positive

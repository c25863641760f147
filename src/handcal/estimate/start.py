"""Where the filter begins: a navigation state, and how far each part of it can be trusted.

Levelling reads the accelerometer, whose bias is not known yet, so the start attitude and
the bias are correlated: forgetting that makes the filter inconsistent (a 60 mg bias tilts
the start by 3.4 degrees).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.compiled import so3
from handcal.estimate.prior_scales import LOG_SHARES, SCALES
from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array, Prior, Recording

# In the order of the states.
BIASES = tuple((sensor, axis) for sensor in ("gyro_bias", "accel_bias") for axis in "xyz")


def usual_biases() -> Array:
    """Prior sigmas (6,) of the biases of a device of which nothing is known, SI."""
    return np.repeat([GYRO_BIAS_PRIOR, ACCEL_BIAS_PRIOR], 3)


@dataclass(frozen=True)
class Start:
    """Prior of the navigation state and the biases at the first sample.

    p_n, v_n (3,), C_nb (3, 3): the state with zero biases. force (3,) m/s^2: mean
    accelerometer reading that levelled C_nb, or None where the attitude comes from
    elsewhere. Sigmas: position m, velocity m/s, tilt and yaw rad (tilt beyond what the
    bias explains). bias_mean, bias_sigma (6,): of gyro and accelerometer, rad/s and m/s^2.
    """

    p_n: Array
    v_n: Array
    C_nb: Array
    force: Array | None
    position_sigma: float = 1.0
    velocity_sigma: float = 0.1
    tilt_sigma: float = math.radians(1.0)
    yaw_sigma: float = math.radians(100.0)
    bias_mean: Array = field(default_factory=lambda: np.zeros(6))
    bias_sigma: Array = field(default_factory=usual_biases)

    def attitude(self, accel_bias: Array) -> Array:
        """C_nb (3, 3) re-levelled as if the accelerometer had this bias (3,)."""
        if self.force is None:
            return self.C_nb
        return levelled(self.force - accel_bias, float(so3.yaw_of(self.C_nb)))

    def prior(self, p: Array, v: Array, C: Array, bg: Array, ba: Array) -> tuple[Array, Array]:
        """Mean (15,) and covariance (15, 15) of the error of a nominal start (true minus it)."""
        mean = np.zeros(15)
        mean[0:3], mean[3:6] = self.p_n - p, self.v_n - v
        mean[9:15] = self.bias_mean - np.r_[bg, ba]
        # (where the nominal heading has gone far from the first guess of it, which hardly counts,
        # a bias tilts the other axis of n)
        D = self.attitude(ba) @ C.T
        away = math.atan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1])
        back = so3.matrix_exp(np.array([0.0, 0.0, -away]))
        A = back @ self._tilt_by_bias(ba)
        mean[6:9] = so3.matrix_log(back @ D) + A @ mean[12:15]
        mean[8] += away
        own = np.repeat([self.position_sigma, self.velocity_sigma, self.tilt_sigma], 3)
        P = np.diag(np.r_[own, self.bias_sigma] ** 2)
        P[8, 8] = self.yaw_sigma**2
        P_ba = P[12:15, 12:15]
        P[6:9, 6:9] += A @ P_ba @ A.T
        P[6:9, 12:15] = A @ P_ba
        P[12:15, 6:9] = P[6:9, 12:15].T
        return mean, P

    def _tilt_by_bias(self, ba: Array) -> Array:
        """Derivative (3, 3) of the levelled attitude by the accelerometer bias, rad/(m/s^2)."""
        if self.force is None:
            return np.zeros((3, 3))
        step, yaw = 1e-4, float(so3.yaw_of(self.C_nb))
        D = np.empty((3, 3, 3))
        for i, e in enumerate(step * np.eye(3)):
            more, less = (levelled(self.force - b, yaw) for b in (ba + e, ba - e))
            D[i] = more @ less.T
        return np.asarray(so3.matrix_log(D).T / (2 * step))


def with_known_biases(start: Start, before: Prior | None) -> Start:
    """The start with what is known of the biases before, each for itself."""
    if before is None:
        return start
    mean, sigma = start.bias_mean.copy(), start.bias_sigma.copy()
    for i, name in enumerate(BIASES):
        if name in before.names:
            at = before.names.index(name)
            mean[i], sigma[i] = before.mean[at], math.sqrt(before.covariance[at, at])
    return replace(start, bias_mean=mean, bias_sigma=sigma)


def with_wide_gyro_bias(start: Start, bias: Array) -> Start:
    """The start with the scale of the prior's mixture (``prior_scales``) at which this bias (3,) of
    the gyro, rad/s, is likeliest; where the bias was known before, it stays as it is."""
    usual, sigma = usual_biases(), start.bias_sigma.copy()
    if np.array_equal(sigma[:3], usual[:3]):
        squares = float(((bias / usual[:3]) ** 2).sum())
        shares = LOG_SHARES - 3.0 * np.log(SCALES) - 0.5 * squares / SCALES**2
        sigma[:3] *= SCALES[int(np.argmax(shares))]
    return replace(start, bias_sigma=sigma)


def levelled(force: Array, yaw: float) -> Array:
    """C_nb (3, 3) with the specific force (3,) upwards and body x at this heading (rad)."""
    up = force / math.sqrt(force @ force)
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.99 else np.array([0.0, 0.0, 1.0])
    x = x - up * (up @ x)
    x /= math.sqrt(x @ x)
    # (numpy's cross product takes longer than all else here)
    (a, b, c), (d, e, f) = up, x
    C = np.array([x, [b * f - c * e, c * d - a * f, a * e - b * d], up])
    turn = so3.matrix_exp(np.array([0.0, 0.0, yaw - float(so3.yaw_of(C))]))
    return np.asarray(turn @ C)


def from_rest(recording: Recording, yaw: float, yaw_sigma: float, rests: Array) -> Start:
    """Level on the mean force of the first second, more trusted if the device rests there."""
    imu = recording.imu
    at_rest = len(rests) > 0 and rests[0, 0] <= imu.t[0] + 0.2 and rests[0, 1] > imu.t[0] + 0.8
    span = min(rests[0, 1] - imu.t[0], 1.0) if at_rest else 0.5
    window = imu.t <= imu.t[0] + span
    force = imu.accel[window].mean(axis=0)
    return Start(
        np.zeros(3),
        np.zeros(3),
        levelled(force, yaw),
        force,
        velocity_sigma=0.05 if at_rest else 1.0,
        tilt_sigma=math.radians(2.0 if at_rest else 20.0),
        yaw_sigma=yaw_sigma,
    )


def from_pose(t: Array, z: Array) -> Start:
    """Start at the first measured pose; z (k, 7) as the pose observation aligned it."""
    k = int(np.searchsorted(t, t[0] + 0.25)) or 1
    velocity = (z[k, :3] - z[0, :3]) / (t[k] - t[0])
    return Start(
        z[0, :3].copy(),
        velocity,
        so3.matrix_of(z[0, 3:7]),
        None,
        position_sigma=1.0,
        velocity_sigma=1.0,
        tilt_sigma=math.radians(10.0),
        yaw_sigma=math.radians(30.0),
    )

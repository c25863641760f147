"""Rate and force known from outside: a turntable, or a second, trusted IMU on the same body.

The axes of the reference are first turned into those of the IMU (turns and forces seen by
both sensors), then what remains is estimated: ``theta`` is that rotation vector (3,), and how late
the reference is, s: of two sensors, stamps differ by some hundredths of a millisecond, which
a shake shows; without it, a clock that runs fast by a millionth would be named for that.
The reference has biases too, and they are unknown: what is compared are differences of biases.
Rests say more of them (``_reference_bias``); what they leave is in ``theta`` (6 more numbers), in
units of what is left.
What ``z`` holds is in ``ReferenceRows``.
Without an arm the reference is taken to sit where the IMU sits.

Two IMUs never sample at the same instant, mounts flex, and a shake has more bandwidth than
the sampling resolves; all of that makes the readings differ in proportion to the motion.
So the errors grow with the turning rate: Markov states that forget at once. Those of the
force have a size for each axis, because an angular acceleration that the sampling missed
acts across a lever arm, never along it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import njit, residual_function
from handcal.effects._derivative import quiet_derivative
from handcal.effects._reference import ACCEL_LEFT, GYRO_LEFT, NOW, SLOPE, ReferenceRows
from handcal.observations import (
    Constant,
    Observation,
    Rows,
    Scene,
    _reference_bias,
    nearest,
    pseudo_times,
)
from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array, BoolArray, Level, Recording

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

FEWEST, MOST = 20, 12000
REST_RATE = 10.0
# An interval longer than this many usual ones is a gap; a row this near to one is left out,
# since the spline feels what is missing (by a factor of -0.27 a sample).
GAP, NEAR = 1.6, 3
MEMORY_S = 1e-3
SLOWEST = 0.01
LEAST_TURN = 0.05
# How well the stamps of the two sensors belong together, s.
STAMPED = 3e-5
# The times that a clock might be off by, as a share of the time since the start.
CLOCK_REACH = 2e-4
# How crooked axes are (rad), and how far apart two sensors of one body (m): priors.
CROOKED, LONGEST_ARM = 0.01, 0.3
MOTION = ("reference_gyro_in_motion",) * 3 + tuple(f"reference_accel_in_motion_{a}" for a in "xyz")


@njit
def _rotation(x: float, y: float, z: float) -> Array:
    out = np.empty((3, 3))
    so3.exp(np.array((x, y, z)), out)
    return out


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:
    R = _rotation(theta[0], theta[1], theta[2])
    late = theta[3]
    for i in range(3):
        # taken off the measurement, so that r is in b, where a lever arm is given
        turn, force, at = 0.0, 0.0, ACCEL_LEFT
        for j in range(3):
            bias = 0.0
            for k in range(j + 1):
                bias += z[at] * theta[7 + k]
                at += 1
            turn += R[j, i] * (z[NOW + j] + late * z[SLOPE + j] - z[GYRO_LEFT] * theta[4 + j])
            force += R[j, i] * (z[NOW + 3 + j] + late * z[SLOPE + 3 + j] - bias)
        r[i] = turn - nav[15 + i]
        r[3 + i] = force - nav[18 + i]
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    for i in range(6):
        H[15 * i + 9 + i] = 1.0
    return 0


def _in_motion(nav: Any, error: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(6):
        r[i] -= error[i]
    return 0


class InMotion:
    """Errors (6,) in proportion to the turning rate, each new at every sample."""

    size = 6
    vectors = 0

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Phi and Q (n, 6, 6): forgets within a millisecond; as large as the rate is."""
        phi = np.exp(-dt / MEMORY_S)
        variance = self._variance(levels) * (rate**2 + SLOWEST**2)[:, None]
        return (
            phi[:, None, None] * np.eye(6),
            ((1.0 - phi**2)[:, None] * variance)[:, :, None] * np.eye(6),
        )

    def weighed(
        self,
        many: Sequence[Mapping[str, float]],
        dt: Array,
        rate: Array,
        by_Phi: Array,  # noqa: ARG002
        by_Q: Array,
    ) -> Array:
        """Q at each of these levels, every entry times what it weighs, summed (m,); no level
        changes Phi."""
        new = -np.expm1(-2.0 * dt / MEMORY_S) * (rate**2 + SLOWEST**2)
        along = new @ np.diagonal(by_Q, axis1=1, axis2=2)
        return np.array([along @ self._variance(levels) for levels in many])

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Variances at this rate."""
        return np.diag(self._variance(levels) * (rate**2 + SLOWEST**2))

    def _variance(self, levels: Mapping[str, float]) -> Array:
        return np.array([levels[n] ** 2 for n in MOTION])


def _sound(t: Array, valid: BoolArray) -> Array:
    """1 for samples with no gap, end or invalid one within NEAR samples, 0 for others."""
    gap = np.diff(t) > GAP * np.median(np.diff(t))
    bad = ~valid | np.r_[True, gap] | np.r_[gap, True]
    near = np.convolve(bad, np.ones(2 * NEAR + 1), mode="same") > 0.5
    return np.where(near, 0.0, 1.0)


def _at(t: Array, sound: Array, wanted: Array) -> BoolArray:
    """Whether the samples on both sides of the times wanted are sound."""
    return np.asarray(np.interp(wanted, t, sound, left=0.0, right=0.0) > 1.0 - 1e-9)


def axes_between(own: Array, known: Array) -> Array:
    """Rotation (3, 3) of the reference's axes into the IMU's, from readings (k, 6) of both.

    Changes alone count, which biases leave alone, and turns more than forces, which differ
    by the swing of a lever arm.
    """
    own, known = own - own.mean(axis=0), known - known.mean(axis=0)
    turn = max((own[:, :3] ** 2).mean(), (known[:, :3] ** 2).mean(), LEAST_TURN**2)
    weight = np.repeat([1.0, 0.1 * math.sqrt(turn / max((own[:, 3:] ** 2).mean(), 1.0))], 3)
    a, b = known * weight, own * weight
    B = b[:, :3].T @ a[:, :3] + b[:, 3:].T @ a[:, 3:]
    # what nothing shows stays as it is: the smallest rotation
    U, _, Vt = np.linalg.svd(B + 1e-6 * turn * len(a) * np.eye(3))
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _thinned(t: Array, recording: Recording, scene: Scene) -> Array:
    """Those of the times t that tell enough: all in motion, some of each rest, MOST at most."""
    resting = np.zeros(len(t), dtype=np.bool_)
    for a, b in scene.rests:
        resting |= (t >= a) & (t <= b)
    some = np.searchsorted(t, pseudo_times(recording, REST_RATE, scene.rests))
    keep = ~resting
    keep[some[some < len(t)]] = True
    t = t[keep]
    return t[:: 1 + len(t) // MOST]


@dataclass(frozen=True)
class Matched:
    """Both sensors side by side: t (n,) stamps, sound (n,) where neither is saturated or
    missing nearby; reference: its readings as functions of time, and R (3, 3), which takes its
    axes to the IMU's."""

    t: Array
    sound: BoolArray
    reference: CubicSpline
    R: Array

    def known(self, t: Array, derivative: int = 0) -> Array:
        """Rate and force (n, 6) of the reference, or derivatives of them, in the IMU's axes."""
        return self.turned(self.reference(t, derivative))

    def turned(self, value: Array) -> Array:
        """Of the reference's axes (n, 6) into the IMU's."""
        return np.hstack([value[:, :3] @ self.R.T, value[:, 3:] @ self.R.T])


def matched(recording: Recording, scene: Scene) -> Matched | None:
    """The reference brought to the IMU's axes; None where there is too little of it."""
    from scipy.interpolate import CubicSpline

    imu, reference = recording.imu, recording.streams.get("reference")
    if reference is None or len(reference.t) < FEWEST:
        return None
    # As often as the slower of the two reads, at stamps of the IMU: the reference's spline says
    # what is between its samples; straight lines between the IMU's would cut off a tremor.
    t = imu.t
    if float(np.median(np.diff(reference.t))) > 1.2 / recording.rate_hz:
        t = imu.t[np.unique(nearest(imu.t, reference.t))]
    everything = np.ones(len(reference.t), dtype=np.bool_)
    sound = _at(imu.t, _sound(imu.t, imu.valid), t)
    sound &= _at(reference.t, _sound(reference.t, everything), t)
    some = _thinned(t[sound], recording, scene)
    if len(some) < FEWEST:
        return None
    spline = CubicSpline(reference.t, reference.value)
    own = read_at(recording, some)
    R = axes_between(own, spline(some))
    for _ in range(2):
        R = _by_force(own[:, 3:], Matched(t, sound, spline, R), some) @ R
    return Matched(t, sound, spline, R)


def _by_force(force: Array, both: Matched, t: Array) -> Array:
    """The small rotation (3, 3) that is left between the reference's axes and those that the
    accelerometers define: x is body x, y lies in the body's x-y plane.

    A gyro's axes may stand as crooked as gyros do, and the rotation that fits the turns best is
    off by as much. Each axis' force is fitted by all three of the reference, a bias and an arm,
    with their priors; where the forces do not tell, the rotation is none.
    """
    known, alpha = both.known(t), both.known(t, 1)[:, :3]
    w = known[:, :3]
    prior = np.r_[np.full(3, CROOKED), 1.0, np.full(3, LONGEST_ARM)]
    A = np.zeros((3, 3))
    for i in range(3):
        swing = [np.cross(alpha, e)[:, i] + np.cross(w, np.cross(w, e))[:, i] for e in np.eye(3)]
        rows = np.column_stack([known[:, 3:], np.ones(len(t)), *swing])
        left = force[:, i] - known[:, 3 + i]
        found = np.zeros(7)
        for _ in range(2):
            sigma = max(float(np.std(left - rows @ found)), 1e-3)
            stacked = np.vstack([rows / sigma, np.diag(1.0 / prior)])
            found = np.linalg.lstsq(stacked, np.r_[left / sigma, np.zeros(7)], rcond=None)[0]
        A[i] = found[:3]
    return _rotation(-A[1, 2], A[0, 2], -A[0, 1])


def read_at(recording: Recording, t: Array) -> Array:
    """What the IMU reads (n, 6) at times t (n,), linear between its samples."""
    imu = recording.imu
    return np.stack([np.interp(t, imu.t, x) for x in (*imu.gyro.T, *imu.accel.T)], axis=1)


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    from scipy.interpolate import CubicSpline

    both = matched(recording, scene)
    if both is None:
        return None
    t = _thinned(both.t[both.sound], recording, scene)
    reach = CLOCK_REACH * (t - recording.imu.t[0])
    own, imu = recording.streams["reference"], recording.imu
    bias = _bias(both.turned(own.value), own.t, scene)
    # What a moment earlier or later was read is what is read now and the motion in between: of
    # noise, there is less at some moments than at others, and a clock would be set to those.
    slope = CubicSpline(own.t, quiet_derivative(own.t, own.value, own.t))
    motion = slope.antiderivative()
    beside = [np.clip(t + sign * reach, own.t[0], own.t[-1]) for sign in (-1.0, 1.0)]
    now = both.known(t) - bias.mean
    before, after = (now + both.turned(motion(at) - motion(t)) for at in beside)
    slope_before, slope_after = (both.turned(slope(at)) for at in beside)
    alpha = both.turned(slope(np.clip(imu.t, own.t[0], own.t[-1])))[:, :3]
    rows = ReferenceRows(
        now, both.turned(slope(t)), before, after, slope_before, slope_after, reach[:, None],
        np.full((len(t), 1), bias.gyro), np.tile(bias.accel[np.tril_indices(3)], (len(t), 1)),
    )  # fmt: skip
    return Rows(t, rows.joined(), alpha=alpha)


def _bias(value: Array, t: Array, scene: Scene) -> _reference_bias.Bias:
    """What is known of the biases of a reference that reads these (n, 6) at times t (n,)."""
    if scene.reference_exact:
        return _reference_bias.NONE
    earth_rate = float(np.linalg.norm(scene.omega_ie_n))
    return _reference_bias.of_rests(t, value, scene.rests, scene.gravity, earth_rate)


def _guess(z: Array) -> Mapping[str, float]:
    """Levels that the reference itself shows: its white noise, and as much of the IMU."""
    out, read = {}, z[:, NOW:SLOPE]
    for name, x in (("reference_gyro_noise", read[:, :3]), ("reference_accel_noise", read[:, 3:])):
        least, most = next((lv.lower, lv.upper) for lv in LEVELS if lv.name == name)
        out[name] = min(max(math.sqrt(2.0 * _white(x)), 2.0 * least), 0.5 * most)
    return out


def _white(x: Array) -> float:
    """Variance of the white noise of readings x (n, 3), where least else is quick."""
    return float(np.quantile(_quick(x), 0.3))


def _quick(x: Array) -> Array:
    """Variance of what is quick in readings x (n, 3), noise and tremor, of each short while."""
    power = (np.diff(x, n=4, axis=0) ** 2).mean(axis=1) / 70.0
    width = max(1, min(30, len(power)))
    return np.asarray(power[: len(power) // width * width].reshape(-1, width).mean(axis=1))


def _ours(z: Array, read: Array) -> Array:
    """Share (6,) of the noise that is not the reference's: a tremor is in both, and not in their
    difference."""
    known, out = z[:, NOW:SLOPE], np.zeros(6)
    for s in (slice(0, 3), slice(3, 6)):
        apart = _quick(read[:, s] - known[:, s])
        own = 0.5 * (_quick(read[:, s]) - _quick(known[:, s]) + apart)
        if np.median(apart) > 0.0:
            out[s] = np.clip(np.median(own) / np.median(apart), 0.0, 1.0)
    return out


def _variance(levels: Mapping[str, float]) -> Array:
    gyro, accel = levels["reference_gyro_noise"], levels["reference_accel_noise"]
    return np.repeat([gyro**2, accel**2], 3)


def _constants(scene: Scene) -> tuple[Constant, ...]:  # noqa: ARG001
    axes = (Constant(f"reference_{a}", "rad", 0.1) for a in "xyz")
    gyro = (Constant(f"reference_gyro_bias_{a}", "rad/s", GYRO_BIAS_PRIOR) for a in "xyz")
    accel = (Constant(f"reference_accel_bias_{i}", "m/s^2", ACCEL_BIAS_PRIOR) for i in (1, 2, 3))
    return (*axes, Constant("reference_late", "s", STAMPED), *gyro, *accel)


LEVELS = (
    Level("reference_gyro_noise", "rad/s", 0.003, 1e-6, 0.3),
    Level("reference_accel_noise", "m/s^2", 0.03, 1e-5, 3.0),
    Level("reference_gyro_in_motion", "1", 2e-3, 1e-6, 0.3),
    *(Level(f"reference_accel_in_motion_{a}", "m/s", 5e-2, 1e-6, 3.0) for a in "xyz"),
)

OBSERVATION = Observation(
    kind="known_input",
    navigates=False,
    title="known input",
    dim=6,
    channels=("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"),
    unit="rad/s, m/s^2",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=LEVELS,
    variance=_variance,
    constants=_constants,
    markov=InMotion(),
    markov_residual=residual_function(_in_motion),
    guess=_guess,
    ours=_ours,
)

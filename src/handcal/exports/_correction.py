"""What is taken off a reading, as far as matrices can say it.

It is found by probing, not effect by effect: an effect whose error is linear in the readings of one
moment comes out as a matrix, effects of your own included; all others do not. That the matrices do
what ``handcal apply`` does is checked each time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.device import apply as device
from handcal.device.apply import Learnt
from handcal.effects import Effect, catalogue
from handcal.signals import probe
from handcal.types import Array, HandcalError, Imu, Recording

# What rounding leaves of an error that is linear, as a part of it, and of a corrected reading
# (of the largest one).
LINEAR, EQUAL = 1e-9, 1e-10


@dataclass(frozen=True)
class Correction:
    """How readings are corrected, axes of the recording, SI:

    force = accel (read_a - accel_bias), rate = gyro (read_w - gyro_bias - g_sensitivity force).

    gyro_bias, accel_bias (3,): what is read too much; gyro, accel (3, 3), the identity for a
    sensor without errors; g_sensitivity (3, 3), (rad/s)/(m/s^2). A misalignment is part of the
    matrix of its sensor: body axes are those of the recording, as all of handcal has them
    (accelerometer x is body x, accelerometer y in the body x-y plane).
    """

    gyro_bias: Array
    accel_bias: Array
    gyro: Array
    accel: Array
    g_sensitivity: Array

    def applied(self, read: Array) -> Array:
        """Corrected readings (n, 6), gyro first, of readings (n, 6)."""
        force = (read[:, 3:] - self.accel_bias) @ self.accel.T
        rate = (read[:, :3] - self.gyro_bias - force @ self.g_sensitivity.T) @ self.gyro.T
        return np.hstack([rate, force])

    @property
    def numbers(self) -> Array:
        """All of it, (33,)."""
        parts = (self.gyro_bias, self.accel_bias, self.gyro, self.accel, self.g_sensitivity)
        return np.concatenate([np.ravel(p) for p in parts])


NOTHING = Correction(np.zeros(3), np.zeros(3), np.eye(3), np.eye(3), np.zeros((3, 3)))


def of_error(error: Array, bias: Array) -> Correction:
    """The correction where ``error @ truth + bias`` is read too much; (6, 6) and (6,)."""
    blocks = (np.eye(3) + error[k : k + 3, k : k + 3] for k in (0, 3))
    gyro, accel = (np.linalg.inv(block).astype(np.float64) for block in blocks)
    return Correction(bias[:3].copy(), bias[3:].copy(), gyro, accel, error[:3, 3:].copy())


def as_matrix(effect: Effect, values: Array) -> tuple[Array, Array] | None:
    """Of an effect that adds ``E @ truth + c`` to the readings: E (6, 6), c (6,); None if it does
    something else, or adds to the accelerometer's readings what goes with the rate."""
    if effect.imu_error is None or effect.world or effect.undo or effect.of_one_day:
        return None
    truth = probe()
    signals = np.hstack([truth.gyro, truth.accel, np.ones((len(truth.t), 1))])
    error = effect.imu_error(values, truth)
    found: Array = np.linalg.lstsq(signals, error, rcond=None)[0].T.astype(np.float64)
    size = float(np.abs(error).max(initial=0.0))
    if not np.abs(error - signals @ found.T).max(initial=0.0) <= LINEAR * size:
        return None
    found[np.abs(found) <= LINEAR * np.abs(found).max(initial=0.0)] = 0.0
    return None if found[3:, :3].any() else (found[:, :6], found[:, 6])


def together(parts: Sequence[tuple[Array, Array]], bias: Array) -> Correction:
    """The correction of several effects, each E (6, 6) and c (6,), and a bias (6,)."""
    error, constant = np.zeros((6, 6)), bias.astype(np.float64)
    for E, c in parts:
        error, constant = error + E, constant + c
    return of_error(error, constant)


def check(correction: Correction, values: Mapping[str, Array], bias: Array) -> None:
    """Errors: HandcalError where the correction is not what ``handcal apply`` does."""
    truth = probe()
    imu = Imu(truth.t, truth.gyro, truth.accel, np.ones(len(truth.t), dtype=bool))
    done = corrected(Recording("probe", imu, {}), values, bias)
    read = np.hstack([imu.gyro, imu.accel])
    apart = np.abs(correction.applied(read) - done).max()
    if not apart <= EQUAL * np.abs(read).max():
        raise HandcalError(
            f"As matrices, {', '.join(values)} would not correct readings as `handcal apply` does "
            f"(by {apart:.1e}); use `handcal apply`."
        )


def corrected(recording: Recording, values: Mapping[str, Array], bias: Array) -> Array:
    """Readings (n, 6) as ``handcal apply --biases`` corrects them."""
    learnt = Learnt("", {i: values[i] for i in catalogue() if i in values}, (("", bias),), ())
    imu = device.apply(recording, learnt, biases=True).recording.imu
    return np.hstack([imu.gyro, imu.accel])

"""Gyro bandwidth: a filter inside the gyro smooths and delays what it reports."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from handcal.compiled.jit import njit
from handcal.effects import Effect, Known, Param, Signals
from handcal.effects._derivative import derivative, quiet_derivative, sound
from handcal.types import Array, Recording


@njit
def _low_pass(t: Array, x: Array, tau: float) -> Array:
    """First-order low pass, from zero, of x (n, 3), linear between its times t (n,).

    (From the first value its noise would last for several tau.)
    """
    y = np.zeros_like(x)
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        decay = math.exp(-dt / tau)
        share = -math.expm1(-dt / tau) * tau / dt
        for i in range(x.shape[1]):
            y[k, i] = decay * y[k - 1, i] + (1.0 - share) * x[k, i] + (share - decay) * x[k - 1, i]
    return y


def imu_error(tau: Array, signals: Signals) -> Array:
    """What the filter holds back, ``-tau`` times the low-passed derivative; result (n, 6).

    A negative tau, which no gyro has, is the same filter backwards in time: the series
    ``-tau omega' + tau^2 omega'' - ...`` goes on smoothly through zero.
    """
    out = np.zeros((len(signals.t), 6))
    if tau[0] == 0.0:
        return out
    t, rise = signals.t, _rise(signals)
    if tau[0] > 0.0:
        out[:, :3] = -tau[0] * _low_pass(t, rise, tau[0])
    else:
        back = _low_pass(np.ascontiguousarray(-t[::-1]), np.ascontiguousarray(rise[::-1]), -tau[0])
        out[:, :3] = -tau[0] * back[::-1]
    return out


def imu_inverse(tau: Array, readings: Signals) -> Array:
    """The truth: the reading and tau times its derivative; result (n, 6)."""
    return np.hstack([readings.gyro + tau[0] * _rise(readings), readings.accel])


def _rise(signals: Signals) -> Array:
    """Derivative (n, 3) of the gyro's own rate; beside a reference, which tells the angular
    acceleration, without its noise: but not the reference's, which has the noise of that in it
    which the gyro is compared with."""
    t, gyro = signals.t, signals.gyro
    return derivative(t, gyro) if signals.alpha is None else quiet_derivative(t, gyro, t)


def conceal(tau: Array, recording: Recording, known: Known) -> Recording:
    """The rate itself, low-passed, instead of its derivative."""
    imu, t, rate = recording.imu, known.signals.t, known.signals.gyro
    if tau[0] == 0.0:
        return recording
    slow = rate[0] + _low_pass(t, np.ascontiguousarray(rate - rate[0]), tau[0])
    return replace(recording, imu=replace(imu, gyro=imu.gyro + (slow - rate)))


EFFECT = Effect(
    id="gyro_bandwidth",
    title="Gyro bandwidth",
    parameters=(Param("tau", "s", 0.02, positive=True),),
    story="A filter inside the gyro smooths fast turns and reports them late.",
    source="first-order low pass, as in data sheets of digital gyros",
    motion="Brisk turns, to and fro.",
    validated="the simulator's injection",
    imu_error=imu_error,
    imu_inverse=imu_inverse,
    conceal=conceal,
    sound=sound,
    akin=("accel_delay", "heading_delay"),
)

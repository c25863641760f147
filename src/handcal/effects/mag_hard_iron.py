"""Hard iron: magnetised parts of the device add a field that turns with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from handcal._jit import residual_function
from handcal.effects import Effect, Param
from handcal.types import Array, InputError, Recording

PRIOR = 1e-4
# How far readings stray from the sphere, tesla: rooms bend the field.
STRAY = 3e-6
GUESS_RATE = 10.0


def guess(recording: Recording) -> Array:
    """A first value (3,), tesla: ``sphere``'s centre."""
    return sphere(recording)[0]


def sphere(recording: Recording) -> tuple[Array, Array]:
    """Centre (3,) of the sphere on which the readings lie and how well it is known (3,), tesla.

    An iron may be stronger than the Earth's field, and before it is known nobody knows where
    north is: so this is where a fit begins. Where the motion shows only part of the sphere, the
    prior decides. Linear least squares in the centre c: |m|^2 = 2 m.c + (R^2 - |c|^2). As
    whatever bends the field lasts, many readings make the sigmas no smaller than the readings'
    own distance from the sphere.

    Raises InputError without a magnetometer.
    """
    mag = recording.streams.get("mag")
    if mag is None or len(mag.t) < 2:
        raise InputError("The recording has no magnetometer, so no hard iron can be guessed.")
    step = max(1, round((len(mag.t) - 1) / (mag.t[-1] - mag.t[0]) / GUESS_RATE))
    m = mag.value[::step] / PRIOR
    centre = np.zeros(3)
    for _ in range(5):
        # |m - c| strays by STRAY, |m|^2 - 2 m.c by 2 R times as much
        radius = float(np.sqrt(((m - centre) ** 2).sum(axis=1).mean()))
        weight = 1.0 / (2.0 * radius * STRAY / PRIOR)
        rows = weight * np.c_[2.0 * m, np.ones(len(m))]
        A = np.vstack([rows, np.eye(3, 4)])
        b = np.r_[weight * (m**2).sum(axis=1), np.zeros(3)]
        solution = np.linalg.lstsq(A, b, rcond=None)[0]
        centre = solution[:3]
    stray = max(1.0, float(np.sqrt(((rows @ solution - b[:-3]) ** 2).mean())))
    inverse = solve_triangular(np.linalg.qr(A, mode="r"), np.eye(4))
    alone = PRIOR * np.linalg.norm(inverse[:3], axis=1)
    sigma = np.minimum(stray * np.hypot(alone, STRAY), PRIOR)
    return np.asarray(PRIOR * centre), np.asarray(sigma)


def cleaned(recording: Recording, iron: Array) -> Recording:
    """The recording with this iron (3,) taken off its magnetometer's readings."""
    mag = recording.streams["mag"]
    streams = {**recording.streams, "mag": replace(mag, value=mag.value - iron)}
    return replace(recording, streams=streams)


def _magnetometer(nav: Any, iron: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] -= iron[i]
    return 0


EFFECT = Effect(
    id="mag_hard_iron",
    title="Magnetometer hard iron",
    parameters=tuple(Param(axis, "tesla", PRIOR) for axis in "xyz"),
    story="Magnetised parts near the sensor add a field of their own, which turns with the device.",
    source="contract of this project; Gebre-Egziabher et al., J. Aerospace Eng. 19(2), 2006",
    motion="A full turn about at least two axes.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    observation_error={"magnetometer": residual_function(_magnetometer)},
    conceal=lambda iron, recording, _: cleaned(recording, -iron),
    undo=lambda iron, recording: cleaned(recording, iron),
    always=True,
)

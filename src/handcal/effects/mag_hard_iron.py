"""Hard iron: magnetised parts of the device add a field that turns with it."""

from __future__ import annotations

import math
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
# Where z of a magnetometer holds the iron (3,) that is already taken off the field in it.
TAKEN_OFF = 4


def guess(recording: Recording) -> Array:
    """A first value (3,), tesla: ``sphere``'s centre."""
    return sphere(recording)[0]


def sphere(recording: Recording) -> tuple[Array, Array]:
    """Centre (3,) of the sphere on which the readings lie and how well it is known (3,), tesla.

    Near its prior the effect is far from linear about zero (the iron is stronger than the
    Earth's field), so this is taken off the readings and only the rest is filtered. Where the
    motion shows only part of the sphere, the prior decides. Linear least squares in the centre
    c: |m|^2 = 2 m.c + (R^2 - |c|^2). The length of the field says nothing of the heading, so
    the sigmas may serve as prior of an estimate from headings; as whatever bends the field
    lasts, many readings make them no smaller than the readings' own distance from the sphere.

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


def _magnetometer(nav: Any, iron: Any, z: Any, out: Any) -> int:
    x = z[0] - (iron[0] - z[TAKEN_OFF])
    y = z[1] - (iron[1] - z[TAKEN_OFF + 1])
    w = z[2] - (iron[2] - z[TAKEN_OFF + 2])
    east = nav[6] * z[0] + nav[7] * z[1] + nav[8] * z[2]
    north = nav[9] * z[0] + nav[10] * z[1] + nav[11] * z[2]
    clean_east = nav[6] * x + nav[7] * y + nav[8] * w
    clean_north = nav[9] * x + nav[10] * y + nav[11] * w
    d = math.atan2(north, east) - math.atan2(clean_north, clean_east)
    out[0] += d - 2.0 * math.pi * math.floor(d / (2.0 * math.pi) + 0.5)
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
)

"""Magnetic gradient: the room's iron makes the field another at another place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.effects import PLACE, Effect, Known, Param
from handcal.effects._field import GRADIENT, gradient_of
from handcal.types import Array, InputError, Recording, Series

NAMES = ("xx", "yy", "xy", "xz", "yz")
# Beside what else the place is told: where the held point, or the marker, is on the device.
BESIDE = ("lever_arm",)


def matrix(parameters: Array) -> Array:
    """The change (3, 3) of the field by the place, tesla/m, symmetric and without trace: where the
    device is there is neither a current nor a pole."""
    xx, yy, xy, xz, yz = parameters
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])


def _magnetometer(nav: Any, G: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    m = gradient_of(nav, G, 0)
    for i in range(3):
        r[i] -= m[i]
    return 0


def _believed(z: Array, G: Array) -> Array:
    out = z.copy()
    out[:, GRADIENT : GRADIENT + len(NAMES)] = G
    return out


def _conceal(parameters: Array, recording: Recording, known: Known) -> Recording:
    """The field changes as the device goes about the held point, or as its pose says."""
    found, mag = known.result(BESIDE), recording.streams["mag"]
    if found.assume != "fixed-point" and "pose" not in recording.streams:
        raise InputError(
            "mag_gradient needs to know where the device is: a hand that holds one point, or a "
            f"stream pose; {recording.path} shows neither."
        )
    course = found.smoothed
    assert course is not None
    place = np.stack([np.interp(mag.t, course.t, x) for x in course.p_n.T], axis=1)
    more = np.einsum("nji,nj->ni", known.attitude(mag.t, BESIDE), place @ matrix(parameters))
    streams = {**recording.streams, "mag": Series(mag.t, mag.value + more)}
    return replace(recording, streams=streams)


EFFECT = Effect(
    id="mag_gradient",
    title="Magnetic gradient",
    parameters=tuple(Param(name, "tesla/m", 2e-5, most=3e-4) for name in NAMES),
    story="Iron in the room (a steel table, a radiator, a wall) bends the field, so that it is "
    "another at another place: as the device goes about the point that is held, the field changes.",
    source="Maxwell's equations away from currents and iron: a field free of curl and divergence, "
    "to the first order in the place; axes are those of the field at the origin: y to its "
    "horizontal part, z up",
    motion="Turns about two axes, the device at the end of an arm; or a walk about, with a pose.",
    validated="the simulator's injection",
    observation_error={"magnetometer": residual_function(_magnetometer)},
    believed={"magnetometer": _believed},
    needs=("mag", PLACE),
    conceal=_conceal,
    world=True,
)

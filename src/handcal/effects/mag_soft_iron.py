"""Soft iron: the device's own iron bends the field that it stands in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Known, Param
from handcal.effects import mag_hard_iron as hard
from handcal.effects._field import field_of
from handcal.types import Array, Recording

NAMES = ("xx", "yy", "zz", "xy", "xz", "yz")


def matrix(parameters: Array) -> Array:
    """The symmetric matrix (3, 3) of the parameters (6,)."""
    xx, yy, zz, xy, xz, yz = parameters
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _magnetometer(nav: Any, S: Any, z: Any, r: Any) -> int:
    m = field_of(nav, z)
    r[0] -= S[0] * m[0] + S[3] * m[1] + S[4] * m[2]
    r[1] -= S[3] * m[0] + S[1] * m[1] + S[5] * m[2]
    r[2] -= S[4] * m[0] + S[5] * m[1] + S[2] * m[2]
    return 0


def _conceal(parameters: Array, recording: Recording, known: Known) -> Recording:  # noqa: ARG001
    A = np.eye(3) + matrix(parameters)
    return _changed(recording, lambda field: field @ A.T)


def _undo(parameters: Array, recording: Recording) -> Recording:
    A = np.eye(3) + matrix(parameters)
    return _changed(recording, lambda field: np.linalg.solve(A, field.T).T.astype(np.float64))


def _changed(recording: Recording, change: Callable[[Array], Array]) -> Recording:
    """The recording with its field (n, 3) changed, but not its hard iron, which is no field that
    the device stands in."""
    iron, mag = hard.guess(recording), recording.streams["mag"]
    streams = {**recording.streams, "mag": replace(mag, value=change(mag.value - iron) + iron)}
    return replace(recording, streams=streams)


EFFECT = Effect(
    id="mag_soft_iron",
    title="Magnetometer soft iron",
    parameters=tuple(Param(name, "1", 0.1, most=0.3) for name in NAMES),
    story="Iron in the device draws the Earth's field to itself: the sensor reads more of it along "
    "one axis and less along another, and some of one axis on the next.",
    source="contract of this project; Gebre-Egziabher et al., J. Aerospace Eng. 19(2), 2006; the "
    "antisymmetric part turns the sensor's axes, the trace is the field's own strength",
    motion="Full turns about all three axes.",
    validated="the simulator's injection",
    common="some per cent to ten in phones; application notes of magnetometers",
    observation_error={"magnetometer": residual_function(_magnetometer)},
    conceal=_conceal,
    undo=_undo,
    # Of some tenths it would turn the field about, which a swing about one axis does not refute.
    tails=False,
    # A field that is as much stronger along all axes is a stronger field.
    together=np.asarray(np.kron(np.diag([1.0, 0.0]), np.eye(3) - 1.0 / 3.0)
                        + np.kron(np.diag([0.0, 1.0]), np.eye(3))),
)  # fmt: skip

"""A set of poses in words and attitudes that a person, or a drawing, can follow."""

from __future__ import annotations

import math

import numpy as np

from handcal.compiled import so3
from handcal.types import Array

FACES = ("right edge up", "top edge up", "screen up", "left edge up", "bottom edge up",
         "screen down")  # fmt: skip
EDGES = ("right", "top", "left", "bottom")
NEARLY = 0.5


def elevations(up: Array) -> Array:
    """How far each axis of the device points above the horizon, deg, for up (..., 3)."""
    return np.asarray(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))))


def instruction(up: Array) -> str:
    """How to lay a device with up (3,) in body axes: x to its right edge, y to its top, z out
    of its screen."""
    both = np.r_[up, -up]
    if both.max() > math.cos(math.radians(NEARLY)):
        return FACES[int(np.argmax(both))]
    tilt = math.degrees(math.acos(float(np.clip(up[2], -1.0, 1.0))))
    if abs(tilt - 90.0) < NEARLY:
        return f"upright, {_side(up)} up"
    face = "screen up" if tilt < 90.0 else "screen down"
    return f"{face}, {_side(up)} raised by {min(tilt, 180.0 - tilt):.0f}°"


def _side(up: Array) -> str:
    """Which side of the screen is the highest."""
    azimuth = math.degrees(math.atan2(up[1], up[0])) % 360.0
    nearest = round(azimuth / 90.0)
    beside = azimuth - 90.0 * nearest
    edge = EDGES[nearest % 4]
    if abs(beside) < NEARLY:
        return f"its {edge} edge"
    other = EDGES[(nearest + (1 if beside > 0.0 else -1)) % 4]
    if abs(abs(beside) - 45.0) < NEARLY:
        return f"its side between {edge} and {other}"
    return f"its side {abs(beside):.0f}° from {edge} to {other}"


def attitude_of(up: Array) -> Array:
    """C_nb (3, 3) of a pose: turned the shortest way from screen up, top to the north."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return np.eye(3) if up[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    return so3.matrix_exp(math.atan2(length, float(up[2])) / length * axis)

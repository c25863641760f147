"""Heading delay: the heading (or the magnetometer) tells of a slightly different moment."""

from __future__ import annotations

import math
from typing import Any

from handcal.compiled.jit import njit, residual_function
from handcal.effects import DELAY, Effect, Param
from handcal.effects._field import field_of


@njit
def _turned(nav: Any, x: float, y: float, z: float, delay: float) -> float:
    """Change of the yaw of body vector (x, y, z) over the last ``delay`` seconds."""
    wx, wy, wz = nav[15] * delay, nav[16] * delay, nav[17] * delay
    cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    bx = x - cx + 0.5 * (wy * cz - wz * cy)
    by = y - cy + 0.5 * (wz * cx - wx * cz)
    bz = z - cz + 0.5 * (wx * cy - wy * cx)
    now = math.atan2(nav[9] * x + nav[10] * y + nav[11] * z, nav[6] * x + nav[7] * y + nav[8] * z)
    before = math.atan2(
        nav[9] * bx + nav[10] * by + nav[11] * bz, nav[6] * bx + nav[7] * by + nav[8] * bz
    )
    d = now - before
    return d - 2.0 * math.pi * math.floor(d / (2.0 * math.pi) + 0.5)


def _heading(nav: Any, delay: Any, z: Any, out: Any) -> int:
    # nav is of the moment z[DELAY] before the reading's stamp
    out[0] += _turned(nav, 1.0, 0.0, 0.0, delay[0] - z[DELAY])
    return 0


def _magnetometer(nav: Any, delay: Any, z: Any, out: Any) -> int:
    # what is read is the field in the axes of a moment before
    late = delay[0] - z[DELAY]
    m = field_of(nav, z)
    wx, wy, wz = nav[15] * late, nav[16] * late, nav[17] * late
    cx, cy, cz = wy * m[2] - wz * m[1], wz * m[0] - wx * m[2], wx * m[1] - wy * m[0]
    out[0] -= cx + 0.5 * (wy * cz - wz * cy)
    out[1] -= cy + 0.5 * (wz * cx - wx * cz)
    out[2] -= cz + 0.5 * (wx * cy - wy * cx)
    return 0


EFFECT = Effect(
    id="heading_delay",
    title="Heading delay",
    parameters=(Param("delay", "s", 0.15),),
    story="The heading arrives late: while the device turns, it tells of a moment ago.",
    source="contract of this project; second order in the turn during the delay",
    motion="A turn and its reverse.",
    validated="the simulator's injection",
    observation_error={
        "heading": residual_function(_heading),
        "magnetometer": residual_function(_magnetometer),
    },
    delays=("heading", "magnetometer"),
)

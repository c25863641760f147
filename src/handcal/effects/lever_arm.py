"""Lever arm: the IMU does not sit at the point that is held, or at the marker."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param
from handcal.effects._position import placed
from handcal.effects._reference import SLOPE


def _position(nav: Any, r: Any, z: Any, out: Any) -> int:  # noqa: ARG001
    for i in range(3):
        out[i] += nav[6 + 3 * i] * r[0] + nav[7 + 3 * i] * r[1] + nav[8 + 3 * i] * r[2]
    return 0


def _velocity(nav: Any, r: Any, z: Any, out: Any) -> int:  # noqa: ARG001
    x = nav[16] * r[2] - nav[17] * r[1]
    y = nav[17] * r[0] - nav[15] * r[2]
    w = nav[15] * r[1] - nav[16] * r[0]
    for i in range(3):
        out[i] += nav[6 + 3 * i] * x + nav[7 + 3 * i] * y + nav[8 + 3 * i] * w
    return 0


def _force(nav: Any, r: Any, z: Any, out: Any) -> int:
    # what the reference lacks of alpha x r + omega x (omega x r); its rate's slope is alpha
    ax, ay, az = z[SLOPE], z[SLOPE + 1], z[SLOPE + 2]
    square = nav[15] * nav[15] + nav[16] * nav[16] + nav[17] * nav[17]
    along = nav[15] * r[0] + nav[16] * r[1] + nav[17] * r[2]
    out[3] += ay * r[2] - az * r[1] + nav[15] * along - square * r[0]
    out[4] += az * r[0] - ax * r[2] + nav[16] * along - square * r[1]
    out[5] += ax * r[1] - ay * r[0] + nav[17] * along - square * r[2]
    return 0


_AT_POINT = residual_function(_position)

EFFECT = Effect(
    id="lever_arm",
    title="Lever arm",
    parameters=(Param("x", "m", 0.1), Param("y", "m", 0.1), Param("z", "m", 0.1)),
    story="The sensor sits beside the point whose motion is known (where the hand turns the "
    "device, a marker, another sensor), and swings around it.",
    source="rigid-body kinematics; paper 003, equation 1",
    motion="Turns about at least two axes; the faster, the sharper.",
    validated="three turns simulated with 200 seeds; motion capture of a hand-held IMU",
    common="no chip sits at the point that a hand or a marker holds: some centimetres",
    observation_error={
        "fixed_position": _AT_POINT,
        "known_input": residual_function(_force),
        "pose": _AT_POINT,
        "zero_velocity": residual_function(_velocity),
    },
    world=True,
    conceal=placed,
)

"""Soft iron, as a compass shows it: an error that goes round twice as the device turns once."""

from __future__ import annotations

import math
from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param


def _heading(nav: Any, iron: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = 2.0 * math.atan2(nav[9], nav[6])
    r[0] -= iron[0] * math.sin(yaw) + iron[1] * math.cos(yaw)
    return 0


EFFECT = Effect(
    id="heading_soft_iron",
    title="Heading soft iron",
    parameters=(Param("sin", "rad", 0.15), Param("cos", "rad", 0.15)),
    story="Iron in the device bends the Earth's field: the compass errs the same way facing north "
    "and south, and the other way in between. Directions count from where the heading itself reads "
    "zero: a constant offset of it turns sin and cos, and no motion shows that.",
    source="contract of this project; coefficients D and E of a compass's deviation (NGA Pub. 226, "
    "Handbook of Magnetic Compass Adjustment)",
    motion="A full turn about the vertical, back and forth.",
    validated="the simulator's injection",
    common="headings of phones and boards come from magnetometers: 5 to 10 deg "
    "of iron where they were never calibrated",
    observation_error={"heading": residual_function(_heading)},
    instead="mag_soft_iron",
)

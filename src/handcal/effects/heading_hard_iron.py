"""Hard iron, as a compass shows it: an error that goes round once as the device does."""

from __future__ import annotations

import math
from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param


def _heading(nav: Any, iron: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = math.atan2(nav[9], nav[6])
    r[0] -= iron[0] * math.sin(yaw) + iron[1] * math.cos(yaw)
    return 0


# A magnetometer shows the field itself: its hard iron is mag_hard_iron.
EFFECT = Effect(
    id="heading_hard_iron",
    title="Heading hard iron",
    parameters=(Param("sin", "rad", 0.2), Param("cos", "rad", 0.2)),
    story="Magnetised parts of the device pull its compass aside, one way facing east and the "
    "other way facing west. Directions count from where the heading itself reads zero: a constant "
    "offset of it turns sin and cos, and no motion shows that.",
    source="contract of this project; coefficients B and C of a compass's deviation (NGA Pub. 226, "
    "Handbook of Magnetic Compass Adjustment)",
    motion="A full turn about the vertical, back and forth.",
    validated="the simulator's injection",
    common="headings of phones and boards come from magnetometers: 5 to 20 deg "
    "of iron where they were never calibrated",
    observation_error={"heading": residual_function(_heading)},
    instead="mag_hard_iron",
)

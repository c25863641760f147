"""Heading outliers: some readings are merely wrong."""

from __future__ import annotations

import math

from handcal.effects import Effect, Param

ANYWHERE = 1.0 / (2.0 * math.pi)
# Of a magnetometer: in a cube of 100 microtesla, tesla^-3.
IN_A_CUBE = 1e-4**-3

EFFECT = Effect(
    id="heading_outliers",
    title="Heading outliers",
    parameters=(Param("fraction", "1", 0.1, positive=True, most=1.0),),
    story="A share of the heading's readings have nothing to do with the heading: they point "
    "anywhere. Where a magnetometer is all that shows one, it is its readings that are wrong.",
    source="contract of this project; mixture of a normal and a uniform density (Hogg, Bovy & "
    "Lang, arXiv:1008.4686, section 3)",
    motion="Any motion.",
    validated="the simulator's injection",
    outliers={"heading": ANYWHERE, "magnetometer": IN_A_CUBE},
)

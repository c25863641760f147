"""Heading outliers: some readings are merely wrong."""

from __future__ import annotations

import math

from handcal.effects import Effect, Param

ANYWHERE = 1.0 / (2.0 * math.pi)

EFFECT = Effect(
    id="heading_outliers",
    title="Heading outliers",
    parameters=(Param("fraction", "1", 0.1, positive=True, most=1.0),),
    story="A share of the heading's readings have nothing to do with the heading: they point "
    "anywhere.",
    source="contract of this project; mixture of a normal and a uniform density (Hogg, Bovy & "
    "Lang, arXiv:1008.4686, section 3)",
    motion="Any motion.",
    validated="the simulator's injection",
    outliers={"heading": ANYWHERE, "magnetometer": ANYWHERE},
)

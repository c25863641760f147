"""Compass delay: the heading (or the magnetometer) tells of a slightly different moment."""

from __future__ import annotations

from handcal.effects import Effect, Param
from handcal.effects._delay import LATE

EFFECT = Effect(
    id="heading_delay",
    title="Compass delay",
    parameters=(Param("delay", "s", 0.15),),
    story="While the device turns, the heading or the magnetometer tells of another moment than "
    "the gyro: of one that has passed (a delay above zero), or of one that the gyro only tells of "
    "later (below).",
    source="contract of this project",
    motion="A turn and its reverse.",
    validated="the simulator's injection",
    common="fused headings and magnetometers lag by 20 to 200 ms",
    lateness={"heading": LATE, "magnetometer": LATE},
    delays=("heading", "magnetometer"),
)

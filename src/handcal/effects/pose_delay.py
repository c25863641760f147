"""Pose delay: the measured pose is that of a slightly different moment."""

from __future__ import annotations

from handcal.effects import Effect, Param
from handcal.effects._delay import LATE

EFFECT = Effect(
    id="pose_delay",
    title="Pose delay",
    parameters=(Param("delay", "s", 0.02),),
    story="The clocks of tracker and IMU do not agree: the pose comes late (positive) or early.",
    source="contract of this project",
    motion="Any brisk motion.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    common="cameras and their clocks lag by some milliseconds to tens of them",
    lateness={"pose": LATE},
    delays=("pose",),
)

"""Pose scale: the metre of what measured the pose is too long or too short."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param


def _pose(nav: Any, scale: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] -= scale[0] * nav[i]
    return 0


# A camera that has never felt gravity may take a metre for two thirds of one; where all positions
# are said to be one (-1), no motion is seen that could contradict it.
MOST = 0.5

EFFECT = Effect(
    id="pose_scale",
    title="Pose scale",
    parameters=(Param("scale", "1", 0.02, most=MOST),),
    story="The positions come from something that does not know how long a metre is, as a phone's "
    "camera that learnt it from the phone's own accelerometer: all ways are too long or too short "
    "by the same share.",
    source="contract of this project; the scale of monocular visual-inertial odometry: Kelly & "
    "Sukhatme, Int. J. Robotics Research 30(1), 2011",
    motion="Brisk movement through a room or at arm's length, so that ways show as accelerations.",
    validated="put in by `handcal conceal`",
    observation_error={"pose": residual_function(_pose)},
)

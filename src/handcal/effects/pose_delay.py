"""Pose delay: the measured pose is that of a slightly different moment."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import DELAY, Effect, Param
from handcal.effects._late import add_lateness


def _pose(nav: Any, delay: Any, z: Any, out: Any) -> int:
    # nav is of the moment z[DELAY] before the pose's stamp
    add_lateness(nav, delay[0] - z[DELAY], out)
    return 0


EFFECT = Effect(
    id="pose_delay",
    title="Pose delay",
    parameters=(Param("delay", "s", 0.02),),
    story="The clocks of tracker and IMU do not agree: the pose comes late or early.",
    source="contract of this project; first order in the delay",
    motion="Any brisk motion.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    observation_error={"pose": residual_function(_pose)},
    delays=("pose",),
)

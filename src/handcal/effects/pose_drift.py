"""Pose drift: the world of what measured the pose wanders, as that of a camera's odometry does."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param
from handcal.effects._walk import RandomWalk
from handcal.types import Level

POSITION, ATTITUDE = "pose_drift_position", "pose_drift_attitude"


def _pose(nav: Any, state: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    # a world that turns carries the place with it
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        r[i] -= state[i] + state[3 + j] * nav[k] - state[3 + k] * nav[j]
        r[3 + i] -= state[3 + i]
    return 0


EFFECT = Effect(
    id="pose_drift",
    title="Pose drift",
    parameters=(
        Param("position", "m/sqrt(s)", 0.005, positive=True),
        Param("attitude", "rad/sqrt(s)", 5e-4, positive=True),
    ),
    story="The pose is an estimate, not a measurement: each place and direction is reckoned from "
    "the one before, and its errors stay. Its world wanders away from where it was.",
    source="contract of this project; unobservable directions of visual-inertial odometry: "
    "Hesch et al., IEEE Trans. Robotics 30(1), 2014",
    motion="A recording long enough for the world to wander further than the pose scatters.",
    validated="put in by `handcal conceal`",
    observation_error={"pose": residual_function(_pose)},
    # the origin of the world and its attitude, both in n
    process=RandomWalk(POSITION, ATTITUDE, vectors=2),
    levels=(
        Level(POSITION, "m/sqrt(s)", 0.003, 1e-5, 0.1),
        Level(ATTITUDE, "rad/sqrt(s)", 3e-4, 1e-6, 0.02),
    ),
)

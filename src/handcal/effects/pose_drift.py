"""Pose drift: the world of what measured the pose wanders, as that of a camera's odometry does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal._jit import residual_function
from handcal.effects import Effect, Param
from handcal.types import Array, Level

POSITION, ATTITUDE = "pose_drift_position", "pose_drift_attitude"


class _WanderingWorld:
    """Random walks of the world's origin (3,) and of its attitude (3,), in n, from zero."""

    size, vectors = 6, 2

    def transition(
        self,
        levels: Mapping[str, float],
        dt: Array,
        rate: Array,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Phi (the identity) and Q, each (n, 6, 6)."""
        eye = np.eye(6)
        densities = np.repeat([levels[POSITION] ** 2, levels[ATTITUDE] ** 2], 3)
        return np.broadcast_to(eye, (len(dt), 6, 6)).copy(), dt[:, None, None] * densities * eye

    def start(self, levels: Mapping[str, float], rate: float) -> Array:  # noqa: ARG002
        """The world is where it was at the start, by definition."""
        return np.zeros((6, 6))


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
    process=_WanderingWorld(),
    levels=(
        Level(POSITION, "m/sqrt(s)", 0.003, 1e-5, 0.1),
        Level(ATTITUDE, "rad/sqrt(s)", 3e-4, 1e-6, 0.02),
    ),
)

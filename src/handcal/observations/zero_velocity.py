"""Zero velocity while the device rests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.observations import Observation, Rows, Scene, pseudo_times
from handcal.types import Array, Level, Recording


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] = z[i] - nav[3 + i]
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    for i in range(3):
        H[15 * i + 3 + i] = 1.0
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    t = pseudo_times(recording, scene.rate, scene.rests if scene.sway else None, scene.origin)
    return Rows(t, np.zeros((len(t), 3))) if len(t) else None


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["velocity_noise"] ** 2)


OBSERVATION = Observation(
    kind="zero_velocity",
    title="zero velocity at rest",
    dim=3,
    channels=("velocity_x", "velocity_y", "velocity_z"),
    unit="m/s",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(Level("velocity_noise", "m/s", 0.005, 1e-4, 0.3),),
    variance=_variance,
    isotropic=True,
)

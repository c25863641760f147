"""A measured heading (yaw of body x), from a camera, a compass or a simulator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import residual_function
from handcal.observations import Observation, Rows, Scene
from handcal.types import Array, Level, Recording, Series

# Contract: no heading within 15 degrees of body x vertical.
_SIN2_LIMIT = math.cos(math.radians(15.0)) ** 2


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    if nav[12] * nav[12] > _SIN2_LIMIT:
        return 1
    d = z[0] - math.atan2(nav[9], nav[6])
    r[0] = d - 2.0 * math.pi * math.floor(d / (2.0 * math.pi) + 0.5)
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    x, y, w = nav[6], nav[9], nav[12]
    horizontal = x * x + y * y
    H[6] = -x * w / horizontal
    H[7] = -y * w / horizontal
    H[8] = 1.0
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:  # noqa: ARG001
    series = recording.streams.get("heading")
    return None if series is None else Rows(series.t, series.value)


def _variance(levels: Mapping[str, float]) -> Array:
    return np.array([levels["heading_noise"] ** 2])


def _guess(z: Array) -> Mapping[str, float]:
    # neighbours share the true heading, so their differences are noise
    d = so3.wrap(np.diff(z[:, 0]))
    return {"heading_noise": float(np.clip(np.sqrt((d**2).mean() / 2), 1e-3, 2.0))}


def _moved(recording: Recording, series: Series, C_nb: Array, shift: Array) -> Series:  # noqa: ARG001
    return Series(series.t, so3.wrap(series.value + shift))


OBSERVATION = Observation(
    kind="heading",
    title="measured heading",
    dim=1,
    channels=("heading",),
    unit="rad",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(Level("heading_noise", "rad", 0.1, 1e-4, 2.0),),
    variance=_variance,
    guess=_guess,
    folds=True,
    moved=_moved,
)

"""Zero angular rate while the device rests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.observations import Observation, Rows, Scene, pseudo_times
from handcal.types import Array, Level, Recording


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        # at rest the gyro still turns with the Earth, whose rate in n is the rest of z
        earth = nav[6 + i] * z[3] + nav[9 + i] * z[4] + nav[12 + i] * z[5]
        r[i] = z[i] + earth - nav[15 + i]
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    imu = recording.imu
    t = pseudo_times(recording, scene.rate, scene.rests, scene.origin)
    if not len(t):
        return None
    # The filter compares z with the reading at its stamp. What matters is the mean over
    # the slot, which is as good as using every sample, so z takes the difference.
    first = np.searchsorted(imu.t, t)
    slot = 1 if scene.rate is None else max(1, round(recording.rate_hz / scene.rate))
    total = np.vstack([np.zeros(3), np.cumsum(imu.gyro, axis=0)])
    last = np.minimum(first + slot, len(imu.t))
    mean = (total[last] - total[first]) / (last - first)[:, None]
    earth = np.broadcast_to(scene.omega_ie_n, mean.shape)
    return Rows(t, np.hstack([imu.gyro[first] - mean, earth]))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["rest_rate_noise"] ** 2)


OBSERVATION = Observation(
    kind="zero_rate",
    title="zero rate at rest",
    dim=3,
    channels=("gyro_x", "gyro_y", "gyro_z"),
    unit="rad/s",
    residual=residual_function(_residual),
    rows=_rows,
    levels=(Level("rest_rate_noise", "rad/s", 0.003, 1e-5, 0.2),),
    variance=_variance,
)

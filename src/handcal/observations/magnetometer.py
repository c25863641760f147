"""Magnetic heading by tilt compensation inside the filter.

The field measured in b is levelled with the filter's own attitude, so the tilt's
uncertainty and its correlation with the heading are part of the update. Magnetic north
is +y of n. Indoors the field is bent by furniture and by the device itself: an error
that stays as long as the device does, and changes as it turns. That is a Markov state
whose clock is the angle turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal import so3
from handcal._jit import residual_function
from handcal.observations import Observation, Rows, Scene
from handcal.observations._turning import Turning
from handcal.types import Array, Level, Recording, Series

MAX_RATE = 10.0


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    east = nav[6] * z[0] + nav[7] * z[1] + nav[8] * z[2]
    north = nav[9] * z[0] + nav[10] * z[1] + nav[11] * z[2]
    up = nav[12] * z[0] + nav[13] * z[1] + nav[14] * z[2]
    horizontal = east * east + north * north
    # A dip above 85 degrees holds no heading.
    if horizontal < 0.0076 * (horizontal + up * up):
        return 1
    d = 0.5 * math.pi - math.atan2(north, east)
    r[0] = d - 2.0 * math.pi * math.floor(d / (2.0 * math.pi) + 0.5)
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    # Where the field is predicted (north, with the recording's own dip), not where this
    # reading puts it: its noise would turn up both in H and in the residual, and whatever
    # tilt explains that would be "seen".
    H[7] = -z[3]
    H[8] = 1.0
    return 0


def _bent(nav: Any, bend: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] += bend[0]
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:  # noqa: ARG001
    series = recording.streams.get("mag")
    if series is None or len(series.t) < 2:
        return None
    # Neighbouring readings share their disturbance; more of them would only feign certainty.
    step = max(1, round((len(series.t) - 1) / (series.t[-1] - series.t[0]) / MAX_RATE))
    field = series.value[::step]
    slope = np.full((len(field), 1), _slope(recording, series))
    return Rows(series.t[::step], np.hstack([field, slope]))


def _slope(recording: Recording, mag: Series) -> float:
    """Upward over horizontal component of the field: the median, taking the force as up."""
    imu = recording.imu
    up = np.stack([np.interp(mag.t, imu.t, imu.accel[:, i]) for i in range(3)], axis=1)
    size = np.linalg.norm(up, axis=1) * np.linalg.norm(mag.value, axis=1)
    sine = float(np.median((up * mag.value).sum(axis=1) / size))
    return sine / math.sqrt(max(1.0 - sine * sine, 0.01))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.array([levels["mag_heading_noise"] ** 2])


def _moved(recording: Recording, series: Series, C_nb: Array, shift: Array, own: Array) -> Series:  # noqa: ARG001
    """A heading too large is a field turned the other way about the vertical, but for the
    part that belongs to the device."""
    about = np.zeros((len(shift), 3))
    about[:, 2] = -shift[:, 0]
    level = np.einsum("kij,kj->ki", C_nb, series.value - own)
    turned = np.einsum("kij,kj->ki", so3.rotations(about), level)
    return Series(series.t, np.einsum("kji,kj->ki", C_nb, turned) + own)


OBSERVATION = Observation(
    kind="magnetometer",
    title="magnetic heading",
    dim=1,
    channels=("heading",),
    unit="rad",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(
        Level("mag_heading_noise", "rad", 0.01, 1e-4, 2.0),
        Level("mag_disturbance", "rad", 0.03, 1e-3, 0.5, above=0.7),
    ),
    variance=_variance,
    markov=Turning("mag_disturbance"),
    markov_residual=residual_function(_bent),
    moved=_moved,
)

"""Clock rate: the device's clock runs fast or slow against the true one."""

from __future__ import annotations

from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.earth import STANDARD_GRAVITY
from handcal.effects import ATTITUDE, TIME, Effect, Param, Signals
from handcal.effects._reference import (
    AFTER,
    BEFORE,
    NOW,
    REACH,
    SLOPE,
    SLOPE_AFTER,
    SLOPE_BEFORE,
)
from handcal.effects._stamps import stretched
from handcal.types import Array

MOST_PPM = 1e5


def imu_error(ppm: Array, signals: Signals) -> Array:
    """What is read beyond rate and acceleration by the device's clock; result (n, 6).

    A fast clock counts too many seconds, in which the device seems to turn more slowly by
    1e-6 ppm and to accelerate less by twice that. Gravity is known by the true clock. All that
    is so where motion is integrated; without an attitude, none is.
    """
    out = np.zeros((len(signals.t), 6))
    if signals.C_nb is not None:
        fast = 1e-6 * ppm[0]
        out[:, :3] = fast * signals.gyro
        out[:, 3:] = 2.0 * fast * (signals.accel - STANDARD_GRAVITY * signals.C_nb[:, 2, :])
    return out


def _pose(nav: Any, ppm: Any, z: Any, out: Any) -> int:  # noqa: ARG001
    # The pose's stamp is true time, by which the device's clock already shows more: the
    # pose is taken for one of an earlier moment, a delay that is negative and grows.
    out[0] -= 1e-6 * ppm[0] * z[TIME]
    return 0


def _reference(nav: Any, ppm: Any, z: Any, out: Any) -> int:  # noqa: ARG001
    # Beside a stamp of the reference's, the device shows what was a little earlier. What the
    # reference showed then is read off a polynomial through three moments, their slopes too.
    if z[REACH] == 0.0:
        return 0
    x = -1e-6 * ppm[0] * z[TIME] / z[REACH]
    for i in range(6):
        now, slope = z[NOW + i], z[REACH] * z[SLOPE + i]
        before, after = z[BEFORE + i] - now, z[AFTER + i] - now
        slope_before, slope_after = z[REACH] * z[SLOPE_BEFORE + i], z[REACH] * z[SLOPE_AFTER + i]
        even, odd = 0.5 * (after + before), 0.5 * (after - before) - slope
        slope_even = 0.5 * (slope_after + slope_before) - slope
        x4 = 0.25 * (slope_after - slope_before) - even
        x5 = 0.5 * (slope_even - 3.0 * odd)
        out[i] += x * (slope + x * (even - x4 + x * (odd - x5 + x * (x4 + x * x5))))
    return 0


EFFECT = Effect(
    id="clock_rate",
    title="Clock rate",
    parameters=(Param("ppm", "1e-6", 100.0, most=MOST_PPM),),
    story="The device's clock runs fast or slow, so its stamps drift away from the true time.",
    source="contract of this project; first order in the growing delay of a pose",
    motion="Brisk motion at the beginning and at the end of a long recording, with a pose or a "
    "reference.",
    validated="the simulator's injection",
    imu_error=imu_error,
    observation_error={"known_input": residual_function(_reference)},
    lateness={"pose": residual_function(_pose)},
    needs=(ATTITUDE,),
    conceal=lambda ppm, recording, _: stretched(recording, 1.0 + 1e-6 * float(ppm[0])),
    undo=lambda ppm, recording: stretched(recording, 1.0 / (1.0 + 1e-6 * float(ppm[0]))),
)

"""Which effects a laboratory method can estimate."""

from __future__ import annotations

from collections.abc import Sequence

from handcal.effects import ATTITUDE, Effect, select
from handcal.types import InputError


def chosen(ids: Sequence[str], temperature: bool) -> tuple[Effect, ...]:
    """The effects of these ids; biases are always estimated and may be named.

    temperature: whether it is known. Errors: InputError for one that is no constant error of
    the IMU's readings, or needs what is not known.
    """
    effects = select([i for i in ids if i not in ("gyro_bias", "accel_bias")])
    for e in effects:
        if e.imu_error is None or e.process is not None or e.moments is not None:
            raise InputError(f"{e.id} is no constant error of gyro or accelerometer.")
        if ATTITUDE in e.needs:
            raise InputError(
                f"{e.id} belongs to the place, not to the sensors: here it is taken as known "
                "(--gravity)."
            )
        if "temperature" in e.needs and not temperature:
            raise InputError(f"{e.id} needs the temperature, which these readings lack.")
    return effects

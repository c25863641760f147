"""What no laboratory method may believe: a dead axis, and a sensor that reads hardly any of what it
is known to feel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from handcal.recordings.inputs._health import check_fit
from handcal.types import HandcalError, Recording
from handcal.units import shown

# No sensor errs by so much of what it measures: the worst of the cheap ones, by a tenth.
NO_SENSOR = 0.3
# So much beyond noise is no scatter of a table or of temperature, and so much is no fit at all: a
# deg/s and 20 mg are several times the worst of cheap sensors; 6 deg/s and 50 mg, of their errors.
APART = {"gyro": 0.01, "accel": 0.2}
NO_FIT = {"gyro": 0.1, "accel": 0.5}
UNITS = {"gyro": "rad/s", "accel": "m/s^2"}
NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}


def refuse_dead(recording: Recording) -> None:
    """HandcalError where the recording is unfit for any calibration, and where an axis never moves
    by one bit while another of that sensor does: a number would come out of it, with hardly any
    noise."""
    check_fit(recording)
    for name, value in (("gyro", recording.imu.gyro), ("accel", recording.imu.accel)):
        still = np.ptp(value, axis=0) == 0.0
        if still.any() and not still.all():
            axes = " and ".join(np.array(list("xyz"))[still])
            raise HandcalError(
                f"{recording.path}: the {NAMES[name]}'s {axes} never moves by one bit while its "
                "other axes do: dead, so that nothing can be learned of it here."
            )


def refuse_incredible(found: Iterable[tuple[str, str, float]]) -> None:
    """HandcalError where a scale error is one that no sensor has. found: effect, name, value."""
    for effect, name, value in found:
        sensor, _, what = effect.partition("_")
        if sensor in NAMES and what == "scale" and abs(value) > NO_SENSOR:
            raise HandcalError(
                f"The {NAMES[sensor]}'s {name} reads {1.0 + value:.3g} times what it is known "
                "to feel: it is dead or at the end of its range, or one of the two is in another "
                "unit (--units) or in other axes."
            )


def doubts(extra: Mapping[str, float]) -> tuple[str, ...]:
    """Warnings where readings differ from any such model by more than they should; extra: by
    sensor ("gyro", "accel"), beyond their noise, SI. HandcalError where nothing fits at all."""
    said = []
    for sensor, much in extra.items():
        unit = shown(UNITS[sensor], (much,))
        differ = (
            f"The {NAMES[sensor]}'s readings differ from all that these parameters allow by "
            f"{much * unit.factor:.2g} {unit.unit} beyond their noise"
        )
        if much > NO_FIT[sensor]:
            raise HandcalError(
                f"{differ}: nothing fits. Are the readings and what is known beside them of one "
                "clock, in the right units and axes, and was no sensor at the end of its range?"
            )
        if much > APART[sensor]:
            said.append(
                f"{differ}: something else is wrong (a range that ends, a table that is not what "
                "it says, an error that is not estimated), so trust the sigmas less."
            )
    return tuple(said)

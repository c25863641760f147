"""PX4: CAL_GYRO*_* and CAL_ACC*_* as a parameter file of QGroundControl.

PX4 corrects readings in the sensor's frame, which its driver has turned to the board's axes, x
forward, y right, z down (github.com/PX4/PX4-Autopilot, src/lib/sensor_calibration, ``Correct`` in
Gyroscope.hpp and Accelerometer.hpp; docs.px4.io, "Parameter Reference", CAL_*), here of sensor 0:

    rate  = rotation (data - thermal_offset - (CAL_GYRO0_XOFF, YOFF, ZOFF))
    force = rotation ((data - thermal_offset - (CAL_ACC0_XOFF, ...)) * (CAL_ACC0_XSCALE, ...))

rad/s and m/s^2; the gyro has no scale and nothing has misalignments. handcal's recordings have ROS
axes (forward, left, up), to which a log of PX4 (.ulg) is turned when it is read: y and z change
sign. ``--axes frd`` is for a table of yours in PX4's axes.

The file is right as it stands: load it, and the vehicle corrects its readings as ``handcal apply``
does, but for what the header says it cannot hold. sensor_combined is what PX4 has corrected
already; its parameters are in the log, and what they left is added to them. sensor_accel and
sensor_gyro are raw, and what is found in them takes the place of the parameters. A table does not
say which of the two it is: ``--readings raw`` or ``--readings corrected`` says it, and
``--parameters FILE`` is the vehicle's parameters at that time. Which of CAL_ACC0_* to CAL_ACC3_*
belong to the sensor its id says (CAL_ACC0_ID, ...; of sensor_combined, the topic sensor_selection,
or that there is only one), and of a table ``--instance 1``.

Beside each parameter stands what the vehicle had and what was found. One that was not shown, or
was found within two of its sigmas of the vehicle's, is left out, so that the vehicle keeps its own.
Refused: a log without these parameters, or in which they changed; sensor_combined of a sensor that
is turned (on the board SENS_BOARD_ROT, elsewhere CAL_ACC0_ROT, and SENS_BOARD_X_OFF of both); raw
readings of a board with a thermal calibration (TC_A_ENABLE, TC_G_ENABLE).

Raw readings need the topics sensor_accel and sensor_gyro at full rate: lines ``sensor_accel 0 0``
and ``sensor_gyro 0 0`` in etc/logging/logger_topics.txt on the card, and SDLOG_MODE 2 or ``logger
on`` (docs.px4.io, "Logging").
"""

from __future__ import annotations

from collections.abc import Mapping

from handcal.exports import Contents, Format
from handcal.exports._vehicle import (
    CORRECTED,
    RAW,
    Parameter,
    keep,
    known,
    left,
    lines,
    parameters,
    readings_of,
    refuse_turned,
    told,
)
from handcal.types import HandcalError, InputError

REAL = 9  # MAV_PARAM_TYPE_REAL32
LINE = f"1\t1\t{{name}}\t{{value}}\t{REAL}"
NAMES = {"gyro": "CAL_GYRO", "accel": "CAL_ACC"}
MOST = 4  # sensors of a kind
THERMAL = {"gyro": "TC_G_ENABLE", "accel": "TC_A_ENABLE"}
LEVEL = ("SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF")
RAW_TOPICS = (
    "sensor_accel 0 0 and sensor_gyro 0 0 as lines of etc/logging/logger_topics.txt on the card"
)


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError where the vehicle's own calibration is not known, InputError
    for an instance that is another sensor's."""
    found = _parameters(contents)
    columns = "# Vehicle-Id Component-Id Name Value Type"
    head = f"{contents.commented()}{told(contents)}#\n{columns}\n"
    return head + lines(contents, found, LINE)


def _parameters(contents: Contents) -> list[Parameter]:
    out = []
    for sensor in NAMES:
        names = _names(contents.vehicle, contents.readings, sensor, contents.instance.get(sensor))
        out += parameters(contents, sensor, *names)
    return out


def _names(
    vehicle: Mapping[str, float], readings: str, sensor: str, instance: int | None = None
) -> tuple[str, str]:
    """Of the offsets and the scales of the sensor that was read. Errors: HandcalError where that,
    or what PX4 did to the readings, is not known."""
    if not readings:
        known(vehicle, readings, "CAL_ACC0_{}OFF")
    name = f"{NAMES[sensor]}{_index(vehicle, readings, sensor, instance)}"
    if readings == CORRECTED:
        external = vehicle.get(f"{name}_ROT", -1.0) >= 0.0
        turned = (f"{name}_ROT" if external else "SENS_BOARD_ROT", *LEVEL)
        refuse_turned(vehicle, turned, f"Raw readings have these axes: log {RAW_TOPICS}.")
    elif vehicle.get(THERMAL[sensor]):
        raise HandcalError(
            f"PX4 takes a thermal calibration off these raw readings ({THERMAL[sensor]} is "
            "1) before its offsets, which handcal does not know; use a log of sensor_combined."
        )
    names = f"{name}_{{}}OFF", f"{name}_{{}}SCALE" if sensor == "accel" else ""
    known(vehicle, readings, *names)
    return names


def lacks(vehicle: Mapping[str, float]) -> list[str]:
    """Why a log's result could not be written, in sentences."""
    out = dict[str, None]()
    for sensor in NAMES:
        try:
            _names(vehicle, readings_of(vehicle) or CORRECTED, sensor)
        except HandcalError as error:
            out[str(error)] = None
    return list(out)


def _index(vehicle: Mapping[str, float], readings: str, sensor: str, instance: int | None) -> int:
    """Which of the vehicle's sensors was read. Errors: HandcalError where that is not known,
    InputError for an instance that it was not."""
    name = NAMES[sensor]
    field = (f"sensor_{sensor}.device_id" if readings == RAW
             else f"sensor_selection.{sensor}_device_id")  # fmt: skip
    # (ids are unsigned in topics, signed as parameters)
    ids = {k: int(vehicle.get(f"{name}{k}_ID", 0)) % 2**32 for k in range(MOST)}
    ids = {k: id for k, id in ids.items() if id}
    if not ids:
        raise HandcalError(_without_id(vehicle, readings, name))
    used = [k for k, id in ids.items() if field not in vehicle or id == vehicle[field]]
    has = ", ".join(f"{name}{k}_ID {id}" for k, id in ids.items())
    if instance is not None and instance not in used:
        read = f", and the log is of {vehicle[field]:.0f}" if field in vehicle else ""
        raise InputError(f"--instance {sensor}={instance}: the vehicle has {has}{read}.")
    if instance is None and len(used) != 1:
        raise HandcalError(
            f"Which of the vehicle's sensors was read is not known: {field} is "
            f"{vehicle.get(field, 'not in the recording')!s}, and the vehicle has {has}. Name it "
            f"with {' or '.join(f'--instance {k}' for k in ids)}, or log the topic "
            f"{field.partition('.')[0]}; a sensor without an id there has no calibration of PX4's "
            "yet, which has to come first."
        )
    return used[0] if instance is None else instance


def _without_id(vehicle: Mapping[str, float], readings: str, name: str) -> str:
    """Why no sensor has an id, and what helps."""
    if not any(f"{name}{k}_ID" in vehicle for k in range(MOST)):
        return (
            "The vehicle's parameters are not in the recording (CAL_GYRO0_ID, CAL_ACC0_ID, ...), "
            "which say where these numbers belong: give them as they were then with --parameters "
            "FILE."
        )
    after = ("give its parameters after that with --parameters FILE" if readings == RAW
             else "record anew")  # fmt: skip
    return (
        f"PX4 has no calibration of this sensor yet ({name}0_ID is 0), and corrects none without: "
        f"calibrate the vehicle once in QGroundControl, which sets the ids, and {after}."
    )


FORMAT = Format(
    program="PX4",
    line="PX4: CAL_GYRO*_* and CAL_ACC*_*, a parameter file of QGroundControl",
    write=write,
    keep=keep,
    notes=("Signs: rate = reading - CAL_GYRO_OFF; force = (reading - CAL_ACC_OFF) * SCALE",),
    needs_bias=True,
    vehicle=("CAL_", "SENS_BOARD_", "TC_", "sensor_"),
    says=lambda contents: left(_parameters(contents)),
    lacks=lacks,
)

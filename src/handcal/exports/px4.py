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
sensor_gyro are raw, and what is found in them takes the place of the parameters. Which of
CAL_ACC0_* to CAL_ACC3_* belong to the sensor its id says (CAL_ACC0_ID, ...; of sensor_combined,
the topic sensor_selection, or that there is only one). Parameters that the recording did not show
are left out, so that the vehicle keeps its own. Refused: a log without these parameters, or in
which they changed; a board that is turned (SENS_BOARD_ROT, CAL_ACC0_ROT) with sensor_combined; raw
readings of a board with a thermal calibration (TC_A_ENABLE, TC_G_ENABLE). ``--parameters FILE`` is
for readings that PX4 has corrected and whose log is lost: the vehicle's parameters at that time.

Raw readings need the topics sensor_accel and sensor_gyro at full rate: lines ``sensor_accel 0 0``
and ``sensor_gyro 0 0`` in etc/logging/logger_topics.txt on the card, and SDLOG_MODE 2 or ``logger
on`` (docs.px4.io, "Logging").
"""

from __future__ import annotations

from handcal.exports import Contents, Format
from handcal.exports._vehicle import NONE, keep, lines, offsets, own, refuse_turned, scales, told
from handcal.types import HandcalError

REAL = 9  # MAV_PARAM_TYPE_REAL32
LINE = f"1\t1\t{{name}}\t{{value}}\t{REAL}"
NAMES = {"gyro": "CAL_GYRO", "accel": "CAL_ACC"}
MOST = 4  # sensors of a kind
THERMAL = {"gyro": "TC_G_ENABLE", "accel": "TC_A_ENABLE"}
BOARD = ("SENS_BOARD_ROT", "SENS_BOARD_X_OFF", "SENS_BOARD_Y_OFF", "SENS_BOARD_Z_OFF")


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError where the vehicle's own calibration is not known."""
    raw = any(f"sensor_{sensor}.device_id" in contents.vehicle for sensor in NAMES)
    written = [line for sensor in NAMES for line in _sensor(contents, sensor, raw)]
    head = f"{contents.commented()}{told(contents, not raw)}#\n"
    return f"{head}# Vehicle-Id Component-Id Name Value Type\n" + "\n".join(written) + "\n"


def _sensor(contents: Contents, sensor: str, raw: bool) -> list[str]:
    """Lines of the gyro or of the accelerometer."""
    vehicle = contents.vehicle
    name = f"{NAMES[sensor]}{_index(contents, sensor, raw)}"
    offset, scale = f"{name}_{{}}OFF", f"{name}_{{}}SCALE" if sensor == "accel" else ""
    if raw:
        if vehicle.get(THERMAL[sensor]):
            raise HandcalError(
                f"PX4 takes a thermal calibration off these raw readings ({THERMAL[sensor]} is "
                "1) before its offsets, which handcal does not know; use a log of sensor_combined."
            )
        before = NONE
    else:
        refuse_turned(vehicle, (f"{name}_ROT", *BOARD))
        before = own(vehicle, offset, scale)
    out = lines(offset, offsets(contents, sensor, before), LINE)
    return out + (lines(scale, scales(contents, before), LINE) if scale else [])


def _index(contents: Contents, sensor: str, raw: bool) -> int:
    """Which of the vehicle's sensors was read. Errors: HandcalError where that is not known."""
    vehicle, name = contents.vehicle, NAMES[sensor]
    field = f"sensor_{sensor}.device_id" if raw else f"sensor_selection.{sensor}_device_id"
    # (ids are unsigned in topics, signed as parameters)
    known = {k: int(vehicle.get(f"{name}{k}_ID", 0)) % 2**32 for k in range(MOST)}
    used = [k for k, id in known.items() if id]
    if not used:
        raise HandcalError(
            f"{contents.name} does not say by which calibration PX4 had corrected the readings "
            f"({name}0_ID and the like are missing): calibrate or explain the log (.ulg) itself, "
            "or give the vehicle's parameters as they were then with --parameters FILE."
        )
    if field in vehicle:
        used = [k for k in used if known[k] == vehicle[field]]
    if len(used) != 1:
        raise HandcalError(
            f"Which of the vehicle's sensors {contents.name} is of is not known: {field} is "
            f"{vehicle.get(field, 'not in the log')!s}, and the vehicle has "
            f"{', '.join(f'{name}{k}_ID {id}' for k, id in known.items() if id)}. Log the topic "
            f"{field.partition('.')[0]}; a sensor without an id there has no calibration of PX4's "
            "yet, which has to come first."
        )
    return used[0]


FORMAT = Format(
    program="PX4",
    line="PX4: CAL_GYRO*_* and CAL_ACC*_*, a parameter file of QGroundControl",
    write=write,
    keep=keep,
    notes=("Signs: rate = reading - CAL_GYRO_OFF; force = (reading - CAL_ACC_OFF) * SCALE",),
    needs_bias=True,
    vehicle=True,
)

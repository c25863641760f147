"""ArduPilot: INS_GYROFFS_*, INS_ACCOFFS_* and INS_ACCSCAL_* as a parameter file.

ArduPilot corrects readings after it turned the sensor to the board's axes, x forward, y right, z
down, and before AHRS_ORIENTATION (github.com/ArduPilot/ardupilot, AP_InertialSensor_Backend.cpp,
``_rotate_and_correct_accel`` and ``_rotate_and_correct_gyro``; ardupilot.org, "Complete Parameter
List", INS_*):

    rate  = reading - (INS_GYROFFS_X, _Y, _Z)
    force = (reading - (INS_ACCOFFS_X, ...)) * (INS_ACCSCAL_X, ...)

rad/s and m/s^2; the gyro has no scale and nothing has misalignments. handcal's recordings have ROS
axes (forward, left, up): y and z change sign; ``--axes frd`` is for a table of yours in ArduPilot's
axes. The gyro's offsets are found anew at each start unless INS_GYR_CAL is 0. Scales outside 0.8 to
1.2 are refused by ArduPilot, and so are they here.

What ArduPilot logs it has corrected by these parameters, so what handcal finds in it is what they
left. A log (.bin) has the parameters too, and they go with the recording: the file is right as it
stands. Of a table of such a log say ``--readings corrected``, and with ``--parameters FILE`` the
vehicle's parameters at that time: a file of Mission Planner, MAVProxy or QGroundControl, or
``mavlogdump.py --format csv --types PARM``. Refused: readings whose parameters are not known, or
changed in the log; a board that is turned (AHRS_ORIENTATION). Beside each parameter stands what the
vehicle had and what was found. One that was not shown, or was found within two of its sigmas of the
vehicle's, is left out, so that the vehicle keeps its own.

A log needs the IMU at full rate, also before arming: LOG_BITMASK with *Fast IMU* or *Raw IMU*, and
LOG_DISARMED 1 (ardupilot.org, "Complete Parameter List"). The first IMU is read.
"""

from __future__ import annotations

from collections.abc import Mapping

from handcal.exports import Contents, Format
from handcal.exports._vehicle import (
    CORRECTED,
    Parameter,
    keep,
    known,
    left,
    lines,
    parameters,
    refuse_turned,
    told,
)
from handcal.types import HandcalError, InputError

FACTOR = (0.8, 1.2)
LINE = "{name},{value}"
NAMES = {"gyro": ("INS_GYROFFS_{}", ""), "accel": ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}")}


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError for a scale that ArduPilot does not take, and where the
    vehicle's own calibration is not known."""
    found = _parameters(contents)
    wrong = [p for p in found if "ACCSCAL" in p.name and p.written
             and not FACTOR[0] <= p.now <= FACTOR[1]]  # fmt: skip
    if wrong:
        said = ", ".join(f"{p.name} {p.now:.4g}" for p in wrong)
        raise HandcalError(f"ArduPilot takes scales from {FACTOR[0]} to {FACTOR[1]}, not {said}.")
    return f"{contents.commented()}{told(contents)}" + lines(contents, found, LINE)


def _parameters(contents: Contents) -> list[Parameter]:
    _refuse_turned(contents.vehicle)
    if contents.instance:
        raise InputError("--instance is for px4: of ArduPilot only the first IMU is written.")
    return [p for sensor, names in NAMES.items() for p in parameters(contents, sensor, *names)]


def _refuse_turned(vehicle: Mapping[str, float]) -> None:
    """Errors: HandcalError."""
    refuse_turned(vehicle, ("AHRS_ORIENTATION",), "Record with AHRS_ORIENTATION 0.")


def lacks(vehicle: Mapping[str, float]) -> list[str]:
    """Why a log's result could not be written, in sentences."""
    try:
        _refuse_turned(vehicle)
        for names in NAMES.values():
            known(vehicle, CORRECTED, *names)
    except HandcalError as error:
        return [str(error)]
    return []


FORMAT = Format(
    program="ArduPilot",
    line="ArduPilot: INS_GYROFFS_*, INS_ACCOFFS_*, INS_ACCSCAL_*, a parameter file",
    write=write,
    keep=keep,
    notes=("Signs: rate = reading - INS_GYROFFS; force = (reading - INS_ACCOFFS) * INS_ACCSCAL",
           "For a board with AHRS_ORIENTATION 0; INS_GYR_CAL 0 keeps the gyro's offsets"),
    needs_bias=True,
    vehicle=("INS_", "AHRS_", "IMU", "GYR"),
    says=lambda contents: left(_parameters(contents)),
    lacks=lacks,
)  # fmt: skip

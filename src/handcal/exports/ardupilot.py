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

ArduPilot's own logs (.bin) are not read. The way round: its IMU messages as a table (pymavlink:
``mavlogdump.py --format csv --types IMU``), of one instance I; columns ``t,gx,gy,gz,ax,ay,az`` from
TimeUS (in s), Gyr and Acc, with the sign of y and z changed in both sensors (or as they are, and
``--axes frd``). These are readings that ArduPilot has corrected and filtered already: with all
INS_GYROFFS and INS_ACCOFFS zero and INS_ACCSCAL one they are raw but for the filter; otherwise what
is found here is what those left, and the offsets add up.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._vehicle import keep, offsets, scales, told
from handcal.types import HandcalError

FACTOR = (0.8, 1.2)


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError for a scale that ArduPilot does not take."""
    found, factor, lines = offsets(contents), scales(contents), []
    if factor.min() < FACTOR[0] or factor.max() > FACTOR[1]:
        raise HandcalError(f"ArduPilot takes scales from {FACTOR[0]} to {FACTOR[1]}, not {factor}.")
    for sensor, name in (("gyro", "INS_GYROFFS"), ("accel", "INS_ACCOFFS")):
        for axis, value in zip("XYZ", found[sensor], strict=True):
            if np.isnan(value):
                lines.append(f"# {name}_{axis}: not shown, left as it is on the vehicle")
            else:
                lines.append(f"{name}_{axis},{value:.12f}")
    lines += [f"INS_ACCSCAL_{a},{v:.12f}" for a, v in zip("XYZ", factor, strict=True)]
    return f"{contents.commented()}{told(contents)}" + "\n".join(lines) + "\n"


FORMAT = Format(
    program="ArduPilot",
    line="ArduPilot: INS_GYROFFS_*, INS_ACCOFFS_*, INS_ACCSCAL_*, a parameter file",
    write=write,
    keep=keep,
    notes=("Signs: rate = reading - INS_GYROFFS; force = (reading - INS_ACCOFFS) * INS_ACCSCAL",
           "For a board with AHRS_ORIENTATION 0; INS_GYR_CAL 0 keeps the gyro's offsets"),
    needs_bias=True,
    vehicle=True,
)  # fmt: skip

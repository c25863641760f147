"""PX4: CAL_GYRO0_* and CAL_ACC0_* as a parameter file of QGroundControl.

PX4 corrects readings in the sensor's frame, which its driver has turned to the board's axes, x
forward, y right, z down (github.com/PX4/PX4-Autopilot, src/lib/sensor_calibration, ``Correct`` in
Gyroscope.hpp and Accelerometer.hpp; docs.px4.io, "Parameter Reference", CAL_*):

    rate  = rotation (data - thermal_offset - (CAL_GYRO0_XOFF, YOFF, ZOFF))
    force = rotation ((data - thermal_offset - (CAL_ACC0_XOFF, ...)) * (CAL_ACC0_XSCALE, ...))

rad/s and m/s^2; the gyro has no scale and nothing has misalignments. handcal's recordings have ROS
axes (forward, left, up), to which a log of PX4 (.ulg) is turned when it is read: y and z change
sign. ``--axes frd`` is for a table of yours in PX4's axes. The file holds for the first sensor of a
board without SENS_BOARD_ROT; PX4 uses it only if CAL_GYRO0_ID and CAL_ACC0_ID name the device
already, as they do after its own calibration.

Log the topics sensor_accel and sensor_gyro at full rate: lines ``sensor_accel 0 0`` and
``sensor_gyro 0 0`` in etc/logging/logger_topics.txt on the card, and SDLOG_MODE 2 or ``logger on``
(docs.px4.io, "Logging"). sensor_combined alone is what PX4 has corrected already by CAL_GYRO0_* and
CAL_ACC0_*: what handcal then finds is what those left, and has to be added to them.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._vehicle import keep, offsets, scales, told

REAL = 9  # MAV_PARAM_TYPE_REAL32


def write(contents: Contents) -> str:
    """The file."""
    found, lines = offsets(contents), []
    for sensor, name in (("gyro", "CAL_GYRO0"), ("accel", "CAL_ACC0")):
        for axis, value in zip("XYZ", found[sensor], strict=True):
            if np.isnan(value):
                lines.append(f"# {name}_{axis}OFF: not shown, left as it is on the vehicle")
            else:
                lines.append(f"1\t1\t{name}_{axis}OFF\t{value:.12f}\t{REAL}")
    for axis, value in zip("XYZ", scales(contents), strict=True):
        lines.append(f"1\t1\tCAL_ACC0_{axis}SCALE\t{value:.12f}\t{REAL}")
    head = f"{contents.commented()}{told(contents)}#\n"
    return f"{head}# Vehicle-Id Component-Id Name Value Type\n" + "\n".join(lines) + "\n"


FORMAT = Format(
    program="PX4",
    line="PX4: CAL_GYRO0_* and CAL_ACC0_*, a parameter file of QGroundControl",
    write=write,
    keep=keep,
    notes=("Signs: rate = reading - CAL_GYRO0_OFF; force = (reading - CAL_ACC0_OFF) * SCALE",
           "For a board without SENS_BOARD_ROT whose CAL_GYRO0_ID and CAL_ACC0_ID are set"),
    needs_bias=True,
    vehicle=True,
)  # fmt: skip

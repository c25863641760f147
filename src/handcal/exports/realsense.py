"""RealSense: scale_and_alignment and bias, as rs-imu-calibration.py writes them.

librealsense corrects a reading (github.com/IntelRealSense/librealsense,
src/proc/motion-transform.cpp, ``correct_motion_helper``):

    corrected = sensitivity * reading - bias

so its bias is behind the matrix: bias = T b where handcal has T (reading - b). The script
tools/rs-imu-calibration/rs-imu-calibration.py fits the same (a column of -1 beside the readings)
and writes to calibration.json the nine numbers of ``scale_and_alignment`` column by column.
``rs2_motion_device_intrinsic`` has rows of scale, cross axes and bias; they are here as ``data``.
Both hold in the depth sensor's axes, in which librealsense gives readings to you: record without
motion correction (``enable_motion_correction`` 0).
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports.fusion import keep
from handcal.types import Array


def _sensor(matrix: Array, bias: Array) -> dict[str, Any]:
    behind = matrix @ bias
    return {
        "scale_and_alignment": matrix.T.ravel().tolist(),
        "bias": behind.tolist(),
        "data": np.column_stack([matrix, behind]).tolist(),
    }


def write(contents: Contents) -> str:
    """The file."""
    c = contents.correction
    imu = {
        "accelerometer": _sensor(c.accel, c.accel_bias),
        "gyroscope": _sensor(c.gyro, c.gyro_bias),
    }
    document = {"handcal": list(contents.header), "imus": [imu]}
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


FORMAT = Format(
    program="librealsense",
    line="RealSense: scale_and_alignment and bias of calibration.json",
    write=write,
    keep=keep,
    notes=("Signs: corrected = sensitivity reading - bias; scale_and_alignment column by column",),
)

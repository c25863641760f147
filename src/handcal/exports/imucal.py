"""imucal: a Ferraris calibration as JSON, which ``imucal.FerrarisCalibrationInfo`` loads.

imucal corrects readings (package imucal, class FerrarisCalibrationInfo, methods _calibrate_acc and
_calibrate_gyr):

    a = inv(R_a) inv(K_a) (read_a - b_a)
    w = inv(R_g) inv(K_g) (read_w - K_ga a - b_g)

K is the diagonal of scales, R the directions of the sensor's axes, one in a row. Units are SI
throughout: load it by ``imucal.management.load_calibration_info`` or ``from_json_file``, and call
``calibrate(acc, gyr, "m/s^2", "rad/s")``.
"""

from __future__ import annotations

import json

import numpy as np

from handcal.exports import Contents, Format
from handcal.types import Array


def _factors(correction: Array) -> tuple[Array, Array]:
    """K (3, 3), diagonal, and R (3, 3) with rows of length one, of the matrix that corrects."""
    forward = np.linalg.inv(correction)
    lengths = np.linalg.norm(forward, axis=1)
    return np.diag(lengths), forward / lengths[:, None]


def write(contents: Contents) -> str:
    """The file."""
    c = contents.correction
    K_a, R_a = _factors(c.accel)
    K_g, R_g = _factors(c.gyro)
    matrices = {"K_a": K_a, "R_a": R_a, "b_a": c.accel_bias, "K_g": K_g, "R_g": R_g,
                "K_ga": c.g_sensitivity, "b_g": c.gyro_bias}  # fmt: skip
    document = {
        "cal_type": "Ferraris",
        "_format_version": "2.0.0",
        "acc_unit": "m/s^2",
        "gyr_unit": "rad/s",
        "from_acc_unit": "m/s^2",
        "from_gyr_unit": "rad/s",
        "comment": "\n".join(contents.header),
        **{name: matrix.tolist() for name, matrix in matrices.items()},
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


FORMAT = Format(
    program="imucal",
    line="imucal: a Ferraris calibration as JSON (K_a, R_a, b_a, K_g, R_g, K_ga, b_g)",
    write=write,
    notes=("Signs: a = inv(R_a) inv(K_a) (read - b_a); w = inv(R_g) inv(K_g) (read - K_ga a - b_g)",
           "SI throughout: m/s^2 and rad/s in and out"),
)  # fmt: skip

"""OpenVINS: ``kalibr_imu_chain.yaml`` in its IMU model "kalibr", body axes as in handcal.

OpenVINS corrects readings (docs.openvins.com, page "Analytical Propagation", section "IMU Intrinsic
Models"; keys as read in ov_msckf/src/core/VioManagerOptions.h):

    a = R_IMUtoACC^T inv(Ta) (read_a - b_a)
    w = R_IMUtoGYRO^T inv(Tw) (read_w - Tg a - b_g)

In the model "kalibr" only the lower triangles of inv(Tw) and inv(Ta) are used, and the IMU's axes
are those of the accelerometer: R_IMUtoACC is the identity. Biases are part of its state. Copy the
file over the ``kalibr_imu_chain.yaml`` of your configuration; with ``calib_imu_intrinsics``
OpenVINS goes on from there. Noise levels, rate and topic are there as in the file of ``--to
kalibr``, each level with where it is from; ``handcal export ALLAN.json --to openvins`` writes them
alone.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._chain import EUROC, biases, body, noise, without_biases
from handcal.exports._text import lower_accel, lower_times_turn, yaml_matrix
from handcal.types import Array


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError where the model's axes cannot be met."""
    c = contents.correction
    accel = lower_accel(np.linalg.inv(c.accel), "OpenVINS (kalibr)")
    gyro, turn = lower_times_turn(np.linalg.inv(c.gyro))
    return chain(contents, "kalibr", gyro, turn, accel, np.eye(3), c.g_sensitivity)


def chain(
    contents: Contents, model: str, Tw: Array, R_IMUtoGYRO: Array, Ta: Array, R_IMUtoACC: Array,
    Tg: Array,
) -> str:  # fmt: skip
    """The file of either model; all (3, 3). (OpenCV wants the YAML version first.)"""
    matrices = {"Tw": Tw, "R_IMUtoGYRO": R_IMUtoGYRO, "Ta": Ta, "R_IMUtoACC": R_IMUtoACC, "Tg": Tg}
    return "".join(
        [
            "%YAML:1.0\n",
            contents.commented(),
            biases(contents),
            "imu0:\n",
            body(contents, 2),
            noise(contents, 2),
            f'  time_offset: 0.0\n  model: "{model}"\n',
            *(yaml_matrix(name, matrix, 2) for name, matrix in matrices.items()),
        ]
    )


FORMAT = Format(
    program="OpenVINS",
    line='OpenVINS\' kalibr_imu_chain.yaml: noise, Tw, Ta, Tg, R_IMUtoGYRO (model "kalibr")',
    write=write,
    keep=without_biases,
    notes=("Signs: a = inv(Ta) (read - b_a); w = R_IMUtoGYRO^T inv(Tw) (read - Tg a - b_g); SI",),
    online=True,
    noise=EUROC,
)

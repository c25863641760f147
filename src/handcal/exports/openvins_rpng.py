"""OpenVINS: ``kalibr_imu_chain.yaml`` in its IMU model "rpng", whose IMU axes are the gyro's.

The formulas are those of the model "kalibr" (docs.openvins.com, page "Analytical Propagation",
section "IMU Intrinsic Models"), but only the upper triangles of inv(Tw) and inv(Ta) are used, and
the IMU's axes are those of the gyro: R_IMUtoGYRO is the identity and R_IMUtoACC is not. They are
turned against handcal's by a rotation that the header has, as rate and force come out of OpenVINS
turned: w_openvins = R w_handcal. What is known of a camera on handcal's axes has to be turned too.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._chain import EUROC, without_biases
from handcal.exports._correction import Correction
from handcal.exports._text import row, turn_times_upper
from handcal.exports.openvins import chain
from handcal.types import Array


def turned(correction: Correction) -> tuple[Array, Array, Array, Array]:
    """R (3, 3), that takes handcal's axes to the model's; Dw, R_ACCtoIMU and Da there."""
    turn, Dw = turn_times_upper(correction.gyro)
    R = turn.T
    R_ACCtoIMU, Da = turn_times_upper(R @ correction.accel)
    return R, Dw, R_ACCtoIMU, Da


def write(contents: Contents) -> str:
    """The file."""
    c = contents.correction
    R, Dw, R_ACCtoIMU, Da = turned(c)
    text = chain(
        contents, "rpng", np.triu(np.linalg.inv(Dw)), np.eye(3), np.triu(np.linalg.inv(Da)),
        R_ACCtoIMU.T, c.g_sensitivity @ R.T,
    )  # fmt: skip
    first, rest = text.split("\n", 1)
    axes = f"# R_openvins_handcal: [[{'], ['.join(row(r) for r in R)}]]\n"
    return f"{first}\n{axes}{rest}"


FORMAT = Format(
    program="OpenVINS with its own IMU model",
    line='OpenVINS\' kalibr_imu_chain.yaml with R_IMUtoACC (model "rpng", the gyro\'s axes)',
    write=write,
    keep=without_biases,
    notes=("Signs: a = R_IMUtoACC^T inv(Ta) (read - b_a); w = inv(Tw) (read - Tg a - b_g); SI",
           "The IMU's axes here are the gyro's: w = R_openvins_handcal w_handcal"),
    online=True,
    noise=EUROC,
)  # fmt: skip

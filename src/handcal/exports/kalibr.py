"""Kalibr: ``imu.yaml``, with noise densities and the intrinsics of its model scale-misalignment.

Kalibr predicts a reading from rate w and force a of the IMU's axes i (Rehder et al., Extending
kalibr, ICRA 2016; github.com/ethz-asl/kalibr, IccSensors.py, class IccScaledMisalignedImu):

    accelerometer = M_a a + b_a
    gyro          = M_g C_gyro_i w + A C_gyro_i a + b_g

with M_a and M_g lower triangular, so the accelerometer's x axis is that of i, as in handcal. Take
them off in this order: a = inv(M_a) (read - b_a), then w = C_gyro_i^T inv(M_g) (read - b_g -
A C_gyro_i a). The file has the keys of an ``imu.yaml`` (for ``--imu``) on top, and all of it again
under ``imu0``, as Kalibr writes its own results. Biases are no part of it.

Kalibr itself reads six keys of the file as ``--imu``: ``rostopic``, ``update_rate`` and four noise
levels. It reads none of the matrices: they are for what corrects readings afterwards. For a bag
that ``handcal apply`` corrected take its model ``--imu-models calibrated`` (the default: biases and
nothing else); for the raw one ``--imu-models scale-misalignment``, which estimates the matrices
anew.

The six keys are always there, each noise level with where it is from: ``--noise ALLAN.json``
(``handcal allan`` of a record at rest; of a walk that it was too short to see, the most that would
have stayed hidden), else the fit's own, which hold what the motion adds and stand beside those of
the recording's longest rest, else those of the ADIS16448 in the EuRoC data set, marked DEFAULT.
``handcal export ALLAN.json --to kalibr`` writes the noise alone. ``update_rate`` is the sensor's,
``rostopic`` that of the recording or of ``--topic imu=/NAME``. ``T_i_b`` takes points from the axes
of a pose's marker (or camera) to the IMU's, where there was one; without, the body is the IMU, as
Kalibr has it for imu0.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._chain import EUROC, biases, body, noise, without_biases
from handcal.exports._text import lower_accel, lower_times_turn, yaml_matrix
from handcal.types import HandcalError


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError where Kalibr's axes cannot be met, or no rate is known."""
    if contents.rate_hz is None:
        raise HandcalError(
            f"{contents.name} does not say how often the IMU was read, which Kalibr needs; give "
            "the recording with --recording FILE."
        )
    c = contents.correction
    accel = lower_accel(np.linalg.inv(c.accel), "Kalibr")
    gyro, turn = lower_times_turn(np.linalg.inv(c.gyro))
    chain = "".join(
        [
            body(contents, 2),
            noise(contents, 2),
            "  time_offset: 0.0\n  model: scale-misalignment\n",
            "  accelerometers:\n",
            yaml_matrix("M", accel, 4),
            "  gyroscopes:\n",
            yaml_matrix("M", gyro, 4),
            yaml_matrix("A", c.g_sensitivity @ turn.T, 4),
            yaml_matrix("C_gyro_i", turn, 4),
        ]
    )
    return f"{contents.commented()}{biases(contents)}{noise(contents, 0)}imu0:\n{chain}"


FORMAT = Format(
    program="Kalibr",
    line="Kalibr's imu.yaml: noise, rate, and the matrices M, A and C_gyro_i",
    write=write,
    keep=without_biases,
    notes=(
        "Signs: reading = M a + b, and M C_gyro_i w + A C_gyro_i a + b; SI, axes of the recording",
    ),
    online=True,
    noise=EUROC,
)

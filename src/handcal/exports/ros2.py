"""ROS 2: covariances for the Imu messages, and how to get a corrected bag.

sensor_msgs/msg/Imu (docs.ros.org, sensor_msgs, Imu) has covariances of rate and force, row by row;
all zeros mean "unknown", -1 in the first place of ``orientation_covariance`` "no orientation".
White noise of density N gives a sample, at f samples a second, the variance N^2 f. What a bias
may have changed since is not in it. ROS 2 has no message for a calibration; ``handcal apply
RECORDING.mcap --from RESULT.json --biases -o corrected.mcap`` writes a corrected bag.
The parameters are for a node of your own, which declares them and writes them into its messages; a
driver calls them by names of its own. ``--biases`` takes off the biases too, which are those of
this recording alone.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._text import row
from handcal.types import HandcalError


def write(contents: Contents) -> str:
    """The file. Errors: HandcalError where noise or rate is not known."""
    gyro, accel, rate = contents.noise.gyro_noise, contents.noise.accel_noise, contents.rate_hz
    if gyro is None or accel is None or rate is None:
        raise HandcalError(
            f"{contents.name} has no white noise of gyro and accelerometer, or no rate, of which a "
            "covariance could be made; from a record at rest: `handcal allan REST --json "
            "ALLAN.json`, then --noise ALLAN.json."
        )
    lines = [
        contents.commented(),
        f"# Noise: gyro {contents.noise.sources['gyro_noise']}; accelerometer "
        f"{contents.noise.sources['accel_noise']}\n",
        "/**:\n  ros__parameters:\n",
    ]
    lines.append(f"    orientation_covariance: [{row([-1.0, *[0.0] * 8])}]\n")
    for name, density in (("angular_velocity", gyro), ("linear_acceleration", accel)):
        variance = np.diag([density**2 * rate] * 3)
        lines.append(f"    {name}_covariance: [{row(variance.ravel())}]\n")
    return "".join(lines)


FORMAT = Format(
    program="ROS 2",
    line="ROS 2: covariances for the Imu messages, as parameters of a node of your own",
    write=write,
    keep=None,
    noise={"gyro_noise": None, "accel_noise": None},
    notes=("One variance for the three axes of a sensor, whose noise is known as one level",
           "Variance of one sample: density^2 * rate; (rad/s)^2 and (m/s^2)^2, row by row",
           "The node declares these parameters and writes them into its messages: "
           "ros2 run PACKAGE NODE --ros-args --params-file FILE.yaml",
           "A driver calls them by names of its own: copy the numbers into its file of parameters",
           "A corrected bag: handcal apply RECORDING --from RESULT.json --biases -o FILE.mcap"),
)  # fmt: skip

"""What the YAML files of Kalibr and OpenVINS have in common: noise, rate, topic.

Both programs want all four noise levels, larger than zero. What was not measured is that of the
ADIS16448 in the EuRoC data set (Burri et al., IJRR 35, 2016; imu0/sensor.yaml there), and is marked
as such: what a device's bias does in minutes takes hours at rest to see.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents
from handcal.exports._correction import Correction
from handcal.exports._text import number, row, yaml_matrix

KEYS = (
    ("accelerometer_noise_density", "accel_noise", "m/s^2/sqrt(Hz), white noise"),
    ("accelerometer_random_walk", "accel_bias_walk", "m/s^3/sqrt(Hz), walk of the bias"),
    ("gyroscope_noise_density", "gyro_noise", "rad/s/sqrt(Hz), white noise"),
    ("gyroscope_random_walk", "gyro_bias_walk", "rad/s^2/sqrt(Hz), walk of the bias"),
)
EUROC: dict[str, float | None] = {
    "accel_noise": 2e-3, "accel_bias_walk": 3e-3, "gyro_noise": 1.6968e-4,
    "gyro_bias_walk": 1.9393e-5,
}  # fmt: skip
# ROS 2's usual name, which handcal gives to recordings of other formats as well.
TOPIC = "/imu"


def noise(contents: Contents, indent: int) -> str:
    """The four noise levels, topic and rate."""
    space, lines = " " * indent, list[str]()
    for key, name, unit in KEYS:
        source = contents.noise.sources[name]
        lines.append(f"{key}: {number(getattr(contents.noise, name))}  # {unit}; {source}")
    if not contents.topic:
        lines.append("# rostopic: not in the recording, put in yours")
    lines.append(f"rostopic: {contents.topic or TOPIC}")
    if contents.rate_hz is None:
        lines.append("# update_rate: not in the result")
    else:
        lines.append(f"update_rate: {number(contents.rate_hz)}")
    return "".join(f"{space}{line}\n" for line in lines)


def without_biases(correction: Correction) -> Correction:
    """What a program keeps that finds the biases itself."""
    c = correction
    return Correction(np.zeros(3), np.zeros(3), c.gyro, c.accel, c.g_sensitivity)


def biases(contents: Contents) -> str:
    """The biases as comments, to begin with; both are in front of every matrix."""
    if not contents.has_bias:
        return ""
    return (
        f"# To begin with: gyro bias [{row(contents.bias[:3])}] rad/s,\n"
        f"# accelerometer bias [{row(contents.bias[3:])}] m/s^2, as read too much.\n"
    )


def body(contents: Contents, indent: int) -> str:
    """T_i_b (4, 4), which takes points in the body's axes to the IMU's: the body is the marker of a
    pose where there is one, else the IMU itself."""
    T, said = np.eye(4), "the body is the IMU itself, as it is of Kalibr's imu0"
    if contents.marker is not None:
        T[:3, :3], place = contents.marker
        known = bool(np.isfinite(place).all())
        T[:3, 3] = place if known else 0.0
        said = "the body is the marker of /pose, where Kalibr's imu0 has the identity" + (
            "" if known else "; where the marker sits was not shown: zeros"
        )
    return f"{' ' * indent}# T_i_b: {said}\n{yaml_matrix('T_i_b', T, indent)}"

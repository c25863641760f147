"""What the YAML files of Kalibr and OpenVINS have in common: noise, rate, topic."""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents
from handcal.exports._correction import Correction
from handcal.exports._text import number, row

KEYS = (
    ("accelerometer_noise_density", "accel_noise", "m/s^2/sqrt(Hz), white noise"),
    ("accelerometer_random_walk", "accel_bias_walk", "m/s^3/sqrt(Hz), walk of the bias"),
    ("gyroscope_noise_density", "gyro_noise", "rad/s/sqrt(Hz), white noise"),
    ("gyroscope_random_walk", "gyro_bias_walk", "rad/s^2/sqrt(Hz), walk of the bias"),
)


def noise(contents: Contents, indent: int) -> str:
    """The four noise levels, topic and rate; what the result does not have is left out and said."""
    space, lines = " " * indent, list[str]()
    if any(getattr(contents.noise, name) for _, name, _ in KEYS):
        lines.append(f"# Noise: {contents.noise.source}")
    for key, name, unit in KEYS:
        value = getattr(contents.noise, name)
        if value is None:
            lines.append(f"# {key}: not in the result; from a record at rest: --noise ALLAN.json")
        else:
            lines.append(f"{key}: {number(value)}  # {unit}")
    lines.append(f"rostopic: {contents.topic}")
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


IDENTITY = np.eye(4)

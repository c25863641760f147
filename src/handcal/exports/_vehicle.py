"""What the parameter files of PX4 and ArduPilot have in common: offsets, and a scale of the
accelerometer, in the vehicle's axes (forward, right, down)."""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents
from handcal.exports._correction import Correction
from handcal.types import Array

# Forward, left, up to forward, right, down.
TURN = np.array([1.0, -1.0, -1.0])


def keep(correction: Correction) -> Correction:
    """Biases, and of the accelerometer one factor an axis."""
    c = correction
    return Correction(
        c.gyro_bias, c.accel_bias, np.eye(3), np.diag(np.diag(c.accel)), np.zeros((3, 3))
    )


def offsets(contents: Contents) -> dict[str, Array]:
    """Offsets of "gyro" and "accel" (3,), vehicle's axes; nan where they were not shown."""
    c = contents.correction
    turn = TURN if contents.axes == "flu" else np.ones(3)
    found = {}
    for sensor, bias in (("gyro", c.gyro_bias), ("accel", c.accel_bias)):
        lost = contents.hidden.get(f"{sensor}_bias", "")
        found[sensor] = np.where([a in lost for a in "xyz"], np.nan, turn * bias + 0.0)
    return found


def scales(contents: Contents) -> Array:
    """Factors of the accelerometer (3,); they do not change with the sense of an axis."""
    return np.diag(contents.correction.accel)


def told(contents: Contents) -> str:
    """Which axes the recording was taken to have."""
    names = {"flu": "x forward, y left, z up (ROS)", "frd": "x forward, y right, z down"}
    return f"# Axes of the recording: {names[contents.axes]}; here x forward, y right, z down\n"

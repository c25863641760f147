"""ROS 2 message definitions, and their CDR form for a whole stream at once.

Every message used here is a header followed by a fixed number of float64, so that a
stream is one structured array with one message in each row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from handcal_sim.profiles import Array

_HEADER = """MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id"""
_TIME = """MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
_QUATERNION = """MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w"""
_VECTOR3 = """MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
_POINT = _VECTOR3.replace("Vector3", "Point")
_POSE = """MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation"""

_IMU = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance"""
_MAG = """std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance"""
_TEMPERATURE = """std_msgs/Header header
float64 temperature
float64 variance"""
_STAMPED_POSE = """std_msgs/Header header
geometry_msgs/Pose pose"""
_STAMPED_QUATERNION = """std_msgs/Header header
geometry_msgs/Quaternion quaternion"""


def _definition(*parts: str) -> str:
    return f"\n{'=' * 80}\n".join((*parts, _HEADER, _TIME)) + "\n"


SCHEMAS: dict[str, str] = {
    "sensor_msgs/msg/Imu": _definition(_IMU, _QUATERNION, _VECTOR3),
    "sensor_msgs/msg/MagneticField": _definition(_MAG, _VECTOR3),
    "sensor_msgs/msg/Temperature": _definition(_TEMPERATURE),
    "geometry_msgs/msg/PoseStamped": _definition(_STAMPED_POSE, _POSE, _POINT, _QUATERNION),
    "geometry_msgs/msg/QuaternionStamped": _definition(_STAMPED_QUATERNION, _QUATERNION),
}


def encode(stamps_ns: NDArray[np.int64], frame_id: str, payload: Array) -> list[bytes]:
    """CDR messages (little endian): stamps (n,) ns since 1970, payload (n, k) float64."""
    name = frame_id.encode() + b"\0"
    padding = -(12 + len(name)) % 8
    row = np.dtype(
        [
            ("encapsulation", "V4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"),
            ("name", f"V{len(name) + padding}"), ("payload", "<f8", (payload.shape[1],)),
        ]
    )  # fmt: skip
    messages = np.zeros(len(payload), row)
    messages["encapsulation"] = np.void(b"\0\1\0\0")
    messages["sec"], messages["nanosec"] = np.divmod(stamps_ns, 1_000_000_000)
    messages["length"] = len(name)
    messages["name"] = np.void(name + b"\0" * padding)
    messages["payload"] = payload
    return [messages[k : k + 1].tobytes() for k in range(len(messages))]


def imu(readings: Array) -> Array:
    """Payload (n, 37) of gyro and accelerometer readings (n, 6); there is no orientation."""
    payload = np.zeros((len(readings), 37))
    payload[:, 3], payload[:, 4] = 1.0, -1.0
    payload[:, 13:16], payload[:, 25:28] = readings[:, :3], readings[:, 3:]
    return payload


def padded(values: Array, width: int) -> Array:
    """Payload (n, width): the values, then zeros for variances that are unknown."""
    payload = np.zeros((len(values), width))
    payload[:, : values.shape[1]] = values
    return payload


def heading(values: Array) -> Array:
    """Payload (n, 4): yaw (n, 1) as a quaternion x y z w about up."""
    half = 0.5 * values[:, 0]
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)

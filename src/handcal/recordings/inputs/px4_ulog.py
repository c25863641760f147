"""Logs of PX4 (.ulg), read with pyulog.

Rate in rad/s and specific force in m/s^2 in the autopilot's axes: x forward, y to the right, z
down, so that a level vehicle at rest reads -9.81 on z, which is +g on the axis up. The raw
sensor_gyro and sensor_accel, the first of each, are taken where they were logged as often as
sensor_combined, which PX4 has corrected by a calibration of its own: that is said. The
magnetometer, gauss, is sensor_mag beside the raw ones, else vehicle_magnetometer. A mocap's pose
has a world with z down, which is turned about its x so that z is up. Stamps: us since boot.
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._zip import LARGEST, stated
from handcal.types import Array, InputError, Recording

UNDERSTOOD = "a log of PX4 (.ulg)"
UNITS = "rad/s, m/s^2, gauss, m; axes forward, right, down: at rest -9.81 on z, +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, pose (vehicle_mocap_odometry)"
ENDINGS = (".ulg",)
MARK = "it does not begin with ULog's magic bytes"
MAGIC = b"ULog\x01\x12\x35"
_TOPICS = ("sensor_gyro", "sensor_accel", "sensor_combined", "sensor_mag", "vehicle_magnetometer",
           "vehicle_mocap_odometry")  # fmt: skip
# What pyulog ends in where a log is damaged: it trusts the lengths and names in it.
_DAMAGED = (struct.error, ValueError, LookupError, TypeError, AttributeError, AssertionError,
            ArithmeticError, EOFError, RecursionError)  # fmt: skip
_Fields = Mapping[str, Array]


def can_read(path: Path) -> bool:
    """By its first bytes."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    topics = _topics(path)
    options.progress(1.0)
    said = list(stated("PX4", options))
    whole = topics.get("sensor_combined", {})
    raw = all(name in topics for name in _TOPICS[:2]) and all(
        2 * len(topics[name]["timestamp"]) > len(whole.get("timestamp", ())) for name in _TOPICS[:2]
    )
    try:
        if raw:
            gyro, accel = (_vector(topics[name], "", 1.0) for name in _TOPICS[:2])
        elif whole:
            said.append("sensor_combined: PX4 has corrected it by a calibration of its own.")
            gyro = _vector(whole, "gyro_rad", 1.0)
            accel = _vector(whole, "accelerometer_m_s2", 1.0)
            late = whole["accelerometer_timestamp_relative"].astype(np.int64) * 1000
            accel = columns(accel.ns + late, accel.value)
        else:
            raise InputError(
                f"{path} has neither sensor_combined nor sensor_gyro and sensor_accel."
            )
        streams = _further(topics, raw)
    except KeyError as error:
        raise InputError(f"{path}: a topic of its IMU lacks the field {error}.") from error
    return assemble(path, gyro, accel, streams, tuple(said))


def _topics(path: Path) -> dict[str, _Fields]:
    """Fields by topic, the first instance of each. Errors: InputError."""
    import pyulog

    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} is too large to be read at once.")
    try:
        # pyulog prints what it thinks of a file, and leaves open what it opens itself.
        with path.open("rb") as file, contextlib.redirect_stdout(io.StringIO()):
            found: list[Any] = pyulog.ULog(file, list(_TOPICS)).data_list
    except _DAMAGED as error:
        raise InputError(f"{path} is a damaged ULog: {type(error).__name__}.") from error
    topics: dict[str, _Fields] = {}
    for one in sorted(found, key=lambda one: int(one.multi_id), reverse=True):
        if "timestamp" in one.data and len(one.data["timestamp"]):
            topics[str(one.name)] = one.data
    return topics


def _further(topics: Mapping[str, _Fields], raw: bool) -> dict[str, Columns]:
    """The streams beside the IMU."""
    streams = {}
    if raw and "sensor_mag" in topics:
        streams["mag"] = _vector(topics["sensor_mag"], "", 1e-4)
    elif not raw and "vehicle_magnetometer" in topics:
        streams["mag"] = _vector(topics["vehicle_magnetometer"], "magnetometer_ga", 1e-4)
    if raw and "temperature" in topics["sensor_accel"]:
        fields = topics["sensor_accel"]
        streams["temperature"] = columns(_stamps(fields), _floats(fields["temperature"])[:, None])
    if "vehicle_mocap_odometry" in topics:
        fields = topics["vehicle_mocap_odometry"]
        place = [_floats(fields[f"position[{k}]"]) for k in range(3)]
        w, x, y, z = (_floats(fields[f"q[{k}]"]) for k in range(4))
        turned = np.column_stack([place[0], -place[1], -place[2], -x, w, -z, y])
        streams["pose"] = columns(_stamps(fields), turned)
    return streams


def _vector(fields: _Fields, name: str, factor: float) -> Columns:
    names = [f"{name}[{k}]" for k in range(3)] if name else ["x", "y", "z"]
    value = np.column_stack([_floats(fields[n]) for n in names])
    return columns(_stamps(fields), factor * value)


def _floats(field: Array) -> Array:
    return np.asarray(field, dtype=np.float64)


def _stamps(fields: _Fields) -> Any:
    """When the sample was taken, else when it was published; ns since boot."""
    us = fields.get("timestamp_sample", fields["timestamp"])
    if us.dtype.kind not in "iu" or np.any(us > 9 * 10**15):
        raise InputError("A time stamp of the log is no number of microseconds since boot.")
    return us.astype(np.int64) * 1000

"""Logs of PX4 (.ulg): ULog, as its specification has it.

Rate in rad/s and specific force in m/s^2 in the autopilot's axes: x forward, y to the right, z
down, so that a level vehicle at rest reads -9.81 on z. All of it is turned about x to handcal's
axes, forward, left, up, and that is said. The raw sensor_gyro and sensor_accel, the first of each,
are taken where they were logged as often as sensor_combined, which PX4 has corrected by a
calibration of its own: that is said. ``--topic gyro=sensor_gyro_1 --topic accel=sensor_accel_1``
takes another instance, named as ulog2csv names it. The magnetometer, gauss, is sensor_mag beside
the raw ones, else vehicle_magnetometer. Of a mocap's pose body and world, whose z is down, are
turned alike. Stamps: us since boot. The parameters of PX4's own calibration go with the recording:
exports add to them what is found in readings that they have corrected.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._autopilot import (
    TURNED,
    Fields,
    Parameters,
    cut,
    floats,
    nanoseconds,
    rows,
    vector,
)
from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import HALVES, Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._zip import stated, whole
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.types import InputError, Recording

UNDERSTOOD = "a log of PX4 (.ulg)"
UNITS = (
    "rad/s, m/s^2, gauss, m; PX4's axes (forward, right, down: at rest -9.81 on z), read into "
    "forward, left, up (REP 103)"
)
STREAMS_READ = "IMU, magnetometer, temperature, pose (vehicle_mocap_odometry)"
TRIED = "logs written by ULog's specification, which pyulog reads alike"
ENDINGS = (".ulg",)
MARK = "it does not begin with ULog's magic bytes"
MAGIC = b"ULog\x01\x12\x35"
_TOPICS = ("sensor_gyro", "sensor_accel", "sensor_combined", "sensor_mag", "vehicle_magnetometer",
           "vehicle_mocap_odometry", "sensor_selection")  # fmt: skip
HEADER = 16
LARGEST_MESSAGE = 2**16
_KINDS = "BFIMPQARDLCSO"
_DATA, _FLAGS, _FORMAT, _ADDED, _INFO, _PARAMETER = (ord(kind) for kind in "DBFAIP")
# Parameters that say how PX4 corrects its readings (docs.px4.io, "Parameter Reference").
_CALIBRATION = re.compile(
    r"CAL_(ACC|GYRO)\d_(ID|ROT|[XYZ]OFF|[XYZ]SCALE)|SENS_BOARD_(ROT|[XYZ]_OFF)|TC_[AG]_ENABLE"
)
_NUMBERS = {"float": "<f", "int32_t": "<i"}
_FIELD = re.compile(r"(\w+?)(?:\[(\d{1,5})\])? (\w+)")
LACKS = (
    "has neither sensor_combined nor sensor_gyro and sensor_accel. PX4 logs sensor_combined by its "
    "default profile (SDLOG_PROFILE 1), and the raw ones at full rate by lines 'sensor_gyro 0 0' "
    "and 'sensor_accel 0 0' in etc/logging/logger_topics.txt on the card (docs.px4.io, Logging)."
)
_SAID = f"PX4's axes (forward, right, down) were {TURNED_TO_FLU}."
_TYPES = {
    **{f"{sign}int{8 * n}_t": f"<{sign or 'i'}{n}" for sign in ("", "u") for n in (1, 2, 4, 8)},
    "float": "<f4", "double": "<f8", "bool": "<u1", "char": "<u1",
}  # fmt: skip


def can_read(path: Path) -> bool:
    """By its first bytes."""
    return begins_with(path, MAGIC)


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    asked = {f"sensor_{s}": options.topics[s] for s in HALVES if options.topics.get(s)}
    topics, said, log = _topics(path, asked)
    options.progress(1.0)
    said = [*stated("PX4", options), *said, *log.parameters.changes("PX4"), _SAID]
    whole = topics.get("sensor_combined", {})
    raw = all(name in topics for name in _TOPICS[:2]) and (bool(asked) or all(
        2 * len(topics[name]["timestamp"]) > len(whole.get("timestamp", ())) for name in _TOPICS[:2]
    ))  # fmt: skip
    try:
        if raw:
            gyro, accel = (_vector(topics[name], "", 1.0) for name in _TOPICS[:2])
        elif whole and not asked:
            said.append("sensor_combined: PX4 has corrected it by a calibration of its own.")
            gyro = _vector(whole, "gyro_rad", 1.0)
            accel = _vector(whole, "accelerometer_m_s2", 1.0)
            late = whole["accelerometer_timestamp_relative"].astype(np.int64) * 1000
            accel = columns(accel.ns + late, accel.value)
        else:
            raise InputError(f"{path} {LACKS}")
        streams = _further(topics, raw)
    except KeyError as error:
        raise InputError(f"{path}: a topic of its IMU lacks the field {error}.") from error
    names = {
        "imu": ", ".join(asked.get(name, name) for name in _TOPICS[:2])
        if raw
        else "sensor_combined",
        "mag": "sensor_mag" if raw else "vehicle_magnetometer",
        "temperature": "sensor_accel",
        "pose": "vehicle_mocap_odometry",
    }
    made = assemble(path, gyro, accel, streams, tuple(said))
    read_from = {s: names[s] for s in ("imu", *made.streams)}
    return replace(made, topics=read_from, device=log.told.get("sys_uuid", ""),
                   model=log.told.get("ver_hw", ""),
                   vehicle={**log.parameters.values, **_ids(topics, raw)})  # fmt: skip


def _ids(topics: Mapping[str, Fields], raw: bool) -> dict[str, float]:
    """Of the sensors that were read, as ``topic.field``; where another one took over, 0 of raw
    readings, which are known by it, and else none."""
    fields = (
        [("sensor_gyro", "device_id"), ("sensor_accel", "device_id")]
        if raw
        else [("sensor_selection", f"{sensor}_device_id") for sensor in ("gyro", "accel")]
    )
    found = {f"{name}.{one}": np.unique(topics.get(name, {}).get(one, np.zeros(0)))
             for name, one in fields}  # fmt: skip
    one = {name: float(ids[0]) for name, ids in found.items() if len(ids) == 1}
    return dict.fromkeys(found, 0.0) | one if raw else one


def _topics(path: Path, asked: Mapping[str, str]) -> tuple[dict[str, Fields], list[str], _Log]:
    """Fields by topic, the first instance of each or the one that is asked for, warnings, and what
    else the log says. Errors: InputError."""
    data = whole(path)
    log = _walked(path, data)
    topics: dict[str, Fields] = {}
    there: dict[str, list[str]] = {}
    for id, (instance, name) in sorted(log.names.items(), key=lambda one: one[1][0]):
        layout = _layout(log.formats.get(name, ""))
        starts = [at for at, length in log.places.get(id, ()) if length >= layout.itemsize]
        if not starts or "timestamp" not in (layout.names or ()):
            continue
        own = f"{name}_{instance}"
        there.setdefault(name, []).append(own)
        if name not in topics and asked.get(name, own) in (own, "" if instance else name):
            topics[name] = rows(data, starts, layout)
    for name, one in asked.items():
        if name not in topics:
            known = ", ".join(there.get(name, [f"no {name}"]))
            raise InputError(f"--topic {name[7:]}={one}: {path} has {known}.")
    said = [] if log.whole else [cut(log.messages)]
    further = [(name[7:], own[-1]) for name, own in there.items()
               if name in _TOPICS[:2] and name not in asked and len(own) > 1]  # fmt: skip
    if further:
        options = " ".join(f"--topic {sensor}={own}" for sensor, own in further)
        said.append(f"The log has further IMUs, of which the first was read; another: {options}.")
    return topics, said, log


@dataclass
class _Log:
    """What a walk found: formats by topic; instance and topic, and places, by id; what the log says
    of its device; parameters of its calibration, and those whose value changed."""

    formats: dict[str, str] = field(default_factory=dict)
    names: dict[int, tuple[int, str]] = field(default_factory=dict)
    places: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    messages: int = 0
    whole: bool = True
    told: dict[str, str] = field(default_factory=dict)
    parameters: Parameters = field(default_factory=Parameters)

    def add_parameter(self, message: bytes) -> None:
        """A parameter message."""
        key, value = _keyed(message)
        kind, _, name = key.partition(" ")
        if kind not in _NUMBERS or len(value) != 4 or not _CALIBRATION.fullmatch(name):
            return
        self.parameters.add(name, float(struct.unpack(_NUMBERS[kind], value)[0]))


def _walked(path: Path, data: bytes) -> _Log:
    """Every message of the log, until something is none. Errors: InputError."""
    log, at, ends = _Log(), HEADER, [len(data)]
    head = struct.Struct("<HB").unpack_from
    while at < len(data):
        end = next(e for e in ends if e > at)
        if at + 3 > end:
            at, log.whole = end, log.whole and end < len(data)
            continue
        length, kind = head(data, at)
        begin, following = at + 3, at + 3 + length
        if chr(kind) not in _KINDS or following > end:
            # Where data were appended after a crash, what is before them may be cut.
            at, log.whole = end, log.whole and end < len(data)
            continue
        if kind == _DATA and length > 2:
            (id,) = struct.unpack_from("<H", data, begin)
            if id in log.names:
                log.places.setdefault(id, []).append((begin + 2, length - 2))
                log.messages += 1
        elif kind == _INFO and length:
            log.told |= _told(data[begin:following])
        elif kind == _PARAMETER and length:
            log.add_parameter(data[begin:following])
        elif kind == _FLAGS and length >= 40:
            ends = _ends(path, data[begin:following], len(data))
        elif kind == _FORMAT:
            name, _, fields = data[begin:following].decode("ascii", "replace").partition(":")
            if name in _TOPICS:
                log.formats[name] = fields
        elif kind == _ADDED and length > 3:
            instance, id = struct.unpack_from("<BH", data, begin)
            name = data[begin + 3 : following].decode("ascii", "replace")
            if name in _TOPICS:
                log.names[id] = (instance, name)
        at = following
    return log


def _keyed(message: bytes) -> tuple[str, bytes]:
    """Key (type and name) and value of a message: length of the key, key, value."""
    key, value = message[1 : 1 + message[0]], message[1 + message[0] :]
    return key.decode("ascii", "replace"), value


def _told(message: bytes) -> dict[str, str]:
    """A text about the device in an information message."""
    key, value = _keyed(message)
    kind, _, name = key.partition(" ")
    if not kind.startswith("char[") or name not in ("sys_uuid", "ver_hw"):
        return {}
    return {name: value.decode("utf-8", "replace").strip("\0 ")}


def _ends(path: Path, flags: bytes, size: int) -> list[int]:
    """Where each part that was written at once ends. Errors: InputError for unknown flags."""
    if flags[8] & ~1 or any(flags[9:16]):
        raise InputError(f"{path} needs what this reader of ULog does not know.")
    appended = struct.unpack_from("<3Q", flags, 16) if flags[8] & 1 else ()
    return [*sorted(offset for offset in appended if HEADER < offset < size), size]


def _layout(fields: str) -> np.dtype[np.void]:
    """The fields that can be read of a message, until one of unknown type; arrays as name[0]."""
    found: list[tuple[str, str]] = []
    size = 0
    for one in fields.split(";"):
        match = _FIELD.fullmatch(one.strip())
        code = _TYPES.get(match[1]) if match else None
        if match is None or code is None:
            break
        count = int(match[2] or 1)
        size += count * int(code[-1])
        if size > LARGEST_MESSAGE:
            break
        name = match[3]
        found += [(f"{name}[{k}]", code) for k in range(count)] if match[2] else [(name, code)]
    while found and found[-1][0].startswith("_padding"):
        found.pop()  # (of the last field none is written)
    return np.dtype(list(dict(found).items()))


def _further(topics: Mapping[str, Fields], raw: bool) -> dict[str, Columns]:
    """The streams beside the IMU."""
    streams = {}
    if raw and "sensor_mag" in topics:
        streams["mag"] = _vector(topics["sensor_mag"], "", 1e-4)
    elif not raw and "vehicle_magnetometer" in topics:
        streams["mag"] = _vector(topics["vehicle_magnetometer"], "magnetometer_ga", 1e-4)
    if raw and "temperature" in topics["sensor_accel"]:
        fields = topics["sensor_accel"]
        streams["temperature"] = columns(
            nanoseconds(fields[_stamp(fields)]), floats(fields["temperature"])[:, None]
        )
    if "vehicle_mocap_odometry" in topics:
        fields = topics["vehicle_mocap_odometry"]
        place, q = (
            np.column_stack([floats(fields[f"{name}[{k}]"]) for k in range(n)])
            for name, n in (("position", 3), ("q", 4))
        )
        turned = np.hstack([place * TURNED, q[:, :2], -q[:, 2:]])
        streams["pose"] = columns(nanoseconds(fields[_stamp(fields)]), turned)
    return streams


def _vector(fields: Fields, name: str, factor: float) -> Columns:
    """A vector (n, 3) in forward, left, up."""
    names = [f"{name}[{k}]" for k in range(3)] if name else ["x", "y", "z"]
    return vector(fields, names, _stamp(fields), factor)


def _stamp(fields: Fields) -> str:
    """The field that says when the sample was taken, else when it was published."""
    return "timestamp_sample" if "timestamp_sample" in fields else "timestamp"

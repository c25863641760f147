"""Dataflash logs of ArduPilot (.bin), which describe themselves.

A message is A3 95, its kind, and fields of a fixed layout; FMT messages (kind 80) give a kind's
length, name, types of fields (a letter each) and their names (ardupilot.org/dev, "Code Overview:
Adding a new Log Message"; libraries/AP_Logger/LogStructure.h). Read is the first IMU: GYR and ACC
where they have more readings than IMU (LOG_BITMASK with Raw IMU), else IMU. Rate in rad/s and
specific force in m/s^2 in x forward, y right, z down; the magnetometer, milligauss, is MAG. All of
it is turned about x to handcal's axes, forward, left, up, and that is said. Stamps: us since boot.

All that is logged ArduPilot has corrected by INS_GYROFFS_*, INS_ACCOFFS_* and INS_ACCSCAL_*
(AP_InertialSensor_Backend.cpp), which are in the log as PARM and go with the recording:
``export --to ardupilot`` adds to them what is found.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._autopilot import (
    Fields,
    Parameters,
    cut,
    floats,
    nanoseconds,
    rows,
    vector,
)
from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import assemble, columns
from handcal.recordings.inputs._zip import stated, whole
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.types import InputError, Recording

UNDERSTOOD = "a dataflash log of ArduPilot (.bin)"
UNITS = (
    "rad/s, m/s^2, milligauss; ArduPilot's axes (forward, right, down: at rest -9.81 on z), read "
    "into forward, left, up (REP 103)"
)
STREAMS_READ = "IMU, magnetometer, temperature"
TRIED = "logs written by the documented layout, which pymavlink reads alike"
ENDINGS = (".bin",)
MARK = "it does not begin with the FMT message of ArduPilot's logs"
HEAD = b"\xa3\x95"
_FORMAT, _FORMAT_LENGTH = 0x80, 89
_FORMAT_LAYOUT = np.dtype(
    [("kind", "u1"), ("length", "u1"), ("name", "S4"), ("types", "S16"), ("labels", "S64")]
)
# (of scaled integers and arrays no field is read, so their bytes are enough)
_TYPES = {
    "b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8",
    "Q": "<u8", "g": "<f2", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64", "c": "V2",
    "C": "V2", "e": "V4", "E": "V4", "L": "V4", "a": "V64",
}  # fmt: skip
_IMU = ("IMU", "GYR", "ACC")
_WANTED = (*_IMU, "MAG", "PARM")
_CALIBRATION = re.compile(r"INS_(GYROFFS|ACCOFFS|ACCSCAL)_[XYZ]|AHRS_ORIENTATION")
_Named = tuple[str, np.dtype[np.void]]  # a message's name and its fields
_GYRO, _ACCEL, _MAG = ([f"{name}{a}" for a in "XYZ"] for name in ("Gyr", "Acc", "Mag"))


def can_read(path: Path) -> bool:
    """By its first bytes."""
    return begins_with(path, HEAD + bytes([_FORMAT]))


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    messages, said = _messages(whole(path))
    options.progress(1.0)
    imu, gyr, acc = (messages.get(name, {}) for name in _IMU)
    raw = min(_count(gyr), _count(acc)) > _count(imu)
    if not raw and not imu:
        raise InputError(f"{path} has neither IMU nor GYR and ACC messages of a first IMU.")
    streams = {}
    try:
        if raw:
            gyro, accel = vector(gyr, _GYRO, "SampleUS"), vector(acc, _ACCEL, "SampleUS")
        else:
            gyro, accel = vector(imu, _GYRO, "TimeUS"), vector(imu, _ACCEL, "TimeUS")
        if "MAG" in messages:
            streams["mag"] = vector(messages["MAG"], _MAG, "TimeUS", 1e-7)
        if "T" in imu:
            streams["temperature"] = columns(nanoseconds(imu["TimeUS"]), floats(imu["T"])[:, None])
    except KeyError as error:
        raise InputError(f"{path}: a message of its IMU lacks the field {error}.") from error
    own, read_from = _parameters(messages.get("PARM", {})), "GYR, ACC" if raw else "IMU"
    said = [
        *stated("ArduPilot", options), *said, *own.changes("ArduPilot"),
        f"ArduPilot's axes (forward, right, down) were {TURNED_TO_FLU}.",
        f"{read_from}: ArduPilot has corrected it by a calibration of its own.",
    ]  # fmt: skip
    made = assemble(path, gyro, accel, streams, tuple(said))
    topics = {"imu": read_from, "mag": "MAG", "temperature": "IMU"}
    return replace(made, topics={s: topics[s] for s in ("imu", *made.streams)}, vehicle=own.values)


def _count(fields: Fields) -> int:
    return len(next(iter(fields.values()), ()))


def _messages(data: bytes) -> tuple[dict[str, Fields], list[str]]:
    """Fields by name of message, of the first instance, and what is to be said of the file."""
    lengths, places = {_FORMAT: _FORMAT_LENGTH}, dict[int, list[int]]()
    named: dict[int, _Named] = {}
    at, count, complete = 0, 0, True
    while 0 <= at < len(data):
        kind = data[at + 2] if at + 2 < len(data) else -1
        length = lengths.get(kind, 0)
        if not length or not data.startswith(HEAD, at) or at + length > len(data):
            at, complete = data.find(HEAD, at + 1), False
            continue
        if kind == _FORMAT:
            _described(data[at + 3 : at + length], lengths, named)
        elif kind in named:
            places.setdefault(kind, []).append(at + 3)
        at, count = at + length, count + 1
    found = {named[kind][0]: rows(data, starts, named[kind][1]) for kind, starts in places.items()}
    firsts = {name: one for name, f in found.items() if _count(one := _first(f))}
    said = [] if complete else [cut(count)]
    if any(_count(firsts.get(name, {})) < _count(found[name]) for name in _IMU if name in found):
        said.append("The log has further IMUs; of ArduPilot only the first is read.")
    return firsts, said


def _described(message: bytes, lengths: dict[int, int], named: dict[int, _Named]) -> None:
    """Take in an FMT message, the first of a kind."""
    row = np.frombuffer(message, _FORMAT_LAYOUT)[0]
    kind, length = int(row["kind"]), int(row["length"])
    name, types, labels = (
        row[c].decode("ascii", "replace").strip() for c in ("name", "types", "labels")
    )
    if kind in lengths or length < 3:
        return
    lengths[kind] = length
    fields, codes = labels.split(","), [_TYPES.get(t) for t in types]
    if name not in _WANTED or not all(fields) or not all(codes):
        return
    if len(fields) == len(codes) == len(set(fields)):
        layout = np.dtype(list(zip(fields, codes, strict=True)))
        if layout.itemsize + 3 == length:
            named[kind] = name, layout


def _first(fields: Fields) -> Fields:
    """What is of the first sensor of its kind, in logs that number them."""
    if "I" not in fields:
        return fields
    return {name: values[fields["I"] == 0] for name, values in fields.items()}


def _parameters(fields: Fields) -> Parameters:
    """Those of the calibration."""
    own = Parameters()
    if not {"Name", "Value"} <= set(fields) or fields["Name"].dtype.kind != "S":
        return own
    for name, value in zip(fields["Name"], floats(fields["Value"]).tolist(), strict=True):
        text = name.decode("ascii", "replace")
        if _CALIBRATION.fullmatch(text) and np.isfinite(value):
            own.add(text, value)
    return own

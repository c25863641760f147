"""Folders and zips that the x-IMU3 software writes (xio Technologies): Inertial.csv and its like.

A header names quantities and units: `Time (s)` or `Timestamp (us)`, gyroscope in deg/s,
accelerometer in g with +1 on the axis up at rest, in the axes printed on the device. The
magnetometer is read where its unit is one of a field; x-IMU3 writes it in parts of the field at
its calibration (a.u.), of which no tesla can be made, and then it is left out and that is said.
"""

from __future__ import annotations

from pathlib import Path

from handcal.recordings.inputs._options import Options, parse_unit, unit_factor
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import (
    Rows,
    numbers,
    places,
    plain_name,
    rows_of,
    times,
    unit_in,
)
from handcal.recordings.inputs._zip import beginnings, by_name, contents, stated
from handcal.types import InputError, Recording

UNDERSTOOD = "a folder or zip of the x-IMU3 software (Inertial.csv)"
UNITS = (
    "as the header's brackets say: deg/s, g; at rest +1 g on the axis up; the magnetometer in uT"
)
STREAMS_READ = "IMU, magnetometer (not in a.u.), temperature"
TRIED = "files written by the layout of xio's exports"
MEMBERS = ("Inertial.csv", "Magnetometer.csv")
_FILES = ("inertial.csv", "magnetometer.csv", "temperature.csv")
_TIMES = ("time", "timestamp")


def can_read(path: Path) -> bool:
    """By the header of Inertial.csv."""
    found = by_name(beginnings(path, lambda name: name.lower().endswith("inertial.csv")))
    first = found.get(_FILES[0], b"").partition(b"\n")[0]
    return b"Gyroscope X" in first and b"Accelerometer X" in first


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    files = by_name(contents(path, lambda name: name.rsplit("/", 1)[-1].lower() in _FILES, options))
    options.progress(1.0)
    said = list(stated("x-IMU3", options))
    inertial = rows_of(files[_FILES[0]], f"{path}: Inertial.csv")
    gyro = _sensor(inertial, "gyro", _axes("gyroscope"))
    accel = _sensor(inertial, "accel", _axes("accelerometer"))
    streams = {}
    for stream, name, wanted in (
        ("mag", _FILES[1], _axes("magnetometer")),
        ("temperature", _FILES[2], ("temperature",)),
    ):
        rows = rows_of(files[name], f"{path}: {name}") if files.get(name, b"").strip() else inertial
        if wanted[0] not in map(plain_name, rows.names):
            continue
        unit = unit_in(rows.names[places(rows, wanted)[0]])
        if parse_unit(stream, unit) is None:
            said.append(f"{stream}: its unit is {unit or 'not stated'}; it was left out.")
        elif rows.body:
            streams[stream] = _sensor(rows, stream, wanted)
    return assemble(path, gyro, accel, streams, tuple(said))


def _axes(sensor: str) -> tuple[str, ...]:
    return tuple(f"{sensor}_{axis}" for axis in "xyz")


def _sensor(rows: Rows, quantity: str, wanted: tuple[str, ...]) -> Columns:
    """Columns in SI by the units of their header. Errors: InputError."""
    plain = [plain_name(name) for name in rows.names]
    time = next((k for k, name in enumerate(plain) if name in _TIMES), None)
    if time is None:
        raise InputError(f"{rows.where} lacks a column of time.")
    at = places(rows, wanted)
    units = {parse_unit(quantity, unit_in(rows.names[k])) for k in at}
    (unit,) = units if len(units) == 1 else (None,)
    clock = parse_unit("time", unit_in(rows.names[time]))
    if unit is None or clock is None:
        raise InputError(f"{rows.where}: the unit of {wanted[0]} or of time is not understood.")
    if not rows.body:
        raise InputError(f"{rows.where} has a header but no rows.")
    ns = times(rows, time, unit_factor("time", clock))
    return columns(ns, numbers(rows, at) * unit_factor(quantity, unit))

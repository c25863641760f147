"""Exports of the Sensor Logger app (iOS and Android): zip, folder of CSV files, JSON or SQLite.

Units and signs differ between the systems. Android: m/s^2, screen up reads +9.81 on z.
iOS: the other sign, and the uncalibrated accelerometer in g; unless the app was told to
standardise, which makes everything as on Android. Metadata say which; without them, the
magnitude at rest does. Only raw classes are fit for calibration: the others have had a
changing bias taken out by the phone.
"""

from __future__ import annotations

import csv
import io
import json
import sqlite3
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns, magnitude_at_rest
from handcal.recordings.inputs._rows import numbers, rows_of, whole_numbers
from handcal.recordings.inputs._sqlite import is_database, opened, tables
from handcal.recordings.inputs._zip import LARGEST, beginnings, contents, listing, stated
from handcal.types import InputError, IntArray, Recording

IN_G = 3.0  # what reads less at rest reads g, not m/s^2
UNDERSTOOD = "an export of the Sensor Logger app (zip, folder, JSON or SQLite)"
UNITS = (
    "rad/s, m/s^2, uT; of iOS the uncalibrated accelerometer in g, and signs turned: "
    "at rest -1 g on the axis up"
)
UNITS_OF = {
    "android": "rad/s, m/s^2, uT; at rest +g on the axis up",
    "ios": "rad/s, uT, the uncalibrated accelerometer in g; signs turned: at rest -1 g on the axis "
    "up",
}
STREAMS_READ = "IMU, magnetometer"
TRIED = (
    "real exports of iOS and Android, the second equal to its conversion by other hands; JSON and "
    "SQLite written by the documented layout"
)
GYROS = ("GyroscopeUncalibrated", "Gyroscope")
MAGS = ("MagnetometerUncalibrated", "Magnetometer")
ACCELS = ("AccelerometerUncalibrated", "TotalAcceleration", "Accelerometer", "Gravity")
SENSORS = (*GYROS, *MAGS, *ACCELS)
# Bytes of a cell, or of the words that a table was made with, and rows in memory at a time: a
# column may be computed of nothing, and would otherwise be as long as it says.
LARGEST_CELL, _AT_ONCE = 2**14, 1000
_CELLS = ("time", "x", "y", "z")  # what is read of a row
MEMBERS = (f"{GYROS[0]}.csv", f"{ACCELS[0]}.csv")


@dataclass(frozen=True)
class _Export:
    """What the export holds: sensors as they are in it; platform, device and model if it says."""

    sensors: Mapping[str, Columns]
    platform: str
    standardised: bool
    device: str = ""
    model: str = ""


def can_read(path: Path) -> bool:
    """By the names of the files in it and what their columns are called (phyphox has the same
    names, the x-IMU3 one of them), by the first bytes of the JSON, or by the tables of the
    database."""
    if listing(path) is not None:
        found = beginnings(path, lambda name: _stem(name) in SENSORS)
        others = (b"Time (", b"Timestamp")
        return any(not t.lstrip(b'\xef\xbb\xbf"').startswith(others) for t in found.values())
    if zipfile.is_zipfile(path):
        return False
    if is_database(path):
        return not tables(path).isdisjoint(SENSORS)
    with path.open("rb") as file:
        start = file.read(4096).lstrip(b"\xef\xbb\xbf \t\r\n")
    return start.startswith(b"[") and b'"sensor"' in start


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    if path.is_dir() or zipfile.is_zipfile(path):
        export = _from_files(path, options)
    else:
        export = _from_database(path) if is_database(path) else _from_json(path)
    options.progress(1.0)
    said = list(stated("Sensor Logger", options))
    gyro = _first(export, GYROS, said)
    if gyro is None:
        held = ", ".join(sorted(export.sensors)) or "no motion sensor"
        raise InputError(f"{path} has no gyroscope readings; it holds {held}.")
    accel = _specific_force(path, export, said)
    mag = _first(export, MAGS, said)
    streams = {} if mag is None else {"mag": columns(mag.ns, mag.value * 1e-6)}
    made = assemble(path, gyro, accel, streams, tuple(said))
    signs = "android" if export.standardised else export.platform
    return replace(
        made, device=export.device, model=export.model, file_units=UNITS_OF.get(signs, "")
    )


def _first(export: _Export, names: tuple[str, str], said: list[str]) -> Columns | None:
    """The raw class, or the corrected one with a warning, or None."""
    raw, corrected = names
    if raw in export.sensors:
        return export.sensors[raw]
    if corrected in export.sensors:
        said.append(
            f"{raw} is absent or empty: {corrected} is used, from which the phone may have "
            "taken a changing bias."
        )
    return export.sensors.get(corrected)


def _specific_force(path: Path, export: _Export, said: list[str]) -> Columns:
    """Specific force in m/s^2 in Android's signs. Errors: InputError."""
    sensors = export.sensors
    if "AccelerometerUncalibrated" in sensors:
        raw = sensors["AccelerometerUncalibrated"]
        apple = _apple(export, raw, said)
        return columns(raw.ns, raw.value * (-STANDARD_GRAVITY if apple else 1.0))
    said.append("AccelerometerUncalibrated is absent or empty: a corrected one is used.")
    if "TotalAcceleration" in sensors:
        raw = sensors["TotalAcceleration"]
    elif "Accelerometer" in sensors and "Gravity" in sensors:
        raw = _sum(sensors["Accelerometer"], sensors["Gravity"])
    else:
        raise InputError(
            f"{path} has no accelerometer with gravity in it: AccelerometerUncalibrated, "
            "TotalAcceleration, or Accelerometer and Gravity are needed."
        )
    if not export.platform and "TotalAcceleration" not in sensors:
        raise InputError(
            f"{path} does not say whether it is from iOS or Android, which differ in sign: "
            "Metadata.csv with a column platform is needed."
        )
    unit = STANDARD_GRAVITY if magnitude_at_rest(raw) < IN_G else 1.0
    return columns(raw.ns, raw.value * (-unit if _apple(export, raw, said) else unit))


def _apple(export: _Export, raw: Columns, said: list[str]) -> bool:
    """Whether forces have the signs of iOS; where no metadata tells, what they are taken for is
    said."""
    if export.platform:
        return export.platform == "ios" and not export.standardised
    rest = magnitude_at_rest(raw)
    signs = "g in the signs of iOS" if rest < IN_G else "m/s^2 in the signs of Android"
    said.append(
        f"No metadata: the accelerometer reads {rest:.2f} at rest, taken for {signs} (of the other "
        "system up is down: keep Metadata.csv beside the sensors)."
    )
    return rest < IN_G


def _sum(motion: Columns, gravity: Columns) -> Columns:
    """Both come from one fusion, mostly with equal stamps; else gravity is interpolated."""
    order = np.argsort(gravity.ns, kind="stable")
    zero = int(motion.ns[0])
    t, tg = (motion.ns - zero) / 1e9, (gravity.ns[order] - zero) / 1e9
    inside = (t >= tg[0]) & (t <= tg[-1])
    parts = [np.interp(t[inside], tg, axis) for axis in gravity.value[order].T]
    return columns(motion.ns[inside], motion.value[inside] + np.column_stack(parts))


def _stem(name: str) -> str:
    """``folder/Gyroscope.csv`` is Gyroscope."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    return last[:-4] if last.lower().endswith(".csv") else ""


def _from_files(path: Path, options: Options) -> _Export:
    """Of a folder or zip: one CSV file a sensor, wherever it lies in it."""
    found = contents(path, lambda name: _stem(name) in (*SENSORS, "Metadata"), options)
    return _from_texts(path, {_stem(name): text for name, text in reversed(list(found.items()))})


def _from_texts(path: Path, texts: Mapping[str, bytes]) -> _Export:
    sensors = {}
    for name, content in texts.items():
        table = _table(path, name, content) if name != "Metadata" and content.strip() else None
        if table is not None:
            sensors[name] = table
    rows = csv.DictReader(io.StringIO(texts.get("Metadata", b"").decode("utf-8-sig", "replace")))
    try:
        return _export(sensors, next(iter(rows), {}))
    except csv.Error as error:
        raise InputError(f"{path}: Metadata.csv is damaged.") from error


def _export(sensors: Mapping[str, Columns], metadata: Mapping[str, object]) -> _Export:
    platform = str(metadata.get("platform", "")).strip().lower()
    platform = "ios" if platform in ("ios", "iphone", "ipados") else platform
    standardised = str(metadata.get("standardisation", "")).strip().lower() == "true"
    device, model = (str(metadata.get(k) or "").strip() for k in ("device id", "device name"))
    known = platform if platform in ("ios", "android") else ""
    return _Export(sensors, known, standardised, device, model)


def _table(path: Path, name: str, content: bytes) -> Columns | None:
    """One sensor's CSV, or None if it has no rows. Errors: InputError."""
    rows = rows_of(content, f"{path}: {name}.csv", separator=",")
    if not rows.body:
        return None
    if not {"time", "x", "y", "z"} <= set(rows.names):
        raise InputError(f"{rows.where} lacks one of the columns time, x, y, z.")
    rows = replace(rows, where=f"{rows.where} is damaged")
    ns = whole_numbers(rows, rows.names.index("time"))
    if ns is None:
        raise InputError(f"{rows.where}: a time is no whole number.")
    value = numbers(rows, [rows.names.index(axis) for axis in "xyz"])
    return columns(_checked_ns(path, ns), value)


def _checked_ns(path: Path, ns: IntArray) -> IntArray:
    if np.any(ns > 9 * 10**18) or np.any(ns < 0):
        raise InputError(f"{path} has a time stamp that is no time since 1970.")
    return ns


def _from_json(path: Path) -> _Export:
    """An array of objects whose values are all strings, one object a reading."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} is too large to be read as JSON: export it as zip.")
    try:
        entries = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not whole JSON: it may be truncated.") from error
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise InputError(f"{path} is not an array of readings.")
    rows: dict[str, list[tuple[object, ...]]] = {}
    metadata: dict[str, object] = {}
    for entry in entries:
        name = str(entry.get("sensor"))
        if name in SENSORS:
            rows.setdefault(name, []).append(tuple(entry.get(key) for key in _CELLS))
        elif "platform" in entry:
            metadata = entry
    return _export({name: _of_cells(path, name, found) for name, found in rows.items()}, metadata)


def _from_database(path: Path) -> _Export:
    """One table a sensor, its columns called as in the CSV, its values numbers or text."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} is too large to be read as a database: export it as zip.")
    there = tables(path)
    sensors, metadata = {}, {}
    with opened(path) as database:
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_CELL)
        for name in (sensor for sensor in SENSORS if sensor in there):
            cursor = database.execute(f'SELECT {", ".join(_CELLS)} FROM "{name}"')
            parts = []
            while rows := cursor.fetchmany(_AT_ONCE):
                parts.append(_of_cells(path, name, rows))
            if parts:
                ns, value = (
                    np.concatenate([getattr(p, n) for p in parts]) for n in ("ns", "value")
                )
                sensors[name] = columns(ns, value)
        for name in (table for table in there if table.lower() == "metadata"):
            cursor = database.execute(f'SELECT * FROM "{name.replace(chr(34), chr(34) * 2)}"')
            keys = [str(column[0]) for column in cursor.description]
            metadata = dict(zip(keys, cursor.fetchone() or (), strict=False))
    return _export(sensors, metadata)


def _of_cells(path: Path, name: str, rows: Sequence[Sequence[object]]) -> Columns:
    """Stamps and readings of rows of time, x, y, z, each a number or its text. Errors:
    InputError."""
    try:
        ns = np.array([int(str(row[0])) for row in rows], dtype=np.int64)
        value = np.array([[float(str(cell)) for cell in row[1:]] for row in rows])
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: a reading of {name} lacks time, x, y or z.") from error
    return columns(_checked_ns(path, ns), value)

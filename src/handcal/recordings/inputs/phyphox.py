"""Exports of the phyphox app (Android and iOS): zip or folder of CSV files, or Excel (.xls).

A table a sensor, its columns `Time (s)` and three axes with their unit, in any of the app's
separators. Body axes are Android's: x to the right and y to the top of the screen, z out of it;
at rest the axis up reads +g on both systems. On iOS phyphox makes m/s^2 of g by -9.81, so the
readings of a device that says it is Apple's are multiplied by 9.80665/9.81. Without metadata
nothing is changed and that is said. Time is the experiment's, which stands still while it is
paused; the table of events gives the clock's, so that a pause is a gap. Linear acceleration has
had gravity taken out and is not read. An .xls is read with xlrd: a binary (BIFF8) workbook.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns, nanoseconds
from handcal.recordings.inputs._rows import numbers, rows_of, unit_in
from handcal.recordings.inputs._zip import beginnings, contents, listing, stated, whole
from handcal.types import Array, InputError, IntArray, Recording

UNDERSTOOD = "an export of the phyphox app (zip or folder of CSV, one CSV, or .xls)"
_SYSTEMS = "as the header's brackets say (rad/s, m/s^2, uT); at rest +g on the axis up"
UNITS = f"{_SYSTEMS}; of iOS 9.81 to a g, which is put right"
STREAMS_READ = "IMU, magnetometer"
TRIED = (
    "two real exports (a zip of an iPhone, an .xls), their numbers compared, both refused with a "
    "reason; files written by the layout of such exports"
)
MEMBERS = ("Accelerometer.csv", "Gyroscope.csv", "device.csv", "time.csv")
ENDINGS = (".xls",)
MARK = "it does not begin as an Excel workbook (.xls) does"
PHYPHOX_G = 9.81
LARGEST_XLS = 48 * 2**20
LARGEST_META = 2**16
_WORKBOOK = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_AXIS = re.compile(r"(?:^|[\s_])([xyz])\s*$")
_QUANTITIES = {"rad/s": "gyro", "m/s^2": "accel", "m/s\u00b2": "accel",
               "ut": "mag", "\u00b5t": "mag", "\u03bct": "mag"}  # fmt: skip
_CORRECTED = ("linear", "gravity", "without g")
# What xlrd ends in where a workbook is damaged: it trusts every length in it.
_DAMAGED = (struct.error, ValueError, LookupError, TypeError, AttributeError, AssertionError,
            ArithmeticError, EOFError, NotImplementedError, RecursionError, NameError)  # fmt: skip


@dataclass(frozen=True)
class _Sheet:
    """A table: names of its columns, and its cells as text or numbers, one list a column."""

    name: str
    names: tuple[str, ...]
    value: Array


@dataclass(frozen=True)
class _Export:
    """Tables of numbers; the metadata's properties; starts (k, 2): experiment and system time;
    when the experiment was stopped for good, s."""

    sheets: tuple[_Sheet, ...]
    device: Mapping[str, str]
    starts: Array
    stop: float = np.inf


def can_read(path: Path) -> bool:
    """By the headers of the CSV files in it, by that of a CSV (whose names are in quotes), or as
    an Excel workbook."""
    if listing(path) is not None:
        found = beginnings(path, lambda name: name.lower().endswith(".csv"))
        return any(_sensors("", _header(text)) for text in found.values())
    return begins_with(path, _WORKBOOK) or _is_table(path)


def _is_table(path: Path) -> bool:
    """Whether a file is a table of a sensor: other programs' have no quotes about their names."""
    with path.open("rb") as file:
        line = file.readline(LARGEST_META).removeprefix(b"\xef\xbb\xbf")
    return line.startswith(b'"Time (s)"') and bool(_sensors("", _header(line)))


def _header(text: bytes) -> tuple[str, ...]:
    """The names in a CSV's first line; () where it does not begin with phyphox's time."""
    line = text.decode("utf-8-sig", "replace").partition("\n")[0]
    separator = max(",;\t", key=line.count)
    names = tuple(cell.strip().strip('"') for cell in line.split(separator))
    return names if names[0] == "Time (s)" else ()


def _sensors(table: str, names: Sequence[str]) -> dict[str, list[int]]:
    """The columns of x, y and z, by quantity, of a table that begins with time."""
    found: dict[str, dict[str, int]] = {}
    if not names or names[0] != "Time (s)":
        return {}
    for index, name in enumerate(names):
        plain = name.partition("(")[0].strip().lower()
        axis, quantity = _AXIS.search(plain), _QUANTITIES.get(unit_in(name).lower())
        if axis and quantity and not any(w in f"{table} {plain}".lower() for w in _CORRECTED):
            found.setdefault(quantity, {}).setdefault(axis[1], index)
    return {q: [at[axis] for axis in "xyz"] for q, at in found.items() if len(at) == 3}


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    is_text = listing(path) is not None or not begins_with(path, _WORKBOOK)
    export = _of_files(path, options) if is_text else _of_workbook(path)
    options.progress(1.0)
    said = list(stated("phyphox", options))
    held = _held(path, export)
    _check_held(path, held, export)
    brand = export.device.get("deviceBrand", export.device.get("deviceManufacturer", "")).lower()
    accel = held["accel"]
    if brand == "apple":
        accel = columns(accel.ns, accel.value * (STANDARD_GRAVITY / PHYPHOX_G))
    elif not brand:
        said.append(
            "phyphox does not say here which device it was: of an iPhone's, the accelerometer "
            "reads 0.03 % too much (9.81 to a g)."
        )
    said.append("phyphox does not say whether the phone has taken a bias out of its gyroscope.")
    streams = {"mag": held["mag"]} if "mag" in held else {}
    made = assemble(path, held["gyro"], accel, streams, tuple(said))
    names = (export.device.get(k, "").strip() for k in ("deviceBrand", "deviceModel"))
    own = {"apple": f"{_SYSTEMS}; 9.81 to a g, which is put right", "": ""}.get(brand, _SYSTEMS)
    return replace(made, model=" ".join(n for n in names if n), file_units=own)


def _held(path: Path, export: _Export) -> dict[str, Columns]:
    """The first table of each quantity. Errors: InputError."""
    held: dict[str, Columns] = {}
    factor = {"gyro": 1.0, "accel": 1.0, "mag": 1e-6}
    for sheet in export.sheets:
        for quantity, at in _sensors(sheet.name, sheet.names).items():
            if quantity not in held and len(sheet.value):
                finite = np.isfinite(sheet.value[:, 0])
                t = sheet.value[finite, 0]
                if len(t) and t.max() > export.stop + 1.0:
                    raise InputError(
                        f"{path}: {sheet.name} goes on to {t.max():.1f} s, where the experiment "
                        f"was stopped at {export.stop:.1f} s: these tables are of two recordings."
                    )
                ns = _stamps(t, export.starts)
                held[quantity] = columns(ns, factor[quantity] * sheet.value[finite][:, at])
    return held


def _check_held(path: Path, held: Mapping[str, Columns], export: _Export) -> None:
    """Errors: InputError, saying what to record, where a sensor lacks."""
    names = ", ".join(sheet.name for sheet in export.sheets[:6]) or "no table"
    for quantity, sensor in (("gyro", "gyroscope"), ("accel", "accelerometer with gravity")):
        if quantity not in held:
            raise InputError(
                f"{path} has no {sensor} readings; it holds {names}. In phyphox, record the "
                "gyroscope and the accelerometer (with g) together in one experiment of your own; "
                "of an export of several tables give the zip or the folder."
            )


def _stamps(t: Array, starts: Array) -> IntArray:
    """Experiment time (n,) as ns since 1970, or since the start where no events are known."""
    if not len(starts):
        return nanoseconds(t)
    begun = np.clip(np.searchsorted(starts[:, 0], t, side="right") - 1, 0, None)
    return nanoseconds(t - starts[begun, 0]) + nanoseconds(starts[begun, 1])


def _of_files(path: Path, options: Options) -> _Export:
    """Of a zip or folder, or of one table. Errors: InputError."""
    if listing(path) is not None:
        files = contents(path, lambda name: name.lower().endswith(".csv"), options)
    else:
        files = {path.name: whole(path)}
    sheets, texts = [], []
    for name, content in sorted(files.items()):
        if _header(content):
            rows = rows_of(content, f"{path}: {name}")
            stem = name.rsplit("/", 1)[-1][:-4]
            sheets.append(_Sheet(stem, rows.names, numbers(rows, range(len(rows.names)))))
        else:
            lines = content[:LARGEST_META].decode("utf-8-sig", "replace").splitlines()
            separator = max(",;\t", key=lines[0].count) if lines else ","
            texts.append([[c.strip().strip('"') for c in line.split(separator)] for line in lines])
    return _export(sheets, texts)


def _export(sheets: Sequence[_Sheet], texts: Sequence[Sequence[Sequence[object]]]) -> _Export:
    """With the metadata that tables of text hold: properties of the device, and events."""
    device: dict[str, str] = {}
    starts, stop = np.empty((0, 2)), np.inf
    for rows in texts:
        kind = str(rows[0][0]) if rows and rows[0] else ""
        if kind == "property":
            device = {str(row[0]): str(row[1]) for row in rows[1:] if len(row) == 2}
        elif kind == "event":
            events = [
                (str(row[0]), _float(row[1]), _float(row[2])) for row in rows[1:] if len(row) > 2
            ]
            begun = np.array([e[1:] for e in events if e[0] == "START"]).reshape(-1, 2)
            if np.all(np.isfinite(begun)) and np.all(np.diff(begun[:, 0]) >= 0):
                starts = begun
                stop = events[-1][1] if events and events[-1][0] == "PAUSE" else np.inf
    return _Export(tuple(sheets), device, starts, stop)


def _float(cell: object) -> float:
    """A cell's number, with a point or a comma; NaN for what is none."""
    try:
        return float(str(cell).replace(",", "."))
    except ValueError:
        return np.nan


def _of_workbook(path: Path) -> _Export:
    """Of an .xls. Errors: InputError."""
    import xlrd

    if path.stat().st_size > LARGEST_XLS:
        raise InputError(f"{path} is too large to be read as .xls: export it as CSV.")
    try:
        book = xlrd.open_workbook(str(path), logfile=io.StringIO(), ragged_rows=True)
        cells = {
            sheet.name: [sheet.row_values(k) for k in range(sheet.nrows)] for sheet in book.sheets()
        }
    except (xlrd.XLRDError, xlrd.compdoc.CompDocError, *_DAMAGED) as error:
        raise InputError(f"{path} is a damaged Excel workbook, or none: {error}.") from error
    sheets, texts = [], []
    for name, rows in cells.items():
        names = tuple(str(cell) for cell in rows[0]) if rows else ()
        if names[:1] == ("Time (s)",):
            value = [_floats(row, len(names)) for row in rows[1:]]
            sheets.append(_Sheet(name, names, np.array(value).reshape(-1, len(names))))
        else:
            texts.append(rows)
    return _export(sheets, texts)


def _floats(row: Sequence[object], size: int) -> list[float]:
    """A row's numbers; NaN for what is none."""
    found = [float(cell) if isinstance(cell, float | int) else np.nan for cell in row[:size]]
    return found + [np.nan] * (size - len(found))

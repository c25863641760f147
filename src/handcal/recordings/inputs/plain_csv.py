"""Plain CSV: one header line that names the columns, one row a sample.

Header names, in any case: ``t`` or ``time``; ``gx gy gz``, ``ax ay az``, ``mx my mz``,
``temp``, ``heading``; or long ones such as ``Gyroscope X``. A unit may follow in round or
square brackets, as in ``Gyroscope X (deg/s)``; without one it is SI (s, rad/s, m/s^2, tesla, degC,
rad), and ``--units`` overrules both. Separators: comma, semicolon, tab. Empty cells are
readings that were not taken.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from handcal.recordings.inputs._cut import whole_lines
from handcal.recordings.inputs._options import ALONE, Options, parse_unit, quantities
from handcal.recordings.inputs._repair import (
    Columns,
    assemble,
    assemble_alone,
    columns,
    nanoseconds,
)
from handcal.recordings.inputs._rows import parsed, stamps
from handcal.recordings.streams import STREAMS, Stream
from handcal.types import Array, InputError, IntArray, Recording

UNDERSTOOD = "plain CSV with columns t, gx, gy, gz, ax, ay, az (.csv)"
UNITS = "as the header's brackets say, else SI; signs as handcal's: at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "a real recording of an x-IMU3; tables made by hypothesis"
ENDINGS = (".csv", ".tsv")
LAST = True  # (any CSV is this one, by its name)
_ROWS_AT_ONCE = 20_000
UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE
FEWEST_COLUMNS = 6  # fewer separators than this make no header
_IMU = {
    "gyro": ("g", "gyro", "gyroscope", "w", "angularvelocity"),
    "accel": ("a", "acc", "accel", "accelerometer", "linearacceleration"),
}
_TIMES = ("t", "time", "timestamp")
Places = Mapping[tuple[str, str], int]  # column by quantity and axis


def _axes(row: Stream) -> tuple[str, ...]:
    """What follows the name in a header: nothing where there is one column."""
    return row.columns if len(row.columns) > 1 else ("",)


def _names() -> dict[str, tuple[str, str]]:
    """Quantity and axis by what a column is called."""
    out = dict.fromkeys(_TIMES, ("time", ""))
    out |= {n + axis: (q, axis) for q, names in _IMU.items() for n in names for axis in "xyz"}
    for row in STREAMS.values():
        out |= {name + axis: (row.name, axis) for name in row.csv for axis in _axes(row)}
    return out


def _expected() -> str:
    more = [row.csv[0] + axis for row in STREAMS.values() if row.csv for axis in _axes(row)]
    return f"t, gx, gy, gz, ax, ay, az and, if there, {', '.join(more)}"


def can_read(path: Path) -> bool:
    """By its name; what the header lacks is better said than guessed."""
    return path.is_file() and path.suffix.lower() in (".csv", ".tsv")


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    with path.open("rb") as file:
        if file.read(2) in UTF_16:
            raise InputError(f"{path} is in UTF-16: save it as UTF-8.")
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header, separator = _header(file)
        names = [cell.strip().strip('"') for cell in header.split(separator)]
        return of_table(
            path,
            names,
            options,
            lambda places, units: _table(file, path, separator, places, units, options),
        )


def _header(file: TextIO) -> tuple[str, str]:
    """The line that names the columns, and what is between them; remarks before it are none."""
    while True:
        line = file.readline()
        header = line.lstrip("#").rstrip("\r\n")
        separator = max(",;\t", key=header.count)
        if not line.startswith("#") or header.count(separator) >= FEWEST_COLUMNS:
            return header, separator


def of_table(
    path: Path,
    names: list[str],
    options: Options,
    table: Callable[[Places, Mapping[str, str]], tuple[IntArray, Array]],
) -> Recording:
    """A recording of columns with such names, as a header has them.

    table: of the places of the columns and the units, to stamps (n,) ns and all other columns
    (n, k) in the order of their places, as they are in the file. Errors: InputError.
    """
    places, units, warnings = _understood(path, names, options)
    units = {quantity: options.units.get(quantity, unit) for quantity, unit in units.items()}
    ns, values = table(places, units)
    taken = {quantity: values[:, at] for quantity, at in _slices(places).items()}
    streams: dict[str, Columns] = {}
    for quantity, value in taken.items():
        value *= quantities()[quantity][units[quantity]]
        if quantity not in ("gyro", "accel"):
            streams[quantity] = _measured(quantity, columns(ns, value), warnings)
    sensors = [sensor for sensor in _IMU if sensor in taken]
    if len(sensors) == 1:
        own = columns(ns, taken[sensors[0]])
        return assemble_alone(path, sensors[0], own, streams, tuple(warnings))
    gyro, accel = columns(ns, taken["gyro"]), columns(ns, taken["accel"])
    return assemble(path, gyro, accel, streams, tuple(warnings))


def of_named(path: Path, named: Mapping[str, Array | IntArray], options: Options) -> Recording:
    """A recording of arrays (n,) by what a header would call them. Errors: InputError."""
    names = list(named)

    def table(places: Places, units: Mapping[str, str]) -> tuple[IntArray, Array]:
        time, factor = named[names[places["time", ""]]], quantities()["time"][units["time"]]
        values = [named[names[at]] for key, at in places.items() if key[0] != "time"]
        exact = time.dtype.kind in "iu" and factor < 1e9 and not np.any(time > 9e18 / factor)
        if exact:
            ns: IntArray = time.astype(np.int64) * int(factor)
        else:
            ns = nanoseconds(np.asarray(time, dtype=np.float64), factor)
        return ns, np.column_stack([np.asarray(v, dtype=np.float64) for v in values])

    return of_table(path, names, options, table)


def _understood(
    path: Path, names: list[str], options: Options
) -> tuple[dict[tuple[str, str], int], dict[str, str], list[str]]:
    """Column by quantity and axis, unit by quantity, warnings. Errors: InputError."""
    places: dict[tuple[str, str], int] = {}
    units: dict[str, str] = {}
    unknown, known, choices = [], _names(), quantities()
    for index, name in enumerate(names):
        text, unit_text = _split_unit(name)
        key = known.get(re.sub(r"[\s_.\-]", "", text.lower()))
        if key is None or key in places:
            unknown.append(name)
            continue
        unit = next(iter(choices[key[0]])) if unit_text is None else parse_unit(key[0], unit_text)
        if unit is None or units.get(key[0], unit) != unit:
            raise InputError(
                f"{path}: the unit of column {name!r} is not understood or differs from its "
                f"neighbours'; the units of {key[0]} are {', '.join(choices[key[0]])}."
            )
        places[key], units[key[0]] = index, unit
    missing = [
        f"{q} {axis}".strip() for q, axis in _wanted(places, options) if (q, axis) not in places
    ]
    listed = ", ".join(repr(name[:40]) for name in unknown[:12])
    if missing:
        others = f" Not understood: {listed}." if unknown else ""
        raise InputError(
            f"{path} lacks columns for {', '.join(missing)}.{others} Expected: {_expected()}, "
            f"each with its unit in brackets if it is not SI.{_lone(places)}"
        )
    return places, units, [f"Columns not used: {listed}."] if unknown else []


def _split_unit(name: str) -> tuple[str, str | None]:
    match = re.fullmatch(r"(.*?)\s*[(\[]([^()\[\]]*)[)\]]\s*", name)
    return (match[1], match[2]) if match else (name, None)


def _lone(places: Places) -> str:
    """Where one sensor alone is taken, if there is one alone."""
    return f" {ALONE}" if len({q for q, _ in places} & set(_IMU)) == 1 else ""


def _wanted(places: Places, options: Options) -> list[tuple[str, str]]:
    """Columns that must be there: time, gyro, accel; of a further stream all or nothing."""
    there = {quantity for quantity, _ in places}
    needed = set(options.needs) | (there & set(_IMU)) or set(_IMU)
    wanted = [("time", "")] + [(sensor, axis) for sensor in _IMU for axis in "xyz"
                               if sensor in needed]  # fmt: skip
    rows = [row for row in STREAMS.values() if row.name in there]
    return wanted + [(row.name, axis) for row in rows for axis in _axes(row)]


def _slices(places: Places) -> dict[str, list[int]]:
    """Where each quantity stands in the table that ``_table`` returns, which has no time."""
    order = [key for key in places if key[0] != "time"]
    return {
        quantity: [order.index((quantity, a)) for a in _order(quantity) if (quantity, a) in order]
        for quantity, _ in order
    }


def _order(quantity: str) -> tuple[str, ...]:
    return _axes(STREAMS[quantity]) if quantity in STREAMS else ("x", "y", "z")


def _table(
    file: TextIO,
    path: Path,
    separator: str,
    places: Places,
    units: Mapping[str, str],
    options: Options,
) -> tuple[IntArray, Array]:
    """Stamps (n,) ns and the other columns (n, k) in the order of places. Errors: InputError."""
    size, done = max(1, path.stat().st_size), 0
    moments: list[IntArray] = []
    tables: list[Array] = []
    last: list[str] = []
    factor = quantities()["time"][units["time"]]
    others = [index for key, index in places.items() if key[0] != "time"]
    for number, lines in _blocks(file):
        done += sum(map(len, lines))
        if not lines[-1].endswith("\n"):
            lines = whole_lines([*last, *lines], separator, str(path))[len(last) :]
        if not lines:
            break
        last = lines[-1:]
        if separator != ",":  # then a comma can only be a decimal sign
            lines = [line.replace(",", ".") for line in lines]
        values = parsed(lines, separator, others, str(path), number)
        moments.append(stamps(lines, separator, places["time", ""], factor, str(path), number))
        tables.append(values)
        options.progress(min(1.0, done / size))
    if not moments:
        raise InputError(f"{path} has a header but no rows.")
    options.progress(1.0)
    return np.concatenate(moments), np.concatenate(tables)


def _blocks(file: TextIO) -> Iterator[tuple[int, list[str]]]:
    """Rows that are not blank, with the number of the first line."""
    number = 2
    while lines := list(islice(file, _ROWS_AT_ONCE)):
        rows = [line for line in lines if line.strip()]
        if rows:
            yield number, rows
        number += len(lines)


def _measured(name: str, held: Columns, warnings: list[str]) -> Columns:
    """A slower stream in a table is blank, or repeats itself until its next reading."""
    blank = np.all(np.isnan(held.value), axis=1)
    if blank.any() or len(held.ns) < 2:
        return held.rows(~blank)
    fresh = np.concatenate([[True], np.any(np.diff(held.value, axis=0) != 0, axis=1)])
    # (what nothing observes is known between its readings, so repeating does no harm)
    if not STREAMS[name].observation or fresh.mean() > 0.5:
        return held
    warnings.append(f"{name}: only the {int(fresh.sum())} rows in which it changes are used.")
    return held.rows(fresh)

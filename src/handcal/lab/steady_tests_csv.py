"""Known inputs and averaged readings from a table: one header line, one row a test.

Columns, in any case and order, with a unit in brackets where it is not SI, as ``gx (deg/s)``:

- the input: ``wx wy wz``, the known rate, and ``fx fy fz``, the known specific force (rest,
  x up: ``fx`` reads +g), both in the axes of the table; or ``alpha beta gamma``, the angles
  of a table with three axes (``table.Table``), from which the force follows;
- the averaged readings: ``gx gy gz`` of the gyro, ``ax ay az`` of the accelerometer;
- ``temp``, where it is known.
"""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path

import numpy as np

from handcal.documents import reading
from handcal.lab.steady_tests import Bench, of_arrays
from handcal.lab.stretches import PERFECT
from handcal.lab.table import Table, table
from handcal.recordings.inputs._options import parse_unit, quantities
from handcal.types import Array, InputError

GROUPS = {
    "rate": ("wx", "wy", "wz"),
    "force": ("fx", "fy", "fz"),
    "angles": ("alpha", "beta", "gamma"),
    "gyro": ("gx", "gy", "gz"),
    "accel": ("ax", "ay", "az"),
    "temperature": ("temp",),
}
QUANTITY = {"rate": "gyro", "force": "accel", "angles": "heading", "gyro": "gyro",
            "accel": "accel", "temperature": "temperature"}  # fmt: skip
EXPECTED = (
    "wx wy wz (known rate), fx fy fz (known force) or alpha beta gamma (angles of the table); "
    "readings gx gy gz, ax ay az; temp; units in brackets where they are not SI"
)
MOST_ROWS = 100_000


def read(path: Path, sequence: str, gravity: float) -> tuple[Bench, Table | None]:
    """The tests of a file, and the table where its angles are given. Errors: InputError."""
    values = _columns(path)
    if "angles" in values and "force" in values:
        raise InputError(f"{path} has both the angles of the table and the force: leave one out.")
    if not {"gyro", "accel"} & values.keys():
        raise InputError(f"{path} has no readings. Expected: {EXPECTED}.")
    poses = None
    force = values.get("force")
    if "angles" in values:
        poses = table(sequence, values["angles"], gravity)
        force = poses.force()
    if "accel" in values and force is None:
        raise InputError(
            f"{path} has readings of the accelerometer but no known force: {EXPECTED}."
        )
    if "gyro" in values and "rate" not in values and poses is None:
        raise InputError(f"{path} has readings of the gyro but no known rate: {EXPECTED}.")
    T = values.get("temperature")
    bench = of_arrays(
        values.get("rate"), force, values.get("gyro"), values.get("accel"),
        (PERFECT, PERFECT), None if T is None else T[:, 0],
    )  # fmt: skip
    return bench, poses


def _columns(path: Path) -> dict[str, Array]:
    """Values (n, d) in SI by group."""
    try:
        with reading(path), path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            header = file.readline()
            separator = max(",;\t", key=header.count)
            names = next(csv.reader([header], delimiter=separator), [])
            lines = [row for row in csv.reader(file, delimiter=separator) if any(row)]
    except csv.Error as error:
        raise InputError(f"{path} is no table: {error}.") from error
    if not 0 < len(lines) <= MOST_ROWS:
        raise InputError(f"{path} has {len(lines)} rows of tests; expected 1 to {MOST_ROWS}.")
    places = _places(path, names)
    out = {}
    for group, wanted in GROUPS.items():
        there = [n for n in wanted if n in places]
        if there and len(there) < len(wanted):
            raise InputError(f"{path} has {', '.join(there)} but not all of {', '.join(wanted)}.")
        if there:
            out[group] = np.stack([_column(path, lines, n, *places[n], group) for n in wanted], 1)
    return out


def _places(path: Path, names: list[str]) -> dict[str, tuple[int, str | None]]:
    known = {name for group in GROUPS.values() for name in group}
    out: dict[str, tuple[int, str | None]] = {}
    for i, text in enumerate(names):
        match = re.fullmatch(r"\s*#?\s*\"?([A-Za-z_]+)\"?\s*(?:[(\[]([^()\[\]]*)[)\]])?\s*", text)
        if match and match[1].lower() in known:
            if match[1].lower() in out:
                raise InputError(f"{path} has the column {match[1]} twice.")
            out[match[1].lower()] = (i, match[2])
    if not out:
        raise InputError(f"{path} has no column that is known. Expected: {EXPECTED}.")
    return out


def _column(
    path: Path, lines: list[list[str]], name: str, at: int, unit: str | None, group: str
) -> Array:
    quantity = QUANTITY[group]
    found = next(iter(quantities()[quantity])) if unit is None else parse_unit(quantity, unit)
    if found is None:
        units = ", ".join(quantities()[quantity])
        raise InputError(f"{path}: the unit of {name} ({unit}) is none of {units}.")
    out = np.empty(len(lines))
    for i, row in enumerate(lines):
        try:
            out[i] = float(row[at])
        except (ValueError, IndexError):
            out[i] = math.nan
        if not math.isfinite(out[i]):
            raise InputError(f"{path}, test {i + 1}: {name} is not a finite number.")
    return out * quantities()[quantity][found]

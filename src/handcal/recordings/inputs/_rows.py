"""Rows of numbers in text: columns as arrays, stamps to the nanosecond, and what is wrong where."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.recordings.inputs._cut import whole_lines
from handcal.recordings.inputs._repair import nanoseconds
from handcal.types import Array, InputError, IntArray


@dataclass(frozen=True)
class Rows:
    """A table in a file. where: what a message calls it; names: of its columns, () without a
    header; number: the line that ``lines[0]`` was in the file."""

    where: str
    names: tuple[str, ...]
    lines: list[str]
    separator: str
    number: int = 1


def rows_of(content: bytes, where: str, *, header: bool = True, separator: str = "") -> Rows:
    """The rows that are not blank nor comments. With a header, its names; without a separator,
    the one that the first line has most of. Errors: InputError where there is not one row."""
    lines = content.decode("utf-8-sig", "replace").splitlines()
    number = next((k for k, line in enumerate(lines) if _is_row(line, header)), len(lines))
    if number == len(lines):
        raise InputError(f"{where} is empty.")
    first = lines[number].lstrip("#")
    separator = separator or max(",;\t", key=first.count)
    names = tuple(cell.strip().strip('"') for cell in first.split(separator)) if header else ()
    body = [line for line in lines[number + header :] if _is_row(line, False)]
    if body and not content.endswith((b"\n", b"\r")):
        body = whole_lines(body, separator, where)
    if separator != ",":  # then a comma can only be a decimal sign
        body = [line.replace(",", ".") for line in body]
    return Rows(where, names, body, separator, number + 1 + header)


def _is_row(line: str, header: bool) -> bool:
    return bool(line.strip()) and (header or not line.lstrip().startswith(("#", "//")))


def numbers(rows: Rows, columns: Sequence[int]) -> Array:
    """Those columns (n, k); NaN for empty cells. Errors: InputError."""
    if not rows.lines:
        return np.empty((0, len(columns)))
    return parsed(rows.lines, rows.separator, list(columns), rows.where, rows.number)


def times(rows: Rows, column: int, factor: float) -> IntArray:
    """A column of stamps (n,) in ns; factor: from its unit to ns. Errors: InputError."""
    if not rows.lines:
        return np.empty(0, dtype=np.int64)
    return stamps(rows.lines, rows.separator, column, factor, rows.where, rows.number)


def places(rows: Rows, wanted: Sequence[str]) -> list[int]:
    """Where the columns stand, small letters, spaces and units aside. Errors: InputError."""
    plain = [plain_name(name) for name in rows.names]
    missing = [name for name in wanted if name not in plain]
    if missing:
        raise InputError(
            f"{rows.where} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}."
        )
    return [plain.index(name) for name in wanted]


def plain_name(name: str) -> str:
    """``Gyroscope X (deg/s)`` is gyroscope_x."""
    return re.sub(r"[\s_]+", "_", re.sub(r"[(\[].*", "", name).strip().lower())


def unit_in(name: str) -> str:
    """``Gyroscope X (deg/s)`` is in deg/s; "" where nothing is in brackets."""
    match = re.search(r"[(\[]([^()\[\]]*)[)\]]\s*$", name)
    return match[1].strip() if match else ""


def stamps(
    lines: list[str], separator: str, column: int, factor: float, where: str, number: int
) -> IntArray:
    """Whole numbers exactly: ns since 1970 do not fit into a float64. Errors: InputError."""
    if factor < 1e9:
        try:
            whole = np.loadtxt(
                lines, np.int64, delimiter=separator, usecols=[column], ndmin=1, comments=None
            )
            if np.abs(whole).max() < 9e18 / factor:
                exact: IntArray = whole * int(factor)
                return exact
        except ValueError:
            pass  # fractions of them, then
    return nanoseconds(parsed(lines, separator, [column], where, number)[:, 0], factor)


def parsed(lines: list[str], separator: str, usecols: list[int], where: str, number: int) -> Array:
    """Numbers (rows, columns); NaN for empty cells. Errors: InputError."""
    for rows in (lines, None):
        try:
            table: Array = np.loadtxt(
                _filled(lines, separator) if rows is None else rows,
                delimiter=separator,
                usecols=usecols,
                ndmin=2,
                comments=None,
            )
            return table
        except ValueError as error:
            problem = error
    raise InputError(
        f"{where}: the rows from line {number} are not all numbers in columns divided by "
        f"{separator!r}; the first that is not: {_offender(lines, separator, usecols, number)}."
    ) from problem


def _offender(lines: list[str], separator: str, usecols: list[int], number: int) -> str:
    """The first cell that is no number, and its line (blank ones not counted)."""
    for k, line in enumerate(lines):
        cells = [cell.strip() for cell in line.rstrip("\r\n").split(separator)]
        if len(cells) <= max(usecols):
            return f"line {number + k} has {len(cells)} columns"
        for cell in (cells[c] for c in usecols):
            try:
                float(cell or "nan")
            except ValueError:
                return f"{cell[:40]!r} in line {number + k}"
    return "unknown"


def _filled(lines: list[str], separator: str) -> list[str]:
    return [
        separator.join(cell.strip() or "nan" for cell in line.rstrip("\r\n").split(separator))
        for line in lines
    ]

"""Rows of numbers in text, read by pyarrow: columns as arrays, stamps to the nanosecond, and what
is wrong where."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal.recordings.inputs._cut import COMPARED, whole_lines
from handcal.recordings.inputs._repair import nanoseconds
from handcal.types import Array, InputError, IntArray

# Cells of readings that were not taken, as pandas, R, MATLAB and databases write them.
BLANK = ("", "nan", "na", "n/a", "null", "none", "-", "--")
_REMARKS = ("#", "//", "%")
# Rows that show what a column holds; the share of rows that may be broken.
_TYPICAL, _BROKEN = 1000, 0.02
_ENDS = (b"\n", b"\r")


@dataclass(frozen=True)
class Rows:
    """A table in a file. where: what a message calls it; names: of its columns, () without a
    header; body: the rows alone, in UTF-8; number: the line that the first of them was in the
    file."""

    where: str
    names: tuple[str, ...]
    body: bytes
    separator: str
    number: int = 1


def rows_of(content: bytes, where: str, *, header: bool = True, separator: str = "") -> Rows:
    """The rows that are not blank nor comments. With a header, its names; without a separator,
    the one that the first line has most of. Errors: InputError where there is not one row."""
    content = in_utf8(content)
    for number, begin, end in _lines(content):
        first = content[begin:end].decode()
        if not first.strip() or (not header and is_remark(first)):
            continue
        first = first.lstrip("#")
        separator = separator or max(",;\t", key=first.count)
        names = [cell.strip().strip('"') for cell in first.split(separator)] if header else []
        body = content[end + 1 :] if header else content[begin:]
        return whole(Rows(where, tuple(names), body, separator, number + header))
    raise InputError(f"{where} is empty.")


def in_utf8(content: bytes) -> bytes:
    """Text in UTF-8 with ends of lines as everywhere; what is none of it has a mark instead."""
    content = content.removeprefix(codecs.BOM_UTF8)
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        content.decode()
    except UnicodeDecodeError:
        content = content.decode("utf-8", "replace").encode()
    return content


def whole(rows: Rows) -> Rows:
    """Without comments, and without a last line that is cut off."""
    body = rows.body
    if any(b"\n" + mark.encode() in body for mark in _REMARKS) or is_remark(body[:2].decode("l1")):
        lines = body.decode().split("\n")
        body = "\n".join(["" if is_remark(line) else line for line in lines]).encode()
    if rows.separator == " ":
        body = re.sub(rb"[ \t]*\n[ \t]*", b"\n", re.sub(rb"[ \t]+", b" ", body)).strip(b" ")
    elif rows.separator != ",":  # then a comma can only be a decimal sign
        body = body.replace(b",", b".")
    if body.strip() and not body.endswith(_ENDS):
        last = body.rstrip().rsplit(b"\n", COMPARED + 1)[-COMPARED - 1 :]
        lines = [line.decode() for line in last if line.strip()]
        if len(whole_lines(lines, rows.separator, rows.where)) < len(lines):
            body = body.rstrip()[: -len(last[-1])]
    return replace(rows, body=body if body.strip() else b"")


def is_remark(line: str) -> bool:
    """Whether a line holds no readings but words about them."""
    return line.lstrip().startswith(_REMARKS)


def _lines(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Number of each line, where it begins and where it ends."""
    begin, number = 0, 0
    while begin < len(content):
        end = content.find(b"\n", begin)
        end = len(content) if end < 0 else end
        number += 1
        yield number, begin, end
        begin = end + 1


def numbers(rows: Rows, columns: Sequence[int]) -> Array:
    """Those columns (n, k); NaN for empty cells. Errors: InputError."""
    if not rows.body:
        return np.empty((0, len(columns)))
    cells = _cells(rows, columns)
    return np.column_stack([_floats(rows, column, cells[column]) for column in columns])


def times(rows: Rows, column: int, factor: float) -> IntArray:
    """A column of stamps (n,) in ns; factor: from its unit to ns. Errors: InputError."""
    counted = whole_numbers(rows, column)
    if counted is not None and is_exact(counted, factor):
        return counted * int(factor)
    return nanoseconds(numbers(rows, [column])[:, 0], factor)


def is_exact(counted: IntArray, factor: float) -> bool:
    """Whether stamps (n,) times the factor are whole ns that 64 bits hold: ns since 1970 do not
    fit into a float64."""
    size = np.abs(counted.astype(np.float64)).max(initial=0.0)
    return factor < 1e9 and factor == int(factor) and bool(size * factor < 9e18)


def whole_numbers(rows: Rows, column: int) -> IntArray | None:
    """A column (n,) of whole numbers; None where one is none. Errors: InputError."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not rows.body:
        return np.empty(0, dtype=np.int64)
    try:
        found = pc.cast(_cells(rows, [column])[column], pa.int64())
    except pa.ArrowInvalid:
        return None
    return None if found.null_count else np.asarray(found.to_numpy(), dtype=np.int64)


def texts(rows: Rows, column: int) -> list[str]:
    """The cells of a column as they stand, n of them. Errors: InputError."""
    return [str(cell) for cell in _cells(rows, [column])[column].to_pylist()] if rows.body else []


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


def _cells(rows: Rows, columns: Sequence[int]) -> dict[int, Any]:
    """The cells of some columns as arrays of text without blanks around. Errors: InputError."""
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import csv

    def table(body: bytes, quote: str | bool) -> Any:
        return csv.read_csv(
            pa.BufferReader(body),
            csv.ReadOptions(column_names=names, use_threads=False),
            csv.ParseOptions(
                delimiter=rows.separator, quote_char=quote, invalid_row_handler=handled
            ),
            csv.ConvertOptions(
                include_columns=[names[k] for k in wanted],
                column_types=dict.fromkeys(names, pa.string()),
                strings_can_be_null=False,
            ),
        )

    uneven = []

    def handled(row: Any) -> str:
        if row.text.strip():
            uneven.append(row.text)
        return "skip"

    first = rows.body.lstrip(b"\n").partition(b"\n")[0].decode()
    width, wanted = max(first.count(rows.separator) + 1, max(columns) + 1), sorted(set(columns))
    names = [str(k) for k in range(width)]
    try:
        found = table(rows.body, '"')
        if uneven:
            found = table(_evened(rows, width, wanted[-1]), False)
    except (pa.ArrowInvalid, OverflowError) as error:
        raise InputError(f"{rows.where} is no table of numbers: {error}.") from error
    return {k: pc.utf8_trim_whitespace(found.column(names[k])) for k in wanted}


def _evened(rows: Rows, width: int, last: int) -> bytes:
    """The rows with as many cells each, blank ones behind. Errors: InputError where one ends
    before a column that is needed."""
    out = []
    for number, line in enumerate(rows.body.decode().split("\n"), rows.number):
        if not line.strip():
            continue
        cells = [cell.strip().strip('"') for cell in line.split(rows.separator)]
        if len(cells) <= last:
            raise InputError(
                f"{rows.where}: the rows from line {rows.number} are not all numbers in columns "
                f"divided by {rows.separator!r}: line {number} has {len(cells)} columns."
            )
        out.append(rows.separator.join((cells + [""] * width)[:width]))
    return "\n".join(out).encode()


def without_broken(rows: Rows) -> tuple[Rows, int]:
    """The rows without those that a link has torn, and how many these are: other numbers of cells
    than most have, or no number where the others have one. Where many are, none is left out."""
    lines = [line for line in rows.body.decode().split("\n") if line.strip()]
    cells = [[cell.strip().strip('"') for cell in line.split(rows.separator)] for line in lines]
    width = int(np.bincount([len(row) for row in cells]).argmax())
    told = [row for row in cells if len(row) == width][:_TYPICAL]
    numeric = [k for k in range(width) if np.mean([_is_number(row[k]) for row in told]) > 0.9]
    sound = [len(row) == width and all(_is_number(row[k]) for k in numeric) for row in cells]
    broken = len(lines) - sum(sound)
    if broken > _BROKEN * len(lines):
        return rows, 0
    kept = [line for line, good in zip(lines, sound, strict=True) if good]
    return replace(rows, body="\n".join(kept).encode()), broken


def _is_number(cell: str) -> bool:
    try:
        float("nan" if cell.lower() in BLANK else cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _floats(rows: Rows, column: int, cells: Any) -> Array:
    """A column's numbers (n,). Errors: InputError."""
    import pyarrow as pa
    import pyarrow.compute as pc

    pointed = pc.replace_substring(cells, ",", ".")
    blank = pc.is_in(pc.utf8_lower(pointed), value_set=pa.array(BLANK))
    try:
        found = pc.cast(pc.if_else(blank, None, pointed), pa.float64())
    except pa.ArrowInvalid as error:
        raise InputError(
            f"{rows.where}: the rows from line {rows.number} are not all numbers in columns "
            f"divided by {rows.separator!r}; the first that is not: {_offender(rows, column)}."
        ) from error
    return np.asarray(pc.fill_null(found, np.nan).to_numpy(), dtype=np.float64)


def _offender(rows: Rows, column: int) -> str:
    """The first cell of a column that is no number, and its line."""
    for number, line in enumerate(rows.body.decode().split("\n"), rows.number):
        cells = [cell.strip().strip('"') for cell in line.split(rows.separator)]
        if not line.strip() or len(cells) <= column:
            continue
        if not _is_number(cells[column]):
            return f"{cells[column][:40]!r} in line {number}"
    return "unknown"

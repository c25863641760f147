"""Where the rows of a text begin, what divides their cells, and what stands above them."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from handcal.recordings.inputs._clock import is_clock, is_date
from handcal.recordings.inputs._options import parse_unit, quantities
from handcal.recordings.inputs._rows import BLANK, Rows, in_utf8, whole

# Looked at, to know a table by: lines and bytes; rows that have to be alike, numbers in each.
_LINES, _BYTES, _ALIKE, _FEWEST = 400, 2**18, 5, 3
_SEPARATORS = "\t;,| "
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:e[+-]?\d+)?|nan|[+-]?inf", re.I)
_RATE = re.compile(
    r"\b(?:fs|odr|(?:sampl\w*|data|update|output|logging)?[ _-]*(?:rate|freq\w*))\b"
    r"[^\d\n]{0,12}?(\d+(?:[.,]\d+)?)\s*(k?)(?:hz)?",
    re.I,
)
_LABELLED = re.compile(r"([A-Za-z]\w*)\s*[:=]\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)")
_RATES = 1.0, 20_000.0


@dataclass(frozen=True)
class Layout:
    """rows; units: of a second header line, () without; rate_hz: that the lines above state."""

    rows: Rows
    units: tuple[str, ...] = ()
    rate_hz: float | None = None


def layout(content: bytes, where: str) -> Layout | None:
    """The table in a text; None where there are no rows of numbers in it."""
    content = in_utf8(content)
    lines = content[:_BYTES].split(b"\n")[:_LINES]
    texts = [line.decode("utf-8", "ignore") for line in lines]
    begun = [(_values(texts, separator), separator) for separator in _SEPARATORS]
    (first, count), separator = max(begun, key=lambda one: one[0][1])
    if count < _FEWEST:
        unnamed = _unlabelled(content)
        return None if unnamed is None else layout(unnamed, where)
    above = [k for k in range(first) if texts[k].strip()]
    width = len(_cells(texts[first], separator))
    units: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    if above and (units := _if_units(texts[above[-1]], separator)):
        above.pop()
    if above and (names := _if_names(texts[above[-1]], separator, width)):
        above.pop()
    if above and sum(name.lower() in ("x", "y", "z") for name in names) >= _FEWEST:
        names = _under(_cells(texts[above[-1]], separator), names)
    said = "\n".join(texts[k] for k in above)
    stated = [float(m[1].replace(",", ".")) * (1000.0 if m[2] else 1.0)
              for m in _RATE.finditer(said)]  # fmt: skip
    rate = next((hz for hz in stated if _RATES[0] <= hz <= _RATES[1]), None)
    body = content[sum(len(line) + 1 for line in lines[:first]) :]
    return Layout(whole(Rows(where, names, body, separator, first + 1)), units, rate)


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return re.split(" +", line.strip())
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def _values(lines: Sequence[str], separator: str) -> tuple[int, int]:
    """Where rows of numbers begin, and how many numbers are in each; 0, 0 where there are none."""
    counts = [sum(map(_is_value, _cells(line, separator))) for line in lines]
    filled = [k for k, line in enumerate(lines) if line.strip()]
    for n, k in enumerate(filled):
        some = [counts[j] for j in filled[n : n + _ALIKE]]
        cells = [cell for cell in _cells(lines[k], separator) if cell.lower() not in BLANK]
        if min(some) >= _FEWEST and 2 * counts[k] >= len(cells) and 2 * min(some) >= max(some):
            return k, sorted(some)[len(some) // 2]
    return 0, 0


def _is_value(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell)) or is_clock(cell) or is_date(cell)


def _if_names(line: str, separator: str, width: int) -> tuple[str, ...]:
    """The names of the columns, where a line has as many as there are; else ()."""
    line = re.sub(r"^\s*(#|//)\s*", "", line)
    for divided in (separator, *_SEPARATORS):
        names = _cells(line, divided)
        words = sum(bool(name) and not _is_value(name) for name in names)
        if words >= max(_FEWEST, width - 1) or (words >= _FEWEST and divided == separator):
            return tuple(names)
    return ()


def _if_units(line: str, separator: str) -> tuple[str, ...]:
    """The units of the columns, where a line is made of such; else ()."""
    cells = [cell.strip("()[] ") if "(" not in cell[1:] else cell
             for cell in _cells(line.lstrip("#"), separator)]  # fmt: skip
    filled = [cell for cell in cells if cell]
    units = [c for c in filled if any(parse_unit(q, c) is not None for q in quantities())]
    return tuple(cells) if len(units) >= _FEWEST and 2 * len(units) >= len(filled) else ()


def _under(sensors: Sequence[str], axes: Sequence[str]) -> tuple[str, ...]:
    """Names of two lines: a sensor above the first of its axes, or above each."""
    out, last = [], ""
    for k, axis in enumerate(axes):
        last = (sensors[k] if k < len(sensors) else "") or last
        out.append(f"{last} {axis}" if axis.lower() in ("x", "y", "z") else axis)
    return tuple(out)


def _unlabelled(content: bytes) -> bytes | None:
    """The table of rows such as ``ax:0.1,ay:0.2``, as sketches for a serial plotter print them;
    None where the text has none."""
    found = [_LABELLED.findall(line) for line in content.decode().split("\n")]
    names = next(([name for name, _ in pairs] for pairs in found if len(pairs) >= _FEWEST), None)
    if names is None:
        return None
    rows = [",".join(value for _, value in pairs) for pairs in found
            if [name for name, _ in pairs] == names]  # fmt: skip
    return "\n".join([",".join(names), *rows, ""]).encode()

"""Tables in text: a line that names the columns, one row a sample, whatever divides the cells.

Names in any case, with their unit in brackets, as the last word (acc_x_g) or in a second line;
without one it is SI (s, rad/s, m/s^2, tesla, degC, rad), and ``--units`` overrules both. Which
names there are, and which programs write them, says columns.toml beside this file. Lines above the
names are not read, but for a sampling rate. Between the cells: comma, semicolon, tab, |, blanks;
decimal commas where no comma divides. Times: numbers, of the clock, with a date, ISO 8601. Empty
cells are readings that were not taken. Where the file does not say enough: ``--columns`` names the
columns in their order, ``--rate`` counts time.
"""

from __future__ import annotations

import codecs
from dataclasses import replace
from pathlib import Path

from handcal.recordings.inputs._cells import Table
from handcal.recordings.inputs._clock import is_clock, is_date
from handcal.recordings.inputs._layout import Layout, layout
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._rows import Rows, numbers, texts, whole_numbers, without_broken
from handcal.recordings.inputs._stamps import Clock
from handcal.recordings.inputs._table import recording
from handcal.recordings.inputs._zip import LARGEST
from handcal.types import InputError, Recording

UNDERSTOOD = (
    "plain CSV, or another table in text, with columns t, gx, gy, gz, ax, ay, az (.csv, .tsv, .txt)"
)
UNITS = "as the names or a second header say, else SI; at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "a real recording of an x-IMU3; layouts of many programs; tables made by hypothesis"
ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".log")
LAST = True  # (any text of numbers is this one)
TABLE = True
MARK = "it holds no rows of numbers"
_NAMED = (".csv", ".tsv")
_BEGINNING = 65_536
UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE


def can_read(path: Path) -> bool:
    """By its name (.csv, .tsv), or by rows of numbers (.txt, .dat, .log)"""
    ending = path.suffix.lower()
    if not path.is_file() or ending not in ENDINGS:
        return False
    if ending in _NAMED:  # (what it lacks is better said than guessed)
        return True
    with path.open("rb") as file:
        return layout(file.read(_BEGINNING), str(path)) is not None


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB: cut it into parts.")
    content = path.read_bytes()
    if content.startswith(UTF_16):
        raise InputError(f"{path} is in UTF-16: save it as UTF-8.")
    found = layout(content, str(path))
    if found is None:
        raise InputError(
            f"{path} has no rows of numbers. Expected: t, gx, gy, gz, ax, ay, az in a line, and "
            "numbers below."
        )
    options.progress(0.5)
    rows = found.rows
    if not rows.body:
        raise InputError(f"{path} has a header but no rows.")
    first = rows.body.lstrip(b"\n").partition(b"\n")[0].decode()
    width = max(first.count(rows.separator) + 1, len(rows.names))
    if rows.separator == "," and rows.names and width >= 2 * len(rows.names):
        raise InputError(
            f"{path}: commas divide its columns and are decimal signs too: {len(rows.names)} "
            f"columns are named, and {width} are there. Export it with semicolons between them."
        )
    try:
        made = _recording(path, rows, width, found, options)
    except InputError:
        sound, broken = without_broken(rows)
        if not broken:
            raise
        made = _recording(path, sound, width, found, options)
        said = f"{broken} broken line{'s were' if broken > 1 else ' was'} left out."
        made = replace(made, warnings=(said, *made.warnings))
    options.progress(1.0)
    return made


def _recording(path: Path, rows: Rows, width: int, found: Layout, options: Options) -> Recording:
    """The recording of rows of at most so many columns. Errors: InputError."""
    few = replace(rows, body=rows.body[:_BEGINNING].rpartition(b"\n")[0] or rows.body)
    while width > len(rows.names) and not any(texts(few, width - 1)):
        width -= 1  # (many a row ends with a comma)
    table = Table(
        path, rows.names, width, lambda places: numbers(rows, places),
        lambda place: _clock(rows, place), found.units, found.rate_hz,
    )  # fmt: skip
    return recording(table, options)


def _clock(rows: Rows, place: int) -> Clock:
    """A column of times: whole numbers, text of the clock, or numbers. Errors: InputError."""
    whole = whole_numbers(rows, place)
    if whole is not None:
        return whole
    cells = texts(rows, place)
    if is_clock(cells[0]) or is_date(cells[0]):
        return cells
    return numbers(rows, [place])[:, 0]

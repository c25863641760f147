"""Writes docs/formats.md from src/handcal/recordings/inputs/; `make docs` runs it."""

# ruff: noqa: E501 (a paragraph of the page is a line)

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from handcal.recordings.inputs import formats
from handcal.recordings.inputs._names import vocabulary

FILE = Path(__file__).with_name("formats.md")
INTRODUCTION = """# What handcal reads

*Reference.* Every command that takes a recording reads all of these formats; a folder or a zip file is read as a whole. `handcal import` makes one file of it. The format is recognised by the content, without an option; a table without known columns by its name (.csv) or by its rows of numbers. Formats are tried in the order of this list.

In SI, at rest the axis that points up reads +g, in every format after it is read. Where a file does not say its unit, gravity at rest is asked, and what was found is said; a unit that gravity contradicts is refused with the option that puts it right (`--units accel=g`), and one that is stated is used. Stamps of arrival in bursts are put where the readings were taken; a magnetometer on other axes is turned to the IMU's; both are said. Compressed and foreign files are read within bounds: what would unpack to too much is refused unopened ([what was tried](reliability.md)).

This page is written by `make docs` from the files in `src/handcal/recordings/inputs/`: one file, one format. Axes and conventions of each stand in the first lines of the file of that name.

| format | how it is recognised | units and signs in the file | what is read | tried on |
|---|---|---|---|---|
"""
TABLES = """
## Tables

A table in text, of MATLAB, NumPy or Parquet is read at once where its header says what the columns are: one of the names below and an axis, in any order and case (`gx`, `acc_x`, `AccX`, `Gyroscope X`, `gyro_rad[0]`), with a unit in brackets, as the last word (`acc_x_g`, `gyro_x_dps`) or in a second line. Between the cells: comma, semicolon, tab, `|` or blanks; decimal commas and lines before the header are understood. Times: s, ms, us, ns, of the clock, with a date, ISO 8601. A refusal says all that is wrong at once, with the options to type, as far as the numbers tell them: time goes on, gravity has one size, and it turns as the gyro says.

| option | of a file that does not say | example |
|---|---|---|
| `--columns` | what its columns are: no header, another language, a plain matrix; `-` leaves one aside | `--columns t,gx,gy,gz,ax,ay,az` |
| `--rate` | its times, or whose time counts samples | `--rate 100` |
| `--units` | its units, also in counts | `--units accel=g/16384,gyro=deg/s/131,mag=uT/0.15` |
| `--axes` | that a sensor has other axes than the IMU: which of its own stand for x, y, z | `--axes mag=y,x,-z` |

Every command that reads a recording has them, `import` too, and [handcal.toml](commands.md#options-in-a-file) per command; `--units` and `--axes` work for every format. In Python: `handcal.read(path, columns=..., rate_hz=..., units=..., axes=...)`.

Names, of several the first; a sign and a sum are meant as such (`src/handcal/recordings/inputs/columns.toml`, where further ones are added):

| quantity | names |
|---|---|
"""
PRODUCERS = """
Programs and devices whose headers are tried, and what is known of them beyond the header:

| program | known by the columns | units that it does not state | axes that stand for x, y, z |
|---|---|---|---|
"""
EPILOGUE = """
Not read: what has had gravity taken out (linear acceleration), positions without attitude, and a magnetic field in parts of the one at a calibration (a.u.), of which no tesla can be made. Orientations that a phone has computed are not read either: they hold its own filter's errors.
"""


def page() -> str:
    """The whole page as Markdown."""
    return INTRODUCTION + "".join(map(row, formats())) + tables() + EPILOGUE


def tables() -> str:
    """What the columns of a table are called, and by whom."""
    known = vocabulary()
    named = [
        f"| {quantity} | {', '.join(f'`{name.text}`' for name in names)} |\n"
        for quantity, names in known.names.items()
    ]
    programs = [
        f"| {p.name} | {', '.join(f'`{name}`' for name in p.columns)} "
        f"| {', '.join(f'{q} {unit}' for q, unit in p.units.items())} "
        f"| {'; '.join(f'{s} {chr(44).join(axes)}' for s, axes in p.axes.items())} |\n"
        for p in known.producers
    ]
    return TABLES + "".join(named) + PRODUCERS + "".join(programs)


def row(module: ModuleType) -> str:
    """A format's row; what it does not say is left empty."""
    name = module.__name__.rsplit(".", 1)[-1]
    first = " ".join((module.can_read.__doc__ or "").split())
    cells = [
        f"{module.UNDERSTOOD} (`{name}`)",
        first.rstrip("."),
        *(str(getattr(module, name, "")) for name in ("UNITS", "STREAMS_READ", "TRIED")),
    ]
    return f"| {' | '.join(cell.replace('|', ' ') for cell in cells)} |\n"


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")

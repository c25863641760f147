"""Writes docs/formats.md from src/handcal/recordings/inputs/; `make docs` runs it."""

# ruff: noqa: E501 (a paragraph of the page is a line)

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from handcal.recordings.inputs import formats

FILE = Path(__file__).with_name("formats.md")
INTRODUCTION = """# What handcal reads

Every command that takes a recording takes any of these, a folder or zip as a whole; `handcal import` makes one file of it. The format is told by the content (a table of which nothing else is known by its name, .csv), without an option. Formats are asked in the order of this table.

In SI, at rest the axis that points up reads +g, in every format after it is read. Where a file does not say its unit, gravity at rest is asked, and what was found is said; a unit that gravity contradicts is refused with the option that puts it right (`--units accel=g`), and one that is stated is used. Stamps of arrival in bursts are put where the readings were taken; a magnetometer on other axes is turned to the IMU's; both are said. Compressed and foreign files are read within bounds: what would unpack to too much is refused unopened ([what was tried](reliability.md)).

This page is written by `make docs` from the files in `src/handcal/recordings/inputs/`: one file, one format. Axes and conventions of each stand in the first lines of the file of that name.

| format | how it is recognised | units and signs in the file | what is read | tried on |
|---|---|---|---|---|
"""
EPILOGUE = """
Not read: what has had gravity taken out (linear acceleration), positions without attitude, and a magnetic field in parts of the one at a calibration (a.u.), of which no tesla can be made. Orientations that a phone has computed are not read either: they hold its own filter's errors.
"""


def page() -> str:
    """The whole page as Markdown."""
    return INTRODUCTION + "".join(map(row, formats())) + EPILOGUE


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

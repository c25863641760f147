"""Text that ends in the middle of a line, as a killed logger or a broken copy leaves it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# A number that lost its end is mostly shorter than every one of so many before it; one that is
# not has lost so little that it does no harm.
COMPARED = 50
# What was left out within ``said_of_cuts``; None outside.
_SAID: ContextVar[list[str] | None] = ContextVar("said", default=None)


@contextmanager
def said_of_cuts() -> Iterator[list[str]]:
    """Inside, a sentence for each line that was left out because it is cut off."""
    said: list[str] = []
    token = _SAID.set(said)
    try:
        yield said
    finally:
        _SAID.reset(token)


def whole_lines(lines: list[str], separator: str, where: str) -> list[str]:
    """Rows of a text whose last line has no end: without it, where it is not whole.

    lines: at least one, none of them blank. A last line is whole where it has as many cells as
    the one before and the last of them is not shorter than all that stand above it.
    """
    before, last = lines[-COMPARED - 1 : -1], _cells(lines[-1], separator)
    if not before:
        return lines
    above = [_cells(line, separator) for line in before]
    if len(last) == len(above[-1]) and len(last[-1]) >= min(len(cells[-1]) for cells in above):
        return lines
    said = _SAID.get()
    if said is not None:
        said.append(f"{where} ends in the middle of a line: that reading was left out.")
    return lines[:-1]


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in line.split(separator)]

"""What a paper claims, and what comes out when it is computed again.

A file ``paper_NNN.py`` in this folder has ``paper(progress) -> Paper``, which runs everything;
nothing else needs to know of it. ``docs/make_paper_tables.py`` writes the same tables into
``docs/paper-NNN.md``.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from handcal.lab import papers
from handcal.lab.papers.table import Table
from handcal.types import InputError

# What became of a claim.
HOLDS, CORRECTED, FAILS, UNKNOWN = "holds", "holds, corrected", "does not hold", "not reproducible"
SWEPT = "002"  # the paper that another command runs again
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Claim:
    """One claim: in short, as printed, as computed here, and what became of it."""

    claim: str
    printed: str
    computed: str
    verdict: str


@dataclass(frozen=True)
class Paper:
    """number: as in "001"; source: authors, title, year; beyond: what handcal reaches where the
    paper stops (what, the paper's figure, handcal's)."""

    number: str
    source: str
    claims: tuple[Claim, ...]
    beyond: tuple[tuple[str, str, str], ...] = ()
    more: tuple[Table, ...] = ()

    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order in which they are shown."""
        rows = tuple((c.claim, c.printed, c.computed, c.verdict) for c in self.claims)
        heading = ("claim", "printed", "computed here", "verdict")
        out = [Table("What it claims, and what holds", heading, rows, text=4)]
        if self.beyond:
            beside = ("what", "paper", "handcal")
            out.append(Table("What handcal does better", beside, self.beyond, text=3))
        return (*out, *self.more)


def below(x: float) -> str:
    """How near to nothing: rounding differs from one machine to the next, its size hardly."""
    for exponent in (-12, -9, -6):
        if abs(x) < 10.0**exponent:
            return f"within 1e{exponent}"
    return f"within {abs(x):.1e}"


def numbers() -> tuple[str, ...]:
    """The papers there are."""
    names = (m.name for m in pkgutil.iter_modules(papers.__path__))
    return tuple(n.removeprefix("paper_") for n in sorted(names) if n[6:].isdigit())


def computed(number: str, progress: Progress = lambda _: None) -> Paper:
    """A paper computed again, which takes some seconds. Errors: InputError if there is none."""
    if number not in numbers():
        there = f"there are {', '.join(numbers())}"
        if number == SWEPT:
            raise InputError(f"Paper {SWEPT} is run again by `handcal sweep`; here {there}.")
        raise InputError(f"There is no paper {number}: {there}, and {SWEPT} by `handcal sweep`.")
    paper: Paper = importlib.import_module(f"{papers.__name__}.paper_{number}").paper(progress)
    return paper


def markdown(tables: Sequence[Table]) -> str:
    """Tables as they stand in docs/."""
    return "\n".join(_one(t) for t in tables)


def _one(table: Table) -> str:
    rule = ["---" if i < table.text else "---:" for i in range(len(table.columns))]
    cells = [table.columns, rule, *table.rows]
    lines = ["| " + " | ".join(c.replace("|", "\\|") for c in row) + " |" for row in cells]
    return "\n".join(
        [f"### {table.heading}", "", *lines, "", *([table.note, ""] if table.note else [])]
    )

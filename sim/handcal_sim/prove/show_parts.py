"""What the tables of all suites are made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich import box
from rich.table import Table

Row = Mapping[str, Any]


def percent(share: Row) -> str:
    """A share and its interval: 98.0 % (94.3 to 99.6 %)."""
    if not share["n"]:
        return "-"
    low, high = (100.0 * x for x in share["interval"])
    return f"{100.0 * share['share']:.1f} % ({low:.1f} to {high:.1f})"


def marked(met: bool | None) -> str:
    """Whether what is asked is met, behind the sentence that says it."""
    return {None: " too few to say", True: " [green]met[/]", False: " [red]not met[/]"}[met]


def new_table(title: str, *columns: str) -> Table:
    """An empty table, numbers to the right of what they are of."""
    made = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        made.add_column(column, justify="right" if k else "left")
    return made

"""What results in the terminal have in common: tables and lists of sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def table(*columns: str) -> Table:
    """A table without rows. Of a column's name, a leading ">" justifies it to the right, and "*"
    behind that lets it wrap."""
    from rich import box
    from rich.table import Table

    out = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        wraps = name.lstrip(">").startswith("*")
        out.add_column(
            name.lstrip(">*"),
            justify="right" if name.startswith(">") else "left",
            no_wrap=not wraps,
        )
    return out


def print_bullets(console: Console, sentences: Iterable[str]) -> None:
    """A line for each, set in."""
    from rich.markup import escape
    from rich.padding import Padding

    for sentence in sentences:
        console.print(Padding(escape(f"• {sentence}"), (0, 0, 0, 2)), highlight=False)


def print_section(console: Console, heading: str, sentences: Sequence[str]) -> None:
    """A heading and its sentences; nothing where there are none."""
    if sentences:
        console.print(f"[bold]{heading}[/]")
        print_bullets(console, sentences)

"""A laboratory result as a page and in the terminal: one layout for all methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import handcal
from handcal import output
from handcal.lab.papers.table import Table as Table
from handcal.show import words
from handcal.show.drawing import Plot
from handcal.show.html_page import page
from handcal.show.terminal import print_bullets, print_section
from handcal.show.terminal import table as terminal_table
from handcal.types import Parameter

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Sheet:
    """What a person sees. facts: value and label; sentences: what it comes to."""

    title: str
    sub: str
    facts: tuple[tuple[str, str], ...]
    sentences: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    warnings: tuple[str, ...] = ()


def write_sheet(sheet: Sheet, path: str | Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    context = {"sheet": sheet, "groups": _groups(sheet.parameters), "version": handcal.__version__}
    output.write_text(path, page("lab.html.j2", context))


def print_sheet(sheet: Sheet, console: Console) -> None:
    """The same without the pictures."""
    from rich.markup import escape
    from rich.padding import Padding

    console.print(f"[bold]{escape(sheet.title)}[/]  {escape(sheet.sub)}", highlight=False)
    print_bullets(console, sheet.sentences)
    if sheet.parameters:
        columns = ("parameter", "value", "± 1 sigma", "unit")
        rows = [(f"{g['title']} {r['name']}".rstrip(), r["value"], r["sigma"], g["unit"])
                for g in _groups(sheet.parameters) for r in g["rows"]]  # fmt: skip
        console.print(_table(columns, rows, numbers=(1, 2)))
    for table in sheet.tables:
        console.print(f"[bold]{escape(table.heading)}[/]")
        numbers = range(table.text, len(table.columns))
        console.print(_table(table.columns, table.rows, numbers))
        if table.note:
            console.print(Padding(escape(table.note), (0, 0, 1, 0)), highlight=False)
    print_section(console, "Warnings", sheet.warnings)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int]) -> Any:
    from rich.markup import escape

    out = terminal_table(*(f">{c}" if i in numbers else f"*{c}" for i, c in enumerate(columns)))
    for row in rows:
        out.add_row(*(escape(cell) for cell in row))
    return out


def _groups(parameters: Sequence[Parameter]) -> list[dict[str, Any]]:
    out = []
    for (effect, _), group in words.by_effect(parameters).items():
        unit = words.shown_group(group)
        rows = [
            {"name": words.parameter_name(p), "value": unit.value(p.value, p.sigma, sign=True),
             "sigma": unit.value(p.sigma, p.sigma)}
            for p in group
        ]  # fmt: skip
        out.append({"title": words.effect_title(effect), "unit": unit.unit, "rows": rows})
    return out

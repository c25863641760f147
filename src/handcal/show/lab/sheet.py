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
    for sentence in sheet.sentences:
        console.print(Padding(escape(f"• {sentence}"), (0, 0, 0, 2)), highlight=False)
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
    if sheet.warnings:
        console.print("[bold]Warnings[/]")
        for sentence in sheet.warnings:
            console.print(Padding(escape(f"• {sentence}"), (0, 0, 0, 2)), highlight=False)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int]) -> Any:
    from rich import box
    from rich.markup import escape
    from rich.table import Table as Rich

    table = Rich(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i in numbers else "left", no_wrap=i in numbers)
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    return table


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

"""A calibration as text in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from handcal.show import words
from handcal.show.calibration import verdict_text
from handcal.show.calibration.shown import in_front, under_table
from handcal.show.calibration.summary import all_warnings
from handcal.show.doubts import nis_word
from handcal.show.terminal import print_section, table
from handcal.types import Parameter, Result

if TYPE_CHECKING:
    from rich.console import Console

WIDE = 96  # columns of a terminal that has room for everything


def print_summary(result: Result, console: Console) -> None:
    """Verdict, parameters, consistency and what the motion could not show, in the terminal."""
    from rich.markup import escape
    from rich.padding import Padding

    recording, judged = result.recording, verdict_text.verdict(result)
    colour = {"good": "green", "partly": "yellow", "poor": "red"}[judged.level]
    console.print(
        f"[bold]{escape(recording.path)}[/]  {recording.duration_s:.1f} s at "
        f"{recording.rate_hz:.0f} Hz; {words.counted(len(result.rests), 'rest')}"
    )
    console.print(f"[bold {colour}]{escape(judged.headline)}[/]")
    for sentence in judged.sentences:
        console.print(Padding(escape(sentence), (0, 0, 0, 2)))
    front, rest = in_front(result.parameters)
    console.print(_parameter_table(front, prior=console.width >= WIDE))
    for line in filter(None, (*under_table(front, rest), words.marker_sentence(result.marker))):
        console.print(Padding(escape(line), (0, 0, 1, 2)), highlight=False)
    console.print(_kind_table(result))
    for heading, sentences in (
        ("What this motion could not show", verdict_text.not_shown(result)),
        ("Warnings", all_warnings(result)),
    ):
        print_section(console, heading, sentences)


def _parameter_table(parameters: Sequence[Parameter], prior: bool) -> Any:
    columns = (">value", ">± 1 sigma", *([">prior ±"] if prior else []))
    rows = table("parameter", *columns, "*unit", "*shown", "*settled")
    for group in words.by_effect(parameters).values():
        unit = words.shown_group(group)
        for p in group:
            at = "" if p.converged_at_s is None else f"{p.converged_at_s:.0f} s"
            seen = "[green]yes[/]" if p.shown else "[yellow]no[/]"
            row = (unit.value(p.value, p.sigma, sign=True), unit.value(p.sigma, p.sigma))
            before = [unit.value(p.prior_sigma)] if prior else []
            rows.add_row(words.parameter_title(p), *row, *before, unit.unit, seen, at)
    return rows


def _kind_table(result: Result) -> Any:
    rows = table("*observation", ">*updates", ">*NIS / dof", "*the filter is")
    for kind, i in result.innovations.items():
        nis = "–" if i.mean_nis is None else f"{i.mean_nis:.2f}"
        rows.add_row(words.kind_title(kind), str(i.t.size), nis, nis_word(i))
    return rows

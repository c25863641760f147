"""The catalogue of effects in words: groups, usual sizes, needs; for the terminal and docs/."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Final

import handcal
from handcal.effects import PLACE, Effect, Param
from handcal.recordings.streams import STREAMS
from handcal.units import shown

if TYPE_CHECKING:
    from rich.console import Console

    from handcal import results

SCHEMA: Final = "handcal/effects/1"
GROUPS = (
    ("Gyro", ("gyro_",)),
    ("Accelerometer", ("accel_",)),
    ("Heading and magnetometer", ("heading_", "mag_")),
    ("Place, world and clocks", ("",)),
)


def grouped(known: Mapping[str, Effect]) -> list[tuple[str, list[Effect]]]:
    """The effects under headings, in their order."""
    left = dict(known)
    out = []
    for title, prefixes in GROUPS:
        out.append((title, [left.pop(i) for i in list(left) if i.startswith(prefixes)]))
    return out


def usual(effect: Effect) -> list[str]:
    """ "each 0.01 rad (0.573 deg)", one for all parameters that are alike."""
    said = []
    for (si_unit, sigma), group in groupby(effect.parameters, _kind):
        names = [p.name for p in group]
        if effect.moments is not None and si_unit == "s":
            said.append(f"{names[0]} any moment, in s after the first sample")
            continue
        unit = shown(si_unit, [sigma])
        friendly = f"{unit.value(sigma)} {unit.unit}"
        si = friendly if si_unit == "1e-6" else f"{sigma:g}" + f" {si_unit}" * (si_unit != "1")
        more = "" if friendly == si else f" ({friendly})"
        said.append(f"{'each' if len(names) > 1 else names[0]} {si}{more}")
    return said


def _kind(p: Param) -> tuple[str, float]:
    return p.unit, p.prior_sigma


def needs(effect: Effect) -> list[str]:
    """What a recording must have for it to be told."""
    out = [f"a stream `{n}`" for n in effect.needs if n in STREAMS]
    return out + ["a held point or a stream `pose`"] * (PLACE in effect.needs)


def effects_json(known: Mapping[str, Effect]) -> results.effects.Effects:
    """``effects --json``."""
    return {
        "schema": SCHEMA,
        "version": handcal.__version__,
        "effects": [
            {"id": e.id, "title": e.title, "story": e.story, "motion": e.motion,
             "source": e.source, "validated": e.validated, "common": e.common,
             "parameters": [{"name": p.name, "unit": p.unit, "prior_sigma": p.prior_sigma}
                            for p in e.parameters]}
            for e in known.values()
        ],
    }  # fmt: skip


def print_catalogue(known: Mapping[str, Effect], console: Console) -> None:
    """All effects: id, what they do, what is usual of them."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    for title, effects in grouped(known):
        if not effects:
            continue
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=title, title_justify="left",
                      title_style="bold", expand=False)  # fmt: skip
        table.add_column("id", no_wrap=True, style="cyan")
        table.add_column("what it does")
        table.add_column("usual")
        table.add_column("common")
        for e in effects:
            also = "yes" if e.common or e.baseline else ""
            table.add_row(e.id, escape(e.story), escape("; ".join(usual(e))), also)
        console.print(table)
    console.print("[bold]handcal effects ID[/] says what shows one, and where it is from.",
                  highlight=False)  # fmt: skip


def print_effect(effect: Effect, console: Console) -> None:
    """One effect: all that the catalogue says of it."""
    from rich.markup import escape
    from rich.padding import Padding

    names = ",".join(p.name for p in effect.parameters)
    console.print(f"[bold]{escape(effect.title)}[/]  [cyan]{effect.id}[/]", highlight=False)
    told = (
        ("", effect.story),
        ("Parameters", f"--effect {effect.id}={names}, in {_units(effect)}"),
        ("Usual", "; ".join(usual(effect))),
        ("Common", effect.common or "no: tried beside what every device has"),
        ("What shows it", effect.motion),
        ("Needs", ", and ".join(needs(effect))),
        ("Source", effect.source),
        ("Tried on", effect.validated),
    )
    for heading, text in told:
        if text:
            said = f"[bold]{heading}:[/] {escape(text)}" if heading else escape(text)
            console.print(Padding(said, (0, 0, 0, 2)), highlight=False)


def _units(effect: Effect) -> str:
    """The SI units of the parameters, each once."""
    found = dict.fromkeys(p.unit for p in effect.parameters)
    return ", ".join("parts of one" if u == "1" else u for u in found)

"""Which motion to make next, as a page, as JSON and in the terminal."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import handcal
from handcal import output, units
from handcal.design.motion import Plan, Prospect
from handcal.show import words
from handcal.show.design.picture import write_figure
from handcal.show.drawing import INK, MUTED, RC, WIDE, XYZ, Plot, legend, svg
from handcal.show.html_page import page
from handcal.show.terminal import print_bullets, table
from handcal.types import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from handcal import results

SCHEMA: Final = "handcal/design-motion/1"
SHOWN = 6
WRAPPED = 44
LITTLE = 1.05


def write_motion_report(plan: Plan, path: str | Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    import matplotlib as mpl

    with mpl.rc_context(RC):
        figure = svg(_figure(plan), "design-motion")
    caption = (
        "Uncertainty after each motion (dots: x, y, z or the parameters in their order) and "
        "before (lines). Farther to the left is better."
    )
    context = {
        "version": handcal.__version__, "title": "What to do next", "sub": _asked(plan),
        "sentences": sentences(plan), "columns": _columns(plan), "rows": _rows(plan),
        "warnings": list(plan.warnings), "plot": Plot("Motions", caption, figure),
    }  # fmt: skip
    output.write_text(path, page("motion.html.j2", context))


def save_motion_picture(plan: Plan, path: Path) -> None:
    """Write the drawing. Errors: InputError where the ending is none of a picture."""
    write_figure(lambda: _figure(plan), path)


def motion_json(plan: Plan) -> results.design.DesignedMotion:
    """``design motion --json``: sigmas before and after each motion, the best motion first."""
    return {
        "schema": SCHEMA,
        "after": None if plan.result is None else plan.result.recording.path,
        "observations": list(plan.kinds),
        "before": [{"effect": p.effect, "name": p.name, "sigma": p.sigma,
                    "prior_sigma": p.prior_sigma, "unit": p.unit} for p in plan.wanted],
        "motions": [{"motion": p.motion.sentence, "seconds": p.motion.duration_s,
                     "times_smaller": p.times,
                     "sigma": [{"effect": w.effect, "name": w.name, "sigma": float(s),
                                "unit": w.unit}
                               for w, s in zip(plan.wanted, p.sigma, strict=True)]}
                    for p in plan.prospects],
        "warnings": list(plan.warnings),
    }  # fmt: skip


def print_motions(plan: Plan, console: Console) -> None:
    """What to do, and what each motion would bring."""
    from rich.markup import escape
    from rich.padding import Padding

    console.print(f"[bold]What to do next[/] {escape(_asked(plan))}", highlight=False)
    print_bullets(console, sentences(plan))
    rows = table("*", *(f">*{column}" for column in _columns(plan)[1:]))
    for n, row in enumerate(_rows(plan)):
        rows.add_row(f"{n}" if n else "now", *row[1:])
    console.print(rows)
    for n, prospect in enumerate(plan.prospects):
        said = escape(f"{n + 1}: {prospect.motion.sentence}")
        console.print(Padding(said, (0, 0, 0, 2)), highlight=False)
    print_bullets(console, plan.warnings)


def sentences(plan: Plan) -> list[str]:
    """The best motion and what it does, for somebody who is to make it."""
    best = plan.best
    if best.times < LITTLE:
        return [
            "None of these motions would tell much more than is known already. Let the device "
            "rest longer, or record something else that shows it (see `handcal explain`)."
        ]
    out = [best.motion.sentence]
    for effect, index in _effects(plan).items():
        before, unit = _before(plan, index), _unit(plan, index)
        factor = float(np.exp(np.log(before / best.sigma[index]).mean()))
        out.append(
            f"{words.effect_title(effect)}: uncertain by {_span(unit, before)} {unit.unit} before, "
            f"by {_span(unit, best.sigma[index])} {unit.unit} after: {factor:.3g} times less."
        )
    blind = [words.parameter_title(w).lower() for w, s in zip(plan.wanted, best.sigma, strict=True)
             if s > w.sigma / LITTLE]  # fmt: skip
    if blind:
        out.append(f"It hardly tells {words.listed(blind, 'or')}: choose another for that.")
    return out


def _span(unit: units.Shown, values: Array) -> str:
    low, high = (_two(float(v) * unit.factor) for v in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def _effects(plan: Plan) -> dict[str, list[int]]:
    """Indices of the wanted parameters, by effect."""
    out: dict[str, list[int]] = {}
    for i, p in enumerate(plan.wanted):
        out.setdefault(p.effect, []).append(i)
    return out


def _asked(plan: Plan) -> str:
    titles = words.listed([words.effect_title(e).lower() for e in _effects(plan)])
    if plan.result is None:
        return f"to tell {titles}, with nothing recorded yet."
    return f"to tell {titles} better, after {Path(plan.result.recording.path).name}."


def _columns(plan: Plan) -> list[str]:
    out = ["motion", "takes"]
    for effect, index in _effects(plan).items():
        unit = _unit(plan, index)
        title = words.effect_title(effect).lower()
        out.append(f"{title}, {unit.unit}".rstrip(", "))
    return [*out, "less by"]


def _rows(plan: Plan) -> list[list[str]]:
    rows = [["as it is known now", "", *_cells(plan, np.array([p.sigma for p in plan.wanted])), ""]]
    for p in plan.prospects:
        rows.append(
            [p.motion.sentence, f"{p.motion.duration_s:.0f} s", *_cells(plan, p.sigma), _times(p)]
        )
    return rows


def _times(p: Prospect) -> str:
    return f"{p.times:.0f} times" if p.times >= 10 else f"{p.times:.2f} times"


def _cells(plan: Plan, sigma: Array) -> list[str]:
    """Sigmas of each effect: all of them up to three, else the worst."""
    out = []
    for index in _effects(plan).values():
        unit = _unit(plan, index)
        values = [float(sigma[i]) for i in index]
        shown = values if len(values) <= 3 else [max(values)]
        out.append(" / ".join(_two(v * unit.factor) for v in shown))
    return out


def _two(x: float) -> str:
    return f"{x:.0f}" if x >= 10.0 else units.plain(x, 2)


def _before(plan: Plan, index: list[int]) -> Array:
    return np.array([plan.wanted[i].sigma for i in index])


def _unit(plan: Plan, index: list[int]) -> units.Shown:
    """The one unit of an effect, wherever it is written: that of what is known now."""
    return units.shown(plan.wanted[index[0]].unit, [float(_before(plan, index).max())])


def _figure(plan: Plan) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    effects, shown = _effects(plan), plan.prospects[:SHOWN]
    figure = Figure(figsize=(WIDE, 1.4 + 0.72 * len(shown)), layout="constrained")
    axes = figure.subplots(1, len(effects), sharey=True, squeeze=False)[0]
    place = np.arange(len(shown))[::-1]
    for ax, (effect, index) in zip(axes, effects.items(), strict=True):
        unit = _unit(plan, index)
        several = len(index) <= 3
        for n, i in enumerate(index):
            colour = XYZ[n % 3] if several else INK
            ax.axvline(unit.factor * plan.wanted[i].sigma, color=colour, lw=1.0, ls=(0, (3, 2)))
            at = [unit.factor * p.sigma[i] for p in shown]
            label = plan.wanted[i].name if several else None
            ax.plot(at, place + 0.12 * (1 - n if several else 0), "o", color=colour, markersize=6,
                    label=label)  # fmt: skip
        ax.set(xscale="log", xlabel=f"{words.effect_title(effect)}, {unit.unit}".rstrip(", "))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        if several and len(index) > 1:
            legend(ax)
    said = ["\n".join(textwrap.wrap(p.motion.sentence, WRAPPED)) for p in shown]
    axes[0].set_yticks(place, said, fontsize=8.5, color=MUTED)
    axes[0].set_ylim(-0.6, len(shown) - 0.4)
    return figure

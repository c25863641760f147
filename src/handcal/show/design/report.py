"""A set of poses as a page, as JSON and in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import handcal
from handcal import output, units
from handcal.design.poses import MOUNTING, NOISE
from handcal.design.search import HELD_WITHIN_DEG, Design
from handcal.show import words
from handcal.show.design.picture import poses_plot
from handcal.show.design.words import elevations, instruction
from handcal.show.html_page import page
from handcal.show.terminal import print_bullets, table

if TYPE_CHECKING:
    from rich.console import Console

SCHEMA = "handcal/design-poses/1"
READ = {
    "norm": "Let it rest in each pose; only the size of gravity is taken as known.",
    "pose": "Let it rest in each pose, held at that attitude by a cube, a dividing head or a "
    "turntable.",
    "rate": "In each pose, turn it steadily about the vertical on a rate table.",
    "spin": "In each pose, let it rest and then turn it steadily about the vertical; what "
    "changes is what counts.",
}
CRITERIA = {
    "D": "smallest volume of uncertainty (D)",
    "A": "smallest mean variance (A)",
    "condition": "smallest condition number",
}


def write_design_report(design: Design, path: str | Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    context = {
        "version": handcal.__version__, "title": _title(design), "sub": _asked(design),
        "read": READ[design.experiment.known], "facts": _facts(design), "rows": _rows(design),
        "sentences": _sentences(design), "sigmas": _sigmas(design), "noise": _noise(design),
        "plot": poses_plot(design),
    }  # fmt: skip
    output.write_text(path, page("design.html.j2", context))


def design_json(design: Design) -> dict[str, Any]:
    """``design poses --json``: up in body axes, elevations of x y z, and how good the set is."""
    e = design.experiment
    return {
        "schema": SCHEMA,
        "effects": _ids(design), "known": e.known, "criterion": design.criterion,
        "way": design.way, "rate": e.rate if e.known in ("rate", "spin") else None,
        "poses": [{"up": up.tolist(), "elevation_deg": elevations(up).tolist(),
                   "instruction": instruction(up)} for up in design.up],
        "d_efficiency": design.d_efficiency, "a_efficiency": design.a_efficiency,
        "condition": design.condition, "best_condition": design.best_condition,
        "d_efficiency_held_within_5_deg": design.loose,
        "reading_noise": {"gyro": NOISE[0], "accel": NOISE[1]},
        "parameters": [{"effect": u.effect, "name": u.param.name, "sigma": s, "unit": u.param.unit}
                       for u, s in zip(e.unknowns, design.sigma.tolist(), strict=True)],
    }  # fmt: skip


def print_design(design: Design, console: Console) -> None:
    """The poses, how good they are, and how well they tell the parameters."""
    console.print(f"[bold]{_title(design)}[/] {_asked(design)}")
    console.print(READ[design.experiment.known])
    poses = table(">*", "*how to lay it", *(f">{axis} up by" for axis in "xyz"))
    for row in _rows(design):
        poses.add_row(*row)
    console.print(poses)
    print_bullets(console, _sentences(design))
    sigmas = table(f"*with readings good to {_noise(design)}", ">*± 1 sigma", "*unit")
    for line in _sigmas(design):
        sigmas.add_row(*line)
    console.print(sigmas)


def _ids(design: Design) -> list[str]:
    return [e.id for e in design.experiment.effects]


def _title(design: Design) -> str:
    return f"{len(design.up)} poses"


def _asked(design: Design) -> str:
    titles = words.listed([words.effect_title(i).lower() for i in _ids(design) if i != MOUNTING.id])
    way = "one after the other" if design.way == "sequential" else "all at once"
    return f"for {titles}; {CRITERIA[design.criterion]}, chosen {way}."


def _facts(design: Design) -> list[tuple[str, str]]:
    return [
        (f"{design.d_efficiency:.3f}", "D-efficiency"),
        (f"{design.a_efficiency:.3f}", "A-efficiency"),
        (f"{design.condition:.3g}", f"condition number (best {design.best_condition:.3g})"),
        (f"{design.loose:.3f}", f"D-efficiency held within {HELD_WITHIN_DEG:.0f}°"),
    ]


def _sentences(design: Design) -> list[str]:
    return [
        f"D-efficiency {design.d_efficiency:.3f}, A-efficiency {design.a_efficiency:.3f}: 1 is the "
        "best that any number of poses reaches, for as many readings.",
        f"Condition number {design.condition:.3g}; the least possible is "
        f"{design.best_condition:.3g}.",
        f"Each pose need not be exact: held within {HELD_WITHIN_DEG:.0f}° (1 sigma), the "
        f"D-efficiency stays above {design.loose:.3f} in 19 of 20 tries.",
    ]


def _rows(design: Design) -> list[tuple[str, ...]]:
    return [
        (f"{i + 1}", instruction(up), *(_degrees(e) for e in elevations(up)))
        for i, up in enumerate(design.up)
    ]


def _degrees(angle: float) -> str:
    return f"{round(angle)}°".replace("-", "−")


def _sigmas(design: Design) -> list[tuple[str, str, str]]:
    """Title, the largest sigma of an effect's parameters, unit."""
    largest: dict[tuple[str, str], float] = {}
    for u, sigma in zip(design.experiment.unknowns, design.sigma, strict=True):
        key = (u.effect, u.param.unit)
        largest[key] = max(largest.get(key, 0.0), float(sigma))
    out = []
    for (effect, unit), sigma in largest.items():
        shown = units.shown(unit, [sigma])
        title = MOUNTING.title if effect == MOUNTING.id else words.effect_title(effect)
        out.append((title, shown.value(sigma), shown.unit))
    return out


def _noise(design: Design) -> str:
    """What readings are taken to be good to."""
    said = []
    for sensor, (unit, sigma) in enumerate(zip(("rad/s", "m/s^2"), NOISE, strict=True)):
        if any(i // 3 == sensor for i in design.experiment.rows):
            shown = units.shown(unit, [sigma])
            said.append(f"{shown.value(sigma)} {shown.unit}")
    return words.listed(said)

"""How parameters of devices change from one recording to the next: as JSON, tables and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from handcal.population.by_model import Change
from handcal.population.drift import DAY_S
from handcal.show import words
from handcal.show.calibration.summary import finite
from handcal.show.drawing import RC, XYZ, Plot, canvas, svg
from handcal.units import shown

if TYPE_CHECKING:
    from handcal import results

PARTS = ("turn_on", "ageing", "temperature", "step")
# Rows of steps and devices drawn, beyond which a page is no help.
MOST_STEPS, MOST_DRAWN = 30, 40


def change_json(c: Change) -> results.fleet.FleetChange:
    """As it stands in fleet.json."""
    d = c.drift
    return {
        "effect": c.effect, "name": c.name, "unit": c.unit, "recordings": d.count, "days": d.days,
        "turn_on": d.turn_on, "ageing": d.ageing, "slope": finite(d.slope),
        "slope_sigma": finite(d.slope_sigma), "slope_spread": finite(d.slope_spread),
        "shares": {"turn_on": d.shares["turn_on"], "ageing": d.shares["ageing"],
                   "temperature": d.shares["temperature"], "step": d.shares["step"]},
        "steps": [
            {"device": s.who, "after": _time(c, s.index, -1), "until": _time(c, s.index, 0),
             "size": s.size, "sigma": s.sigma, "probability": s.probability}
            for s in d.steps
        ],
    }  # fmt: skip


def _time(c: Change, index: int, beside: int) -> str:
    """When a recording began, or the one of the same device before it; ISO 8601."""
    own = [i for i, w in enumerate(c.who) if w == c.who[index] and np.isfinite(c.started[i])]
    own.sort(key=lambda i: float(c.started[i]))
    when = float(c.started[own[own.index(index) + beside]])
    return datetime.fromtimestamp(when, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def rows_of(changes: Sequence[Change]) -> list[tuple[str, ...]]:
    """A row for each parameter that changes."""
    out: list[tuple[str, ...]] = []
    for c in changes:
        d = c.drift
        if not any(d.shares.values()):
            continue
        slope = 0.0 if math.isnan(d.slope) else d.slope
        unit = shown(c.unit, [d.turn_on, d.ageing, 10.0 * slope, *(s.size for s in d.steps)])
        sigma = unit.value(d.slope_sigma, d.slope_sigma)
        by_heat = f"{unit.value(slope, d.slope_sigma, sign=True)} ± {sigma}"
        out.append((
            f"{words.effect_title(c.effect)} {c.name}",
            unit.value(d.turn_on) if d.turn_on else "–", unit.value(d.ageing) if d.ageing else "–",
            "–" if math.isnan(d.slope) else by_heat,
            *(f"{100.0 * d.shares[p]:.0f} %" for p in PARTS), unit.unit, str(d.count),
        ))  # fmt: skip
    return out


def steps_of(changes: Sequence[Change]) -> list[tuple[str, ...]]:
    """A row for each step, the most probable first."""
    steps = [(s, c) for c in changes for s in c.drift.steps]
    steps.sort(key=lambda one: -one[0].probability)
    out: list[tuple[str, ...]] = []
    for s, c in steps[:MOST_STEPS]:
        unit = shown(c.unit, [s.size])
        size = f"{unit.value(s.size, s.sigma, sign=True)} ± {unit.value(s.sigma, s.sigma)}"
        when = f"{_time(c, s.index, -1)[:10]} and {_time(c, s.index, 0)[:10]}"
        out.append((s.who, f"{words.effect_title(c.effect)} {c.name}", f"{size} {unit.unit}", when,
                    f"{100.0 * s.probability:.3g} %"))  # fmt: skip
    return out


def histories(model: str, changes: Sequence[Change]) -> list[Plot]:
    """Of each effect that ages or has steps, its parameters over time, a line for each device."""
    import matplotlib as mpl

    alive = [c for c in changes if c.drift.ageing > 0.0 or c.drift.steps]
    with mpl.rc_context(RC):
        return [
            _effect(model, effect, [c for c in alive if c.effect == effect])
            for effect in dict.fromkeys(c.effect for c in alive)
        ]


def _effect(model: str, effect: str, rows: Sequence[Change]) -> Plot:
    unit = shown(rows[0].unit, [float(np.nanmax(np.abs(c.value))) for c in rows])
    first = min(float(np.nanmin(c.started)) for c in rows)
    figure, axes = canvas(len(rows), 0.6 + 1.3 * len(rows))
    for ax, c in zip(axes, rows, strict=True):
        stepped = {s.who for s in c.drift.steps}
        drawn = [*stepped, *(w for w in dict.fromkeys(c.who) if w not in stepped)][:MOST_DRAWN]
        for who in drawn:
            at = [i for i, w in enumerate(c.who) if w == who and np.isfinite(c.started[i])]
            at.sort(key=lambda i: float(c.started[i]))
            days, value = (c.started[at] - first) / DAY_S, unit.factor * c.value[at]
            colour, width = (XYZ[0], 1.2) if who in stepped else (XYZ[2], 0.5)
            ax.plot(days, value, marker=".", ms=3, color=colour, lw=width)
        ax.set_ylabel(f"{c.name}, {unit.unit}" if unit.unit else c.name)
    axes[-1].set_xlabel("days")
    caption = "Each line: one device, recording by recording; orange: devices with a step."
    title = f"{words.effect_title(effect)} over time"
    return Plot(title, caption, svg(figure, f"fleet-{model}-{effect}-history"))

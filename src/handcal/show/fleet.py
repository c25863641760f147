"""What a fleet tells: as JSON, and as a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import handcal
from handcal import output
from handcal.device.file import unit_of
from handcal.effects import catalogue
from handcal.population.by_model import Common, Model
from handcal.population.odd import Odd
from handcal.population.stacked import FOUND, Stack
from handcal.show import common_law, words
from handcal.show.calibration.summary import finite
from handcal.show.changes import change_json, histories, rows_of, steps_of
from handcal.show.common_law import law_json
from handcal.show.drawing import RC, SHADE, XYZ, Plot, canvas, svg, thin
from handcal.show.html_page import page
from handcal.trust import Trust, json_of
from handcal.units import Shown, shown

if TYPE_CHECKING:
    from handcal import results

SCHEMA = "handcal/fleet/1"
# Rows of a table, and effects without any evidence, beyond which a page is no help.
MOST_ROWS, MOST_STACKS = 50, 12
# Devices that are drawn one by one, of each parameter.
MOST_DRAWN = 300


@dataclass(frozen=True)
class Fleet:
    """models; failures: path, status and reason of each recording without a result; verdicts: how
    often each; done: recordings with a result; untold: path and reason of each of these that tells
    nothing of the devices of its model; doubted: by path, of what tells of them in spite of it."""

    models: tuple[Model, ...]
    failures: tuple[tuple[str, str, str], ...]
    verdicts: Mapping[str, int]
    done: int
    untold: tuple[tuple[str, str], ...] = ()
    doubted: Mapping[str, Trust] = field(default_factory=dict)


def fleet_json(fleet: Fleet) -> dict[str, Any]:
    """The fleet as JSON."""
    return {
        "schema": SCHEMA,
        "recordings": {"done": fleet.done, "failed": len(fleet.failures)},
        "verdicts": dict(fleet.verdicts),
        "models": [_model_json(m) for m in fleet.models],
        "failures": [{"path": p, "status": s, "reason": r} for p, s, r in fleet.failures],
        "untold": [{"path": p, "reason": r} for p, r in fleet.untold],
        "doubted": [{"path": p} | json_of(own) for p, own in fleet.doubted.items()],
    }


def _model_json(m: Model) -> results.fleet.FleetModel:
    return {
        "name": m.name, "recordings": m.recordings, "devices": m.devices,
        "populations": [_population_json(c) for c in m.common],
        "stacked": [
            {"effect": s.effect, "log_evidence_gain": finite(s.gain),
             "over_single_devices": finite(s.over_some), "probability": s.probability,
             "devices": s.devices, "best_alone": finite(s.best_alone)}
            for s in m.stacks
        ],
        "odd": [
            {"who": o.who, "kind": o.kind, "by_chance": finite(o.by_chance), "effect": o.effect,
             "name": o.name, "value": finite(o.value), "sigma": finite(o.sigma),
             "mean": finite(o.mean), "deviation": finite(o.deviation), "like": o.like,
             "reason": reason(o), "left_out": o.left_out}
            for o in m.odd
        ],
        "changes": [change_json(c) for c in m.changes], "law": law_json(m.law),
    }  # fmt: skip


def _population_json(c: Common) -> results.fleet.FleetPopulation:
    p = c.population
    return {
        "effect": c.effect, "name": c.name, "unit": c.unit, "devices": p.count,
        "mean": finite(p.mean), "mean_sigma": finite(p.mean_sigma),
        "spread": finite(p.spread), "spread_from": finite(p.low), "spread_to": finite(p.high),
        "tail": "normal" if math.isinf(p.dof) else "student_t", "dof": finite(p.dof),
        "turn_on": finite(p.apart) if not c.stays else None, "usual": c.usual, "told": c.told,
        "of": "device" if c.own else "occasion",
    }  # fmt: skip


def reason(o: Odd) -> str:
    """Why a device or a recording is odd, in a sentence."""
    if o.kind == "refused":
        return f"{round(o.value)} of its recordings could not be used. {o.said}"
    if o.kind == "gravity":
        return (f"Its accelerometer reads {o.value:.3g} m/s² where gravity is 9.8: another unit, "
                "or no specific force.")  # fmt: skip
    unit = shown(unit_of((o.effect, o.name)), [o.value, o.mean, o.deviation])
    value = unit.value(o.value, o.sigma, sign=True)
    mean = unit.value(o.mean, o.deviation, sign=True)
    deviation = unit.value(o.deviation, o.deviation)
    whose = "devices of the model have" if o.kind == "device" else "its device's others say"
    # (an effect of one number has no need of its name)
    which = f" {o.name}" if len(catalogue()[o.effect].parameters) > 1 else ""
    out = (f"{words.effect_title(o.effect)}{which} is {value} {unit.unit}; {whose} {mean} ± "
           f"{deviation}.")  # fmt: skip
    return out + _guess(o) + (" Populations are told without it." if o.left_out else "")


def _guess(o: Odd) -> str:
    """What may lie behind it."""
    if o.like:
        return f" In everything it is like {o.like}: is it that one?"
    if o.effect in ("gyro_scale", "accel_scale"):
        if abs(o.value + 2.0) < 0.1:
            return " That is an axis whose sign is turned round."
        # (a scale of 57.3 or of its reciprocal, to 5 % and to 0.3 %)
        units = ((180.0 / math.pi, 3.0), (math.pi / 180.0, 3e-3))
        if any(abs(1.0 + o.value - factor) < within for factor, within in units):
            return " That is degrees for radians, or the other way round."
    return ""


def write_page(fleet: Fleet, path: Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    devices, models = sum(m.devices for m in fleet.models), len(fleet.models)
    context = {
        "version": handcal.__version__,
        "facts": [(str(fleet.done), f"{words.noun_of(fleet.done, 'recording')} explained"),
                  (str(len(fleet.failures)), "without a result"),
                  (str(devices), words.noun_of(devices, "device")),
                  (str(models), words.noun_of(models, "model"))],
        "models": [_section(m) for m in fleet.models],
        "failures": [(Path(p).name, s, r) for p, s, r in fleet.failures[:MOST_ROWS]],
        "untold": [(Path(p).name, r) for p, r in fleet.untold[:MOST_ROWS]],
        "doubted": [(Path(p).name, own.level, " ".join(own.reasons))
                    for p, own in [*fleet.doubted.items()][:MOST_ROWS]],
        "more": max(0, len(fleet.failures) - MOST_ROWS),
    }  # fmt: skip
    output.write_text(path, page("fleet.html.j2", context))


def _section(m: Model) -> dict[str, Any]:
    return {
        "name": m.name, "recordings": m.recordings, "devices": m.devices, "plots": draw(m),
        "populations": [_row(c) for c in m.common],
        "stacks": [_stack_row(s) for s in m.stacks[:MOST_STACKS]],
        "changes": rows_of(m.changes), "steps": steps_of(m.changes),
        "histories": histories(m.name, m.changes),
        "law": None if m.law is None else common_law.row_of(m.law),
        "law_plot": None if m.law is None else common_law.drawn(m.name, m.law),
        "odd": [(_who(o), _times(o.by_chance), reason(o)) for o in m.odd[:MOST_ROWS]],
    }  # fmt: skip


def _who(o: Odd) -> str:
    return o.who if o.kind in ("device", "refused") else Path(o.who).name


def _times(expected: float) -> str:
    return f"{expected:.2g}" if expected > 1e-6 else "never"


def _row(c: Common) -> tuple[str, ...]:
    p = c.population
    unit = shown(c.unit, [p.mean, p.high])
    tail = "normal" if math.isinf(p.dof) else f"t, {p.dof:g}"
    apart = "–" if c.stays or math.isnan(p.apart) else unit.value(p.apart, p.high - p.low)
    return (
        f"{words.effect_title(c.effect)} {c.name}",
        f"{unit.value(p.mean, p.mean_sigma, sign=True)} ± {unit.value(p.mean_sigma, p.mean_sigma)}",
        unit.value(p.spread, 0.25 * (p.high - p.low)),
        f"{unit.value(p.low, p.low)} to {unit.value(p.high, p.high)}",
        tail, apart, unit.value(c.usual), unit.unit, str(p.count), _in_priors(c),
    )  # fmt: skip


def _in_priors(c: Common) -> str:
    return ("yes" if c.told else "no") if c.own else "no: of the occasion"


def _stack_row(s: Stack) -> tuple[str, ...]:
    return (words.effect_title(s.effect), f"{s.gain:.1f}", f"{s.over_some:.1f}",
            f"{s.best_alone:.1f}", str(s.devices), f"{100 * s.probability:.3g} %",
            "found" if s.probability > FOUND else "")  # fmt: skip


def draw(m: Model) -> list[Plot]:
    """Of each effect the populations, with the devices on them."""
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return [_effect(m, effect, list(rows)) for effect, rows in _by_effect(m.common)]


def _by_effect(common: Sequence[Common]) -> Iterator[tuple[str, list[Common]]]:
    for effect in dict.fromkeys(c.effect for c in common):
        yield effect, [c for c in common if c.effect == effect]


def _effect(m: Model, effect: str, rows: Sequence[Common]) -> Plot:
    reach = [abs(c.population.mean) + 4.0 * c.population.deviation for c in rows]
    unit = shown(rows[0].unit, [max(reach), *(float(np.abs(c.value).max()) for c in rows)])
    figure, (ax,) = canvas(1, 0.9 + 0.55 * len(rows))
    for k, c in enumerate(rows):
        _population(ax, k, c, unit)
    ax.set_yticks(range(len(rows)), [c.name for c in rows])
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_xlabel(unit.unit or "1")
    caption = ("Band: one and two spreads of the true errors; line: their mean; dots: devices with "
               "their own sigma.")  # fmt: skip
    return Plot(words.effect_title(effect), caption, svg(figure, f"fleet-{m.name}-{effect}"))


def _population(ax: Any, k: int, c: Common, unit: Shown) -> None:
    p, f = c.population, unit.factor
    for times in (2.0, 1.0):
        ax.fill_between([f * (p.mean - times * p.spread), f * (p.mean + times * p.spread)],
                        k - 0.4, k + 0.4, color=SHADE, alpha=0.75, linewidth=0)  # fmt: skip
    ax.plot([f * p.mean] * 2, [k - 0.4, k + 0.4], color=XYZ[0], lw=1.6)
    at = thin(len(c.value), MOST_DRAWN)
    # (one under the other in the order of their values, so that none hides another)
    y = k - 0.3 + 0.6 * np.argsort(np.argsort(c.value[at])) / max(1, len(at) - 1)
    low, high = p.mean - 8.0 * p.deviation, p.mean + 8.0 * p.deviation
    sigma = np.minimum(c.sigma[at], high - low)
    ax.errorbar(f * c.value[at], y, xerr=f * sigma, fmt=".", color=XYZ[2], ms=3, elinewidth=0.5)

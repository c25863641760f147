"""Curves against temperature as JSON, as a page and in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from handcal.lab.thermal.curves import Curve, Thermal
from handcal.lab.thermal.model import SENSORS
from handcal.show import words
from handcal.show.drawing import RC, XYZ, Plot, canvas, legend, svg
from handcal.show.lab.sheet import Sheet, Table
from handcal.types import Array
from handcal.units import shown

if TYPE_CHECKING:
    from handcal import results

SCHEMA: Final = "handcal/lab-thermal/1"
ROWS, LINE = 7, 200
UNITS = {"gyro": "rad/s", "accel": "m/s^2"}
# More nats than this for one curve over the next best leave no doubt worth telling.
CLEAR = 5.0


def thermal_json(result: Thermal) -> results.lab.Thermal:
    """``lab thermal --json``: of each parameter its values at the knots that give the curve, and
    the powers of (T - zero) where it is a polynomial."""
    low, high = result.span
    return {
        "schema": SCHEMA,
        "recordings": [r.path for r in result.recordings],
        "from_degC": low, "to_degC": high, "pieces": len(result.pieces),
        "curves": [_curve_json(c) for c in result.curves],
        "noise": [{"name": f"{s}_beyond_noise", "value": result.extra[s], "unit": UNITS[s]}
                  for s in SENSORS],
        "residual_rms": {"before": _rms(result.before).tolist(),
                         "after": _rms(result.residual).tolist(),
                         "unit": "rad/s, m/s^2"},
        "warnings": list(_warnings(result)),
    }  # fmt: skip


def _curve_json(c: Curve) -> results.lab._ThermalCurve:
    value, sigma = c.at(c.basis.knots)
    out: results.lab._ThermalCurve = {
        "effect": c.effect, "name": c.name, "unit": c.unit,
        "kind": c.basis.kind, "degree": c.basis.degree,
        "absolute": c.anchored,
        "degC": c.basis.knots.tolist(), "value": value.tolist(), "sigma": sigma.tolist(),
        "log_evidence_gain": c.gain,
        "runner_up": {"curve": c.runner[0], "log_evidence_less": c.runner[1]},
    }  # fmt: skip
    if c.basis.kind == "polynomial":
        zero, half = c.basis.middle, 0.5 * (c.basis.high - c.basis.low)
        powers = np.polynomial.legendre.leg2poly(c.c) / half ** np.arange(len(c.c))
        if not c.anchored:
            powers[0] = 0.0
        out |= {"zero_degC": zero, "powers": powers.tolist()}
    return out


def thermal_sheet(result: Thermal, name: str, pictures: bool) -> Sheet:
    """What a person sees; name: of the files."""
    low, high = result.span
    groups = _groups(result)
    before, after = _rms(result.before), _rms(result.residual)
    return Sheet(
        title=f"Temperature of {name}",
        sub=f"{low:.1f} to {high:.1f} °C, {len(result.pieces)} stretches at rest"
        if result.pieces.known is None
        else f"{low:.1f} to {high:.1f} °C, {len(result.pieces)} steady stretches with a reference",
        facts=tuple(
            (_most(group), f"{words.effect_title(effect).lower()}: largest change")
            for effect, group in groups.items()
        ),
        sentences=tuple(_sentences(groups, before, after)),
        parameters=(),
        tables=tuple(_table(effect, group, low, high) for effect, group in groups.items()),
        plots=tuple(_plots(result, groups)) if pictures else (),
        warnings=_warnings(result),
    )


def _groups(result: Thermal) -> dict[str, list[Curve]]:
    out: dict[str, list[Curve]] = {}
    for c in result.curves:
        out.setdefault(c.effect, []).append(c)
    return out


def _changes(c: Curve) -> float:
    """Highest less lowest value within the span."""
    value, _ = c.at(np.linspace(c.basis.low, c.basis.high, LINE))
    return float(np.ptp(value))


def _most(group: Sequence[Curve]) -> str:
    most = max(_changes(c) for c in group)
    unit = shown(group[0].unit, [most])
    return f"{unit.value(most)} {unit.unit}"


def _sentences(groups: dict[str, list[Curve]], before: Array, after: Array) -> list[str]:
    out = []
    for effect, group in groups.items():
        c, title = group[0], words.effect_title(effect)
        second = f" ({c.runner[0]} comes next, {c.runner[1]:.1f} nats behind)"
        close = second if c.runner[1] < CLEAR else ""
        if c.basis.size == 1:
            out.append(f"{title}: no change with temperature was seen{close}.")
        else:
            out.append(
                f"{title}: {c.basis.title}, which gains {c.gain:.0f} nats of evidence over a "
                f"constant{close}; it changes by {_most(group)} at most."
            )
    for s, sensor in enumerate(("gyro", "accelerometer")):
        own = slice(3 * s, 3 * s + 3)
        unit = shown(UNITS[SENSORS[s]], [float(before[own].max())])
        least, most = (unit.value(float(x[own].max())) for x in (after, before))
        out.append(
            f"With one value for all temperatures {most} {unit.unit} of the {sensor}'s readings "
            f"are left on the worst axis, with the curves {least} {unit.unit} (root mean square)."
        )
    return out


def _table(effect: str, group: Sequence[Curve], low: float, high: float) -> Table:
    T = np.linspace(low, high, ROWS)
    values = [c.at(T) for c in group]
    unit = shown(group[0].unit, [float(np.abs(v).max()) for v, _ in values])
    rows = tuple(
        (f"{t:.1f}", *(f"{unit.value(float(v[i]), float(s[i]), sign=True)} ± "
                       f"{unit.value(float(s[i]), float(s[i]))}" for v, s in values))
        for i, t in enumerate(T)
    )  # fmt: skip
    relative = [c.name for c in group if not c.anchored]
    note = ""
    if relative:
        note = (
            f"Of {words.listed(relative)} only the change against {group[0].basis.middle:.1f} °C "
            "is known: gravity was not seen from enough sides."
        )
    return Table(
        f"{words.effect_title(effect)}, {unit.unit}".rstrip(", "),
        ("°C", *(c.name for c in group)), rows, text=1, note=note,
    )  # fmt: skip


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def _warnings(result: Thermal) -> tuple[str, ...]:
    read = [w for r in result.recordings for w in r.warnings]
    return tuple(dict.fromkeys((*read, *result.warnings)))


def files_title(paths: Sequence[Path]) -> str:
    """ "a.mcap", "a.mcap and 2 more"."""
    more = len(paths) - 1
    return paths[0].name + (f" and {more} more" if more else "")


# --- pictures -----------------------------------------------------------------------------------


def _plots(result: Thermal, groups: dict[str, list[Curve]]) -> list[Plot]:
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return [_plot(result, effect, group) for effect, group in groups.items()]


def _plot(result: Thermal, effect: str, group: Sequence[Curve]) -> Plot:
    """Curves with their bands; of a bias also each stretch, by what is left of its readings."""
    figure, (ax,) = canvas(1, 4.4)
    T = np.linspace(*result.span, LINE)
    curves = [c.at(T) for c in group]
    unit = shown(group[0].unit, [float(np.abs(v).max()) for v, _ in curves])
    for n, (c, (value, sigma), colour) in enumerate(zip(group, curves, XYZ, strict=True)):
        low, high = unit.factor * (value - 2.0 * sigma), unit.factor * (value + 2.0 * sigma)
        ax.fill_between(T, low, high, color=colour, alpha=0.18, lw=0)
        ax.plot(T, unit.factor * value, color=colour, label=c.name)
        if effect.endswith("_bias"):
            left = result.residual[:, n + 3 * SENSORS.index(effect.split("_")[0])]
            points = unit.factor * (c.at(result.pieces.T)[0] + left)
            ax.plot(result.pieces.T, points, ".", color=colour, markersize=4, alpha=0.6)
    ax.set(xlabel="temperature, °C", ylabel=unit.unit)
    legend(ax)
    dots = " Dots: the stretches." if effect.endswith("_bias") else ""
    caption = f"{group[0].basis.title.capitalize()}, with two sigma.{dots}"
    return Plot(words.effect_title(effect), caption, svg(figure, f"thermal-{effect}"))

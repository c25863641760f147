"""The law without a name that devices have in common: as JSON, as a row, drawn."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from handcal.laws.law_effect import Law
from handcal.laws.of_devices import SCALE, all_laws
from handcal.population.laws import CommonLaw
from handcal.show.drawing import RC, SHADE, XYZ, Plot, canvas, svg
from handcal.units import shown

if TYPE_CHECKING:
    from handcal import results

# How far the driver is drawn, in scales of a hand's motion, and at how many places.
REACH, POINTS = 1.5, 201
# Devices that are drawn one by one.
MOST_DRAWN = 40


def law_of(c: CommonLaw) -> Law:
    """The law itself."""
    return all_laws()[c.index]


def law_json(c: CommonLaw | None) -> results.fleet.FleetLaw | None:
    """As it stands in fleet.json."""
    if c is None:
        return None
    law, p, s = law_of(c), c.population, c.stack
    (parameter,) = law.parameters
    return {
        "formula": law.said, "channels": list(law.channels), "unit": parameter.unit,
        "mean": p.mean, "mean_sigma": p.mean_sigma, "spread": p.spread,
        "log_evidence_gain": s.gain, "over_single_devices": s.over_some,
        "probability": s.probability, "devices": s.devices, "best_alone": s.best_alone,
    }  # fmt: skip


def row_of(c: CommonLaw) -> tuple[str, ...]:
    """Formula, constant, spread, and the evidence."""
    p, s = c.population, c.stack
    unit = shown(law_of(c).parameters[0].unit, [p.mean, p.spread])
    constant = f"{unit.value(p.mean, p.mean_sigma, sign=True)} ± {unit.value(p.mean_sigma)}"
    return (law_of(c).said, f"{constant} {unit.unit}", unit.value(p.spread, p.mean_sigma),
            f"{s.gain:.1f}", f"{s.over_some:.1f}", f"{s.best_alone:.1f}", str(s.devices),
            f"{100.0 * s.probability:.3g} %")  # fmt: skip


def drawn(model: str, c: CommonLaw) -> Plot:
    """What the law adds over its driver, in a motion of a hand: the devices' mean with its band, of
    devices, and each device's own."""
    import matplotlib as mpl

    law, p = law_of(c), c.population
    top = REACH * SCALE.get(law.driver.unit, 1.0)
    x = np.linspace(-top if law.driver.signed else 0.0, top, POINTS)
    y = law.form.values(x)[:, 0]
    unit = shown(law.unit, [float(np.abs(p.mean * y).max())])
    with mpl.rc_context(RC):
        figure, (ax,) = canvas(1, 2.6)
        width = 2.0 * math.hypot(p.deviation, p.mean_sigma)
        low, high = (unit.factor * (p.mean + side * width) * y for side in (-1.0, 1.0))
        ax.fill_between(x, low, high, color=SHADE, alpha=0.75, linewidth=0)
        for k in c.value[:MOST_DRAWN]:
            ax.plot(x, unit.factor * k * y, color=XYZ[2], lw=0.4)
        ax.plot(x, unit.factor * p.mean * y, color=XYZ[0], lw=1.8)
        ax.set_xlabel(f"{law.driver.said(law.axis)}, {law.driver.unit}")
        ax.set_ylabel(f"{', '.join(law.channels)}, {unit.unit}")
    caption = "Line: the devices' mean; band: two standard deviations of a device; thin: each."
    return Plot("A law without a name", caption, svg(figure, f"fleet-{model}-law"))

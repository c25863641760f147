"""Laws that devices may have in common: a fixed list, of each what one recording tells.

One recording looks for the law that fits it best, with numbers and widths of its own; devices can
only be asked about the same laws. So here every law of the usual drivers stands in the same forms
and with the same numbers for all, and each recording says of each constant what its likelihood
alone makes of it, beside the model that was found there without its own unnamed laws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from handcal.effects import catalogue
from handcal.estimate.columns import Ground
from handcal.estimate.model import Model
from handcal.estimate.scan import grounds, scan
from handcal.laws.drivers import DRIVERS, FORCES, HEADING, LINE, LOAD, RATES, TURNS, Driver, usable
from handcal.laws.grammar import ATOMS, Form, Part, formula
from handcal.laws.law_effect import AXES_OF, SIZE, Law, effect_of
from handcal.laws.over_drivers import signals_of
from handcal.laws.weighing import beside
from handcal.signals import probe
from handcal.types import Array

# Forms of a curve's driver: those without numbers, and these with shares of the driver's scale.
PLAIN = ("square", "cube", "size", "signed square", "root", "signed root")
SHARES = {"sign": (0.05, 0.3), "dead zone": (0.1, 0.3), "compression": (0.5, 1.0),
          "excess": (0.5, 1.0)}  # fmt: skip
# What a hand turns and shakes at usual, by unit.
SCALE = {"rad/s": 2.0, "m/s^2": 10.0}
# Samples of the motion from which usual sizes come.
PROBED = 400
# Columns that one scan looks at.
COLUMNS = 140
# Information below this part of a usual size's is rounding.
LEAST = 1e-6
# Ways a law may be of a sensor: on each axis alone, and on all by one constant.
WAYS = ((0,), (1,), (2,), (0, 1, 2))


@dataclass(frozen=True)
class Known:
    """Of each law of ``all_laws`` (n,): value and sigma of its constant, SI, nan where the
    recording does not tell it."""

    value: Array
    sigma: Array


@cache
def all_laws() -> tuple[Law, ...]:
    """Every law that devices are asked about, those that the catalogue has among them."""
    return tuple(
        Law(sensor, axes, False, driver, form, (_usual(sensor, driver, form),))
        for sensor, driver, form in _forms()
        for axes in WAYS
    )


@cache
def _forms() -> tuple[tuple[int, Driver, Form], ...]:
    """Sensor, driver and form of each law, whatever its axes."""
    out = []
    for sensor in range(HEADING):
        for driver in DRIVERS.values():
            if driver.only not in (None, sensor) or driver.needs:
                continue
            for part in _parts(driver):
                form = formula([part])
                if _usual(sensor, driver, form) > 0.0:
                    out.append((sensor, driver, form))
    return tuple(out)


def _parts(driver: Driver) -> list[Part]:
    if driver.free:
        return []
    if driver.knots == LINE:
        return [("line", ())]
    if driver.name not in {d.name for d in (*RATES, *FORCES, TURNS, LOAD)}:
        return []
    scale = SCALE[driver.unit]
    plain: list[Part] = [(name, ()) for name in PLAIN]
    plain += [(name, (share * scale,)) for name, shares in SHARES.items() for share in shares]
    return [p for p in plain if driver.signed or not ATOMS[p[0]].sided]


@cache
def _usual(sensor: int, driver: Driver, form: Form) -> float:
    """The constant of a law that is clearly visible in a motion of all axes; 0 where it does
    nothing there."""
    signals = probe(PROBED)
    x = np.concatenate([form.values(driver.course(signals, axis)) for axis in range(3)])
    rms = float(np.sqrt(np.mean(x**2)))
    return SIZE[sensor] / rms if rms > 1e-9 else 0.0


def known_of(model: Model) -> Known:
    """What the first recording of a model tells of every law. Errors: as of ``scan``."""
    value, sigma = np.full((2, len(_forms()), len(WAYS)), np.nan)
    signals, base = signals_of(model.parts[0]), grounds(model)
    there = [n for n, (_, driver, _) in enumerate(_forms()) if usable(driver, signals)]
    for first in range(0, len(there), COLUMNS // 3):
        some = there[first : first + COLUMNS // 3]
        told = _told(model, base, [_forms()[n] for n in some])
        for n, (b, G) in zip(some, told, strict=True):
            usual = _usual(*_forms()[n])
            for way, axes in enumerate(WAYS):
                own, information = b[list(axes)].sum(), G[np.ix_(axes, axes)].sum()
                if np.isfinite(own) and information > LEAST:
                    value[n, way] = own / information * usual
                    sigma[n, way] = usual / np.sqrt(information)
    return Known(value.ravel(), sigma.ravel())


def _told(
    model: Model, base: Sequence[Ground], forms: Sequence[tuple[int, Driver, Form]]
) -> list[tuple[Array, Array]]:
    """b (3,) and G (3, 3) of each form's constants, one an axis, in usual sizes."""
    effects = []
    for n, (sensor, driver, form) in enumerate(forms):
        law = Law(sensor, AXES_OF[sensor], True, driver, form, (_usual(sensor, driver, form),))
        effects.append(replace(effect_of(law), id=f"basis: {n}"))
    q = scan(model, effects, base)
    known = [e for e in model.effects if e.process is None and e.id in catalogue()]
    seen = beside(q, known, effects)
    at = [seen.at[e.id] for e in effects]
    return [(seen.b[i] / q.worth, seen.G[np.ix_(i, i)] / q.worth) for i in at]

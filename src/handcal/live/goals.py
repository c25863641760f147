"""When it is enough: how well each parameter is to be known."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from handcal.did_you_mean import did_you_mean
from handcal.effects import catalogue
from handcal.show import words
from handcal.types import Array, InputError, Parameter
from handcal.units import DEG, MG, shown

# What a unit is in SI, and of which SI unit it is.
UNITS: Mapping[str, tuple[str, float]] = {
    "%": ("1", 1e-2),
    "ppm": ("1", 1e-6),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", 1.0 / DEG),
    "deg/h": ("rad/s", 1.0 / (3600.0 * DEG)),
    "m/s^2": ("m/s^2", 1.0),
    "mg": ("m/s^2", 1.0 / MG),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", 1.0 / DEG),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "uT": ("tesla", 1e-6),
}
# Of what is not named: a gyro's bias that turns a heading by 1 deg in four minutes; scales and
# axes that are off by a millimetre in a metre; a bias of 2 mg, which tilts by 2 mrad.
USUAL: Mapping[str, float] = {
    "gyro_bias": 15.0 / (3600.0 * DEG),
    "accel_bias": 2.0 / MG,
    "gyro_scale": 1e-3,
    "accel_scale": 1e-3,
    "gyro_misalignment": 1e-3,
    "accel_misalignment": 1e-3,
}
# A number, then what may be a unit.
_NUMBER = re.compile(r"\s*((?:[-+.\d]|[eE][-+]?(?=\d))*)\s*(.*?)\s*")
# Of effects that stand neither here nor there: a tenth of what is usual. (Of common effects no goal
# is made: how little is known of them is in the sigmas of the ones above.)
SHARE = 0.1


def parse(text: str) -> Mapping[str, float]:
    """``gyro_scale=0.1%,gyro_bias=15deg/h`` as sigmas in SI, by effect.

    Errors: InputError for what is unknown, no number, or of another unit.
    """
    goals: dict[str, float] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        effect, _, goal = (part.strip() for part in item.partition("="))
        known = catalogue()
        if effect not in known:
            raise InputError(f"--until {item}: unknown effect.{did_you_mean(effect, known)}")
        number, unit = _NUMBER.fullmatch(goal).groups()  # type: ignore[union-attr]
        own = known[effect].parameters[0].unit
        if unit and (unit not in UNITS or UNITS[unit][0] != own):
            fitting = ", ".join(name for name, (of, _) in UNITS.items() if of == own) or own
            raise InputError(f"--until {item}: {effect} is in {fitting}.")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise InputError(
                f"--until {item}: expected EFFECT=SIGMA, as in gyro_scale=0.1%,gyro_bias=15deg/h."
            )
        goals[effect] = value * (UNITS[unit][1] if unit else 1.0)
    return goals


def wanted(parameters: Sequence[Parameter], until: Mapping[str, float]) -> Array:
    """How well each parameter (k,) is to be known, SI; infinite where it does not matter: with
    ``until``, all that it does not name; else what every device has and is not among ``USUAL``."""
    known = catalogue()

    def usual(p: Parameter) -> float:
        common = p.effect in known and known[p.effect].common
        return USUAL.get(p.effect, math.inf if common else SHARE * p.prior_sigma)

    return np.array([until.get(p.effect, math.inf) if until else usual(p) for p in parameters])


def said_of(parameters: Sequence[Parameter], until: Mapping[str, float]) -> tuple[str, ...]:
    """Whether all that ``until`` names became known as well as it asks for, in a sentence; none
    where nothing was asked for."""
    if not until:
        return ()
    missed = [
        (p, goal)
        for p, goal in zip(parameters, wanted(parameters, until), strict=True)
        if p.sigma > goal
    ]
    there = {p.effect for p in parameters}
    gone = [words.effect_title(e) for e in until if e not in there]
    if not missed and not gone:
        return ("All is known as well as was asked for (--until).",)
    told = [_missed(p, goal) for p, goal in missed] + [f"{title}, not estimated" for title in gone]
    return (f"Not known as well as was asked for (--until): {'; '.join(told)}.",)


def _missed(p: Parameter, goal: float) -> str:
    unit = shown(p.unit, [p.sigma])
    title = words.parameter_title(p)
    return (
        f"{title}, ± {unit.value(p.sigma, p.sigma)} instead of {unit.value(goal, goal)} {unit.unit}"
    )


def enough(parameters: Sequence[Parameter], until: Mapping[str, float]) -> bool:
    """Whether every parameter is known as well as is wanted, and each named one is there."""
    there = {p.effect for p in parameters}
    sigma = np.array([p.sigma for p in parameters])
    return set(until) <= there and bool(np.all(sigma <= wanted(parameters, until)))

"""The suite `ordinary`: are all numbers of a device as good as is said?

Of a trial's document only `parameters` are looked at, which calibrations and explanations have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from handcal_sim.effects import EFFECTS
from handcal_sim.prove.ordinary_devices import SPREADS, spread
from handcal_sim.prove.trial import Trial, share

# What a parameter is: a bias, another that was drawn, or one of an effect that is not there.
BIAS, DRAWN, ABSENT = "bias", "drawn", "absent"


@dataclass(frozen=True)
class Deviation:
    """One told parameter: its recording, effect and name; what it is; the truth, what was told and
    with which sigma; whether the program says that the recording showed it."""

    trial: Trial
    effect: str
    name: str
    what: str
    truth: float
    value: float
    sigma: float
    shown: bool

    @property
    def sigmas(self) -> float:
        """By how many sigmas it is off."""
        return (self.value - self.truth) / self.sigma

    @property
    def spread(self) -> float:
        """Of the device's class; 0 where no class has a spread of it."""
        kind = str(self.trial.answer.circumstances["kind"])
        return spread(kind, self.effect) if self.effect in SPREADS else 0.0


def deviations(trials: Iterable[Trial]) -> list[Deviation]:
    """Every told parameter that the simulator knows."""
    return [found for trial in trials for found in _of(trial)]


def _of(trial: Trial) -> list[Deviation]:
    answer, found = trial.answer, []
    for p in trial.document.get("parameters", []):
        effect, name = str(p["effect"]), str(p["name"])
        truth, what = answer.truth(effect), DRAWN
        if effect in answer.baseline:
            truth, what = answer.baseline[effect], BIAS
        elif truth is None:
            truth, what = dict.fromkeys((q.name for q in EFFECTS.get(effect, ())), 0.0), ABSENT
        if name in truth and p["value"] is not None and (p["sigma"] or 0.0) > 0.0:
            shown = bool(p.get("shown", p.get("observable", False)))
            found.append(
                Deviation(trial, effect, name, what, truth[name], p["value"], p["sigma"], shown)
            )
    return found


def within(found: Sequence[Deviation]) -> dict[str, Any]:
    """Shares within one and two sigmas, the root mean square of what they are off; how many are
    shown, and of a class's spread how much is left unknown, in the median."""
    off = [abs(d.sigmas) for d in found]
    known = [d.sigma / d.spread for d in found if d.spread]
    return {
        "within_1_sigma": share(sum(x < 1.0 for x in off), len(off)),
        "within_2_sigma": share(sum(x < 2.0 for x in off), len(off)),
        "rms": math.sqrt(sum(x * x for x in off) / len(off)) if off else None,
        "shown": sum(d.shown for d in found),
        "sigma_over_spread": median(known) if known else None,
    }


def coverage(found: Sequence[Deviation]) -> dict[str, Any]:
    """Of all that was drawn, and of parts of it; `absent`: of effects that are not there."""
    there = [d for d in found if d.what != ABSENT]
    parts = {
        "all": there,
        "biases": [d for d in there if d.what == BIAS],
        "shown": [d for d in there if d.shown],
        "not_shown": [d for d in there if not d.shown],
        "absent": [d for d in found if d.what == ABSENT],
    }
    return {name: within(part) for name, part in parts.items()}


def rare(trial: Trial) -> str:
    """What the device has that few have: an effect, a law, or nothing."""
    given = trial.answer.circumstances
    return str(given["rare"] or trial.answer.stranger.get("kind", ""))


def _besides(d: Deviation) -> str:
    return "a law" if d.trial.answer.stranger else "a rare effect" if rare(d.trial) else "nothing"


# Ways to part deviations.
BY: Mapping[str, Callable[[Deviation], str]] = {
    "class": lambda d: str(d.trial.answer.circumstances["kind"]),
    "motion": lambda d: str(d.trial.answer.circumstances["motion"]),
    "stream": lambda d: str(d.trial.answer.circumstances["stream"]),
    "effect": lambda d: d.effect,
    "besides": _besides,
}


def parts(found: Sequence[Deviation], of: Callable[[Deviation], str]) -> dict[str, Any]:
    """Coverage of what was drawn, by part."""
    by: dict[str, list[Deviation]] = {}
    for d in found:
        if d.what != ABSENT:
            by.setdefault(of(d), []).append(d)
    return {name: within(part) for name, part in by.items()}


def worst(found: Sequence[Deviation], count: int) -> list[Deviation]:
    """The parameters that are off by most of their sigmas."""
    return sorted(found, key=lambda d: -abs(d.sigmas))[:count]


def line(d: Deviation) -> dict[str, Any]:
    """A deviation, ready for JSON."""
    given = d.trial.answer.circumstances
    return {
        "recording": d.trial.name, "class": given["kind"], "motion": given["motion"],
        "stream": given["stream"], "besides": rare(d.trial), "effect": d.effect, "name": d.name,
        "what": d.what, "truth": d.truth, "value": d.value, "sigma": d.sigma,
        "sigmas": d.sigmas, "shown": d.shown,
    }  # fmt: skip


@dataclass(frozen=True)
class Bound:
    """What is asked of a part: its share within so many sigmas, and how far it may be from it
    (None: it may be more)."""

    part: str
    sigmas: int
    asked: float
    off: float | None


OWN = (Bound("shown", 1, 0.68, 0.08), Bound("shown", 2, 0.95, 0.03),
       Bound("not_shown", 2, 0.90, None))  # fmt: skip
DRAWING = (Bound("all", 1, 0.68, 0.05), Bound("all", 2, 0.95, 0.02))


def asked(covered: Mapping[str, Any], drawing_priors: bool) -> list[dict[str, Any]]:
    """What is asked of the numbers beside what was measured."""
    rows = []
    for bound in DRAWING if drawing_priors else OWN:
        measured = covered[bound.part][f"within_{bound.sigmas}_sigma"]
        of, met = measured["share"], None
        if of is not None:
            met = of >= bound.asked if bound.off is None else abs(of - bound.asked) <= bound.off
        rows.append({**vars(bound), "measured": measured, "met": met})
    return rows

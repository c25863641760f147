"""Confounding: disturbances that hold what an effect does. An observation's own correlated noise,
grown far beyond what is usual, is an alibi for whatever bends the observation."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace
from functools import partial

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted, Model
from handcal.estimate.parallel import in_parallel
from handcal.estimate.sway import HAND_SWAY, sway_of
from handcal.score import better

# Sigmas of its prior by which a level lies above its first guess before it is suspected.
FAR = 2.0


def without_confounding(model: Model, worth: float, tried: set[str]) -> Model | None:
    """The model with the effect that explains what a disturbance was taken for, if one does.

    While the disturbance is wide a scan sees no effect beside it. So each effect that acts on
    the same observation is fitted from the usual noise, once; ``tried`` remembers which.
    """
    suspected = frozenset(kind for f in model.parts for kind in _grown(f))
    begun = [_usual(f, suspected) for f in model.parts]
    wanted = [
        e
        for e in catalogue().values()
        if e.id not in tried | set(model.ids)
        and _acts(e, suspected)
        and any(applicable(f.case, e) for f in model.parts)
    ]
    tried |= {e.id for e in wanted}
    fits = (partial(fitted, begun, (*model.effects, e), noise_rounds=2) for e in wanted)
    held = [fit for fit in in_parallel(fits) if better(fit, model, worth) > 0.0]
    return max(held, key=lambda fit: fit.log_evidence, default=None)


def sways_far(f: Fitted) -> bool:
    """Whether the noise levels are those of a hand that sways further than one does."""
    return sway_of(f.problem, f.levels) > HAND_SWAY


def steadied(base: Model) -> Model:
    """The baseline with the noise that is usual where it took strong physics for a hand that sways
    far and slowly.

    With such a sway little of the physics shows, the noise levels that fit that little are as good
    again, and the search ends where it began. It is to begin here too.
    """
    begun = [_usual(f, frozenset(f.case.kinds)) if sways_far(f) else f for f in base.parts]
    return fitted(begun, base.effects, noise_rounds=0)


def _acts(effect: Effect, kinds: Set[str]) -> bool:
    named = effect.process is None and not effect.outliers and effect.moments is None
    return named and bool(kinds & effect.acts_on)


def _grown(f: Fitted) -> list[str]:
    """Kinds of observation whose correlated noise lies far above its first guess."""
    return [
        o.kind
        for o in f.problem.observations
        if o.markov is not None
        and any(
            math.log(f.levels[lv.name] / lv.initial) > FAR * lv.above
            for lv in o.levels
            if lv.name not in f.case.fixed
        )
    ]


def _usual(f: Fitted, kinds: Set[str]) -> Fitted:
    """The same with the noise of these observations as it is at first."""
    levels = dict(f.levels)
    for o in f.problem.observations:
        if o.kind in kinds:
            levels |= {lv.name: lv.initial for lv in o.levels if lv.name not in f.case.fixed}
    return replace(f, levels=levels)

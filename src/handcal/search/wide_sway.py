"""A hand that seems to sway far: strong physics that the baseline lacks looks like one."""

from __future__ import annotations

from dataclasses import replace

from handcal.estimate.fit import fitted
from handcal.estimate.hand_sway import HAND_SWAY, sway_of
from handcal.estimate.model import Fitted, Model


def sways_far(f: Fitted) -> bool:
    """Whether the noise levels are those of a hand that sways further than one does."""
    return sway_of(f.problem, f.levels) > HAND_SWAY


def steadied(base: Model) -> Model:
    """The baseline with the noise that is usual where it took strong physics for a hand that sways
    far and slowly.

    With such a sway little of the physics shows, the noise levels that fit that little are as good
    again, and the search ends where it began. It is to begin here too.
    """
    begun = [_usual(f) if sways_far(f) else f for f in base.parts]
    return fitted(begun, base.effects, noise_rounds=0)


def _usual(f: Fitted) -> Fitted:
    """The same with the noise of its observations as it is at first."""
    first = {
        level.name: level.initial
        for o in f.problem.observations
        for level in o.levels
        if level.name not in f.case.fixed
    }
    return replace(f, levels={**f.levels, **first})

"""Moments at which effects are held (a step's), and how well they are known."""

from __future__ import annotations

import math

import numpy as np

from handcal.estimate.case import name_of
from handcal.estimate.parameters import Moment
from handcal.search.multistart import Found
from handcal.search.space import rivals

# How well a moment is known, s, where only one was on trial.
MOMENT = 0.1


def moments(found: Found) -> dict[str, Moment]:
    """Of each effect of the model that is held at one, by its id."""
    return {e.id: _moment(found, e.id) for e in found.model.effects if "@" in e.id}


def _moment(found: Found, effect: str) -> Moment:
    """Mean and standard deviation of the moment at which an effect is held, s, over all moments
    on trial; what lies between two of them is not told."""
    chosen = found.model.chosen
    same = [i for i in found.space.effects if "@" in i and name_of(i) == name_of(effect)]
    same.sort(key=_held_at)
    here = _held_at(effect)
    if effect not in found.space.effects or len(same) < 2:
        return Moment(here, MOMENT)
    scores = rivals(found.space, chosen, effect)
    at = np.array([_held_at(i) for i in same])
    # moments on trial lie closer together near the one that was chosen
    share = np.exp([min(scores[i], 50.0) for i in same]) * np.gradient(at)
    share /= share.sum()
    mean = float(share @ at)
    near = float(np.min(np.abs(np.delete(at, same.index(effect)) - here)))
    sigma = math.hypot(math.sqrt(float(share @ (at - mean) ** 2)), near / math.sqrt(12.0))
    return Moment(mean, sigma)


def _held_at(effect: str) -> float:
    return float(effect.split("@")[1])

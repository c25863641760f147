"""The step of a climb that adds a noise effect."""

from __future__ import annotations

from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.model_score import PRIOR, better, score
from handcal.search.climb.state import FEW, Climb
from handcal.search.noise_scan import all_noise, looks_of, of_looks, on_fewer_axes


def add_noise(c: Climb) -> Model | None:
    """The model with the noise effect that gains most, if one does; or the same fitted anew, if
    that was what the noise effect gained by."""
    model, worth = c.model, c.worth
    have = {*model.ids, *c.dropped}
    looks = looks_of(model.parts, model.effects, [e for e in all_noise() if e.id not in have], FEW)
    tried = [(m, e) for m, e in of_looks(looks) if better(m, model, worth) > 0.0]
    if not tried:
        return None
    best, added = on_fewer_axes(*max(tried, key=lambda pair: score(pair[0], worth)), worth)
    without = fitted(best.parts, model.effects, noise_rounds=1)
    if without.log_evidence < model.log_evidence:
        without = model
    gain = better(best, without, worth)
    if gain > 0.0:
        c.noise[added.id] = gain - PRIOR
    elif without is model:
        return None
    else:
        best = without
    c.visited.clear()
    return best

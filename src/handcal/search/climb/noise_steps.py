"""The step of a climb that adds a noise effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from handcal.effects import Effect
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.model_score import PRIOR, better, score
from handcal.search.climb.state import FEW, Climb, Lack
from handcal.search.noise_scan import Look, all_noise, looks_of, of_looks, on_fewer_axes

# Nats beyond what the evidence has fallen by that a noise effect has to lack, so that it is not
# looked at again beside the same effects and more, or fewer: at a look, whose levels are rough, and
# in a fit.
ROUGHLY, FITTED = 20.0, 3.0
# Of what the best gains at a look, the share with which another may be the better one.
NEAR = 0.5


def add_noise(c: Climb) -> Model | None:
    """The model with the noise effect that gains most, if one does; or the same fitted anew, if
    that was what the noise effect gained by."""
    model, worth = c.model, c.worth
    have = {*model.ids, *c.dropped, *_far_off(c)}
    asked = [e for e in all_noise() if e.id not in have]
    looks, gained = looks_of(model.parts, model.effects, asked, FEW)
    lacks = {i: -gain - ROUGHLY for i, gain in gained.items()}
    tried: list[tuple[Model, Effect]] = []
    for some in _in_turn(looks, gained):
        if not tried:
            fits = [(m, e, better(m, model, worth)) for m, e in of_looks(some)]
            lacks |= {e.id: -gain - FITTED for _, e, gain in fits}
            tried = [(m, e) for m, e, gain in fits if gain > 0.0]
    c.lacking |= {i: Lack(x, model.log_evidence, frozenset(model.ids)) for i, x in lacks.items()}
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


def _in_turn(looks: Sequence[Look], gained: Mapping[str, float]) -> tuple[list[Look], list[Look]]:
    """Looks that gain about as much as the best, and the others."""
    best = max((gained[k.effects[-1].id] for k in looks), default=0.0)
    near = [k for k in looks if gained[k.effects[-1].id] >= min(NEAR * best, best)]
    return near, [k for k in looks if k not in near]


def _far_off(c: Climb) -> set[str]:
    """Noise effects that lacked much when they were last looked at, beside the same effects and
    others that have gone since, or without some that came."""
    now = frozenset(c.model.ids)
    out = set()
    for i, lack in c.lacking.items():
        fallen = max(0.0, lack.log_evidence - c.model.log_evidence)
        if lack.nats > fallen and (lack.beside <= now or now <= lack.beside):
            out.add(i)
    return out

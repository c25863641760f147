"""Steps of a climb that add a noise effect, or replace one by names."""

from __future__ import annotations

from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.transfer import without
from handcal.model_score import MOMENTS, PRIOR, better, score
from handcal.search.climb.candidates import fitted_with, scanned_about
from handcal.search.climb.state import (
    FEW,
    HOPELESS,
    Climb,
    fell_short,
    forget,
    in_vain,
    likelier,
)
from handcal.search.climb.subset_steps import favourite
from handcal.search.noise_scan import all_noise, looks_of, of_looks, on_fewer_axes
from handcal.search.space import best_set


def add_noise(c: Climb) -> Model | None:
    """The model with the best noise effect, if it raises the score; or the same effects fitted
    again, if the gain came from the new fit alone."""
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


def noise_or_step(c: Climb) -> Model | None:
    """The model with a noise effect, if the scan chooses a step and noise is likelier: a step can
    imitate a bias walk, and hides it."""
    chosen = favourite(c)
    if not any(name_of(i) != i for i in chosen - c.model.chosen):
        return None
    known = dict(c.noise)
    tried = add_noise(c)
    if tried is not None:
        step = fitted_with(c.model, c.where, chosen, tried, c.worth)
        if likelier(c, tried, step) or not likelier(c, step):
            return tried
    c.noise = known
    return None


def name_noise(c: Climb) -> Model | None:
    """The model with effects that include a step at a moment in place of a noise effect, if that is
    likelier.

    (A fit with a wrong moment hides the right one. Noise brings the trajectory close to the truth,
    and a scan about it shows the moment.)
    """
    key = frozenset(c.model.ids)
    if key in c.unmasked:
        return None
    c.unmasked.add(key)
    noise = [e for e in c.model.effects if e.process is not None and e.id not in c.kept]
    ends = []
    for e in c.budget.each(noise):
        what = name_noise.__name__, e.id
        if in_vain(c, what):
            continue
        tried = _at_a_moment(c, without(c.model, {e.id}))
        if tried is not None and likelier(c, tried):
            ends.append(tried)
        else:
            # (without a candidate, the loss is all that the noise gained)
            held = c.noise.get(e.id, HOPELESS)
            fell_short(c, what, held if tried is None else better(c.model, tried, c.worth))
    if not ends:
        return None
    best = max(ends, key=lambda m: score(m, c.worth))
    forget(c, best)
    return best


def _at_a_moment(c: Climb, model: Model) -> Model | None:
    """The model with more effects of the catalogue, one a step whose moment is refined from scan to
    scan; None if the first scan chooses no step."""
    best: Model | None = None
    for _ in c.budget.each(range(MOMENTS)):
        where = scanned_about(model, c.unnamed, c.dropped | c.beyond)
        chosen = best_set(where, model.chosen)
        if chosen == model.chosen or all(name_of(i) == i for i in chosen):
            return best
        model = fitted_with(model, where, chosen)
        if best is not None and model.log_evidence < best.log_evidence:
            return best
        best = model
    return best

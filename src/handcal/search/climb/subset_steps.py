"""Steps of a climb that choose the set of effects: fit the best set of a scan, or remove a weak
effect."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from handcal.effects import catalogue
from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.robust import inflation
from handcal.model_score import GAINED, PRIOR, better
from handcal.search.climb.candidates import REFUSED, fitted_with, scanned_about
from handcal.search.climb.state import (
    FEW,
    Climb,
    beside_others,
    fell_short,
    forget,
    in_time,
    in_vain,
    likelier,
    too_large,
)
from handcal.search.space import Space, best_set, gains

# Gain below which removal of an effect is tested by a fit, nats.
CLOSE = 20.0


def choose(c: Climb) -> Model | None:
    """The fit of the best set of the scan, if it raises the score. If one of its effects comes out
    implausibly large, the best set without that effect is fitted."""
    now = c.model.chosen
    for _ in c.budget.each(range(FEW)):
        chosen, known = favourite(c), len(c.beyond)
        if chosen == now or chosen in c.visited or _same(c.where, now, chosen):
            return None
        c.visited.add(chosen)
        larger = _grown(c, chosen)
        if larger is not None:
            beside_others(c, larger)
            c.refused.clear()
            c.beyond.clear()
            return larger
        if len(c.beyond) == known:
            return None
        odds = {i: REFUSED if name_of(i) in c.beyond else p for i, p in c.where.prior.items()}
        c.where = replace(c.where, prior=odds, scores={})
    return None


def everything(c: Climb) -> Model | None:
    """The best set of effects about a fit of all candidates, tried once, if the scan adds effects
    to a model that already has some.

    About a model that lacks much, noise absorbs missing effects, and a scan is distorted. About a
    fit of all it is not. Absent effects do little harm there, since priors keep them near zero.
    """
    now = {name_of(i) for i in c.model.chosen}
    more = {name_of(i) for i in favourite(c)} - now
    if c.everything or not more or not c.model.chosen - c.kept:
        return None
    c.everything = True
    names = {name_of(i) for i in c.model.ids} | c.dropped | c.beyond
    # (without steps, whose moment is unknown, and laws)
    others = [e for i, e in c.where.effects.items() if i in catalogue() and i not in names]
    # (frees memory: two linearised problems of this size would be too large)
    c.model = c.model.bare
    whole = fitted(c.model.parts, [*c.model.effects, *others])
    where = scanned_about(whole.bare, c.unnamed, c.dropped | c.beyond)
    tried = fitted_with(whole, where, best_set(where, whole.chosen))
    if not likelier(c, tried):
        return None
    forget(c, tried)
    return tried


def favourite(c: Climb) -> frozenset[str]:
    """The set of effects with the highest score in the last scan."""
    starts = (c.model.chosen, ())
    return max((best_set(c.where, start) for start in starts), key=c.where.score)


def _same(where: Space, now: frozenset[str], chosen: frozenset[str]) -> bool:
    """Whether two sets differ only in moments, with a gain below 1 nat."""
    if {name_of(i) for i in now} != {name_of(i) for i in chosen}:
        return False
    return where.score(chosen) - where.score(now) < 1.0


def _grown(c: Climb, chosen: frozenset[str]) -> Model | None:
    """The fit of the chosen effects, or of the best single addition, if it raises the score. An
    effect that makes the fit much worse is dropped."""
    now = c.model.chosen
    for wanted in (chosen, *_singles(c.where, now, chosen)):
        if wanted in c.refused:
            continue
        tried = fitted_with(c.model, c.where, wanted, c.model, c.worth)
        if likelier(c, tried):
            return tried
        c.refused.add(wanted)
        there = {name_of(i) for i in now}
        if large := too_large(tried) - there:
            c.beyond |= large
            return None
        if len(wanted - now) == 1 and tried.log_evidence < c.model.log_evidence - GAINED:
            # (a step that the model has at another moment is not dropped)
            c.dropped |= {name_of(i) for i in wanted - now} - there
    return None


def _singles(where: Space, now: frozenset[str], chosen: frozenset[str]) -> list[frozenset[str]]:
    added = chosen - now
    return [max((now | {i} for i in added), key=where.score)] if len(added) > 1 else []


def thin(c: Climb) -> Model | None:
    """The model without one of its weakest effects, if a fit without it has the higher score.

    The gain of an effect is reduced if its own scores scatter more than the evidence as a whole.
    """
    model, where = c.model, c.where
    gained = gains(where, model.chosen)
    missed = {i for i in model.ids if in_vain(c, (thin.__name__, i))}
    last = {i: 0.0 if i in c.stale - missed else v for i, v in c.noise.items()}
    least = gained | last
    weakest = sorted(model.effects, key=lambda e: least.get(e.id, 0.0))
    tried = [
        e
        for e in [e for e in weakest if not e.common][:FEW]
        if e.id not in missed
        and least.get(e.id, 0.0) <= (CLOSE if e.process is None else 10.0 * CLOSE)
    ]
    fewer = ([x for x in model.effects if x is not e] for e in tried)
    calls = (partial(fitted, model.parts, rest) for rest in fewer)
    more = inflation(model) if tried else {}
    for without, e in in_time(c, calls, tried):
        gain = better(model, without, c.worth)
        if not math.isfinite(gain):  # (the fit without it diverged: its gain is unknown)
            c.stale.discard(e.id)
            continue
        if e.process is not None:
            c.noise[e.id] = gain - PRIOR
            c.stale.discard(e.id)
        else:
            odds = where.prior[e.id]
            gain = (gain - odds) / max(1.0, more[e.id] * c.worth) + odds
        if gain < 0.0:
            c.noise.pop(e.id, None)
            c.dropped.add(name_of(e.id))
            return without
        fell_short(c, (thin.__name__, e.id), gain)
    return None

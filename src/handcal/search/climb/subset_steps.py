"""Steps of a climb that choose the set of effects: those that the scan likes best are fitted, one
that is not missed is left out."""

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

# An effect whose gain is less than this is fitted without, to be sure.
CLOSE = 20.0


def choose(c: Climb) -> Model | None:
    """The effects that the scan likes best, fitted, if such a fit holds; where one of them came out
    larger than makes sense, those that it likes best without that one."""
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
    """The best set of effects about a fit of all that the recordings could show, where more than
    one step of ``choose`` is needed.

    About a model that lacks much, noise levels hold what is missing and each effect is judged by
    what others left; about one that lacks nothing, each is judged for what it is. What is not there
    costs a fit little: priors keep it near zero.
    """
    now = {name_of(i) for i in c.model.chosen}
    more = {name_of(i) for i in favourite(c)} - now
    if c.everything or not more or not c.model.chosen - c.kept:
        return None
    c.everything = True
    names = {name_of(i) for i in c.model.ids} | c.dropped | c.beyond
    # (no steps, whose moment is open, and no laws)
    others = [e for i, e in c.where.effects.items() if i in catalogue() and i not in names]
    # (no two problems of this size beside each other, linearised)
    c.model = c.model.bare
    whole = fitted(c.model.parts, [*c.model.effects, *others])
    where = scanned_about(whole.bare, c.unnamed, c.dropped | c.beyond)
    tried = fitted_with(whole, where, best_set(where, whole.chosen))
    if not likelier(c, tried):
        return None
    forget(c, tried)
    return tried


def favourite(c: Climb) -> frozenset[str]:
    """The set of effects that the last scan likes best."""
    starts = (c.model.chosen, ())
    return max((best_set(c.where, start) for start in starts), key=c.where.score)


def _same(where: Space, now: frozenset[str], chosen: frozenset[str]) -> bool:
    """Whether only a moment would move, for less than a nat."""
    if {name_of(i) for i in now} != {name_of(i) for i in chosen}:
        return False
    return where.score(chosen) - where.score(now) < 1.0


def _grown(c: Climb, chosen: frozenset[str]) -> Model | None:
    """The model with the chosen effects, or with the best of those added, if such a fit is
    likelier than the one there is; an effect with which no fit holds is not looked at again."""
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
            # (what is there at another moment is not dropped)
            c.dropped |= {name_of(i) for i in wanted - now} - there
    return None


def _singles(where: Space, now: frozenset[str], chosen: frozenset[str]) -> list[frozenset[str]]:
    added = chosen - now
    return [max((now | {i} for i in added), key=where.score)] if len(added) > 1 else []


def thin(c: Climb) -> Model | None:
    """The model without an effect that it does not miss when all else is fitted again.

    What an effect gains counts for less where its own scores scatter more than the evidence as a
    whole is discounted for.
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
        if not math.isfinite(gain):  # (no fit holds without it, which says nothing of how much)
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

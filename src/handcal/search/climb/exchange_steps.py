"""Steps of a climb that exchange similar effects, or change the order of effects in a sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from functools import partial

from handcal.effects import Effect, Param, Signals, catalogue
from handcal.effects._linear import added
from handcal.estimate.case import applicable, name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.laws.best_law import Term
from handcal.laws.chosen_again import with_other
from handcal.laws.weighing import beside
from handcal.laws.weighing import gains as gains_of
from handcal.model_score import NAMED, PRIOR, better, of_use
from handcal.search.climb.candidates import fitted_with, scanned_about
from handcal.search.climb.state import (
    HOPELESS,
    WEAK,
    Climb,
    beside_others,
    fell_short,
    in_time,
    in_vain,
    likelier,
    sensible,
)
from handcal.search.space import best_set, gains, rivals
from handcal.types import Array

# Share of an effect's gain that a rival must reach in a scan to be fitted in its place.
NEARLY = 0.4
# Largest count of exchanges in a climb; each counts twice, once for either direction.
MOST_SWAPS = 6
# Divisor of the evidence between two effects that are equal to first order. It varies by as much
# as eleven nats with the hand's sway, whichever of them is the cause.
ALIKE = 4.0


def exchange(c: Climb) -> Model | None:
    """The model with an effect replaced by its closest rival, if that fits better.

    Two effects may be equal to first order (a low pass of the gyro, an early accelerometer). A scan
    about a fit with one cannot evaluate the other, so it is fitted.
    """
    model, where = c.model, c.where
    gained = gains(where, model.chosen)
    pairs = _rivalries(c, gained)

    def exchanged(e: Effect, rival: str) -> Model:
        wanted = [*(x for x in model.effects if x is not e), catalogue()[rival]]
        return fitted(model.parts, wanted, of_use=of_use(model, wanted, c.worth))

    calls = (partial(exchanged, *pair) for pair in pairs)
    for tried, (e, rival) in in_time(c, calls, pairs):
        # (a rival with a negative value of a positive parameter does not count)
        worse = better(model, tried, c.worth) if tried.one_sided else math.inf
        c.swaps[e.id, rival], c.swaps[rival, e.id] = worse, -worse
        fell_short(c, tuple(sorted((e.id, rival))), abs(worse))
        if worse < 0.0:
            return tried
        # (the wrong effect may need a weak third one, which the right one does not)
        others = [x for x in model.effects if x is not e]
        weakest = min(
            (x for x in others if x.id in model.chosen and not x.common),
            key=lambda x: gained[x.id],
            default=None,
        )
        if weakest is not None and worse < -2.0 * PRIOR and gained[weakest.id] < WEAK:
            rest = [x for x in others if x is not weakest]
            fewer = fitted(model.parts, [*rest, catalogue()[rival]])
            if likelier(c, fewer):
                return fewer
    return None


def _rivalries(c: Climb, gained: Mapping[str, float]) -> list[tuple[Effect, str]]:
    """Effects of the model, each with the rival that reaches the largest share of its gain."""
    have, now = {name_of(i) for i in c.model.ids}, c.model.chosen
    pairs: list[tuple[Effect, str]] = []
    tried = set(c.swaps)
    for e in c.model.effects:
        # (the baseline's effects stay)
        if e.id not in now or e.id in c.kept or len(tried) >= MOST_SWAPS:
            continue
        if gained[e.id] < -PRIOR:
            continue
        # (nats lost with each rival, then the share of the effect's gain that it reaches)
        lost = {i: -v for i, v in rivals(c.where, now, e.id).items() if i in catalogue()}
        lost = {i: v for i, v in lost.items() if i != e.id and (v < HOPELESS or akin(e.id, i))}
        near = {i: 1.0 - v / gained[e.id] for i, v in lost.items()}
        near = {i: v for i, v in near.items() if v > NEARLY or akin(e.id, i)}
        near = {i: v for i, v in near.items() if i not in have | c.dropped}
        # (an effect that includes this one is no exchange for it)
        near = {i: v for i, v in near.items() if e.id not in catalogue()[i].exclusive}
        near = {i: v for i, v in near.items() if (e.id, i) not in tried}
        if near:
            rival = max(near, key=lambda i: near[i])
            pairs.append((e, rival))
            tried |= {(e.id, rival), (rival, e.id)}
    return pairs


def lateness(c: Climb) -> Model | None:
    """The model with a slow gyro replaced by a delay of another sensor, if the evidence between
    them is not clear. By convention the gyro's stamps define time, and correcting a lag that the
    gyro does not have would make it worse. None if no exchange applies."""
    sure = math.log(NAMED / (1.0 - NAMED))
    for e in c.model.effects:
        near = {r: worse for (i, r), worse in c.swaps.items() if i == e.id and r in e.akin}
        rival = min(near, key=lambda r: near[r], default=None)
        if rival is None or near[rival] > ALIKE * sure or rival in c.model.ids:
            continue
        others = [x for x in c.model.effects if x is not e]
        tried = fitted(c.model.parts, [*others, catalogue()[rival]])
        if sensible(tried):
            return tried
    return None


def akin(a: str, b: str) -> bool:
    """Whether two effects are equal to first order."""
    one, other = catalogue().get(a), catalogue().get(b)
    return one is not None and other is not None and (b in one.akin or a in other.akin)


def reorder(c: Climb) -> Model | None:
    """The model with a filter or delay before the other errors instead of after, or the reverse, if
    that fits better. The order in the sensor is unknown."""
    model, now = c.model, frozenset(c.model.ids)
    ways = []
    for e in model.effects:
        beside = [x for x in model.effects if x.imu_error is not None and x.id != e.id]
        if e.imu_inverse is not None and beside and (e.id, now) not in c.ordered:
            ways.append((e, replace(e, last=not e.last)))
    calls = (partial(with_other, model, *pair, model, c.worth) for pair in ways)
    for tried, (e, _) in in_time(c, calls, ways):
        c.ordered.add((e.id, now))
        if tried.log_evidence > model.log_evidence:
            return tried
    return None


def hidden(c: Climb) -> Model | None:
    """The model with a filter whose lag delays may have absorbed.

    Beside delays a scan about zero cannot show a filter, since its smoothing is of second order. So
    it is fitted, from its usual size on, with all delays that could compensate its lag.
    """
    model, now = c.model, frozenset(c.model.ids)
    have = {name_of(i) for i in now} | c.dropped
    cases = [f.case for f in model.parts]
    ways = []
    for e in catalogue().values():
        seen = (e.id, now) in c.ordered or in_vain(c, (hidden.__name__, e.id))
        if e.id in have or seen or not _smooths(e):
            continue
        late = [catalogue()[i] for i in e.akin if i not in have]
        wanted = [x for x in (e, *late) if any(applicable(case, x) for case in cases)]
        held = any(x.delays or akin(e.id, x.id) for x in model.effects)
        if held and e in wanted and _promised(model, e, c.worth) > 0.0:
            ways.append(wanted)
    refused = c.dropped | c.beyond
    calls = (partial(_beside_delays, model, w, c.unnamed, refused, c.worth) for w in ways)
    for tried, (e, *_) in in_time(c, calls, ways):
        c.ordered.add((e.id, now))
        if tried is not None and tried.one_sided and likelier(c, tried):
            beside_others(c, tried)
            return tried
        short = -PRIOR if tried is None else better(model, tried, c.worth)
        if short > 0.0 and (tried is None or tried.one_sided):
            fell_short(c, (hidden.__name__, e.id), short)
    return None


def _promised(model: Model, effect: Effect, worth: float) -> float:
    """Gain of a filter in a scan of its error at the usual size, nats. Delays and all other effects
    of the model are free, so only the part that no delay compensates counts. (A fit gains about
    twice as much.)"""
    error, usual = effect.imu_error, effect.prior_sigma
    assert error is not None

    def features(signals: Signals) -> list[tuple[int, int, Array]]:
        felt = error(usual, signals)
        return [(k, 0, felt[:, k, None]) for k in range(6) if felt[:, k].any()]

    whole = replace(
        effect, id=f"basis: {effect.id}", parameters=(Param("share", "", 1.0),), imu_inverse=None,
        features=features, imu_error=added(features),
    )  # fmt: skip
    known = [e for e in model.effects if e.process is None]
    seen = beside(scan(model, [whole], None, worth), known, [whole])
    return float(gains_of(seen.b[None], seen.G[None])[0])


def _beside_delays(
    model: Model,
    wanted: Sequence[Effect],
    unnamed: Sequence[Term],
    refused: Set[str],
    worth: float,
) -> Model | None:
    """The model with a filter and the delays that it needs, chosen about a fit with all of them.

    wanted: the filter and its delays. worth: power of the likelihood. None if the choice is the
    present model.
    """
    tried = fitted(model.parts, [*model.effects, *wanted])
    where = scanned_about(tried.bare, unnamed, refused)
    fewer = best_set(where, tried.chosen)
    if fewer == model.chosen:
        return None
    if fewer == tried.chosen:
        return tried
    return fitted_with(tried, where, fewer, model, worth)


def _smooths(effect: Effect) -> bool:
    """Whether an effect is a causal filter of the readings."""
    return effect.imu_inverse is not None and any(p.positive for p in effect.parameters)

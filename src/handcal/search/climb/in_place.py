"""Laws in place of effects that may imitate them (noise first), or beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from functools import partial

from handcal.effects import Effect, catalogue
from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.noise_look import as_they_are
from handcal.estimate.transfer import fit_of, without
from handcal.laws.best_law import ENOUGH, Survey, Term, best_terms, survey
from handcal.laws.law_effect import SENSORS, channels_of
from handcal.model_score import better, of_use, score
from handcal.search.climb.candidates import fitted_with, scanned_about
from handcal.search.climb.state import (
    HOPELESS,
    WEAK,
    Barred,
    Climb,
    best_of,
    forget,
    in_time,
    likelier,
    sensible,
)
from handcal.search.space import best_set, gains

# Key of a fit: ids of the effects to which a term is added, the term's formula and its definition.
Way = tuple[frozenset[str], str, object]


def instead_of_noise(c: Climb, room: int) -> Model | None:
    """The model with the best law, in place of effects that may imitate it or beside them, and with
    further laws on other channels that raise the score too.

    room: largest count of new laws.
    """
    key = frozenset(c.model.ids)
    if key in c.bared:
        return None
    doubted = _doubted(c)
    hidden = {sensor: _hidden_by(c, sensor, sets[-1]) for sensor, sets in doubted.items()}
    asked = [sensor for sensor in doubted if _may_hide(c.barred.get(sensor), *hidden[sensor])]
    ends, answered = _ends(c, {sensor: doubted[sensor] for sensor in asked}, last=room == 1)
    for sensor in answered:
        c.barred[sensor] = Barred(*hidden[sensor], _fell_short(c, sensor, ends))
    if len(answered) == len(asked):
        c.bared.add(key)
    tried = likeliest(c, ends)
    return tried if tried is None else _and_of_others(c, tried, ends, room - 1)


def _and_of_others(c: Climb, tried: Model, ends: Sequence[tuple[Model, Term]], room: int) -> Model:
    """A model with a term, and further terms on other channels, each with the removals that it was
    fitted with. (Another survey of all laws would mostly find the same ones.)"""
    others = _apart(ends, c.unnamed[-1])
    while room > 0 and not c.budget.cuts() and (best := best_of(c, others)) is not None:
        alone, term = best
        others = _apart(others, term)
        rest = without(tried, set(c.model.ids) - set(alone.ids))
        both = with_term(rest, term, c.worth, c.beyond, tried)
        if likelier(c, both, tried):
            tried, room = _taken(c, both, term), room - 1
    return tried


def _apart(ends: Sequence[tuple[Model, Term]], than: Term) -> list[tuple[Model, Term]]:
    """Fits whose term has no channel in common with this one."""
    own = set(channels_of(than.effect))
    return [(m, term) for m, term in ends if own.isdisjoint(channels_of(term.effect))]


def _may_hide(last: Barred | None, own: frozenset[str], held: float) -> bool:
    """Whether a law in place of doubted effects may succeed after it failed: the effects have
    changed, or they now hold more nats by more than the law fell short."""
    return last is None or own != last.own or held - last.held > last.short


def _hidden_by(c: Climb, sensor: str, doubted: frozenset[str]) -> tuple[frozenset[str], float]:
    """The effects that a law of this sensor could replace or change, and the nats held by the noise
    and the weak ones of the doubted."""
    own = doubted | {e.id for e in c.model.effects if e.id.startswith(sensor)}
    gained = gains(c.where, c.model.chosen)
    weak = sum(v for i, v in gained.items() if i in doubted and v < WEAK)
    rest = [e for e in c.model.effects if e.process is None or e.id not in doubted]
    if len(rest) == len(c.model.effects):
        return own, weak
    here, there = ([fit_of(f, e) for f in c.model.parts] for e in (c.model.effects, rest))
    return own, c.worth * (as_they_are(here) - as_they_are(there)) + weak


def _fell_short(c: Climb, sensor: str, ends: Sequence[tuple[Model, Term]]) -> float:
    """Nats by which the best of these laws of a sensor scores below the model."""
    own = [m for m, term in ends if sensor_of(term) == sensor]
    # (diverged fits say nothing)
    nats = [-better(m, c.model, c.worth) for m in own if math.isfinite(m.log_evidence)]
    return min(nats, default=0.0 if own else ENOUGH)


def likeliest(c: Climb, ends: Sequence[tuple[Model, Term]]) -> Model | None:
    """The best of these fits, each with a term, if it beats the climb's model."""
    best = best_of(c, ends)
    if best is None:
        return None
    return _taken(c, *best)


def _taken(c: Climb, tried: Model, term: Term) -> Model:
    """The model; its term joins those of the climb."""
    c.unnamed.append(term)
    forget(c, tried)
    return tried


def _ends(
    c: Climb, doubted: Mapping[str, list[frozenset[str]]], last: bool
) -> tuple[list[tuple[Model, Term]], list[str]]:
    """Fits with a term in place of effects of each sensor or beside them, and the sensors whose
    sets of effects have all been tried.

    The smallest sets come first. A larger set is tried only if a fit with a smaller one comes near
    the best score, since removing more names gains no more than their odds. Unless this is the last
    term, larger sets are tried only if no smaller one raised the score.
    """
    ends: dict[Way, tuple[Model, Term]] = {}
    far: set[tuple[str, str, object]] = set()
    left = {sensor: [*sets] for sensor, sets in doubted.items()}
    while any(left.values()) and not c.budget.cuts():
        ways: dict[Way, tuple[Model, Term]] = {}
        bare: dict[str, list[Way]] = {sensor: [] for sensor, sets in left.items() if sets}
        for sensor in bare:
            for m, term in _in_place(c, sensor, left[sensor].pop(0)):
                way: Way = (frozenset(m.ids), term.effect.id, term.effect.made)
                bare[sensor] += [] if m is c.model else [way]
                # (a larger set may lead to the same term as a smaller one)
                if way not in ends and (sensor, *way[1:]) not in far:
                    ways[way] = m, term
        ends |= zip(ways, fits_of(c, ways), strict=False)
        reached = {way: score(m, c.worth) for way, (m, _) in ends.items()}
        best = max([score(c.model, c.worth), *reached.values()])
        for sensor, mine in bare.items():
            # (a diverged fit does not rule its term out)
            far |= {
                (sensor, *way[1:])
                for way in mine
                if -math.inf < reached.get(way, -math.inf) < best - HOPELESS
            }
            if mine and all((sensor, *way[1:]) in far for way in mine):
                left[sensor] = []
        if not last and any(likelier(c, m) for m, _ in ends.values()):
            break
    return list(ends.values()), [sensor for sensor, sets in left.items() if not sets]


def fits_of(c: Climb, ways: Mapping[Way, tuple[Model, Term]]) -> list[tuple[Model, Term]]:
    """Fits of models with their terms, and the terms, as far as the budget allows."""
    calls = (partial(with_term, m, t, c.worth, c.beyond, c.model) for m, t in ways.values())
    return [(m, term) for m, (_, term) in in_time(c, calls, ways.values())]


def _doubted(c: Climb) -> dict[str, list[frozenset[str]]]:
    """Growing sets of effects that may imitate a law, by sensor.

    First noise, then weak names, then steps (whose moment is free), then delays (whose error is
    proportional to the rate of change of the reading). Each set includes the ones before.
    """
    gained = gains(c.where, c.model.chosen)
    out: dict[str, list[frozenset[str]]] = {}
    late = late_ones([e for e in c.model.effects if e.id not in c.kept])
    for sensor in SENSORS:
        own = [e for e in c.model.effects if e.id.startswith(sensor) and e.id not in c.kept]
        noise = frozenset(e.id for e in own if e.process is not None)
        names = [e.id for e in names_of(c, sensor)]
        weak = noise | {i for i in names if gained[i] < WEAK}
        held = weak | {i for i in names if name_of(i) != i}
        sets = noise, weak, held, held | late if noise else held
        if own_sets := [ids for ids in dict.fromkeys(sets) if ids]:
            out[sensor] = own_sets
    return out


def sensor_of(term: Term) -> str:
    """The sensor of a term; "" if it acts on none."""
    return next((s for s in SENSORS if term.effect.id.startswith(s)), "")


def names_of(c: Climb, sensor: str) -> list[Effect]:
    """The named errors of a sensor in the model, without noise and the baseline's effects."""
    own = [e for e in c.model.effects if e.id.startswith(sensor) and e.id not in c.kept]
    return [e for e in own if e.process is None and name_of(e.id) in catalogue()]


def surveyed(c: Climb) -> Survey:
    """The survey of the climb's model, made once for each model."""
    if c.survey is None or c.survey.model is not c.model:
        c.survey = survey(c.model, c.vocabulary)
    return c.survey


def _in_place(c: Climb, sensor: str, ids: frozenset[str]) -> list[tuple[Model, Term]]:
    """Terms found beside the model without these effects, each paired with the models to which it
    may be added: without the effects, and with them."""
    rest, found = beside_the_rest(c, sensor, ids, refused_by(c))
    return [(m, term) for term in found for m in (rest, c.model)]


def beside_the_rest(
    c: Climb, sensor: str, ids: frozenset[str], refused: Set[str]
) -> tuple[Model, list[Term]]:
    """The model without some effects, and the best terms beside it."""
    # (linearised without them, since removing a filter or delay is no small change)
    rest = without(c.model, ids)
    # (at the worth of the full model: without the effects, what the law explains looks like misfit)
    where = survey(rest, c.vocabulary, c.worth)
    return rest, best_terms(where, refused=refused, beyond=(sensor,))


def refused_by(c: Climb) -> set[str]:
    """Formulas that were tried, or are in the model."""
    return c.dropped | set(c.model.ids) | {t.effect.id for t in c.unnamed}


def late_ones(effects: Sequence[Effect]) -> frozenset[str]:
    """Ids of the effects that make readings of any sensor late or early."""
    alike = {i for e in catalogue().values() if e.akin for i in (e.id, *e.akin)}
    return frozenset(e.id for e in effects if e.lateness or e.id in alike)


def with_term(
    model: Model, term: Term, worth: float, refused: Set[str], than: Model | None = None
) -> Model:
    """The model with a term, and with further effects that a scan about that fit chooses: the term
    may replace noise that also held a named error (a drifting gain has a mean scale error).

    refused: names to leave out. than: a model to exceed, or the fit may stop early.
    """
    wanted = (*model.effects, term.effect)
    alone = fitted(model.parts, wanted, of_use=of_use(than, wanted, worth))
    if not (sensible(alone) and math.isfinite(alone.log_evidence)):
        return alone
    where = scanned_about(alone.bare, [term], refused)
    chosen = best_set(where, alone.chosen)
    promised = where.score(chosen) - where.score(alone.chosen)
    # (sets without the term belong to other steps)
    same = chosen == alone.chosen or term.effect.id not in chosen
    far = than is not None and better(alone, than, worth) + promised < -HOPELESS
    if same or far:
        return alone
    more = fitted_with(alone, where, chosen, than, worth)
    return more if sensible(more) and better(more, alone, worth) > 0.0 else alone

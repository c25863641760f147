"""Laws in the place of what may stand in for one on a sensor, noise first of all, or beside it."""

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

# Effects to which a term is added, its formula, and what it is made of.
Way = tuple[frozenset[str], str, object]


def instead_of_noise(c: Climb, room: int) -> Model | None:
    """The model with terms in the place of what may stand in for them, or beside it: the likeliest,
    and those of other channels that are likelier as well; room: how many there may be."""
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
    """A model with a term, and with the best of those of other channels that is likelier still,
    each in the place of what it was likelier without. (Beside the first, a further look at all laws
    mostly finds the same.)"""
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
    """Those with a term that adds to no channel to which this one adds."""
    own = set(channels_of(than.effect))
    return [(m, term) for m, term in ends if own.isdisjoint(channels_of(term.effect))]


def _may_hide(last: Barred | None, own: frozenset[str], held: float) -> bool:
    """Whether a law may be likelier in the place of doubted effects than it was when that was tried
    last: they are others, or hold as many nats more as it fell short."""
    return last is None or own != last.own or held - last.held > last.short


def _hidden_by(c: Climb, sensor: str, doubted: frozenset[str]) -> tuple[frozenset[str], float]:
    """What of the model a law of this sensor has to do with, and the nats that noise and the weak
    of the doubted effects hold."""
    own = doubted | {e.id for e in c.model.effects if e.id.startswith(sensor)}
    gained = gains(c.where, c.model.chosen)
    weak = sum(v for i, v in gained.items() if i in doubted and v < WEAK)
    rest = [e for e in c.model.effects if e.process is None or e.id not in doubted]
    if len(rest) == len(c.model.effects):
        return own, weak
    here, there = ([fit_of(f, e) for f in c.model.parts] for e in (c.model.effects, rest))
    return own, c.worth * (as_they_are(here) - as_they_are(there)) + weak


def _fell_short(c: Climb, sensor: str, ends: Sequence[tuple[Model, Term]]) -> float:
    """Nats by which the best of these laws of a sensor is less likely than the model."""
    own = [m for m, term in ends if sensor_of(term) == sensor]
    # (of what diverged nothing is known)
    nats = [-better(m, c.model, c.worth) for m in own if math.isfinite(m.log_evidence)]
    return min(nats, default=0.0 if own else ENOUGH)


def likeliest(c: Climb, ends: Sequence[tuple[Model, Term]]) -> Model | None:
    """The best of fits with a term each that are likelier than the model there is."""
    best = best_of(c, ends)
    if best is None:
        return None
    return _taken(c, *best)


def _taken(c: Climb, tried: Model, term: Term) -> Model:
    """The model with its term, which is one of the climb's from now on."""
    c.unnamed.append(term)
    forget(c, tried)
    return tried


def _ends(
    c: Climb, doubted: Mapping[str, list[frozenset[str]]], last: bool
) -> tuple[list[tuple[Model, Term]], list[str]]:
    """Fits with a term in the place of effects of each sensor, or beside them: first of the fewest;
    and the sensors of which no other set of effects is left to be asked about.

    In the place of more is looked only where in that of fewer a fit comes near the best there is:
    without further names it has no more evidence than with them, but for what these cost. And, but
    for the last term, only where none of these is of any use: what is found in the place of more
    is found beside that as well.
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
                # (in the place of more may be found what was found in that of less)
                if way not in ends and (sensor, *way[1:]) not in far:
                    ways[way] = m, term
        ends |= zip(ways, fits_of(c, ways), strict=False)
        reached = {way: score(m, c.worth) for way, (m, _) in ends.items()}
        best = max([score(c.model, c.worth), *reached.values()])
        for sensor, mine in bare.items():
            # (of one that diverged nothing is known)
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
    """Models, each fitted with its term, and that; those for which there is time."""
    calls = (partial(with_term, m, t, c.worth, c.beyond, c.model) for m, t in ways.values())
    return [(m, term) for m, (_, term) in in_time(c, calls, ways.values())]


def _doubted(c: Climb) -> dict[str, list[frozenset[str]]]:
    """Sensors, each with effects of the model that may stand in for one law together: noise, which
    hides whatever has no name; the weak ones, with it; steps, whose moment is free, with both; and
    delays besides, by which a sensor's error is as fast as what it reads changes. Each set holds
    those before."""
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
    """Of whose readings a term is ("" for a course of something else)."""
    return next((s for s in SENSORS if term.effect.id.startswith(s)), "")


def names_of(c: Climb, sensor: str) -> list[Effect]:
    """The errors of a sensor that have a name, but for noise and what is kept."""
    own = [e for e in c.model.effects if e.id.startswith(sensor) and e.id not in c.kept]
    return [e for e in own if e.process is None and name_of(e.id) in catalogue()]


def surveyed(c: Climb) -> Survey:
    """The survey of the climb's model: one for all that is asked of it."""
    if c.survey is None or c.survey.model is not c.model:
        c.survey = survey(c.model, c.vocabulary)
    return c.survey


def _in_place(c: Climb, sensor: str, ids: frozenset[str]) -> list[tuple[Model, Term]]:
    """Terms that are looked for beside the model's effects but for these, each with the models to
    which it may be added: without them, and with."""
    rest, found = beside_the_rest(c, sensor, ids, refused_by(c))
    return [(m, term) for term in found for m in (rest, c.model)]


def beside_the_rest(
    c: Climb, sensor: str, ids: frozenset[str], refused: Set[str]
) -> tuple[Model, list[Term]]:
    """The model without some effects, and terms that are looked for beside what it has."""
    # (looked for about the model without them: a filter or a delay that goes is no small change,
    # as a survey beside them would have it, nor is that of a weak name: what a sensor's asymmetry
    # stood in for showed in none)
    rest = without(c.model, ids)
    # (and for what evidence is worth with them: what a law has to do in their place is not misfit)
    where = survey(rest, c.vocabulary, c.worth)
    return rest, best_terms(where, refused=refused, beyond=(sensor,))


def refused_by(c: Climb) -> set[str]:
    """Formulas that were on trial, or are."""
    return c.dropped | set(c.model.ids) | {t.effect.id for t in c.unnamed}


def late_ones(effects: Sequence[Effect]) -> frozenset[str]:
    """Those by which readings of whatever sensor come late or early."""
    alike = {i for e in catalogue().values() if e.akin for i in (e.id, *e.akin)}
    return frozenset(e.id for e in effects if e.lateness or e.id in alike)


def with_term(
    model: Model, term: Term, worth: float, refused: Set[str], than: Model | None = None
) -> Model:
    """The model with a term, and with what a scan about that would have besides: of what noise
    held, part may have a name (a gain that drifts is a scale error too). refused: names; than: a
    model that it should be likelier than."""
    wanted = (*model.effects, term.effect)
    alone = fitted(model.parts, wanted, of_use=of_use(than, wanted, worth))
    if not (sensible(alone) and math.isfinite(alone.log_evidence)):
        return alone
    where = scanned_about(alone.bare, [term], refused)
    chosen = best_set(where, alone.chosen)
    promised = where.score(chosen) - where.score(alone.chosen)
    # (without the term it is a fit that other steps ask for)
    same = chosen == alone.chosen or term.effect.id not in chosen
    far = than is not None and better(alone, than, worth) + promised < -HOPELESS
    if same or far:
        return alone
    more = fitted_with(alone, where, chosen, than, worth)
    return more if sensible(more) and better(more, alone, worth) > 0.0 else alone

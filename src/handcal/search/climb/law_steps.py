"""Steps of a climb about laws without a name: find one, choose its form again, adjust its numbers,
put it on fewer axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.parallel import in_parallel
from handcal.estimate.rest_only import travels
from handcal.estimate.transfer import moved_to
from handcal.laws.best_law import Survey, Term, best_term, best_terms, reshaped, survey
from handcal.laws.drivers import HEADING
from handcal.laws.law_constants import adjusted
from handcal.laws.law_effect import SENSORS, effect_of, law_of
from handcal.model_score import better, score
from handcal.search.climb.candidates import scanned, scanned_about
from handcal.search.climb.state import HOPELESS, WEAK, Climb, forget, likelier, sensible
from handcal.search.climb.subset_steps import choose
from handcal.search.space import best_set, gains

# Terms without a name at the most, and of those that were on trial.
MAX_TERMS, MAX_TRIED = 3, 6
# What is known of a law and of a name goes together so far that one may be part of the other.
MIXED = 0.5
# Effects to which a term is added, its formula, and what it is made of.
_Way = tuple[frozenset[str], str, object]


def name_term(c: Climb) -> Model | None:
    """The model with a term that nobody named in the place of its noise effects, which hide
    whatever has no name, or beside them; or as it is chosen anew with a further term on trial."""
    if not _room(c):
        return None
    tried = _instead_of_noise(c)
    while tried is None and _room(c):
        term = best_term(_surveyed(c), refused=_refused(c))
        if term is None:
            break
        c.unnamed.append(term)
        c.visited.clear()
        c.stale |= set(c.noise)  # (what noise effects gained was weighed without the term)
        c.where = scanned(c)
        tried = choose(c)
    return tried


def _room(c: Climb) -> bool:
    there = sum(t.effect.id in c.model.ids for t in c.unnamed)
    return there < MAX_TERMS and len(c.unnamed) < MAX_TRIED


def _refused(c: Climb) -> set[str]:
    """Formulas that were on trial, or are."""
    return c.dropped | set(c.model.ids) | {t.effect.id for t in c.unnamed}


def _instead_of_noise(c: Climb) -> Model | None:
    """The model with a term in the place of what may stand in for one on a sensor, or beside it."""
    key, doubted = frozenset(c.model.ids), _doubted(c)
    if not doubted or key in c.bared:
        return None
    c.bared.add(key)
    return _likeliest(c, _ends(c, doubted))


def _likeliest(c: Climb, ends: Sequence[tuple[Model, Term]]) -> Model | None:
    """The best of fits with a term each, if it is likelier than the model there is."""
    if not ends:
        return None
    tried, term = max(ends, key=lambda end: score(end[0], c.worth))
    if not likelier(c, tried):
        return None
    c.unnamed.append(term)
    forget(c, tried)
    return tried


def _ends(c: Climb, doubted: Mapping[str, list[frozenset[str]]]) -> list[tuple[Model, Term]]:
    """Fits with a term in the place of effects of each sensor, or beside them: first of the fewest.

    In the place of more is looked only where in that of fewer a fit comes near the best there is:
    without further names it has no more evidence than with them, but for what these cost.
    """
    ends: dict[_Way, tuple[Model, Term]] = {}
    far: set[tuple[str, str, object]] = set()
    left = {sensor: [*sets] for sensor, sets in doubted.items()}
    while any(left.values()):
        ways: dict[_Way, tuple[Model, Term]] = {}
        without: dict[str, list[_Way]] = {sensor: [] for sensor, sets in left.items() if sets}
        for sensor in without:
            for m, term in _in_place(c, sensor, left[sensor].pop(0)):
                way: _Way = (frozenset(m.ids), term.effect.id, term.effect.made)
                without[sensor] += [] if m is c.model else [way]
                # (in the place of more may be found what was found in that of less)
                if way not in ends and (sensor, *way[1:]) not in far:
                    ways[way] = m, term
        ends |= zip(ways, _fits(c, ways), strict=True)
        reached = {way: score(m, c.worth) for way, (m, _) in ends.items()}
        best = max([score(c.model, c.worth), *reached.values()])
        for sensor, mine in without.items():
            # (of one that diverged nothing is known)
            far |= {
                (sensor, *way[1:])
                for way in mine
                if -math.inf < reached.get(way, -math.inf) < best - HOPELESS
            }
            if mine and all((sensor, *way[1:]) in far for way in mine):
                left[sensor] = []
    return list(ends.values())


def _fits(c: Climb, ways: Mapping[_Way, tuple[Model, Term]]) -> list[tuple[Model, Term]]:
    """Models, each fitted with its term, and that."""
    least = score(c.model, c.worth) - HOPELESS
    fits = in_parallel(partial(with_term, m, t, c.worth, c.beyond, least) for m, t in ways.values())
    return [(m, term) for m, (_, term) in zip(fits, ways.values(), strict=True)]


def _doubted(c: Climb) -> dict[str, list[frozenset[str]]]:
    """Sensors, each with effects of the model that may stand in for one law together: noise, which
    hides whatever has no name; the weak ones, with it; steps, whose moment is free, with both; and
    delays besides, by which a sensor's error is as fast as what it reads changes. Each set holds
    those before."""
    gained = gains(c.where, c.model.chosen)
    out: dict[str, list[frozenset[str]]] = {}
    late = _late([e for e in c.model.effects if e.id not in c.kept])
    for sensor in SENSORS:
        own = [e for e in c.model.effects if e.id.startswith(sensor) and e.id not in c.kept]
        noise = frozenset(e.id for e in own if e.process is not None)
        names = [e.id for e in own if e.process is None and name_of(e.id) in catalogue()]
        weak = noise | {i for i in names if gained[i] < WEAK}
        held = weak | {i for i in names if name_of(i) != i}
        sets = noise, weak, held, held | late if noise else held
        if own_sets := [ids for ids in dict.fromkeys(sets) if ids]:
            out[sensor] = own_sets
    return out


def _surveyed(c: Climb) -> Survey:
    """The survey of the climb's model: one for all that is asked of it."""
    if c.survey is None or c.survey.model is not c.model:
        c.survey = survey(c.model, c.vocabulary)
    return c.survey


def _in_place(c: Climb, sensor: str, ids: frozenset[str]) -> list[tuple[Model, Term]]:
    """Terms that are looked for beside the model's effects but for these, each with the models to
    which it may be added: without them, and with."""
    without, found = _beside_the_rest(c, sensor, ids, _refused(c))
    return [(m, term) for term in found for m in (without, c.model)]


def _beside_the_rest(
    c: Climb, sensor: str, ids: frozenset[str], refused: Set[str]
) -> tuple[Model, list[Term]]:
    """The model without some effects, and terms that are looked for beside what it has."""
    # (looked for about the model without them: a filter or a delay that goes is no small change,
    # as a survey beside them would have it)
    without = _without(c.model, ids)
    # (and for what evidence is worth with them: what a law has to do in their place is not misfit)
    found = best_terms(
        survey(without, c.vocabulary), refused=refused, beyond=(sensor,), worth=c.worth
    )
    return without, found


def rename(c: Climb) -> Model | None:
    """The model with another law in the place of one and of names or laws that may be there for its
    sake only. (A law that is a name beside another law to the first order is found as that: a cubic
    error as a scale error and what bends off it. And one that is found as another that resembles it
    leaves a third to be found.)"""
    ways: dict[_Way, tuple[Model, Term]] = {}
    for term in c.unnamed:
        for ids in _beside(c, term):
            rest = frozenset(c.model.ids) - ids
            if rest in c.bared:
                continue
            c.bared.add(rest)
            without, found = _beside_the_rest(c, _sensor(term), ids, c.dropped)
            ways |= {(rest, t.effect.id, t.effect.made): (without, t) for t in found}
    return _likeliest(c, _fits(c, ways))


def _beside(c: Climb, term: Term) -> list[frozenset[str]]:
    """A law with names of its sensor, with delays, by which the errors of all sensors are late or
    early, and with both; and with the other laws of its sensor, without and with these names; as
    far as the recordings hardly tell them from the law, or they are steps, whose moment is free.
    Last with all that has no name on its sensor: what is left beside a law may be so because it is
    another one."""
    sensor = _sensor(term)
    if term.effect.id not in c.model.ids or not sensor:
        return []
    taken = [e for e in c.model.effects if e.process is None and e.id not in c.kept]
    mixed = [e for e in taken if e.id != term.effect.id
             and _correlation(c.model, e.id, term.effect.id) > MIXED]  # fmt: skip
    steps = [e for e in taken if name_of(e.id) != e.id]
    names = [e for e in (*mixed, *steps) if name_of(e.id) in catalogue()]
    own = frozenset(e.id for e in names if e.id.startswith(sensor))
    late = _late(names)
    laws = frozenset(e.id for e in mixed if e.id.startswith(sensor) and e not in names)
    sets = own, late, own | late, *((laws, laws | own) if laws else ()), _nameless(c, sensor)
    return [ids | {term.effect.id} for ids in dict.fromkeys(sets) if ids - {term.effect.id}]


def _late(effects: Sequence[Effect]) -> frozenset[str]:
    """Those by which readings of whatever sensor come late or early."""
    alike = {i for e in catalogue().values() if e.akin for i in (e.id, *e.akin)}
    return frozenset(e.id for e in effects if e.lateness or e.id in alike)


def _nameless(c: Climb, sensor: str) -> frozenset[str]:
    """All laws and noise of a sensor."""
    own = [e for e in c.model.effects if e.id.startswith(sensor) and e.id not in c.kept]
    return frozenset(e.id for e in own if e.process is not None or name_of(e.id) not in catalogue())


def instead_of_travel(c: Climb) -> Model | None:
    """The model with a law with which the point is held that sways as no hand does without it.

    (Integrated twice, a force that is wrong leads away from any point as a hand does that travels,
    and its sway takes on whatever there is: no noise of the sensors asks for a law.)
    """
    key = frozenset(c.model.ids)
    if key in c.travelled or not _room(c) or not any(map(travels, c.model.parts)):
        return None
    c.travelled.add(key)
    found = best_terms(_surveyed(c), refused=_refused(c), beyond=SENSORS[:HEADING])
    ways: dict[_Way, tuple[Model, Term]] = {(key, t.effect.id, t.effect.made): (c.model, t)
                                            for t in found}  # fmt: skip
    fits = [(m, term) for m, term in _fits(c, ways) if math.isfinite(m.log_evidence)]
    return _likeliest(c, [(m, term) for m, term in fits if not any(map(travels, m.parts))])


def _correlation(model: Model, one: str, other: str) -> float:
    """The largest of what is known of a parameter of one effect and one of the other."""
    own = [[k for k, n in enumerate(model.quadratic.names) if n[0] == i] for i in (one, other)]
    sigma = np.sqrt(np.diag(model.covariance))
    both = np.abs(model.covariance[np.ix_(*own)]) / np.outer(sigma[own[0]], sigma[own[1]])
    return float(both.max(initial=0.0))


def _sensor(term: Term) -> str:
    return next((s for s in SENSORS if term.effect.id.startswith(s)), "")


def _without(model: Model, ids: Set[str]) -> Model:
    """The model without some of its effects, about the trajectory and the sensor noise that there
    are with all of them: fitted without them, what they held would be noise, in which no law
    shows."""
    rest = tuple(e for e in model.effects if e.id not in ids)
    return replace(model, effects=rest, parts=tuple(moved_to(f, rest) for f in model.parts))


def with_term(
    model: Model, term: Term, worth: float, refused: Set[str], least: float = -math.inf
) -> Model:
    """The model with a term, and with what a scan about that would have besides: of what noise
    held, part may have a name (a gain that drifts is a scale error too). refused: names; least:
    score below which that is of no use."""
    alone = fitted(model.parts, (*model.effects, term.effect))
    if not (sensible(alone) and math.isfinite(alone.log_evidence)):
        return alone
    where = scanned_about(alone.bare, [term], refused)
    chosen = best_set(where, alone.chosen)
    promised = where.score(chosen) - where.score(alone.chosen)
    if chosen == alone.chosen or score(alone, worth) + promised < least:
        return alone
    noise = [e for e in alone.effects if e.process is not None]
    more = fitted(alone.parts, [*(where.effects[i] for i in sorted(chosen)), *noise])
    return more if sensible(more) and better(more, alone, worth) > 0.0 else alone


def reshape(c: Climb) -> Model | None:
    """A law, or a course over time or direction, chosen again."""
    new = set(c.model.ids) - c.shaped
    if not any(t.effect.id in new for t in c.unnamed):
        return None
    return reshaped(_surveyed(c), c.worth, c.unnamed, c.shaped)


def adjust(c: Climb) -> Model | None:
    """The model with a law's numbers (a time, a width) as the recordings ask for them, step by step
    as far as they do."""
    for i, term in enumerate(c.unnamed):
        model, effect = c.model, term.effect
        while effect.id in model.ids and effect.id not in c.adjusted:
            c.adjusted.add(effect.id)
            new = adjusted(model, effect)
            if new is None or new.id in model.ids:
                break
            tried = fitted(model.parts, [new if e is effect else e for e in model.effects])
            if not likelier(c, tried, model):
                break
            model, effect = tried, new
        if model is not c.model:
            c.unnamed[i] = replace(term, effect=effect)
            c.shaped.add(effect.id)
            c.whole.add(effect.id)
            return model
    return None


def narrow(c: Climb) -> Model | None:
    """The model with a law on fewer axes, if it does not miss the one where it adds least: far
    from where a law is large a scan cannot tell what it adds there."""
    for i, term in enumerate(c.unnamed):
        old, law = term.effect, law_of(term.effect)
        if law is None or not law.each or old.id not in c.model.ids or old.id in c.whole:
            continue
        c.whole.add(old.id)
        mine = [k for k, n in enumerate(c.model.quadratic.names) if n[0] == old.id]
        sizes = np.abs(c.model.u[mine]).reshape(len(law.axes), -1).sum(axis=1)
        axes = tuple(a for k, a in enumerate(law.axes) if k != int(np.argmin(sizes)))
        new = effect_of(replace(law, axes=axes, each=len(axes) > 1))
        tried = fitted(c.model.parts, [new if e is old else e for e in c.model.effects])
        if likelier(c, tried):
            c.unnamed[i] = replace(term, effect=new)
            c.shaped.add(new.id)
            return tried
    return None

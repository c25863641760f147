"""Steps of a climb about laws without a name: find one, choose its form again, adjust its numbers,
put it on fewer axes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.rest_only import travels
from handcal.laws import course_numbers
from handcal.laws.best_law import Term, best_term, best_terms
from handcal.laws.chosen_again import reshaped, with_other
from handcal.laws.drivers import HEADING
from handcal.laws.grammar import LEVEL, SAME, formula, shorter
from handcal.laws.law_constants import adjusted
from handcal.laws.law_effect import SENSORS, SIZE, Law, effect_of, law_of, named
from handcal.laws.over_drivers import is_product, of_one_signal, rms_of
from handcal.search.climb.candidates import scanned
from handcal.search.climb.in_place import (
    Way,
    beside_the_rest,
    fits_of,
    instead_of_noise,
    late_ones,
    likeliest,
    names_of,
    refused_by,
    sensor_of,
    surveyed,
)
from handcal.search.climb.state import Climb, best_of, forget, in_time, likelier
from handcal.search.climb.subset_steps import choose

# Terms without a name at the most, and of those that were on trial.
MAX_TERMS, MAX_TRIED = 3, 6
# What is known of a law and of a name goes together so far that one may be part of the other.
MIXED = 0.5


def name_term(c: Climb) -> Model | None:
    """The model with a term without a name in the place of its noise effects, which hide
    whatever has no name, or beside them; or as it is chosen anew with a further term on trial."""
    if not _room(c):
        return None
    tried = instead_of_noise(c, _room(c))
    while tried is None and _room(c) and not c.budget.cuts():
        term = best_term(surveyed(c), refused=refused_by(c))
        if term is None:
            break
        c.unnamed.append(term)
        c.visited.clear()
        c.stale |= set(c.noise)  # (what noise effects gained was weighed without the term)
        c.where = scanned(c)
        tried = choose(c)
    return tried


def _room(c: Climb) -> int:
    """How many terms more there may be."""
    there = sum(t.effect.id in c.model.ids for t in c.unnamed)
    return max(min(MAX_TERMS - there, MAX_TRIED - len(c.unnamed)), 0)


def rename(c: Climb) -> Model | None:
    """The model with another law in the place of one and of names or laws that may be there for its
    sake only. (A law that is a name beside another law to the first order is found as that: a cubic
    error as a scale error and what bends off it. And one that is found as another that resembles it
    leaves a third to be found.)"""
    ways: dict[Way, tuple[Model, Term]] = {}
    for term in c.unnamed:
        for ids in c.budget.each(_beside(c, term)):
            rest = frozenset(c.model.ids) - ids
            if rest in c.bared:
                continue
            c.bared.add(rest)
            without, found = beside_the_rest(c, sensor_of(term), ids, c.dropped)
            ways |= {(rest, t.effect.id, t.effect.made): (without, t) for t in found}
    return likeliest(c, fits_of(c, ways))


def _beside(c: Climb, term: Term) -> list[frozenset[str]]:
    """A law with names of its sensor, with delays, by which the errors of all sensors are late or
    early, and with both; and with the other laws of its sensor, without and with these names; as
    far as the recordings hardly tell them from the law, or they are steps, whose moment is free.
    Last with all that has no name on its sensor: what is left beside a law may be so because it is
    another one."""
    sensor = sensor_of(term)
    if term.effect.id not in c.model.ids or not sensor:
        return []
    taken = [e for e in c.model.effects if e.process is None and e.id not in c.kept]
    mixed = [e for e in taken if e.id != term.effect.id
             and _correlation(c.model, e.id, term.effect.id) > MIXED]  # fmt: skip
    steps = [e for e in taken if name_of(e.id) != e.id]
    names = [e for e in (*mixed, *steps) if name_of(e.id) in catalogue()]
    own = frozenset(e.id for e in names if e.id.startswith(sensor))
    late = late_ones(names)
    laws = frozenset(e.id for e in mixed if e.id.startswith(sensor) and e not in names)
    sets = own, late, own | late, *((laws, laws | own) if laws else ()), _nameless(c, sensor)
    return [ids | {term.effect.id} for ids in dict.fromkeys(sets) if ids - {term.effect.id}]


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
    found = best_terms(surveyed(c), refused=refused_by(c), beyond=SENSORS[:HEADING])
    ways: dict[Way, tuple[Model, Term]] = {(key, t.effect.id, t.effect.made): (c.model, t)
                                            for t in found}  # fmt: skip
    fits = [(m, term) for m, term in fits_of(c, ways) if math.isfinite(m.log_evidence)]
    return likeliest(c, [(m, term) for m, term in fits if not any(map(travels, m.parts))])


def _correlation(model: Model, one: str, other: str) -> float:
    """The largest of what is known of a parameter of one effect and one of the other."""
    own = [[k for k, n in enumerate(model.quadratic.names) if n[0] == i] for i in (one, other)]
    sigma = np.sqrt(np.diag(model.covariance))
    both = np.abs(model.covariance[np.ix_(*own)]) / np.outer(sigma[own[0]], sigma[own[1]])
    return float(both.max(initial=0.0))


def reshape(c: Climb) -> Model | None:
    """A law, or a course over time or direction, chosen again."""
    new = set(c.model.ids) - c.shaped
    if not any(t.effect.id in new for t in c.unnamed):
        return None
    return reshaped(surveyed(c), c.worth, c.unnamed, c.shaped)


def adjust(c: Climb) -> Model | None:
    """The model with a law's numbers (a time, a width) as the recordings ask for them, step by step
    as far as they do."""
    for i, term in enumerate(c.unnamed):
        model, effect = c.model, term.effect
        while effect.id in model.ids and effect.id not in c.adjusted and not c.budget.cuts():
            c.adjusted.add(effect.id)
            new = adjusted(model, effect) or course_numbers.adjusted(model, effect)
            if new is None or new.id in model.ids:
                break
            tried = with_other(model, effect, new, model, c.worth)
            if not likelier(c, tried, model):
                break
            model, effect = tried, new
        if model is not c.model:
            c.unnamed[i] = replace(term, effect=effect)
            c.shaped.add(effect.id)
            law = law_of(effect)
            # (one of a sum may have made up for numbers that were not right yet)
            if law is None or not list(shorter(law.form)):
                c.whole.add(effect.id)
            return model
    return None


def take_in(c: Climb) -> Model | None:
    """The model with a law of how much a signal is felt that holds what is always felt of it, in
    the place of that law and of a name of its sensor that may be there for that."""
    ways: list[tuple[int, str, Effect]] = []
    for i, term in enumerate(c.unnamed):
        whole = _with_level(c, term.effect) if term.effect.id in c.model.ids else None
        if whole is None:
            continue
        asked = [(e.id, term.effect.id) for e in names_of(c, sensor_of(term))]
        ways += [(i, name, whole) for name, law in asked if (name, law) not in c.taken_in]
        c.taken_in |= set(asked)
    calls = [partial(_taken_in, c.model, c.unnamed[i].effect, name, e) for i, name, e in ways]
    best = best_of(c, in_time(c, calls, ways))
    if best is None:
        return None
    model, (i, _, whole) = best
    c.unnamed[i] = replace(c.unnamed[i], effect=whole)
    forget(c, model)
    return model


def _with_level(c: Climb, effect: Effect) -> Effect | None:
    """A law of how much a signal is felt, with what is always felt of it; None if it is none."""
    law = law_of(effect)
    if law is None or law.driver.factor is None or law.form.smooth or LEVEL in law.form.parts:
        return None
    sigma = SIZE[law.sensor] / rms_of(law, formula([LEVEL]), surveyed(c).signals)
    form = formula([*law.form.parts, LEVEL], SAME in law.form.kind)
    return effect_of(replace(law, form=form, sigmas=(*law.sigmas, sigma)))


def _taken_in(model: Model, law: Effect, name: str, whole: Effect) -> Model:
    rest = [e for e in model.effects if e.id not in (law.id, name)]
    return fitted(model.parts, [*rest, whole])


def narrow(c: Climb) -> Model | None:
    """The model with a law on fewer axes, or with one function of its sum or one signal of its
    product left out, if it does not miss what it adds least: far from where a law is large a scan
    cannot tell what it adds there."""
    for i, term in enumerate(c.unnamed):
        old = term.effect
        if old.id not in c.model.ids or old.id in c.whole:
            continue
        c.whole.add(old.id)
        new = [effect_of(law) for law in _narrower(c, old) if not named(law)]
        calls = (partial(with_other, c.model, old, e, c.model, c.worth) for e in new)
        best = best_of(c, in_time(c, calls, new))
        if best is not None:
            model, effect = best
            c.unnamed[i] = replace(term, effect=effect)
            c.shaped.add(effect.id)
            return model
    return None


def _narrower(c: Climb, effect: Effect) -> list[Law]:
    """The law without the axis on which it adds least; where it is a sum, without each of its
    functions; and where it is over a product, without each of its signals."""
    law, model = law_of(effect), c.model
    if law is None:
        return []
    out = of_one_signal(law, surveyed(c).signals) if is_product(law.driver) else []
    if law.each:
        mine = [k for k, n in enumerate(model.quadratic.names) if n[0] == effect.id]
        sizes = np.abs(model.u[mine]).reshape(len(law.axes), -1).sum(axis=1)
        axes = tuple(a for k, a in enumerate(law.axes) if k != int(np.argmin(sizes)))
        out.append(replace(law, axes=axes, each=len(axes) > 1))
    for form, kept in shorter(law.form):
        out.append(replace(law, form=form, sigmas=tuple(law.sigmas[k] for k in kept)))
    return out

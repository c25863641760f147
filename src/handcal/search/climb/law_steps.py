"""Steps of a climb for laws without a name: find one, change its form, adjust its numbers, use
fewer axes."""

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

# Largest count of terms in a model, and of terms tried.
MAX_TERMS, MAX_TRIED = 3, 6
# Correlation of a law's and a name's parameters from which one may be part of the other.
MIXED = 0.5


def name_term(c: Climb) -> Model | None:
    """The model with a new law in place of noise (which absorbs laws) or beside it, or else the
    best set of effects with a further term among the candidates."""
    if not _room(c):
        return None
    tried = instead_of_noise(c, _room(c))
    while tried is None and _room(c) and not c.budget.cuts():
        term = best_term(surveyed(c), refused=refused_by(c))
        if term is None:
            break
        c.unnamed.append(term)
        c.visited.clear()
        c.stale |= set(c.noise)  # (gains of noise effects were measured without the term)
        c.where = scanned(c)
        tried = choose(c)
    return tried


def _room(c: Climb) -> int:
    """How many more terms the model may have."""
    there = sum(t.effect.id in c.model.ids for t in c.unnamed)
    return max(min(MAX_TERMS - there, MAX_TRIED - len(c.unnamed)), 0)


def rename(c: Climb) -> Model | None:
    """The model with one law in place of a law and of names or laws that may only complement it.

    (A cubic error may be found first as a scale error and a law for the rest. A law found as a
    similar one leaves a third to be found.)
    """
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
    """Sets of effects to replace together with a law.

    They are: names of its sensor; delays; both; other laws of its sensor, without and with these
    names. Only effects correlated with the law by more than ``MIXED`` count, and steps, whose
    moment is free. Last come all laws and noise of the sensor.
    """
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
    """The model with a law that reduces the held point's sway to that of a hand.

    (A force error, integrated twice, looks like travel. The wide sway absorbs it, so that no sensor
    noise is left to be replaced by a law.)
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
    """The largest correlation between a parameter of one effect and one of the other."""
    own = [[k for k, n in enumerate(model.quadratic.names) if n[0] == i] for i in (one, other)]
    sigma = np.sqrt(np.diag(model.covariance))
    both = np.abs(model.covariance[np.ix_(*own)]) / np.outer(sigma[own[0]], sigma[own[1]])
    return float(both.max(initial=0.0))


def reshape(c: Climb) -> Model | None:
    """The model with a law or course chosen again from the whole vocabulary."""
    new = set(c.model.ids) - c.shaped
    if not any(t.effect.id in new for t in c.unnamed):
        return None
    return reshaped(surveyed(c), c.worth, c.unnamed, c.shaped)


def adjust(c: Climb) -> Model | None:
    """The model with a law's numbers (a time, a width) adjusted step by step while the score
    rises."""
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
            # (a function of a sum may have compensated wrong numbers, so ``narrow`` tries again)
            if law is None or not list(shorter(law.form)):
                c.whole.add(effect.id)
            return model
    return None


def take_in(c: Climb) -> Model | None:
    """The model with a level added to a law of varying sensitivity, in place of that law and of a
    name of its sensor that may have held the level."""
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
    """A law of varying sensitivity to a signal, with a constant level added; None for other laws,
    or if it has one."""
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
    """The model with a law on one axis less, or without one function of its sum or one signal of
    its product, if that is likelier. (Decided by fits, since a scan is not accurate where a law is
    large.)"""
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
    """Narrower versions of a law: without its weakest axis, without each function of a sum, and
    over each single signal of a product."""
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

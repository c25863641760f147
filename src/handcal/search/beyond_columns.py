"""Changes of a model that no combination of columns shows, each decided by a fit.

They are: a filter on the other side of other errors; a law's numbers; a law on fewer axes; one of
two effects that are equal to first order in the other's place; another noise in the place of one;
a filter whose lag delays have absorbed; and the model without noise, or without a weak name whose
own scores scatter much.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.effects import Effect, Param, Signals, catalogue
from handcal.effects._linear import added
from handcal.estimate.case import applicable, name_of
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.robust import inflation
from handcal.estimate.scan import scan
from handcal.laws import course_numbers
from handcal.laws.grammar import shorter
from handcal.laws.law_constants import adjusted
from handcal.laws.law_effect import Law, effect_of, law_of, named
from handcal.laws.over_drivers import is_product, of_one_signal, signals_of
from handcal.laws.weighing import beside
from handcal.laws.weighing import gains as gains_of
from handcal.model_score import NAMED, PRIOR, better, of_use, prior
from handcal.search.candidates import scanned_about
from handcal.search.noise_scan import all_noise, looks_of
from handcal.search.plausible import sensible
from handcal.search.space import best_set
from handcal.types import Array

# Divisor of the evidence between two effects that are equal to first order. It varies by as much
# as eleven nats with the hand's sway, whichever of them is the cause.
ALIKE = 4.0
# Nats by which noise at the best of a few levels may fall behind a fit.
COARSE = 10.0
# Gain below which a rare name's own scores are looked at, nats.
CLOSE = 20.0


def other_ways(model: Model, worth: float, refused: Set[str], kept: Set[str]) -> Iterator[Model]:
    """Fits of the model changed in such a way, the cheap ones first."""
    sets = [*_orders(model), *_laws(model), *_exchanged(model, refused, kept)]
    sets += [_rest(model, e) for e in noise_of(model, kept)]
    calls = (partial(fitted, model.parts, x, of_use=of_use(model, x, worth)) for x in sets)
    yield from in_parallel(calls)
    yield from _other_noise(model, worth, refused, kept)
    yield from _hidden(model, worth, refused)


def noise_of(model: Model, kept: Set[str]) -> list[Effect]:
    """The noise effects of a model that are not part of its baseline."""
    return [e for e in model.effects if e.process is not None and e.id not in kept]


def _other_noise(model: Model, worth: float, refused: Set[str], kept: Set[str]) -> Iterator[Model]:
    """The model with the likeliest other noise in the place of each of its own, by looks of both
    at the same few levels."""
    out = all_noise({*model.ids, *refused})
    for mine in noise_of(model, kept):
        looks = looks_of(model.parts, _rest(model, mine), [mine, *out], len(out) + 1)
        own = next(look.gain for look in looks if look.effects[-1] is mine)
        look = next((look for look in looks if look.effects[-1] is not mine), None)
        if look is not None and look.gain > own - COARSE:
            yield fitted(look.parts, look.effects, of_use=of_use(model, look.effects, worth))


def gains_of_noise(model: Model, kept: Set[str], worth: float) -> dict[str, float]:
    """Nats that each noise effect of a model gains, prior odds not counted, by a fit without it."""
    noise = noise_of(model, kept)
    fits = _fits(model, [_rest(model, e) for e in noise])
    return {e.id: better(model, m, worth) - PRIOR for e, m in zip(noise, fits, strict=True)}


def unsure(model: Model, kept: Set[str], worth: float) -> tuple[Effect, Model] | None:
    """A rare name that gains less than its odds, its evidence reduced if its own scores scatter
    more than the evidence as a whole, and the model without it; None if there is none."""
    names = [e for e in model.effects if e.process is None and not (e.common or e.id in kept)]
    names = [e for e in names if "+=" not in e.id]
    if not names:
        return None
    scatter, cases = inflation(model), [f.case for f in model.parts]
    for e in names:
        without = fitted(model.parts, _rest(model, e))
        odds = prior(e, cases)
        nats = better(model, without, worth) - odds
        if nats < CLOSE and nats / max(1.0, scatter[e.id] * worth) + odds < 0.0:
            return e, without
    return None


def swaps_of(
    model: Model, refused: Set[str], kept: Set[str], worth: float
) -> dict[tuple[str, str], float]:
    """Nats lost with a rival fitted in an effect's place, of those that are equal to first
    order."""
    pairs = _alike(model, refused, kept)
    ways = [_with_other(model, e, catalogue()[rival]) for e, rival in pairs]
    out: dict[tuple[str, str], float] = {}
    for (e, rival), tried in zip(pairs, _fits(model, ways), strict=True):
        # (a rival with a negative value of a positive parameter does not count)
        worse = better(model, tried, worth) if tried.one_sided else math.inf
        out[e.id, rival], out[rival, e.id] = worse, -worse
    return out


def by_convention(model: Model, swaps: dict[tuple[str, str], float]) -> Model | None:
    """The model with a slow gyro replaced by a delay of another sensor, if the evidence between
    them is not clear. By convention the gyro's stamps define time, and correcting a lag that the
    gyro does not have would make it worse. None if no exchange applies."""
    sure = math.log(NAMED / (1.0 - NAMED))
    for e in model.effects:
        near = {r: worse for (i, r), worse in swaps.items() if i == e.id and r in e.akin}
        rival = min(near, key=lambda r: near[r], default=None)
        if rival is None or near[rival] > ALIKE * sure or rival in model.ids:
            continue
        tried = fitted(model.parts, _with_other(model, e, catalogue()[rival]))
        if sensible(tried):
            return tried
    return None


def akin(a: str, b: str) -> bool:
    """Whether two effects are equal to first order."""
    one, other = catalogue().get(a), catalogue().get(b)
    return one is not None and other is not None and (b in one.akin or a in other.akin)


def _fits(model: Model, sets: Iterable[Sequence[Effect]]) -> Iterator[Model]:
    """Fits of these sets of effects, from the model on."""
    return in_parallel(partial(fitted, model.parts, effects) for effects in sets)


def _rest(model: Model, e: Effect) -> list[Effect]:
    return [x for x in model.effects if x is not e]


def _with_other(model: Model, old: Effect, new: Effect) -> list[Effect]:
    return [new if e is old else e for e in model.effects]


def _orders(model: Model) -> Iterator[list[Effect]]:
    """A filter or delay before the other errors of its sensor instead of after, or the reverse: the
    order in the sensor is unknown."""
    for e in model.effects:
        others = [x for x in model.effects if x.imu_error is not None and x.id != e.id]
        if e.imu_inverse is not None and others:
            yield _with_other(model, e, replace(e, last=not e.last))


def _laws(model: Model) -> Iterator[list[Effect]]:
    """A law with other numbers, or narrower."""
    for e in model.effects:
        if "+=" not in e.id or e.process is not None:
            continue
        new = adjusted(model, e) or course_numbers.adjusted(model, e)
        options = [] if new is None else [new]
        options += [effect_of(law) for law in _narrower(model, e) if not named(law)]
        yield from (_with_other(model, e, x) for x in options if x.id not in model.ids)


def _narrower(model: Model, effect: Effect) -> list[Law]:
    """Narrower versions of a law: without its weakest axis, without each function of a sum, and
    over each single signal of a product."""
    law = law_of(effect)
    if law is None:
        return []
    out = of_one_signal(law, signals_of(model.parts[0])) if is_product(law.driver) else []
    if law.each:
        mine = [k for k, n in enumerate(model.quadratic.names) if n[0] == effect.id]
        sizes = np.abs(model.u[mine]).reshape(len(law.axes), -1).sum(axis=1)
        axes = tuple(a for k, a in enumerate(law.axes) if k != int(np.argmin(sizes)))
        out.append(replace(law, axes=axes, each=len(axes) > 1))
    for form, own in shorter(law.form):
        out.append(replace(law, form=form, sigmas=tuple(law.sigmas[k] for k in own)))
    return out


def _alike(model: Model, refused: Set[str], kept: Set[str]) -> list[tuple[Effect, str]]:
    """Effects of the model, each with those that are equal to first order and that it lacks."""
    have = {name_of(i) for i in model.ids}
    cases = [f.case for f in model.parts]
    return [
        (e, i)
        for e in model.effects
        if e.id not in kept and e.id in catalogue()
        for i, rival in catalogue().items()
        if akin(e.id, i)
        and i not in have | refused
        and e.id not in rival.exclusive
        and any(applicable(case, rival) for case in cases)
    ]


def _exchanged(model: Model, refused: Set[str], kept: Set[str]) -> Iterator[list[Effect]]:
    for e, rival in _alike(model, refused, kept):
        yield _with_other(model, e, catalogue()[rival])


def _hidden(model: Model, worth: float, refused: Set[str]) -> Iterator[Model]:
    """The model with a filter whose lag delays may have absorbed.

    Beside delays a scan about zero cannot show a filter, since its smoothing is of second order. So
    it is fitted, from its usual size on, with all delays that could compensate its lag.
    """
    have = {name_of(i) for i in model.ids} | refused
    cases = [f.case for f in model.parts]
    for e in catalogue().values():
        if e.id in have or not _smooths(e):
            continue
        late = [catalogue()[i] for i in e.akin if i not in have]
        wanted = [x for x in (e, *late) if any(applicable(case, x) for case in cases)]
        hides = any(x.delays or akin(e.id, x.id) for x in model.effects)
        if hides and e in wanted and _promised(model, e, worth) > 0.0:
            new = _beside_delays(model, wanted, refused, worth)
            if new is not None:
                yield new


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
    model: Model, wanted: Sequence[Effect], refused: Set[str], worth: float
) -> Model | None:
    """The model with a filter and the delays that it needs, chosen about a fit with all of them;
    None if the choice is the present model."""
    tried = fitted(model.parts, [*model.effects, *wanted])
    where = scanned_about(tried.bare, refused)
    fewer = best_set(where, tried.chosen)
    if fewer in (model.chosen, tried.chosen):
        return None if fewer == model.chosen else tried
    noise = [e for e in model.effects if e.process is not None]
    effects = [*(where.effects[i] for i in sorted(fewer)), *noise]
    return fitted(tried.parts, effects, of_use=of_use(model, effects, worth))


def _smooths(effect: Effect) -> bool:
    """Whether an effect is a causal filter of the readings."""
    return effect.imu_inverse is not None and any(p.positive for p in effect.parameters)

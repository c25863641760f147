"""A law or course without a name chosen again, when more is known than when it was found."""

from __future__ import annotations

from functools import partial

from handcal.effects import Effect
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.laws.best_law import Survey, Term, best_terms, is_composed
from handcal.laws.law_effect import SENSORS, channel_of, law_of
from handcal.model_score import better, of_use, score

# Of what a law gains, the share that terms of second order leave open: a formula that costs more
# than the one there is has to gain more than that.
OPEN = 1e-3


def reshaped(where: Survey, worth: float, unnamed: list[Term], shaped: set[str]) -> Model | None:
    """The model with a law or course that fits better than the one it has, which was chosen when
    less was known; ``unnamed`` is changed with it."""
    model = where.model
    for i, term in enumerate(unnamed):
        old = term.effect
        if old.id not in model.ids or old.id in shaped:
            continue
        shaped.add(old.id)
        # (a course may be what depends on the past of something: that is further on)
        beyond = [sensor for sensor in SENSORS if old.id.startswith(sensor)]
        found = best_terms(where, without={old.id}, beyond=beyond)
        if not found:
            continue
        new = max(found, key=lambda t: t.gain)
        effects = new.effect, *new.others, *(t.effect for t in found if not is_composed(t.effect))
        tried = shaped | set(model.ids)
        options = list({e.id: e for e in effects if e.id not in tried}.values())
        calls = (partial(with_other, model, old, e, model, worth) for e in options)
        pairs = zip(in_parallel(calls), options, strict=True)
        held = [
            (m, e)
            for m, e in pairs
            if better(m, model, worth) > (OPEN * worth * new.gain if _cost(e) > _cost(old) else 0.0)
        ]
        if not held:
            continue
        best, effect = max(held, key=lambda pair: score(pair[0], worth))
        unnamed[i] = Term(effect, new.gain)
        if _kind(effect) == _kind(old):
            shaped.add(effect.id)  # (its numbers are as good as they get)
        return best
    return None


def _cost(effect: Effect) -> float:
    law = law_of(effect)
    return 0.0 if law is None or law.form.smooth else law.cost


def with_other(
    model: Model, old: Effect, new: Effect, than: Model | None = None, worth: float = 1.0
) -> Model:
    """The model fitted with one effect in the place of another; than: a model that it should be
    likelier than, at this worth of evidence."""
    wanted = [new if e is old else e for e in model.effects]
    return fitted(model.parts, wanted, of_use=of_use(than, wanted, worth))


def _kind(effect: Effect) -> tuple[str, ...]:
    """What something without a name is, but for its numbers."""
    law = law_of(effect)
    if law is not None:
        return channel_of(effect.id), law.driver.kind, law.form.kind
    return (effect.id if effect.made is None else effect.made[0],)

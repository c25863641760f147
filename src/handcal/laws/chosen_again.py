"""Second choice of a law or course, about a model that explains more than the first one did."""

from __future__ import annotations

from functools import partial

from handcal.effects import Effect
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.laws.best_law import Survey, Term, best_terms, is_composed
from handcal.laws.law_effect import SENSORS, channel_of, law_of
from handcal.model_score import better, of_use, score

# Relative error of a law's gain from second-order terms. A formula with more parameters has to gain
# more than this beyond the present one.
OPEN = 1e-3


def reshaped(where: Survey, worth: float, unnamed: list[Term], shaped: set[str]) -> Model | None:
    """The model with a better law or course in place of one it has; None if there is none.

    unnamed: terms of the model; the replaced one is updated. shaped: ids already tried; added to.
    """
    model = where.model
    for i, term in enumerate(unnamed):
        old = term.effect
        if old.id not in model.ids or old.id in shaped:
            continue
        shaped.add(old.id)
        # (a course may be a law over the past of a signal, in the further vocabulary)
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
            shaped.add(effect.id)  # (only the numbers changed, so another round is useless)
        return best
    return None


def _cost(effect: Effect) -> float:
    law = law_of(effect)
    return 0.0 if law is None or law.form.smooth else law.cost


def with_other(
    model: Model, old: Effect, new: Effect, than: Model | None = None, worth: float = 1.0
) -> Model:
    """The model fitted with ``new`` in place of ``old``; than: a model to exceed, at this worth
    of evidence, or the fit may stop early."""
    wanted = [new if e is old else e for e in model.effects]
    return fitted(model.parts, wanted, of_use=of_use(than, wanted, worth))


def _kind(effect: Effect) -> tuple[str, ...]:
    """The kind of a term, without its numbers."""
    law = law_of(effect)
    if law is not None:
        return channel_of(effect.id), law.driver.kind, law.form.kind
    return (effect.id if effect.made is None else effect.made[0],)

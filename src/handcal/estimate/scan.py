"""Scan of absent effects: one quadratic of all candidates, linearised about a fit without them."""

from __future__ import annotations

from collections.abc import Sequence

from handcal.effects import Effect
from handcal.estimate.case import problem_with
from handcal.estimate.columns import Ground, Wider, ground, widened
from handcal.estimate.model import Fitted, Model
from handcal.estimate.quadratic import Quadratic, local, total
from handcal.estimate.robust import excess
from handcal.estimate.transfer import fit_of


def grounds(model: Model) -> list[Ground]:
    """The common start of all scans about a model: its parts, linearised and filtered once."""
    out = []
    for f in model.parts:
        own = fit_of(f, model.effects)
        out.append(ground(own.linear, problem_with(own.case, model.effects), own.levels))
    return out


def with_new(f: Fitted, about: Ground, new: Sequence[Effect]) -> Wider:
    """The pass over one recording with further effects, which its model lacks."""
    seen = [e for e in new if e.acts_now_on & set(f.case.kinds)]
    return widened(about, new, problem_with(f.case, seen) if seen else None)


def scan(
    model: Model,
    candidates: Sequence[Effect],
    about: Sequence[Ground] | None = None,
    worth: float | None = None,
) -> Quadratic:
    """The quadratic of a model's effects and of all candidates, about the model's fit.

    candidates: effects, none of them noise. about: the model's ``grounds``, if they are at hand.
    worth: power of the likelihood; None measures it by the scatter of the scores. Evidence counts
    for less where innovations are correlated (Holmes & Walker, Biometrika 104, 2017).
    """
    have = {e.id for e in model.effects}
    new = [e for e in candidates if e.id not in have]
    everything = frozenset(have | {e.id for e in new})
    parts = []
    for f, base in zip(model.parts, grounds(model) if about is None else about, strict=True):
        done = with_new(f, base, new)
        q = local(done, everything).quadratic
        own = 1.0 / excess(done, frozenset(have)) if worth is None else worth
        parts.append(Quadratic(q.names, q.a, own * q.b, own * q.G, own))
    return total(parts)

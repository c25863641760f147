"""Common effects that a recording shows. Every fit estimates all of them; one is found if the
evidence falls without it by more than the odds of a name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from handcal.effects import Effect
from handcal.estimate.case import name_of
from handcal.estimate.heavy_tails import tailed
from handcal.estimate.model import Model
from handcal.estimate.prior_root import prior_root
from handcal.model_score import PRIOR
from handcal.search.space import Space, best_set
from handcal.types import Parameter

# Log odds of an effect that is always in the set.
STAYS = 1e6


@dataclass(frozen=True)
class Shown:
    """A common effect that is found.

    gain: nats lost without it. beside: common effects that imitate it, and have to be removed with
    it for the evidence to fall. rivals: log odds of effects in its place, relative to its own.
    others: the likeliest set of causes, it included.
    """

    gain: float
    beside: tuple[str, ...]
    rivals: Mapping[str, float]
    others: frozenset[str]


def shown(where: Space, chosen: frozenset[str]) -> dict[str, Shown]:
    """The common effects found among those of a model, by id. chosen: ids of the model's effects.

    Causes are the likeliest set of common effects, each at the odds of a name. A cause is found if
    the evidence falls without it, all other common effects present. If others imitate it, they are
    removed with it, the best imitation first. At least one of its parameters must be significant.
    """
    common = [i for i in sorted(chosen) if where.effects[i].common]
    rest = chosen.difference(common)
    sparse = _with_odds(where, chosen, dict.fromkeys(common, PRIOR) | dict.fromkeys(rest, STAYS))
    causes = max((best_set(sparse, start) for start in (chosen, rest)), key=sparse.score)
    spare = [i for i in common if i not in causes]
    out = {}
    for i in sorted(causes.difference(rest)):
        gain, beside = _lost(where, chosen, i, spare)
        if gain + PRIOR > 0.0 and stands_out(parameters_in(where, where.effects[i], chosen)):
            out[i] = Shown(gain, beside, _rivals(where, chosen, causes, i), causes)
    return out


def parameters_in(where: Space, effect: Effect, ids: frozenset[str]) -> tuple[Parameter, ...]:
    """Estimates of an effect's parameters in a model of these effects."""
    effects = [where.effects[i] for i in sorted(ids)]
    index = np.concatenate([where.where[e.id] for e in effects])
    q = where.quadratic
    known = tailed(q, index, prior_root(q, effects, index))
    at = [n for n, i in enumerate(index) if q.names[i][0] == effect.id]
    sigma = np.sqrt(np.diag(known.covariance))
    return tuple(
        Parameter(name_of(effect.id), p.name, float(known.mean[k]) * p.prior_sigma,
                  float(sigma[k]) * p.prior_sigma, p.unit, p.prior_sigma, None)
        for k, p in zip(at, effect.parameters, strict=True)
    )  # fmt: skip


def stands_out(parameters: Iterable[Parameter]) -> bool:
    """Whether any of an effect's parameters is significant. (An effect may gain evidence from
    several parameters, none of them significant alone.)"""
    return any(p.shown for p in parameters)


def names_of(where: Space, model: Model) -> frozenset[str]:
    """Ids of a model's effects, without common ones that the recordings do not show."""
    rare = frozenset(e.id for e in model.effects if not e.common)
    return rare.union(shown(where, model.chosen))


def evidence(where: Space, ids: Iterable[str]) -> float:
    """Log-evidence of a set, prior odds not counted."""
    key = frozenset(ids)
    return where.score(key) - sum(where.prior[i] for i in key)


def _with_odds(where: Space, ids: frozenset[str], odds: Mapping[str, float]) -> Space:
    """The space of these effects only, at these odds."""
    effects = {i: e for i, e in where.effects.items() if i in ids}
    places = {i: where.where[i] for i in effects}
    return replace(where, effects=effects, prior=odds, where=places, scores={})


def _lost(
    where: Space, chosen: frozenset[str], effect: str, spare: list[str]
) -> tuple[float, tuple[str, ...]]:
    """Nats lost without an effect, and the effects of ``spare`` that are removed with it."""
    out: list[str] = []

    def lost(without: Iterable[str]) -> float:
        rest = chosen.difference(without)
        return evidence(where, rest) - evidence(where, rest - {effect})

    gain = lost(out)
    while gain + PRIOR <= 0.0 and len(out) < len(spare):
        left = [i for i in spare if i not in out]
        best = max(left, key=lambda i: lost([*out, i]))
        out.append(best)
        gain = lost(out)
    return gain, tuple(out)


def _rivals(
    where: Space, chosen: frozenset[str], causes: frozenset[str], effect: str
) -> dict[str, float]:
    """Log odds of each other effect in place of this cause.

    A rare effect also pays the odds of a name. It beats the common effect only with fewer
    parameters.
    """
    own, size = evidence(where, causes), len(where.where[effect])
    out = {}
    for i, e in where.effects.items():
        if i not in causes and "+=" not in i and (i in chosen) == bool(e.common):
            odds = evidence(where, (causes - {effect}) | {i}) - own
            plainer = len(where.where[i]) < size
            out[i] = odds if e.common else PRIOR + (odds if plainer else min(odds, 0.0))
    return {i: v for i, v in out.items() if math.isfinite(v) and name_of(i) != name_of(effect)}

"""Effects that turn out to be a simpler one: three accelerometers at one place are a lever arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from handcal.effects import catalogue
from handcal.estimate.model import Model
from handcal.explanation import Hypothesis, Missing
from handcal.types import Array, Parameter

# Chance at which what an effect has beyond the simpler one is taken for noise.
BY_CHANCE = 1e-3


def plainly(model: Model, missing: Missing, excess: Mapping[str, float]) -> Missing:
    """The same under the simpler effect's name, where the effect in the model is not more.

    Of two effects that are one, the contract names that with fewer parameters, and lists the
    other. excess: by which the scores of each effect scatter beyond the matrix (``inflation``).
    """
    effect = next((e for e in model.effects if e.id == missing.effect), None)
    if effect is None or effect.together is None or not effect.exclusive:
        return missing
    if set(effect.exclusive) & set(model.ids):
        return missing
    mine = [i for i, n in enumerate(model.quadratic.names) if n[0] == effect.id]
    own, u = effect.together, model.u[mine]
    C = excess[effect.id] * model.covariance[np.ix_(mine, mine)]
    if not by_chance(own @ u, own @ C @ own.T):
        return missing
    plain, shared = catalogue()[effect.exclusive[0]], np.eye(len(u)) - own
    size = effect.parameters[0].prior_sigma
    value, sigma = size * (shared @ u), size * np.sqrt(np.diag(shared @ C @ shared.T))
    parameters = tuple(
        Parameter(plain.id, p.name, float(value[i]), float(sigma[i]), p.unit, p.prior_sigma, None)
        for i, p in enumerate(plain.parameters)
    )
    others = dict.fromkeys((effect.id, *missing.indistinguishable_from))
    return replace(
        missing,
        effect=plain.id,
        title=plain.title,
        indistinguishable_from=tuple(i for i in others if i != plain.id),
        parameters=parameters,
        story=plain.story,
        motion=plain.motion,
    )


def renamed(
    model: Model, told: Sequence[Missing], hypotheses: Sequence[Hypothesis]
) -> tuple[Hypothesis, ...]:
    """Evidence and probability under the name that each effect of the model is told by
    (``plainly``): what is said of the one was found of the other."""
    names = {m.effect for m in told}
    by_name = {h.effect: h for h in hypotheses}
    out = dict(by_name)
    for e in model.effects:
        plain = e.exclusive[0] if e.exclusive else ""
        if e.id not in names and plain in names and {e.id, plain} <= set(by_name):
            one, other = by_name[e.id], by_name[plain]
            out[plain] = replace(other, final=one.final, probability=one.probability)
            out[e.id] = replace(one, final=other.final, probability=other.probability)
    return tuple(out[h.effect] for h in hypotheses)


def by_chance(x: Array, C: Array) -> bool:
    """Whether x (k,) of covariance C (k, k), which may be singular, may well be nothing."""
    from scipy.special import chdtrc  # (slow to import, and seldom needed)

    values, vectors = np.linalg.eigh(C)
    seen = values > 1e-9 * values[-1]
    distance = np.sum((vectors[:, seen].T @ x) ** 2 / values[seen])
    return bool(chdtrc(int(seen.sum()), distance) >= BY_CHANCE)

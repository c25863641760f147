"""What was learnt of the parameters: of effects, of a step's moment, of biases (of noise: see
``process``)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.evidence import reduce, reduced_pass
from handcal.explain.case import name_of
from handcal.explain.find import Found
from handcal.explain.fit import Fitted, Model
from handcal.explain.search import rivals
from handcal.model import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR
from handcal.types import Parameter

# How well a moment is known, s, where only one was on trial.
MOMENT = 0.1


def learnt(found: Found, excess: Mapping[str, float]) -> dict[str, tuple[Parameter, ...]]:
    """Parameters of each effect that is no noise, by its id."""
    model = found.model
    moments = {e.id: _moment(found, e.id) for e in model.effects if "@" in e.id}
    return {
        e.id: _effect_parameters(model, e, excess[e.id], moments.get(e.id, (0.0, 0.0)))
        for e in model.effects
        if e.process is None
    }


def _moment(found: Found, effect: str) -> tuple[float, float]:
    """Mean and standard deviation of the moment at which an effect is held, s, over all moments
    on trial; what lies between two of them is not told."""
    chosen = found.model.chosen
    same = [i for i in found.space.effects if "@" in i and name_of(i) == name_of(effect)]
    same.sort(key=_held_at)
    here = _held_at(effect)
    if effect not in found.space.effects or len(same) < 2:
        return here, MOMENT
    scores = rivals(found.space, chosen, effect)
    at = np.array([_held_at(i) for i in same])
    # moments on trial lie closer together near the one that was chosen
    share = np.exp([min(scores[i], 50.0) for i in same]) * np.gradient(at)
    share /= share.sum()
    mean = float(share @ at)
    near = float(np.min(np.abs(np.delete(at, same.index(effect)) - here)))
    return mean, math.hypot(math.sqrt(float(share @ (at - mean) ** 2)), near / math.sqrt(12.0))


def _held_at(effect: str) -> float:
    return float(effect.split("@")[1])


def _effect_parameters(
    model: Model, effect: Effect, excess: float, moment: tuple[float, float]
) -> tuple[Parameter, ...]:
    at = [i for i, n in enumerate(model.quadratic.names) if n[0] == effect.id]
    sigma = math.sqrt(excess) * np.sqrt(np.maximum(np.diag(model.covariance), 0.0))
    out = []
    free = {p.name: (p, i) for p, i in zip(effect.parameters, at, strict=True)}
    for p in catalogue().get(name_of(effect.id), effect).parameters:
        if p.name in free:
            q, i = free[p.name]
            value, spread = model.u[i] * q.prior_sigma, sigma[i] * q.prior_sigma
        else:
            value, spread = moment
        out.append(
            Parameter(name_of(effect.id), p.name, float(value), float(spread), p.unit,
                      p.prior_sigma, None)
        )  # fmt: skip
    return tuple(out)


def biases(f: Fitted) -> tuple[Parameter, ...]:
    """Of gyro and accelerometer, of this recording alone."""
    done = reduced_pass(reduce(f.linear), f.levels)
    sigma = np.linalg.norm(done.spread, axis=1)[:6] * done.reduction.scale[:6]
    nominal = f.linear.trajectory
    values = np.r_[nominal.bg, nominal.ba]
    prior = [float(GYRO_BIAS_PRIOR)] * 3 + [ACCEL_BIAS_PRIOR] * 3
    names = [("gyro_bias", a, "rad/s") for a in "xyz"] + [("accel_bias", a, "m/s^2") for a in "xyz"]
    return tuple(
        Parameter(e, n, float(values[i]), float(sigma[i]), unit, prior[i], None)
        for i, (e, n, unit) in enumerate(names)
    )

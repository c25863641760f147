"""What a noise effect would gain about a fit: a pass at each of a few levels, and no other fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.linear import beside
from handcal.estimate.model import Fitted, Model
from handcal.estimate.transfer import fit_of, moved_to

# Times the first guess of each level at which a look is taken.
TIMES = (0.1, 0.3, 1.0, 3.0)
# Nats that a walk of a bias must gain to be a part of a model that is not searched for.
EVIDENT = 7.5


def drifting(model: Model) -> tuple[Effect, ...]:
    """Walks of the biases, if one of them makes the recordings evidently likelier."""
    cases = [f.case for f in model.parts]
    walks = [e for e in catalogue().values() if e.walks and any(applicable(c, e) for c in cases)]
    new = [e for e in walks if e.id not in model.ids]
    plain = [fit_of(f, model.effects) for f in model.parts]
    enough = as_they_are(plain) + EVIDENT
    evident = any(with_noise(plain, model.effects, e)[1] > enough for e in new)
    return tuple(new) if evident else ()


def with_noise(
    parts: Sequence[Fitted], effects: Sequence[Effect], e: Effect
) -> tuple[tuple[Fitted, ...], float]:
    """The recordings, fitted with these effects, with one noise effect at the best of a few levels,
    and their log-evidence there."""
    wide = [_at_best(_beside(f, moved_to(f, (*effects, e))), e) for f in parts]
    return tuple(f for f, _ in wide), sum(value for _, value in wide)


def as_they_are(parts: Sequence[Fitted]) -> float:
    """Log-evidence about the trajectories and noise levels that there are."""
    return sum(reduced_pass(reduce(f.linear), f.levels).log_evidence for f in parts)


def _beside(f: Fitted, wide: Fitted) -> Fitted:
    """The fit with a noise effect besides, which changes nothing of what is between the epochs."""
    same = len(wide.problem.slots) == len(f.problem.slots) and np.array_equal(wide.t, f.t)
    return replace(wide, about=beside(f.linear, wide.problem, wide.trajectory)) if same else wide


def _at_best(f: Fitted, e: Effect) -> tuple[Fitted, float]:
    """With the levels of a noise effect at the best of a few times their first guesses."""
    reduction, best = reduce(f.linear), (f.bare, -math.inf)
    size, *others = e.levels
    for times in product(*[TIMES] * len(others)):
        before = -math.inf
        for factor in TIMES:
            levels = dict(f.levels)
            for level, by in zip((size, *others), (factor, *times), strict=True):
                levels[level.name] = min(max(by * level.initial, level.lower), level.upper)
            value = reduced_pass(reduction, levels).log_evidence
            if value > best[1]:
                best = replace(f.bare, levels=levels), value
            if value < before:  # (over a size, evidence has one summit)
                break
            before = value
    return best

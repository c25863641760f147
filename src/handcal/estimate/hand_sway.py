"""How far a held point sways, and whether a hand does that."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from handcal.estimate.evidence import reduced_pass
from handcal.estimate.linear import About
from handcal.estimate.pieces import reduced
from handcal.estimate.problem import Problem

# A hand that holds a point still does not wander further than this (root mean square, m); nats
# that a wider sway must gain before the hand is taken to travel.
HAND_SWAY = 0.05
TRAVEL_NATS = 5.0


def typical_rate(problem: Problem) -> float:
    """Turning rate, rad/s, root mean square."""
    return float(np.sqrt((problem.rate**2).mean()))


def sway_of(problem: Problem, levels: Mapping[str, float]) -> float:
    """Root mean square of the hand's sway at these levels, m; 0 where no point is held."""
    turning = levels.get("sway_per_rate", 0.0) * typical_rate(problem)
    return math.hypot(levels.get("sway", 0.0), turning)


def beyond_a_hand(about: About, levels: Mapping[str, float]) -> float:
    """Nats by which these levels do better than the widest sway that is still a hand's, 0 where
    they are a hand's (then nothing is linearised)."""
    wide = sway_of(about.problem, levels) / HAND_SWAY
    if wide <= 1.0:
        return 0.0
    # what is seen in a short while is sigma^2 / time^3; that alone stays
    held = dict(levels) | {n: levels[n] / wide for n in ("sway", "sway_per_rate")}
    held["sway_time"] = levels["sway_time"] / wide ** (2.0 / 3.0)
    reduction = reduced(about)
    return reduced_pass(reduction, levels).log_evidence - reduced_pass(reduction, held).log_evidence

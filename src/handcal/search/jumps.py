"""Moments at which an observation was least expected: where something may have happened at once.

What changes an observation from one reading to the next shows at that moment alone: a step that
is put one reading too late leaves a reading that nothing explains, so evidence falls from the
right moment to the wrong ones at once, and no grid of moments finds it.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from handcal.compiled.kernel import MAX_DIM
from handcal.estimate.evidence import ReducedPass
from handcal.estimate.model import Fitted
from handcal.types import Array

# Moments of each kind of observation that are looked at.
MOST = 4


def sudden(f: Fitted, kinds: Set[str], done: ReducedPass) -> Array:
    """The moments (k,) between two readings of which the second was least expected, s after the
    first sample, of each of these kinds of observation; done: a pass over the fit."""
    linear = done.reduction.linear
    square = done.innovations(done.w) ** 2 / done.S
    epoch = np.repeat(np.arange(len(linear.t)), np.diff(done.reduction.first))
    found = []
    for k, observation in enumerate(linear.problem.observations):
        mine = done.reduction.slot // MAX_DIM == k
        if observation.kind not in kinds or not mine.any():
            continue
        penalty = np.bincount(epoch[mine], square[mine], len(linear.t))
        seen = np.unique(epoch[mine])
        worst = 1 + np.argsort(-penalty[seen[1:]], kind="stable")[:MOST]
        found.append(0.5 * (linear.t[seen[worst]] + linear.t[seen[worst - 1]]))
    first = f.case.recording.imu.t[0]
    return np.sort(np.concatenate(found)) - first if found else np.zeros(0)

"""Delays that are too large for a scan: tried on a grid, before the search begins."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted, Model
from handcal.estimate.parallel import in_parallel
from handcal.estimate.transfer import delayed, moved_to

# A scan does not see what a delay does when the device turns further than this within it, rad.
BEYOND = 0.5
# Nothing is later than this, s: phones' compasses, and cameras with long exposures.
LATEST = 0.45
# Steps to either side at the most: each is a linearisation of its own.
MOST_STEPS = 8
# Nats that a delay of the grid must gain as it stands, nothing adjusted to it.
LOOK = 3.0


def with_delays(model: Model) -> list[Model]:
    """The model with each delay that a scan cannot see, because the device turns too far within it.

    A scan asks what a small delay would do; after half a radian the answer says nothing of a
    large one, and the noise levels come to hold it. So delays are tried on a grid.
    """
    out = []
    for effect in catalogue().values():
        cases = [f.case for f in model.parts]
        if not _moves_in_time(effect) or effect.id in model.ids:
            continue
        if not effect.delays and not all(f.problem.navigated for f in model.parts):
            # (beside a reference readings are compared at once, and nothing is integrated)
            continue
        if not any(applicable(c, effect) for c in cases):
            continue
        wanted = (*model.effects, effect)
        begun = _begun(model, wanted, effect)
        if begun is not None:
            out.append(fitted(begun, wanted))
    return out


def _moves_in_time(effect: Effect) -> bool:
    """Whether it moves an observation, or the readings as a whole, in time."""
    return bool(effect.delays) or (
        effect.imu_inverse is not None and effect.parameters[0].unit == "s"
    )


def _begun(model: Model, wanted: Sequence[Effect], effect: Effect) -> list[Fitted] | None:
    """The recordings with the delay of the grid that suits them best, if one suits them better
    than none."""
    rates = [np.linalg.norm(f.case.recording.imu.gyro, axis=1) for f in model.parts]
    step = BEYOND / max(float(np.quantile(r, 0.95)) for r in rates)
    step = max(step, LATEST / MOST_STEPS)
    count = int(LATEST / step)
    if count == 0:
        return None
    here = [moved_to(f, wanted) for f in model.parts]
    least = _evidence(here) + LOOK
    best: list[Fitted] | None = None
    early = () if effect.parameters[0].positive else range(-count, 0)

    def late_by(seconds: float) -> tuple[list[Fitted], float]:
        there = [delayed(f, wanted, effect, seconds) for f in here]
        return there, _evidence(there)

    steps = (partial(late_by, k * step) for k in (*early, *range(1, count + 1)))
    for there, value in in_parallel(steps):
        if value > least:
            best, least = there, value
    return best


def _evidence(parts: Sequence[Fitted]) -> float:
    return sum(reduced_pass(reduce(f.linear), f.levels).log_evidence for f in parts)

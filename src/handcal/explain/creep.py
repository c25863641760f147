"""An arm that tires: the held point drifts by centimetres within many seconds, which a walking bias
of the accelerometer would stand in for."""

from __future__ import annotations

from collections.abc import Mapping

from handcal.estimate.case import creeping as creeping_case
from handcal.estimate.fit import Model, baseline, fitted, started
from handcal.explain.climb import WEAK
from handcal.explain.score import better
from handcal.observations.fixed_position import CREEPING
from handcal.types import HandcalError

OBSERVED = CREEPING.kind


def creeping(base: Model, model: Model, gained: Mapping[str, float]) -> tuple[Model, float] | None:
    """The baseline with a hand that creeps, if that with the strong ones of the model's effects
    explains as much as all of them, and by how many nats; gained: nats by effect.

    Where nothing weak was found there is no need to ask.
    """
    held = any(OBSERVED in f.case.kinds for f in base.parts)
    strong = [e for e in model.effects if e.always or gained[e.id] > WEAK]
    if not held or len(strong) == len(model.effects):
        return None
    cases = [creeping_case(f.case) for f in base.parts]
    try:
        begin = [started(case, strong) for case in cases]
    except HandcalError:
        return None
    tried = fitted(begin, strong, noise_rounds=2)
    # (every arm tires a little, so that costs nothing; what is spared does)
    advantage = better(tried, model, 1.0)
    return None if advantage < 0.0 else (baseline(cases), advantage)

"""An arm that tires: the held point drifts by centimetres within many seconds, which a walking bias
of the accelerometer would stand in for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from handcal.explain.fit import Model, fitted, started
from handcal.explain.search import OCCAM_LEVEL, PRIOR
from handcal.observations.fixed_position import CREEP, CREEPING

# Nats up to which an effect may be there for the sake of a creeping hand only.
WEAK = 100.0
OBSERVED = CREEPING.kind


def creeping(base: Model, model: Model, gained: Mapping[str, float]) -> Model | None:
    """The baseline with a hand that creeps, if that with the strong ones of the model's effects
    explains as much as all of them; gained: nats by effect.

    Where nothing weak was found there is no need to ask.
    """
    held = [OBSERVED in f.case.kinds for f in base.parts]
    strong = [e for e in model.effects if gained[e.id] > WEAK]
    if not any(held) or len(strong) == len(model.effects):
        return None
    cases = [
        replace(
            f.case,
            observed=tuple(
                (CREEPING if o.kind == OBSERVED else o, rows, constants)
                for o, rows, constants in f.case.observed
            ),
        )
        for f in base.parts
    ]
    begin = [started(case, strong) for case in cases]
    tried = fitted(begin, strong, noise_rounds=2)
    gain = tried.log_evidence - model.log_evidence - OCCAM_LEVEL * len(CREEP)
    if gain - PRIOR * (len(model.effects) - len(strong)) < 0.0:
        return None
    return fitted([started(case) for case in cases], (), noise_rounds=2)

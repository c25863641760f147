"""Somebody who moves: the held point drifts smoothly, by centimetres where an arm tires, further on
a chair that turns. A walking bias or an error that goes with the motion would stand in for that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from handcal.effects import Effect
from handcal.estimate.beside import side_by_side
from handcal.estimate.case import Case
from handcal.estimate.case import creeping as creeping_case
from handcal.estimate.fit import Model, baseline, diverged, fitted, started
from handcal.explain.climb import WEAK
from handcal.explain.score import better
from handcal.observations.fixed_position import CREEPING
from handcal.sway import beyond_a_hand
from handcal.types import HandcalError

OBSERVED = CREEPING.kind


def creeping(base: Model, model: Model, gained: Mapping[str, float]) -> tuple[Model, float] | None:
    """The baseline with a hand that creeps, if that with the strong ones of the model's effects,
    or with those of them that have a name, explains as much as all of them, and by how many nats;
    gained: nats by effect.

    Where nothing weak and nothing without a name was found there is no need to ask.
    """
    held = any(OBSERVED in f.case.kinds for f in base.parts)
    strong = [e for e in model.effects if e.always or gained[e.id] > WEAK]
    named = [e for e in strong if "+=" not in e.id]
    if not held or len(named) == len(model.effects):
        return None
    cases = [creeping_case(f.case) for f in base.parts]
    ways = [named] if len(strong) in (len(named), len(model.effects)) else [named, strong]
    # (every arm tires a little, so that costs nothing; what is spared does)
    tried = side_by_side(partial(_fit, cases, way) for way in ways)
    # (a point that sways further than a hand does was not held, whatever else there is)
    further = sum(beyond_a_hand(f.linear, f.levels) for f in model.parts)
    advantage = max(better(m, model, 1.0) for m in tried) + further
    return None if advantage < 0.0 else (baseline(cases), advantage)


def _fit(cases: Sequence[Case], effects: Sequence[Effect]) -> Model:
    """The fit of a hand that creeps; one that is worse than any other where it diverges."""
    try:
        return fitted([started(case, effects) for case in cases], effects, noise_rounds=2)
    except HandcalError:
        return diverged((), effects)

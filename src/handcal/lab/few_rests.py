"""What a few rests show: which effects `lab scalar` can estimate of them, and what would help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from handcal.estimate import regression
from handcal.estimate.regression import BIASES
from handcal.lab.choice import chosen
from handcal.lab.norm_fit import Solution, enough, solved
from handcal.lab.norm_rows import Problem, rows_of
from handcal.lab.remedy import Fits, fewer, of_misfit
from handcal.lab.telling import Unseen
from handcal.types import HandcalError


def with_remedy(refused: Unseen, problem: Problem, sensors: tuple[str, ...]) -> str:
    """A refusal with what would help: a further effect where what these leave hides parameters
    that the rests show, or fewer effects."""
    fits = _fits(problem, sensors)
    own = _solved(problem, fits.ids)
    said = str(refused)
    if own is not None:
        found, _ = own
        fits = replace(fits, beside=lambda ids: _beside(problem, found, ids))
        said = of_misfit(fits, _left(problem, found))
    return " ".join(filter(None, [said, that_would(problem, sensors)]))


def that_would(problem: Problem, sensors: tuple[str, ...]) -> str:
    """The effects of the problem that its rests do show, as an option; "" where there are none."""
    ids = fewer(_fits(problem, sensors))
    return f"These would work: --effects {','.join(ids)}." if ids else ""


def _fits(problem: Problem, sensors: tuple[str, ...]) -> Fits:
    def leaves(ids: Sequence[str]) -> Mapping[str, float] | None:
        own = _solved(problem, ids)
        return _left(problem, own[0]) if own is not None and own[1] else None

    ids = tuple(e.id for e in problem.effects if e not in BIASES)
    return Fits(leaves, lambda _: 0.0, ids, sensors, problem.rests.temperature is not None)


def _of(problem: Problem, ids: Sequence[str]) -> Problem:
    """The same rests, and other effects."""
    known = problem.rests.temperature is not None
    acting = (*(e for e in problem.effects if e in BIASES), *chosen(ids, known))
    return replace(problem, effects=acting, unknowns=regression.unknowns(acting))


def _beside(problem: Problem, found: Solution, ids: Sequence[str]) -> float:
    """What is left to first order with effects behind those that were found, weighted as there."""
    other = _of(problem, ids)
    x = np.r_[found.x, np.zeros(len(other.unknowns) - len(found.x))]
    rows = rows_of(other, x, found.d)
    root = np.sqrt(rows.total(found.extra))
    A, y = rows.both / root[:, None], rows.y / root
    return float(np.sum((y - A @ np.linalg.lstsq(A, y)[0]) ** 2))


def _solved(problem: Problem, ids: Sequence[str]) -> tuple[Solution, bool] | None:
    """The fit of some effects, and whether all of them are seen beside what it leaves; None where
    the rests alone do not show them, or nothing fits."""
    other = _of(problem, ids)
    try:
        enough(other, spare=1)
        found = solved(other, None)
    except HandcalError:
        return None
    hidden = regression.unseen(found.shown, regression.priors(other.unknowns), noise=True)
    return found, not hidden


def _left(problem: Problem, found: Solution) -> dict[str, float]:
    """What a fit leaves beyond the noise: of accelerations in the rests, m/s^2, and of turns, rad
    (between rests the gyro's bias drifts, whatever the model)."""
    missed = problem.turns.missed
    turn = found.extra["turn"] * float(np.sqrt((missed**2).mean())) if len(missed) else 0.0
    return {"accel": found.extra["accel"], "turn": turn}

"""Where every fit begins: a first trajectory by the online filter, and the fit with no effect but
those that every model has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate import noise_levels, smoother
from handcal.estimate.case import Case, no_fit, other_irons, problem_with
from handcal.estimate.derivatives import relinearised
from handcal.estimate.filter import ENGINES
from handcal.estimate.first_trajectory import first_trajectory
from handcal.estimate.fit import TOLERANCE, fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.linear import About, known_linear, linearise_about
from handcal.estimate.model import Fitted, Model
from handcal.estimate.observed import first_state
from handcal.estimate.pieces import is_long
from handcal.types import HandcalError


def always(cases: Sequence[Case]) -> tuple[Effect, ...]:
    """The effects that every model of these recordings has."""
    kinds = {k for c in cases for k in c.kinds}
    return tuple(e for e in catalogue().values() if e.always and kinds & e.acts_on)


def baseline(cases: Sequence[Case], engine: str = "compiled") -> Model:
    """The fit with no effect but those that every model has, where every other begins.

    A magnetometer's hard iron is tried from all that its readings may lie around.
    """
    effects = always(cases)
    ways = [tuple(cases)]
    for k, case in enumerate(cases):
        ways += [(*cases[:k], other, *cases[k + 1 :]) for other in other_irons(case)]

    def begun(way: Sequence[Case]) -> Model:
        # (written down, as what was found is)
        first = (started(c, effects, engine) for c in way)
        return fitted(first, effects, noise_rounds=2, tolerance=TOLERANCE)

    if len(ways) == 1:
        return begun(cases)
    fits = []
    for k, tried in enumerate(in_parallel(partial(_attempt, begun, way) for way in ways)):
        if isinstance(tried, Model):
            fits.append(tried)
        elif k == len(ways) - 1 and not fits:
            raise tried
    return max(fits, key=lambda m: m.log_evidence)


def _attempt(begun: Callable[[Sequence[Case]], Model], way: Sequence[Case]) -> Model | HandcalError:
    """The fit, or why there is none: of several starts one may diverge."""
    try:
        return begun(way)
    except HandcalError as error:
        return error


def started(case: Case, effects: Sequence[Effect] = (), engine: str = "compiled") -> Fitted:
    """A first trajectory by the online filter, with the effects that it cannot do without."""
    problem = problem_with(case, effects)
    problem = relinearised(problem, np.zeros(problem.constants), np.zeros(3), np.zeros(3))
    levels = noise_levels.initial_levels(problem) | {
        k: v for k, v in case.fixed.items() if k in {lv.name for lv in problem.levels}
    }
    state = first_state(problem, case.start, levels, case.iron)
    nominal = first_trajectory(problem, levels, state, ENGINES[engine])
    if is_long(problem, nominal):
        if not np.isfinite(nominal.p).all():
            raise no_fit([case.recording])
        # (the fit that begins here goes on until it rests, a piece at a time)
        return Fitted(case, About(problem, case.start, nominal), levels)
    linear, _, _ = smoother.relinearise(linearise_about(problem, case.start, nominal), levels)
    if not np.isfinite(linear.d).all():
        raise no_fit([case.recording])
    return Fitted(case, known_linear(linear), levels)

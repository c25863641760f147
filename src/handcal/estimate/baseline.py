"""The start of every fit: a first trajectory from the online filter, and the baseline fit, which
has only the effects of every model."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate import noise_levels, smoother
from handcal.estimate.case import Case, applicable, no_fit, other_irons, problem_with
from handcal.estimate.derivatives import relinearised
from handcal.estimate.filter import ENGINES
from handcal.estimate.first_trajectory import first_trajectory
from handcal.estimate.fit import TOLERANCE, TRUSTED, fitted, with_usual_noise
from handcal.estimate.forked import in_parallel
from handcal.estimate.linear import About, known_linear, linearise_about
from handcal.estimate.model import Fitted, Model
from handcal.estimate.observed import first_state
from handcal.estimate.pieces import is_long
from handcal.estimate.start import with_wide_gyro_bias
from handcal.types import HandcalError

# In standard deviations of a prior: longest step of a parameter in a cautious fit, and largest
# usual size of a common effect.
CAUTIOUS, FAR = 3.0, 10.0


def always(cases: Sequence[Case]) -> tuple[Effect, ...]:
    """The effects that every model of these recordings has."""
    kinds = {k for c in cases for k in c.kinds}
    return tuple(e for e in catalogue().values() if e.always and kinds & e.acts_on)


def common(cases: Sequence[Case]) -> tuple[Effect, ...]:
    """The common effects, those of every device, that one of these recordings could show."""
    known = catalogue().values()
    return tuple(e for e in known if e.common and any(applicable(c, e) for c in cases))


def dense(base: Model, without: Set[str] = frozenset()) -> Model:
    """The baseline with all common effects, or with as many of them as a fit converges with.

    It starts from the baseline with its noise, and with the usual noise, since a baseline without
    strong errors absorbs them as noise. If neither converges at usual sizes, the errors of
    observations (arm, delays, irons) are fitted first and those of sensors next, in shorter steps.

    without: ids of effects to leave out, because a fit came to an implausible size of them.
    """
    have = {*base.ids, *without}
    new = [e for e in common([f.case for f in base.parts]) if e.id not in have]
    if not new or not np.isfinite(base.log_evidence):
        return base
    effects = (*base.effects, *new)
    found = _from_both(base, effects)
    if not any(m.settled and np.abs(m.u).max() < FAR for m in found):
        seen = _from_both(base, [*base.effects, *(e for e in new if e.imu_error is None)], CAUTIOUS)
        first = max(seen, key=_better)
        found += _from_both(first, effects, CAUTIOUS) if np.isfinite(first.log_evidence) else []
        if not any(np.isfinite(m.log_evidence) for m in found):
            found = [base, first]
    return max(found, key=_better)


def plain(base: Model) -> Model:
    """The baseline fit alone, biases and the hand, from a fit with common effects."""
    effects = [e for e in base.effects if e.always]
    found = fitted(base.parts, effects, noise_rounds=2, tolerance=TOLERANCE)
    if np.isfinite(found.log_evidence):
        return found
    # (missing errors may be so strong that only wide initial noise converges)
    return baseline([replace(f.case, delays={}) for f in base.parts])


def _from_both(base: Model, effects: Sequence[Effect], trusted: float = TRUSTED) -> list[Model]:
    """Two fits of these effects: from the base with its own noise, and with the usual noise."""
    fit = partial(fitted, effects=effects, noise_rounds=2, tolerance=TOLERANCE, trusted=trusted)
    usual = [with_usual_noise(f) for f in base.parts]
    return [*in_parallel([partial(fit, base.parts), partial(fit, usual)])]


def _better(model: Model) -> tuple[bool, float]:
    return model.one_sided, model.log_evidence


def baseline(cases: Sequence[Case], engine: str = "compiled") -> Model:
    """The fit with only the effects of every model, from which all others start.

    A magnetometer's hard iron starts from the centre of each sphere that fits its readings. A gyro
    bias beyond its usual size gets a prior of that scale, or rarer errors would absorb it. Raises
    HandcalError if no start converges.
    """
    effects = always(cases)
    ways = [tuple(cases)]
    for k, case in enumerate(cases):
        ways += [(*cases[:k], other, *cases[k + 1 :]) for other in other_irons(case)]

    def begun(way: Sequence[Case]) -> Model:
        # (at the tolerance of a fit that is written down)
        first = [started(c, effects, engine) for c in way]
        found = fitted(first, effects, noise_rounds=2, tolerance=TOLERANCE)
        wide = [_with_wide_gyro_bias(f) for f in found.parts]
        same = all(f.case is case for f, case in zip(found.parts, wide, strict=True))
        return found if same else begun(wide)

    if len(ways) == 1:
        return begun(cases)
    fits = []
    for k, tried in enumerate(in_parallel(partial(_attempt, begun, way) for way in ways)):
        if isinstance(tried, Model):
            fits.append(tried)
        elif k == len(ways) - 1 and not fits:
            raise tried
    return max(fits, key=lambda m: m.log_evidence)


def _with_wide_gyro_bias(f: Fitted) -> Case:
    """The case with a gyro bias prior as wide as the fitted bias; the same case if that is usual or
    the fit diverged. (Not for the accelerometer, whose large bias may be an unknown tilt.)"""
    bias = f.trajectory.bg
    start = with_wide_gyro_bias(f.case.start, bias) if np.isfinite(bias).all() else f.case.start
    same = np.array_equal(start.bias_sigma, f.case.start.bias_sigma)
    return f.case if same else replace(f.case, start=start)


def _attempt(begun: Callable[[Sequence[Case]], Model], way: Sequence[Case]) -> Model | HandcalError:
    """The fit, or the error if it diverges: of several starts one may."""
    try:
        return begun(way)
    except HandcalError as error:
        return error


def started(case: Case, effects: Sequence[Effect] = (), engine: str = "compiled") -> Fitted:
    """A first trajectory from the online filter, with the effects that it needs to converge.

    Raises HandcalError if the filter diverges.
    """
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
        # (a long recording is linearised piece by piece in the fit)
        return Fitted(case, About(problem, case.start, nominal), levels)
    linear, _, _ = smoother.relinearise(linearise_about(problem, case.start, nominal), levels)
    if not np.isfinite(linear.d).all():
        raise no_fit([case.recording])
    return Fitted(case, known_linear(linear), levels)

"""A fit taken over: to the problem of other effects, to other constants or delays, to another
trajectory."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import numpy as np

from handcal.compiled import so3
from handcal.effects import Effect
from handcal.estimate import noise_levels
from handcal.estimate.case import problem_with
from handcal.estimate.linear import About
from handcal.estimate.model import Fitted, Model
from handcal.estimate.pieces import is_long
from handcal.estimate.problem import Problem
from handcal.estimate.sampling import interpolated
from handcal.estimate.trajectory import Trajectory, epochs, path

# A delay is linearised about where it is known to this, s.
DELAY_STEP = 0.002


def linearised(
    f: Fitted, trajectory: Trajectory, effects: Sequence[Effect], corrected: Problem | None = None
) -> Fitted:
    """The fit about the trajectory; if a delay has moved, about the moment it points to. corrected:
    the fit's problem as it became when it was linearised, if that is at hand."""
    delays = _delays(f.problem, trajectory, effects)
    known = f.case.delays
    if any(abs(delays[k] - known.get(k, 0.0)) > DELAY_STEP for k in delays):
        case = replace(f.case, delays={**known, **delays})
        problem = problem_with(case, effects)
        trajectory = transferred(trajectory, f.about, problem, corrected)
        return replace(f, case=case, about=About(problem, f.about.start, trajectory))
    problem = f.linear.problem if corrected is None else corrected
    return replace(f, about=About(problem, f.about.start, trajectory))


def _delays(
    problem: Problem, trajectory: Trajectory, effects: Sequence[Effect]
) -> dict[str, float]:
    """Delay of each kind of observation that this trajectory's constants hold, s."""
    have = {o.kind for o in problem.observations}
    found = {}
    for e in effects:
        for kind in set(e.delays) & have:
            at = next(i for i, s in enumerate(problem.slots) if s.owner == e.id)
            found[kind] = float(trajectory.constants[at])
    return found


def moved_to(f: Fitted, effects: Sequence[Effect]) -> Fitted:
    """The same trajectory in the problem of other effects: new parameters zero."""
    kept = {k for e in effects for k in e.delays}
    case = replace(f.case, delays={k: v for k, v in f.case.delays.items() if k in kept})
    problem = problem_with(case, effects)
    trajectory = transferred(f.trajectory, f.about, problem)
    levels = noise_levels.initial_levels(problem) | dict(case.fixed)
    have = {lv.name for lv in problem.levels}
    levels |= {k: v for k, v in f.levels.items() if k in have}
    return Fitted(case, About(problem, f.about.start, trajectory), levels, f.curvature)


def fit_of(f: Fitted, effects: Sequence[Effect]) -> Fitted:
    """``moved_to``, or the fit itself where it is of these effects and of no other delays."""
    kept = {k for e in effects for k in e.delays}
    own = {e.id for e in f.problem.effects} == {e.id for e in effects}
    return f if own and set(f.case.delays) <= kept else moved_to(f, effects)


def begun(f: Fitted, effects: Sequence[Effect]) -> Fitted:
    """``moved_to``, for a fit: what is one-sided begins at its usual size. (About zero a filter is
    a delay, which others may hold already, and it would be chance on which side of it a fit ends.)
    """
    if is_long(f.problem, f.trajectory) and fit_of(f, effects) is f:
        return f  # (of a long one no second problem; nobody edits its case, as a search may)
    have = {s.owner for s in f.problem.slots}
    new = [e for e in effects if e.id not in have and e.imu_inverse is not None]
    usual = {(e.id, p.name): p.prior_sigma for e in new for p in e.parameters if p.positive}
    return at_constants(moved_to(f, effects), effects, usual)


def without(model: Model, ids: Container[str]) -> Model:
    """The model without some of its effects, about the trajectory and the sensor noise that there
    are with all of them: fitted without them, what they held would be noise, in which no law
    shows."""
    rest = tuple(e for e in model.effects if e.id not in ids)
    return replace(model, effects=rest, parts=tuple(moved_to(f, rest) for f in model.parts))


def at_constants(
    f: Fitted, effects: Sequence[Effect], values: Mapping[tuple[str, str], float]
) -> Fitted:
    """The fit, of these effects already, with some of their constants set to these values (SI)
    and nothing else moved."""
    if not values:
        return f
    constants = f.trajectory.constants.copy()
    for i, s in enumerate(f.problem.slots):
        constants[i] = values.get((s.owner, s.name), constants[i])
    return linearised(f, replace(f.trajectory, constants=constants), effects)


def transferred(
    nominal: Trajectory, about: About, new: Problem, corrected: Problem | None = None
) -> Trajectory:
    """A trajectory of one fit's problem as one of another of the same recording; corrected: see
    ``linearised``."""
    old = about.problem
    values = {(s.owner, s.name): v for s, v in zip(old.slots, nominal.constants, strict=True)}
    constants = np.array([values.get((s.owner, s.name), 0.0) for s in new.slots])
    node = epochs(new)
    t_old, t = old.nodes.t[nominal.node], new.nodes.t[node]
    same = len(t) == len(t_old) and bool(np.all(t == t_old))
    markov = np.zeros((len(t_old), new.markov_size))
    for process in new.markovs:
        if len(have := old.states_of(process)):
            markov[:, new.states_of(process)] = nominal.markov[:, have]
    if same:
        return replace(nominal, node=node, constants=constants, markov=markov)
    if corrected is None:
        # (the slopes are needed only to where the constants were moved)
        corrected = about.corrected if nominal is about.trajectory else about.linear.problem
    way = path(corrected, nominal)
    return Trajectory(
        node,
        interpolated(t, old.nodes.t, way.p),
        interpolated(t, old.nodes.t, way.v),
        so3.between(old.nodes.t, way.C, t),
        nominal.bg,
        nominal.ba,
        constants,
        interpolated(t, t_old, markov),
    )

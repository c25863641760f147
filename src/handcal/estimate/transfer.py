"""Transfer of a fit to the problem of other effects, to other constants or delays, or to another
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

# Change of a delay after which its observations are linearised anew, s.
DELAY_STEP = 0.002


def linearised(
    f: Fitted, trajectory: Trajectory, effects: Sequence[Effect], corrected: Problem | None = None
) -> Fitted:
    """The fit about a trajectory, with observations at their newly estimated delays.

    corrected: the fit's problem after linearisation, if it is at hand.
    """
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
    """Delay of each kind of observation according to this trajectory's constants, s."""
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
    """The fit itself if it has exactly these effects and no other delays, else ``moved_to``."""
    kept = {k for e in effects for k in e.delays}
    own = {e.id for e in f.problem.effects} == {e.id for e in effects}
    return f if own and set(f.case.delays) <= kept else moved_to(f, effects)


def begun(f: Fitted, effects: Sequence[Effect]) -> Fitted:
    """``moved_to`` as the start of a fit: new positive parameters begin at their usual sizes.

    (Near zero a filter acts as a delay. Delays in the model may absorb it, and the sign of the
    estimate would be chance.)
    """
    if is_long(f.problem, f.trajectory) and fit_of(f, effects) is f:
        return f  # (avoids a second problem of a long recording)
    have = {s.owner for s in f.problem.slots}
    new = [e for e in effects if e.id not in have and e.imu_inverse is not None]
    usual = {(e.id, p.name): p.prior_sigma for e in new for p in e.parameters if p.positive}
    return at_constants(moved_to(f, effects), effects, usual)


def without(model: Model, ids: Container[str]) -> Model:
    """The model without some of its effects, about the trajectory and noise of the full fit.

    (A fit without them would raise the noise levels, and hide the laws that are searched next.)
    """
    rest = tuple(e for e in model.effects if e.id not in ids)
    return replace(model, effects=rest, parts=tuple(moved_to(f, rest) for f in model.parts))


def at_constants(
    f: Fitted, effects: Sequence[Effect], values: Mapping[tuple[str, str], float]
) -> Fitted:
    """The fit with some constants of its effects set to these values (SI), all else unchanged."""
    if not values:
        return f
    constants = f.trajectory.constants.copy()
    for i, s in enumerate(f.problem.slots):
        constants[i] = values.get((s.owner, s.name), constants[i])
    return linearised(f, replace(f.trajectory, constants=constants), effects)


def transferred(
    nominal: Trajectory, about: About, new: Problem, corrected: Problem | None = None
) -> Trajectory:
    """A trajectory carried over to another problem of the same recording.

    nominal: trajectory of ``about.problem``. corrected: see ``linearised``.
    """
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
        # (slopes are needed only if the trajectory is another than the one linearised about)
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

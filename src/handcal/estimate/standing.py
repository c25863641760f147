"""Where a fit stands at the end of its recording, so that a filter can go on from there.

What the whole fit says of its parameters is not what its last forward pass says (several
recordings, what was known before, how much scores scatter), so the pass's state is moved to it:
what it says of everything else, *given* the parameters, stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import BASE
from handcal.estimate.problem import Problem
from handcal.estimate.start import BIASES
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array, Standing

# Of its variance, what is added to each parameter so that their covariance can be solved with.
RIDGE = 1e-12


def standing_of(problem: Problem, t: float, nominal: Trajectory, x: Array, P: Array) -> Standing:
    """The last epoch, at t (s), of a nominal trajectory with errors x (N,) known to P (N, N)."""
    extras = np.r_[nominal.constants, nominal.markov[-1]]
    navigated = nominal.p[-1], nominal.v[-1], nominal.C[-1], nominal.bg, nominal.ba
    return moved(in_terms_of(problem, t, navigated, extras, P), x)


def in_terms_of(
    problem: Problem, t: float, navigated: tuple[Array, Array, Array, Array, Array], extras: Array,
    P: Array,
) -> Standing:  # fmt: skip
    """A state of a problem at t (s): place, velocity, attitude and biases (``navigated``), then
    constants and Markov states."""
    return Standing(
        t, *navigated, tuple(e.id for e in problem.effects),
        tuple(o.kind for o in problem.observations),
        tuple((s.owner, s.name) for s in problem.slots), processes(problem), extras, P,
        problem.recording.bias_temperature,
    )  # fmt: skip


def processes(problem: Problem) -> tuple[tuple[str, int], ...]:
    """Owner and number of states of each Markov process, in their order."""
    owned = [(o.kind, o.markov) for o in problem.observations]
    owned += [(e.id, e.process) for e in problem.effects if e.imu_error is None]
    return tuple((owner, m.size) for owner, m in owned if m is not None)


def places(standing: Standing, names: Sequence[tuple[str, str]]) -> list[int]:
    """Where parameters stand among the states, -1 for those that do not."""
    at = {n: 9 + i for i, n in enumerate((*BIASES, *standing.names))}
    return [at.get(n, -1) for n in names]


def known_as(
    standing: Standing, names: Sequence[tuple[str, str]], mean: Array, covariance: Array
) -> Standing:
    """The same with these parameters known as well as this: mean (m,), covariance (m, m), SI. What
    everything else is, given them, stays as it was."""
    at = np.array(places(standing, names), dtype=np.int64)
    own = (at >= 0) & (np.diag(standing.P)[at] > 0.0)
    mine, mean, S = at[own], mean[own], covariance[np.ix_(own, own)]
    if not len(mine):
        return standing
    others = np.setdiff1d(np.arange(len(standing.P)), mine)
    P = standing.P
    sigma = np.sqrt(np.diag(P)[mine])
    scaled = P[np.ix_(mine, mine)] / np.outer(sigma, sigma) + RIDGE * np.eye(len(mine))
    # (by how much everything else moves with the parameters)
    A = np.linalg.solve(scaled, (P[np.ix_(others, mine)] / sigma).T).T / sigma
    x = np.zeros(len(P))
    x[mine] = mean - _values(standing)[mine - 9]
    x[others] = A @ x[mine]
    new = np.empty_like(P)
    new[np.ix_(mine, mine)] = S
    new[np.ix_(others, mine)] = A @ S
    new[np.ix_(mine, others)] = (A @ S).T
    more = S - P[np.ix_(mine, mine)]
    new[np.ix_(others, others)] = P[np.ix_(others, others)] + A @ more @ A.T
    return moved(replace(standing, P=0.5 * (new + new.T)), x)


def moved(standing: Standing, x: Array) -> Standing:
    """The same with its state moved by errors x (N,)."""
    return replace(
        standing,
        p=standing.p + x[0:3],
        v=standing.v + x[3:6],
        C=np.asarray(so3.rotations(x[None, 6:9])[0] @ standing.C),
        bg=standing.bg + x[9:12],
        ba=standing.ba + x[12:BASE],
        extras=standing.extras + x[BASE:],
    )


def kept(standing: Standing, kinds: Sequence[str], effects: Sequence[str],
         names: Sequence[tuple[str, str]],
         processes: Sequence[tuple[str, int]]) -> Standing:  # fmt: skip
    """The same in a model of fewer kinds and effects: of what is left out nothing is assumed (its
    states are integrated out). names, processes: those of that model, in its order."""
    first = np.cumsum([len(standing.names), *(n for _, n in standing.processes)])
    spans = {o: (int(i), n) for (o, n), i in zip(standing.processes, first, strict=False)}
    at = [standing.names.index(n) for n in names]
    for owner, size in processes:
        begin, n = spans[owner]
        if n != size:
            raise ValueError(f"{owner} has {n} states, not {size}")
        at += range(begin, begin + n)
    states = np.r_[np.arange(BASE), BASE + np.array(at, dtype=np.int64)]
    return replace(
        standing, effects=tuple(effects), kinds=tuple(kinds), names=tuple(names),
        processes=tuple(processes), extras=standing.extras[at],
        P=standing.P[np.ix_(states, states)],
    )  # fmt: skip


def _values(standing: Standing) -> Array:
    """Biases and constants (6 + c,)."""
    constants = standing.extras[: len(standing.names)]
    return np.concatenate([standing.bg, standing.ba, constants])

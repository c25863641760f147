"""The trajectory about which a problem is linearised: nominal states at the epochs, and the way
between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from handcal.compiled.kernel import Nodes
from handcal.compiled.preintegration import (
    integrate,
)
from handcal.estimate.filter import Track
from handcal.estimate.problem import Problem
from handcal.types import Array, IntArray

# Longest epoch, s: the interval between looks at a held point.
LONGEST = 1.0 / 3.0


@dataclass(frozen=True)
class Trajectory:
    """Nominal states at k epochs: node (k,), p, v (k, 3), C (k, 3, 3), Markov states (k, e);
    biases and constants."""

    node: IntArray
    p: Array
    v: Array
    C: Array
    bg: Array
    ba: Array
    constants: Array
    markov: Array


def epochs(problem: Problem) -> IntArray:
    """Nodes at which something is observed, with the first and the last node, and in between as
    many that none of them is much longer than ``LONGEST``: within an epoch no noise is driven."""
    seen, t = np.diff(problem.nodes.first) > 0, problem.nodes.t
    seen[[0, -1]] = True
    at = np.flatnonzero(seen)
    for a, b in pairwise(at):
        many = round(float(t[b] - t[a]) / LONGEST)
        if many > 1:
            seen[np.searchsorted(t, np.linspace(t[a], t[b], many + 1)[1:-1])] = True
    return np.flatnonzero(seen)


def trajectory_of(
    problem: Problem, track: Track, bg: Array, ba: Array, extras: Array
) -> Trajectory:
    """Nominal trajectory from what the online filter recorded at the epochs."""
    return Trajectory(
        track.node,
        track.p.copy(),
        track.v.copy(),
        track.C.copy(),
        bg.copy(),
        ba.copy(),
        extras[: problem.constants].copy(),
        track.extras[:, problem.constants :].copy(),
    )


def biases(problem: Problem, nominal: Trajectory) -> tuple[Array, Array]:
    """Bias of gyro and of accelerometer at the epochs, (k, 3) each, walks included."""
    out = np.tile(np.r_[nominal.bg, nominal.ba], (len(nominal.node), 1))
    for state, column in problem.walks:
        out[:, column : column + 3] += nominal.markov[:, state : state + 3]
    return np.ascontiguousarray(out[:, :3]), np.ascontiguousarray(out[:, 3:])


def intervals(
    problem: Problem, nominal: Trajectory
) -> tuple[Nodes, IntArray, tuple[Array, Array, Array], tuple[Array, Array], Array, Array]:
    """What integrating from epoch to epoch begins with (see ``preintegrate``)."""
    return (
        problem.nodes,
        nominal.node,
        (nominal.p, nominal.v, nominal.C),
        biases(problem, nominal),
        problem.g_n,
        problem.omega_ie_n,
    )


@dataclass(frozen=True)
class Path:
    """Position, velocity (n, 3) and attitude (n, 3, 3) at all nodes, and by how much what was
    integrated missed the epochs, d (k, 9)."""

    p: Array
    v: Array
    C: Array
    d: Array


def path(problem: Problem, nominal: Trajectory) -> Path:
    """The nominal trajectory between its epochs, as the readings tell it."""
    n = len(problem.nodes.t)
    if problem.slopes is not None:
        moved = problem.slopes.times(nominal.constants - problem.ref)
        nodes = problem.nodes
        gyro, accel = nodes.gyro - moved[:, :3], nodes.accel - moved[:, 3:]
        problem = replace(problem, nodes=nodes._replace(gyro=gyro, accel=accel))
    out = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
    d = np.zeros((len(nominal.node), 9))
    integrate(*intervals(problem, nominal), out, d)
    return Path(*out, d)

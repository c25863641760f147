"""The online filter over a whole recording, piece by piece: the first trajectory of a long one.

Its noise levels, turned into arrays for every node, would take half a kilobyte each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from handcal.compiled.kernel import Noise
from handcal.estimate.filter import State, Track, empty_track
from handcal.estimate.problem import Problem, between, noise_arrays
from handcal.estimate.trajectory import Trajectory, epochs
from handcal.types import Array

# Nodes of a piece.
PIECE = 20_000


def first_trajectory(
    problem: Problem,
    levels: Mapping[str, float],
    state: State,
    engine: Callable[[Problem, Noise, State, Track], State],
) -> Trajectory:
    """What the online filter finds at the epochs, at these noise levels (SI), from ``state``, which
    is before the first node; constants and biases as they are at the end."""
    node, count, c = epochs(problem), len(problem.nodes.t), problem.constants
    k = len(node)
    p, v, C = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3, 3))
    markov: Array = np.empty((k, problem.markov_size))
    for a in range(0, count, PIECE):
        # (the piece begins with the node that was reached: it tells when the next interval begins)
        first, end = max(a - 1, 0), min(a + PIECE, count)
        some = between(problem, first, end - 1)
        rows = slice(*np.searchsorted(node, (a, end)))
        track = empty_track(some, node[rows] - first)
        noise = noise_arrays(some, levels)
        state = engine(some, noise, replace(state, node=a - 1 - first), track)
        p[rows], v[rows], C[rows] = track.p, track.v, track.C
        markov[rows] = track.extras[:, c:]
    return Trajectory(node, p, v, C, state.bg, state.ba, state.extras[:c].copy(), markov)

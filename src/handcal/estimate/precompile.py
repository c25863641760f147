"""What a fit needs last, compiled by ``python -m handcal.estimate.precompile``, another process.

On a first run the process that fits compiles the online filter and the linearisation; meanwhile
this one calls everything after these on a problem of zeros and keeps the machine code on disk,
where the other finds it. The last comes first: they meet in the middle.
"""

from __future__ import annotations

import numpy as np

from handcal.estimate import robust, smoother
from handcal.estimate.case import case_of, problem_with
from handcal.estimate.evidence import means, reduce, reduced_pass
from handcal.estimate.folded import unfolded
from handcal.estimate.heavy_tails import tailed
from handcal.estimate.linear import Linear
from handcal.estimate.noise_levels import Score, initial_levels
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.trajectory import Trajectory, epochs
from handcal.types import Imu, Recording, Series

# Of the still recording that everything is compiled on: any will do.
RATE_HZ, SECONDS = 100.0, 3.0


def compile_ahead() -> None:
    """Compile, in the types that any recording comes in."""
    linear, levels = _still()
    smoother.forward(linear, levels)
    tailed(Quadratic((("none", "x"),), 0.0, np.zeros(1), np.eye(1)), np.arange(1))
    done = reduced_pass(reduce(linear, folds=False), levels, keep=True)
    means(done)
    robust._add_by_block(
        done.nu, done.S, np.zeros(len(done.S), dtype=np.int64), done.nu[:1, 1:].copy()
    )
    Score(done.reduction, levels, list(levels))(levels)
    folded = reduce(linear).folded
    assert folded is not None
    unfolded(folded, linear.t, np.zeros((len(folded.start), linear.problem.size)))


def _still() -> tuple[Linear, dict[str, float]]:
    """A device that keeps its heading, linearised about just that, and noise levels."""
    t = np.arange(RATE_HZ * SECONDS) / RATE_HZ
    accel = np.tile([0.0, 0.0, 9.8], (len(t), 1))
    imu = Imu(t, np.zeros((len(t), 3)), accel, np.ones(len(t), dtype=np.bool_))
    # (many readings of a heading between two of the held point: as many are folded into one)
    case = case_of(Recording("", imu, {"heading": Series(t, np.zeros((len(t), 1)))}))
    problem = problem_with(case, ())
    node, nodes = epochs(problem), problem.nodes
    k, q, width = len(node), len(nodes.kind), int(problem.tables.dim.max(initial=1))
    nominal = Trajectory(
        node, np.zeros((k, 3)), np.zeros((k, 3)), np.tile(np.eye(3), (k, 1, 1)), np.zeros(3),
        np.zeros(3), np.zeros(problem.constants), np.zeros((k, problem.markov_size)),
    )  # fmt: skip
    Q = np.zeros((3, k, 9, 9))
    linear = Linear(
        problem, nominal, case.start, np.zeros((k, 9, 15)), np.zeros((k, 9)), Q[0], Q[1], Q[2],
        nodes.t[node], problem.rate[node], np.r_[nodes.first[node], nodes.first[-1]], nodes.kind,
        np.zeros((q, width)), np.zeros((q, width, problem.size)), np.ones(q, dtype=np.bool_),
    )  # fmt: skip
    return linear, initial_levels(problem)


if __name__ == "__main__":
    compile_ahead()

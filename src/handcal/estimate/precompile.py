"""What a fit needs last, compiled by ``python -m handcal.estimate.precompile``, another process.

On a first run the process that fits compiles the online filter and the linearisation; meanwhile
this one calls everything after these on a problem of zeros and keeps the machine code on disk,
where the other finds it. The last comes first: they meet in the middle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.compiled.kernel import BASE
from handcal.compiled.preintegration import responses
from handcal.estimate import robust, smoother
from handcal.estimate.baseline import common
from handcal.estimate.case import Case, case_of, problem_with
from handcal.estimate.corrected import corrected_readings
from handcal.estimate.derivatives import differentiated
from handcal.estimate.evidence import means, reduce, reduced_pass
from handcal.estimate.folded import unfolded
from handcal.estimate.heavy_tails import tailed, usual
from handcal.estimate.linear import Linear
from handcal.estimate.noise_levels import Score, initial_levels
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.seen import seen_by_constants
from handcal.estimate.trajectory import Trajectory, epochs, path
from handcal.types import Imu, Recording, Series

# Of the still recording that everything is compiled on: any will do.
RATE_HZ, SECONDS = 100.0, 3.0


def compile_ahead() -> None:
    """Compile, in the types that any recording comes in."""
    case = _still()
    linear, levels = _baseline(case)
    smoother.forward(linear, levels)
    one = Quadratic((("gyro_scale", "x"),), 0.0, np.zeros(1), np.eye(1))
    for of_scales in (tailed, usual):
        of_scales(one, np.arange(1))
    _of_every_device(case, linear.trajectory)
    done = reduced_pass(reduce(linear, folds=False), levels, keep=True)
    means(done)
    robust._add_by_block(
        done.nu, done.S, np.zeros(len(done.S), dtype=np.int64), done.nu[:1, 1:].copy()
    )
    Score(done.reduction, levels, list(levels))(levels)
    folded = reduce(linear).folded
    assert folded is not None
    unfolded(folded, linear.t, np.zeros((len(folded.start), linear.problem.size)))


def _of_every_device(case: Case, nominal: Trajectory) -> None:
    """What the errors that every device has need besides (``baseline.dense``)."""
    problem = problem_with(case, common([case]))
    nominal = replace(nominal, constants=np.zeros(problem.constants))
    done = corrected_readings(problem, nominal.constants, nominal.bg, nominal.ba)
    problem = differentiated(done, np.zeros((len(case.recording.imu.t), 6)))
    path(problem, nominal)
    slopes, nodes = problem.slopes, problem.nodes
    assert slopes is not None
    W = np.zeros((len(nodes.t), 9, 6))
    Phi = np.zeros((len(nominal.node), 9, BASE + problem.imu_constants))
    responses(W, slopes.values, slopes.channel, slopes.column, nominal.node, Phi[:, :, BASE:])
    widest = int(problem.tables.dim.max(initial=1))
    seen_by_constants(slopes, nodes.first, np.ones((len(nodes.kind), widest, problem.size)))


def _still() -> Case:
    """A device that keeps its heading."""
    t = np.arange(RATE_HZ * SECONDS) / RATE_HZ
    accel = np.tile([0.0, 0.0, 9.8], (len(t), 1))
    imu = Imu(t, np.zeros((len(t), 3)), accel, np.ones(len(t), dtype=np.bool_))
    # (many readings of a heading between two of the held point: as many are folded into one)
    return case_of(Recording("", imu, {"heading": Series(t, np.zeros((len(t), 1)))}))


def _baseline(case: Case) -> tuple[Linear, dict[str, float]]:
    """Linearised about just that, and noise levels."""
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

"""What observations see besides the state: those that look at rate and force themselves, constants
and biases; and what has come before, where an effect depends on that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from handcal.compiled.jit import njit
from handcal.compiled.kernel import BASE
from handcal.effects import Effect, Signals, seen_columns
from handcal.estimate.derivatives import errors_by_bias
from handcal.estimate.problem import Problem, Slopes
from handcal.estimate.trajectory import Trajectory, path
from handcal.observations import nearest
from handcal.signals import of_recording
from handcal.types import Array, IntArray


def seen_by_constants(slopes: Slopes, first: IntArray, H: Array) -> None:
    """Let observations that look at rate and force see the IMU constants, in their rows H."""
    rows = np.flatnonzero(H[:, :, 9:BASE].any(axis=(1, 2)))
    if not len(rows):
        return
    node = np.searchsorted(first, rows, side="right") - 1
    _add_seen(rows, node, slopes.values, slopes.channel, slopes.column, H)


def truth(problem: Problem, nominal: Trajectory) -> Signals:
    """The best estimate of rate, force and attitude at the IMU's samples; problem: with corrected
    readings, where it is navigated."""
    imu = problem.recording.imu
    read = np.hstack([imu.gyro - nominal.bg, imu.accel - nominal.ba])
    C_nb = None
    if problem.navigated:
        C_nb = path(problem, nominal).C[np.searchsorted(problem.nodes.t, imu.t)]
    return of_recording(problem.recording, read=read, C_nb=C_nb)


def seen_over_time(
    problem: Problem, nominal: Trajectory, effects: Sequence[Effect]
) -> Iterator[tuple[Effect, IntArray, Array]]:
    """Of each effect with columns of its own (``Effect.seen``): readings (m,) that it changes, and
    by what for a unit of each of its parameters (m, k)."""
    signals, nodes = None, problem.nodes
    for kind, observation in enumerate(problem.observations):
        mine = np.flatnonzero(nodes.kind == kind)
        for e in (e for e in effects if observation.kind in e.seen):
            signals = truth(problem, nominal) if signals is None else signals
            t = nodes.t[np.searchsorted(nodes.first, mine, side="right") - 1]
            yield e, mine, seen_columns(e, observation.kind, signals, t)


def seen_by_past(problem: Problem, nominal: Trajectory, r: Array, H: Array) -> None:
    """Take from the residuals r (q, m) what such effects of the problem add, and let their rows of
    H (q, m, N) see their constants."""
    for e, mine, columns in seen_over_time(problem, nominal, problem.effects):
        at = [i for i, s in enumerate(problem.slots) if s.owner == e.id]
        r[mine, 0] -= columns @ nominal.constants[at]
        H[mine[:, None], 0, BASE + np.array(at)] = columns


def by_biases(problem: Problem, nominal: Trajectory) -> tuple[Array, Array] | None:
    """What effects add with a bias (q, 6, 6), where readings are looked at themselves, and with a
    bias of this sample alone; None where they are not, or nothing is added."""
    nodes = problem.nodes
    by_bias = None if problem.navigated else errors_by_bias(problem, nominal.bg, nominal.ba)
    if by_bias is None:
        return None
    seen = np.searchsorted(nodes.first, np.arange(len(nodes.kind)), side="right") - 1
    at = nearest(problem.recording.imu.t, nodes.t[seen])
    return by_bias[0][at], by_bias[1][at]


def measured(problem: Problem, by_sample: Array) -> Array:
    """What residuals (q, 6) are multiplied by (q, 6, 6), to be in the measure of what was read, not
    of what is left of it when effects are taken off; by_sample: as of ``by_biases``.

    Corrected for a scale error of 5 %, readings have 5 % less noise. If that counted, evidence
    would be for whatever makes readings smaller (0.05 nats for each of them), without another word
    of theirs. The reference's noise does not become smaller: residuals are as much larger as the
    IMU's share of the noise has it. Noise is new at each sample: what others do to it does not
    count (a signal less the mean of what it was is smaller in its noise, and not in its mean).
    """
    nodes, imu = problem.nodes, problem.recording.imu
    out = np.tile(np.eye(6), (len(by_sample), 1, 1))
    for kind, observation in enumerate(problem.observations):
        if observation.ours is None:
            continue
        mine = np.flatnonzero(nodes.kind == kind)
        at = nearest(imu.t, nodes.t[np.searchsorted(nodes.first, mine, side="right") - 1])
        share = observation.ours(nodes.z[mine], np.hstack([imu.gyro[at], imu.accel[at]]))
        out[mine] -= share[:, None] * by_sample[mine]
    return out


def seen_by_biases(problem: Problem, by_bias: Array | None, H: Array) -> None:
    """Let the rows H see what effects that are not linear add with a bias, and the walks what the
    biases do."""
    if by_bias is not None:
        H[:, :, 9:15] += H[:, :, 9:15] @ by_bias
    e0 = BASE + problem.constants
    for state, column in problem.walks:
        H[:, :, e0 + state : e0 + state + 3] = H[:, :, 9 + column : 12 + column]


@njit
def _add_seen(
    rows: IntArray, node: IntArray, slopes: Array, channel: IntArray, column: IntArray, H: Array
) -> None:
    for q, at in zip(rows, node):  # noqa: B905 (numba's zip has no strict)
        for i in range(H.shape[1]):
            for s in range(len(channel)):
                H[q, i, BASE + column[s]] += H[q, i, 9 + channel[s]] * slopes[at, s]

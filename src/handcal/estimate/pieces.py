"""A long recording linearised piece by piece, so that nobody holds all its epochs at once.

What is between two epochs takes four kilobytes, and an hour of headings has two hundred thousand
epochs: a piece of them is linearised, its readings are gathered into windows (``gathered``), and
what it was made of is forgotten. Between the beginnings of windows a trajectory is what the
readings tell, integrated once more.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.compiled.memory import returned
from handcal.compiled.preintegration import responses, turn_noise
from handcal.estimate.derivatives import differentiated
from handcal.estimate.evidence import Reduction, Scalars, reduce, reduced_of, scalars_of, units
from handcal.estimate.exciting import unexciting
from handcal.estimate.folded import Folded, at_epochs
from handcal.estimate.gathered import gathered, windows
from handcal.estimate.linear import (
    About,
    Linear,
    believing,
    observed,
    prepared,
    transitions,
    turning,
)
from handcal.estimate.parallel import in_threads
from handcal.estimate.problem import Problem, between, foldable
from handcal.estimate.start import Start
from handcal.estimate.trajectory import Trajectory, path
from handcal.estimate.white import white_levels
from handcal.types import Array, BoolArray, IntArray

# Epochs from which a recording is long (six minutes of headings, fifty a second), and as many as
# a piece has of them, about (16 MB).
LONG, PIECE = 20_000, 4_000
# Longest window, s: where a point is held, it is looked at more often than that.
WINDOW_S = 0.4
# The same where a bias walks, which is neglected within a window: at 0.4 s a gyro's that walks by
# 3e-4 rad/s in a second was 4 % surer of where it began.
WALKING_S = 0.1
# Of the variance of a window's mean, what the gyro's noise within it may be (an hour of headings of
# 5 deg is off by 0.02 nats); windows as short as those that are folded are taken anyway.
NEGLECTED, SHORTEST_S = 1e-5, 0.07
# Readings that are enough to see how noisy they are.
ENOUGH = 10_000


# Whether long recordings are gone about piece by piece here: whoever looks for what is missing asks
# for every reading, and for the sway within windows, which may excite no effect.
_ALLOWED: ContextVar[bool] = ContextVar("_ALLOWED", default=False)


@contextmanager
def by_pieces() -> Iterator[None]:
    """Within this, long recordings are gone about piece by piece, in threads begun here too."""
    token = _ALLOWED.set(True)
    try:
        yield
    finally:
        _ALLOWED.reset(token)


def is_long(problem: Problem, nominal: Trajectory) -> bool:
    """Whether to go about it piece by piece: many epochs, most of them of readings that may be
    gathered, and nothing that sees more of the past than its own moment."""
    if not _ALLOWED.get() or len(nominal.node) < LONG or not problem.navigated:
        return False
    if not foldable(problem).any() or any(e.seen for e in problem.effects):
        return False
    return len(starts(problem, nominal)) < len(nominal.node) / 2


def starts(problem: Problem, nominal: Trajectory) -> IntArray:
    """Epochs (K,) at which windows begin."""
    nodes, node = problem.nodes, nominal.node
    folds = foldable(problem)
    first = np.r_[nodes.first[node], nodes.first[-1]]
    return windows(nodes.t[node], first, folds[nodes.kind], _longest(problem, folds))


def _longest(problem: Problem, folds: BoolArray) -> float:
    """Seconds within which the gyro's noise is little beside that of the readings."""
    imu, nodes = problem.recording.imu, problem.nodes
    some = replace(
        imu, t=imu.t[:ENOUGH], gyro=imu.gyro[:ENOUGH], accel=imu.accel[:ENOUGH],
        valid=imu.valid[:ENOUGH],
    )  # fmt: skip
    noise = white_levels(replace(problem.recording, imu=some))["gyro_noise"]
    out = WALKING_S if problem.walks else WINDOW_S
    for k in np.flatnonzero(folds):
        o, mine = problem.observations[k], np.flatnonzero(nodes.kind == k)
        levels = {lv.name: lv.initial for lv in o.levels}
        levels |= o.guess(nodes.z[mine[:ENOUGH]]) if o.guess is not None else {}
        rate = len(mine) / (nodes.t[-1] - nodes.t[0])
        # (of T seconds the noise is T times its density squared, of their readings' mean R / n)
        out = min(out, float(np.sqrt(NEGLECTED * o.variance(levels).min() / rate)) / noise)
    return max(out, SHORTEST_S)


def reduced(about: About) -> Reduction:
    """What the reduced filter needs, ``folded`` where that is worth the while; of a long recording
    made piece by piece, ``gathered``, and then nothing is kept of what was linearised."""
    problem, nominal = about.problem, about.trajectory
    held: Reduction | None = about.__dict__.get("_reduced")
    if held is not None:
        return held
    if not is_long(problem, nominal):
        return reduce(about.linear)
    return _reduced(corrected_about(problem, nominal), about.start, nominal)


def known_reduced(about: About) -> About:
    """The same, of a long recording with what it is reduced to, for whoever asks several times."""
    return holding(about, reduced(about)) if is_long(about.problem, about.trajectory) else about


def holding(about: About, reduction: Reduction) -> About:
    """The same with what it is known to be reduced to."""
    out = about.bare
    out.__dict__["_reduced"] = reduction
    return out


def released(about: About) -> Reduction:
    """``reduced``, not kept here, nor what it was linearised to: both are large."""
    if is_long(about.problem, about.trajectory):
        out = reduced(about)
        about.__dict__.pop("_reduced", None)
        return out
    return reduce(about.released())


def corrected_about(problem: Problem, nominal: Trajectory) -> Problem:
    """The problem as it is linearised about the nominal trajectory."""
    problem, done, C_nb = prepared(problem, nominal)
    if done is not None:
        d = np.zeros((len(nominal.node), 9))
        for a, b in _spans(len(d)):
            sub = between(problem, int(nominal.node[a]), int(nominal.node[b]))
            d[a + 1 : b + 1] = transitions(sub, _some(nominal, a, b), False)[1][1:]
        problem = differentiated(done, *unexciting(problem, nominal, d, C_nb))
    return believing(problem, nominal.constants)


def _spans(epochs: int) -> Iterator[tuple[int, int]]:
    """First and last epoch of each piece; the last is the first of the next."""
    last = epochs - 1
    return ((a, min(a + PIECE, last)) for a in range(0, last, PIECE))


def _reduced(problem: Problem, start: Start, nominal: Trajectory) -> Reduction:
    """``reduced`` of a long recording; problem: ``corrected_about``."""
    returned()
    begin, t = starts(problem, nominal), problem.nodes.t[nominal.node]
    linear, scalars, extra, scatter = _gathered(problem, start, nominal, begin)
    nothing, nobody = np.zeros((0, 9, linear.Phi.shape[2])), np.zeros(0, dtype=np.int64)
    of: IntArray = np.searchsorted(begin, np.arange(len(t)), side="right").astype(np.int64) - 1
    folded = Folded(
        linear, begin, of, nothing, np.zeros((0, 9)), extra, scatter, nominal.markov, nobody,
        np.zeros((0, 2)),
    )  # fmt: skip
    return reduced_of(linear, scalars, folded, t)


def _gathered(
    problem: Problem, start: Start, nominal: Trajectory, begin: IntArray
) -> tuple[Linear, Scalars, Array, Array]:
    """The windows that begin at the epochs ``begin`` (K,), as ``gathered`` has them, without their
    rows, and these as scalars."""
    k, K = len(nominal.node), len(begin)
    rate, q = turning(problem, nominal.node), np.zeros(0, dtype=np.int64)
    gaps = np.zeros((K, 9, 9)) if problem.nodes.extra.any() else np.broadcast_to(0.0, (K, 9, 9))
    Q = np.zeros((2, K, 9, 9))
    linear = Linear(
        problem, at_epochs(nominal, begin), start, np.zeros((K, 9, BASE + problem.imu_constants)),
        np.zeros((K, 9)), Q[0], Q[1], gaps, problem.nodes.t[nominal.node[begin]], rate[begin],
        np.zeros(K + 1, dtype=np.int64), q, np.zeros((0, 1)), np.zeros((0, 1, problem.size)),
        np.zeros(0, dtype=np.bool_),
    )  # fmt: skip
    scale = units(linear)
    first = np.unique(np.searchsorted(begin, np.arange(0, k, PIECE)))
    spans = list(pairwise([*first[first < K - 1].tolist(), K]))

    def made(u: int, v: int) -> tuple[Linear, Scalars, Array, Array]:
        a, b = int(begin[u]), k - 1 if v == K else int(begin[v])
        part = _piece(problem, start, nominal, rate, a, b)
        own, extra, scatter = gathered(part, begin[u : v + 1] - a, v == K)
        return own, scalars_of(own, scale), extra, scatter

    rows, size = [], len(problem.observations) * MAX_DIM
    extra, scatter = np.zeros(size), np.zeros(size)
    found = in_threads(partial(made, *span) for span in spans)
    for (u, v), (part, scalars, more, left) in zip(spans, found, strict=True):
        to = slice(u + 1, v + 1)  # (what leads to a piece's first window is made with those before)
        linear.Phi[to], linear.d[to] = part.Phi[1:], part.d[1:]
        linear.Q_gyro[to], linear.Q_accel[to] = part.Q_gyro[1:], part.Q_accel[1:]
        if gaps.flags.writeable:
            gaps[to] = part.Q_extra[1:]
        rows.append((np.diff(scalars.first)[: v - u], *scalars[1:]))
        extra += more
        scatter += left
    count, g, h, slot = (np.concatenate(x) for x in zip(*rows, strict=True))
    return linear, Scalars(np.r_[0, np.cumsum(count)], g, h, slot), extra, scatter


def _piece(
    problem: Problem, start: Start, nominal: Trajectory, rate: Array, a: int, b: int
) -> Linear:
    """The epochs from a to b, linearised; rate (k,): of turning, at all epochs, rad/s."""
    sub = between(problem, int(nominal.node[a]), int(nominal.node[b]))
    part, slopes = _some(nominal, a, b), sub.slopes
    Phi, d, Q, W = transitions(sub, part, slopes is not None)
    if slopes is not None:
        responses(W, slopes.values, slopes.channel, slopes.column, part.node, Phi[:, :, BASE:])
    turn_noise(Phi, d)
    return replace(observed(sub, start, part, (Phi, d, (Q[0], Q[1], Q[2]))), rate=rate[a : b + 1])


def _some(nominal: Trajectory, a: int, b: int) -> Trajectory:
    """The trajectory from epoch a to b, its nodes counted from that of a."""
    s, node = slice(a, b + 1), nominal.node
    return replace(
        nominal, node=node[s] - node[a], p=nominal.p[s], v=nominal.v[s], C=nominal.C[s],
        markov=nominal.markov[s],
    )  # fmt: skip


def each(problem: Problem, start: Start, nominal: Trajectory) -> Iterator[tuple[int, Linear]]:
    """The epochs of a long recording linearised, a piece at a time, with the number of its first:
    that is the last of the piece before, which has its readings. problem: ``corrected_about``."""
    rate = turning(problem, nominal.node)
    for a, b in _spans(len(nominal.node)):
        yield a, _piece(problem, start, nominal, rate, a, b)


def filled(problem: Problem, old: Trajectory, there: Trajectory, of: IntArray) -> Trajectory:
    """The trajectory at all epochs of ``old``, from where it is at the beginnings of windows,
    ``there``; of (k,): whose window each epoch is in. Within a window it is as the readings tell,
    and what that lacks at its end came in on the way. problem: corrected, as of a reduction."""
    begin = np.flatnonzero(np.diff(of, prepend=-1))
    k, K = len(of), len(begin)
    p, v, C = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3, 3))
    # (to the end of the last window nothing is known but what leads there from its beginning)
    turn = old.C[-1] @ old.C[begin[-1]].T
    ends = replace(
        there, node=np.r_[there.node, old.node[-1]],
        p=np.vstack([there.p, there.p[-1:] + old.p[-1] - old.p[begin[-1]]]),
        v=np.vstack([there.v, there.v[-1:] + old.v[-1] - old.v[begin[-1]]]),
        C=np.concatenate([there.C, (turn @ there.C[-1])[None]]),
        markov=np.vstack([there.markov, there.markov[-1:]]),
    )  # fmt: skip
    step = max(1, PIECE * K // k)
    for u in range(0, K, step):
        w = min(u + step, K)
        a, b = begin[u], k - 1 if w == K else begin[w]
        first, last = int(old.node[a]), int(old.node[b])
        way = path(between(problem, first, last), _some(ends, u, w))
        at = old.node[a : b + 1] - first
        p[a : b + 1], v[a : b + 1], C[a : b + 1] = way.p[at], way.v[at], way.C[at]
    t = problem.nodes.t[old.node]
    after = np.r_[t[begin[1:]], max(t[-1], t[begin[-1]] + 1e-9)]
    share = ((t - t[begin[of]]) / (after - t[begin])[of])[:, None]
    ahead = np.vstack([np.diff(there.markov, axis=0), np.zeros((1, there.markov.shape[1]))])
    markov = there.markov[of] + share * ahead[of]
    return replace(there, node=old.node, p=p, v=v, C=C, markov=markov)

"""Sensitivity columns of absent constants, added to one pass of the filter.

Linearised about a trajectory, the gains of a pass do not depend on further constants that are zero
there. Each such constant is one more column of innovations, without another pass. The response of
the state at the end of each window, and of the observations within it, to errors of the readings
is computed once. A column is then a sum over the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from handcal.compiled import columns_kernel as kernel
from handcal.compiled.rows import blank, padded
from handcal.compiled.sparse import no_entries
from handcal.effects import Effect
from handcal.estimate.evidence import TOGETHER, ReducedPass, Reduction, reduce, reduced_pass
from handcal.estimate.linear import Excited, Linear, excited, slopes_of
from handcal.estimate.problem import Problem, slots_of
from handcal.estimate.seen import seen_over_time
from handcal.estimate.trajectory import biases
from handcal.types import Array, IntArray

T = TypeVar("T")
# Constants times nodes whose slopes are computed together (some 100 MB).
SLOPES = 5e6


@dataclass(frozen=True)
class Ground:
    """A linearised problem, one pass of the filter over it, and the responses for further columns.

    windows: first and last node of each window (K,), and where its rows of ``weights[1]`` begin;
    weights, scalars: see ``columns_kernel``; rows: first of the scalars of each reading (q, 2),
    -1 for none, and its shares in them (q, 2); by_reading (q, m, 6): derivatives of the
    observations by rate and force.
    """

    linear: Linear
    done: ReducedPass
    excited: Excited
    windows: tuple[IntArray, IntArray, IntArray]
    weights: tuple[Array, Array]
    scalars: tuple[IntArray, IntArray]
    rows: tuple[IntArray, Array]
    by_reading: Array


def ground(linear: Linear, fresh: Problem, levels: Mapping[str, float]) -> Ground:
    """The common start of scans about a linearised problem; fresh: the same problem before
    linearisation."""
    done = reduced_pass(reduce(linear), levels)
    told = excited(linear, fresh)
    reduction, nominal = done.reduction, linear.trajectory
    start = np.arange(len(linear.t)) if reduction.folded is None else reduction.folded.start
    rows = _rows(done)
    seen, far, scalars = _looks(linear, done, start, rows)
    node = nominal.node
    ends = np.r_[node[start[1:]], node[-1]]
    length = ends - node[start]
    size = length * np.diff(far)
    begin = np.r_[0, np.cumsum(size)[:-1]]
    v = reduction.navigation
    weights = np.zeros((len(told.W), v, 6)), np.zeros((int(size.sum()), 6))
    if v > 0:
        kernel.carried(linear.Phi, told.W, node, start, seen, (far, begin), weights)
    windows = node[start], ends, begin
    return Ground(linear, done, told, windows, weights, (far, scalars), rows, told.by_reading)


def _rows(done: ReducedPass) -> tuple[IntArray, Array]:
    """First of the scalars of each reading (q, 2), -1 for none, and its shares in them (q, 2)."""
    reduction = done.reduction
    linear, folded = reduction.linear, reduction.folded
    dim = linear.problem.tables.dim[linear.kind] * linear.used
    scalar = np.where(dim > 0, np.cumsum(dim) - dim, -1)
    if folded is None:
        first = np.stack([scalar, np.full(len(scalar), -1)], axis=1)
        return first, np.tile([1.0, 0.0], (len(scalar), 1))
    further = np.r_[scalar, -1]
    both = folded.share[:, 1] != 0.0
    at = np.stack([folded.row, np.where(both, folded.row + 1, -1)], axis=1)
    return further[at], folded.share


def _looks(
    linear: Linear, done: ReducedPass, start: IntArray, rows: tuple[IntArray, Array]
) -> tuple[tuple[IntArray, IntArray, Array], IntArray, IntArray]:
    """Observations of the state within windows, not at their starts.

    By epoch: the first of its observations (k + 1,); of each observation its scalar within the
    window, and h (9,). By window: the first of its scalars (K + 1,). Last, all these scalars.
    """
    k, count = len(linear.t), len(start)
    at = np.repeat(np.arange(k), np.diff(linear.first))
    of = np.searchsorted(start, np.arange(k), side="right") - 1
    dim = linear.problem.tables.dim[linear.kind]
    far = (at != start[of[at]])[:, None] & (rows[0] >= 0)
    far3 = far[:, :, None] & (np.arange(linear.H.shape[1]) < dim[:, None])[:, None]
    q, part, channel = np.nonzero(far3)
    scalar = rows[0][q, part] + channel
    h = rows[1][q, part, None] * linear.H[q, channel, :9]
    scalars = np.unique(scalar)
    window = np.searchsorted(done.reduction.first, scalars, side="right") - 1
    first = np.searchsorted(window, np.arange(count + 1))
    which = np.searchsorted(scalars, scalar) - first[of[at[q]]]
    by_epoch = np.searchsorted(at[q], np.arange(k + 1))
    return (by_epoch, which, h), first, scalars


@dataclass(frozen=True)
class Wider:
    """A pass with the constants of further effects appended (see ``ReducedPass``).

    own, further: innovation columns (s, c) of its own constants and of the further ones.
    """

    reduction: Reduction
    own: Array
    further: Array
    S: Array
    log_likelihood: tuple[float, Array, Array]

    @property
    def nu(self) -> Array:
        """All innovation columns, own ones first."""
        return np.hstack([self.own, self.further])


def widened(about: Ground, effects: Sequence[Effect], seen: Problem | None = None) -> Wider:
    """The pass with columns for the constants of absent effects, none of them noise.

    seen: a problem of those effects alone that act on observations; None if there are none.
    """
    done = about.done
    slots = slots_of(effects)
    scale = np.array([s.prior_sigma for s in slots])
    D, g = _driven(about, effects, [(s.owner, s.name) for s in slots], seen)
    nu, work = np.empty((len(done.S), len(slots))), _work(done, len(slots))
    kernel.followed(done.arrays, done.gain, (D, g, scale), nu, work, (0, len(done.arrays.A)))
    return Wider(_with(done.reduction, effects), done.nu, nu, done.S, _likelihood(done, nu))


def _work(done: ReducedPass, columns: int) -> kernel.FollowedWork:
    m, width = done.gain.shape[1], padded(columns)
    return kernel.FollowedWork(
        no_entries(m, TOGETHER), blank(m, width), blank(m, width), blank(TOGETHER, width),
        blank(m, TOGETHER),
    )  # fmt: skip


def _with(reduction: Reduction, effects: Sequence[Effect]) -> Reduction:
    """The reduction with the constants of absent effects appended."""
    slots, linear = slots_of(effects), reduction.linear
    problem = replace(
        linear.problem,
        slots=(*linear.problem.slots, *slots),
        effects=(*linear.problem.effects, *effects),
    )
    return replace(
        reduction,
        linear=replace(linear, problem=problem),
        scale=np.r_[reduction.scale, [s.prior_sigma for s in slots]],
        w0=np.r_[reduction.w0, np.zeros(len(slots))],
    )


@dataclass(frozen=True)
class Spread:
    """A pass with constants in windows; log_likelihood: a, b, G."""

    reduction: Reduction
    log_likelihood: tuple[float, Array, Array]


def spread(
    about: Ground,
    pattern: Sequence[Effect],
    effects: Sequence[Effect],
    window: IntArray,
    beside: Wider | None = None,
) -> Spread:
    """The pass with columns for constants that differ from window to window.

    pattern: effects that define the action of c constants. window (K,): the window of each epoch,
    ascending; effects: those constants in every window, one constant after the other. beside: the
    same pass with other further constants.

    After its window a column is only an error of the state, of m numbers, and what any later
    window makes of these is known from one backward recursion of their information (m, m). So
    n columns take n^2 m products, however many observations follow.
    """
    passed = about.done if beside is None else beside
    a0, b0, G0 = passed.log_likelihood
    nu, ends, at = _within(about, pattern, window)
    # (a diverged pass may have negative variances; its sums mean nothing)
    sigma = np.sqrt(np.abs(about.done.S))[:, None]
    nu, there = nu / sigma, passed.nu / sigma
    m, count = about.done.gain.shape[1], len(ends)
    channels, known = nu.shape[1] - m, len(b0)
    information, right = np.zeros((m, m)), np.zeros((m, there.shape[1]))
    looks, mixed = [], np.zeros((count, channels, 1 + known))
    for w in reversed(range(count)):
        own, end = nu[at[w] : at[w + 1]], ends[w]
        gram = own.T @ own + end.T @ information @ end
        sums = own.T @ there[at[w] : at[w + 1]] + end.T @ right
        information, right, mixed[w] = gram[:m, :m], sums[:m], sums[m:]
        looks.append(gram[:, m:])
    by_channel = mixed.transpose(1, 0, 2).reshape(-1, 1 + known)
    whole = np.empty((known + len(by_channel), known + len(by_channel)))
    whole[:known, :known] = G0
    whole[known:, :known], whole[:known, known:] = by_channel[:, 1:], by_channel[:, 1:].T
    _fill(whole[known:, known:], looks[::-1], ends)
    return Spread(_with(passed.reduction, effects), (a0, np.r_[b0, -by_channel[:, 0]], whole))


def _within(
    about: Ground, pattern: Sequence[Effect], window: IntArray
) -> tuple[Array, list[Array], IntArray]:
    """What an error of each of the m numbers of the state at the start of a window, and each of
    the c constants in it, does: innovations in the window (s, m + c), the state at the start of the
    next one (m, m + c), and the first scalar of each window."""
    done, slots = about.done, slots_of(pattern)
    D, g = _driven(about, pattern, [(s.owner, s.name) for s in slots], None)
    m = done.gain.shape[1]
    D, g = (np.concatenate([np.zeros((*x.shape[:-1], m)), x], axis=-1) for x in (D, g))
    scale = np.r_[np.ones(m), [s.prior_sigma for s in slots]]
    start = np.searchsorted(window, np.arange(window[-1] + 2))
    nu, ends, work = np.empty_like(g), [], _work(done, len(scale))
    at = done.reduction.first[start]
    for a, b, s in zip(start, start[1:], map(slice, at, at[1:]), strict=False):
        work.X[:] = np.eye(*work.X.shape)
        driven = D[a : b + 1], g[s], scale
        kernel.followed(done.arrays, done.gain, driven, nu[s], work, (int(a), int(b)))
        ends.append(work.X[:, : len(scale)].copy())
    return nu, ends, at


def _fill(gram: Array, looks: Sequence[Array], ends: Sequence[Array]) -> None:
    """Write the products of all columns of windows, gram (n, n). looks: of each window the
    products of its constants with the state at its start, and with each other, (m + c, c); ends: of
    ``_within``."""
    m, channels, count = len(ends[0]), looks[0].shape[1], len(ends)
    X = np.zeros((m, channels, count))
    for w, (look, end) in enumerate(zip(looks, ends, strict=True)):
        rows = w + count * np.arange(channels)
        older = (rows[:, None] - np.arange(w, 0, -1)).ravel()
        before = X[:, :, :w].reshape(m, -1)
        block = look[:m].T @ before
        gram[np.ix_(rows, older)], gram[np.ix_(older, rows)] = block, block.T
        gram[np.ix_(rows, rows)] = look[m:]
        X[:, :, :w] = (end[:, :m] @ before).reshape(m, channels, w)
        X[:, :, w] = end[:, m:]


def _likelihood(done: ReducedPass, nu: Array) -> tuple[float, Array, Array]:
    """a, b, G with the columns of further constants, nu (s, c)."""
    a, b, G = done.log_likelihood
    known, c, first = len(b), nu.shape[1], padded(1 + len(b))
    size = first + padded(c)
    gram = blank(size, size)
    kernel.products(done.nu, nu, done.S, first, blank(TOGETHER, size), gram)
    mixed, own = gram[first : first + c, : 1 + known], gram[first : first + c, first : first + c]
    whole = np.zeros((known + c, known + c))
    whole[:known, :known] = G
    whole[:known, known:] = mixed[:, 1:].T
    whole[known:, :known] = mixed[:, 1:]
    whole[known:, known:] = np.tril(own) + np.tril(own, -1).T
    return a, np.r_[b, -mixed[:, 0]], whole


def in_groups(all_: Iterable[T], size: Callable[[T], int], most: float) -> Iterator[list[T]]:
    """Consecutive groups, each of a total size of ``most`` or less, or of one item."""
    group: list[T] = []
    sizes = 0
    for x in all_:
        if group and sizes + size(x) > most:
            yield group
            group, sizes = [], 0
        group.append(x)
        sizes += size(x)
    if group:
        yield group


def columns_of(effect: Effect) -> int:
    """The number of an effect's columns."""
    return len(effect.parameters)


def _driven(
    about: Ground, effects: Sequence[Effect], names: list[tuple[str, str]], seen: Problem | None
) -> tuple[Array, Array]:
    """D (K, v, c) and g (s, c) of further effects' constants: their additions to the state at the
    ends of windows, and to the observations. Effects that act on the readings come first."""
    done, told, c = about.done, about.excited, len(names)
    nominal = about.linear.trajectory
    D = np.zeros((len(done.arrays.A), done.reduction.navigation, c))
    g = np.zeros((len(done.S), c))
    _excite(about, effects, (D, g))
    _see_past(about, effects, names, g)
    if seen is not None:
        at = {name: i for i, name in enumerate(names)}
        own = {e.id for e in effects}
        place = np.array([at[s.owner, s.name] for s in seen.slots if s.owner in own])
        tables = seen.tables
        mine = np.where(tables.start < len(place), tables.counts, 0)
        looked = np.zeros_like(g)
        kernel.seen_by_readings(
            about.linear.problem.nodes,
            tables._replace(counts=mine),
            (nominal.node, nominal.p, nominal.v, nominal.C, *biases(about.linear.problem, nominal)),
            len(tables.step),
            about.rows,
            place,
            about.linear.used,
            about.linear.H,
            (about.linear.problem.tables, np.r_[nominal.constants, nominal.markov[0]]),
            looked,
        )
        g += (
            looked if told.measure is None else _measured(told.measure, about.rows[0][:, 0], looked)
        )
    return D, g


def _excite(about: Ground, effects: Sequence[Effect], out: tuple[Array, Array]) -> None:
    """Add the effects that act on IMU readings to D (K, v, c), and subtract them from g (s, c)."""
    node = np.zeros(0, dtype=np.int64)
    if len(about.by_reading):
        first = about.linear.problem.nodes.first
        node = np.searchsorted(first, np.arange(first[-1]), side="right") - 1
    begin = 0
    acting = [e for e in effects if e.imu_error is not None]
    for some in in_groups(acting, columns_of, SLOPES / len(about.linear.problem.nodes.t)):
        slopes = slopes_of(about.excited, some, effects)
        column = slopes.column + begin
        if about.done.reduction.navigation > 0:
            kernel.responses(
                slopes.values, slopes.channel, column, about.windows, about.weights,
                about.scalars, out,
            )  # fmt: skip
        if len(about.by_reading):
            kernel.seen_at_once(
                slopes.values, slopes.channel, column, node, about.by_reading, about.rows, out[1]
            )
        begin += sum(map(columns_of, some))


def _see_past(
    about: Ground, effects: Sequence[Effect], names: list[tuple[str, str]], g: Array
) -> None:
    """Subtract effects with observation columns of their own (``Effect.seen``) from g (s, c)."""
    linear, (first, share) = about.linear, about.rows
    for e, mine, columns in seen_over_time(linear.problem, linear.trajectory, effects):
        at = [i for i, (owner, _) in enumerate(names) if owner == e.id]
        for part in range(2):
            there = linear.used[mine] & (first[mine, part] >= 0)
            rows = first[mine[there], part]
            np.subtract.at(g, (rows[:, None], at), share[mine[there], part, None] * columns[there])


def _measured(measure: Array, first: IntArray, g: Array) -> Array:
    """g (s, c) multiplied by the weights ``measure`` (q, m, m) of the residuals.

    first (q,): first scalar of each reading, -1 for none.
    """
    used = np.flatnonzero(first >= 0)
    at = first[used, None] + np.arange(measure.shape[1])
    out = g.copy()
    out[at] = measure[used] @ g[at]
    return out

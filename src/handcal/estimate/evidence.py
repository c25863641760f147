"""The evidence of a linearised problem.

Biases and constants never move, so the filter runs over the moving states alone, for all
values of the constants at once: that is several times faster than the whole filter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from handcal.compiled.covariance import scalar_work
from handcal.compiled.kernel import MAX_DIM
from handcal.compiled.reduced_kernel import ForwardWork, Reduced, reduced_forward, reduced_means
from handcal.compiled.rows import blank, padded
from handcal.compiled.sparse import no_entries
from handcal.estimate.driven import driven
from handcal.estimate.filter import full_prior
from handcal.estimate.folded import Folded, fold
from handcal.estimate.linear import Linear
from handcal.estimate.problem import observation_variances
from handcal.types import Array, IntArray

# Innovations whose squares are added up at once: their rows stay in the processor's own memory.
TOGETHER = 64
# Rows that are split up at once, so that there is no second copy of all.
AT_ONCE = 2048


@dataclass(frozen=True)
class Reduction:
    """What the reduced filter needs of a linearised problem, whatever the noise levels.

    Biases and constants never move, so the filter runs over the m = v + e moving states
    alone, once for all values w (nc,) of the constants' errors in units of their prior
    sigma ``scale``; w0 is their prior mean. v: 9 of the navigation, or 0 where nothing that is
    read depends on it. X0 (9 + e, 1 + nc), P15 (15, 15): the prior; D (k, v, 1 + nc): see
    ``Reduced``; slot (s,): kind and channel of each scalar, numbered through. folded: how the
    problem was folded, if it was; ``linear`` is what it became, without its H, which went into g
    and h; t (k,): the epochs before that, s.
    """

    linear: Linear
    scale: Array
    w0: Array
    X0: Array
    P15: Array
    D: Array
    first: IntArray
    g: Array
    h: Array
    at: IntArray
    count: IntArray
    slot: IntArray
    folded: Folded | None
    t: Array

    def scatter(self, variances: Array) -> float:
        """Log-density of how readings scatter within their windows, given the variances of each
        slot."""
        if self.folded is None:
            return 0.0
        f, seen = self.folded, self.folded.extra > 0.0
        R = variances.ravel()[seen]
        return -0.5 * float(f.extra[seen] @ np.log(2.0 * math.pi * R) + (f.scatter[seen] / R).sum())

    def scatter_slope(self, variances: Array) -> Array:
        """Derivative of ``scatter`` by the variance of each slot."""
        R = variances.ravel()
        if self.folded is None:
            return np.zeros(len(R))
        return np.asarray(0.5 * (self.folded.scatter / R - self.folded.extra) / R)

    @property
    def moving(self) -> IntArray:
        """Indices (m,) of the moving states in the full state."""
        n = self.linear.problem.size
        return np.asarray(np.r_[0 : self.navigation, n - self.linear.problem.markov_size : n])

    @property
    def begin(self) -> Array:
        """X0 (m, 1 + nc) of the moving states."""
        return self.X0[len(self.X0) - self.h.shape[1] :]

    @property
    def navigation(self) -> int:
        """How many of them are errors of the navigation: 9, or 0."""
        return int(self.D.shape[1])


def reduce(linear: Linear, folds: bool = True, whole: bool = False) -> Reduction:
    """Split a linearised problem into what moves and what is constant.

    folds: False to keep every epoch and every reading its own; whole: with the navigation, even
    where nothing that is read depends on it.
    """
    folded, t = fold(linear) if folds else None, linear.t
    linear = linear if folded is None else folded.linear
    v = 0 if linear.problem.compared and not whole else 9
    return reduced_of(linear, scalars_of(linear, units(linear), v), folded, t)


def reduced_of(linear: Linear, scalars: Scalars, folded: Folded | None, t: Array) -> Reduction:
    """The reduction of a problem of which this is read, ``folded`` from epochs at t (k,) s."""
    problem, nominal = linear.problem, linear.trajectory
    c, e = problem.constants, problem.markov_size
    mean15, P15 = linear.start.prior(
        nominal.p[0], nominal.v[0], nominal.C[0], nominal.bg, nominal.ba
    )
    scale = units(linear)
    w0 = np.r_[mean15[9:], problem.prior_mean - nominal.constants] / scale
    by_bias = P15[:9, 9:] / np.diag(P15)[9:]
    X0 = np.zeros((9 + e, 1 + 6 + c))
    X0[:9, 0] = mean15[:9] - by_bias @ mean15[9:]
    X0[:9, 1:7] = by_bias * scale[:6]
    X0[9:, 0] = -nominal.markov[0]
    v, width = scalars.h.shape[1] - e, linear.Phi.shape[2]
    D = np.zeros((len(linear.t), v, 1 + 6 + c))
    D[:, :, 0] = linear.d[:, :v]
    np.multiply(linear.Phi[:, :v, 9:], scale[: width - 9], out=D[:, :, 1 : width - 8])
    linear = replace(linear, H=np.zeros((0, *linear.H.shape[1:])))
    folded = None if folded is None else replace(folded, linear=linear)
    first, g, h, slot = scalars
    return Reduction(
        linear,
        scale,
        w0,
        X0,
        P15,
        D,
        first,
        g,
        h,
        np.argsort(h == 0.0, axis=1, kind="stable"),
        (h != 0.0).sum(axis=1),
        slot,
        folded,
        t,
    )


def units(linear: Linear) -> Array:
    """Prior sigmas (nc,) of biases and constants."""
    own = np.array([s.prior_sigma for s in linear.problem.slots], dtype=np.float64)
    return np.asarray(np.r_[linear.start.bias_sigma, own])


class Scalars(NamedTuple):
    """What is read, number by number: first (k + 1,) of each epoch, g (s, 1 + nc), h (s, m), slot
    (s,): see ``Reduction``."""

    first: IntArray
    g: Array
    h: Array
    slot: IntArray


def scalars_of(linear: Linear, scale: Array, v: int = 9) -> Scalars:
    """Of each scalar that is read its residual and slope by the constants in units of ``scale``
    (nc,), and its slope by what moves, v of it the navigation."""
    problem = linear.problem
    n, e = problem.size, problem.markov_size
    dim = problem.tables.dim[linear.kind] * linear.used
    row, channel = np.nonzero(np.arange(linear.H.shape[1]) < dim[:, None])
    h, g = np.empty((len(row), v + e)), np.empty((len(row), 1 + len(scale)))
    g[:, 0] = linear.r[row, channel]
    for some in (slice(i, i + AT_ONCE) for i in range(0, len(row), AT_ONCE)):
        H = linear.H[row[some], channel[some]]
        h[some, :v], h[some, v:] = H[:, :v], H[:, n - e :]
        np.multiply(H[:, 9 : n - e], -scale, out=g[some, 1:])
    first = np.searchsorted(row, linear.first).astype(np.int64)
    return Scalars(first, g, h, linear.kind[row] * MAX_DIM + channel)


class OfConstants(Protocol):
    """What a pass says of constants (see ``ReducedPass``)."""

    @property
    def reduction(self) -> Reduction: ...

    @property
    def log_likelihood(self) -> tuple[float, Array, Array]: ...


class Likelihood(OfConstants, Protocol):
    """The same with every innovation."""

    @property
    def nu(self) -> Array: ...

    @property
    def S(self) -> Array: ...


@dataclass(frozen=True)
class ReducedPass:
    """The reduced filter at certain noise levels, and the constants given everything.

    X (k, m, 1 + nc), P (k, m, m) after each epoch; gain (s, m), nu (s, 1 + nc), S (s,) of
    each scalar; w (nc,) and spread (nc, nc): posterior mean and a square root of the
    posterior covariance of the constants, in units of their priors; log_likelihood: a, b
    (nc,), G (nc, nc) of a + b'w - w'G w / 2.
    """

    reduction: Reduction
    arrays: Reduced
    X: Array
    P: Array
    gain: Array
    nu: Array
    S: Array
    w: Array
    spread: Array
    log_evidence: float
    log_likelihood: tuple[float, Array, Array]

    def innovations(self, w: Array) -> Array:
        """Of every scalar (s,), were the constants' errors w (nc,)."""
        return np.asarray(self.nu[:, 0] + self.nu[:, 1:] @ w)


def kept(count: int, rows: IntArray | None) -> IntArray:
    """Row (count,) in which each epoch is kept, -1 for nowhere: those of ``rows``, or all."""
    out: IntArray = np.arange(count, dtype=np.int64)
    if rows is not None:
        out[:] = -1
        out[rows] = np.arange(len(rows))
    return out


def reduced_pass(
    reduction: Reduction,
    levels: Mapping[str, float],
    keep: bool = False,
    rows: IntArray | None = None,
    wide: bool = True,
) -> ReducedPass:
    """Evidence at these noise levels, as that of ``forward`` but several times faster.

    keep: the states after every epoch, or after those of ``rows``; otherwise the last alone. wide:
    False to keep their covariances without the columns X, which are as large as all else together
    and which ``means`` does without (X is of the last alone).

    Source: the augmented filter of de Jong, The diffuse Kalman filter, Annals of
    Statistics 19 (1991), with proper priors. Of numbers that ran away (a variance that is not
    positive, information that is not) the log-evidence is minus infinity.
    """
    k, s, m = len(reduction.linear.t), *reduction.h.shape
    columns = reduction.X0.shape[1]
    arrays = _reduced_arrays(reduction, levels)
    last = np.array([k - 1], dtype=np.int64)
    place = kept(k, rows if keep and wide else last), kept(k, rows if keep else last)
    X, P = np.empty((_rows(place[0]), m, columns)), np.empty((_rows(place[1]), m, m))
    gain, nu, S = np.empty((s, m)), np.empty((s, columns)), np.empty(s)
    P0, X0 = blank(m, padded(m)), blank(m, padded(columns))
    P0[:, :m], X0[:, :columns] = _moving_prior(reduction, levels), reduction.begin
    gram = blank(padded(columns), padded(columns))
    work = _forward_work(m, padded(columns))
    reduced_forward(arrays, P0, X0, (X, P), (gain, nu, S), gram, work, place)
    told = _told(reduction, levels, S, gram[:columns, :columns])
    return ReducedPass(reduction, arrays, X, P, gain, nu, S, *told)


def _rows(place: IntArray) -> int:
    """How many epochs are kept."""
    return int(place.max()) + 1


def _forward_work(m: int, width: int) -> ForwardWork:
    high = padded(m)
    return ForwardWork(
        no_entries(m, TOGETHER), blank(m, width), blank(m, high), blank(m, high),
        scalar_work(high), blank(TOGETHER, width), blank(m, TOGETHER),
    )  # fmt: skip


def means(done: ReducedPass) -> Array:
    """States (k, m, 1) after each epoch of a pass, at its constants ``w``."""
    m, at = done.gain.shape[1], np.r_[1.0, done.w]
    out, x = np.empty((len(done.arrays.A), m, 1)), done.reduction.begin @ at
    moved = done.gain, done.innovations(done.w)
    reduced_means(done.arrays, x[:, None].copy(), done.arrays.D @ at, moved, no_entries(m), out)
    return out


def _moving_prior(reduction: Reduction, levels: Mapping[str, float]) -> Array:
    """Prior covariance (m, m) of the moving states, the constants known."""
    moving = reduction.moving
    full = full_prior(reduction.linear.problem, reduction.P15, dict(levels))
    P0 = full[np.ix_(moving, moving)]
    by_bias = reduction.X0[: reduction.navigation, 1:7]
    P0[: len(by_bias), : len(by_bias)] -= by_bias @ by_bias.T
    return P0


def _told(
    reduction: Reduction, levels: Mapping[str, float], S: Array, gram: Array
) -> tuple[Array, Array, float, tuple[float, Array, Array]]:
    """w, spread, log-evidence and log-likelihood (see ``ReducedPass``) from the products
    (1 + nc, 1 + nc) of all innovations."""
    count = len(gram) - 1
    w0, b = reduction.w0, reduction.w0 - gram[1:, 0]
    G = np.tril(gram[1:, 1:]) + np.tril(gram[1:, 1:], -1).T
    root = _root(G + np.eye(count)) if S.min(initial=math.inf) > 0.0 else None
    if root is None:
        none: Array = np.zeros((count, count))
        w: Array = np.zeros(count)
        return w, none, -math.inf, (-math.inf, w, none)
    spread: Array = np.linalg.inv(root).T.astype(np.float64, copy=False)
    w = spread @ (spread.T @ b)
    white = float(np.log(2.0 * math.pi * S).sum()) + float(gram[0, 0])
    white -= 2.0 * reduction.scatter(observation_variances(reduction.linear.problem, levels))
    value = -0.5 * (white + float(w0 @ w0 - b @ w)) - float(np.log(np.diag(root)).sum())
    return w, spread, value, (-0.5 * white, -gram[1:, 0], G)


def _root(information: Array) -> Array | None:
    """Cholesky's root (c, c) of the constants' information, None if there is none."""
    if not np.isfinite(information).all():
        return None
    try:
        return np.asarray(np.linalg.cholesky(information))
    except np.linalg.LinAlgError:
        return None


def _reduced_arrays(reduction: Reduction, levels: Mapping[str, float]) -> Reduced:
    linear, v = reduction.linear, reduction.navigation
    noise = driven(linear, levels, v)
    return Reduced(
        linear.Phi[:, :v],
        reduction.D,
        noise.Q,
        noise.B,
        noise.Phi_e,
        noise.Q_e,
        noise.d_e,
        noise.Phi_psi,
        reduction.first,
        reduction.g,
        reduction.h,
        reduction.at,
        reduction.count,
        observation_variances(linear.problem, levels).ravel()[reduction.slot],
    )

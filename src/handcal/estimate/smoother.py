"""The same filter about a fixed trajectory: forward, smoothed, moved, relinearised.

Nothing is fed back inside a pass: the error state is estimated as a whole, the trajectory
is moved by its smoothed value, and the pass is repeated until the evidence stops changing.
That is Gauss-Newton on the whole recording, with the evidence of a linear Gaussian model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handcal.compiled.covariance import (
    Propagation,
    Update,
    propagate,
    propagation_work,
    times_transition,
    update_linear,
    update_work,
)
from handcal.compiled.jit import copy1, copy2, njit
from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.compiled.rows import symmetrise
from handcal.compiled.so3 import exp, matmul
from handcal.estimate.adjoint import backward
from handcal.estimate.driven import driven
from handcal.estimate.evidence import (
    ReducedPass,
    Reduction,
    kept,
    means,
    reduce,
    reduced_pass,
)
from handcal.estimate.filter import full_prior
from handcal.estimate.folded import unfolded
from handcal.estimate.linear import About, Linear, linearise_about
from handcal.estimate.pieces import corrected_about, each, filled
from handcal.estimate.problem import observation_variances
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array, BoolArray, IntArray

# Epochs whose covariances are smoothed at once: what that takes besides them is small.
AT_ONCE = 256


@dataclass(frozen=True)
class Pass:
    """One forward pass: x (k, N) and P (k, N, N) after the observations of each epoch; of each
    observation innovation and sigma (q, MAX_DIM), nis (q,) and the log of its predictive
    density, loglik (q,)."""

    x: Array
    P: Array
    residual: Array
    sigma: Array
    nis: Array
    loglik: Array

    @property
    def log_evidence(self) -> float:
        return float(self.loglik.sum())


def forward(
    linear: Linear, levels: Mapping[str, float], keep: bool = True, rows: IntArray | None = None
) -> Pass:
    """Kalman filter over the linearised problem at these noise levels.

    keep: store every epoch's state, or those of ``rows`` (k',), for histories; otherwise only
    the last one.
    """
    k = len(linear.t)
    x, P = _prior(linear, levels)
    place = kept(k, rows if keep else np.array([k - 1], dtype=np.int64))
    out = _empty(int(place.max()) + 1, linear.problem.size, len(linear.kind))
    _passed(linear, levels, linear.used, (x, P), place, out)
    return out


def _empty(count: int, n: int, q: int) -> Pass:
    """A pass that keeps so many epochs of n states and q readings, before it has gone anywhere."""
    return Pass(
        np.zeros((count, n)), np.zeros((count, n, n)), np.zeros((q, MAX_DIM)),
        np.zeros((q, MAX_DIM)), np.full(q, np.nan), np.zeros(q),
    )  # fmt: skip


def _passed(
    linear: Linear,
    levels: Mapping[str, float],
    used: BoolArray,
    state: tuple[Array, Array],
    place: IntArray,
    out: Pass,
) -> None:
    """Filter on from ``state`` at the first epoch, which becomes that at the last; into ``out``."""
    problem = linear.problem
    noise = driven(linear, levels)
    _forward(
        (linear.Phi, linear.d, noise.Q, noise.B, noise.Phi_e, noise.Q_e, noise.d_e, noise.Phi_psi),
        (linear.first, linear.kind, linear.r, linear.H, used),
        problem.tables.dim,
        observation_variances(problem, levels),
        problem.constants,
        *state,
        (out.x, out.P),
        (out.residual, out.sigma, out.nis, out.loglik),
        propagation_work(problem.size, problem.markov_size),
        update_work(problem.size, MAX_DIM),
        place,
    )


def forward_by_pieces(
    about: About, levels: Mapping[str, float], rows: IntArray
) -> tuple[Pass, Linear]:
    """``forward`` of a long recording, piece by piece, kept at the epochs ``rows`` (k',); and its
    problem as it was linearised, without what is between the epochs and what readings see."""
    problem, nominal = corrected_about(about.problem, about.trajectory), about.trajectory
    nodes, node, n = problem.nodes, nominal.node, problem.size
    q, place = len(nodes.kind), kept(len(node), rows)
    out = _empty(len(rows), n, q)
    r, seen = np.zeros((q, int(problem.tables.dim.max(initial=1)))), np.zeros(q, dtype=np.bool_)
    state = np.zeros(n), np.zeros((n, n))
    for a, linear in each(problem, about.start, nominal):
        old = int(linear.first[1]) if a else 0
        used, there = linear.used.copy(), place[a : a + len(linear.t)].copy()
        if a:
            used[:old], there[0] = False, -1
        else:
            state = _prior(linear, levels)
        own = replace(_empty(0, n, len(used)), x=out.x, P=out.P)
        _passed(linear, levels, used, state, there, own)
        new = slice(int(nodes.first[node[a]]) + old, int(nodes.first[node[a]]) + len(used))
        for name in ("residual", "sigma", "nis", "loglik"):
            getattr(out, name)[new] = getattr(own, name)[old:]
        r[new], seen[new] = linear.r[old:], linear.used[old:]
    none = np.zeros((0, 9, 9))
    whole = Linear(
        problem, nominal, about.start, none, none[:, 0], none, none, none, nodes.t[node],
        np.zeros(0), np.r_[nodes.first[node], q], nodes.kind, r, np.zeros((0, 0, n)), seen,
    )  # fmt: skip
    return out, whole


def _prior(linear: Linear, levels: Mapping[str, float]) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of the errors before anything was observed."""
    problem, nominal = linear.problem, linear.trajectory
    mean15, P15 = linear.start.prior(
        nominal.p[0], nominal.v[0], nominal.C[0], nominal.bg, nominal.ba
    )
    x0 = np.r_[mean15, problem.prior_mean - nominal.constants, -nominal.markov[0]]
    return x0, full_prior(problem, P15, dict(levels))


@njit
def _forward(
    dynamics: tuple[Array, Array, Array, Array, Array, Array, Array, Array],
    rows: tuple[IntArray, IntArray, Array, Array, BoolArray],
    dim: IntArray,
    R: Array,
    c: int,
    x: Array,
    P: Array,
    store: tuple[Array, Array],
    out: tuple[Array, Array, Array, Array],
    work: Propagation,
    update: Update,
    place: IntArray,
) -> None:
    Phi, d, Q, B, Phi_e, Q_e, d_e, Phi_psi = dynamics
    first, kind, r, H, used = rows
    n = len(x)
    e = Phi_e.shape[1]
    e0 = BASE + c
    column, moved = np.empty((n, 1)), np.empty((n, 1))
    for j in range(Phi.shape[0]):
        if j > 0:
            for a in range(n):
                column[a, 0] = x[a]
            times_transition(Phi[j], B[j], Phi_e[j], Phi_psi[j], e0, column, moved)
            propagate(P, Phi[j], B[j], Phi_e[j], Phi_psi[j], e0, work)
            for a in range(9):
                x[a] = moved[a, 0] + d[j, a]
                for b in range(9):
                    P[a, b] += Q[j, a, b]
            for a in range(e):
                x[e0 + a] = moved[e0 + a, 0] + d_e[j, a]
                for b in range(e):
                    P[e0 + a, e0 + b] += Q_e[j, a, b]
        for q in range(first[j], first[j + 1]):
            if used[q]:
                update_linear(
                    r[q],
                    H[q],
                    dim[kind[q]],
                    R[kind[q]],
                    P,
                    x,
                    (out[0][q], out[1][q], out[2][q : q + 1], out[3][q : q + 1]),
                    update,
                )
        symmetrise(P)
        if place[j] >= 0:
            copy1(x, store[0][place[j]])
            copy2(P, store[1][place[j]])


def smoothed_mean(linear: Linear, levels: Mapping[str, float]) -> tuple[Array, float]:
    """Estimated errors x (k, N) given the whole recording, and the log-evidence."""
    done = reduced_pass(reduce(linear), levels, keep=True, wide=False)
    x = smoothed_of(done)
    folded = done.reduction.folded
    return x if folded is None else unfolded(folded, done.reduction.t, x), done.log_evidence


def smoothed_of(done: ReducedPass) -> Array:
    """Errors x (K, N) at the epochs of a pass that was kept, given the whole recording."""
    k, m = done.P.shape[:2]
    r = np.empty((k, m, 1))
    backward(done, False, r, np.empty((0, m, m)), spread=False)
    return _whole_mean(done, r, means(done))


def _whole_mean(done: ReducedPass, r: Array, before: Array) -> Array:
    """The same, with the pass's adjoint r and its own states ``before`` (k, m, 1) at w."""
    reduction = done.reduction
    x = np.empty((len(done.P), reduction.linear.problem.size))
    x[:, 9 : 9 + len(done.w)] = reduction.scale * done.w
    x[:, reduction.moving] = moving = (before + done.P @ r)[:, :, 0]
    if reduction.navigation == 0:
        x[:, :9] = _unseen_navigation(done, moving)
    return x


def _unseen_navigation(done: ReducedPass, markov: Array) -> Array:
    """Errors (k, 9) of the navigation where nothing depends on it: what the constants' errors and
    those of the Markov states (k, e) make of them."""
    linear, scale = done.reduction.linear, done.reduction.scale
    width = linear.Phi.shape[2] - 9
    step = linear.d + linear.Phi[:, :, 9:] @ (scale * done.w)[:width]
    for state, column in linear.problem.walks:
        by_bias = linear.Phi[1:, :, 9 + column : 12 + column]
        step[1:] += np.einsum("kij,kj->ki", by_bias, markov[:-1, state : state + 3])
    step[0] = done.reduction.X0[:9] @ np.r_[1.0, done.w]
    _added_up(linear.Phi, step)
    return step


@njit
def _added_up(Phi: Array, x: Array) -> None:
    """Steps x (k, 9) become what they add up to, each carried on by the next Phi (k, 9, .)."""
    for j in range(1, len(x)):
        for i in range(9):
            for c in range(9):
                x[j, i] += Phi[j, i, c] * x[j - 1, c]


def followed(done: ReducedPass, nominal: Trajectory, step: float = 1.0) -> Callable[[], Trajectory]:
    """Makes the nominal trajectory moved by that share of the errors that a pass, which was kept,
    finds given the whole recording; of a long one without the pass, which may be gone by then."""
    x, folded = smoothed_of(done), done.reduction.folded
    if folded is None:
        return partial(moved, nominal, step * x)
    if folded.by_pieces:
        there = moved(folded.linear.trajectory, step * x)
        return partial(filled, folded.linear.problem, nominal, there, folded.of)
    return partial(moved, nominal, step * unfolded(folded, done.reduction.t, x))


def smooth(
    linear: Linear, levels: Mapping[str, float], forward_pass: Pass, rows: IntArray | None = None
) -> tuple[Array, Array]:
    """Fixed-interval smoother: x (k, N) and P (k, N, N) given the whole recording; of all epochs,
    or of those of ``rows``, which end with the last, as in the forward pass.

    The form of Bryson and Frazier on the reduced filter: nothing is inverted but the
    constants' information, in units of their priors. The last epoch is the filter's own.
    """
    x, P = smooth_reduced(reduce(linear, folds=False, whole=True), levels, rows)
    x[-1], P[-1] = forward_pass.x[-1], forward_pass.P[-1]
    return x, P


def smooth_reduced(
    reduction: Reduction, levels: Mapping[str, float], rows: IntArray | None = None
) -> tuple[Array, Array]:
    """The same at the epochs of a reduction, or those of ``rows``, the last one as well."""
    done = reduced_pass(reduction, levels, keep=True, rows=rows)
    k, m, columns = done.X.shape
    r, N = np.empty((k, m, columns)), np.empty((k, m, m))
    backward(done, True, r, N, rows=rows)
    x = _whole_mean(done, r[:, :, :1], done.X @ np.r_[1.0, done.w][:, None])
    moving, scale = done.reduction.moving, done.reduction.scale
    fixed = np.arange(9, 9 + len(scale))
    spread = done.spread * scale[:, None]
    P = np.empty((k, x.shape[1], x.shape[1]))
    P[:, fixed[:, None], fixed] = spread @ spread.T
    for some in (slice(j, j + AT_ONCE) for j in range(0, k, AT_ONCE)):
        X, P_moving = done.X[some], done.P[some]
        by_constants = X[:, :, 1:] @ done.spread + P_moving @ r[some, :, 1:]
        mixed = by_constants @ spread.T
        P[some, moving[:, None], fixed] = mixed
        P[some, fixed[:, None], moving] = mixed.transpose(0, 2, 1)
        own = P_moving - P_moving @ N[some] @ P_moving
        own = own + by_constants @ by_constants.transpose(0, 2, 1)
        P[some, moving[:, None], moving] = 0.5 * (own + own.transpose(0, 2, 1))
    return x, P


@njit
def _turned(psi: Array, C: Array, out: Array) -> None:
    turn = np.empty((3, 3))
    for j in range(len(psi)):
        exp(psi[j], turn)
        matmul(turn, C[j], out[j])


def moved(nominal: Trajectory, x: Array) -> Trajectory:
    """The nominal trajectory moved by the estimated errors x (k, N)."""
    c = len(nominal.constants)
    last = x[-1]
    C = np.empty_like(nominal.C)
    _turned(np.ascontiguousarray(x[:, 6:9]), nominal.C, C)
    return replace(
        nominal,
        p=nominal.p + x[:, 0:3],
        v=nominal.v + x[:, 3:6],
        C=C,
        bg=nominal.bg + last[9:12],
        ba=nominal.ba + last[12:15],
        constants=nominal.constants + last[BASE : BASE + c],
        markov=nominal.markov + x[:, BASE + c :],
    )


def relinearise(
    linear: Linear, levels: Mapping[str, float], tolerance: float = 0.05, rounds: int = 8
) -> tuple[Linear, bool, float]:
    """Move the trajectory and linearise again until the evidence changes by < tolerance nats.

    Returns the last linearisation, whether it settled, and its log evidence.
    """
    x, evidence = smoothed_mean(linear, levels)
    settled = False
    for _ in range(rounds):
        problem, start, there = linear.problem, linear.start, moved(linear.trajectory, x)
        del linear  # (as large as all else together, and not needed beside the next)
        linear = linearise_about(problem, start, there)
        x, new = smoothed_mean(linear, levels)
        settled = abs(new - evidence) < tolerance
        evidence = new
        if settled:
            break
    return linear, settled, evidence

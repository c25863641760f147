"""The same filter about a fixed trajectory: relinearised evidence and smoothing.

Between two observation epochs the readings are integrated once into one transition
(preintegration), so a pass costs as many steps as there are epochs. Nothing is fed back
inside a pass: the error state is estimated as a whole, the trajectory is moved by its
smoothed value, and the pass is repeated until the evidence stops changing. That is
Gauss-Newton on the whole recording, with the evidence of a linear Gaussian model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from handcal._jit import njit
from handcal.filter import Track, full_prior, update_linear
from handcal.kernel import (
    BASE,
    MAX_DIM,
    Nodes,
    Reduced,
    Tables,
    corrected,
    fill_nav,
    interval,
    linearise,
    propagate,
    propagation_work,
    reduced_backward,
    reduced_forward,
    times_transition,
)
from handcal.model import Problem, markov_transitions, observation_variances, relinearised
from handcal.observations import NAV
from handcal.so3 import exp, matmul
from handcal.start import Start
from handcal.types import Array, BoolArray, IntArray


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


@dataclass(frozen=True)
class Linear:
    """A problem linearised about a trajectory; everything but the noise levels.

    Phi (k, 9, 15 + mi) from the epoch before, d (k, 9) predicted minus nominal, Q_gyro,
    Q_accel, Q_extra (k, 9, 9) per unit density; t, rate (k,); first (k + 1,) rows of each
    epoch; kind (q,), r (q, MAX_DIM), H (q, MAX_DIM, N), used (q,).
    """

    problem: Problem
    trajectory: Trajectory
    start: Start
    Phi: Array
    d: Array
    Q_gyro: Array
    Q_accel: Array
    Q_extra: Array
    t: Array
    rate: Array
    first: IntArray
    kind: IntArray
    r: Array
    H: Array
    used: BoolArray


@dataclass(frozen=True)
class Pass:
    """One forward pass: x (k, N) and P (k, N, N) after the observations of each epoch, the
    same before them; of each observation innovation and sigma (q, MAX_DIM), nis (q,) and
    the log of its predictive density, loglik (q,)."""

    x: Array
    P: Array
    x_before: Array
    P_before: Array
    residual: Array
    sigma: Array
    nis: Array
    loglik: Array

    @property
    def log_evidence(self) -> float:
        return float(self.loglik.sum())


def epochs(problem: Problem) -> IntArray:
    """Nodes at which something is observed, with the first and the last node."""
    seen = np.flatnonzero(np.diff(problem.nodes.first))
    return np.unique(np.r_[0, seen, len(problem.nodes.t) - 1])


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


def linearise_about(problem: Problem, start: Start, nominal: Trajectory) -> Linear:
    """Integrate between the epochs and linearise everything about the nominal trajectory."""
    problem = relinearised(problem, nominal.constants, nominal.bg, nominal.ba)
    Phi, d, Q = _transitions(problem, nominal)
    if problem.imu_constants:
        # What an effect does depends on the true rate and force: take off the noise that
        # this trajectory implies, or each sample's noise would pose as motion that excites it.
        noise = _implied_noise(problem, nominal, d)
        problem = relinearised(problem, nominal.constants, nominal.bg, nominal.ba, noise)
        Phi, d, Q = _transitions(problem, nominal)
    nodes = problem.nodes
    q = len(nodes.kind)
    r, H = np.zeros((q, MAX_DIM)), np.zeros((q, MAX_DIM, problem.size))
    used = np.zeros(q, dtype=np.bool_)
    _linearise_rows(
        nodes,
        problem.tables,
        nominal.node,
        (nominal.p, nominal.v, nominal.C, nominal.markov),
        (nominal.bg, nominal.ba, nominal.constants, problem.ref),
        (r, H, used),
    )
    for kind, observation in enumerate(problem.observations):
        if observation.isotropic:
            rows = (nodes.kind == kind) & ~nodes.z.any(axis=1)
            H[rows, :3, 6:9] -= _skews(r[rows, :3])
    node = nominal.node
    first = np.r_[nodes.first[node], nodes.first[-1]]
    return Linear(
        problem,
        nominal,
        start,
        Phi,
        d,
        Q[0],
        Q[1],
        Q[2],
        nodes.t[node],
        problem.rate[node],
        first,
        nodes.kind,
        r,
        H,
        used,
    )


def _transitions(problem: Problem, nominal: Trajectory) -> tuple[Array, Array, Array]:
    """Phi (k, 9, 15 + mi), d (k, 9) and the three Q (3, k, 9, 9) between the epochs."""
    k = len(nominal.node)
    Phi, d = np.zeros((k, 9, BASE + problem.imu_constants)), np.zeros((k, 9))
    Q = np.zeros((3, k, 9, 9))
    extras = np.r_[nominal.constants, np.zeros(problem.markov_size)]
    _preintegrate(
        problem.nodes,
        nominal.node,
        (nominal.p, nominal.v, nominal.C),
        (nominal.bg, nominal.ba, extras, problem.ref),
        problem.g_n,
        problem.omega_ie_n,
        (Phi, d, Q[0], Q[1], Q[2]),
    )
    _turn_noise(Phi, d)
    return Phi, d, Q


def _turn_noise(Phi: Array, d: Array) -> None:
    """Let an attitude error turn the noise that the trajectory implies, in Phi.

    Sensor noise lives in the body: what the measured rate and force differ from those of
    the nominal trajectory turns with the attitude and is no information about it. Taking
    it for a signal makes a heading observable that is not (in a z turn without a heading,
    sigma of the vertical gyro bias falls to a tenth).
    """
    turned = 0.5 * Phi[1:, 6:9]
    turned[:, :, 6:9] += 0.5 * np.eye(3)
    for i in (0, 3, 6):
        Phi[1:, i : i + 3] += _skews(d[1:, i : i + 3]) @ turned


def _skews(x: Array) -> Array:
    """Matrices [x cross] (k, 3, 3) of vectors (k, 3)."""
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return out - out.transpose(0, 2, 1)


def _implied_noise(problem: Problem, nominal: Trajectory, d: Array) -> Array:
    """Mean noise of gyro and accelerometer (n, 6) at the IMU's samples, interval by interval."""
    t = problem.nodes.t[nominal.node]
    dt = np.maximum(np.diff(t), 1e-6)[:, None]
    C_bn = nominal.C[1:].transpose(0, 2, 1)
    gyro = np.einsum("kij,kj->ki", C_bn, d[1:, 6:9]) / dt
    accel = np.einsum("kij,kj->ki", C_bn, d[1:, 3:6]) / dt
    at = np.clip(np.searchsorted(t, problem.recording.imu.t, side="right") - 1, 0, len(t) - 2)
    return np.hstack([gyro, accel])[at]


@njit
def _preintegrate(
    nodes: Nodes,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array],
    constants: tuple[Array, Array, Array, Array],
    g_n: Array,
    omega_ie_n: Array,
    out: tuple[Array, Array, Array, Array, Array],
) -> None:
    bg, ba, extras, ref = constants
    Phi_out, d_out, Qg_out, Qa_out, Q0_out = out
    mi = nodes.J.shape[2]
    width = BASE + mi
    Phi, J = np.empty((9, width)), np.empty((6, 6 + mi))
    none = np.empty((0, 0))
    total, new = np.zeros((width, width)), np.zeros((9, width))
    work = propagation_work(9, 0)
    Q = np.zeros((3, 9, 9))
    C = np.empty((3, 3))
    D = np.empty((3, 3))
    for j in range(1, len(epoch)):
        p, v = nominal[0][j - 1].copy(), nominal[1][j - 1].copy()
        C[:, :] = nominal[2][j - 1]
        total[:, :] = 0.0
        for a in range(width):
            total[a, a] = 1.0
        Q[:, :, :] = 0.0
        for i in range(epoch[j - 1] + 1, epoch[j] + 1):
            interval(nodes, i, bg, ba, extras, ref, g_n, omega_ie_n, p, v, C, Phi, J)
            times_transition(Phi, none, none, width, total, new)
            total[:9] = new
            dt = nodes.t[i] - nodes.t[i - 1]
            for s in range(3):
                if s < 2 or Q[s, 3, 3] != 0.0 or Q[s, 6, 6] != 0.0:
                    propagate(Q[s], Phi, none, none, 9, work)
            for a in range(3):
                Q[0, 6 + a, 6 + a] += dt
                Q[1, 3 + a, 3 + a] += dt
                Q[2, 6 + a, 6 + a] += nodes.extra[i, 0]
                Q[2, 3 + a, 3 + a] += nodes.extra[i, 1]
        Phi_out[j] = total[:9]
        Qg_out[j], Qa_out[j], Q0_out[j] = Q[0], Q[1], Q[2]
        for a in range(3):
            d_out[j, a] = p[a] - nominal[0][j, a]
            d_out[j, 3 + a] = v[a] - nominal[1][j, a]
            for b in range(3):
                D[a, b] = 0.0
                for c in range(3):
                    D[a, b] += C[a, c] * nominal[2][j, b, c]
        _small_log(D, d_out[j, 6:9])


@njit
def _small_log(D: Array, out: Array) -> None:
    """Rotation vector of a matrix not near half a turn."""
    x = 0.5 * (D[2, 1] - D[1, 2])
    y = 0.5 * (D[0, 2] - D[2, 0])
    z = 0.5 * (D[1, 0] - D[0, 1])
    s = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(s, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    k = 1.0 if s < 1e-9 else angle / s
    out[0], out[1], out[2] = k * x, k * y, k * z


@njit
def _linearise_rows(
    nodes: Nodes,
    tables: Tables,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array, Array],
    constants: tuple[Array, Array, Array, Array],
    out: tuple[Array, Array, BoolArray],
) -> None:
    bg, ba, constant, ref = constants
    extras = np.concatenate((constant, nominal[3][0]))
    nav, w, f = np.empty(NAV), np.empty(3), np.empty(3)
    for j in range(len(epoch)):
        i = epoch[j]
        extras[len(constant) :] = nominal[3][j]
        corrected(nodes.gyro[i], nodes.J[i], 0, bg, extras, ref, w)
        corrected(nodes.accel[i], nodes.J[i], 3, ba, extras, ref, f)
        fill_nav(nominal[0][j], nominal[1][j], nominal[2][j], w, f, nav)
        for q in range(nodes.first[i], nodes.first[i + 1]):
            out[2][q] = (
                linearise(
                    nodes.kind[q], tables, nav, extras, nodes.z[q], nodes.J[i], out[0][q], out[1][q]
                )
                == 0
            )


def forward(linear: Linear, levels: Mapping[str, float], keep: bool = True) -> Pass:
    """Kalman filter over the linearised problem at these noise levels.

    keep: store every epoch's state (needed for smoothing and histories); otherwise only
    the last one, which makes the search for noise levels cheap.
    """
    problem = linear.problem
    k, n, q = len(linear.t), problem.size, len(linear.kind)
    Phi_e, Q_e = markov_transitions(problem, levels, linear.t, linear.rate)
    d_e, Phi_psi = _markov_steps(problem, linear.trajectory.markov[:k], Phi_e)
    Q = _process_noise(linear, levels)
    nominal = linear.trajectory
    mean15, P15 = linear.start.prior(
        nominal.p[0], nominal.v[0], nominal.C[0], nominal.bg, nominal.ba
    )
    x0 = np.zeros(n)
    x0[:BASE] = mean15
    x0[BASE : BASE + problem.constants] = -nominal.constants
    x0[BASE + problem.constants :] = -nominal.markov[0]
    P0 = full_prior(problem, P15, dict(levels))
    rows = k if keep else 1
    out = Pass(
        np.zeros((rows, n)),
        np.zeros((rows, n, n)),
        np.zeros((rows, n)),
        np.zeros((rows, n, n)),
        np.zeros((q, MAX_DIM)),
        np.zeros((q, MAX_DIM)),
        np.full(q, np.nan),
        np.zeros(q),
    )
    _forward(
        (linear.Phi, linear.d, Q, Phi_e, Q_e, d_e, Phi_psi),
        (linear.first, linear.kind, linear.r, linear.H, linear.used),
        problem.tables.dim,
        observation_variances(problem, levels),
        problem.constants,
        x0,
        P0,
        (out.x, out.P, out.x_before, out.P_before),
        (out.residual, out.sigma, out.nis, out.loglik),
    )
    return out


def _markov_steps(problem: Problem, markov: Array, Phi_e: Array) -> tuple[Array, Array]:
    """Steps d_e (k, e) predicted minus nominal of the Markov states, and Phi_psi (k, e, 3).

    The noise that drives a vector such as the hand's sway has no preferred direction, so
    an error of attitude turns what the trajectory says of it: with it, a heading that
    nothing observes stays unobserved. (Without, the noise's own directions would seem to
    be known, and the heading with them.)
    """
    d_e = np.zeros_like(markov)
    d_e[1:] = np.einsum("kij,kj->ki", Phi_e[1:], markov[:-1]) - markov[1:]
    Phi_psi = np.zeros((*markov.shape, 3))
    at = 0
    for kind in problem.markov_kinds:
        kept = problem.observations[kind].markov
        assert kept is not None
        for i in range(at, at + 3 * kept.vectors, 3):
            Phi_psi[:, i : i + 3] = _skews(d_e[:, i : i + 3])
        at += kept.size
    return d_e, Phi_psi


@njit
def _forward(
    dynamics: tuple[Array, Array, Array, Array, Array, Array, Array],
    rows: tuple[IntArray, IntArray, Array, Array, BoolArray],
    dim: IntArray,
    R: Array,
    c: int,
    x: Array,
    P: Array,
    store: tuple[Array, Array, Array, Array],
    out: tuple[Array, Array, Array, Array],
) -> None:
    Phi, d, Q, Phi_e, Q_e, d_e, Phi_psi = dynamics
    first, kind, r, H, used = rows
    n = len(x)
    e = Phi_e.shape[1]
    keep = store[0].shape[0] > 1
    e0 = BASE + c
    work = propagation_work(n, e)
    column, moved = np.empty((n, 1)), np.empty((n, 1))
    for j in range(Phi.shape[0]):
        if j > 0:
            column[:, 0] = x
            times_transition(Phi[j], Phi_e[j], Phi_psi[j], e0, column, moved)
            propagate(P, Phi[j], Phi_e[j], Phi_psi[j], e0, work)
            for a in range(9):
                x[a] = moved[a, 0] + d[j, a]
                for b in range(9):
                    P[a, b] += Q[j, a, b]
            for a in range(e):
                x[e0 + a] = moved[e0 + a, 0] + d_e[j, a]
                for b in range(e):
                    P[e0 + a, e0 + b] += Q_e[j, a, b]
        if keep:
            store[2][j], store[3][j] = x, P
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
                )
        at = j if keep else 0
        store[0][at], store[1][at] = x, P


@dataclass(frozen=True)
class Reduction:
    """What the reduced filter needs of a linearised problem, whatever the noise levels.

    Biases and constants never move, so the filter runs over the m = 9 + e moving states
    alone, once for all values w (nc,) of the constants' errors in units of their prior
    sigma ``scale``; w0 is their prior mean. X0 (m, 1 + nc), P15 (15, 15): the prior;
    slot (s,): kind and channel of each scalar, numbered through.
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

    @property
    def moving(self) -> IntArray:
        """Indices (m,) of the moving states in the full state."""
        n = self.linear.problem.size
        return np.asarray(np.r_[0:9, n - self.linear.problem.markov_size : n])


def reduce(linear: Linear) -> Reduction:
    """Split a linearised problem into what moves and what is constant."""
    problem, nominal = linear.problem, linear.trajectory
    n, c, e = problem.size, problem.constants, problem.markov_size
    mean15, P15 = linear.start.prior(
        nominal.p[0], nominal.v[0], nominal.C[0], nominal.bg, nominal.ba
    )
    scale = np.sqrt(np.r_[np.diag(P15)[9:], [s.prior_sigma**2 for s in problem.slots]])
    w0 = np.r_[mean15[9:], -nominal.constants] / scale
    by_bias = P15[:9, 9:] / np.diag(P15)[9:]
    X0 = np.zeros((9 + e, 1 + 6 + c))
    X0[:9, 0] = mean15[:9] - by_bias @ mean15[9:]
    X0[:9, 1:7] = by_bias * scale[:6]
    X0[9:, 0] = -nominal.markov[0]
    width = linear.Phi.shape[2]
    D = np.zeros((len(linear.t), 9, 1 + 6 + c))
    D[:, :, 0] = linear.d
    D[:, :, 1 : width - 8] = linear.Phi[:, :, 9:] * scale[: width - 9]
    dim = problem.tables.dim[linear.kind] * linear.used
    row, channel = np.nonzero(np.arange(MAX_DIM) < dim[:, None])
    H = linear.H[row, channel]
    h = np.ascontiguousarray(H[:, np.r_[0:9, n - e : n]])
    return Reduction(
        linear,
        scale,
        w0,
        X0,
        P15,
        D,
        np.searchsorted(row, linear.first).astype(np.int64),
        np.hstack([linear.r[row, channel][:, None], -H[:, 9 : n - e] * scale]),
        h,
        np.argsort(h == 0.0, axis=1, kind="stable"),
        (h != 0.0).sum(axis=1),
        linear.kind[row] * MAX_DIM + channel,
    )


@dataclass(frozen=True)
class ReducedPass:
    """The reduced filter at certain noise levels, and the constants given everything.

    X (k, m, 1 + nc), P (k, m, m) after each epoch; gain (s, m), nu (s, 1 + nc), S (s,) of
    each scalar; w (nc,) and spread (nc, nc): posterior mean and a square root of the
    posterior covariance of the constants, in units of their priors.
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


def reduced_pass(
    reduction: Reduction, levels: Mapping[str, float], keep: bool = False
) -> ReducedPass:
    """Evidence at these noise levels, as that of ``forward`` but several times faster.

    Source: the augmented filter of de Jong, The diffuse Kalman filter, Annals of
    Statistics 19 (1991), with proper priors.
    """
    linear = reduction.linear
    problem, k, s = linear.problem, len(linear.t), len(reduction.h)
    m, columns = reduction.X0.shape
    arrays = _reduced_arrays(reduction, levels)
    rows = k if keep else 1
    X, P = np.empty((rows, m, columns)), np.empty((rows, m, m))
    gain, nu, S = np.empty((s, m)), np.empty((s, columns)), np.empty(s)
    moving = reduction.moving
    P0 = full_prior(problem, reduction.P15, dict(levels))[np.ix_(moving, moving)]
    by_bias = reduction.X0[:9, 1:7]
    P0[:9, :9] -= by_bias @ by_bias.T
    gram = np.zeros((columns, columns))
    reduced_forward(arrays, P0, reduction.X0.copy(), (X, P), (gain, nu, S), gram)
    w0, b = reduction.w0, reduction.w0 - gram[1:, 0]
    information = np.tril(gram[1:, 1:]) + np.tril(gram[1:, 1:], -1).T + np.eye(columns - 1)
    root = np.linalg.cholesky(information)
    spread = np.linalg.inv(root).T
    w = spread @ (spread.T @ b)
    white = float(np.log(2.0 * math.pi * S).sum()) + float(gram[0, 0])
    value = -0.5 * (white + float(w0 @ w0 - b @ w)) - float(np.log(np.diag(root)).sum())
    return ReducedPass(reduction, arrays, X, P, gain, nu, S, w, spread, value)


def _reduced_arrays(reduction: Reduction, levels: Mapping[str, float]) -> Reduced:
    linear = reduction.linear
    problem = linear.problem
    Phi_e, Q_e = markov_transitions(problem, levels, linear.t, linear.rate)
    d_e, Phi_psi = _markov_steps(problem, linear.trajectory.markov[: len(linear.t)], Phi_e)
    return Reduced(
        linear.Phi,
        reduction.D,
        _process_noise(linear, levels),
        Phi_e,
        Q_e,
        d_e,
        Phi_psi,
        reduction.first,
        reduction.g,
        reduction.h,
        reduction.at,
        reduction.count,
        observation_variances(problem, levels).ravel()[reduction.slot],
    )


def _process_noise(linear: Linear, levels: Mapping[str, float]) -> Array:
    """Q (k, 9, 9) of the navigation errors."""
    return np.asarray(
        levels["gyro_noise"] ** 2 * linear.Q_gyro
        + levels["accel_noise"] ** 2 * linear.Q_accel
        + linear.Q_extra
    )


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the log-evidence: by R (s,) of each scalar, by the two densities
    squared (2,), by Q_e (k, e, e), and by the prior of the moving states (m, m)."""

    R: Array
    densities: Array
    Q_e: Array
    prior: Array


def backward(
    done: ReducedPass, score: bool, r_kept: Array, N_kept: Array, spread: bool = True
) -> Slopes:
    """Adjoint of ``reduced_pass``; r_kept (k, m, columns), N_kept (k, m, m) may be empty.

    score: with the derivatives; spread: r has columns for the uncertainty of the constants,
    besides the one for their mean.
    """
    linear, (s, m) = done.reduction.linear, done.gain.shape
    e = m - 9
    columns = 1 + len(done.w) if spread else 1
    given = np.zeros((1 + len(done.w), columns))
    given[0, 0] = 1.0
    given[1:, 0] = done.w
    given[1:, 1:] = done.spread[:, : columns - 1]
    slopes = Slopes(np.zeros(s), np.zeros(2), np.zeros((len(linear.t), e, e)), np.zeros((m, m)))
    reduced_backward(
        done.arrays,
        done.gain,
        done.nu,
        done.S,
        given,
        (linear.Q_gyro, linear.Q_accel),
        np.zeros((m, columns)),
        np.zeros((m, m) if score else (0, 0)),
        (r_kept, N_kept),
        (slopes.R, slopes.densities, slopes.Q_e, slopes.prior),
    )
    return slopes


def smoothed_mean(linear: Linear, levels: Mapping[str, float]) -> tuple[Array, float]:
    """Estimated errors x (k, N) given the whole recording, and the log-evidence."""
    done = reduced_pass(reduce(linear), levels, keep=True)
    k, m = done.X.shape[:2]
    r = np.empty((k, m, 1))
    backward(done, False, r, np.empty((0, m, m)), spread=False)
    return _whole_mean(done, r), done.log_evidence


def _whole_mean(done: ReducedPass, r: Array) -> Array:
    reduction = done.reduction
    x = np.empty((len(done.X), reduction.linear.problem.size))
    x[:, 9 : 9 + len(done.w)] = reduction.scale * done.w
    x[:, reduction.moving] = done.X[:, :, 0] + done.X[:, :, 1:] @ done.w + (done.P @ r)[:, :, 0]
    return x


def smooth(linear: Linear, levels: Mapping[str, float], forward_pass: Pass) -> tuple[Array, Array]:
    """Fixed-interval smoother: x (k, N) and P (k, N, N) given the whole recording.

    The form of Bryson and Frazier on the reduced filter: nothing is inverted but the
    constants' information, in units of their priors. The last epoch is the filter's own.
    """
    done = reduced_pass(reduce(linear), levels, keep=True)
    k, m, columns = done.X.shape
    r, N = np.empty((k, m, columns)), np.empty((k, m, m))
    backward(done, True, r, N)
    x = _whole_mean(done, r[:, :, :1])
    moving, scale = done.reduction.moving, done.reduction.scale
    fixed = np.arange(9, 9 + len(scale))
    spread = done.spread * scale[:, None]
    by_constants = done.X[:, :, 1:] @ done.spread + done.P @ r[:, :, 1:]
    P = np.empty((k, x.shape[1], x.shape[1]))
    P[:, fixed[:, None], fixed] = spread @ spread.T
    P[:, moving[:, None], fixed] = by_constants @ spread.T
    P[:, fixed[:, None], moving] = P[:, moving[:, None], fixed].transpose(0, 2, 1)
    own = done.P - done.P @ N @ done.P + by_constants @ by_constants.transpose(0, 2, 1)
    P[:, moving[:, None], moving] = 0.5 * (own + own.transpose(0, 2, 1))
    x[-1], P[-1] = forward_pass.x[-1], forward_pass.P[-1]
    return x, P


@njit
def _turned(psi: Array, C: Array, out: Array) -> None:
    turn = np.empty((3, 3))
    for j in range(len(psi)):
        exp(psi[j], turn)
        matmul(turn, C[j], out[j])


def moved(linear: Linear, x: Array) -> Trajectory:
    """The nominal trajectory moved by the estimated errors x (k, N)."""
    nominal, c = linear.trajectory, linear.problem.constants
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
) -> tuple[Linear, Pass, bool]:
    """Move the trajectory and linearise again until the evidence changes by < tolerance nats.

    Returns the last linearisation, its forward pass and whether it settled.
    """
    x, evidence = smoothed_mean(linear, levels)
    settled = False
    for _ in range(rounds):
        linear = linearise_about(linear.problem, linear.start, moved(linear, x))
        x, new = smoothed_mean(linear, levels)
        settled = abs(new - evidence) < tolerance
        evidence = new
        if settled:
            break
    return linear, forward(linear, levels), settled

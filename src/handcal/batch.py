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

from handcal import so3
from handcal._jit import njit
from handcal.filter import Track, full_prior, update_linear
from handcal.kernel import (
    BASE,
    MAX_DIM,
    Nodes,
    Tables,
    corrected,
    fill_nav,
    interval,
    linearise,
    propagate,
    propagation_work,
    times_transition,
)
from handcal.model import Problem, markov_transitions, observation_variances, relinearised
from handcal.observations import NAV
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
            rows = nodes.kind == kind
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
    Q = (
        levels["gyro_noise"] ** 2 * linear.Q_gyro
        + levels["accel_noise"] ** 2 * linear.Q_accel
        + linear.Q_extra
    )
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


def smooth(linear: Linear, levels: Mapping[str, float], forward_pass: Pass) -> tuple[Array, Array]:
    """Rauch-Tung-Striebel smoother: x (k, N) and P (k, N, N) given the whole recording."""
    problem = linear.problem
    n, c = problem.size, problem.constants
    Phi_e, _ = markov_transitions(problem, levels, linear.t, linear.rate)
    x, P = forward_pass.x.copy(), forward_pass.P.copy()
    _, Phi_psi = _markov_steps(problem, linear.trajectory.markov, Phi_e)
    F = np.eye(n)
    width = linear.Phi.shape[2]
    for j in range(len(x) - 2, -1, -1):
        F[:9, :width] = linear.Phi[j + 1]
        F[BASE + c :, BASE + c :] = Phi_e[j + 1]
        F[BASE + c :, 6:9] = Phi_psi[j + 1]
        before = forward_pass.P_before[j + 1]
        scale = 1.0 / np.sqrt(np.diag(before))
        gain = (
            np.linalg.solve(scale[:, None] * before * scale, scale[:, None] * (F @ P[j])).T * scale
        )
        x[j] = x[j] + gain @ (x[j + 1] - forward_pass.x_before[j + 1])
        P[j] = P[j] + gain @ (P[j + 1] - before) @ gain.T
    return x, P


def moved(linear: Linear, x: Array) -> Trajectory:
    """The nominal trajectory moved by the estimated errors x (k, N)."""
    nominal, c = linear.trajectory, linear.problem.constants
    last = x[-1]
    C = np.stack([so3.matrix_exp(x[j, 6:9]) @ nominal.C[j] for j in range(len(x))])
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
    result = forward(linear, levels)
    for _ in range(rounds):
        x, _P = smooth(linear, levels, result)
        again = linearise_about(linear.problem, linear.start, moved(linear, x))
        new = forward(again, levels)
        change = new.log_evidence - result.log_evidence
        linear, result = again, new
        if abs(change) < tolerance:
            return linear, result, True
    return linear, result, False

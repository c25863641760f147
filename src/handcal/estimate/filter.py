"""The loop: strapdown mechanization and error-state Kalman filter. Read this first.

At every node (an IMU sample, or an observation between two samples):

1. correct the readings for the biases and effects estimated so far,
2. carry position, velocity and attitude over the interval (``strapdown``),
3. carry the covariance with the error transition, add process noise,
4. for each observation here: residual, H, update in Joseph form, and put the estimated
   error into the state.

Two engines, one mathematics: ``run_compiled`` does whole recordings in one compiled
loop, ``run_filterpy`` the same steps one at a time with filterpy's KalmanFilter, as a
live filter does. Both take and return a ``State``, so a run can stop at any node and be
resumed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from handcal.compiled.covariance import (
    Propagation,
    Update,
    add_unknown_force,
    propagate,
    propagation_work,
    update_linear,
    update_work,
)
from handcal.compiled.jit import copy1, copy2, inlined, lean, local_matrix, local_vector, zero1
from handcal.compiled.kernel import (
    BASE,
    MAX_DIM,
    Nodes,
    Noise,
    Tables,
    corrected,
    fill_nav,
    interval,
    linearise,
)
from handcal.compiled.rows import blank, padded, symmetrise
from handcal.compiled.so3 import exp, matmul
from handcal.estimate.problem import Problem
from handcal.estimate.start import Start
from handcal.observations import NAV
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class State:
    """The filter after a node.

    node: index of the last node whose observations are in (-1: none); p, v, bg, ba (3,);
    C (3, 3); extras: constants and Markov states; P (N, N).
    """

    node: int
    p: Array
    v: Array
    C: Array
    bg: Array
    ba: Array
    extras: Array
    P: Array


@dataclass(frozen=True)
class Track:
    """What a run leaves behind, for k recorded nodes and q observations.

    node (k,); p, v, bg, ba (k, 3); C (k, 3, 3); extras (k, ...); variance (k, N): the
    diagonal of P; residual, sigma (q, MAX_DIM); nis (q,), NaN where skipped; loglik (q,).
    """

    node: IntArray
    p: Array
    v: Array
    C: Array
    bg: Array
    ba: Array
    extras: Array
    variance: Array
    residual: Array
    sigma: Array
    nis: Array
    loglik: Array


class Work(NamedTuple):
    """Work space of a compiled run; x (N,) is zero between observations."""

    Phi: Array
    J: Array
    r: Array
    H: Array
    x: Array
    none: Array
    still: Array
    propagation: Propagation
    update: Update


def initial_state(problem: Problem, start: Start, levels: dict[str, float]) -> State:
    """The state before the first node, from the prior."""
    bg, ba = start.bias_mean[:3].copy(), start.bias_mean[3:].copy()
    C_nb = start.attitude(ba) if ba.any() else start.C_nb
    _, P15 = start.prior(start.p_n, start.v_n, C_nb, bg, ba)
    return State(
        -1,
        start.p_n.copy(),
        start.v_n.copy(),
        C_nb.copy(),
        bg,
        ba,
        np.r_[problem.prior_mean, np.zeros(problem.markov_size)],
        full_prior(problem, P15, levels),
    )


def full_prior(problem: Problem, P15: Array, levels: dict[str, float]) -> Array:
    """Prior covariance (N, N) of all states from that of the first fifteen."""
    P = np.zeros((problem.size, problem.size))
    P[:BASE, :BASE] = P15
    for i, slot in enumerate(problem.slots):
        P[BASE + i, BASE + i] = slot.prior_sigma**2
    at = BASE + problem.constants
    for markov in problem.markovs:
        P[at : at + markov.size, at : at + markov.size] = markov.start(
            levels, float(problem.rate[0])
        )
        at += markov.size
    return P


def empty_track(problem: Problem, record: IntArray) -> Track:
    """Arrays for a run over the whole problem that records the nodes ``record`` (k,)."""
    k, q, m = len(record), len(problem.nodes.kind), problem.size - BASE
    return Track(
        np.asarray(record, dtype=np.int64),
        np.zeros((k, 3)),
        np.zeros((k, 3)),
        np.zeros((k, 3, 3)),
        np.zeros((k, 3)),
        np.zeros((k, 3)),
        np.zeros((k, m)),
        np.zeros((k, problem.size)),
        np.zeros((q, MAX_DIM)),
        np.zeros((q, MAX_DIM)),
        np.full(q, np.nan),
        np.zeros(q),
    )


def run_compiled(
    problem: Problem, noise: Noise, state: State, track: Track, stop: int | None = None
) -> State:
    """Filter from after ``state.node`` to before node ``stop`` (None: the end), into ``track``."""
    end = len(problem.nodes.t) if stop is None else stop
    p, v, C = state.p.copy(), state.v.copy(), state.C.copy()
    bg, ba, extras = state.bg.copy(), state.ba.copy(), state.extras.copy()
    n, mi, e = problem.size, problem.nodes.J.shape[2], problem.markov_size
    wide = padded(n)
    P = blank(wide, wide)
    P[:n, :n] = state.P
    _run(
        problem.nodes,
        problem.tables,
        noise,
        (problem.constants, problem.ref, problem.g_n, problem.omega_ie_n),
        (state.node + 1, end),
        (p, v, C, bg, ba, extras, P),
        int(np.searchsorted(track.node, state.node + 1)),
        (track.node, track.p, track.v, track.C, track.bg, track.ba, track.extras, track.variance),
        (track.residual, track.sigma, track.nis, track.loglik),
        Work(
            np.empty((9, BASE + mi)),
            np.empty((6, mi)),
            np.empty(MAX_DIM),
            blank(MAX_DIM, wide),
            blank(wide),
            np.empty((0, 0)),
            np.zeros((e, 3)),
            propagation_work(wide, e),
            update_work(wide, MAX_DIM),
        ),
    )
    return State(end - 1, p, v, C, bg, ba, extras, P[:n, :n].copy())


@lean
def _run(
    nodes: Nodes,
    tables: Tables,
    noise: Noise,
    world: tuple[int, Array, Array, Array],
    span: tuple[int, int],
    state: tuple[Array, Array, Array, Array, Array, Array, Array],
    at: int,
    record: tuple[IntArray, Array, Array, Array, Array, Array, Array, Array],
    innovation: tuple[Array, Array, Array, Array],
    work: Work,
) -> None:
    p, v, C, bg, ba, extras, P = state
    c, ref, g_n, omega_ie_n = world
    Phi, J, x = work.Phi, work.J, work.x
    nav, w, f = local_vector(NAV), local_vector(3), local_vector(3)
    for i in range(span[0], span[1]):
        if i > 0:
            interval(nodes, i, bg, ba, extras, ref, g_n, omega_ie_n, p, v, C, Phi, J)
            move_markov(noise.Phi_e[i], c, extras, x)
            propagate(P, Phi, work.none, noise.Phi_e[i], work.still, BASE + c, work.propagation)
            add_noise(P, noise, nodes.t[i] - nodes.t[i - 1], nodes.extra[i], noise.Q_e[i], c)
        for q in range(nodes.first[i], nodes.first[i + 1]):
            corrected(nodes.gyro[i], nodes.J[i], 0, bg, extras, ref, w)
            corrected(nodes.accel[i], nodes.J[i], 3, ba, extras, ref, f)
            fill_nav(p, v, C, w, f, nav)
            update(q, nodes, tables, noise, nav, extras, nodes.J[i], P, innovation, work)
            inject(x, p, v, C, bg, ba, extras)
        symmetrise(P)
        if at < len(record[0]) and record[0][at] == i:
            copy1(p, record[1][at])
            copy1(v, record[2][at])
            copy2(C, record[3][at])
            copy1(bg, record[4][at])
            copy1(ba, record[5][at])
            copy1(extras, record[6][at])
            for k in range(BASE + len(extras)):
                record[7][at, k] = P[k, k]
            at += 1


@lean
def move_markov(Phi_e: Array, c: int, extras: Array, x: Array) -> None:
    """Carry the estimated Markov states over one interval, in place; x (N,) is zero."""
    e = Phi_e.shape[0]
    for i in range(e):
        for j in range(e):
            x[i] += Phi_e[i, j] * extras[c + j]
    for i in range(e):
        extras[c + i] = x[i]
        x[i] = 0.0


@lean
def add_noise(P: Array, noise: Noise, dt: float, extra: Array, Q_e: Array, c: int) -> None:
    """Add the process noise of one interval to P, in place."""
    for k in range(3):
        P[3 + k, 3 + k] += noise.accel * dt
        if extra[1] > 0.0:
            add_unknown_force(P, k, dt, extra[1])
        P[6 + k, 6 + k] += noise.gyro * dt + extra[0]
        P[k, k] += extra[2]
    for k in range(9, BASE + c):
        P[k, k] += noise.walk[k] * dt
    for i in range(Q_e.shape[0]):
        for j in range(Q_e.shape[0]):
            P[BASE + c + i, BASE + c + j] += Q_e[i, j]


@inlined
def update(
    q: int,
    nodes: Nodes,
    tables: Tables,
    noise: Noise,
    nav: Array,
    extras: Array,
    J: Array,
    P: Array,
    innovation: tuple[Array, Array, Array, Array],
    work: Work,
) -> None:
    """Update P with observation q; the estimated error goes into x, which must be zero."""
    kind = nodes.kind[q]
    r, H = work.r, work.H
    if linearise(kind, tables, nav, extras, nodes.z[q], J, r, H) != 0:
        return
    update_linear(
        r,
        H,
        tables.dim[kind],
        noise.R[kind],
        P,
        work.x,
        (innovation[0][q], innovation[1][q], innovation[2][q : q + 1], innovation[3][q : q + 1]),
        work.update,
    )


@lean
def inject(x: Array, p: Array, v: Array, C: Array, bg: Array, ba: Array, extras: Array) -> None:
    """Put the estimated error x (N,) into the state and set it to zero."""
    turn, new = local_matrix(3, 3), local_matrix(3, 3)
    for i in range(3):
        p[i] += x[i]
        v[i] += x[3 + i]
        bg[i] += x[9 + i]
        ba[i] += x[12 + i]
    exp(x[6:9], turn)
    matmul(turn, C, new)
    copy2(new, C)
    for i in range(len(extras)):
        extras[i] += x[BASE + i]
    zero1(x)


def run_filterpy(
    problem: Problem, noise: Noise, state: State, track: Track, stop: int | None = None
) -> State:
    """The same as ``run_compiled``, one step at a time on filterpy's KalmanFilter."""
    end = len(problem.nodes.t) if stop is None else stop
    last = state
    for step in steps_filterpy(problem, noise, state, track, end):
        last = step
    return last


def steps_filterpy(
    problem: Problem, noise: Noise, state: State, track: Track, end: int
) -> Iterator[State]:
    """Yield the state after each node, as a live filter would."""
    from filterpy.kalman import KalmanFilter

    n, mi = problem.size, problem.nodes.J.shape[2]
    kf = KalmanFilter(dim_x=n, dim_z=1)
    kf.x, kf.P = np.zeros(n), state.P.copy()
    s = State(state.node, *_copies(state), kf.P)
    work = np.empty((9, BASE + mi)), np.empty((6, mi)), np.eye(n)
    for i in range(state.node + 1, end):
        if i > 0:
            _predict_filterpy(kf, problem, noise, s, i, work)
        for q in range(problem.nodes.first[i], problem.nodes.first[i + 1]):
            _update_filterpy(kf, problem, noise, s, i, q, track)
        at = int(np.searchsorted(track.node, i))
        if at < len(track.node) and track.node[at] == i:
            track.p[at], track.v[at], track.C[at] = s.p, s.v, s.C
            track.bg[at], track.ba[at], track.extras[at] = s.bg, s.ba, s.extras
            track.variance[at] = np.diag(kf.P)
        yield State(i, *_copies(s), kf.P.copy())


def _mean(s: State) -> tuple[Array, Array, Array, Array, Array, Array]:
    return s.p, s.v, s.C, s.bg, s.ba, s.extras


def _copies(s: State) -> tuple[Array, Array, Array, Array, Array, Array]:
    return s.p.copy(), s.v.copy(), s.C.copy(), s.bg.copy(), s.ba.copy(), s.extras.copy()


def _predict_filterpy(
    kf: Any, problem: Problem, noise: Noise, s: State, i: int, work: tuple[Array, Array, Array]
) -> None:
    """Carry the mean in ``s`` (in place) and the covariance of kf from node i - 1 to i."""
    nodes, c, n = problem.nodes, problem.constants, problem.size
    Phi, J, F = work
    earth = problem.ref, problem.g_n, problem.omega_ie_n
    interval(nodes, i, s.bg, s.ba, s.extras, *earth, s.p, s.v, s.C, Phi, J)
    move_markov(noise.Phi_e[i], c, s.extras, np.zeros(n))
    F[:9, : Phi.shape[1]] = Phi
    F[BASE + c :, BASE + c :] = noise.Phi_e[i]
    Q = np.zeros((n, n))
    add_noise(Q, noise, nodes.t[i] - nodes.t[i - 1], nodes.extra[i], noise.Q_e[i], c)
    kf.predict(F=F, Q=Q)


def _update_filterpy(
    kf: Any, problem: Problem, noise: Noise, s: State, i: int, q: int, track: Track
) -> None:
    """Take in observation q at node i: kf, the mean in ``s`` (in place) and the track."""
    nodes, kind = problem.nodes, problem.nodes.kind[q]
    d = problem.tables.dim[kind]
    nav, w, f = np.empty(NAV), np.empty(3), np.empty(3)
    r, H = np.empty(MAX_DIM), np.empty((MAX_DIM, problem.size))
    corrected(nodes.gyro[i], nodes.J[i], 0, s.bg, s.extras, problem.ref, w)
    corrected(nodes.accel[i], nodes.J[i], 3, s.ba, s.extras, problem.ref, f)
    fill_nav(s.p, s.v, s.C, w, f, nav)
    if linearise(kind, problem.tables, nav, s.extras, nodes.z[q], nodes.J[i], r, H) != 0:
        return
    kf.update(r[:d].copy(), R=np.diag(noise.R[kind, :d]), H=H[:d].copy())
    track.residual[q, :d] = r[:d]
    track.sigma[q, :d] = np.sqrt(np.diag(kf.S))
    track.nis[q] = float(kf.y @ np.linalg.solve(kf.S, kf.y))
    track.loglik[q] = -0.5 * (track.nis[q] + np.linalg.slogdet(kf.S)[1] + d * math.log(2 * math.pi))
    inject(kf.x, *_mean(s))


ENGINES = {"compiled": run_compiled, "filterpy": run_filterpy}

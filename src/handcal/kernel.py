"""The compiled arithmetic that both engines and the batch estimator share.

The error state is (position, velocity, psi, gyro bias, accelerometer bias, constants,
Markov states). ``Layout`` of the problem is three numbers: imu constants (they act on
the readings), all constants, and the total size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from handcal._jit import call_residual, njit
from handcal.observations import NAV
from handcal.so3 import exp, matmul
from handcal.strapdown import advance, error_transition, increments
from handcal.types import Array, IntArray

BASE = 15
MAX_DIM = 6


class Tables(NamedTuple):
    """Which compiled functions make up each kind of observation.

    dim (K,), jacobian (K,) addresses or 0; function (K, F) addresses, the first the
    observation's own, 0 ends the list; start, counts (K, F): its slice of the extras;
    step: of the central difference by each of the extras.
    """

    dim: IntArray
    jacobian: IntArray
    function: IntArray
    start: IntArray
    counts: IntArray
    step: Array


class Nodes(NamedTuple):
    """The recording on the union of IMU stamps and observation times, n nodes.

    t (n,); gyro, accel (n, 3) with the effects at their reference removed;
    J (n, 6, mi): derivative of the readings by the IMU constants; extra (n, 2): variance
    added to angle (rad^2) and velocity over the interval that ends here (gaps, masks);
    first (n + 1,): observations first[i]:first[i + 1] belong to node i; kind, z: of each.
    """

    t: Array
    gyro: Array
    accel: Array
    J: Array
    extra: Array
    first: IntArray
    kind: IntArray
    z: Array


class Noise(NamedTuple):
    """Noise as the kernel uses it: gyro and accel densities squared, walks (15 + c,) as
    variance per second, R (K, MAX_DIM), Markov transitions (n, e, e) of each interval."""

    gyro: float
    accel: float
    walk: Array
    R: Array
    Phi_e: Array
    Q_e: Array


class Reduced(NamedTuple):
    """A linearised problem of m = 9 + e moving states, as columns of 1 + nc numbers.

    The first column is for constants as the trajectory has them, the others are derivatives
    by the nc biases and constants, each in units of its prior sigma. k epochs, s scalars.
    A (k, 9, 15 + mi), of which the first nine columns count; D (k, 9, 1 + nc) added by an
    interval; Phi_e, Q_e (k, e, e), Phi_psi (k, e, 3), d_e (k, e): Markov states; Q (k, 9, 9);
    first (k + 1,): scalars of each epoch; g (s, 1 + nc): observed minus predicted; h (s, m)
    with its nonzero (s,) entries listed in at (s, m); R (s,).
    """

    A: Array
    D: Array
    Q: Array
    Phi_e: Array
    Q_e: Array
    d_e: Array
    Phi_psi: Array
    first: IntArray
    g: Array
    h: Array
    at: IntArray
    nonzero: IntArray
    R: Array


@njit
def fill_nav(p: Array, v: Array, C: Array, w: Array, f: Array, nav: Array) -> None:
    """Write the flat view of the navigation state that observations read."""
    for i in range(3):
        nav[i] = p[i]
        nav[3 + i] = v[i]
        nav[15 + i] = w[i]
        nav[18 + i] = f[i]
        for j in range(3):
            nav[6 + 3 * i + j] = C[i, j]


@njit
def corrected(
    reading: Array, J: Array, row: int, bias: Array, extras: Array, ref: Array, out: Array
) -> None:
    """True rate (row 0) or force (row 3) from a reading, bias and IMU constants."""
    for i in range(3):
        s = reading[i] - bias[i]
        for c in range(J.shape[1]):
            s -= J[row + i, c] * (extras[c] - ref[c])
        out[i] = s


@njit
def _total(
    kind: int, tables: Tables, nav: Array, extras: Array, z: Array, only: int, r: Array
) -> int:
    """Residual of all functions of a kind (from number ``only`` on); 1 if it is to be skipped."""
    r[:] = 0.0
    status = 0
    for k in range(only, tables.function.shape[1]):
        address = tables.function[kind, k]
        if address == 0:
            break
        a = tables.start[kind, k]
        status |= call_residual(address, nav, extras[a : a + max(1, tables.counts[kind, k])], z, r)
    return status


@njit
def _perturb_nav(nav: Array, i: int, step: float, out: Array) -> None:
    """Copy nav with error component i (position, velocity, psi, rate, force) moved by step."""
    out[:] = nav
    if i < 6:
        out[i] += step
    elif i < 9:
        phi = np.zeros(3)
        phi[i - 6] = step
        turn = np.empty((3, 3))
        new = np.empty((3, 3))
        exp(phi, turn)
        matmul(turn, nav[6:15].reshape(3, 3), new)
        for k in range(9):
            out[6 + k] = new[k // 3, k % 3]
    else:
        out[i + 6] += step


@njit
def linearise(
    kind: int,
    tables: Tables,
    nav: Array,
    extras: Array,
    z: Array,
    J: Array,
    r: Array,
    H: Array,
) -> int:
    """Residual r (MAX_DIM,) and observation matrix H (MAX_DIM, N) of one observation.

    Derivatives are central differences, except for the part by the navigation state
    where the observation brings its own. Angular residuals are small by construction,
    so differences of them need no wrapping. Returns 1 if it is to be skipped.
    """
    d = tables.dim[kind]
    mi = J.shape[1]
    H[:, :] = 0.0
    status = _total(kind, tables, nav, extras, z, 0, r)
    if status != 0:
        return 1
    flat = np.zeros(MAX_DIM * BASE)
    Hn = flat.reshape(MAX_DIM, BASE)
    plus = np.zeros(MAX_DIM)
    minus = np.zeros(MAX_DIM)
    moved = np.empty(NAV)
    first = 0
    if tables.jacobian[kind] != 0:
        first = 1
        call_residual(tables.jacobian[kind], nav, extras, z, flat)
    if tables.function.shape[1] > first and tables.function[kind, first] != 0:
        step = 1e-5
        for i in range(BASE):
            _perturb_nav(nav, i, step, moved)
            _total(kind, tables, moved, extras, z, first, plus)
            _perturb_nav(nav, i, -step, moved)
            _total(kind, tables, moved, extras, z, first, minus)
            for j in range(d):
                # r is observed minus predicted, so it falls as the prediction rises
                Hn[j, i] -= (plus[j] - minus[j]) / (2 * step)
    for j in range(d):
        for i in range(9):
            H[j, i] = Hn[j, i]
        # a larger bias means a smaller true rate and force
        for i in range(6):
            h = Hn[j, 9 + i]
            if h != 0.0:
                H[j, 9 + i] -= h
                for c in range(mi):
                    H[j, BASE + c] -= h * J[i, c]
    _extras_columns(kind, tables, nav, extras, z, d, plus, minus, H)
    return 0


@njit
def _extras_columns(
    kind: int,
    tables: Tables,
    nav: Array,
    extras: Array,
    z: Array,
    d: int,
    plus: Array,
    minus: Array,
    H: Array,
) -> None:
    """Columns of H for the constants and Markov states that the functions of a kind read."""
    for k in range(tables.function.shape[1]):
        if tables.function[kind, k] == 0:
            break
        a = tables.start[kind, k]
        for c in range(a, a + tables.counts[kind, k]):
            keep, step = extras[c], tables.step[c]
            extras[c] = keep + step
            _total(kind, tables, nav, extras, z, 0, plus)
            extras[c] = keep - step
            _total(kind, tables, nav, extras, z, 0, minus)
            extras[c] = keep
            for j in range(d):
                H[j, BASE + c] -= (plus[j] - minus[j]) / (2 * step)


@njit
def scalar_update(
    P: Array, x: Array, h: Array, r: float, R: float, ph: Array, gain: Array
) -> tuple[float, float]:
    """One scalar Kalman update in Joseph form; returns innovation and its variance.

    (I - K h) P (I - K h)' + K R K', evaluated as two rank-one corrections, then kept
    symmetric. x (N,) and P (N, N) are changed in place; ph, gain (N,) are work space.
    """
    n = len(x)
    S = R
    nu = r
    for i in range(n):
        ph[i] = 0.0
    for a in range(n):
        # most of a row of H is zero
        if h[a] != 0.0:
            nu -= h[a] * x[a]
            for i in range(n):
                ph[i] += h[a] * P[a, i]
    for a in range(n):
        S += h[a] * ph[a]
    for i in range(n):
        gain[i] = ph[i] / S
        x[i] += gain[i] * nu
    for i in range(n):
        for j in range(n):
            P[i, j] -= gain[i] * ph[j]
        # (I - K h) P is not symmetric in round-off: multiply by (I - K h)' from what it is
        s = gain[i] * R
        for a in range(n):
            if h[a] != 0.0:
                s -= P[i, a] * h[a]
        for j in range(n):
            P[i, j] += s * gain[j]
    for i in range(n):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s
    return nu, S


@njit
def times_transition(
    Phi: Array, Phi_e: Array, Phi_psi: Array, e0: int, X: Array, out: Array
) -> None:
    """The rows of out = F X that differ from those of X; the others are left alone.

    F is the full transition made of Phi (9, 15 + mi) in its first nine rows, the identity,
    and from row e0 on, where the Markov states begin, Phi_e (e, e) and Phi_psi (e, 3): how
    Markov states depend on psi. Without constants, e0 = 9 and Phi is cut to nine columns.
    """
    n = X.shape[1]
    width = min(Phi.shape[1], e0)
    for i in range(9):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(width):
            a = Phi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[i, j] += a * X[k, j]
    for i in range(Phi_e.shape[0]):
        for j in range(n):
            out[e0 + i, j] = 0.0
        for k in range(Phi_e.shape[0]):
            a = Phi_e[i, k]
            if a != 0.0:
                for j in range(n):
                    out[e0 + i, j] += a * X[e0 + k, j]
        for k in range(3):
            a = Phi_psi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[e0 + i, j] += a * X[6 + k, j]


@njit
def propagate(
    P: Array, Phi: Array, Phi_e: Array, Phi_psi: Array, e0: int, work: tuple[Array, Array, Array]
) -> None:
    """P = F P F' in place (without Q), F as in ``times_transition``.

    work: (N, N), (N, 9 + e), (N, 9 + e). The constants' own block of P does not change,
    and their rows and columns only once.
    """
    W, W_t, new = work
    n = P.shape[0]
    moved = 9 + Phi_e.shape[0]
    shift = e0 - 9
    times_transition(Phi, Phi_e, Phi_psi, e0, P, W)
    for i in range(moved):
        row = i if i < 9 else i + shift
        for j in range(n):
            W_t[j, i] = W[row, j]
    times_transition(Phi, Phi_e, Phi_psi, e0, W_t, new)
    for i in range(moved):
        row = i if i < 9 else i + shift
        for j in range(9, e0):
            P[row, j] = W[row, j]
            P[j, row] = W[row, j]
        for j in range(i + 1):
            column = j if j < 9 else j + shift
            s = 0.5 * (new[row, j] + new[column, i])
            P[row, column] = s
            P[column, row] = s


@njit
def propagation_work(n: int, e: int) -> tuple[Array, Array, Array]:
    """Work space of ``propagate`` for n states, e of them Markov states."""
    return np.empty((n, n)), np.empty((n, 9 + e)), np.empty((n, 9 + e))


@njit
def interval(
    nodes: Nodes,
    i: int,
    bg: Array,
    ba: Array,
    extras: Array,
    ref: Array,
    g_n: Array,
    omega_ie_n: Array,
    p: Array,
    v: Array,
    C: Array,
    Phi: Array,
    J: Array,
) -> None:
    """Carry p, v, C (in place) from node i - 1 to i and write the error transition Phi.

    J (6, 6 + mi) is work space for the derivative of the mean reading by biases and
    IMU constants.
    """
    w0, w1, f0, f1 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    inc, C_mid, turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    f_n, half = np.empty(3), np.empty(3)
    corrected(nodes.gyro[i - 1], nodes.J[i - 1], 0, bg, extras, ref, w0)
    corrected(nodes.gyro[i], nodes.J[i], 0, bg, extras, ref, w1)
    corrected(nodes.accel[i - 1], nodes.J[i - 1], 3, ba, extras, ref, f0)
    corrected(nodes.accel[i], nodes.J[i], 3, ba, extras, ref, f1)
    dt = nodes.t[i] - nodes.t[i - 1]
    increments(w0, w1, f0, f1, dt, inc)
    for k in range(3):
        # (an array expression here would take a second more to compile)
        half[k] = 0.5 * inc[0, k]
    exp(half, turn)
    matmul(C, turn, C_mid)
    advance(p, v, C, inc, dt, g_n, omega_ie_n, f_n)
    J[:, :6] = 0.0
    for k in range(6):
        J[k, k] = 1.0
        for c in range(nodes.J.shape[2]):
            J[k, 6 + c] = 0.5 * (nodes.J[i - 1, k, c] + nodes.J[i, k, c])
    error_transition(C_mid, f_n, dt, omega_ie_n, J, Phi)


@njit
def reduced_update(
    P: Array,
    X: Array,
    g: Array,
    h: Array,
    at: IntArray,
    R: float,
    ph: Array,
    gain: Array,
    nu: Array,
) -> float:
    """``scalar_update`` of X (m, 1 + nc) and P (m, m); at: where h is not zero.

    gain (m,) and the innovation nu (1 + nc,) are written; returns the innovation's variance.
    """
    m, columns = X.shape
    nu[:] = g
    ph[:] = 0.0
    for a in at:
        for c in range(columns):
            nu[c] -= h[a] * X[a, c]
        for i in range(m):
            ph[i] += h[a] * P[a, i]
    S: float = R
    for a in at:
        S += h[a] * ph[a]
    for i in range(m):
        k = ph[i] / S
        gain[i] = k
        for c in range(columns):
            X[i, c] += k * nu[c]
    for i in range(m):
        for j in range(m):
            P[i, j] -= gain[i] * ph[j]
        s = gain[i] * R
        for a in at:
            s -= P[i, a] * h[a]
        for j in range(m):
            P[i, j] += s * gain[j]
    for i in range(m):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s
    return S


@njit
def reduced_forward(
    a: Reduced,
    P: Array,
    X: Array,
    states: tuple[Array, Array],
    scalars: tuple[Array, Array, Array],
    gram: Array,
) -> None:
    """Kalman filter over the moving states alone, for all values of the constants at once.

    states: X (k, m, 1 + nc) and P (k, m, m) after each epoch, or of length 1 to keep only
    the last; scalars: gain (s, m), innovation (s, 1 + nc) and its variance (s,). gram
    (1 + nc, 1 + nc) receives the lower half of the sum of nu nu' / S, which is all that the
    evidence and the constants need.
    """
    m, columns = X.shape
    e = m - 9
    work = propagation_work(m, e)
    new, ph = np.empty((m, columns)), np.empty(m)
    keep = states[0].shape[0] > 1
    for j in range(len(a.first) - 1):
        if j > 0:
            times_transition(a.A[j], a.Phi_e[j], a.Phi_psi[j], 9, X, new)
            propagate(P, a.A[j], a.Phi_e[j], a.Phi_psi[j], 9, work)
            for i in range(9):
                for c in range(columns):
                    X[i, c] = new[i, c] + a.D[j, i, c]
                for c in range(9):
                    P[i, c] += a.Q[j, i, c]
            for i in range(e):
                for c in range(columns):
                    X[9 + i, c] = new[9 + i, c]
                X[9 + i, 0] += a.d_e[j, i]
                for c in range(e):
                    P[9 + i, 9 + c] += a.Q_e[j, i, c]
        for q in range(a.first[j], a.first[j + 1]):
            scalars[2][q] = reduced_update(
                P,
                X,
                a.g[q],
                a.h[q],
                a.at[q, : a.nonzero[q]],
                a.R[q],
                ph,
                scalars[0][q],
                scalars[1][q],
            )
            for i in range(columns):
                s = scalars[1][q, i] / scalars[2][q]
                for c in range(i + 1):
                    gram[i, c] += s * scalars[1][q, c]
        if keep or j == len(a.first) - 2:
            states[0][j if keep else 0] = X
            states[1][j if keep else 0] = P


@njit
def times_transposed(Phi: Array, Phi_e: Array, Phi_psi: Array, X: Array, out: Array) -> None:
    """out = F' X for the moving states (m, n)."""
    n = X.shape[1]
    e = Phi_e.shape[0]
    out[:, :] = 0.0
    for i in range(9):
        for k in range(9):
            a = Phi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[k, j] += a * X[i, j]
    for i in range(e):
        for k in range(e):
            a = Phi_e[i, k]
            if a != 0.0:
                for j in range(n):
                    out[9 + k, j] += a * X[9 + i, j]
        for k in range(3):
            a = Phi_psi[i, k]
            if a != 0.0:
                for j in range(n):
                    out[6 + k, j] += a * X[9 + i, j]


@njit
def adjoint_update(
    r: Array,
    N: Array,
    h: Array,
    at: IntArray,
    gain: Array,
    nu: Array,
    S: float,
    given: Array,
    error: Array,
) -> float:
    """Take r (m, columns) and N (m, m) from after a scalar update to before it.

    given (1 + nc, columns) turns the innovation nu into the one at the constants' posterior
    mean and its spread. Returns the derivative of the log-evidence by the scalar's variance
    R. error (columns,) is work space.
    """
    m, columns = r.shape
    error[:] = 0.0
    for i in range(len(nu)):
        weight = nu[i] / S
        for c in range(columns):
            error[c] += weight * given[i, c]
    for i in range(m):
        for c in range(columns):
            error[c] -= gain[i] * r[i, c]
    slope = -1.0 / S
    for c in range(columns):
        slope += error[c] * error[c]
    for a in at:
        for c in range(columns):
            r[a, c] += h[a] * error[c]
    if len(N) == 0:
        return 0.0
    u = np.zeros(m)
    for i in range(m):
        for j in range(m):
            u[j] += gain[i] * N[i, j]
    s = 0.0
    for i in range(m):
        s += gain[i] * u[i]
    for a in at:
        for i in range(m):
            N[a, i] -= h[a] * u[i]
            N[i, a] -= h[a] * u[i]
        for b in at:
            N[a, b] += h[a] * h[b] * (s + 1.0 / S)
    by_R: float = 0.5 * (slope - s)
    return by_R


@njit
def reduced_backward(
    a: Reduced,
    gain: Array,
    nu: Array,
    S: Array,
    given: Array,
    Q_unit: tuple[Array, Array],
    r: Array,
    N: Array,
    states: tuple[Array, Array],
    slopes: tuple[Array, Array, Array, Array],
) -> None:
    """Fixed-interval recursion of Bryson and Frazier, and with it the score.

    r (m, columns) and N (m, m, or empty if only the mean is wanted) start as zeros and end
    as those of the prior. given (1 + nc, columns): as in ``adjoint_update``. states: r and
    N after the observations of each epoch, or empty. slopes: derivatives of the
    log-evidence by R (s,), by the two densities whose Q (k, 9, 9) are Q_unit (2,), by Q_e
    (k, e, e) and by the prior of the moving states (m, m).

    Source: Durbin & Koopman, Time Series Analysis by State Space Methods, 4.5 and 7.3.3;
    with constants as in de Jong (1991).
    """
    m, columns = r.shape
    e = m - 9
    new, work, half = np.empty((m, columns)), np.empty((m, m)), np.empty((m, m))
    error = np.empty(columns)
    score = len(N) > 0
    for j in range(len(a.first) - 2, -1, -1):
        if len(states[0]) > 0:
            states[0][j] = r
        if len(states[1]) > 0:
            states[1][j] = N
        for q in range(a.first[j + 1] - 1, a.first[j] - 1, -1):
            at = a.at[q, : a.nonzero[q]]
            slopes[0][q] = adjoint_update(r, N, a.h[q], at, gain[q], nu[q], S[q], given, error)
        if score:
            _covariance_slope(r, N, slopes[3])
            for i in range(9):
                for k in range(9):
                    slopes[1][0] += slopes[3][i, k] * Q_unit[0][j, i, k]
                    slopes[1][1] += slopes[3][i, k] * Q_unit[1][j, i, k]
            for i in range(e):
                for k in range(e):
                    slopes[2][j, i, k] = slopes[3][9 + i, 9 + k]
        if j > 0:
            times_transposed(a.A[j], a.Phi_e[j], a.Phi_psi[j], r, new)
            r[:, :] = new
            if score:
                times_transposed(a.A[j], a.Phi_e[j], a.Phi_psi[j], N, work)
                for i in range(m):
                    for k in range(m):
                        half[k, i] = work[i, k]
                times_transposed(a.A[j], a.Phi_e[j], a.Phi_psi[j], half, work)
                for i in range(m):
                    for k in range(m):
                        N[i, k] = 0.5 * (work[i, k] + work[k, i])


@njit
def _covariance_slope(r: Array, N: Array, out: Array) -> None:
    """Derivative (m, m) of the log-evidence by a covariance added here: (E r r' - N) / 2."""
    m, columns = r.shape
    for i in range(m):
        for k in range(i + 1):
            s = -N[i, k]
            for c in range(columns):
                s += r[i, c] * r[k, c]
            out[i, k] = 0.5 * s
            out[k, i] = 0.5 * s

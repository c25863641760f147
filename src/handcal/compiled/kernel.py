"""The compiled steps of mean and observations that both engines and the batch share.

The error state is (position, velocity, psi, gyro bias, accelerometer bias, constants,
Markov states). ``Layout`` of the problem is three numbers: imu constants (they act on
the readings), all constants, and the total size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from handcal.compiled.jit import (
    call_residual,
    copy1,
    inlined,
    inner,
    lean,
    local_matrix,
    local_vector,
    zero1,
)
from handcal.compiled.so3 import exp, left_jacobian, matmul
from handcal.compiled.strapdown import advance, error_transition, increments
from handcal.types import Array, IntArray

BASE = 15
MAX_DIM = 6
# Numbers of the flat navigation state that observations read.
NAV = 21
_SLOPES = MAX_DIM * BASE
# Parameters of a function of which some are held, at the most.
MOST_HELD = 16


class Tables(NamedTuple):
    """Which compiled functions make up each kind of observation.

    dim (K,), jacobian (K,) addresses or 0; function (K, F) addresses, the first the
    observation's own, 0 ends the list; start, counts (K, F): its slice of the extras;
    step: of the central difference by each of the extras. whole (K, F): of a function some of
    whose parameters are held, how many it has, else 0; held (K, F, MOST_HELD): those, nan where
    the extras tell. late (K, F): 1 where a function tells by how many seconds readings of this kind
    come late, instead of adding to their residual.
    """

    dim: IntArray
    jacobian: IntArray
    function: IntArray
    start: IntArray
    counts: IntArray
    step: Array
    whole: IntArray
    held: Array
    late: IntArray


class Nodes(NamedTuple):
    """The recording on the union of IMU stamps and observation times, n nodes.

    t (n,); gyro, accel (n, 3) with the effects at their reference removed; bend (n, 6): what is
    added to both where they are integrated, for the motion between the samples;
    J (n, 6, mi): derivative of the readings by the IMU constants; extra (n, 3): variance
    added to angle (rad^2), velocity and position over the interval that ends here (gaps, masks,
    and a held point that is moved);
    first (n + 1,): observations first[i]:first[i + 1] belong to node i; kind, z: of each.
    """

    t: Array
    gyro: Array
    accel: Array
    bend: Array
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


@lean
def fill_nav(p: Array, v: Array, C: Array, w: Array, f: Array, nav: Array) -> None:
    """Write the flat view of the navigation state that observations read."""
    for i in range(3):
        nav[i] = p[i]
        nav[3 + i] = v[i]
        nav[15 + i] = w[i]
        nav[18 + i] = f[i]
        for j in range(3):
            nav[6 + 3 * i + j] = C[i, j]


@lean
def corrected(
    reading: Array, J: Array, row: int, bias: Array, extras: Array, ref: Array, out: Array
) -> None:
    """True rate (row 0) or force (row 3) from a reading, bias and IMU constants."""
    for i in range(3):
        s = reading[i] - bias[i]
        for c in range(J.shape[1]):
            s -= J[row + i, c] * (extras[c] - ref[c])
        out[i] = s


@inlined
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

    J (6, mi) is work space for the derivative of the mean reading by the IMU constants.
    """
    w0, w1, f0, f1 = local_vector(3), local_vector(3), local_vector(3), local_vector(3)
    inc, C_mid, turn = local_matrix(3, 3), local_matrix(3, 3), local_matrix(3, 3)
    f_n, half = local_vector(3), local_vector(3)
    corrected(nodes.gyro[i - 1], nodes.J[i - 1], 0, bg, extras, ref, w0)
    corrected(nodes.gyro[i], nodes.J[i], 0, bg, extras, ref, w1)
    corrected(nodes.accel[i - 1], nodes.J[i - 1], 3, ba, extras, ref, f0)
    corrected(nodes.accel[i], nodes.J[i], 3, ba, extras, ref, f1)
    for k in range(3):
        w0[k] += nodes.bend[i - 1, k]
        w1[k] += nodes.bend[i, k]
        f0[k] += nodes.bend[i - 1, 3 + k]
        f1[k] += nodes.bend[i, 3 + k]
    dt = nodes.t[i] - nodes.t[i - 1]
    increments(w0, w1, f0, f1, dt, inc)
    for k in range(3):
        # (an array expression here would take a second more to compile)
        half[k] = 0.5 * inc[0, k]
    exp(half, turn)
    matmul(C, turn, C_mid)
    advance(p, v, C, inc, dt, g_n, omega_ie_n, f_n)
    for k in range(6):
        for c in range(nodes.J.shape[2]):
            J[k, c] = 0.5 * (nodes.J[i - 1, k, c] + nodes.J[i, k, c])
    error_transition(C_mid, f_n, dt, omega_ie_n, J, Phi)


@inlined
def by_differences(
    kind: int,
    tables: Tables,
    nav: Array,
    extras: Array,
    z: Array,
    first: int,
    work: tuple[Array, Array, Array, Array],
    Hn: Array,
) -> None:
    """Add to Hn (BASE * dimension,) the derivatives by the fifteen errors of all that ``first``
    and the later functions of an observation predict, as central differences."""
    plus, minus, moved, moved_then = work
    step = 1e-5
    for i in range(BASE):
        _perturb_nav(nav, i, step, moved)
        back_in_time(kind, tables, moved, extras, z, plus, moved_then)
        _total(kind, tables, moved_then, extras, z, first, plus)
        _perturb_nav(nav, i, -step, moved)
        back_in_time(kind, tables, moved, extras, z, minus, moved_then)
        _total(kind, tables, moved_then, extras, z, first, minus)
        for j in range(tables.dim[kind]):
            # r is observed minus predicted, so it falls as the prediction rises
            Hn[BASE * j + i] -= (plus[j] - minus[j]) / (2 * step)


@inlined
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
    """Residual r (MAX_DIM,) and observation matrix H (MAX_DIM, N) of one observation, as far
    as its dimension goes.

    Derivatives are central differences, except for the part by the navigation state
    where the observation brings its own. Angular residuals are small by construction,
    so differences of them need no wrapping. Returns 1 if it is to be skipped.
    """
    d = tables.dim[kind]
    mi = J.shape[1]
    plus, minus = local_vector(MAX_DIM), local_vector(MAX_DIM)
    then, moved, moved_then = local_vector(NAV), local_vector(NAV), local_vector(NAV)
    late = back_in_time(kind, tables, nav, extras, z, plus, then)
    status = _total(kind, tables, then, extras, z, 0, r)
    if status != 0:
        return 1
    # (by the fifteen errors, one row after the other)
    Hn = local_vector(_SLOPES)
    for j in range(BASE * d):
        Hn[j] = 0.0
    first = 0
    if tables.jacobian[kind] != 0:
        first = 1
        a = tables.start[kind, 0]
        own = extras[a : a + max(1, tables.counts[kind, 0])]
        call_residual(tables.jacobian[kind], then, own, z, Hn)
        if late != 0.0:
            _as_of_now(nav, late, d, Hn)
    if tables.function.shape[1] > first and tables.function[kind, first] != 0:
        by_differences(kind, tables, nav, extras, z, first, (plus, minus, moved, moved_then), Hn)
    for j in range(d):
        for i in range(9, H.shape[1]):
            H[j, i] = 0.0
        for i in range(9):
            H[j, i] = Hn[BASE * j + i]
        # a larger bias means a smaller true rate and force
        for i in range(6):
            h = Hn[BASE * j + 9 + i]
            if h != 0.0:
                H[j, 9 + i] -= h
                for c in range(mi):
                    H[j, BASE + c] -= h * J[i, c]
    extras_columns(kind, tables, then, extras, z, d, plus, minus, H)
    return 0


@inner
def back_in_time(
    kind: int, tables: Tables, nav: Array, extras: Array, z: Array, work: Array, then: Array
) -> float:
    """Write to ``then`` (NAV,) the state of the moment that readings of this kind tell of, which
    come late by what is returned, s: position with the velocity, attitude with the rate."""
    copy1(nav, then)
    late = 0.0
    for k in range(tables.function.shape[1]):
        if tables.function[kind, k] == 0:
            break
        if tables.late[kind, k] != 0:
            zero1(work)
            _called(kind, k, tables, nav, extras, z, work)
            late += work[0]
    if late != 0.0:
        phi = local_vector(3)
        C, turn, new = local_matrix(3, 3), local_matrix(3, 3), local_matrix(3, 3)
        for i in range(3):
            then[i] -= late * nav[3 + i]
            phi[i] = -late * nav[15 + i]
        for k in range(9):
            C[k // 3, k % 3] = nav[6 + k]
        exp(phi, turn)
        matmul(C, turn, new)
        for k in range(9):
            then[6 + k] = new[k // 3, k % 3]
    return late


@inner
def _as_of_now(nav: Array, late: float, d: int, Hn: Array) -> None:
    """Rows by the errors of the state ``late`` s ago, turned into those by the errors of now."""
    phi, by_rate = local_vector(3), local_vector(3)
    J = local_matrix(3, 3)
    for i in range(3):
        phi[i] = -late * nav[15 + i]
    left_jacobian(phi, J)
    for j in range(d):
        row = BASE * j
        for i in range(3):
            Hn[row + 3 + i] -= late * Hn[row + i]
            by_rate[i] = 0.0
            for k in range(3):
                by_rate[i] += Hn[row + 6 + k] * nav[6 + 3 * k + i]
        for i in range(3):
            for k in range(3):
                Hn[row + 9 + i] -= late * by_rate[k] * J[k, i]


@inner
def _total(
    kind: int, tables: Tables, nav: Array, extras: Array, z: Array, only: int, r: Array
) -> int:
    """Residual of all functions of a kind (from number ``only`` on), of the state at the moment
    that was read; 1 if it is to be skipped."""
    zero1(r)
    status = 0
    for k in range(only, tables.function.shape[1]):
        if tables.function[kind, k] == 0:
            break
        if tables.late[kind, k] == 0:
            status |= _called(kind, k, tables, nav, extras, z, r)
    return status


@inner
def _called(
    kind: int, k: int, tables: Tables, nav: Array, extras: Array, z: Array, r: Array
) -> int:
    """Function number k of a kind with its own of the extras, and with what is held."""
    address, a = tables.function[kind, k], tables.start[kind, k]
    n = tables.whole[kind, k]
    if n == 0:
        return call_residual(address, nav, extras[a : a + max(1, tables.counts[kind, k])], z, r)
    own = local_vector(MOST_HELD)
    for i in range(n):
        own[i] = tables.held[kind, k, i]
        if math.isnan(own[i]):
            own[i] = extras[a]
            a += 1
    return call_residual(address, nav, own, z, r)


@inner
def _perturb_nav(nav: Array, i: int, step: float, out: Array) -> None:
    """Copy nav with error component i (position, velocity, psi, rate, force) moved by step."""
    copy1(nav, out)
    if i < 6:
        out[i] += step
    elif i < 9:
        phi = local_vector(3)
        zero1(phi)
        phi[i - 6] = step
        C, turn, new = local_matrix(3, 3), local_matrix(3, 3), local_matrix(3, 3)
        for k in range(9):
            C[k // 3, k % 3] = nav[6 + k]
        exp(phi, turn)
        matmul(turn, C, new)
        for k in range(9):
            out[6 + k] = new[k // 3, k % 3]
    else:
        out[i + 6] += step


@inner
def extras_columns(
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
    """Columns of H for the constants and Markov states that the functions of a kind read.

    Functions only add to a residual, so each is differenced alone. Where one tells how late
    readings are, they are of another state, of which the first nine columns of H know. nav: of the
    moment that was read.
    """
    for k in range(tables.function.shape[1]):
        if tables.function[kind, k] == 0:
            break
        a = tables.start[kind, k]
        for c in range(a, a + tables.counts[kind, k]):
            keep, step = extras[c], tables.step[c]
            zero1(plus)
            zero1(minus)
            extras[c] = keep + step
            _called(kind, k, tables, nav, extras, z, plus)
            extras[c] = keep - step
            _called(kind, k, tables, nav, extras, z, minus)
            extras[c] = keep
            for j in range(d):
                change = plus[j] - minus[j]
                if tables.late[kind, k] != 0:
                    change = (plus[0] - minus[0]) * _in_a_second(nav, H[j])
                H[j, BASE + c] -= change / (2 * step)


@inner
def _in_a_second(nav: Array, h: Array) -> float:
    """By how much what is predicted, of slopes h by the state's errors, grows in a second."""
    s = 0.0
    for i in range(3):
        s += h[i] * nav[3 + i]
        for k in range(3):
            s += h[6 + i] * nav[6 + 3 * i + k] * nav[15 + k]
    return s

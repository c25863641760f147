"""Products in blocks against numpy's, and the covariance's steps against the textbook's."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handcal.compiled.covariance import (
    propagate,
    propagation_work,
    symmetrise,
    update_linear,
    update_work,
)
from handcal.compiled.rows import BLOCK, add_product, add_row, blank, padded, product, set_row

# (no Phi of the filter is larger than nine rows; more, to meet every remainder)
SIZES = st.integers(0, 19)


# (not kept on disk: a kept one would hold the products of the day it was made)
@numba.njit
def products(A, X, count, out, added):
    product(A, X, count, out)
    add_product(A, X, count, added)


@numba.njit
def rows(a, X, row, out, added):
    set_row(a, X, row, out)
    add_row(a, X, row, added)


@numba.njit
def carried(P, Phi, B, Phi_e, Phi_psi, e0, work):
    propagate(P, Phi, B, Phi_e, Phi_psi, e0, work)


@numba.njit
def updated(r, H, d, R, P, x, out, work):
    update_linear(r, H, d, R, P, x, out, work)
    symmetrise(P)


def spd(rng, n):
    """A covariance of n states whose sigmas span six decades."""
    L = np.tril(rng.standard_normal((n, n))) + 2 * np.eye(n)
    L *= 10 ** rng.uniform(-3, 3, (n, 1))
    return L @ L.T


@settings(deadline=None, max_examples=60)
@given(m=SIZES, k=SIZES, n=SIZES, seed=st.integers(0, 2**31))
def test_products_of_any_size(m, k, n, seed):
    rng = np.random.default_rng(seed)
    A, X, before = (rng.standard_normal(s) for s in ((m, k), (k, n), (m, n)))
    count = int(rng.integers(0, k + 1))
    out, added = np.full((m, n), np.nan), before.copy()
    products(A, X, count, out, added)
    exact = A[:, :count] @ X[:count]
    # each of at most 19 products and sums rounds by half a unit
    bound = 40 * np.finfo(float).eps * (np.abs(A) @ np.abs(X) + np.abs(before) + 1)
    assert np.all(np.abs(out - exact) <= bound)
    assert np.all(np.abs(added - before - exact) <= bound)


@settings(deadline=None, max_examples=40)
@given(m=st.integers(1, 9), n=SIZES, a=st.floats(-1e3, 1e3), seed=st.integers(0, 2**31))
def test_rows_of_any_length(m, n, a, seed):
    rng = np.random.default_rng(seed)
    X, before = rng.standard_normal((m, n)), rng.standard_normal(n)
    row = int(rng.integers(0, m))
    out, added = np.full(n, np.nan), before.copy()
    rows(a, X, row, out, added)
    np.testing.assert_array_equal(out, a * X[row])
    np.testing.assert_allclose(added, before + a * X[row], rtol=1e-15, atol=1e-12)


@given(n=st.integers(0, 100))
def test_padding_is_the_least_that_leaves_no_remainder(n):
    assert padded(n) % BLOCK == 0
    assert 0 <= padded(n) - n < BLOCK


def test_padded_rows_begin_where_cache_lines_do():
    for shape in ((16,), (16, 16), (6, 48)):
        room = blank(*shape)
        assert room.shape == shape
        assert not room.any()
        assert room.ctypes.data % 64 == 0
        assert room.flags.c_contiguous


@pytest.mark.parametrize(("constants", "markov"), [(0, 0), (4, 0), (0, 6), (5, 7)])
@pytest.mark.parametrize("wide", [False, True])
def test_transition_in_blocks_is_the_dense_one(constants, markov, wide):
    rng = np.random.default_rng(constants + markov)
    n, imu = 15 + constants + markov, constants - constants // 2
    size = padded(n) if wide else n
    Phi = np.eye(9, 15 + imu) + 0.1 * rng.standard_normal((9, 15 + imu))
    Phi_e, Phi_psi = rng.standard_normal((markov, markov)), rng.standard_normal((markov, 3))
    F = np.eye(n)
    F[:9, : 15 + imu] = Phi
    F[15 + constants :, 15 + constants :] = Phi_e
    F[15 + constants :, 6:9] = Phi_psi
    before = spd(rng, n)
    P = blank(size, size)
    P[:n, :n] = before
    work = propagation_work(size, markov)
    carried(P, Phi, np.empty((0, 0)), Phi_e, Phi_psi, 15 + constants, work)
    exact = F @ before @ F.T
    sigma = np.sqrt(np.abs(F) @ np.diag(before) * np.abs(F).sum(axis=1))
    np.testing.assert_allclose(P[:n, :n] / np.outer(sigma, sigma), exact / np.outer(sigma, sigma),
                               rtol=0, atol=1e-11)  # fmt: skip
    np.testing.assert_array_equal(P, P.T)
    assert not P[n:].any()


@pytest.mark.parametrize("seed", range(5))
def test_update_is_the_joint_one_of_the_textbook(seed):
    rng = np.random.default_rng(seed)
    n, d = 17, 6
    size = padded(n)
    before, R = spd(rng, n), rng.uniform(0.1, 2.0, d)
    H = np.zeros((d, size))
    H[:, :n] = rng.standard_normal((d, n)) * (rng.random((d, n)) < 0.4)
    r = rng.standard_normal(d)
    P, x = blank(size, size), blank(size)
    P[:n, :n] = before
    out = np.empty(d), np.empty(d), np.empty(1), np.empty(1)
    updated(r, H, d, R, P, x, out, update_work(size, d))
    h = H[:, :n]
    S = h @ before @ h.T + np.diag(R)
    K = np.linalg.solve(S, h @ before).T
    A = np.eye(n) - K @ h
    exact = A @ before @ A.T + K @ np.diag(R) @ K.T
    sigma = np.sqrt(np.diag(before))
    np.testing.assert_allclose(P[:n, :n] / np.outer(sigma, sigma), exact / np.outer(sigma, sigma),
                               rtol=0, atol=1e-8)  # fmt: skip
    np.testing.assert_allclose(x[:n] / sigma, K @ r / sigma, rtol=0, atol=1e-7)
    np.testing.assert_allclose(out[0], r, rtol=1e-14)
    np.testing.assert_allclose(out[1], np.sqrt(np.diag(S)), rtol=1e-12)
    nis = r @ np.linalg.solve(S, r)
    np.testing.assert_allclose(out[2], nis, rtol=1e-7)
    loglik = -0.5 * (nis + np.linalg.slogdet(2 * np.pi * S)[1])
    np.testing.assert_allclose(out[3], loglik, rtol=1e-7)
    assert not P[n:].any()

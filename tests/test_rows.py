"""Products in blocks and in plain loops against numpy's, and the covariance's steps against the
textbook's; without numba's private interface a calibration is the same."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handcal.compiled import generated, loops
from handcal.compiled.covariance import (
    propagate,
    propagation_work,
    update_linear,
    update_work,
)
from handcal.compiled.rows import BLOCK, blank, padded, symmetrise

# (no Phi of the filter is larger than nine rows; more, to meet every remainder)
SIZES = st.integers(0, 19)


# (not kept on disk: a kept one would hold the products of the day it was made)
def compiled(module):
    """Products and rows as compiled code calls them."""
    set_product, add_product = module.set_product, module.add_product
    set_row, add_row, add_outer = module.set_row, module.add_row, module.add_outer

    @numba.njit
    def products(A, X, count, out, added):
        set_product(A, X, count, out)
        add_product(A, X, count, added)

    @numba.njit
    def rows(a, X, row, out, added, x, y, outer):
        set_row(a, X, row, out)
        add_row(a, X, row, added)
        add_outer(x, y, y, x, outer)

    @numba.njit
    def in_place(a, x):
        set_row(a, x, 0, x)

    set_listed, add_listed = module.set_listed, module.add_listed
    add_gram, squares = module.add_gram, module.squares

    @numba.njit
    def sums(at, value, begin, end, X, out, added):
        set_listed(at, value, begin, end, X, out)
        add_listed(at, value, begin, end, X, added)
        return squares(out)

    @numba.njit
    def gram(X, first, count, out):
        add_gram(X, first, count, out)

    mean_of_both = module.symmetrise

    @numba.njit
    def symmetric(P):
        mean_of_both(P)

    nonzero = module.nonzero

    @numba.njit
    def places(x, at):
        return nonzero(x, at)

    return products, rows, in_place, sums, gram, places, symmetric


WRITTEN = [compiled(generated), compiled(loops)]
either = pytest.mark.parametrize("written", WRITTEN, ids=["generated", "loops"])


@numba.njit
def carried(P, Phi, B, Phi_e, Phi_psi, e0, work):
    propagate(P, Phi, B, Phi_e, Phi_psi, e0, work)
    symmetrise(P)


@numba.njit
def updated(r, H, d, R, P, x, out, work):
    update_linear(r, H, d, R, P, x, out, work)
    symmetrise(P)


def spd(rng, n):
    """A covariance of n states whose sigmas span six decades."""
    L = np.tril(rng.standard_normal((n, n))) + 2 * np.eye(n)
    L *= 10 ** rng.uniform(-3, 3, (n, 1))
    return L @ L.T


@either
@settings(deadline=None, max_examples=60)
@given(m=SIZES, k=SIZES, n=SIZES, seed=st.integers(0, 2**31))
def test_products_of_any_size(written, m, k, n, seed):
    rng = np.random.default_rng(seed)
    A, X, before = (rng.standard_normal(s) for s in ((m, k), (k, n), (m, n)))
    count = int(rng.integers(0, k + 1))
    out, added = np.full((m, n), np.nan), before.copy()
    written[0](A, X, count, out, added)
    exact = A[:, :count] @ X[:count]
    # each of at most 19 products and sums rounds by half a unit
    bound = 40 * np.finfo(float).eps * (np.abs(A) @ np.abs(X) + np.abs(before) + 1)
    assert np.all(np.abs(out - exact) <= bound)
    assert np.all(np.abs(added - before - exact) <= bound)


@either
@settings(deadline=None, max_examples=40)
@given(m=st.integers(1, 9), n=SIZES, a=st.floats(-1e3, 1e3), seed=st.integers(0, 2**31))
def test_rows_of_any_length(written, m, n, a, seed):
    rng = np.random.default_rng(seed)
    X, before = rng.standard_normal((m, n)), rng.standard_normal(n)
    row = int(rng.integers(0, m))
    out, added = np.full(n, np.nan), before.copy()
    x, y, outer = rng.standard_normal(n), rng.standard_normal(n), rng.standard_normal((n, n))
    twice = outer + (np.outer(x, y) + np.outer(y, x))
    written[1](a, X, row, out, added, x, y, outer)
    np.testing.assert_allclose(outer, twice, rtol=1e-15, atol=1e-14)
    np.testing.assert_array_equal(out, a * X[row])
    written[2](a, out)
    np.testing.assert_array_equal(out, a * (a * X[row]))
    np.testing.assert_allclose(added, before + a * X[row], rtol=1e-15, atol=1e-12)


@either
@settings(deadline=None, max_examples=40)
@given(terms=st.integers(0, 9), n=st.integers(0, 75), seed=st.integers(0, 2**31))
def test_listed_sums_of_any_length(written, terms, n, seed):
    rng = np.random.default_rng(seed)
    X, before = rng.standard_normal((5, n)), rng.standard_normal(n)
    at, value = rng.integers(0, 5, terms + 2), rng.standard_normal(terms + 2)
    out, added = np.full(n, np.nan), before.copy()
    square = written[3](at, value, 1, 1 + terms, X, out, added)
    exact = value[1 : 1 + terms] @ X[at[1 : 1 + terms]]
    np.testing.assert_allclose(out, exact, rtol=0, atol=1e-13)
    np.testing.assert_allclose(added, before + exact, rtol=0, atol=1e-13)
    assert square == pytest.approx(exact @ exact, rel=1e-12, abs=1e-20)


@either
@settings(deadline=None, max_examples=20)
@given(count=st.integers(0, 9), blocks=st.integers(0, 4), seed=st.integers(0, 2**31))
def test_lower_half_of_a_gram_matrix(written, count, blocks, seed):
    rng = np.random.default_rng(seed)
    n = BLOCK * blocks
    X, before = rng.standard_normal((9, n)), rng.standard_normal((n, n))
    out = before.copy()
    first = BLOCK * int(rng.integers(0, blocks + 1))
    written[4](X, first, count, out)
    exact = before.copy()
    exact[first:] += (X[:count].T @ X[:count])[first:]
    np.testing.assert_allclose(np.tril(out), np.tril(exact), rtol=0, atol=1e-13)


@either
@settings(deadline=None, max_examples=40)
@given(x=st.lists(st.sampled_from([0.0, -0.0, 1e-300, -2.0, np.inf, np.nan]), max_size=40))
def test_places_that_are_not_zero(written, x):
    x = np.array(x)
    at = np.full(len(x), -1)
    count = written[5](x, at)
    np.testing.assert_array_equal(at[:count], np.flatnonzero(x))
    assert (at[count:] == -1).all()


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


@either
@settings(deadline=None, max_examples=60)
@given(m=st.integers(0, 35), more=st.integers(0, 9), seed=st.integers(0, 2**31))
def test_mean_of_a_matrix_and_what_it_is_turned_over(written, m, more, seed):
    before = np.random.default_rng(seed).standard_normal((m, m + more))
    P = before.copy()
    written[6](P)
    np.testing.assert_array_equal(P[:, :m], 0.5 * (before[:, :m] + before[:, :m].T))
    np.testing.assert_array_equal(P[:, m:], before[:, m:])


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


def test_of_a_covariance_that_is_lost_no_density_is_told():
    """Of two variances that are negative either, whose product is not."""
    P, x, H = blank(8, 8), blank(8), blank(2, 8)
    P[0, 0] = P[1, 1] = -2.0
    H[0, 0] = H[1, 1] = 1.0
    out = np.empty(2), np.empty(2), np.empty(1), np.empty(1)
    updated(np.ones(2), H, 2, np.ones(2), P, x, out, update_work(8, 2))
    assert np.isnan(out[3]).all()


RECORDING = Path(__file__).parents[1] / "recordings" / "sealed_01.mcap"
CALIBRATION = """
import sys
import handcal as hc
from handcal.compiled.linking import LINKED
result = hc.calibrate(sys.argv[1], effects=["gyro_scale"])
print(int(LINKED), *(x for p in result.parameters for x in (p.value, p.sigma)))
"""


@pytest.mark.prove  # (all is compiled once more: a minute)
def test_a_calibration_in_plain_loops_is_the_same(tmp_path):
    answers = []
    for plain in ("", "1"):
        env = os.environ | {"HANDCAL_PLAIN": plain, "NUMBA_CACHE_DIR": str(tmp_path / f"_{plain}")}
        command = [sys.executable, "-c", CALIBRATION, str(RECORDING)]
        run = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
        linked, *numbers = map(float, run.stdout.split())
        assert bool(linked) == (not plain)
        answers.append(numbers)
    # (sums in another order, passed on through a few rounds of a fit)
    one, other = (np.reshape(numbers, (-1, 2)) for numbers in answers)
    assert np.all(np.abs(one - other) < 1e-6 * one[:, 1:])

"""The filter over the moving states alone: its transition as a list, scalars an epoch at a time,
and means without the columns they came with."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from worlds import recording_of

from handcal.compiled.sparse import Entries, list_entries, no_entries, times_entries, turn_over
from handcal.effects import select
from handcal.estimate import evidence
from handcal.estimate.adjoint import backward
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.evidence import Reduction, means, reduce, reduced_pass
from handcal.estimate.model import Fitted
from handcal.estimate.noise_levels import Score
from handcal.estimate.smoother import smoothed_of
from handcal.estimate.transfer import linearised, moved_to
from handcal.types import Array
from handcal_sim import simulate
from handcal_sim.phone import Phone, capture_pose, consumer_phone, trusted_reference


@numba.njit
def _both(
    Phi: Array,
    B: Array,
    Phi_e: Array,
    Phi_psi: Array,
    X: Array,
    out: tuple[Array, Array],
    entries: Entries,
    turned: Entries,
) -> None:
    m = len(X)
    list_entries(Phi, B, Phi_e, Phi_psi, entries)
    turn_over(entries, m, turned)
    times_entries(entries, X, out[0])
    times_entries(turned, X, out[1])


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("e", [0, 5])
def test_a_listed_transition_is_the_dense_one(e: int, coupled: bool) -> None:
    rng = np.random.default_rng(e)
    m = 9 + e
    F = rng.standard_normal((m, m)) * (rng.random((m, m)) < 0.3)
    F[0], F[9:, :6] = 0.0, 0.0
    F[:9, 9:] *= coupled
    Phi = np.hstack([F[:9, :9], rng.standard_normal((9, 4))])
    B = np.ascontiguousarray(F[:9, 9:] if coupled else np.zeros((9, 0)))
    own = [np.ascontiguousarray(F[9:, c]) for c in (slice(9, m), slice(6, 9))]
    X = rng.standard_normal((m, 11))
    out = np.full((m, 11), np.nan), np.full((m, 11), np.nan)
    _both(Phi, B, *own, X, out, no_entries(m), no_entries(m))
    np.testing.assert_allclose(out[0], F @ X, rtol=0, atol=1e-12)
    np.testing.assert_allclose(out[1], F.T @ X, rtol=0, atol=1e-12)


@pytest.fixture(scope="module")
def compared() -> Fitted:
    """A device beside a trusted one, with effects, a walk and a memory: nothing is navigated."""
    world = simulate("free-hand", seed=3, duration_s=8.0, phone=_beside)
    wanted = select(("gyro_scale", "accel_scale", "gyro_bias_walk", "lever_arm"))
    f = moved_to(started(case_of(recording_of(world, "reference"))), wanted)
    constants = f.trajectory.constants + 1e-3 * np.random.default_rng(0).normal(
        size=len(f.trajectory.constants)
    )
    return linearised(f, replace(f.trajectory, constants=constants), wanted)


def test_where_nothing_is_navigated_the_pass_does_without(compared: Fitted) -> None:
    """Evidence, slopes and means are those with position, velocity and attitude among the moving
    states, of which no reading says anything."""
    lean, whole = (reduce(compared.linear, whole=own) for own in (False, True))
    assert (lean.navigation, whole.navigation) == (0, 9)
    names = [lv.name for lv in compared.problem.levels]
    told = [Score(r, compared.levels, names)(compared.levels) for r in (lean, whole)]
    assert told[0][0] == pytest.approx(told[1][0], abs=1e-6)
    np.testing.assert_allclose(told[0][1], told[1][1], rtol=1e-7, atol=1e-7)
    x, y = (
        smoothed_of(reduced_pass(r, compared.levels, keep=True, wide=False)) for r in (lean, whole)
    )
    assert float(np.abs(y[:, :9]).max()) > 1e-4
    np.testing.assert_allclose(x, y, rtol=1e-7, atol=1e-9)


def _beside(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), heading=None, reference=trusted_reference(rng))


def _seen(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), pose=capture_pose(rng))


@pytest.fixture(scope="module")
def marker() -> tuple[Reduction, dict[str, float]]:
    """Poses, six numbers each, with two effects and a bias that walks."""
    world = simulate("free-hand", seed=1, duration_s=10.0, phone=_seen)
    wanted = select(("lever_arm", "gyro_scale", "gyro_bias_walk"))
    f = moved_to(started(case_of(recording_of(world, "pose"))), wanted)
    return reduce(f.linear), dict(f.levels)


def test_scalars_of_an_epoch_in_several_parts(
    marker: tuple[Reduction, dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many innovations are added up at once: of six in an epoch, four and two."""
    whole = reduced_pass(*marker)
    monkeypatch.setattr(evidence, "TOGETHER", 4)
    parts = reduced_pass(*marker)
    assert parts.log_evidence == pytest.approx(whole.log_evidence, abs=1e-6)
    np.testing.assert_allclose(parts.S, whole.S, rtol=1e-9)
    scale = np.sqrt(whole.S)[:, None]
    np.testing.assert_allclose(parts.nu / scale, whole.nu / scale, rtol=1e-7, atol=1e-6)


def test_means_are_those_of_the_columns(marker: tuple[Reduction, dict[str, float]]) -> None:
    whole = reduced_pass(*marker, keep=True)
    lean = reduced_pass(*marker, keep=True, wide=False)
    assert lean.X.shape == (1, *whole.X.shape[1:])
    assert lean.log_evidence == whole.log_evidence
    np.testing.assert_array_equal(lean.P, whole.P)
    exact = whole.X @ np.r_[1.0, whole.w][:, None]
    size = np.sqrt(np.einsum("kii->ki", whole.P))[:, :, None]
    away = np.abs(means(lean) - exact) / np.maximum(size, 1e-12)
    assert away.max() < 1e-6


def test_innovations_do_not_depend_on_what_waits_beside_them(
    marker: tuple[Reduction, dict[str, float]],
) -> None:
    """Against each scalar for itself, as one epoch each: the textbook's order."""
    reduction, levels = marker
    done = reduced_pass(reduction, levels, keep=True)
    j = len(reduction.linear.t) // 2
    first, end = reduction.first[j : j + 2]
    R = done.arrays.R[first:end]
    P, X = _before(done, j)
    for q, r in zip(range(first, end), R, strict=True):
        h = reduction.h[q]
        S = h @ P @ h + r
        nu = reduction.g[q] - h @ X
        assert done.S[q] == pytest.approx(S, rel=1e-6)
        np.testing.assert_allclose(done.nu[q], nu, rtol=1e-6, atol=1e-6 * np.sqrt(S))
        K = P @ h / S
        X = X + np.outer(K, nu)
        P = P - np.outer(K, h @ P)


def _before(done: evidence.ReducedPass, j: int) -> tuple[Array, Array]:
    """P and X of an epoch before it was observed, from the one before."""
    a, m = done.arrays, done.P.shape[1]
    F = np.zeros((m, m))
    F[:9, :9], F[9:, 9:], F[9:, 6:9] = a.A[j][:, :9], a.Phi_e[j], a.Phi_psi[j]
    F[:9, 9:] = a.B[j] if a.B.shape[2] else 0.0
    P, X = F @ done.P[j - 1] @ F.T, F @ done.X[j - 1]
    P[:9, :9] += a.Q[j]
    P[9:, 9:] += a.Q_e[j]
    X[:9] += a.D[j]
    X[9:, 0] += a.d_e[j]
    return P, X


def test_the_adjoint_gives_what_the_columns_gave(
    marker: tuple[Reduction, dict[str, float]],
) -> None:
    """Smoothed means from one column are the first of those with the constants' spread."""
    done = reduced_pass(*marker, keep=True)
    k, m, columns = done.X.shape
    one, all_ = np.empty((k, m, 1)), np.empty((k, m, columns))
    backward(done, False, one, np.empty((0, m, m)), spread=False)
    backward(done, True, all_, np.empty((k, m, m)))
    scale = np.abs(all_[:, :, :1]).max(axis=0)
    np.testing.assert_allclose(one / scale, all_[:, :, :1] / scale, rtol=0, atol=1e-7)

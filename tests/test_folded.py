"""Headings folded into windows, against the pass in which each is an epoch of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import select
from handcal.effects.heading_correlated_noise import SIGMA, TAU
from handcal.estimate import smoother
from handcal.estimate.adjoint import backward
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.folded import fold, unfolded
from handcal.estimate.linear import linearise_about
from handcal.estimate.model import Fitted
from handcal.estimate.transfer import moved_to
from handcal_sim import simulate

# Nats, and standard deviations (the issue that asked for it).
NATS, SIGMAS = 0.05, 0.02
WORLDS = [("z-turn", 0), ("three-turns", 0), ("free-hand", 0), ("free-hand", 1)]
EFFECTS = ("gyro_scale", "heading_delay", "gyro_bias_walk")


@pytest.fixture(scope="module", params=WORLDS, ids=lambda w: f"{w[0]}-{w[1]}")
def fit(request: pytest.FixtureRequest) -> Fitted:
    name, seed = request.param
    world = simulate(name, seed=seed, duration_s=30.0)
    (part,) = fitted([started(case_of(recording_of(world, "heading")))], ()).parts
    return moved_to(part, select(EFFECTS))


def test_the_same_evidence_and_constants(fit: Fitted) -> None:
    folded, each = reduce(fit.linear), reduce(fit.linear, folds=False)
    assert len(folded.linear.t) < 0.5 * len(each.linear.t)
    a, b = reduced_pass(folded, fit.levels), reduced_pass(each, fit.levels)
    assert abs(a.log_evidence - b.log_evidence) < NATS
    sigma = np.linalg.norm(b.spread, axis=1)
    assert np.abs((a.w - b.w) / sigma).max() < SIGMAS
    ratio = np.linalg.norm(a.spread, axis=1) / sigma
    assert np.abs(ratio - 1.0).max() < SIGMAS


def test_the_same_trajectory(fit: Fitted) -> None:
    """Smoothed at every epoch: within a fiftieth of the sigma that the whole filter has there."""
    x, _ = smoother.smoothed_mean(fit.linear, fit.levels)
    forward = smoother.forward(fit.linear, fit.levels)
    exact, P = smoother.smooth(fit.linear, fit.levels, forward)
    sigma = np.sqrt(np.einsum("kii->ki", P)[:, :9])
    away = np.abs(x[:, :9] - exact[:, :9]) / sigma
    assert np.quantile(away, 0.99) < SIGMAS
    assert away.max() < 5 * SIGMAS


def test_nothing_is_folded_that_is_looked_at_seldom() -> None:
    world = simulate("free-hand", seed=0, duration_s=10.0)
    (part,) = fitted([started(case_of(recording_of(world)))], ()).parts
    assert fold(part.linear) is None


def test_noise_with_a_memory_does_not_rest_within_a_window(fit: Fitted) -> None:
    """It is linear, so what the trajectory says of it changes no evidence. (As if it rested for
    0.07 s, a recording that had such noise had 870 nats less than without folding.)"""
    f = moved_to(fit, select(("heading_correlated_noise",)))
    levels = {**f.levels, SIGMA: 0.15, TAU: 2.0}
    noise, values = f.trajectory.markov[:, -1], []
    for at in (0.0 * noise, 0.05 * np.random.default_rng(0).standard_normal(len(noise))):
        markov = np.column_stack([f.trajectory.markov[:, :-1], at])
        there = linearise_about(f.problem, f.about.start, replace(f.trajectory, markov=markov))
        values.append(reduced_pass(reduce(there), levels).log_evidence)
    assert abs(values[1] - values[0]) < 1e-6


def test_unfolding_gives_back_what_the_windows_were_given(fit: Fitted) -> None:
    """At the epochs at which a window begins, nothing is changed."""
    done = reduced_pass(reduce(fit.linear), fit.levels, keep=True)
    f = done.reduction.folded
    assert f is not None
    k, m = done.X.shape[:2]
    r = np.empty((k, m, 1))
    backward(done, False, r, np.empty((0, m, m)), spread=False)
    x = np.random.default_rng(0).standard_normal((k, fit.linear.problem.size))
    np.testing.assert_allclose(unfolded(f, fit.linear.t, x)[f.start], x, atol=1e-9)


def test_a_rough_start_is_smoothed_within_the_windows_too(fit: Fitted) -> None:
    """Markov states that were off within a window stayed off: they excited effects, and a fit
    with products of forces ran away (free hand, seed 5)."""
    nominal = fit.linear.trajectory
    rng = np.random.default_rng(0)
    rough = nominal.markov + 0.02 * rng.standard_normal(nominal.markov.shape)
    linear = linearise_about(fit.linear.problem, fit.linear.start, replace(nominal, markov=rough))
    there, _, _ = smoother.relinearise(linear, fit.levels)
    away = (
        there.trajectory.markov - smoother.relinearise(fit.linear, fit.levels)[0].trajectory.markov
    )
    assert np.abs(away).max() < 0.002

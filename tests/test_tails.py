"""Priors with tails, against sums over all combinations of scales, and integrals by quadrature."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from handcal.estimate.heavy_tails import log_evidence, tailed, wider
from handcal.estimate.prior_scales import LOG_SHARES, SCALES
from handcal.estimate.quadratic import Quadratic, posterior


def quadratic(truth: list[float], sigma: float, seed: int, mixed: float = 0.0) -> Quadratic:
    """Two effects, of two and of one parameter, each known to ``sigma``."""
    rng = np.random.default_rng(seed)
    mix = np.eye(3) + mixed * rng.standard_normal((3, 3))
    G = mix @ mix.T / sigma**2
    b = G @ np.array(truth) + np.linalg.cholesky(G) @ rng.standard_normal(3)
    return Quadratic((("a", "x"), ("a", "y"), ("b", "x")), 1.7, b, G)


def summed(q: Quadratic) -> float:
    """Over every combination of scales."""
    terms = []
    for i, k in itertools.product(range(3), repeat=2):
        wide = np.diag([SCALES[i], SCALES[i], SCALES[k]])
        terms.append(LOG_SHARES[i] + LOG_SHARES[k] + posterior(q, np.arange(3), wide).log_evidence)
    return float(logsumexp(terms))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "truth", [[0.3, -0.5, 0.2], [14.0, 3.0, 0.1], [0.1, 0.0, -60.0], [6.0, -9.0, 11.0]]
)
def test_evidence_is_the_sum_over_the_scales(truth: list[float], seed: int) -> None:
    """One by one is exact where the recording tells the effects apart."""
    q = quadratic(truth, 0.1, seed)
    assert tailed(q, np.arange(3)).log_evidence == pytest.approx(summed(q), abs=1e-6)
    # (near the usual scale the search leaves the wide ones out)
    assert log_evidence(q, np.arange(3)) == pytest.approx(summed(q), abs=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_effects_that_depend_on_each_other(seed: int) -> None:
    """Within a tenth of a nat where they are known to half a sigma and mixed."""
    q = quadratic([14.0, 3.0, 0.1], 0.3, seed, mixed=0.2)
    assert tailed(q, np.arange(3)).log_evidence == pytest.approx(summed(q), abs=0.1)


def test_one_parameter_against_an_integral() -> None:
    """The evidence of one parameter is the integral of likelihood times the mixture."""
    b, G, a = 8.0, 1.5, -0.4
    q = Quadratic((("a", "x"),), a, np.array([b]), np.array([[G]]))
    u = np.linspace(-400.0, 400.0, 800_001)
    prior = sum(
        math.exp(w) / (s * math.sqrt(2 * math.pi)) * np.exp(-0.5 * (u / s) ** 2)
        for s, w in zip(SCALES, LOG_SHARES, strict=True)
    )
    whole = np.sum(prior * np.exp(a + b * u - 0.5 * G * u * u)) * (u[1] - u[0])
    assert tailed(q, np.arange(1)).log_evidence == pytest.approx(math.log(whole), abs=1e-6)


@pytest.mark.parametrize("at", [0.5, 2.0, 2.6, 3.0, 4.0, 14.0, -3.1])
def test_the_mean_is_that_over_the_scales(at: float) -> None:
    """Mean and variance of the posterior under the mixture, by quadrature."""
    G = 4.0
    found = tailed(Quadratic((("a", "x"),), 0.0, np.array([G * at]), np.array([[G]])), np.arange(1))
    u = np.linspace(-60.0, 60.0, 240_001)
    log_prior = logsumexp(
        [w - math.log(s) - 0.5 * (u / s) ** 2 for s, w in zip(SCALES, LOG_SHARES, strict=True)],
        axis=0,
    )
    weight = np.exp(log_prior + G * at * u - 0.5 * G * u * u - 0.5 * G * at**2)
    weight /= weight.sum()
    mean = float(weight @ u)
    # (scales of less than a thousandth are left out)
    assert found.mean[0] == pytest.approx(mean, abs=2e-3)
    # (and the covariance of narrower ones stays)
    assert 0.97 < found.covariance[0, 0] / float(weight @ (u - mean) ** 2) < 1.3


def test_how_much_likelier_all_scales_make_what_is_large() -> None:
    for values in ([0.2], [3.5], [0.1, 9.0, -2.0]):
        each = [
            w + sum(norm.logpdf(v, scale=s) for v in values)
            for s, w in zip(SCALES, LOG_SHARES, strict=True)
        ]
        more = logsumexp(each) - each[0]
        assert wider(len(values), sum(v * v for v in values)) == pytest.approx(more)


def test_a_large_error_is_not_pulled_towards_zero() -> None:
    """14 usual sizes, known to one: a normal prior would halve it, tails leave all but a little."""
    q = Quadratic((("a", "x"),), 0.0, np.array([14.0]), np.array([[1.0]]))
    normal, wide = posterior(q, np.arange(1)), tailed(q, np.arange(1))
    assert normal.mean[0] == pytest.approx(7.0)
    assert wide.mean[0] > 13.0
    assert wide.log_evidence > normal.log_evidence + 20.0


def test_a_faint_effect_pays_what_it_paid() -> None:
    """Within the share of devices that are usual: a tenth of a nat, more or less."""
    for truth in (0.0, 0.5, 1.5):
        q = Quadratic((("a", "x"),), 0.0, np.array([truth * 9.0]), np.array([[9.0]]))
        normal, wide = posterior(q, np.arange(1)), tailed(q, np.arange(1))
        assert abs(wide.log_evidence - normal.log_evidence) < 0.15


def test_a_term_found_in_the_recording_has_no_tails() -> None:
    q = Quadratic((("gyro_x += k * t", "k"),), 0.0, np.array([14.0]), np.array([[1.0]]))
    assert tailed(q, np.arange(1)).mean[0] == posterior(q, np.arange(1)).mean[0]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("truth", [[0.5, 0.0, 0.0], [0.4, -0.6, 0.0], [0.0, 0.0, 0.0]])
def test_of_an_effect_any_parameter_may_be_zero(truth: list[float], seed: int) -> None:
    """The mean over all subsets, exact where the recording tells the parameters apart."""
    rng, axes = np.random.default_rng(seed), np.arange(3)
    G = np.diag(1.0 / np.array([0.02, 0.03, 0.05]) ** 2)
    b = G @ np.array(truth) + np.sqrt(np.diag(G)) * rng.standard_normal(3)
    q = Quadratic(tuple(("gyro_scale", axis) for axis in "xyz"), 0.3, b, G)
    sets = itertools.chain.from_iterable(itertools.combinations(range(3), n) for n in range(4))
    each = [posterior(q, np.array(s, dtype=np.int64)).log_evidence if s else q.a for s in sets]
    mean = float(logsumexp(each)) - 3.0 * math.log(2.0) + LOG_SHARES[0]
    assert log_evidence(q, axes) == pytest.approx(mean, abs=1e-6)
    # (the wide scales, and that of all zero each has its share, are a tenth of the whole)
    assert tailed(q, axes).log_evidence == pytest.approx(mean, abs=0.3)


def test_gravity_has_no_tails() -> None:
    """Thirty times what is usual is nothing that the tails forgive."""
    q = Quadratic((("gravity", "delta"),), 0.0, np.array([12000.0]), np.array([[400.0]]))
    assert tailed(q, np.arange(1)).log_evidence == pytest.approx(
        posterior(q, np.arange(1)).log_evidence, abs=1e-9
    )


def test_what_has_one_parameter_is_there_or_not() -> None:
    q = Quadratic((("pose_scale", "scale"),), 0.0, np.array([2.0]), np.array([[400.0]]))
    plain = posterior(q, np.arange(1)).log_evidence + LOG_SHARES[0]
    assert log_evidence(q, np.arange(1)) == pytest.approx(plain, abs=1e-9)

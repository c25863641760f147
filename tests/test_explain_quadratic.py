"""One pass of the filter holds the evidence of every subset of effects: against single passes
and against dense Gaussian algebra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import select
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.evidence import ReducedPass, reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.prior_root import prior_root
from handcal.estimate.quadratic import (
    Local,
    Quadratic,
    given,
    local,
    log_evidence,
    posterior,
    total,
)
from handcal.estimate.scan import scan
from handcal.estimate.transfer import moved_to
from handcal.laws import weighing
from handcal.types import Array, IntArray
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, consumer_phone, with_rate

# Of the readings, of an observation, and of both kinds of time.
EFFECTS = ("gyro_scale", "accel_scale", "lever_arm", "size_effect", "heading_delay", "accel_delay")
SUBSETS = [
    (),
    *[(e,) for e in EFFECTS],
    ("gyro_scale", "lever_arm"),
    ("accel_delay", "heading_delay", "size_effect"),
    EFFECTS,
]


def _slow(rng: np.random.Generator) -> Phone:
    phone = with_rate(consumer_phone(rng), 50.0)
    assert phone.heading is not None
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(10.0)))


def _base(seed: int) -> Model:
    concealed = {"gyro_scale": [0.02, -0.01, 0.015], "lever_arm": [0.05, -0.04, 0.06]}
    world = simulate("free-hand", seed=seed, duration_s=15.0, phone=_slow, effects=concealed)
    return fitted([started(case_of(recording_of(world, "heading")))], ())


@pytest.fixture(scope="module")
def bases() -> list[Model]:
    """Two recordings of a device with two effects, fitted with none."""
    return [_base(seed) for seed in range(2)]


@pytest.fixture(scope="module")
def wide(bases: list[Model]) -> Quadratic:
    """All effects about the fit with none."""
    f = moved_to(bases[0].parts[0], select(EFFECTS))
    return local(reduced_pass(reduce(f.linear), f.levels), frozenset(EFFECTS)).quadratic


@pytest.fixture(scope="module")
def fit(bases: list[Model]) -> tuple[Model, ReducedPass, Local]:
    """The first recording fitted with the right effects, which are not zero where it is
    linearised."""
    model = fitted(bases[0].parts, select(("gyro_scale", "lever_arm")), noise_rounds=0)
    done = reduced_pass(reduce(model.parts[0].linear), model.parts[0].levels)
    return model, done, local(done, frozenset(model.ids))


def _places(q: Quadratic, ids: Sequence[str]) -> IntArray:
    return np.array([i for i, n in enumerate(q.names) if n[0] in ids], dtype=np.int64)


def _dense(q: Quadratic, index: IntArray, P: Array) -> tuple[float, Array, Array]:
    """Evidence, mean and covariance with a prior covariance P (m, m), which may be singular."""
    b, G = q.b[index], q.G[np.ix_(index, index)]
    M = np.eye(len(index)) + P @ G
    covariance = np.linalg.solve(M, P)
    value = q.a + 0.5 * float(b @ covariance @ b) - 0.5 * float(np.linalg.slogdet(M)[1])
    return value, covariance @ b, covariance


def _value(q: Quadratic, u: Array) -> float:
    return float(q.a + q.b @ u - 0.5 * u @ q.G @ u)


def _made_up(names: Sequence[tuple[str, str]], rng: np.random.Generator) -> Quadratic:
    k = len(names)
    X = rng.normal(size=(k + 2, k))
    y = rng.normal(size=k + 2)
    return Quadratic(tuple(names), float(-0.5 * y @ y), X.T @ y, X.T @ X)


@pytest.mark.parametrize("subset", SUBSETS, ids="+".join)
def test_evidence_of_a_subset_is_that_of_its_own_problem(
    bases: list[Model], wide: Quadratic, subset: tuple[str, ...]
) -> None:
    """A problem with these effects alone, about the same trajectory, filtered by itself."""
    part = moved_to(bases[0].parts[0], select(subset))
    alone = reduced_pass(reduce(part.linear), part.levels).log_evidence
    assert log_evidence(wide, _places(wide, subset)) == pytest.approx(alone, abs=1e-6)


def test_subsets_differ(wide: Quadratic) -> None:
    """Or the test above would show nothing."""
    alone = [log_evidence(wide, _places(wide, s)) for s in SUBSETS]
    assert min(abs(a - b) for i, a in enumerate(alone) for b in alone[:i]) > 0.01


def test_a_scan_counts_all_evidence_alike(bases: list[Model], wide: Quadratic) -> None:
    """Innovations that scatter more than the filter says are worth less, never more: a power of
    the likelihood, whatever the effect."""
    found = scan(bases[0], select(EFFECTS))
    assert found.names == wide.names
    assert 0.0 < found.worth <= 1.0
    assert found.a == pytest.approx(wide.a, abs=1e-6)
    np.testing.assert_allclose(found.b, found.worth * wide.b, rtol=1e-9)
    np.testing.assert_allclose(found.G, found.worth * wide.G, rtol=1e-9, atol=1e-9)
    worths = [replace(wide, worth=w) for w in (0.9, 0.5)]
    assert total(worths).worth == 0.5


def test_about_effects_that_are_not_zero(fit: tuple[Model, ReducedPass, Local]) -> None:
    """Linearised about a fit the evidence is the pass's own, and so is the posterior, whether
    it is counted from zero or from there."""
    model, done, own = fit
    q = own.quadratic
    assert np.abs(own.here).max() > 0.5
    found = posterior(q, np.arange(len(q.names)))
    assert found.log_evidence == pytest.approx(done.log_evidence, abs=1e-6)
    np.testing.assert_allclose(own.deviations(found.mean), done.w, atol=1e-8)
    whole = done.spread @ done.spread.T
    np.testing.assert_allclose(
        found.covariance, whole[np.ix_(own.shared, own.shared)], rtol=1e-7, atol=1e-12
    )
    np.testing.assert_allclose(model.u, found.mean, atol=1e-8)
    np.testing.assert_allclose(model.covariance, found.covariance, atol=1e-12)


def test_without_an_effect_that_is_not_zero(fit: tuple[Model, ReducedPass, Local]) -> None:
    """The evidence of all subsets from the likelihood of all constants at once: those left out
    are zero, which is w0 in deviations from where it is linearised."""
    model, done, own = fit
    a, b, G = done.log_likelihood
    w0 = done.reduction.w0
    everything = Quadratic((), a + float(b @ w0 - 0.5 * w0 @ G @ w0), b - G @ w0, G)
    slots = model.parts[0].linear.problem.slots
    owners = np.array([""] * 6 + [s.owner for s in slots])
    for subset in ((), ("gyro_scale",), ("lever_arm",), model.ids):
        free = np.flatnonzero([o not in set(model.ids) - set(subset) for o in owners])
        expected, mean, _ = _dense(everything, free, np.eye(len(free)))
        index = _places(own.quadratic, subset)
        found = posterior(own.quadratic, index)
        assert found.log_evidence == pytest.approx(expected, abs=1e-6)
        assert log_evidence(own.quadratic, index) == pytest.approx(expected, abs=1e-6)
        u = np.zeros(len(own.shared))
        u[index] = found.mean
        np.testing.assert_allclose((own.deviations(u) - w0)[free], mean, atol=1e-7)


def test_own_unknowns_follow_the_shared_ones(fit: tuple[Model, ReducedPass, Local]) -> None:
    """At any u the recording's own are where the posterior, u given, is highest."""
    _, done, own = fit
    _, b, G = done.log_likelihood
    rng = np.random.default_rng(0)
    for _ in range(3):
        u = own.here + rng.normal(size=len(own.here))
        w = own.deviations(u)
        np.testing.assert_allclose(w[own.shared], u - own.here, atol=1e-12)
        slope = b - G @ w - (w - done.reduction.w0)
        scale = np.abs(G) @ np.abs(w) + np.abs(b) + 1.0
        assert np.abs(slope[own.own] / scale[own.own]).max() < 1e-10


def test_recordings_add_up(bases: list[Model]) -> None:
    """Of two recordings together: the product of the likelihoods, at any value of the effects;
    one that one of them cannot show comes from the other alone."""
    effects = select(("gyro_scale", "lever_arm"))
    parts = []
    for base, own in zip(bases, (effects, effects[1:]), strict=True):
        f = moved_to(base.parts[0], own)
        done = reduced_pass(reduce(f.linear), f.levels)
        parts.append(local(done, frozenset(e.id for e in own)).quadratic)
    whole = total(parts)
    assert set(whole.names) == {(e.id, p.name) for e in effects for p in e.parameters}
    rng = np.random.default_rng(1)
    for u in rng.normal(size=(3, len(whole.names))):
        separate = sum(_value(p, given(whole, p, u)) for p in parts)
        assert _value(whole, u) == pytest.approx(separate, rel=1e-12)


def test_the_order_of_names_is_each_recordings_own() -> None:
    rng = np.random.default_rng(2)
    a, b, c = (("e", i) for i in "abc")
    parts = [_made_up([a, b], rng), _made_up([c, a], rng)]
    whole = total(parts)
    u = rng.normal(size=3)
    assert _value(whole, u) == pytest.approx(sum(_value(p, given(whole, p, u)) for p in parts))
    # and as an integral over the priors, on a grid
    one = total([replace(p, names=(a, b)) for p in parts])
    x = np.linspace(-8.0, 8.0, 401)
    X, Y = np.meshgrid(x, x)
    U = np.stack([X.ravel(), Y.ravel()])
    log = one.a + one.b @ U - 0.5 * np.einsum("iu,ij,ju->u", U, one.G, U) - 0.5 * (U**2).sum(0)
    integral = np.log(np.exp(log).sum() * (x[1] - x[0]) ** 2 / (2.0 * np.pi))
    assert log_evidence(one, np.arange(2)) == pytest.approx(integral, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_posterior_of_made_up_readings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = _made_up([("e", str(i)) for i in range(6)], rng)
    index = rng.permutation(6)[:4]
    value, mean, covariance = _dense(q, index, np.eye(4))
    found = posterior(q, index)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-12)
    np.testing.assert_allclose(found.mean, mean, atol=1e-12)
    assert found.log_evidence == pytest.approx(value, abs=1e-10)
    root = rng.normal(size=(4, 2))
    value, mean, covariance = _dense(q, index, root @ root.T)
    found = posterior(q, index, root)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-10)
    np.testing.assert_allclose(found.mean, mean, atol=1e-10)
    assert found.log_evidence == pytest.approx(value, abs=1e-10)
    assert log_evidence(q, index, root) == pytest.approx(value, abs=1e-10)


@pytest.mark.parametrize("order", [("size_effect", "lever_arm"), ("lever_arm", "size_effect")])
def test_together_the_places_of_accelerometers_have_no_mean(
    wide: Quadratic, order: tuple[str, ...]
) -> None:
    """What all places have in common is the lever arm's, beside which it counts once."""
    size, arm = select(("size_effect", "lever_arm"))
    index = np.concatenate([_places(wide, [i]) for i in order])
    names = [wide.names[i] for i in index]
    root = prior_root(wide, select(order), index)
    assert root is not None
    mine = [i for i, n in enumerate(names) if n[0] == "size_effect"]
    rest = [i for i, n in enumerate(names) if n[0] == "lever_arm"]
    # rows of zero mean: a third of the variance is gone, and no more
    P = root @ root.T
    mean_row = np.kron(np.ones((1, 3)), np.eye(3)) / 3.0
    np.testing.assert_allclose(mean_row @ P[np.ix_(mine, mine)], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.diag(P)[mine], 2.0 / 3.0)
    np.testing.assert_allclose(P[np.ix_(rest, rest)], np.eye(3))
    assert not P[np.ix_(mine, rest)].any()
    value, mean, covariance = _dense(wide, index, P)
    found = posterior(wide, index, root)
    assert found.log_evidence == pytest.approx(value, abs=1e-6)
    assert log_evidence(wide, index, root) == pytest.approx(value, abs=1e-6)
    np.testing.assert_allclose(found.mean, mean, atol=1e-8)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-10)
    np.testing.assert_allclose(mean_row @ found.mean[mine], 0.0, atol=1e-12)
    # alone, or beside something else, both keep what they are
    for effects in ([size], [arm], [size, *select(["gyro_scale"])]):
        assert prior_root(wide, effects) is None


def test_a_fit_with_both_keeps_the_prior(bases: list[Model]) -> None:
    model = fitted(bases[0].parts, select(("size_effect", "lever_arm")), noise_rounds=0)
    mine = _places(model.quadratic, ["size_effect"])
    np.testing.assert_allclose(model.u[mine].reshape(3, 3).mean(axis=0), 0.0, atol=1e-12)
    assert np.abs(model.u[mine]).max() > 0.01


@pytest.mark.parametrize("seed", range(3))
def test_what_parameters_gain_is_their_evidence(seed: int) -> None:
    """Of a Gaussian log-likelihood under a Gaussian prior; beside large numbers a matrix is
    positive but for rounding, which broke the search off."""
    rng = np.random.default_rng(seed)
    J = rng.standard_normal((5, 4, 3))
    G, b = J.transpose(0, 2, 1) @ J, rng.standard_normal((5, 3))
    A = G + np.eye(3)
    expected = [
        0.5 * v @ np.linalg.solve(M, v) - 0.5 * np.linalg.slogdet(M)[1]
        for v, M in zip(b, A, strict=True)
    ]
    assert weighing.gains(b, G) == pytest.approx(expected, rel=1e-12)
    column = 1e9 * rng.standard_normal(3)
    flat = np.outer(column, column)[None] - 5.0 * np.eye(3)
    assert np.linalg.eigvalsh(flat[0])[0] < -1.0
    assert np.isfinite(weighing.gains(b[:1], flat)).all()
    # what left float64's range is no candidate, and takes nothing from the others
    for lost in (np.nan, np.inf):
        some = G.copy()
        some[1, 2, 0] = lost
        gained = weighing.gains(b, some)
        assert gained[1] == -np.inf
        assert np.delete(gained, 1) == pytest.approx(np.delete(expected, 1), rel=1e-12)

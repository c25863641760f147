"""Populations: the truth is in the interval as often as it says, faint effects add up, and odd
devices are found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import schemas
from scipy import stats

from handcal.commands._device import before_of
from handcal.device import priors as priors_file
from handcal.device.file import session_of
from handcal.device.priors import Learned
from handcal.population import joint, odd
from handcal.population.by_model import Reading, models
from handcal.population.deconvolved import _nodes, chance, foretold, log_density, population
from handcal.population.grouped import devices, owners
from handcal.population.stacked import stack
from handcal.show.calibration.summary import device_json
from handcal.show.fleet import Fleet, fleet_json, reason
from handcal.types import HandcalError, InputError

FLEETS, PARAMETERS = 20, 10


def drawn(rng, n, mean=0.002, spread=0.01, noise=0.01):
    sigma = noise * np.exp(rng.normal(0.0, 0.5, n))
    return rng.normal(mean, spread, n) + rng.normal(0.0, sigma), sigma


@pytest.mark.prove
@pytest.mark.parametrize(("count", "noise"), [(12, 0.01), (30, 0.02)])
def test_intervals_hold_the_truth_as_often_as_they_say(count, noise):
    """200 populations: of 95 % the binomial law has 90 to 98.5 % within 3.2 sigma."""
    held_spread = held_mean = 0
    for seed in range(FLEETS):
        rng = np.random.default_rng(seed)
        for _ in range(PARAMETERS):
            x, sigma = drawn(rng, count, noise=noise)
            p = population(x, sigma, owners([""] * count))
            held_spread += p.low <= 0.01 <= p.high
            held_mean += abs(p.mean - 0.002) < 1.96 * p.mean_sigma
    assert 0.90 <= held_spread / (FLEETS * PARAMETERS) <= 0.99
    assert 0.90 <= held_mean / (FLEETS * PARAMETERS) <= 0.99


def test_the_scatter_of_estimates_is_not_the_spread():
    rng = np.random.default_rng(0)
    x, sigma = drawn(rng, 200, noise=0.03)
    p = population(x, sigma, owners([""] * 200))
    assert np.std(x) > 0.03
    assert p.low < 0.01 < p.high < 0.018


def test_recordings_of_one_device_share_its_value():
    rng = np.random.default_rng(0)
    truth = rng.normal(0.0, 0.01, 20)
    who = owners([f"d{i // 5}" for i in range(100)])
    sigma = np.full(100, 0.02)
    x = truth[who] + rng.normal(0.0, sigma)
    assert population(x, sigma, who).count == 20
    d = devices(x, sigma, who)
    np.testing.assert_allclose(d.sigma, 0.02 / math.sqrt(5.0))
    # what differs each time it is switched on is told from what differs between devices
    turn_on = truth[who] + rng.normal(0.0, 0.03, 100) + rng.normal(0.0, 0.001, 100)
    p = population(turn_on, np.full(100, 0.001), who, stays=False)
    assert p.apart == pytest.approx(0.03, rel=0.35)  # 80 degrees of freedom: 8 %, grid 13 %
    assert p.spread < 0.02
    with pytest.raises(HandcalError, match="takes 3 devices"):
        population(x[:2], sigma[:2], owners(["a", "b"]))


@pytest.mark.prove
def test_a_tail_is_told_where_there_is_one():
    rng = np.random.default_rng(0)
    sigma = np.full(200, 0.002)
    t = 0.01 * rng.standard_t(3.0, 200) + rng.normal(0.0, sigma)
    p = population(t, sigma, owners([""] * 200))
    assert p.dof <= 5.0
    assert p.low < 0.01 < p.high
    # (of a normal population at most one of ten is told to have one: 5 of 20 are 2.2 sigma more)
    told = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        x = rng.normal(0.0, 0.01, 60) + rng.normal(0.0, sigma[:60])
        told += not math.isinf(population(x, sigma[:60], owners([""] * 60)).dof)
    assert told <= 5


@pytest.mark.parametrize("dof", [3.0, 5.0, 10.0])
def test_the_mixture_is_students_t(dof):
    share, widen = _nodes(dof)
    x = np.linspace(-6.0, 6.0, 25)
    log = log_density(x[None], np.full(25, 1e-12), share, widen, np.ones((1, 1)))[0]
    got = np.log(np.exp(log).sum(axis=1))
    np.testing.assert_allclose(got, stats.t.logpdf(x, dof), atol=0.01)


def test_three_nats_in_each_of_many_devices_add_up_and_one_device_is_not_smeared():
    rng = np.random.default_rng(0)
    n, usual = 40, np.array([0.005])
    sigma = np.full(n, 0.003)
    shared = rng.normal(0.004, 0.0005, n) + rng.normal(0.0, sigma)
    found = stack("gyro_quadratic", [(shared, sigma)], usual, 100)
    assert found.best_alone < 6.0
    assert found.probability > 0.999
    nothing = rng.normal(0.0, sigma)
    assert stack("gyro_quadratic", [(nothing, sigma)], usual, 100).probability < 0.05
    one = nothing.copy()
    one[7] = 0.05
    assert stack("gyro_quadratic", [(one, sigma)], usual, 100).probability < 0.05
    # sigmas that are a third too small are no population
    assert stack("gyro_quadratic", [(1.33 * nothing, sigma)], usual, 100).probability < 0.5


def fleet(rng, count=30):
    """Readings of devices with three scales, each recorded twice."""
    truth = rng.normal(0.0, 0.004, (count, 3))
    truth[4, 1], truth[11, 2] = 0.06, -2.0
    out = []
    for d in range(count):
        for r in range(2):
            whose = 20 if (d, r) == (21, 1) else d  # a recording with another's name on it
            x = truth[whose] + rng.normal(0.0, 0.0004, 3)
            values = {("gyro_scale", a): (float(v), 0.0004) for a, v in zip("xyz", x, strict=True)}
            gravity = 1.0 if (d, r) == (2, 0) else 9.8
            out.append(Reading(f"r{d}_{r}", "m", f"d{d}", values, frozenset(values), gravity))
    return out


def test_odd_devices_and_recordings_come_first_with_the_reason():
    (m,) = models(fleet(np.random.default_rng(0)))
    assert (m.devices, m.recordings) == (30, 60)
    first = {o.who: reason(o) for o in m.odd[:6]}
    assert {"d4", "d11", "r2_0", "r21_1"} <= set(first)
    assert "sign is turned round" in first["d11"]
    assert "another unit" in first["r2_0"]
    assert "like d20" in first["r21_1"]
    assert len(m.odd) <= 8
    (c,) = [c for c in m.common if c.name == "x"]
    assert c.population.low < 0.004 < c.population.high


def test_an_odd_device_is_judged_by_the_others_and_populations_are_told_without_it():
    """Among eight, and two of twelve that are off alike: a spread that has them hides them."""
    for count, far in ((8, (2,)), (12, (3, 8))):
        for seed in range(5):
            rng = np.random.default_rng(seed)
            truth = rng.normal(0.0, 0.004, (count, 3))
            for d in far:
                truth[d, 1] = 0.08
            (m,) = models(
                [Reading(f"r{d}_{r}", "m", f"d{d}", {
                    ("gyro_scale", a): (float(v + rng.normal(0.0, 0.0004)), 0.0004)
                    for a, v in zip("xyz", truth[d], strict=True)
                }, frozenset(("gyro_scale", a) for a in "xyz"), 9.8)
                 for d in range(count) for r in range(2)]
            )  # fmt: skip
            out = {o.who for o in m.odd if o.left_out}
            assert out == {f"d{d}" for d in far}
            (c,) = [c for c in m.common if c.name == "y"]
            assert (c.population.count, len(c.who)) == (count - len(far), count)
            assert c.population.spread < 0.01


@pytest.mark.prove
def test_what_is_foretold_of_one_more_device_comes_as_often():
    """400 devices beside six others each: as many in the outer 5 and 30 % as the binomial law has
    within 3.2 sigma. (The spread's prior is flat, which makes few devices cautious: half as many
    are let pass at the lower end.)"""
    p = np.array([
        foretold(x[:-1], s[:-1], float(x[-1]), float(s[-1]))
        for x, s in (drawn(np.random.default_rng(seed), 7, noise=0.003) for seed in range(400))
    ])  # fmt: skip
    for level in (0.05, 0.3):
        three = 3.2 * math.sqrt(level * (1.0 - level) / len(p))
        assert 0.5 * level - three < np.mean(p < level) < level + three


def test_a_device_most_of_whose_recordings_are_refused_is_odd():
    told = odd.refused(
        {"a": ["", "", "axes", ""], "b": ["axes", "axes", ""], "c": ["x"], "d": [""]}
    )
    assert [(o.who, o.kind, o.value, o.said) for o in told] == [("b", "refused", 2, "axes")]
    assert "2 of its recordings" in reason(told[0])


def test_two_devices_are_no_population():
    two = [r for r in fleet(np.random.default_rng(0)) if r.device in ("d20", "d21")]
    (m,) = models(two)
    assert (m.common, m.stacks) == ((), ())
    # (but which of two recordings is whose may be asked all the same)
    told = fleet_json(Fleet((m,), (), {}, 4))
    assert "r21_1" in {o["who"] for o in told["models"][0]["odd"]}
    schemas.check(told | {"version": "1"})


def test_the_chance_of_a_device_is_that_of_its_population():
    rng = np.random.default_rng(0)
    x, sigma = drawn(rng, 100)
    p = population(x, sigma, owners([""] * 100))
    (got,) = chance(p, np.array([p.mean + 3.0 * p.spread]), np.array([0.0]))
    widened = math.hypot(p.spread, p.mean_sigma)
    assert got == pytest.approx(2.0 * stats.norm.sf(3.0 * p.spread / widened), rel=1e-6)
    assert odd.devices(["a"], {}) == []


def test_priors_come_back_as_they_were_written(tmp_path):
    path = tmp_path / "priors.toml"
    one = Learned(0.003, 0.001, 0.005, 0.001, 3.0, 40)
    two = Learned(0.0, 0.001, 0.002, 0.0005, math.inf, 40)
    written = {'phone "A"': {("gyro_scale", "x"): one, ("gyro_bias", "z"): two}}
    priors_file.write(path, written, {'phone "A"': {"recordings": 80, "devices": 40}})
    read = priors_file.read(path)
    assert read.models == written
    prior = priors_file.prior(read, priors_file.chosen(read, None))
    assert prior.names == (("gyro_scale", "x"), ("gyro_bias", "z"))
    # of Student's t with three degrees of freedom the variance is three times the scale's
    expected = math.sqrt(3.0 * (0.005**2 + 0.001**2) + 0.001**2)
    assert math.sqrt(prior.covariance[0, 0]) == pytest.approx(expected)
    assert prior.source["devices"] == 40
    with pytest.raises(InputError, match="has no model 'B'"):
        priors_file.chosen(read, "B")
    path.write_text(path.read_text().replace('"gyro_scale"', '"gyro_moon"'))
    with pytest.raises(InputError, match="damaged"):
        priors_file.read(path)


# ---- all parameters at once ---------------------------------------------------------------------

SCALE, QUADRATIC = ("gyro_scale", "x"), ("gyro_quadratic", "x")


def turned_at_one_rate(rng, count, quadratic, rate=1.3):
    """Recordings in which a scale error and a quadratic one (usual sizes 0.01 and 0.005) look the
    same, the latter by the way round that the device was turned; truth in usual sizes."""
    out = []
    for _ in range(count):
        h = np.array([0.01, 0.005 * rate * rng.choice([-1.0, 1.0])]) / 0.0003
        truth = np.array([0.2 * rng.normal(), quadratic])
        b = h * (h @ truth + rng.normal())
        # (a little of another rate)
        other = np.array([0.01, 0.0]) / 0.01
        out.append(
            joint.Information((SCALE, QUADRATIC), b + other * (other @ truth + rng.normal()),
                              np.outer(h, h) + np.outer(other, other))
        )  # fmt: skip
    return joint.of_devices(out, np.arange(count), (SCALE, QUADRATIC), ())


def test_evidence_is_that_of_the_marginal_density():
    rng = np.random.default_rng(0)
    L = rng.normal(size=(2, 2))
    G, z = L @ L.T, rng.normal(size=2)
    told = joint.Told((SCALE, QUADRATIC), (G @ z)[None], G[None])
    mean, spread = np.array([0.3, -0.2]), np.array([0.5, 2.0])
    log, _, _ = joint.evidence(told, mean, spread)
    marginal = stats.multivariate_normal(mean, np.linalg.inv(G) + np.diag(spread**2))
    at_best = stats.multivariate_normal(z, np.linalg.inv(G)).logpdf(z)
    # (b and G are the log-likelihood up to its value at the best parameters)
    expected = marginal.logpdf(z) - at_best + 0.5 * z @ G @ z
    assert log[0] == pytest.approx(expected, rel=1e-9)


def test_what_each_recording_takes_for_a_scale_is_found_by_the_devices_together():
    told = turned_at_one_rate(np.random.default_rng(0), 20, 1.2)
    found = joint.stack(told, [SCALE], "gyro_quadratic", 100)
    assert found.probability > 0.99
    assert found.best_alone < 3.0
    mean, spread = joint.fit(told)
    # the mean of 20 devices, each known to 0.3 of a usual size beside a scale of that spread
    assert mean[1] == pytest.approx(1.2, abs=3 * 0.3 / math.sqrt(20))
    assert spread[0] == pytest.approx(0.2, abs=3 * 0.2 / math.sqrt(40))


@pytest.mark.prove
def test_what_is_not_there_is_found_in_one_of_a_hundred_at_the_most():
    """20 fleets; odds of one in a hundred trials, so that one found would be a chance of 1/5."""
    found = [
        joint.stack(turned_at_one_rate(np.random.default_rng(seed), 12, 0.0), [SCALE],
                    "gyro_quadratic", 100).probability > 0.5
        for seed in range(20)
    ]  # fmt: skip
    assert sum(found) <= 1


def test_what_passes_is_integrated_out():
    rng = np.random.default_rng(0)
    L = rng.normal(size=(2, 3))
    G, b = L.T @ L, rng.normal(size=3)
    arm = ("lever_arm", "x")
    one = joint.Information((arm, SCALE, QUADRATIC), b, G)
    told = joint.of_devices([one], np.zeros(1, dtype=np.int64), (SCALE, QUADRATIC), (arm,))
    _, m, C = joint.evidence(told, np.zeros(2), np.ones(2))
    whole = np.linalg.inv(G + np.eye(3))
    np.testing.assert_allclose(C[0], whole[1:, 1:], atol=1e-12)
    np.testing.assert_allclose(m[0], (whole @ b)[1:], atol=1e-12)


# ---- priors that were learned -------------------------------------------------------------------


def two_models(tmp_path):
    path = tmp_path / "priors.toml"
    one = Learned(0.003, 0.001, 0.005, 0.001, math.inf, 40)
    models_of = {name: {("gyro_scale", "x"): one} for name in ("A", "B")}
    priors_file.write(path, models_of, {n: {"recordings": 80, "devices": 40} for n in "AB"})
    return path


@pytest.mark.parametrize(
    ("device", "priors", "model", "said"),
    [
        (None, True, None, "holds priors of A, B: say which"),
        (None, True, "C", "has no model 'C'"),
        (None, False, "A", "give --priors FILE"),
        ("phone.toml", True, "A", "give one of them"),
    ],
)
def test_what_is_begun_with_has_to_be_clear(tmp_path, device, priors, model, said):
    file = two_models(tmp_path) if priors else None
    with pytest.raises(InputError, match=said):
        before_of(device and Path(device), file, model, [])


def test_a_result_says_with_which_priors_and_a_device_file_takes_them_out_again(tmp_path):
    before = before_of(None, two_models(tmp_path), "A", [])
    told = device_json(before)["priors"]
    assert (told["model"], told["devices"], len(told["sha256"])) == ("A", 40, 64)
    assert told["prior"]["mean"] == [0.003]
    variance = told["prior"]["covariance"][0][0]
    document = {
        "schema": "handcal/calibration/1", "priors": told, "covariance": [[1e-8]],
        "recording": {"path": "a.mcap", "recorded": "2026-05-01T10:00:00Z", "sha256": "0"},
        "parameters": [{"effect": "gyro_scale", "name": "x", "value": 0.004, "sigma": 1e-4}],
    }  # fmt: skip
    session = session_of(tmp_path / "a.json", document, "phone")
    assert session.prior_mean.tolist() == [0.003]
    assert session.prior_covariance.tolist() == [[variance]]

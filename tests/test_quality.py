"""How good a device is: linear against brute force, tails against all of them summed, and what is
said of it."""

import itertools
import json
import math
import re

import numpy as np
import pytest
from fake_explanation import fake_explanation
from fake_result import fake_result
from proved import proved
from scipy.spatial.transform import Rotation

from handcal.device import quality as q
from handcal.effects import catalogue
from handcal.estimate.heavy_tails import tailed
from handcal.estimate.prior_scales import LOG_SHARES, SCALES
from handcal.estimate.quadratic import Quadratic
from handcal.motions import MINUTE, attitude
from handcal.show.calibration import how_good, verdict_text
from handcal.show.calibration.summary import calibration_json
from handcal.show.explanation import verdict_text as explained
from handcal.signals import of_arrays
from handcal.types import Array, Parameter

GRAVITY = 9.80665
USUAL = [e for e in catalogue().values() if q.counts(e) and (e.baseline or e.common)]
RARE = [catalogue()[i] for i in ("gyro_quadratic", "accel_cross_products", "gyro_bandwidth")]


def dead_reckoned(t: Array, gyro: Array, accel: Array) -> tuple[Rotation, Array]:
    """Attitude at the end, and position (3,) after ten seconds, from level rest on."""
    dt = t[1] - t[0]
    steps = Rotation.from_rotvec(0.5 * dt * (gyro[1:] + gyro[:-1]))
    C, v, p = Rotation.identity(), np.zeros(3), np.zeros(3)
    for k, step in enumerate(steps):
        after = C * step
        a = 0.5 * (C.apply(accel[k]) + after.apply(accel[k + 1])) - [0.0, 0.0, GRAVITY]
        if t[k] < 10.0 - 0.5 * dt:
            p, v = p + dt * v + 0.5 * dt**2 * a, v + dt * a
        C = after
    return C, p


@pytest.mark.parametrize(
    "effect",
    [*USUAL, *proved(*RARE)],
    ids=lambda e: e.id,
)
def test_the_matrices_do_what_brute_force_does(effect):
    """Small errors, integrated in full: within a tenth, or too small to speak of."""
    t = np.arange(0.0, 60.0 + 1e-9, 0.02)
    C_nb, omega = attitude(MINUTE, t)
    truth = of_arrays(t, omega, GRAVITY * C_nb[:, 2, :])
    size = (
        0.1 * effect.prior_sigma * np.random.default_rng(0).standard_normal(len(effect.prior_sigma))
    )
    size = np.where([p.positive for p in effect.parameters], np.abs(size), size)
    error = effect.imu_error(size, truth)
    C, p = dead_reckoned(t, truth.gyro, truth.accel)
    C_off, p_off = dead_reckoned(t, truth.gyro + error[:, :3], truth.accel + error[:, 3:])
    brute = np.r_[(C_off * C.inv()).as_rotvec(), p_off - p]
    linear = q.propagation([effect]) @ size
    for rows in (slice(0, 3), slice(3, 6)):
        largest = np.linalg.norm(brute[rows])
        assert np.linalg.norm(linear[rows] - brute[rows]) < 0.1 * largest + 1e-5


def device(value: float, sigma: float, effects=USUAL) -> tuple[list[Parameter], Array]:
    """Parameters of that size and sigma, in what is usual, and their covariance."""
    known = [
        Parameter(e.id, p.name, value * p.prior_sigma, sigma * p.prior_sigma, p.unit, p.prior_sigma,
                  None)
        for e in effects for p in e.parameters
    ]  # fmt: skip
    return known, np.diag([p.sigma**2 for p in known])


def asked(known, covariance, **more) -> q.Quality:
    found = q.quality(known, covariance, np.random.default_rng(0), **more)
    assert found is not None
    return found


def test_of_which_nothing_is_known_half_of_all_are_better():
    """Whether the fit had the usual scale alone or all of them: two samples of 2,000 of the same
    density, five sigmas."""
    wide = math.sqrt(float(np.exp(LOG_SHARES) @ SCALES**2))
    known, covariance = device(0.0, 1.0)
    factor = np.array([1.0 if p.effect.endswith("bias") else wide for p in known])
    for C in (covariance, covariance * np.outer(factor, factor)):
        found = asked(known, C)
        for d in (found.attitude, found.position):
            assert abs(d.better - 0.5) < 5.0 * math.sqrt(2.0 / (12.0 * q.DRAWS))
            assert d.after == pytest.approx(d.before, rel=1e-6)
            assert d.low < d.before < d.high


def test_what_is_known_well_is_off_by_what_it_is_and_corrected_by_all_of_it():
    J = q.propagation(USUAL)
    last = 0.0
    for size in (0.02, 0.1, 0.5):
        known, covariance = device(size, 1e-4)
        found = asked(known, covariance)
        error = J @ [p.value for p in known]
        for d, rows in ((found.attitude, slice(0, 3)), (found.position, slice(3, 6))):
            assert d.before == pytest.approx(np.linalg.norm(error[rows]), rel=0.01)
            assert d.high - d.low < 0.02 * d.before
            assert d.after < 0.02 * d.before
        assert found.position.better > last
        last = found.position.better


def test_no_angle_is_beyond_half_a_turn():
    found = asked(*device(50.0, 1e-4))
    assert found.attitude.before == pytest.approx(math.pi)
    assert found.attitude.better > 0.95


def test_of_what_no_motion_of_this_kind_feels_nothing_is_asked():
    """A lever arm is no error of the sensors, a step no lasting one; neither changes anything."""
    known, covariance = device(0.1, 0.1)
    more = [catalogue()[i] for i in ("lever_arm", "gyro_bias_step", "gyro_temperature")]
    beside, other = device(3.0, 0.5, [e for e in more if e.id != "gyro_temperature"])
    both = np.zeros([len(known) + len(beside)] * 2)
    both[: len(known), : len(known)] = covariance
    both[len(known) :, len(known) :] = other
    assert asked([*known, *beside], both) == asked(known, covariance)


def test_without_biases_or_numbers_there_is_none():
    known, covariance = device(0.1, 0.1)
    rng = np.random.default_rng(0)
    assert q.quality(known[6:], covariance[6:, 6:], rng) is None
    covariance[3, 3] = math.nan
    assert q.quality(known, covariance, rng) is None


IDS = ("gyro_bias", "accel_bias", "gyro_scale", "accel_scale", "gyro_misalignment")


@pytest.mark.parametrize("seed", range(4))
def test_tails_are_those_of_all_scales_summed(seed):
    """Behind a posterior's mean and covariance stands the sum over the scales of each effect. Of
    every other device one error is eight times as large as is usual."""
    effects = [catalogue()[i] for i in IDS]
    names = tuple((e.id, p.name) for e in effects for p in e.parameters)
    owners = [n[0] for n in names]
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((rng.integers(3, 16), len(names))) * 10 ** rng.uniform(-1.0, 2.0)
    u = rng.standard_normal(len(names)) * np.where(
        np.array(owners) == "accel_scale", 8.0 if seed % 2 else 1.0, 1.0
    )
    G, b = rows.T @ rows, rows.T @ (rows @ u + rng.standard_normal(len(rows)))
    J = q.propagation(effects) * np.concatenate([e.prior_sigma for e in effects])
    exact = summed(G, b, owners, rng)
    found = tailed(Quadratic(names, 0.0, b, G), np.arange(len(names)))
    drawn = q._drawn(found.mean, found.covariance, owners, np.random.default_rng(0))
    for part in (J[:3], J[3:]):
        ours, theirs = (np.linalg.norm(x @ part.T, axis=1) for x in (drawn, exact))
        assert ours.mean() == pytest.approx(theirs.mean(), rel=0.1)
        assert np.quantile(ours, 0.84) == pytest.approx(np.quantile(theirs, 0.84), rel=0.1)


def summed(G: Array, b: Array, owners: list[str], rng: np.random.Generator) -> Array:
    """Draws (n, k) of the posterior, every choice of scales by its evidence; biases have one."""
    log_weights, parts = [], []
    for kinds in itertools.product(range(len(SCALES)), repeat=3):
        scale = dict(zip(IDS[2:], SCALES[list(kinds)], strict=True))
        s = np.array([scale.get(o, 1.0) for o in owners])
        A = G * np.outer(s, s) + np.eye(len(s))
        C = np.linalg.inv(A) * np.outer(s, s)
        log_weights.append(
            LOG_SHARES[list(kinds)].sum() + 0.5 * b @ C @ b - 0.5 * np.linalg.slogdet(A)[1]
        )
        parts.append((C @ b, C))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    counts = rng.multinomial(10_000, weights / weights.sum())
    pairs = zip(parts, counts, strict=True)
    return np.concatenate([rng.multivariate_normal(*p, n, method="eigh") for p, n in pairs])


def test_priors_of_a_device_have_no_tails():
    known, covariance = device(0.0, 1.0)
    with_tails, without = asked(known, covariance), asked(known, covariance, tails=False)
    assert without.attitude.before < 0.9 * with_tails.attitude.before


def numbers(sentences):
    return [float(n) for n in re.findall(r"\d+(?:\.\d+)?", " ".join(sentences))]


@pytest.mark.parametrize("hidden", [False, True])
def test_it_is_said_first_and_stands_in_the_json(hidden):
    result = fake_result(hidden=hidden)
    found = how_good.quality_of(result.parameters, result.covariance, None)
    assert found is not None
    said = how_good.sentences(result.parameters, result.covariance, None)
    assert verdict_text.verdict(result).sentences[: len(said)] == tuple(said)
    a, p = found.attitude, found.position
    expected = [math.degrees(a.before), math.degrees(a.after), p.before, p.after]
    for value in expected:
        assert any(n == pytest.approx(value, rel=0.05) for n in numbers(said))
    document = json.loads(json.dumps(calibration_json(result)))["quality"]
    assert document["attitude"]["expected"] == a.before
    assert document["position"]["usual_better"] == p.better
    assert document["position"]["unit"] == "m"


def test_of_an_explanation_too_but_not_of_several_recordings():
    one, two = (fake_explanation("explained", recordings=n) for n in (1, 2))
    said = how_good.sentences(one.parameters, one.covariance, one.device)
    assert explained.verdict(one).sentences[: len(said)] == tuple(said)
    assert len(said) == 3
    assert how_good.sentences(two.parameters, two.covariance, two.device) == []


@pytest.mark.parametrize(("after", "better"), [(0.1, True), (0.5, False)])
def test_no_correction_is_promised_that_makes_it_worse(after, better, monkeypatch):
    """Of 12 deg that were "corrected, 28 deg"."""
    drift = q.Drift(0.2, 0.1, 0.3, after, 0.5)
    monkeypatch.setattr(how_good, "quality_of", lambda *_: q.Quality(drift, drift))
    said = how_good.sentences((), None, None)[:2]
    assert ["corrected," in s for s in said] == [better, better]
    assert [how_good.NOT_BETTER in s for s in said] == [not better, not better]

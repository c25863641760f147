"""Beside a reference: the biases are the IMU's own, as uncertain as the reference's leave them.

The devices are made here: an IMU and a reference turned together about one place, both with
biases as large as the priors say, the reference's scales and axes off as those of any sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from proved import proved
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import binom, chi2

from handcal import calibrate
from handcal.device import apply as taking
from handcal.earth import local_earth
from handcal.effects import select
from handcal.estimate.assemble import build
from handcal.estimate.linear import Linear, linearise_about
from handcal.estimate.observed import observed_of
from handcal.estimate.trajectory import Trajectory, epochs
from handcal.explain import explain
from handcal.observations import _reference_bias
from handcal.show.calibration import report, verdict_text
from handcal.show.calibration.summary import calibration_json, write_json
from handcal.types import Array, Imu, Recording, Result, Series

G = 9.80665
# As the contract has them: rad/s, m/s^2, 1 or rad.
GYRO, ACCEL, CROOKED = math.radians(1.0), 0.6, 0.01
PRIOR = np.repeat([GYRO, ACCEL], 3)
RATE_HZ, NOISE = 25.0, np.repeat([1e-3, 1e-2], 3)
POSES, STILL_S, TURN_S, TURNING_S = 9, 3.0, 1.5, 15.0
SEEDS = range(12)
AXES_OF_FORCE = ("accel_scale", "accel_misalignment")


@dataclass(frozen=True)
class Device:
    """A recording, and the biases (6,) of the IMU in it."""

    recording: Recording
    bias: Array


def posed(rng: np.random.Generator, t: Array) -> Rotation:
    """Attitudes at t: POSES anyhow, with quick turns between them."""
    poses = Rotation.random(POSES, random_state=int(rng.integers(2**31)))
    step = t / (STILL_S + TURN_S)
    k = np.minimum(step.astype(int), POSES - 1)
    x = np.clip(((step - k) * (STILL_S + TURN_S) - STILL_S) / TURN_S, 0.0, 1.0)
    smooth = x**3 * (10.0 + x * (6.0 * x - 15.0))
    return Slerp(np.arange(POSES), poses)(np.minimum(k + smooth, POSES - 1.0))


def turning(rng: np.random.Generator, t: Array) -> Rotation:
    """Attitudes at t of a device that never rests."""
    w, phase = rng.uniform(1.0, 2.5, 3), rng.uniform(0.0, 2.0 * math.pi, 3)
    angles = np.array([2.0, 1.1, 2.0]) * np.sin(np.outer(t, w) + phase)
    return Rotation.from_euler("ZYX", angles + rng.uniform(-math.pi, math.pi, 3))


def device(seed: int, rests: bool, biased: bool = True, crooked: bool = True) -> Device:
    """An IMU with biases and a reference with biases, with scales and axes that are off."""
    rng = np.random.default_rng(seed)
    bias, its = rng.normal(0.0, PRIOR), rng.normal(0.0, PRIOR) * biased
    off = np.diag(rng.normal(0.0, CROOKED, 3)) + np.tril(rng.normal(0.0, CROOKED, (3, 3)), -1)
    off = off * crooked
    mounted = Rotation.from_rotvec(rng.normal(0.0, 0.03, 3))
    length = POSES * (STILL_S + TURN_S) - TURN_S if rests else TURNING_S
    motion = int(rng.integers(2**31))

    def truth(t: Array) -> Array:
        def at(moment: Array) -> Rotation:
            return (posed if rests else turning)(np.random.default_rng(motion), moment)

        h = 1e-4
        rate = (at(t - h).inv() * at(t + h)).as_rotvec() / (2.0 * h)
        return np.hstack([rate, at(t).inv().apply([0.0, 0.0, G])])

    t = np.arange(0.01, length - 0.02, 1.0 / RATE_HZ)
    t_ref = t + 0.004
    own = truth(t) + bias + NOISE * rng.standard_normal((len(t), 6))
    there = truth(t_ref)
    turned = mounted.inv().apply(there[:, :3])
    force = mounted.inv().apply(there[:, 3:]) @ (np.eye(3) + off).T
    known = np.hstack([turned, force]) + its + NOISE * rng.standard_normal((len(t), 6))
    imu = Imu(t, own[:, :3].copy(), own[:, 3:].copy(), np.ones(len(t), dtype=bool))
    return Device(Recording("made", imu, {"reference": Series(t_ref, known)}), bias)


@cache
def calibrated(seed: int, rests: bool, exact: bool) -> tuple[Device, Result]:
    """A device and what is found of it; exact: its reference has no error, and is said to have
    no bias."""
    made = device(seed, rests, not exact, not exact)
    effects = () if exact else AXES_OF_FORCE
    return made, calibrate(made.recording, effects, reference_exact=exact, only=True)


@pytest.mark.prove
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("rests", [True, False])
def test_the_biases_are_the_imus_own(rests: bool, exact: bool) -> None:
    """Over all seeds: squared errors in units of the covariance are chi-square, and no more lie
    beyond three sigma than may."""
    total, beyond = 0.0, 0
    for seed in SEEDS:
        made, result = calibrated(seed, rests, exact)
        assert (len(result.rests) > 0) == rests
        error = np.array([p.value for p in result.parameters[:6]]) - made.bias
        sigma = np.array([p.sigma for p in result.parameters[:6]])
        total += float(error @ np.linalg.solve(result.covariance[:6, :6], error))
        beyond += int((np.abs(error) > 3.0 * sigma).sum())
    n = 6 * len(SEEDS)
    low, high = chi2.ppf([0.005, 0.995], n) / n
    print(f"\nrests {rests}, exact {exact}: NEES {total / n:.2f} ({low:.2f} to {high:.2f})")
    assert low < total / n < high
    assert beyond <= binom.ppf(0.995, n, 0.0027)


@pytest.mark.parametrize("seed", [0, *proved(*SEEDS[1:])])
def test_a_bias_is_as_uncertain_as_the_reference_leaves_it(seed: int) -> None:
    """Without rests the difference is known and how it is shared is not: the prior over the
    square root of two. A reference without bias leaves noise alone, over fifteen seconds."""

    def sigma(rests: bool, exact: bool) -> Array:
        return np.array([p.sigma for p in calibrated(seed, rests, exact)[1].parameters[:6]])

    np.testing.assert_allclose(sigma(False, False) / PRIOR, math.sqrt(0.5), rtol=3.0 * CROOKED)
    # (both sensors' noise, at every sample; what is said to come with motion besides)
    least = NOISE * math.sqrt(2.0 / (RATE_HZ * TURNING_S))
    assert np.all(sigma(False, True) > 0.7 * least)
    assert np.all(sigma(False, True) < 3.0 * least)
    assert np.all(sigma(True, False)[:3] < 0.02 * GYRO)


@pytest.mark.prove
def test_what_is_no_bias_is_as_well_known_as_before() -> None:
    """Scales beside a reference without bias: whether that is known or not."""
    made = device(0, False, biased=False)
    known, unknown = (
        calibrate(made.recording, ("gyro_scale", *AXES_OF_FORCE), reference_exact=exact)
        for exact in (True, False)
    )
    for a, b in zip(known.parameters[6:], unknown.parameters[6:], strict=True):
        assert b.sigma == pytest.approx(a.sigma, rel=0.02)
        assert abs(a.value - b.value) < 0.2 * a.sigma


def lopsided(made: Device, asymmetry: Array) -> Recording:
    """The device's recording with an accelerometer that shows forces up and down unlike."""
    imu = made.recording.imu
    true = imu.accel - made.bias[3:]
    return replace(made.recording, imu=replace(imu, accel=imu.accel + asymmetry * np.abs(true)))


@pytest.mark.prove
def test_what_is_not_linear_shows_the_bias_itself() -> None:
    """Forces change sign where the sensor's own zero is, not where half the difference of two
    biases has it: a scale error was named beside an asymmetry to make up for that."""
    for seed in range(3):
        made = device(seed, False, crooked=False)
        recording = lopsided(made, np.array([0.014, -0.012, 0.01]))
        alone, beside = (
            calibrate(recording, effects, only=True)
            for effects in (("accel_asymmetry",), ("accel_asymmetry", "accel_scale"))
        )
        assert beside.log_evidence < alone.log_evidence
        error = np.array([p.value for p in alone.parameters[3:6]]) - made.bias[3:]
        sigma = np.array([p.sigma for p in alone.parameters[3:6]])
        # (a quarter, and what scores that scatter beyond the matrix add)
        assert np.all(sigma < 0.3 * ACCEL)
        assert np.all(np.abs(error) < 4.0 * sigma)


def test_the_matrix_is_the_derivative_by_the_biases() -> None:
    """Effects that are not linear depend on them; readings moved by them, linearised anew.

    (What residuals are multiplied by for the noise's sake is no derivative of theirs.)
    """
    recording = device(0, False).recording
    effects = select(["accel_cross_products", "gyro_quadratic", "gyro_g_sensitivity"])
    observed, start = observed_of(
        recording, ["known_input"], np.zeros((0, 2)), local_earth(None), None
    )
    observed = [(replace(o, ours=None), *rest) for o, *rest in observed]
    problem = build(recording, effects, observed, *local_earth(None))
    constants = np.zeros(problem.constants)
    constants[: problem.imu_constants] = [
        p.prior_sigma for e in problem.effects for p in e.parameters
    ]
    node, none = epochs(problem), np.zeros(3)
    still = np.zeros((len(node), 3))

    def linear(bias: Array) -> Linear:
        C, markov = np.tile(np.eye(3), (len(node), 1, 1)), np.zeros((len(node), 6))
        about = Trajectory(node, still, still, C, bias[:3], bias[3:], constants, markov)
        return linearise_about(problem, start, about)

    middle = linear(np.r_[none, none])
    for k in range(6):
        step = np.zeros(6)
        step[k] = 0.02 * PRIOR[k]
        by_difference = (linear(step).r - linear(-step).r) / (2.0 * step[k])
        own = -middle.H[:, :, 9 + k]
        effect = float(np.abs(own - np.eye(6)[k]).max())
        assert effect > 1e-3
        # (what is left out is of the second order)
        assert np.abs(by_difference - own).max() < 0.1 * effect


# --- what rests say -----------------------------------------------------------------------------


def resting(
    rng: np.random.Generator, up: Array, rates: Array, bias: Array
) -> tuple[Array, Array, Array]:
    """Times, readings and rests (r, 2) of a sensor that rests r times for three seconds with these
    directions up (r, 3), turning a little at these rates (r, 3)."""
    t = np.arange(0.0, STILL_S * len(up), 1.0 / RATE_HZ)
    begin = STILL_S * np.arange(len(up))
    k = np.searchsorted(begin, t, side="right") - 1
    truth = np.hstack([rates[k], G * up[k]])
    value = truth + bias + NOISE * rng.standard_normal((len(t), 6))
    return t, value, np.stack([begin, begin + STILL_S - 1.0 / RATE_HZ], axis=1)


def directions(rng: np.random.Generator, count: int) -> Array:
    up = rng.standard_normal((count, 3))
    return np.asarray(up / np.linalg.norm(up, axis=1, keepdims=True))


@pytest.mark.parametrize("seed", range(3))
def test_one_attitude_shows_the_force_along_gravity_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    up = directions(rng, 1)
    rest = resting(rng, up, np.zeros((1, 3)), np.zeros(6))
    root = ACCEL * _reference_bias.of_rests(*rest, G, 0.0).accel
    along = float(np.linalg.norm(up[0] @ root))
    # gravity, as well as scales and axes let it be known, and an unknown bias' direction
    assert along < 1.5 * math.hypot(CROOKED * G, NOISE[3])
    for side in np.linalg.svd(up)[2][1:]:
        assert np.linalg.norm(side @ root) == pytest.approx(ACCEL, rel=0.02)


@pytest.mark.parametrize("turns", [0.0, math.radians(0.2)])
def test_rests_of_a_hand_count_for_what_they_agree(turns: float) -> None:
    """Each turns a little: their scatter, not the noise, says how well the mean is known."""
    seeds, r = range(100), 12
    total, sigmas = 0.0, []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        bias = rng.normal(0.0, PRIOR)
        rest = resting(rng, directions(rng, r), rng.normal(0.0, turns, (r, 3)), bias)
        found = _reference_bias.of_rests(*rest, G, 0.0)
        sigmas.append(found.gyro * GYRO)
        total += float((((found.mean - bias)[:3] / sigmas[-1]) ** 2).sum())
    n = 3 * len(seeds)
    low, high = chi2.ppf([0.005, 0.995], n) / n
    assert low < total / n < high
    expected = math.hypot(turns, NOISE[0] / math.sqrt(RATE_HZ * STILL_S)) / math.sqrt(r)
    assert np.mean(sigmas) == pytest.approx(expected, rel=0.2)


def test_a_bias_beyond_its_prior_is_no_noise() -> None:
    """Thirty sigma: the rests agree on it."""
    rng = np.random.default_rng(0)
    bias = np.r_[30.0 * GYRO, 0.0, 0.0, 5.0 * ACCEL, 0.0, 0.0]
    rest = resting(rng, directions(rng, 20), np.zeros((20, 3)), bias)
    found = _reference_bias.of_rests(*rest, G, 0.0)
    sigma = PRIOR * np.r_[np.full(3, found.gyro), np.linalg.norm(found.accel, axis=1)]
    assert np.all(np.abs(found.mean - bias) < 4.0 * sigma)
    assert np.all(sigma < 0.02 * PRIOR)


def test_the_earth_turns_in_a_direction_unknown() -> None:
    """With --latitude its rate is part of what a resting gyro reads."""
    rng = np.random.default_rng(0)
    rest = resting(rng, directions(rng, 200), np.zeros((200, 3)), np.zeros(6))
    rate = 1e-3
    assert _reference_bias.of_rests(*rest, G, 0.0).gyro * GYRO < 0.1 * rate
    with_it = _reference_bias.of_rests(*rest, G, rate).gyro * GYRO
    assert with_it == pytest.approx(rate / math.sqrt(3.0), rel=0.01)


def test_no_rests_say_nothing() -> None:
    rng = np.random.default_rng(0)
    t, value, _ = resting(rng, directions(rng, 1), np.zeros((1, 3)), np.zeros(6))
    for rests in (np.zeros((0, 2)), np.array([[1.0, 1.1]]), np.array([[90.0, 95.0]])):
        assert _reference_bias.of_rests(t, value, rests, G, 0.0) is _reference_bias.UNKNOWN


# --- what is said and done with it --------------------------------------------------------------


def still(made: Device, recording: Recording) -> float:
    """Mean size of what the gyro reads in excess of the truth, rad/s."""
    change = recording.imu.gyro - made.recording.imu.gyro
    return float(np.linalg.norm(made.bias[:3] + change.mean(axis=0)))


@pytest.mark.parametrize("seed", [0, *proved(1, 2)])
@pytest.mark.parametrize(("rests", "exact"), [(True, False), (False, False), (False, True)])
def test_applied_it_makes_no_gyro_worse(
    rests: bool, exact: bool, seed: int, tmp_path: Path
) -> None:
    made, result = calibrated(seed, rests, exact)
    write_json(calibration_json(result), tmp_path / "result.json")
    done = taking.apply(made.recording, taking.read(tmp_path / "result.json"), biases=True)
    known = rests or exact
    assert ("gyro_bias" in done.taken) == known
    if known:
        assert still(made, done.recording) < 0.05 * still(made, made.recording)
    else:
        assert {"gyro_bias", "accel_bias"} <= set(done.left[taking.NOT_KNOWN])
        assert still(made, done.recording) < 1.01 * still(made, made.recording)


def test_half_a_bias_is_taken_off_and_the_rest_is_said() -> None:
    made = device(0, True)
    learnt = taking.Learnt("x", {}, (("", made.bias),), (), {"": {"accel_bias": "xz"}})
    done = taking.apply(made.recording, learnt, biases=True)
    assert done.taken == ("gyro_bias", "accel_bias")
    assert done.left == {taking.NOT_KNOWN: ("accel_bias (x and z)",)}
    change = (done.recording.imu.accel - made.recording.imu.accel).mean(axis=0)
    np.testing.assert_allclose(change, [0.0, -made.bias[4], 0.0], atol=1e-9)


def test_a_report_offers_no_bias_that_is_not_known() -> None:
    _, result = calibrated(0, False, False)
    scope: dict[str, Array] = {"gyro": result.recording.imu.gyro, "accel": np.ones((1, 3))}
    code = report.apply_code(result)
    exec(code, scope)
    assert not scope["gyro_bias"].any()
    assert "x, y and z not known" in code
    said = [s for s in verdict_text.not_shown(result) if "bias" in s]
    assert len(said) == 2
    assert all("--reference-exact" in s for s in said)
    assert any("--reference-exact" in w for w in result.warnings)
    assert verdict_text.verdict(result).level != "poor"


def test_where_the_reference_rested_its_bias_is_offered() -> None:
    _, result = calibrated(0, True, False)
    scope: dict[str, Array] = {"gyro": result.recording.imu.gyro, "accel": np.ones((1, 3))}
    exec(report.apply_code(result), scope)
    np.testing.assert_allclose(
        scope["gyro_bias"], [p.value for p in result.parameters[:3]], rtol=1e-5
    )
    assert not any("--reference-exact" in w for w in result.warnings)


@pytest.mark.prove
@pytest.mark.parametrize("exact", [False, True])
def test_explain_has_the_same_biases(exact: bool) -> None:
    """And nothing is missing but what each sensor may have."""
    made = device(0, not exact, biased=not exact, crooked=False)
    found = explain([made.recording], reference_exact=exact)
    assert found.verdict == "nothing_missing"
    biases = [p for p in found.parameters if p.effect in ("gyro_bias", "accel_bias")]
    error = np.array([p.value for p in biases]) - made.bias
    sigma = np.array([p.sigma for p in biases])
    assert np.all(np.abs(error) < 4.0 * sigma)
    assert np.all(sigma[:3] < 0.02 * GYRO)
    assert np.all(sigma[3:] < (0.01 if exact else 0.5) * ACCEL)

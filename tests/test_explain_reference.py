"""Beside a reference: what it cannot show is not on trial, and it is averaged as the IMU is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import recording_of

from handcal import calibrate
from handcal.effects import catalogue, select
from handcal.estimate import case
from handcal.estimate.baseline import baseline
from handcal.estimate.corrected import corrected_readings
from handcal.estimate.derivatives import errors_by_bias, relinearised
from handcal.estimate.fit import fitted
from handcal.explain import explain
from handcal.laws.grammar import formula
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.vocabulary import driver_of
from handcal.observations import Scene
from handcal.observations.known_input import matched
from handcal.types import Array, Imu, Recording, Series
from handcal_sim import simulate
from handcal_sim.phone import Phone, consumer_phone, trusted_reference, with_rate

G = 9.80665
# The form of a law in proportion to what it is over.
LINE = formula([("line", ())])


def beside(rng: np.random.Generator) -> Phone:
    """A consumer's phone of 200 Hz with a trusted IMU of the same rate on its back."""
    phone = with_rate(consumer_phone(rng), 200.0)
    return replace(phone, heading=None, reference=trusted_reference(rng))


def slower(rng: np.random.Generator) -> Phone:
    """The same phone, read fifty times a second."""
    return with_rate(beside(rng), 50.0)


def read(t: Array, rate: Array, tremor: float) -> Array:
    """Rate and force (n, 6) of a device that turns about x at rate[0], with a tremor about z."""
    w = 2.0 * math.pi * 10.0
    about_z = tremor / w * np.sin(w * t)
    turn = Rotation.from_rotvec(np.outer(t, rate)) * Rotation.from_rotvec(
        np.outer(about_z, [0.0, 0.0, 1.0])
    )
    small = Rotation.from_rotvec(np.outer(about_z, [0.0, 0.0, 1.0]))
    gyro = small.inv().apply(np.tile(rate, (len(t), 1))) + np.outer(
        tremor * np.cos(w * t), [0.0, 0.0, 1.0]
    )
    return np.hstack([gyro, turn.inv().apply([0.0, 0.0, G])])


def fast(rate: Array, tremor: float, reference_hz: float) -> Recording:
    """Four hundred readings a second, and a reference, both without any error."""
    t = np.arange(0.0, 8.0, 1.0 / 400.0)
    t_ref = np.arange(0.0013, 8.0, 1.0 / reference_hz)
    own, known = read(t, rate, tremor), read(t_ref, rate, tremor)
    imu = Imu(t, own[:, :3], own[:, 3:], np.ones(len(t), dtype=bool))
    return Recording("fast", imu, {"reference": Series(t_ref, known)})


def test_forces_are_averaged_in_axes_that_stand_still() -> None:
    """At 500 deg/s: to the fourth order in the turn; a plain mean would lose 3 mm/s^2."""
    rate = np.array([math.radians(500.0), 0.0, 0.0])
    imu = case.thinned(fast(rate, 0.0, 400.0)).imu
    wanted = Rotation.from_rotvec(np.outer(imu.t, rate)).inv().apply([0.0, 0.0, G])
    assert np.abs(imu.accel - wanted).max() < 1e-4
    np.testing.assert_allclose(imu.gyro, np.tile(rate, (len(imu.t), 1)), atol=1e-9)


def test_turns_one_after_the_other_are_counted_as_such() -> None:
    """A coning motion: the mean rate, integrated, ends where the readings do."""
    t = np.arange(0.0, 8.0, 1.0 / 400.0)
    middle = t + 0.5 / 400.0
    w = 2.0 * math.pi * 12.0
    gyro = 4.0 * np.stack([np.cos(w * middle), np.sin(w * middle), 0.0 * t], axis=1)
    recording = Recording("cone", Imu(t, gyro, 0.0 * gyro, np.ones(len(t), dtype=bool)), {})
    thin = case.thinned(recording).imu
    count = 400 // len(thin.t) if len(thin.t) < 400 else round(len(t) / len(thin.t))

    def end(rates: Array, dt: float) -> Rotation:
        total = Rotation.identity()
        for step in Rotation.from_rotvec(rates * dt):
            total = total * step
        return total

    exact = end(gyro, 1.0 / 400.0)
    with_coning = (exact.inv() * end(thin.gyro, count / 400.0)).magnitude()
    plain = gyro.reshape(-1, count, 3).mean(axis=1)
    without = (exact.inv() * end(plain, count / 400.0)).magnitude()
    assert without > 0.05
    assert with_coning < 0.05 * without


@pytest.mark.parametrize("reference_hz", [400.0, 200.0])
def test_a_reference_is_averaged_as_the_imu_is(reference_hz: float) -> None:
    """A tremor of 10 Hz, of which a mean over 10 ms loses 1.6 %, is the same in both."""
    thin = case.thinned(fast(np.array([1.0, 0.5, 0.0]), 0.3, reference_hz))
    both = matched(thin, Scene(np.zeros((0, 2)), has_heading=False))
    assert both is not None
    t = both.t[both.sound]
    own = np.hstack([thin.imu.gyro, thin.imu.accel])[np.searchsorted(thin.imu.t, t)]
    assert np.abs(own - both.known(t)).max() < 2e-3


def test_what_both_sensors_feel_is_not_on_trial() -> None:
    """Gravity and the Earth's rate; a clock that runs fast is, by the growing delay."""
    world = simulate("free-hand", seed=0, phone=beside, duration_s=20.0)
    this = case.case_of(recording_of(world, "reference"))
    applicable = {i for i, e in catalogue().items() if case.applicable(this, e)}
    assert not {"gravity", "earth_rate"} & applicable
    assert {"clock_rate", "accel_scale", "lever_arm"} <= applicable


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1])
def test_crooked_gyros_beside_an_arm(seed: int) -> None:
    """The reference's axes were fitted by the turns, and the arm was as crooked as the gyros: a
    size effect was named besides."""
    effects = {
        "gyro_misalignment": [-0.006, -0.014, -0.013, 0.012, 0.008, -0.006],
        "lever_arm": [0.077, -0.058, -0.08],
    }
    world = simulate("free-hand", seed=seed, phone=beside, duration_s=30.0, effects=effects)
    found = explain([recording_of(world, "reference")])
    assert found.verdict == "explained"
    assert {m.effect for m in found.missing} == set(effects)


@pytest.mark.prove
@pytest.mark.parametrize("ppm", [150.0, -150.0])
def test_a_clock_that_runs_fast_beside_a_reference(ppm: float) -> None:
    """At the end the device is 7 ms ahead, nearly half a radian of a tremor."""

    def usual(rng: np.random.Generator) -> Phone:
        return with_rate(beside(rng), 100.0)

    world = simulate(
        "free-hand", seed=1, phone=usual, duration_s=45.0, effects={"clock_rate": [ppm]}
    )
    found = explain([recording_of(world, "reference")])
    assert [m.effect for m in found.missing] == ["clock_rate"]
    (parameter,) = found.missing[0].parameters
    assert abs(parameter.value - ppm) < 4.0 * parameter.sigma


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_of_a_faster_reference_sets_no_clock(seed: int) -> None:
    """A polynomial through three moments has less noise at some times than at others; the clock
    was set to those, 10 to 17 % off (14 sigma), with false delays to make up for it."""

    def faster(rng: np.random.Generator) -> Phone:
        phone = with_rate(beside(rng), 95.0)
        assert phone.reference is not None
        clocking = replace(phone.reference.clocking, rate_hz=237.0)
        return replace(phone, reference=replace(phone.reference, clocking=clocking))

    world = simulate(
        "free-hand", seed=seed, phone=faster, duration_s=35.0, effects={"clock_rate": [100.0]}
    )
    found = explain([recording_of(world, "reference")])
    assert [m.effect for m in found.missing] == ["clock_rate"]
    (parameter,) = found.missing[0].parameters
    assert abs(parameter.value - 100.0) < 4.0 * parameter.sigma


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_of_the_reference_makes_no_arm_shorter(seed: int) -> None:
    """Slow turns: of the angular acceleration a tenth was noise, and an arm 14 sigma off."""

    def noisy(rng: np.random.Generator) -> Phone:
        phone = with_rate(beside(rng), 100.0)
        assert phone.reference is not None
        return replace(phone, reference=replace(phone.reference, gyro_noise=2e-4))

    arm = {"lever_arm": [0.1, -0.12, 0.08]}
    world = simulate("three-turns", seed=seed, phone=noisy, duration_s=30.0, effects=arm)
    found = calibrate(recording_of(world, "reference"), ["lever_arm"])
    for axis, wanted in zip("xyz", arm["lever_arm"], strict=True):
        got = found.parameter("lever_arm", axis)
        assert abs(got.value - wanted) < 5.0 * got.sigma


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_of_the_gyro_is_no_product_of_rates(seed: int) -> None:
    """Turning about one axis, what the others read is noise, and it is in both: in the residual
    and in the derivative by a product of rates, which was named."""
    world = simulate("three-turns", seed=seed, phone=beside, duration_s=40.0)
    found = explain([recording_of(world, "reference")])
    assert (found.verdict, found.missing) == ("nothing_missing", ())


def slowly(noise: float, rate_hz: float) -> Callable[[np.random.Generator], Phone]:
    """A phone beside a reference with so much more noise in its gyro."""

    def phone(rng: np.random.Generator) -> Phone:
        made = with_rate(beside(rng), rate_hz)
        return replace(made, gyro=replace(made.gyro, noise=noise * made.gyro.noise))

    return phone


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("tau", [0.01, 0.03])
def test_a_low_pass_beside_a_reference(tau: float, seed: int) -> None:
    """The reading's derivative was noise for a half, and grew with tau: 3 to 14 sigma too low,
    or a delay, a clock and a scale in its place."""
    world = simulate(
        "three-turns", seed=seed, phone=slowly(1.5, 105.0), duration_s=40.0,
        effects={"gyro_bandwidth": [tau]},
    )  # fmt: skip
    found = explain([recording_of(world, "reference")])
    assert [m.effect for m in found.missing] == ["gyro_bandwidth"]
    (parameter,) = found.missing[0].parameters
    assert abs(parameter.value - tau) < 4.0 * parameter.sigma


@pytest.mark.prove
@pytest.mark.parametrize("seed", [1, 0, 2])
def test_accelerometers_apart_in_slow_turns_beside_a_reference(seed: int) -> None:
    """Angular acceleration of the IMU's own gyro, a half of it noise, for these, and of the
    reference's for an arm: that difference, hundreds of nats, was named as an arm."""
    places = [0.017, 0.025, 0.019, -0.027, -0.011, 0.027, 0.017, 0.015, -0.030]
    world = simulate(
        "three-turns", seed=seed, phone=slowly(1.0, 131.0), duration_s=60.0,
        effects={"size_effect": places},
    )  # fmt: skip
    found = explain([recording_of(world, "reference")])
    assert [m.effect for m in found.missing] == ["size_effect"]
    for p, wanted in zip(found.missing[0].parameters, places, strict=True):
        assert abs(p.value - wanted) < 4.0 * p.sigma


@pytest.mark.prove
def test_evidence_is_not_for_what_makes_readings_smaller() -> None:
    """Two gyros, one 5 % too large and one too small, with the same noise in what they read, are
    understood as well: evidence was for the larger by 0.1 nats for each reading, since what is left
    of it after the correction has so much less noise."""
    log_evidence, readings = [], 0
    for scale in (-0.05, 0.05):
        effects = {"gyro_scale": [scale] * 3}
        world = simulate("three-turns", seed=0, duration_s=40.0, phone=slower, effects=effects)
        base = baseline([case.case_of(recording_of(world, "reference"), "auto")])
        model = fitted(base.parts, [*base.effects, *select(["gyro_scale"])], noise_rounds=2)
        log_evidence.append(model.log_evidence)
        readings = 3 * len(model.parts[0].linear.kind)
    assert abs(log_evidence[1] - log_evidence[0]) < 0.2 * (2 * 0.05 * readings)


def test_what_a_law_is_a_function_of_has_no_noise_of_what_it_is_compared_with() -> None:
    """The play of what a reference read, less that, was its own noise: it promised thousands of
    nats beside two arrays, and no fit with it held. N = 4000 samples: a correlation by chance has
    1 / sqrt(N)."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.005)
    swing = 0.5 * np.sin(np.outer(t, [1.3, 1.7, 2.1])) + np.array([0.0, 0.0, G])
    own = np.hstack([0.1 * np.cos(np.outer(t, [0.7, 0.9, 1.1])), swing])
    noise = 0.05 * rng.normal(size=own.shape)
    imu = Imu(t, own[:, :3], own[:, 3:], np.ones(len(t), dtype=bool))
    recording = Recording("both", imu, {"reference": Series(t, own + noise)})
    law = effect_of(Law(1, (0,), False, driver_of("(play(0.08 m/s^2) of f_{i} - f_{i})"),
                        LINE, (1.0,)))  # fmt: skip
    problem = case.problem_with(case.case_of(recording), [law])
    zero = np.zeros(3)
    columns = relinearised(problem, np.zeros(1), zero, zero).nodes.J[:, 3, 0]
    at_nodes = np.interp(problem.nodes.t, t, noise[:, 3])
    assert columns.std() > 0.02  # (m/s^2: it plays)
    assert abs(np.corrcoef(columns, at_nodes)[0, 1]) < 4.0 / math.sqrt(len(t))


@pytest.mark.parametrize(
    ("name", "itself"),
    [("(memory(0.1 s) of f_{i} - f_{i})", 1.0 - 0.005 / 0.1), ("(memory(0.1 s) of f_{i})", -0.05),
     ("(echo(0.05 s) of f_{i} - f_{i})", 1.0), ("f_{i} * |f|", None)],
)  # fmt: skip
def test_noise_is_counted_as_what_a_sample_does_to_itself(name: str, itself: float | None) -> None:
    """By k times what a signal was, less the signal, noise becomes smaller by (1 - k) and the mean
    does not change: evidence was for the law (of a recording beside an array, by 1,300 nats). By
    how much less is added where this sample alone is larger, of a unit of k; of a law without
    memory it is what all of them do."""
    t = np.arange(0.0, 30.0, 0.005)
    swing = 5.0 * np.sin(np.outer(t, [1.3, 1.7, 2.1])) + np.array([0.0, 0.0, G])
    own = np.hstack([0.1 * np.cos(np.outer(t, [0.7, 0.9, 1.1])), swing])
    imu = Imu(t, own[:, :3], own[:, 3:], np.ones(len(t), dtype=bool))
    recording = Recording("both", imu, {"reference": Series(t, own)})
    k = 0.01 if itself is None else 0.2
    law = effect_of(Law(1, (0, 1, 2), False, driver_of(name), LINE, (1.0,)))
    problem = case.problem_with(case.case_of(recording), [law])
    zero = np.zeros(3)
    done = corrected_readings(problem, np.array([k]), zero, zero).problem
    by_bias = errors_by_bias(done, zero, zero)
    assert by_bias is not None
    every, alone = (x[200:-200, 3:, 3:].mean(axis=0) for x in by_bias)
    if itself is None:
        np.testing.assert_allclose(alone, every, atol=1e-12)
        return
    # (by chance: k over the root of as many signs)
    np.testing.assert_allclose(alone, k * itself * np.eye(3), atol=4.0 * k / math.sqrt(len(t)))

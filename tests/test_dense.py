"""Every fit estimates what every device has beside biases: what is told holds for such a device."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proved import proved
from typer.testing import CliRunner
from worlds import injected, recording_of

from handcal import calibrate
from handcal.commands._app import app
from handcal.design.motion import plan
from handcal.device import apply as taking
from handcal.effects import catalogue, select
from handcal.estimate.baseline import baseline
from handcal.estimate.calibration import ONLY
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted, with_usual_noise
from handcal.estimate.parameters import given_model
from handcal.motions import MOTIONS
from handcal.motions import recording_of as made_of
from handcal.recordings.export import write_mcap
from handcal.show.calibration.summary import calibration_json
from handcal.types import Array, Imu, Parameter, Recording, Result, Series
from handcal_sim import simulate
from handcal_sim.phone import Phone, consumer_magnetometer, consumer_phone
from handcal_sim.scenario import World

# What an ordinary device has, in sizes as its priors say.
ORDINARY = (
    "gyro_scale", "gyro_misalignment", "gyro_g_sensitivity", "accel_scale", "accel_misalignment",
    "lever_arm", "heading_hard_iron",
)  # fmt: skip


def ordinary(seed: int, motion: str = "z-turn") -> World:
    rng = np.random.default_rng(seed)
    errors = {i: rng.normal(0.0, catalogue()[i].prior_sigma).tolist() for i in ORDINARY}
    return simulate(motion, seed=seed, duration_s=30.0, effects=errors)


def biases(world: World) -> Array:
    """Those of gyro and accelerometer (6,), a walking one's mean."""
    walked = world.parameters["mean_walk"]
    return np.concatenate([injected(world, f"{s}_bias") + walked[s] for s in ("gyro", "accel")])


# --- an ordinary device -------------------------------------------------------------------------


@pytest.mark.prove
def test_biases_are_as_far_off_as_is_said_and_without_the_rest_they_are_not() -> None:
    """In a turn about the vertical, where gravity hides what else there is. Eighteen errors of a
    normal density lie within three sigma of each with a probability of 0.95."""
    off: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(3):
        world = ordinary(seed)
        recording = recording_of(world, "heading")
        for only, found in off.items():
            told = calibrate(recording, assume="fixed-point", only=only).parameters[:6]
            assert all(p.sigma < p.prior_sigma for p in told)
            found += [
                abs(p.value - true) / p.sigma for p, true in zip(told, biases(world), strict=True)
            ]
    assert max(off[False]) < 3.0
    assert max(off[True]) > 5.0


@pytest.mark.prove
def test_what_is_asked_for_alone_is_said_to_be_alone(tmp_path: Path) -> None:
    """By the function and by the command; without it nothing is said, and all is estimated."""
    recording = recording_of(simulate("three-turns", seed=0, duration_s=12.0), "heading")
    alone = calibrate(recording, ["gyro_scale"], only=True)
    assert f"{ONLY} and gyro_scale." in alone.warnings
    assert f"{ONLY}." in calibrate(recording, only=True).warnings
    whole = calibrate(recording)
    assert not any(ONLY in w for w in whole.warnings)
    file, result = tmp_path / "x.mcap", tmp_path / "x.json"
    write_mcap(recording, file)
    for options, effects in (([], whole), (["--only", "--effects", "gyro_scale"], alone)):
        command = ["calibrate", str(file), "--json", str(result), *options]
        assert CliRunner().invoke(app, command).exit_code == 0
        said = json.loads(result.read_text())
        assert [p["effect"] for p in said["parameters"]] == [p.effect for p in effects.parameters]
        assert any(ONLY in w for w in said["warnings"]) == bool(options)


# --- given what was found -----------------------------------------------------------------------


def test_what_is_given_the_model_is_the_conditional_density() -> None:
    """By elimination from the information matrix, in another order of the parameters; units are
    such that variances differ by 1e16."""
    rng = np.random.default_rng(0)
    effects = ["gyro_bias"] * 2 + ["lever_arm"] * 2 + ["gyro_scale", "accel_delay"]
    unit = np.array([1e-4, 1e-4, 1e-2, 1e-2, 1.0, 1e4])
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T * np.outer(unit, unit)
    mean = rng.normal(size=6) * unit
    parameters = [
        Parameter(e, str(k), float(m), math.sqrt(covariance[k, k]), "1", float(unit[k]), None)
        for k, (e, m) in enumerate(zip(effects, mean, strict=True))
    ]
    value, sigma = given_model(parameters, covariance, {"gyro_scale"})
    inside, outside = [0, 1, 4], [2, 3, 5]
    information = np.linalg.inv(covariance / np.outer(unit, unit))
    left = np.linalg.inv(information[np.ix_(inside, inside)])
    moved = left @ information[np.ix_(inside, outside)] @ (mean / unit)[outside]
    np.testing.assert_allclose((value / unit)[inside], (mean / unit)[inside] + moved, rtol=1e-6)
    np.testing.assert_allclose((sigma / unit)[inside], np.sqrt(np.diag(left)), rtol=1e-6)
    assert not value[outside].any()
    assert not sigma[outside].any()
    same, as_before = given_model(parameters, covariance, set(effects))
    np.testing.assert_array_equal(same, mean)
    np.testing.assert_allclose(as_before, np.sqrt(np.diag(covariance)))


@pytest.mark.prove
def test_given_nothing_else_biases_are_those_of_a_fit_without() -> None:
    """Of a device without further errors; the two fits find their own noise levels."""
    recording = recording_of(simulate("free-hand", seed=0, duration_s=30.0), "heading")
    whole, alone = (calibrate(recording, assume="fixed-point", only=o) for o in (False, True))
    value, sigma = given_model(whole.parameters, whole.covariance, ())
    for k, p in enumerate(alone.parameters):
        assert (p.effect, p.name) == (whole.parameters[k].effect, whole.parameters[k].name)
        assert abs(value[k] - p.value) < p.sigma
        assert sigma[k] == pytest.approx(p.sigma, rel=0.3)
        assert whole.parameters[k].sigma > sigma[k]


# --- what the recording itself says -------------------------------------------------------------


def with_magnetometer(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), mag=consumer_magnetometer(rng))


@pytest.mark.parametrize(
    ("stream", "seed"),
    [("heading", 0), *proved(("heading", 1)), ("mag", 2)],
)
def test_likelihood_and_prior_are_the_posterior(stream: str, seed: int) -> None:
    """Also where the recording has constants of its own (the strengths of the field)."""
    scale = {"gyro_scale": [0.01, -0.008, 0.006]}
    world = simulate(
        "free-hand", seed=seed, duration_s=30.0, effects=scale, phone=with_magnetometer
    )
    result = calibrate(recording_of(world, stream), [*scale], assume="fixed-point", only=True)
    told = result.likelihood
    assert told is not None
    assert told.names == tuple((p.effect, p.name) for p in result.parameters)
    usual = np.array([p.prior_sigma for p in result.parameters])
    sigma = np.array([p.sigma for p in result.parameters])
    covariance = np.linalg.inv(told.information + np.diag(usual**-2.0))
    mean = covariance @ told.vector
    # (scores that scatter more than the information says widen an effect's sigmas, and all that the
    # recording says by the same power)
    wider = np.diag(covariance) / sigma**2
    assert np.ptp(wider[:6]) < 0.05
    assert wider[0] > 0.95
    assert np.all(wider[6:] < wider[0] + 0.05)
    correlations = [C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
                    for C in (covariance, result.covariance)]  # fmt: skip
    np.testing.assert_allclose(*correlations, atol=0.05)
    away = mean - np.array([p.value for p in result.parameters])
    assert np.abs(away / sigma).max() < 0.05
    # (it has no prior in it: what is said is more than that, and of the truth)
    assert np.all(np.diag(told.information) > 2.0 * usual**-2.0)
    own = calibration_json(result)["likelihood"]
    assert [tuple(n) for n in own["parameters"]] == [*told.names]
    np.testing.assert_array_equal(own["information"], told.information)


# --- warm devices -------------------------------------------------------------------------------

SLOPE = np.radians([0.1, -0.1, 0.1])
FROM_DEGC, TO_DEGC, ROOM = 37.0, 43.0, 25.0


@pytest.fixture(scope="module")
def warm() -> tuple[World, Recording]:
    """A device at 40 degC, whose gyro errs by what it is warmer than a room."""
    world = simulate("three-turns", seed=0, duration_s=20.0)
    recording = recording_of(world, "heading")
    imu = recording.imu
    degrees = np.interp(imu.t, [imu.t[0], imu.t[-1]], [FROM_DEGC, TO_DEGC])
    gyro = imu.gyro + (degrees - ROOM)[:, None] * SLOPE
    temperature = Series(imu.t[::10], degrees[::10, None])
    streams = {**recording.streams, "temperature": temperature}
    return world, replace(recording, imu=replace(imu, gyro=gyro), streams=streams)


def test_a_bias_is_that_at_the_mean_temperature(warm: tuple[World, Recording]) -> None:
    world, recording = warm
    result = calibrate(recording, assume="fixed-point")
    middle = 0.5 * (FROM_DEGC + TO_DEGC)
    assert result.recording.bias_temperature == pytest.approx(middle, abs=0.1)
    for k, axis in enumerate("xyz"):
        p = result.parameter("gyro_bias", axis)
        at_room = biases(world)[k]
        assert abs(p.value - at_room - (middle - ROOM) * SLOPE[k]) < 3.0 * p.sigma
        assert abs(p.value - at_room) > 5.0 * p.sigma
        slope = result.parameter("gyro_temperature", axis)
        assert abs(slope.value - SLOPE[k]) < 3.0 * slope.sigma


def test_what_is_taken_off_is_the_bias_at_each_temperature(warm: tuple[World, Recording]) -> None:
    """Biases of the mean temperature and slopes about 25 degC are not taken off twice."""
    world, recording = warm
    result = calibrate(recording, ["gyro_temperature"], assume="fixed-point", only=True)
    learnt = taking.of_document("x.json", calibration_json(result))
    left = taking.apply(recording, learnt, biases=True).recording.imu.gyro - world.truth.omega
    worst = max(p.sigma for p in result.parameters[:3])
    assert np.abs(left.mean(axis=0)).max() < 4.0 * worst < 0.1 * 15.0 * np.abs(SLOPE).min()


def test_a_motion_is_planned_at_the_temperature_at_which_biases_are_known() -> None:
    """Without warming up no motion tells a slope, however warm the device is and however well its
    biases are known."""
    turn = next(m for m in MOTIONS if "its x axis" in m.sentence)
    still = Recording("like", simulated_rest())
    t = still.imu.t[::10]
    hot = replace(still, streams={"temperature": Series(t, np.full((len(t), 1), 45.0))})
    recording = made_of(turn, hot, np.array([0.0, 0.0, -9.80665]))
    rng = np.random.default_rng(0)
    imu = recording.imu
    noisy = replace(
        imu,
        gyro=imu.gyro + 1e-3 * rng.standard_normal(imu.gyro.shape),
        accel=imu.accel + 1e-2 * rng.standard_normal(imu.gyro.shape),
    )
    known = plan(["gyro_temperature"], replace(recording, imu=noisy), assume="fixed-point")
    before = np.array([w.sigma for w in known.wanted])
    for p in known.prospects:
        if p.motion.warming:
            assert (p.sigma < 0.5 * before).all()
        else:
            np.testing.assert_allclose(p.sigma, before, rtol=0.01)


def simulated_rest() -> Imu:
    """Five seconds level and still."""
    t = np.arange(0.0, 5.0, 0.01)
    accel = np.tile([0.0, 0.0, 9.80665], (len(t), 1))
    return Imu(t, np.zeros_like(accel), accel, np.ones(len(t), dtype=np.bool_))


# --- far from where a fit begins ----------------------------------------------------------------

FAR = (0.2, -0.2, 0.2)


def far_off(result: Result) -> Array:
    """How far the gyro's scales are from the truth, in their sigmas."""
    own = [result.parameter("gyro_scale", axis) for axis in "xyz"]
    assert all(p.sigma < 0.5 * abs(true) for p, true in zip(own, FAR, strict=True))
    return np.array([(p.value - true) / p.sigma for p, true in zip(own, FAR, strict=True)])


@pytest.mark.prove
def test_a_strong_error_is_found_in_a_short_motion() -> None:
    """Twenty times the usual scale error, in twelve seconds."""
    world = simulate("three-turns", seed=0, duration_s=12.0, effects={"gyro_scale": FAR})
    result = calibrate(recording_of(world, "heading"), assume="fixed-point")
    assert result.settled
    assert np.abs(far_off(result)).max() < 4.0


def test_of_a_step_to_what_is_no_motion_a_part_is_taken() -> None:
    """Begun with the usual noise, a whole step leads where nothing can be linearised."""
    world = simulate("free-hand", seed=1, duration_s=20.0, effects={"gyro_scale": FAR})
    base = baseline([case_of(recording_of(world, "heading"), "fixed-point")])
    (scale,) = select(["gyro_scale"])
    found = fitted([with_usual_noise(f) for f in base.parts], [scale], noise_rounds=2)
    assert found.settled
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(sigma * scale.prior_sigma < 0.05 * np.abs(FAR))
    assert np.abs((found.u * scale.prior_sigma - FAR) / scale.prior_sigma / sigma).max() < 4.0

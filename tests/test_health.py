"""What is wrong with a recording is said before any physics, with the option that puts it right;
what is stated is used; and where going on makes no sense, nothing is estimated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proved import proved

import handcal
from handcal.estimate.observed import check_options
from handcal.lab import scalar
from handcal.recordings.inputs import load, of_arrays
from handcal.recordings.inputs._turning import SIGNED, named
from handcal.types import HandcalError, InputError
from handcal_sim import simulate
from handcal_sim.motion_ordinary import six_sides
from handcal_sim.phone import consumer_magnetometer, consumer_phone

CASES = Path(__file__).parents[2] / "shared" / "cases"


def with_mag(rng):
    return replace(consumer_phone(rng), heading=None, mag=consumer_magnetometer(rng))


@pytest.fixture(scope="module", params=["free-hand", *proved("six sides")])
def shown(request):
    """Stamps, rates and forces, and a magnetometer, in a motion that shows all of them."""
    motion = {"six sides": six_sides}.get(request.param, request.param)
    world = simulate(motion, seed=0, duration_s=40.0, phone=with_mag)
    mag = world.streams["mag"]
    return world.imu.stamps, world.imu.values, (mag.stamps, mag.values)


def read(t, values, mag=None):
    streams = {} if mag is None else {"mag": (mag, 3)}
    return of_arrays("health", t, values[:, :3], values[:, 3:6], streams)


def test_nothing_is_said_of_a_sound_recording(shown):
    assert read(*shown).warnings == ()


@pytest.mark.parametrize("factor", [0.5, 4.0])
def test_another_full_scale_of_the_gyro_is_said_and_nothing_is_estimated(shown, factor):
    t, values, _ = shown
    spoilt = read(t, values * ([factor] * 3 + [1.0] * 3))
    assert f"turns {1 / factor:.2g}" in spoilt.unfit.replace("2.0", "2").replace("4.0", "4")
    assert spoilt.unfit in spoilt.warnings
    for refuse in (lambda: check_options(spoilt, "auto", None, ()), lambda: scalar.scalar(spoilt)):
        with pytest.raises(HandcalError, match="full scale or the sample rate"):
            refuse()


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_sample_rate_is_said_likewise(shown, factor):
    t, values, _ = shown
    assert "sample rate" in read(factor * t, values).unfit


@pytest.mark.parametrize("factor", [0.25, 2.0])
def test_another_full_scale_of_the_accelerometer_is_said(shown, factor):
    t, values, _ = shown
    assert f"--units accel=m/s^2/{factor:g}" in read(t, values * ([1] * 3 + [factor] * 3)).unfit


def test_a_usual_scale_error_is_none(shown):
    t, values, _ = shown
    assert read(t, values * ([1.06] * 3 + [0.97] * 3)).warnings == ()


@pytest.mark.parametrize("k", [1, 33])
def test_a_magnetometer_on_other_axes_is_turned_and_that_is_said(shown, k):
    t, values, (tm, mag) = shown
    A = SIGNED[k]
    right = read(t, values, (tm, mag)).streams["mag"].value
    back = read(t, values, (tm, mag @ A.T))
    assert f"magnetometer's axes are ({', '.join(named(A))})" in back.warnings[0]
    np.testing.assert_allclose(back.streams["mag"].value, right)


def test_a_magnetometer_whose_axes_one_turn_does_not_tell_is_left_out():
    """Level, and turned to and fro about the vertical: any axes that count the other way round."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 40.0, 0.01)
    rate, yaw = np.sin(0.5 * t), 2.0 * (1.0 - np.cos(0.5 * t))
    values = np.c_[0 * t, 0 * t, rate, 0 * t, 0 * t, 9.81 + 0 * t]
    values += rng.normal(0.0, [1e-3] * 3 + [0.02] * 3, values.shape)
    field = 1e-5 * np.c_[2 * np.sin(yaw) + 1, 2 * np.cos(yaw) - 2, -4 + 0 * t]
    field += rng.normal(0.0, 3e-7, field.shape)
    assert read(t, values, (t, field)).warnings == ()
    back = read(t, values, (t, field[:, [1, 0, 2]]))
    assert "mag" not in back.streams
    assert "does not tell in which axes" in back.warnings[0]
    assert "--axes mag=" in back.warnings[0]


def table(tmp_path, t, values, header="t,gx,gy,gz,ax,ay,az"):
    path = tmp_path / "x.csv"
    np.savetxt(path, np.column_stack([t, values[:, :6]]), delimiter=",", comments="", header=header)
    return path


def test_what_is_stated_is_used(shown, tmp_path):
    t, values, _ = shown
    path = table(tmp_path, t, values * ([180 / np.pi] * 3 + [1.0] * 3))
    with pytest.raises(InputError, match="gyro=deg/s"):
        load(path)
    stated = load(path, units={"gyro": "rad/s"})
    assert "gyro=deg/s" in stated.warnings[0]
    assert "stated" in stated.warnings[0]
    assert stated.unfit == ""
    half = table(tmp_path, t, values * ([0.5] * 3 + [1.0] * 3))
    assert load(half).unfit
    assert not load(half, units={"gyro": "rad/s"}).unfit


def test_all_that_is_wrong_is_said_at_once(shown):
    t, values, _ = shown
    with pytest.raises(InputError, match=r"accel=g.*gyro=deg/s"):
        read(t, values * ([180 / np.pi] * 3 + [1 / 9.80665] * 3))


def test_a_time_that_counts_samples_is_met_with_the_rate(shown, tmp_path):
    """Of arrays the refusal says which by gravity's turning."""
    t, values, _ = shown
    with pytest.raises(InputError, match=r"counts samples\..*give --rate HZ"):
        load(table(tmp_path, np.arange(float(len(t))), values))
    with pytest.raises(
        InputError, match=r"counts samples: give --rate .* about (9[5-9]|10[0-5])\."
    ):
        read(np.arange(float(len(t))), values)


def test_an_impossible_temperature_is_said(shown):
    t, values, _ = shown
    streams = {"temperature": ((t[::50], np.full(len(t[::50]), 298.0)), 1)}
    back = of_arrays("x", t, values[:, :3], values[:, 3:6], streams)
    assert "temperature reads 298" in back.warnings[0]


SAID = {
    "gyro_half": "turns 2.0 times as far as the gyroscope says",
    "gyro_double": "turns 0.5 times as far as the gyroscope says",
    "accel_half": "reads 0.51 g at rest",
    "bursts": "10 readings every 0.2 s; they were put at a steady 50 Hz",
    "mag_axes_exchanged": "magnetometer's axes are (y, x, -z) of the IMU's",
    "leg_swing": "", "mag_axes_right": "", "still_2_percent_lost": "",
}  # fmt: skip
REFUSED = {
    "deg_unlabelled": "--units gyro=deg/s",
    "index_as_time": r"counts samples\..*give --rate HZ",
}


@pytest.fixture(scope="module")
def cases():
    if not CASES.exists():
        pytest.skip("needs the public cases in ../shared/cases")
    return CASES


@pytest.mark.parametrize("name", SAID)
def test_public_cases_are_met_with_the_right_sentence(cases, name):
    said = " ".join(load(cases / f"{name}.csv").warnings)
    assert SAID[name] in said
    assert bool(said) == bool(SAID[name])


@pytest.mark.parametrize("name", REFUSED)
def test_public_cases_are_refused_with_the_option(cases, name):
    with pytest.raises(InputError, match=REFUSED[name]):
        load(cases / f"{name}.csv")


@pytest.mark.parametrize("unit", ["rad/s", "deg/s"])
def test_a_stated_unit_of_a_leg_that_swings_is_used(cases, unit):
    given = load(cases / "leg_swing.csv", units={"gyro": unit})
    as_read = load(cases / "leg_swing.csv").imu.gyro
    np.testing.assert_allclose(given.imu.gyro, as_read * (np.pi / 180 if unit == "deg/s" else 1))


TRUTH = {
    "gyro_scale": (0.012, -0.008, 0.006), "accel_scale": (0.008, -0.006, 0.012),
    "gyro_bias": tuple(np.radians([0.8, -0.5, 0.3])), "accel_bias": (0.15, -0.10, 0.20),
}  # fmt: skip


@pytest.mark.parametrize("name", ["bursts", *proved("gap_in_rest")])
def test_bursts_and_a_gap_cost_a_calibration_nothing(cases, name):
    result = handcal.calibrate(load(cases / f"{name}.csv"))
    for effect, truth in TRUTH.items():
        for axis, true in zip("xyz", truth, strict=True):
            p = result.parameter(effect, axis)
            assert p.shown
            assert abs(p.value - true) < 4 * p.sigma, (effect, axis)


@pytest.mark.prove
def test_a_fit_that_leaves_metres_names_nothing(cases):
    recording = load(cases / "gyro_half.csv", units={"gyro": "rad/s"})
    found = handcal.explain(recording, budget=5.0)
    assert (found.verdict, found.trust) == ("unexplained", "none")
    assert found.missing == ()
    assert any("strays by" in w and "Check full scales" in w for w in found.trust_reasons)

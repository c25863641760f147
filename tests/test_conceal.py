"""What `conceal` adds is what the simulator, written apart, adds; and it can be found again."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner
from worlds import recording_of

import handcal
from handcal import calibrate
from handcal.commands import _app
from handcal.commands._registry import run
from handcal.compiled import so3
from handcal.device import conceal as hidden
from handcal.device.apply import Learnt, apply
from handcal.effects import select
from handcal.observations import catalogue as observations
from handcal.recordings.export import write_mcap
from handcal.recordings.streams import STREAMS
from handcal.types import InputError, Series
from handcal_sim import simulate
from handcal_sim.phone import (
    Clocking,
    Reference,
    Thermometer,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
)

# Sizes of a consumer device's errors, and how much of the change in rms may go astray.
ON_IMU = {
    "gyro_scale": ([0.01, -0.02, 0.005], 0.02),
    "accel_scale": ([0.01, -0.005, 0.02], 0.06),
    "gyro_misalignment": ([0.01, -0.01, 0.02, 0.0, 0.005, -0.01], 0.02),
    "accel_misalignment": ([0.01, -0.01, 0.005], 0.06),
    "gyro_g_sensitivity": ([1e-4, 2e-4, -1e-4, 3e-4, -2e-4, 1e-4, 0.0, 1e-4, 2e-4], 0.06),
    "gyro_quadratic": ([0.005, -0.003, 0.006], 0.03),
    "gyro_cross_products": ([0.005, -0.003, 0.006] * 3, 0.03),
    "accel_cross_products": ([4e-4, -3e-4, 5e-4] * 3, 0.03),
    "accel_asymmetry": ([0.02, -0.02, 0.01], 0.03),
    "lever_arm": ([0.1, -0.05, 0.03], 0.08),
    "size_effect": ([0.02, 0.01, -0.01, -0.01, 0.02, 0.0, 0.01, 0.0, -0.02], 0.08),
    "gyro_temperature": ([1e-3, -2e-3, 5e-4], 0.02),
    "accel_temperature": ([0.01, -0.02, 0.03], 0.02),
    "accel_delay": ([0.02], 0.08),
    "gyro_bandwidth": ([0.02], 0.08),
    "gyro_bias_step": ([0.01, -0.01, 0.02, 11.3], 0.03),
    "gravity": ([0.05], 0.05),
    "earth_rate": ([1e-3, -5e-4], 0.06),
}
# (what a heading's constant offset does to sin and cos of twice the yaw nobody can know)
ON_HEADING = {
    "heading_hard_iron": ([0.2, -0.1], 0.05),
    "heading_soft_iron": ([0.1, -0.15], 0.15),
    "heading_drift": ([0.005], 0.01),
}
# What a bias makes of a scale error or a misalignment is a bias: not counted.
UP_TO_A_BIAS = ("accel_scale", "accel_misalignment", "gyro_g_sensitivity")


def quiet_phone(rng, **more):
    """A consumer's device of hardly any noise, so that what is added stands out."""
    phone = consumer_phone(rng)
    still = {"noise": 1e-6, "quantum": 0.0}
    return dataclasses.replace(
        phone,
        gyro=dataclasses.replace(phone.gyro, **still),
        accel=dataclasses.replace(phone.accel, **still),
        heading=dataclasses.replace(phone.heading, sigma=1e-3),
        thermometer=Thermometer(sigma=0.0, reported=True),
        **more,
    )


def world(effects=None, seed=4, **more):
    phone = quiet_phone(np.random.default_rng(2), **more)
    return simulate("free-hand", seed=seed, duration_s=25.0, phone=phone, effects=effects)


@pytest.fixture(scope="module")
def plain():
    return recording_of(world(), "heading", "temperature")


@pytest.fixture(scope="module")
def result(plain):
    return calibrate(plain, only=True)


@pytest.fixture
def once(monkeypatch, plain, result):
    """One calibration serves all tests of the plain recording."""

    def made(recording, beside, *, only):
        mine = recording is plain and not beside and only
        return result if mine else calibrate(recording, beside, only=only)

    monkeypatch.setattr(hidden, "calibrate", made)


def concealed(recording, effects, seed=0):
    return hidden.conceal(recording, effects, np.random.default_rng(seed))


def rms(x):
    return float(np.sqrt((x**2).mean()))


def assert_same_change(found, wanted, share):
    assert rms(wanted) > 0
    assert rms(found - wanted) < share * rms(wanted)


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize("effect", ON_IMU)
def test_readings_change_as_in_the_simulator(plain, effect):
    values, share = ON_IMU[effect]
    wanted, found = (
        recording_of(world({effect: values})).imu,
        concealed(plain, {effect: values}).imu,
    )
    for new, old, simulated in (
        (found.gyro, plain.imu.gyro, wanted.gyro),
        (found.accel, plain.imu.accel, wanted.accel),
    ):
        change, right = new - old, simulated - old
        if effect == "earth_rate" and old is plain.imu.accel:
            right = np.zeros_like(right)  # Coriolis: micrometres per second squared
        if effect in UP_TO_A_BIAS:
            change, right = change - change.mean(axis=0), right - right.mean(axis=0)
        if rms(right) > 1e-9:
            assert_same_change(change, right, share)
        else:
            np.testing.assert_allclose(change, 0.0, atol=1e-12)


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize("effect", ON_HEADING)
def test_headings_change_as_in_the_simulator(plain, effect):
    values, share = ON_HEADING[effect]
    old = plain.streams["heading"].value
    wanted = recording_of(world({effect: values}), "heading").streams["heading"].value
    found = concealed(plain, {effect: values}).streams["heading"].value
    assert_same_change(so3.wrap(found - old), so3.wrap(wanted - old), share)


def test_delays_shift_the_stamps(plain):
    old, new = (r.streams["heading"] for r in (plain, concealed(plain, {"heading_delay": [0.15]})))
    np.testing.assert_allclose(new.t, old.t[: len(new.t)] + 0.15)
    np.testing.assert_array_equal(new.value, old.value[: len(new.value)])
    late = recording_of(world({"heading_delay": [0.15]}), "heading").streams["heading"]
    turned = np.interp(late.t, new.t, np.unwrap(new.value[:, 0]), left=np.nan)
    assert np.nanmedian(np.abs(so3.wrap(turned - late.value[:, 0]))) < 0.005


@pytest.mark.usefixtures("once")
def test_noise_is_as_large_as_asked(plain):
    many = np.linspace(0.0, plain.duration_s, 20_000)
    yaw = np.interp(many, plain.streams["heading"].t, plain.streams["heading"].value[:, 0])
    dense = dataclasses.replace(plain, streams={"heading": Series(many, yaw[:, None])})
    known, kind = hidden.Truth(plain, ()), observations()["heading"]

    def error_of(effect, *values):
        values = {effect: np.array(values)}
        chosen, rng = select([effect]), np.random.default_rng(1)
        row, series = STREAMS["heading"], dense.streams["heading"]
        return hidden._shift(kind, row, series, chosen, values, 0.0, known, rng)[:, 0]

    error = error_of("heading_correlated_noise", 0.1, 0.05)
    assert rms(error) == pytest.approx(0.1, rel=0.1)
    step = many[1]
    assert np.corrcoef(error[1:], error[:-1])[0, 1] == pytest.approx(np.exp(-step / 0.05), abs=0.01)
    error = error_of("heading_outliers", 0.1)
    assert np.mean(error != 0.0) == pytest.approx(0.1, abs=0.01)
    assert rms(error[error != 0.0]) == pytest.approx(np.pi / np.sqrt(3), rel=0.03)
    for sensor in ("gyro", "accel"):
        walked = concealed(dense, {f"{sensor}_bias_walk": [1e-3]}).imu
        steps = np.diff(getattr(walked, sensor) - getattr(plain.imu, sensor), axis=0)
        assert rms(steps) == pytest.approx(1e-3 * np.sqrt(1 / plain.rate_hz), rel=0.05)


def test_same_seed_same_recording(plain):
    a, b, c = (concealed(plain, {"gyro_bias_walk": [1e-3]}, seed).imu.gyro for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


def test_saturated_readings_stay(plain):
    imu = plain.imu
    valid = np.ones(len(imu.t), dtype=bool)
    valid[100:110] = False
    masked = dataclasses.replace(plain, imu=dataclasses.replace(imu, valid=valid))
    found = concealed(masked, {"gyro_scale": [0.1] * 3, "accel_delay": [0.02]}).imu
    np.testing.assert_array_equal(found.gyro[100:110], imu.gyro[100:110])
    np.testing.assert_array_equal(found.accel[100:110], imu.accel[100:110])
    assert not found.valid[100:112].any()  # what is read late was felt while saturated
    assert found.valid[:99].all()
    assert found.valid[113:].all()


@pytest.mark.parametrize("seed", range(3))
def test_errors_of_the_device_are_no_motion(seed):
    """Of a scale 5 % too large, and known, an added quadratic error takes 10 % too much."""
    more, own = {"gyro_quadratic": [0.05, -0.04, 0.03]}, {"gyro_scale": [0.05, 0.05, 0.05]}
    both, one = recording_of(world({**own, **more}, seed=seed)), recording_of(world(own, seed=seed))
    learnt = Learnt("", {i: np.array(v) for i, v in own.items()}, (("", np.zeros(6)),), ())
    rng = np.random.default_rng(0)
    truth = apply(one, learnt, biases=True).recording.imu
    wanted = both.imu.gyro - one.imu.gyro
    blind = hidden.conceal(one, more, rng).imu.gyro - one.imu.gyro - wanted
    knowing = hidden.conceal(one, more, rng, truth).imu.gyro - one.imu.gyro - wanted
    assert 0.05 < rms(blind) / rms(wanted) < 0.15
    assert rms(knowing) / rms(wanted) < 0.02


@pytest.mark.usefixtures("once")
def test_all_at_once_and_nothing(plain):
    nothing = {i: [0.0] * len(v) for i, (v, _) in (ON_IMU | ON_HEADING).items()}
    found = concealed(plain, nothing)
    np.testing.assert_allclose(found.imu.gyro, plain.imu.gyro, atol=1e-9)
    np.testing.assert_allclose(found.imu.accel, plain.imu.accel, atol=1e-9)
    found = concealed(plain, {i: v for i, (v, _) in (ON_IMU | ON_HEADING).items()})
    assert np.isfinite(found.imu.accel).all()


# --- found again by the estimator ---------------------------------------------------------------


def assert_found(recording, effects, also=(), within=4.0):
    """Alone they are shown; beside all that a device has they are as far off as is said."""
    hiding = concealed(recording, effects)
    for only in (True, False):
        found = calibrate(hiding, [*effects, *also], only=only)
        for effect, values in effects.items():
            estimates = [p for p in found.parameters if p.effect == effect]
            for p, value in zip(estimates, values, strict=True):
                assert p.shown or not only, f"{effect}.{p.name}"
                assert abs(p.value - value) < within * p.sigma, f"{effect}.{p.name}"


def ordinary(**more):
    phone = dataclasses.replace(consumer_phone(np.random.default_rng(1)), **more)
    return simulate("free-hand", seed=4, duration_s=40.0, phone=phone)


@pytest.mark.prove
def test_found_again_beside_a_heading():
    effects = {
        "gyro_scale": [0.01, -0.02, 0.005],
        "lever_arm": [0.1, -0.05, 0.03],
        "gyro_bandwidth": [0.02],
        "heading_hard_iron": [0.2, -0.1],
    }
    recording = recording_of(ordinary(), "heading")
    seldom = {n: Series(s.t[::5], s.value[::5]) for n, s in recording.streams.items()}
    assert_found(dataclasses.replace(recording, streams=seldom), effects)


@pytest.mark.prove
def test_found_again_beside_a_pose():
    """The marker moves, the pose comes late, the device's clock runs fast."""
    rng = np.random.default_rng(1)
    recording = recording_of(ordinary(heading=None, pose=capture_pose(rng)), "pose")
    effects = {"lever_arm": [0.05, -0.03, 0.02], "pose_delay": [0.02], "clock_rate": [200.0]}
    assert_found(recording, effects)


@pytest.mark.prove
def test_found_again_in_a_magnetometer():
    rng = np.random.default_rng(1)
    recording = recording_of(ordinary(heading=None, mag=consumer_magnetometer(rng)), "mag")
    assert_found(recording, {"mag_soft_iron": [0.05, -0.08, 0.03, 0.04, 0.0, -0.06]})
    assert_found(recording, {"heading_drift": [0.005]})
    more = concealed(recording, {"mag_hard_iron": [1e-5, -2e-5, 3e-5]}).streams["mag"].value
    added = more - recording.streams["mag"].value
    np.testing.assert_allclose(added, np.tile([1e-5, -2e-5, 3e-5], (len(added), 1)), atol=1e-12)


@pytest.mark.prove
def test_moved_marker_is_as_in_the_simulator():
    """With sight of a pose the readings stay; the simulator moves the IMU on the body instead."""
    rng = np.random.default_rng(1)
    recording = recording_of(ordinary(heading=None, pose=capture_pose(rng)), "pose")
    moved = concealed(recording, {"lever_arm": [0.1, 0.0, 0.0]})
    np.testing.assert_array_equal(moved.imu.accel, recording.imu.accel)
    away = moved.streams["pose"].value[:, :3] - recording.streams["pose"].value[:, :3]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.1, rtol=1e-6)


def test_a_reference_keeps_its_place():
    """Where there is a trusted IMU, it is ours that moves."""
    simulated = world(reference=Reference(clocking=Clocking(200.0)))
    recording = recording_of(simulated, "heading", "reference")
    found = concealed(recording, {"lever_arm": [0.1, -0.05, 0.03]})
    assert found.streams["reference"] is recording.streams["reference"]
    assert rms(found.imu.accel - recording.imu.accel) > 0.01


# --- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        ({"giro_scale": [1.0]}, "Unknown effect 'giro_scale'. Did you mean gyro_scale"),
        ({"gyro_scale": [1.0]}, "takes 3 values, not 1: gyro_scale=x,y,z without unit"),
        ({"gyro_bias_step": [1.0]}, "gyro_bias_step=x,y,z,at in rad/s, rad/s, rad/s, s"),
        ({"gyro_scale": [1.0, 2.0, float("nan")]}, "finite"),
        ({"gyro_bandwidth": [-1.0]}, "tau must be above 0"),
        ({"heading_correlated_noise": [0.1, 0.0]}, "tau must be above 0"),
        ({"heading_outliers": [1.5]}, "fraction"),
        ({"clock_rate": [1e7]}, "ppm"),
        ({"pose_delay": [0.1]}, "needs a stream pose"),
        ({"mag_hard_iron": [1e-5] * 3}, "needs a stream mag"),
        ({"heading_delay": [1e3]}, "leaves no reading"),
    ],
)
def test_refusals(plain, effects, says):
    with pytest.raises(InputError, match=says):
        concealed(plain, effects)


def test_streams_that_are_missing(plain):
    bare = dataclasses.replace(plain, streams={})
    for effect in ("gyro_temperature", "accel_temperature"):
        with pytest.raises(InputError, match="needs a stream temperature"):
            concealed(bare, {effect: [1e-3] * 3})
    with pytest.raises(InputError, match="needs a stream heading or mag"):
        concealed(bare, {"heading_drift": [1e-3]})
    mag = dataclasses.replace(plain, streams={"mag": Series(plain.imu.t, plain.imu.accel * 1e-6)})
    with pytest.raises(InputError, match="mag_hard_iron"):
        concealed(mag, {"heading_hard_iron": [0.1, 0.1]})


# --- the command --------------------------------------------------------------------------------


def test_command(plain, tmp_path):
    source, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_mcap(plain, source)
    arguments = ["conceal", str(source), "--effect", "gyro_scale=0.01,0.02,0.03", "-o", str(out)]
    done = CliRunner().invoke(_app.app, [*arguments, "--seed", "3"])
    assert done.exit_code == 0, done.output
    assert "gyro_scale concealed in a.mcap, seed 3" in done.output
    read = handcal.load(out)
    np.testing.assert_allclose(read.imu.gyro, plain.imu.gyro * [1.01, 1.02, 1.03], rtol=1e-12)
    np.testing.assert_array_equal(read.streams["heading"].value, plain.streams["heading"].value)


@pytest.mark.parametrize("text", ["gyro_scale", "gyro_scale=", "gyro_scale=a,b,c", "gyro_scale=1"])
def test_command_says_what_is_expected(text, tmp_path, capsys, monkeypatch):
    out = tmp_path / "b.mcap"
    arguments = ["handcal", "conceal", "none.mcap", "--effect", text, "-o", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as stop:
        run(_app.app)
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "gyro_scale=x,y,z without unit" in said
    assert not out.exists()

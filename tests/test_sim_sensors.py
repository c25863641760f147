"""Random parts of the simulated sensors: levels, spectra, converters, clocks, seeds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from handcal_sim import phone, scenario

SEEDS = range(3)


def still(device, seed, duration=100.0, **effects):
    return scenario.simulate(
        "static",
        seed=seed,
        phone=device,
        duration_s=duration,
        effects=effects,
        start=scenario.Start(),
    )


def agrees(values, variance, sigmas=5.0):
    """Whether the mean square of independent normal values fits their variance (chi-square)."""
    values = np.ravel(values)
    bound = sigmas * math.sqrt(2.0 / values.size)
    return abs(np.mean(values**2) / variance - 1.0) < bound


def white(values, sigmas=5.0):
    """Whether the four quarters of the band have the same power."""
    power = np.abs(np.fft.rfft(values, axis=0)[1:-1]) ** 2
    power = power[: len(power) // 4 * 4].reshape(4, -1)
    ratio = power.mean(axis=1) / power.mean()
    return bool(np.all(np.abs(ratio - 1.0) < sigmas / math.sqrt(power.shape[1])))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_white_noise_has_its_density_at_any_rate(seed, rate):
    base = phone.perfect_phone()
    device = replace(
        base,
        rate_hz=rate,
        gyro=replace(base.gyro, noise=2e-4),
        accel=replace(base.accel, noise=3e-3),
    )
    error = still(device, seed).imu.values - [0, 0, 0, 0, 0, phone.STANDARD_GRAVITY]
    assert agrees(error[:, :3], 2e-4**2 * rate)
    assert agrees(error[:, 3:], 3e-3**2 * rate)
    assert white(error[:, :3])
    assert white(error[:, 3:])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "part"), [("gyro_bias_walk", 0), ("accel_bias_walk", 3)])
def test_a_walking_bias_grows_with_the_root_of_time(seed, name, part):
    world = still(phone.perfect_phone(), seed, **{name: [0.002]})
    walk = world.imu.values[:, part : part + 3] - [0, 0, phone.STANDARD_GRAVITY * (part == 3)]
    assert np.all(np.abs(walk[0]) < 1e-14)
    steps = np.diff(walk, axis=0)
    assert agrees(steps, 0.002**2 * 0.01)
    assert white(steps)
    kind = name.split("_")[0]
    np.testing.assert_allclose(world.parameters["mean_walk"][kind], walk.mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_heading_noise_white_and_correlated(seed):
    device = replace(phone.perfect_phone(), heading=phone.Heading(0.1))
    assert agrees(still(device, seed).streams["heading"].values, 0.1**2)
    world = still(phone.perfect_phone(), seed, heading_correlated_noise=[0.1, 2.0])
    noise = world.streams["heading"].values
    keep = math.exp(-0.01 / 2.0)
    fresh = noise[1:] - keep * noise[:-1]
    assert agrees(fresh, 0.1**2 * (1.0 - keep**2))
    assert white(fresh)


def test_correlated_heading_noise_is_stationary_from_the_start():
    first = [
        still(phone.perfect_phone(), seed, 1.0, heading_correlated_noise=[0.1, 50.0])
        .streams["heading"]
        .values[0, 0]
        for seed in range(200)
    ]
    assert agrees(first, 0.1**2)


@pytest.mark.parametrize("seed", SEEDS)
def test_heading_outliers_are_a_share_of_the_readings_anywhere_on_the_circle(seed):
    heading = still(phone.perfect_phone(), seed, heading_outliers=[0.2]).streams["heading"].values
    stray = heading[heading != 0.0]
    count, n = len(stray), len(heading)
    assert abs(count - 0.2 * n) < 5.0 * math.sqrt(n * 0.2 * 0.8)
    assert np.all((stray > -math.pi) & (stray <= math.pi))
    assert abs(np.mean(np.exp(1j * stray))) < 5.0 / math.sqrt(count)


@pytest.mark.parametrize("seed", SEEDS)
def test_pose_and_reference_noise_and_mounting(seed):
    rng = np.random.default_rng(seed)
    device = replace(
        phone.perfect_phone(), pose=phone.capture_pose(rng), reference=phone.trusted_reference(rng)
    )
    world = still(device, seed)
    pose, reference = world.streams["pose"].values, world.streams["reference"].values
    assert agrees(pose[:, :3], (0.5e-3) ** 2)
    assert device.pose is not None
    assert device.reference is not None
    # Quaternion of the marker against the world's, to first order twice its vector part.
    C = device.pose.C_wn @ device.pose.C_bm
    half = np.array([rotation(q) for q in pose[::20, 3:]])
    slip = np.swapaxes(C[None], 1, 2) @ half
    angles = np.stack([slip[:, 2, 1], slip[:, 0, 2], slip[:, 1, 0]], axis=1)
    assert agrees(angles, (0.15 * phone.DEG) ** 2)
    up = device.reference.C_br.T @ [0.0, 0.0, phone.STANDARD_GRAVITY]
    assert agrees(reference[:, 3:] - up, (0.06 * phone.MG) ** 2 * 100.0)
    assert agrees(reference[:, :3], (0.003 * phone.DEG) ** 2 * 100.0)


def rotation(q):
    """Rotation matrix of a unit quaternion x y z w."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_quaternions_are_those_of_the_attitude():
    from handcal_sim.aiding import quaternion
    from handcal_sim.motion import euler_matrix

    rng = np.random.default_rng(0)
    C = euler_matrix(*rng.uniform(-math.pi, math.pi, (3, 500)))
    special = euler_matrix(*(math.pi * np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])))
    C = np.concatenate([C, special])
    q = quaternion(C)
    np.testing.assert_allclose([rotation(one) for one in q], C, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-15)


def test_converters_round_and_saturate():
    base = phone.perfect_phone()
    device = replace(
        base,
        gyro=replace(base.gyro, quantum=1e-3, full_scale=0.5),
        accel=replace(base.accel, quantum=0.01, full_scale=9.0),
    )
    world = scenario.simulate("three-turns", phone=device)
    plain = scenario.simulate("three-turns", phone=base)
    for part, quantum, full in ((slice(0, 3), 1e-3, 0.5), (slice(3, 6), 0.01, 9.0)):
        read, true = world.imu.values[:, part], plain.imu.values[:, part]
        steps = read / quantum
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert np.max(np.abs(read)) == pytest.approx(full)
        inside = np.abs(true) < full
        assert np.max(np.abs(read - true)[inside]) <= quantum / 2 * (1 + 1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_stamps_may_be_irregular_or_wrong(seed):
    base = phone.perfect_phone()
    irregular = still(replace(base, interval_jitter_s=1e-4), seed)
    regular = np.arange(len(irregular.t)) / 100.0
    assert agrees((irregular.t - regular), 1e-4**2)
    np.testing.assert_allclose(irregular.imu.stamps[1:], irregular.t[1:], atol=1e-15)
    wrong = still(replace(base, stamp_jitter_s=1e-4), seed)
    np.testing.assert_array_equal(wrong.t, regular)
    assert agrees((wrong.imu.stamps - regular)[1:], 1e-4**2)
    wild = still(replace(base, interval_jitter_s=1.0, stamp_jitter_s=1.0), seed)
    assert np.all(np.diff(wild.imu.stamps) > 0.0)


@pytest.mark.parametrize("name", ["z-turn", "three-turns", "free-hand", "travel", "static"])
def test_one_seed_gives_one_world(name):
    one, same, other = (scenario.simulate(name, seed=s, duration_s=15.0) for s in (4, 4, 5))
    np.testing.assert_array_equal(one.imu.values, same.imu.values)
    assert one.parameters == same.parameters
    assert not np.array_equal(one.imu.values, other.imu.values)


def test_an_effect_changes_nothing_but_what_it_says():
    plain = scenario.simulate("free-hand", seed=1, duration_s=15.0)
    world = scenario.simulate(
        "free-hand", seed=1, duration_s=15.0, effects={"gyro_bias_walk": [1e-2]}
    )
    np.testing.assert_array_equal(world.imu.values[:, 3:], plain.imu.values[:, 3:])
    np.testing.assert_array_equal(world.truth.C_nb, plain.truth.C_nb)
    for name, stream in plain.streams.items():
        np.testing.assert_array_equal(world.streams[name].values, stream.values)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_consumer_phone_has_nothing_but_the_baseline(seed):
    world = scenario.simulate("free-hand", seed=seed, duration_s=15.0)
    assert set(world.parameters["effects"]) == {"gyro_bias", "accel_bias"}


def test_the_phone_of_the_paper():
    device = phone.paper_phone()
    silent = replace(
        device, gyro=replace(device.gyro, noise=0.0), accel=replace(device.accel, noise=0.0)
    )
    reading = still(silent, 0, 10.0).imu.values[0]
    in_deg_h = np.degrees(reading[:3]) * 3600.0
    in_mg = (reading[3:] / 9.80665 - [0.0, 0.0, 1.0]) * 1e3
    np.testing.assert_allclose(in_deg_h, [1000.0, 1200.0, 1500.0], rtol=1e-12)
    np.testing.assert_allclose(in_mg, [40.0, 50.0, 52.25], rtol=1e-10)

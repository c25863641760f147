"""Every effect, by its id: what it adds to the readings, worked by hand from the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from handcal_sim import effects, motion, phone, profiles, scenario, sensors
from handcal_sim.errors import SimulationError

# The ids that users know, with the names of their parameters in order.
PROMISED = {
    "gyro_bias": "x y z",
    "accel_bias": "x y z",
    "gyro_scale": "x y z",
    "accel_scale": "x y z",
    "gyro_misalignment": "xy xz yx yz zx zy",
    "accel_misalignment": "yx zx zy",
    "gyro_g_sensitivity": "xx xy xz yx yy yz zx zy zz",
    "gyro_quadratic": "x y z",
    "gyro_cross_products": "x_xy x_yz x_xz y_xy y_yz y_xz z_xy z_yz z_xz",
    "accel_cross_products": "x_xy x_yz x_xz y_xy y_yz y_xz z_xy z_yz z_xz",
    "accel_asymmetry": "x y z",
    "lever_arm": "x y z",
    "size_effect": "xx xy xz yx yy yz zx zy zz",
    "gyro_temperature": "x y z",
    "accel_temperature": "x y z",
    "accel_delay": "delay",
    "gyro_bandwidth": "tau",
    "gyro_bias_walk": "density",
    "accel_bias_walk": "density",
    "gyro_bias_step": "x y z at",
    "heading_hard_iron": "sin cos",
    "heading_soft_iron": "sin cos",
    "mag_hard_iron": "x y z",
    "mag_soft_iron": "xx yy zz xy xz yz",
    "mag_gradient": "xx yy xy xz yz",
    "mag_step": "x y z at",
    "heading_delay": "delay",
    "pose_delay": "delay",
    "pose_scale": "scale",
    "pose_drift": "position attitude",
    "heading_drift": "rate",
    "heading_correlated_noise": "sigma tau",
    "heading_outliers": "fraction",
    "gravity": "delta",
    "earth_rate": "north up",
    "clock_rate": "ppm",
}
DEVICE = replace(
    phone.perfect_phone(),
    mag=phone.Magnetometer(),
    pose=phone.Pose(),
    reference=phone.Reference(),
    thermometer=phone.Thermometer(20.0, 10.0, 12.0),
)


def recorded(device=DEVICE, name="free-hand", seed=3, duration=20.0, **set_effects):
    return scenario.simulate(
        name, seed=seed, phone=device, duration_s=duration, effects=set_effects
    )


PLAIN = recorded()
W, F, ALPHA = PLAIN.truth.omega.T, PLAIN.truth.f.T, PLAIN.truth.alpha.T
ZERO = np.zeros_like(PLAIN.t)
WARM = 20.0 + 10.0 * (1.0 - np.exp(-PLAIN.t / 12.0)) - 25.0


def felt_at(r):
    """Centripetal and Euler force at r, written out in components."""
    (wx, wy, wz), (ax, ay, az), (x, y, z) = W, ALPHA, r
    dot = wx * x + wy * y + wz * z
    square = wx**2 + wy**2 + wz**2
    return [
        ay * z - az * y + wx * dot - x * square,
        az * x - ax * z + wy * dot - y * square,
        ax * y - ay * x + wz * dot - z * square,
    ]


NINE = [0.01, -0.02, 0.03, 0.04, -0.05, 0.06, -0.07, 0.08, 0.09]
NO = [ZERO, ZERO, ZERO]
# id: values; what the gyro and the accelerometer read in addition.
ADDED = {
    "gyro_bias": ([0.1, -0.2, 0.3], [ZERO + 0.1, ZERO - 0.2, ZERO + 0.3], NO),
    "accel_bias": ([0.1, -0.2, 0.3], NO, [ZERO + 0.1, ZERO - 0.2, ZERO + 0.3]),
    "gyro_scale": ([0.01, -0.02, 0.03], [0.01 * W[0], -0.02 * W[1], 0.03 * W[2]], NO),
    "accel_scale": ([0.01, -0.02, 0.03], NO, [0.01 * F[0], -0.02 * F[1], 0.03 * F[2]]),
    "gyro_misalignment": (
        [0.01, -0.02, 0.03, 0.04, -0.05, 0.06],
        [0.01 * W[1] - 0.02 * W[2], 0.03 * W[0] + 0.04 * W[2], -0.05 * W[0] + 0.06 * W[1]],
        NO,
    ),
    "accel_misalignment": (
        [0.01, -0.02, 0.03],
        NO,
        [ZERO, 0.01 * F[0], -0.02 * F[0] + 0.03 * F[1]],
    ),
    "gyro_g_sensitivity": (
        NINE,
        [
            0.01 * F[0] - 0.02 * F[1] + 0.03 * F[2],
            0.04 * F[0] - 0.05 * F[1] + 0.06 * F[2],
            -0.07 * F[0] + 0.08 * F[1] + 0.09 * F[2],
        ],
        NO,
    ),
    "gyro_quadratic": ([0.1, -0.2, 0.3], [0.1 * W[0] ** 2, -0.2 * W[1] ** 2, 0.3 * W[2] ** 2], NO),
    "gyro_cross_products": (
        NINE,
        [
            0.01 * W[0] * W[1] - 0.02 * W[1] * W[2] + 0.03 * W[0] * W[2],
            0.04 * W[0] * W[1] - 0.05 * W[1] * W[2] + 0.06 * W[0] * W[2],
            -0.07 * W[0] * W[1] + 0.08 * W[1] * W[2] + 0.09 * W[0] * W[2],
        ],
        NO,
    ),
    "accel_cross_products": (
        NINE,
        NO,
        [
            0.01 * F[0] * F[1] - 0.02 * F[1] * F[2] + 0.03 * F[0] * F[2],
            0.04 * F[0] * F[1] - 0.05 * F[1] * F[2] + 0.06 * F[0] * F[2],
            -0.07 * F[0] * F[1] + 0.08 * F[1] * F[2] + 0.09 * F[0] * F[2],
        ],
    ),
    "accel_asymmetry": (
        [0.01, -0.02, 0.03],
        NO,
        [0.01 * np.abs(F[0]), -0.02 * np.abs(F[1]), 0.03 * np.abs(F[2])],
    ),
    "lever_arm": ([0.1, -0.2, 0.3], NO, felt_at([0.1, -0.2, 0.3])),
    "size_effect": (
        NINE,
        NO,
        [felt_at(NINE[0:3])[0], felt_at(NINE[3:6])[1], felt_at(NINE[6:9])[2]],
    ),
    "gyro_temperature": ([0.1, -0.2, 0.3], [0.1 * WARM, -0.2 * WARM, 0.3 * WARM], NO),
    "accel_temperature": ([0.1, -0.2, 0.3], NO, [0.1 * WARM, -0.2 * WARM, 0.3 * WARM]),
    "gyro_bias_step": (
        [0.1, -0.2, 0.3, 7.0],
        [np.where(PLAIN.t >= 7.0, step, 0.0) for step in (0.1, -0.2, 0.3)],
        NO,
    ),
    "gravity": ([0.05], NO, [0.05 * row for row in PLAIN.truth.C_nb[:, 2].T]),
}


def test_the_effects_are_those_promised():
    names = {name: " ".join(p.name for p in ps) for name, ps in effects.EFFECTS.items()}
    assert names == PROMISED


@pytest.mark.parametrize("name", ADDED)
def test_an_effect_adds_to_the_readings(name):
    values, gyro, accel = ADDED[name]
    world = recorded(**{name: values})
    added = world.imu.values - PLAIN.imu.values
    # Round-off of sums of numbers up to about 100 (cross products of force times 0.1).
    np.testing.assert_allclose(added[:, :3], np.transpose(gyro), atol=1e-12)
    np.testing.assert_allclose(added[:, 3:], np.transpose(accel), atol=1e-12)
    assert world.parameters["asked"] == {name: values}
    found = [parameter["value"] for parameter in world.parameters["effects"][name]]
    assert found == values
    assert np.all(world.streams["heading"].values == PLAIN.streams["heading"].values)


def test_a_perfect_device_reads_the_truth():
    truth = np.hstack([PLAIN.truth.omega, PLAIN.truth.f])
    np.testing.assert_array_equal(PLAIN.imu.values, truth)
    np.testing.assert_allclose(PLAIN.streams["reference"].values, truth, atol=1e-12)


@pytest.mark.parametrize("delay", [0.03, -0.05])
@pytest.mark.parametrize(
    ("name", "stream"),
    [("accel_delay", "imu"), ("heading_delay", "heading"), ("pose_delay", "pose")],
)
def test_a_delayed_sensor_reads_what_was(name, stream, delay):
    world = recorded(**{name: [delay]})
    values = [w.imu.values if stream == "imu" else w.streams[stream].values for w in (PLAIN, world)]
    shift = round(delay * 100.0)
    now, was = (slice(shift, None), slice(None, -shift))
    if shift < 0:
        now, was = (slice(None, shift), slice(-shift, None))
    changed = slice(3, None) if stream == "imu" else slice(None)
    delayed, plain = values[1][now, changed], values[0][was, changed]
    np.testing.assert_allclose(delayed, plain, atol=1e-10)
    if stream == "imu":
        np.testing.assert_array_equal(values[1][:, :3], values[0][:, :3])


def test_without_a_heading_sensor_heading_effects_are_the_magnetometers():
    alone = replace(DEVICE, heading=None)
    world = recorded(alone, heading_delay=[0.05])
    plain, late = PLAIN.streams["mag"].values, world.streams["mag"].values
    np.testing.assert_allclose(late[5:], plain[:-5], atol=1e-16)
    iron = recorded(mag_hard_iron=[1e-5, -2e-5, 3e-5]).streams["mag"].values
    np.testing.assert_allclose(iron - plain, np.tile([1e-5, -2e-5, 3e-5], (2001, 1)), atol=1e-18)
    # A drift of +0.3 rad in all: levelled, the field has turned clockwise, so that the
    # heading found from it is larger.
    drift = recorded(alone, name="static", heading_drift=[0.015])
    still = recorded(alone, name="static")
    level = [
        np.einsum("nij,nj->ni", w.truth.C_nb, w.streams["mag"].values)[-1] for w in (still, drift)
    ]
    found = [math.pi / 2 - math.atan2(field[1], field[0]) for field in level]
    assert found[1] - found[0] == pytest.approx(0.3, abs=1e-12)
    # symmetric: along x a tenth less, and of y a twentieth on z and the other way round
    soft = recorded(mag_soft_iron=[-0.1, 0.0, 0.1, 0.0, 0.0, 0.05]).streams["mag"].values
    S = np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.05], [0.0, 0.05, 0.1]])
    np.testing.assert_allclose(soft - plain, plain @ S, atol=1e-18)
    jump = recorded(mag_step=[1e-5, -2e-5, 3e-5, 12.0]).streams["mag"]
    later = (jump.stamps >= 12.0)[:, None]
    np.testing.assert_allclose(jump.values - plain, later * [1e-5, -2e-5, 3e-5], atol=1e-18)
    with pytest.raises(SimulationError, match="mag_hard_iron"):
        recorded(alone, heading_hard_iron=[0.1, 0.0])
    with pytest.raises(SimulationError, match="mag_soft_iron"):
        recorded(alone, heading_soft_iron=[0.1, 0.0])
    with pytest.raises(SimulationError, match="needs a heading sensor"):
        recorded(alone, heading_correlated_noise=[0.1, 1.0])
    with pytest.raises(SimulationError, match="needs a heading sensor or a magnetometer"):
        recorded(replace(alone, mag=None), heading_drift=[0.1])
    with pytest.raises(SimulationError, match="not there: pose"):
        recorded(replace(DEVICE, pose=None), pose_delay=[0.1])


def test_the_field_points_north_and_down():
    level = replace(DEVICE, mag=phone.Magnetometer(50e-6, math.radians(60.0)))
    start = scenario.Start(heading=math.pi / 2)  # body x north, body y west
    world = scenario.simulate("static", phone=level, start=start, duration_s=2.0)
    expected = [25e-6, 0.0, -50e-6 * math.sqrt(0.75)]
    np.testing.assert_allclose(world.streams["mag"].values[0], expected, atol=1e-18)


def heading_change(**set_effects):
    world = recorded(**set_effects)
    true, read = (w.streams["heading"].values[:, 0] for w in (PLAIN, world))
    return true, np.angle(np.exp(1j * (read - true)))


def test_heading_errors_depend_on_yaw_and_time():
    true, change = heading_change(heading_hard_iron=[0.1, 0.2])
    np.testing.assert_allclose(change, 0.1 * np.sin(true) + 0.2 * np.cos(true), atol=1e-12)
    true, change = heading_change(heading_soft_iron=[0.1, 0.2])
    np.testing.assert_allclose(change, 0.1 * np.sin(2 * true) + 0.2 * np.cos(2 * true), atol=1e-12)
    _, change = heading_change(heading_drift=[0.005])
    np.testing.assert_allclose(change, 0.005 * PLAIN.t, atol=1e-12)


def test_heading_is_the_yaw_of_body_x():
    C = PLAIN.truth.C_nb
    expected = np.arctan2(C[:, 1, 0], C[:, 0, 0])
    np.testing.assert_allclose(PLAIN.streams["heading"].values[:, 0], expected, atol=1e-14)


def test_a_field_that_changes_with_place():
    """Along the arm, in axes whose y is the way that the field points: the sensor at its end."""
    there = replace(DEVICE, heading=None, mag=phone.Magnetometer(declination=0.4))
    there = replace(there, heading_errors=replace(there.heading_errors, offset=0.3))
    G = np.array([[1e-5, 3e-5, 4e-5], [3e-5, 2e-5, 5e-5], [4e-5, 5e-5, -3e-5]])
    arm = [0.1, -0.2, 0.05]
    world = recorded(there, mag_gradient=[1e-5, 2e-5, 3e-5, 4e-5, 5e-5], lever_arm=arm)
    added = world.streams["mag"].values - recorded(there).streams["mag"].values
    c, s = math.cos(0.7), math.sin(0.7)
    C_nm = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    change = C_nm @ G @ C_nm.T
    C = world.truth.C_nb
    np.testing.assert_allclose(
        added, np.einsum("nji,jk,nk->ni", C, change, world.truth.position), atol=1e-16
    )
    # soft iron draws the field as it is there
    soft = {"mag_soft_iron": [-0.1, 0.0, 0.1, 0.0, 0.0, 0.05]}
    bent = recorded(there, mag_gradient=[1e-5, 2e-5, 3e-5, 4e-5, 5e-5], lever_arm=arm, **soft)
    S = np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.05], [0.0, 0.05, 0.1]])
    read = world.streams["mag"].values
    np.testing.assert_allclose(bent.streams["mag"].values, read + read @ S, atol=1e-16)


def test_the_earth_that_was_left_out():
    world = recorded(earth_rate=[5e-5, 4e-5])
    added = world.imu.values[:, :3] - PLAIN.imu.values[:, :3]
    expected = PLAIN.truth.C_nb.transpose(0, 2, 1) @ np.array([0.0, 5e-5, 4e-5])
    np.testing.assert_allclose(added, expected, atol=1e-14)


def test_a_fast_clock_stamps_too_late_but_not_on_other_devices():
    world = recorded(clock_rate=[10_000.0])
    fast = 1.01
    np.testing.assert_allclose(world.t * fast, world.imu.stamps, atol=1e-12)
    same = recorded(replace(DEVICE, rate_hz=101.0))  # reads at the same true instants
    n = len(world.t)
    np.testing.assert_allclose(world.imu.values, same.imu.values[:n], atol=1e-9)
    for name in ("pose", "reference"):
        np.testing.assert_array_equal(world.streams[name].values, PLAIN.streams[name].values)


@pytest.mark.parametrize("tau", [1e-9, 1e-3, 0.05, 0.3])
def test_a_slow_gyro_weakens_and_delays_a_sinusoid(tau):
    omega = 8.0
    swing = profiles.sinusoids(np.array([omega]), np.array([[0.0, 0.0, 0.5]]), np.zeros((1, 3)))
    made = motion.Motion(
        "swing",
        20.0,
        np.eye(3),
        (swing,),
        profiles.constant([0.0] * 3),
        profiles.constant([1.0]),
        profiles.constant([0.0]),
        (),
    )
    t = np.arange(0.0, 20.0, 0.0137)
    rate = sensors.lagged_rate(made, sensors.ASSUMED, tau, t)
    lag, gain = math.atan(omega * tau), 1.0 / math.hypot(1.0, omega * tau)
    # Linear between 1 ms: h^2/12 of the second derivative, 256 rad/s^3, is 2e-5 rad/s.
    expected = 0.5 * omega * gain * np.cos(omega * t - lag)
    np.testing.assert_allclose(rate[:, 2], expected, atol=3e-5)


def test_a_slow_gyro_is_late_by_its_time_constant():
    world = recorded(gyro_bandwidth=[0.02])
    np.testing.assert_array_equal(world.imu.values[:, 3:], PLAIN.imu.values[:, 3:])
    change = world.imu.values[:, :3] - PLAIN.imu.values[:, :3]
    # A lag of tau is first a delay: -tau alpha, and tau^2 times the next derivative remains.
    left = change + 0.02 * PLAIN.truth.alpha
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(change**2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("gyro_scale=0.01,0,-1e-3", ("gyro_scale", (0.01, 0.0, -0.001))),
        (" accel_delay =-0.02", ("accel_delay", (-0.02,))),
    ],
)
def test_effects_are_read_from_text(text, expected):
    assert effects.parse_effect(text) == expected


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nonsense=1", r"no effect 'nonsense'; there are gyro_bias, accel_bias,"),
        ("gyro_scale", r"expected gyro_scale=x,y,z"),
        ("gyro_scale=1,b,2", r"expected gyro_scale=x,y,z"),
        ("gyro_scale=1,2", r"takes 3 value\(s\), not 2: gyro_scale=x,y,z without unit"),
        ("gyro_bias_step=1,2,3,nan", r"finite numbers: .* in rad/s,rad/s,rad/s,s"),
        ("gyro_bandwidth=-0.1", r"tau must not be negative"),
        ("heading_outliers=1.5", r"must not exceed 1"),
        ("clock_rate=-1e6", r"ppm must lie within 100000"),
        ("heading_correlated_noise=0.1,0", r"tau must be above 0"),
    ],
)
def test_bad_effects_are_refused_in_a_sentence(text, sentence):
    with pytest.raises(SimulationError, match=sentence):
        effects.parse_effect(text)

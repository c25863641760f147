"""The simulated truth against mechanics: derivatives, integrals, turns, the hand."""

import ast
import math
from pathlib import Path

import numpy as np
import pytest

from handcal_sim import hand, motion, phone, profiles, scenario, sensors
from handcal_sim.errors import SimulationError

SIM = Path(__file__).parents[1] / "sim" / "handcal_sim"
SEES_BOTH_SIDES = {"demo.py", "sweep.py", "prove.py"}
START = motion.Start(heading=0.7, pitch=0.05, roll=-0.04)


def moved(name, seed, sway=1.0):
    rng = np.random.default_rng(seed)
    made = motion.build(name, 20.0, START, rng)
    return hand.in_hand(made, hand.random_hand(rng, sway), rng)


def difference(function, t, step):
    """Central difference of fourth order."""
    near = function(t + step) - function(t - step)
    far = function(t + 2 * step) - function(t - 2 * step)
    return (8.0 * near - far) / (12.0 * step)


def skew(v):
    return np.cross(np.eye(3), np.asarray(v)[..., None, :])


@pytest.mark.parametrize("name", motion.SCENARIOS)
@pytest.mark.parametrize("seed", range(3))
def test_rates_and_accelerations_are_the_derivatives_of_the_motion(name, seed):
    made = moved(name, seed)
    t = np.sort(np.random.default_rng(seed).uniform(-0.5, 20.5, 400))
    k = motion.evaluate(made, t)

    def part(field):
        return difference(lambda at: getattr(motion.evaluate(made, at), field), t, 1e-3)

    # Step 1 ms: truncation h^4/30 times the fifth derivative (tremor: (75 rad/s)^5 of 0.1 mm
    # and mrad; the ends of ramps), below 1e-6 of the quantities here.
    np.testing.assert_allclose(part("position"), k.velocity, atol=1e-6)
    np.testing.assert_allclose(part("velocity"), k.acceleration, atol=2e-5)
    np.testing.assert_allclose(part("C_nb"), k.C_nb @ skew(k.omega_nb_b), atol=1e-5)
    np.testing.assert_allclose(part("omega_nb_b"), k.alpha_nb_b, atol=2e-4)
    np.testing.assert_allclose(
        k.C_nb @ k.C_nb.transpose(0, 2, 1), np.eye(3) + 0 * k.C_nb, atol=1e-13
    )


def exponential(v):
    """Rotation matrices of rotation vectors (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    safe = np.where(angle > 0, angle, 1.0)
    K = skew(v)
    return np.eye(3) + np.sin(angle) / safe * K + (1 - np.cos(angle)) / safe**2 * (K @ K)


def test_integrating_rate_and_force_returns_attitude_and_position():
    made, step = moved("travel", 0), 1e-3
    earth = sensors.earth_at(math.radians(48.0), 300.0)
    place = np.array([0.03, -0.02, 0.01])
    t = np.arange(0.0, 20.0, step)
    middle = sensors.truth_at(made, earth, place, t[:-1] + 0.5 * step)
    truth = sensors.truth_at(made, earth, place, t)
    spin = np.array(earth.rate)
    C = truth.C_nb[0]
    attitudes = [C]
    steps = exponential(step * middle.omega)
    turned = exponential(-step * spin[None, :])[0]
    for one in steps:
        C = turned @ C @ one
        attitudes.append(C)
    # Midpoint rule: h^2/24 times the second derivative of the rate (tremor, 0.01 rad/s at
    # 75 rad/s, but that averages out) accumulated over 20 s: below 1e-5 rad.
    np.testing.assert_allclose(attitudes, truth.C_nb, atol=2e-5)
    force = np.einsum("nij,nj->ni", truth.C_nb, truth.f) - [0.0, 0.0, earth.gravity]
    force -= 2.0 * np.cross(spin, truth.velocity)
    velocity = truth.velocity[0] + cumulated(force, step)
    np.testing.assert_allclose(velocity, truth.velocity, atol=2e-5)
    position = truth.position[0] + cumulated(truth.velocity, step)
    np.testing.assert_allclose(position, truth.position, atol=2e-5)


def cumulated(values, step):
    """The trapezoidal integral from the first instant on."""
    total = np.zeros_like(values)
    total[1:] = np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)
    return total


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_z_turn_is_one_whole_turn_between_10_and_20_s(direction):
    start = motion.Start(direction=direction)
    made = motion.build("z-turn", None, start, np.random.default_rng(0))
    t = np.arange(3001) / 100.0
    k = motion.evaluate(made, t)
    total = 0.01 * np.sum(k.omega_nb_b, axis=0)
    np.testing.assert_allclose(total, [0.0, 0.0, direction * 2.0 * math.pi], atol=1e-9)
    still = (t <= 10.0) | (t >= 20.0)
    assert np.max(np.abs(k.omega_nb_b[still])) < 1e-12
    assert np.all(direction * k.omega_nb_b[~still][1:-1, 2] > 0.0)
    np.testing.assert_allclose(k.C_nb[-1], k.C_nb[0], atol=1e-12)
    assert made.rests == ((0.0, 10.0), (20.0, 30.0))


def test_three_turns_go_once_about_each_axis_with_rests_between():
    made = motion.build("three-turns", None, START, np.random.default_rng(0))
    rate = motion.evaluate(made, np.arange(3001) / 100.0).omega_nb_b
    np.testing.assert_allclose(0.01 * rate.sum(axis=0), [2 * math.pi] * 3, atol=1e-9)
    assert np.all(np.count_nonzero(np.abs(rate) > 1e-9, axis=1) <= 1)
    assert [b - a for a, b in made.rests] == [2.0, 1.0, 1.0, 2.0]


@pytest.mark.parametrize("seed", range(5))
def test_a_free_hand_turns_at_about_one_and_a_half_rad_per_s(seed):
    made = motion.build("free-hand", None, START, np.random.default_rng(seed))
    assert made.duration_s == 84.0
    rate = motion.evaluate(made, np.arange(6.0, 78.0, 0.01)).omega_nb_b
    assert 1.0 < math.sqrt(np.mean(np.sum(rate**2, axis=1))) < 2.1
    assert np.all(np.sqrt(np.mean(rate**2, axis=0)) > 0.3)
    resting = motion.evaluate(made, np.array([0.0, 3.9, 80.1, 84.0]))
    assert np.all(resting.omega_nb_b == 0.0)
    assert np.all(resting.position == 0.0)


@pytest.mark.parametrize("seed", range(5))
def test_travel_goes_half_a_metre_and_rests_on_a_table(seed):
    rng = np.random.default_rng(seed)
    made = motion.build("travel", None, START, rng)
    made = hand.in_hand(made, hand.random_hand(rng), rng)
    far = np.linalg.norm(motion.evaluate(made, np.arange(0, 65, 0.1)).position, axis=1)
    assert 0.3 < far.max() < 0.9
    resting = np.concatenate([np.linspace(a, b, 50) for a, b in made.rests])
    k = motion.evaluate(made, resting)
    assert len(made.rests) == 4
    np.testing.assert_allclose(k.velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(k.omega_nb_b, 0.0, atol=1e-12)


@pytest.mark.prove
def test_a_hand_sways_as_much_as_it_says_and_more_while_turning():
    rng = np.random.default_rng(0)
    holder = hand.Hand(1e-3, 6e-3, 2e-3, 8e-3, 5e-5, 4e-3)
    always = motion.Motion(
        "turning",
        2000.0,
        np.eye(3),
        (),
        profiles.constant([0.0] * 3),
        profiles.constant([1.0]),
        profiles.constant([2.0]),
        (),
    )
    made = hand.in_hand(always, holder, rng)
    assert made.wander is not None
    value, rate, _ = made.wander(np.arange(0.0, 2000.0, 0.02))
    # Sums of incommensurate sinusoids: rms is exact but for products of neighbours, which
    # average out as 1 / (spacing * 2000 s); 2 % covers them.
    rms = np.sqrt(np.mean(value**2, axis=0))
    np.testing.assert_allclose(rms[:3], math.hypot(1e-3, 2 * 6e-3, 5e-5), rtol=0.02)
    quick = np.fft.rfft(rate[:, 3:], axis=0)
    band = np.fft.rfftfreq(len(rate), 0.02)
    share = (band >= 7.5) & (band <= 12.5)
    power = 2.0 * np.sum(np.abs(quick[share]) ** 2, axis=0) / len(rate) ** 2
    np.testing.assert_allclose(np.sqrt(power), 4e-3, rtol=0.02)


def test_a_point_on_a_turning_body_feels_centripetal_force():
    made = motion.build("z-turn", None, motion.Start(), np.random.default_rng(0))
    middle = np.array([15.0])
    rate = 2.0 * math.pi / 8.5  # ramps of 1.5 s at both ends
    truth = sensors.truth_at(made, sensors.ASSUMED, np.array([0.1, 0.0, 0.0]), middle)
    np.testing.assert_allclose(truth.omega, [[0.0, 0.0, rate]], atol=1e-12)
    np.testing.assert_allclose(truth.f, [[-(rate**2) * 0.1, 0.0, 9.80665]], atol=1e-12)
    rising = np.array([10.75])  # half way up the first ramp: alpha = rate * S'(1/2) / ramp
    alpha = rate * (315.0 / 128.0) / 1.5
    truth = sensors.truth_at(made, sensors.ASSUMED, np.array([0.1, 0.0, 0.0]), rising)
    expected = [[-((rate / 2) ** 2) * 0.1, alpha * 0.1, 9.80665]]
    np.testing.assert_allclose(truth.f, expected, atol=1e-12)


def test_at_rest_force_points_up_and_the_earth_turns():
    level = motion.build("static", None, motion.Start(), np.random.default_rng(0))
    truth = sensors.truth_at(level, sensors.ASSUMED, np.zeros(3), np.array([1.0]))
    np.testing.assert_allclose(truth.f, [[0.0, 0.0, 9.80665]], atol=1e-15)
    assert np.all(truth.omega == 0.0)
    north = motion.build("static", None, motion.Start(math.pi / 2), np.random.default_rng(0))
    at = sensors.earth_at(math.radians(60.0))
    truth = sensors.truth_at(north, at, np.zeros(3), np.array([1.0]))
    expected = [[7.292115e-5 * 0.5, 0.0, 7.292115e-5 * math.sqrt(0.75)]]
    np.testing.assert_allclose(truth.omega, expected, atol=1e-18)


@pytest.mark.parametrize(
    ("latitude", "height", "gravity"),
    # WGS84 (NIMA TR8350.2): equator, pole; 45 deg; 1000 m: -(3.0877 - 0.0044 sin^2) um/s^2 each.
    [(0, 0, 9.7803253359), (90, 0, 9.8321849379), (45, 0, 9.8061977694), (45, 1000, 9.8031130)],
)
def test_gravity_is_that_of_wgs84(latitude, height, gravity):
    at = sensors.earth_at(math.radians(latitude), height)
    assert at.true_gravity == pytest.approx(gravity, abs=2e-7)


def test_unknown_scenarios_and_lengths_are_refused_in_a_sentence():
    with pytest.raises(SimulationError, match=r"no scenario 'x'; there are z-turn, three-turns"):
        scenario.simulate("x")
    with pytest.raises(SimulationError, match="duration"):
        scenario.simulate("z-turn", duration_s=math.nan)
    with pytest.raises(SimulationError, match="device"):
        phone.make_phone("x", np.random.default_rng(0))


@pytest.mark.parametrize("file", sorted(SIM.glob("*.py")), ids=lambda file: file.name)
def test_the_simulator_imports_nothing_of_handcal(file):
    if file.name in SEES_BOTH_SIDES:
        return
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
            assert node.level == 0
        assert not any(name.split(".")[0] == "handcal" for name in names)

"""The mechanization against motions whose attitude, velocity and place are known exactly."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from handcal.compiled import so3, strapdown
from handcal.earth import EARTH_RATE, local_earth
from handcal_sim import motion, sensors, simulate
from handcal_sim.phone import perfect_phone

G_N, STILL = local_earth(None)
ZERO = np.zeros(3)


def order(steps, errors):
    """Power of the step with which the errors fall: slope over all rates in a log-log plot."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def angle_between(A, B):
    return np.linalg.norm(so3.matrix_log(np.swapaxes(A, -1, -2) @ B), axis=-1)


# --- coning ---------------------------------------------------------------------------------


def coning(t, half_angle, omega):
    """Attitude exp(half_angle (cos, sin, 0)) and body rate of a cone, in closed form.

    With n the unit vector of the rotation and a its angle: rate = sin(a) n' - (1 - cos(a)) n x n'.
    """
    c, s, zero = np.cos(omega * t), np.sin(omega * t), 0 * t
    C = Rotation.from_rotvec(half_angle * np.stack([c, s, zero], 1)).as_matrix()
    rate = omega * np.stack(
        [
            -math.sin(half_angle) * s,
            math.sin(half_angle) * c,
            zero - (1 - math.cos(half_angle)),
        ],
        axis=1,
    )
    return C, rate


def test_coning_attitude_converges_with_the_second_order():
    """Linear interpolation between samples is off by (omega dt)^2: the error falls as dt^2."""
    steps, errors = 1 / np.array([50.0, 100.0, 200.0, 400.0]), []
    for dt in steps:
        t = np.arange(round(2.0 / dt) + 1) * dt
        C, gyro = coning(t, math.radians(10.0), 2 * math.pi * 1.5)
        _, _, got = strapdown.integrate(t, gyro, 0 * gyro, ZERO, ZERO, C[0], ZERO, STILL)
        errors.append(angle_between(C, got).max())
    assert order(steps, errors) == pytest.approx(2.0, abs=0.1)
    # drift a^2/2 omega x^2/6, x = omega dt, for 2 s, and no more than twice that
    x, a = 2 * math.pi * 1.5 * steps[1], math.radians(10.0)
    assert errors[1] < 2 * (a**2 / 2 * 2 * math.pi * 1.5 * 2 * x**2 / 6)


def test_coning_correction_halves_the_drift_of_sampled_rates():
    """Classical coning of 1 degree at 5 Hz, sampled at 100 Hz: drift about z.

    From theory for small angles, x = omega dt: a polygon inscribed in the circle has sin(x)/x
    of its area, the trapezoid shortens its radius to k = (x/2) cot(x/2), and the correction
    dt^2/12 (w0 x w1) gives back x sin(x)/6. Without it x^2/3 of the coning is lost, with it
    x^2/6: what remains is what samples of the rate do not hold.
    """
    a, omega, dt = math.radians(1.0), 2 * math.pi * 5.0, 0.01
    t = np.arange(2001) * dt  # 20 s are 100 whole cones
    C, gyro = coning(t, a, omega)
    _, _, got = strapdown.integrate(t, gyro, 0 * gyro, ZERO, ZERO, C[0], ZERO, STILL)
    bare = C[0]
    for w0, w1 in pairwise(gyro):
        bare = bare @ so3.matrix_exp(0.5 * dt * (w0 + w1))

    def drift(end):
        return so3.matrix_log(C[-1].T @ end)[2] / t[-1]

    x = omega * dt
    lost = 1 - (0.5 * x / math.tan(0.5 * x)) ** 2 * math.sin(x) / x
    size = -0.5 * omega * a**2
    # third order in the angle of the cone is neglected: 1 degree squared
    assert drift(bare) == pytest.approx(size * lost, rel=0.01)
    assert drift(got[-1]) == pytest.approx(size * (lost - x * math.sin(x) / 6), rel=0.01)
    assert abs(drift(got[-1])) < 0.6 * abs(drift(bare))


# --- rate and force linear in time: what the increments promise to be exact for ---------------


def linear_profile(duration):
    w = np.array([[1.0, -2.0, 0.5], [-1.5, 1.0, 2.0]])
    f = np.array([[1.0, 9.0, 3.0], [8.0, -2.0, 5.0]])

    def at(t):
        s = np.asarray(t)[..., None] / duration
        return w[0] + s * (w[1] - w[0]), f[0] + s * (f[1] - f[0])

    return at


def exact(at, duration):
    """Attitude, velocity and position at the end, from a general solver of high order."""

    def slope(t, y):
        w, f = at(t)
        q, v = y[:4], y[4:7]
        turn = 0.5 * np.r_[-q[1:] @ w, q[0] * w + np.cross(q[1:], w)]
        return np.r_[turn, so3.matrix_of(q / np.linalg.norm(q)) @ f + G_N, v]

    y0 = np.r_[1.0, np.zeros(9)]
    y = solve_ivp(slope, (0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return so3.matrix_of(y[:4] / np.linalg.norm(y[:4])), y[4:7], y[7:]


def test_increments_are_of_the_order_they_state():
    """Rotation O(dt^5) an interval, so dt^4 in the end; velocity O(dt^4), so dt^3.

    Without the coning term the rotation, without sculling the velocity would be of order 2.
    """
    duration = 1.0
    at = linear_profile(duration)
    C, v, p = exact(at, duration)
    steps, errors = 1 / np.array([20.0, 40.0, 80.0, 160.0]), []
    for dt in steps:
        t = np.arange(round(duration / dt) + 1) * dt
        gp, gv, gC = strapdown.integrate(t, *at(t), ZERO, ZERO, np.eye(3), G_N, STILL)
        errors.append(
            [angle_between(C, gC[-1]), np.linalg.norm(v - gv[-1]), np.linalg.norm(p - gp[-1])]
        )
    rotation, velocity, position = np.array(errors).T
    assert order(steps, rotation) == pytest.approx(4.0, abs=0.2)
    assert order(steps, velocity) == pytest.approx(3.0, abs=0.2)
    assert order(steps, position) == pytest.approx(3.0, abs=0.2)


def test_a_body_on_a_circle():
    """Constant rate and force in the body; the truth is a circle. Third order in the step."""
    omega, radius, duration = 4.0, 0.5, 1.3
    steps, errors = 1 / np.array([25.0, 50.0, 100.0, 200.0]), []
    for dt in steps:
        t = np.arange(math.floor(duration / dt) + 1) * dt
        c, s, zero = np.cos(omega * t), np.sin(omega * t), 0 * t
        p = radius * np.stack([c, s, zero], 1)
        v = radius * omega * np.stack([-s, c, zero], 1)
        gyro = np.tile([0.0, 0.0, omega], (len(t), 1))
        accel = np.tile([-radius * omega**2, 0.0, 9.80665], (len(t), 1))
        gp, gv, gC = strapdown.integrate(t, gyro, accel, p[0], v[0], np.eye(3), G_N, STILL)
        np.testing.assert_allclose(so3.yaw_of(gC), so3.wrap(omega * t), atol=1e-12)
        errors.append([np.abs(gv - v).max(), np.abs(gp - p).max()])
    velocity, position = np.array(errors).T
    assert order(steps, velocity) == pytest.approx(3.0, abs=0.2)
    assert order(steps, position) == pytest.approx(3.0, abs=0.2)
    # third term of the rotation's series, omega^3 f dt^4 / 24 an interval, added up
    assert velocity[2] < duration / steps[2] * omega**3 * (radius * omega**2) * steps[2] ** 4 / 24


# --- the simulator's motions --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["three-turns", "free-hand", "travel"])
@pytest.mark.parametrize("earth", [None, math.radians(48.0)])
def test_simulated_motions_converge_with_the_second_order(name, earth):
    """Smooth functions sampled: the only error is linear interpolation, so dt^2.

    The Earth's turning, gravity and Coriolis are the simulator's.
    """
    made = motion.build(name, 30.0, motion.Start(0.4, 0.1, -0.2), np.random.default_rng(0))
    world_earth = sensors.ASSUMED if earth is None else sensors.earth_at(earth)
    steps, errors = 1 / np.array([50.0, 100.0, 200.0, 400.0]), []
    for dt in steps:
        t = 2.0 + np.arange(round(10.0 / dt) + 1) * dt
        true = sensors.truth_at(made, world_earth, np.array([0.05, -0.02, 0.1]), t)
        got = strapdown.integrate(
            t, true.omega, true.f, true.position[0], true.velocity[0], true.C_nb[0],
            *local_earth(earth),
        )  # fmt: skip
        errors.append(
            [
                np.linalg.norm(got[0] - true.position, axis=1).max(),
                np.linalg.norm(got[1] - true.velocity, axis=1).max(),
                angle_between(got[2], true.C_nb).max(),
            ]
        )
    errors = np.array(errors)
    for column in errors.T:
        assert order(steps, column) == pytest.approx(2.0, abs=0.15)
    # the trapezoid's error dt^2/12 times the second derivative, never cancelling
    most = steps[-1] ** 2 / 12 * np.linalg.norm(np.diff(true.alpha, axis=0), axis=1).sum()
    assert errors[-1, 2] < 1.1 * most


# --- the Earth -----------------------------------------------------------------------------------


def earth_bound(latitude, C, v, t):
    """Readings of a body that keeps its attitude and its velocity v on the turning Earth."""
    g_n, rate = local_earth(latitude)
    gyro = np.tile(C.T @ rate, (len(t), 1))
    accel = np.tile(C.T @ (2 * np.cross(rate, v) - g_n), (len(t), 1))
    return gyro, accel


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 48.0, 90.0])
def test_a_device_at_rest_stays_level_and_in_place(latitude_deg):
    """Ten minutes; unaccounted the Earth would have turned by 44 mrad and moved it far away."""
    latitude = math.radians(latitude_deg)
    C = Rotation.from_euler("ZYX", [0.7, 0.4, -1.1]).as_matrix()
    t = np.arange(6001) * 0.1
    gyro, accel = earth_bound(latitude, C, ZERO, t)
    earth = local_earth(latitude)
    p, v, got = strapdown.integrate(t, gyro, accel, ZERO, ZERO, C, *earth)
    assert angle_between(C, got).max() < 1e-11
    # second order in the Earth's turn within an interval: g (omega dt)^2 / 6 for ten minutes
    most = 9.8 * (EARTH_RATE * 0.1) ** 2 / 6 * 600.0
    assert np.linalg.norm(v, axis=1).max() < 1.1 * most
    assert np.linalg.norm(p, axis=1).max() < 1.1 * most * 600.0
    _, _, ignored = strapdown.integrate(t, gyro, accel, ZERO, ZERO, C, earth[0], STILL)
    assert angle_between(C, ignored[-1]) == pytest.approx(EARTH_RATE * 600.0, rel=1e-6)


def test_coriolis_keeps_a_moving_body_on_its_line():
    latitude, v = math.radians(30.0), np.array([20.0, -10.0, 5.0])
    C = Rotation.from_euler("ZYX", [0.7, 0.4, -1.1]).as_matrix()
    t = np.arange(1001) * 0.1
    gyro, accel = earth_bound(latitude, C, v, t)
    p, got, _ = strapdown.integrate(t, gyro, accel, ZERO, v, C, *local_earth(latitude))
    # as above for 100 s, and as much for Coriolis
    most = 2 * 9.8 * (EARTH_RATE * 0.1) ** 2 / 6 * 100.0
    np.testing.assert_allclose(got, np.tile(v, (len(t), 1)), atol=1.1 * most)
    np.testing.assert_allclose(p, t[:, None] * v, atol=1.1 * most * 100.0)
    # it is there to be seen: 2 omega v t
    g_n, _ = local_earth(latitude)
    _, without, _ = strapdown.integrate(t, gyro, accel, ZERO, v, C, g_n, STILL)
    assert np.linalg.norm(without[-1] - v) > EARTH_RATE * np.linalg.norm(v) * t[-1]


def test_the_simulated_phone_navigates_home():
    """End to end through the sampled recording: three turns end where they began."""
    world = simulate("three-turns", seed=0, phone=perfect_phone(), sway=0.0)
    x = world.imu.values
    p, v, C = strapdown.integrate(
        world.imu.stamps, x[:, :3], x[:, 3:], world.truth.position[0], world.truth.velocity[0],
        world.truth.C_nb[0], G_N, STILL,
    )  # fmt: skip
    most = 0.01**2 / 12 * np.linalg.norm(np.diff(world.truth.alpha, axis=0), axis=1).sum()
    assert most < 1e-3
    assert angle_between(C, world.truth.C_nb).max() < 1.1 * most
    # such a tilt for 30 s lets gravity run off
    assert np.linalg.norm(v, axis=1).max() < 1.1 * most * 9.8 * 30
    assert np.linalg.norm(p, axis=1).max() < 1.1 * most * 9.8 * 30**2 / 2


# --- the transition of errors -----------------------------------------------------------------


def one_interval(rng, dt, omega_ie_n):
    """Random readings at both ends, a state, and what parameters add to the readings."""
    w0, f0 = rng.normal(0, 3, 3), rng.normal(0, 10, 3)
    # within an interval readings change in proportion to its length
    w1, f1 = w0 + dt * rng.normal(0, 20, 3), f0 + dt * rng.normal(0, 50, 3)
    state = rng.normal(0, 1, 3), rng.normal(0, 2, 3), Rotation.random(random_state=rng).as_matrix()
    J = np.hstack([np.eye(6), rng.normal(0, 3, (6, 4))])

    def carried(error, parameters):
        """State at the end where the truth differs from the estimate by this error."""
        p, v, C = (x.copy() for x in state)
        p, v, C = p + error[:3], v + error[3:6], so3.matrix_exp(error[6:9]) @ C
        wrong = J @ parameters
        inc, f_n = np.empty((3, 3)), np.empty(3)
        strapdown.increments(
            w0 - wrong[:3], w1 - wrong[:3], f0 - wrong[3:], f1 - wrong[3:], dt, inc
        )
        strapdown.advance(p, v, C, inc, dt, G_N, omega_ie_n, f_n)
        return p, v, C, inc, f_n

    return state, J, carried


def numeric_transition(carried, columns, step=1e-5):
    out = np.empty((9, 9 + columns))
    for i in range(9 + columns):
        ends = []
        for sign in (1, -1):
            x = np.zeros(9 + columns)
            x[i] = sign * step
            ends.append(carried(x[:9], x[9:]))
        (pp, vp, Cp, _, _), (pm, vm, Cm, _, _) = ends
        out[:, i] = np.r_[pp - pm, vp - vm, so3.matrix_log(Cp @ Cm.T)] / (2 * step)
    return out


BLOCKS = {"position": slice(0, 3), "velocity": slice(3, 6), "psi": slice(6, 9)}
COLUMNS = BLOCKS | {
    "gyro bias": slice(9, 12),
    "accel bias": slice(12, 15),
    "effects": slice(15, 19),
}


@pytest.mark.parametrize("omega_ie_n", [STILL, 100 * local_earth(0.8)[1]], ids=["still", "earth"])
def test_error_transition_is_the_derivative_of_the_mechanization(omega_ie_n):
    """Every block: what is left falls at least with dt^2, and every main term is there.

    The Earth is made to turn a hundred times as fast, so that its terms can be seen. Without
    it, terms up to dt^2 are to be exact ("integrated to second order"), so the rest is dt^3;
    Coriolis and Earth rate are first order.
    """
    steps = np.array([0.04, 0.02, 0.01, 0.005])
    rest = {}
    for dt in steps:
        square = {}
        for seed in range(4):
            state, J, carried = one_interval(np.random.default_rng(seed), dt, omega_ie_n)
            _, _, _, inc, f_n = carried(np.zeros(9), np.zeros(10))
            Phi = np.empty((9, 19))
            C_mid = state[2] @ so3.matrix_exp(0.5 * inc[0])
            strapdown.error_transition(C_mid, f_n, dt, omega_ie_n, J[:, 6:].copy(), Phi)
            left = Phi - numeric_transition(carried, 10)
            for row, r in BLOCKS.items():
                for column, c in COLUMNS.items():
                    key = row, column
                    square[key] = square.get(key, 0.0) + float((left[r, c] ** 2).mean()) / 4
        for key, value in square.items():
            rest.setdefault(key, []).append(math.sqrt(value))
    least = 2.7 if not omega_ie_n.any() else 1.7
    for (row, column), sizes in rest.items():
        # round-off of the difference, and of positions of a metre
        if max(sizes) > 1e-9:
            assert order(steps, sizes) > least, (row, column, sizes)


def test_error_transition_at_one_hundred_hertz():
    """In numbers: a hand turning at 3 rad/s, 100 Hz, true Earth."""
    dt, rate = 0.01, local_earth(0.8)[1]
    for seed in range(4):
        state, J, carried = one_interval(np.random.default_rng(seed), dt, rate)
        _, _, _, inc, f_n = carried(np.zeros(9), np.zeros(10))
        Phi = np.empty((9, 19))
        C_mid = state[2] @ so3.matrix_exp(0.5 * inc[0])
        strapdown.error_transition(C_mid, f_n, dt, rate, J[:, 6:].copy(), Phi)
        # gyro 3 rad/s and force 10 m/s^2 (sigmas), effects of size 3: dt^3 (w^2, f w) / 6
        np.testing.assert_allclose(Phi, numeric_transition(carried, 10), rtol=0, atol=2e-4)

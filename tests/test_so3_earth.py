"""Rotations and the Earth against independent mathematics and published values."""

import math

import numpy as np
import pytest
from hypothesis import given as given_
from hypothesis import settings
from hypothesis import strategies as st
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from handcal import earth
from handcal.compiled import so3
from handcal.types import InputError

EPS = np.finfo(float).eps


def given(*strategies):
    """Without a deadline: the first call compiles."""
    return lambda test: settings(deadline=None)(given_(*strategies)(test))


@st.composite
def directions(draw):
    """Unit vectors, coordinate axes among them."""
    v = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    norm = np.linalg.norm(v)
    return v / norm if norm > 1e-3 else np.eye(3)[draw(st.integers(0, 2))]


# Angles where exponentials and logarithms go wrong: near 0, near half a turn, and between.
angles = st.one_of(
    st.just(0.0),
    st.floats(-18, -1).map(lambda e: 10.0**e),
    st.floats(-15, -1).map(lambda e: math.pi - 10.0**e),
    st.just(math.pi),
    st.floats(0.0, math.pi),
)
vectors = st.builds(lambda a, n: a * n, angles, directions())
any_angle = st.floats(-1e3, 1e3)


@given(vectors)
def test_exp_agrees_with_scipy_and_is_a_rotation(phi):
    C = so3.matrix_exp(phi)
    np.testing.assert_allclose(C, Rotation.from_rotvec(phi).as_matrix(), rtol=0, atol=8 * EPS)
    np.testing.assert_allclose(C @ C.T, np.eye(3), rtol=0, atol=8 * EPS)
    assert np.linalg.det(C) == pytest.approx(1.0, abs=8 * EPS)


@given(directions(), st.floats(4.0, 40.0))
def test_exp_of_more_than_half_a_turn(axis, angle):
    C = so3.matrix_exp(angle * axis)
    expected = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(C, expected, rtol=0, atol=100 * EPS)


@given(vectors)
def test_log_undoes_exp(phi):
    back = so3.matrix_log(so3.matrix_exp(phi))
    if np.linalg.norm(phi) > math.pi - 1e-14:
        # at half a turn both signs are the same rotation
        back = back if back @ phi >= 0 else -back
    np.testing.assert_allclose(back, phi, rtol=0, atol=30 * EPS)


@given(vectors)
def test_exp_undoes_log(phi):
    C = Rotation.from_rotvec(phi).as_matrix()
    back = so3.matrix_log(C)
    assert np.linalg.norm(back) <= math.pi * (1 + EPS)
    np.testing.assert_allclose(so3.matrix_exp(back), C, rtol=0, atol=30 * EPS)


@given(vectors)
def test_quaternions_there_and_back(phi):
    C = so3.matrix_exp(phi)
    q = so3.quaternion_of(C)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=4 * EPS)
    assert q[0] >= 0
    x, y, z, w = Rotation.from_rotvec(phi).as_quat()
    sign = 1.0 if q @ [w, x, y, z] > 0 else -1.0
    np.testing.assert_allclose(sign * q, [w, x, y, z], rtol=0, atol=30 * EPS)
    np.testing.assert_allclose(so3.matrix_of(q), C, rtol=0, atol=30 * EPS)


def test_arrays_of_rotations_are_taken_one_by_one():
    rng = np.random.default_rng(0)
    many = Rotation.random(12, random_state=0).as_matrix().reshape(3, 4, 3, 3)
    q, phi, yaw = so3.quaternion_of(many), so3.matrix_log(many), so3.yaw_of(many)
    assert (q.shape, phi.shape, yaw.shape) == ((3, 4, 4), (3, 4, 3), (3, 4))
    i, j = rng.integers(0, 3), rng.integers(0, 4)
    np.testing.assert_array_equal(q[i, j], so3.quaternion_of(many[i, j]))
    np.testing.assert_array_equal(phi[i, j], so3.matrix_log(many[i, j]))
    np.testing.assert_allclose(so3.matrix_of(q), many, atol=30 * EPS)


@given(vectors, vectors, directions())
def test_compositions(a, b, x):
    """Matrix product, quaternion product and one rotation after the other are the same."""
    A, B = so3.matrix_exp(a), so3.matrix_exp(b)
    AB, out = np.empty((3, 3)), np.empty(3)
    so3.matmul(A, B, AB)
    np.testing.assert_allclose(AB, A @ B, rtol=0, atol=4 * EPS)
    so3.rotate(AB, x, out)
    np.testing.assert_allclose(out, A @ (B @ x), rtol=0, atol=8 * EPS)
    (p0, p), (q0, q) = ((v[0], v[1:]) for v in (so3.quaternion_of(A), so3.quaternion_of(B)))
    hamilton = np.r_[p0 * q0 - p @ q, p0 * q + q0 * p + np.cross(p, q)]
    np.testing.assert_allclose(so3.matrix_of(hamilton), AB, rtol=0, atol=60 * EPS)


@given(directions(), st.floats(-1, 1), st.floats(-1, 1))
def test_turns_about_one_axis_add(axis, a, b):
    both = so3.matrix_exp(a * axis) @ so3.matrix_exp(b * axis)
    np.testing.assert_allclose(so3.matrix_exp((a + b) * axis), both, rtol=0, atol=10 * EPS)


@given(directions(), directions())
def test_small_turns_compose_by_half_their_cross_product(a, b):
    """Baker, Campbell and Hausdorff: the third order is at most 1/6 of the size cubed."""
    a, b = 1e-3 * a, 1e-3 * b
    both = so3.matrix_log(so3.matrix_exp(a) @ so3.matrix_exp(b))
    np.testing.assert_allclose(both, a + b + 0.5 * np.cross(a, b), rtol=0, atol=4e-10)


@given(vectors, st.integers(0, 2**32 - 1))
def test_orthonormalise_is_one_step_towards_the_polar_form(phi, seed):
    size = 1e-4
    C = so3.matrix_exp(phi) + size * np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    nearest, _ = polar(C)
    so3.orthonormalise(C)
    # A Newton step squares the error (entries up to 1e-4, so norms up to 3e-4).
    assert np.linalg.norm(C - nearest) < 5 * (3 * size) ** 2
    assert np.linalg.norm(C @ C.T - np.eye(3)) < 10 * (3 * size) ** 2


@given(directions(), directions())
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(so3.skew(a) @ b, np.cross(a, b), rtol=0, atol=2 * EPS)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_yaw_is_the_angle_about_the_vertical_whatever_the_tilt(yaw, pitch, roll):
    C = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    # cos(pitch) > 0.07 scales the round-off
    assert so3.yaw_of(C) == pytest.approx(yaw, abs=1e-14)


def test_yaw_counts_counter_clockwise_from_east():
    """Body x to the north: +90 degrees; to the west: 180."""
    north = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert so3.yaw_of(north) == pytest.approx(math.pi / 2)
    assert so3.yaw_of(north @ north) == pytest.approx(math.pi)


@given(any_angle, st.integers(-20, 20))
def test_wrap_keeps_the_direction_and_the_range(angle, turns):
    wrapped = float(so3.wrap(np.array(angle + 2 * math.pi * turns)))
    assert -math.pi < wrapped <= math.pi
    # what 1000 rad and 20 turns are rounded to
    assert math.remainder(wrapped - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize("ulps", [-2, -1, 0, 1, 2])
def test_wrap_at_its_edge(turns, ulps):
    """Half a turn is +pi, from either side and a few rounding errors away from it."""
    angle = (2 * turns + 1) * math.pi
    angle += ulps * np.spacing(angle)
    wrapped = float(so3.wrap(np.array(angle)))
    assert -math.pi < wrapped <= math.pi
    assert abs(wrapped) == pytest.approx(math.pi, abs=1e-14)


@given(st.floats(-3.2, 3.2))
def test_wrap_leaves_angles_within_half_a_turn_alone(angle):
    expected = angle if abs(angle) <= math.pi else angle - math.copysign(2 * math.pi, angle)
    assert float(so3.wrap(np.array(angle))) == pytest.approx(expected, abs=4 * EPS)


def test_normal_gravity_at_equator_and_pole():
    """The defining and derived constants of WGS84 (NIMA TR8350.2, tables 3.3 and 3.4)."""
    assert earth.normal_gravity(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    for pole in (math.pi / 2, -math.pi / 2):
        assert earth.normal_gravity(pole) == pytest.approx(9.8321849378, abs=1e-9)


@pytest.mark.parametrize("latitude", np.radians([0.0, 30.0, -45.0, 60.0, 90.0]))
def test_gravity_falls_with_height_as_bruns_has_it(latitude):
    """-dg/dh = g (1/M + 1/N) + 2 omega^2, M and N the radii of curvature of the ellipsoid."""
    a, e2, omega = 6378137.0, 0.00669437999014, 7.292115e-5
    s2 = math.sin(latitude) ** 2
    N = a / math.sqrt(1 - e2 * s2)
    M = a * (1 - e2) / (1 - e2 * s2) ** 1.5
    g = earth.normal_gravity(latitude)
    expected = -(g * (1 / M + 1 / N) + 2 * omega**2)
    slope = (earth.normal_gravity(latitude, 1.0) - earth.normal_gravity(latitude, -1.0)) / 2
    # the series is cut at the first order of the flattening: f^2 = 1e-5
    assert slope == pytest.approx(expected, rel=5e-5)
    curved = (
        earth.normal_gravity(latitude, 1e4)
        - 2 * g
        + earth.normal_gravity(latitude, -1e4)
    ) / 1e8  # fmt: skip
    # a sphere has 6 g / r^2
    assert curved == pytest.approx(6 * g / a**2, rel=0.01)


def test_gravity_is_the_same_on_both_hemispheres_and_grows_towards_the_poles():
    latitudes = np.radians(np.arange(0, 91, 5))
    north = [earth.normal_gravity(x) for x in latitudes]
    assert north == [earth.normal_gravity(-x) for x in latitudes]
    assert np.all(np.diff(north) > 0)


@pytest.mark.parametrize("latitude_deg", [-90.0, -33.0, 0.0, 48.0, 90.0])
def test_earth_rate_points_to_the_celestial_pole(latitude_deg):
    latitude = math.radians(latitude_deg)
    g_n, rate = earth.local_earth(latitude, 300.0)
    assert g_n[0] == g_n[1] == 0.0
    assert g_n[2] == -earth.normal_gravity(latitude, 300.0)
    assert rate[0] == 0.0
    # one turn a sidereal day; the pole stands as high as the latitude
    assert np.linalg.norm(rate) == pytest.approx(2 * math.pi / 86164.0905, rel=1e-6)
    assert math.atan2(rate[2], rate[1]) == pytest.approx(latitude, abs=1e-12)


def test_without_a_latitude_gravity_is_standard_and_the_earth_stands_still():
    g_n, rate = earth.local_earth(None)
    np.testing.assert_array_equal(g_n, [0.0, 0.0, -9.80665])
    np.testing.assert_array_equal(rate, np.zeros(3))


@pytest.mark.parametrize("latitude", [1.6, -1.6, 48.0, math.nan, math.inf])
def test_a_latitude_that_cannot_be_is_refused(latitude):
    with pytest.raises(InputError, match="latitude"):
        earth.local_earth(latitude)


@pytest.mark.parametrize("height", [-2000.0, 1e5, math.nan])
def test_a_height_that_cannot_be_is_refused(height):
    with pytest.raises(InputError, match="height"):
        earth.local_earth(0.8, height)

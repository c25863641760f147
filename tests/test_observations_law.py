"""Laws that every observation obeys, by itself and with every effect that touches it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from handcal.compiled import so3
from handcal.compiled.jit import call_residual
from handcal.compiled.kernel import BASE, MAX_DIM, MOST_HELD, Tables, linearise
from handcal.compiled.so3 import wrap
from handcal.effects import DELAY, TIME, WARMTH, Z_DIM, _reference
from handcal.effects import catalogue as effects
from handcal.effects._reference import NOW, SLOPE
from handcal.observations import NAV, Scene, catalogue
from handcal.observations.magnetometer import HORIZONTAL, UPWARD, heading_off
from handcal.observations.pose import aligned
from handcal.recordings.streams import STREAMS, observed_by
from handcal.types import Imu, Recording, Series

SCENE = Scene(np.zeros((0, 2)), True)
KINDS = sorted(catalogue())
PAIRS = [(k, None) for k in KINDS] + [
    (k, e.id) for k in KINDS for e in effects().values() if k in e.acts_on
]
# Readings that come late beside whatever else there may be.
LATE = [
    (k, late.id, e.id)
    for k in KINDS
    for late in effects().values()
    if k in late.lateness
    for e in effects().values()
    if k in e.acts_on and e is not late
]


def nav_of(p, v, C, w, f):
    return np.concatenate([p, v, np.ravel(C), w, f]).astype(float)


def tilted(rng, x_from_vertical_deg):
    """A random attitude whose body x stands this far from the vertical, up or down."""
    up = math.radians(90.0 - x_from_vertical_deg) * rng.choice([-1, 1])
    yaw, roll = rng.uniform(-math.pi, math.pi, 2)
    return Rotation.from_euler("ZYX", [yaw, -up, roll]).as_matrix()


def random_case(kind, seed):
    """A navigation state with any tilt that the observation accepts, and a plausible reading."""
    rng = np.random.default_rng(seed)
    C = tilted(rng, rng.uniform(16.0, 90.0))
    p, v, w, f = (rng.normal(0, s, 3) for s in (0.3, 0.5, 2.0, 8.0))
    turn = so3.matrix_exp(rng.normal(0, 0.1, 3))
    if kind == "heading":
        z = [float(wrap(so3.yaw_of(C) + rng.normal(0, 0.5)))]
    elif kind == "magnetometer":
        field = C.T @ [0.0, 0.5, -0.8] + rng.normal(0, 0.1, 3)  # in gauss
        z = np.r_[field, 0.5, -0.8, 0.0, 0.5, -0.8]
    elif kind == "pose":
        z = np.r_[p + rng.normal(0, 0.1, 3), so3.quaternion_of(turn @ C)]
    elif kind == "known_input":
        z = np.r_[w + rng.normal(0, 0.1, 3), f + rng.normal(0, 0.1, 3), rng.normal(0, 5, 3)]
    else:
        z = rng.normal(0, 0.1, 3)
    return nav_of(p, v, C, w, f), placed(kind, z)


def placed(kind, own):
    """z with these numbers in a kind's first own places."""
    first = NOW if kind == "known_input" else 0
    z = np.zeros(_reference.END)
    z[first : first + len(own)] = own
    return z


def setup(kind, *names):
    """Tables of one observation alone, or with effects; its extras one after another."""
    o = catalogue()[kind]
    parts = [(o.residual, len(o.constants(SCENE)), False)]
    if o.markov is not None:
        parts.append((o.markov_residual, o.markov.size, False))
    for e in (effects()[name] for name in names if name is not None):
        size = len(e.parameters) if e.process is None else e.process.size
        late = kind in e.lateness
        parts.append(((e.lateness if late else e.observation_error)[kind], size, late))
    counts = np.array([[c for _, c, _ in parts] + [0]])
    start = np.concatenate([[0], np.cumsum(counts[0])[:-1]])[None]
    function = np.array([[a for a, _, _ in parts] + [0]], dtype=np.int64)
    tables = Tables(
        np.array([o.dim]),
        np.array([o.jacobian]),
        function,
        start,
        counts,
        np.full(64, 1e-5),
        np.zeros_like(counts),
        np.full((*counts.shape, MOST_HELD), np.nan),
        np.array([[late for _, _, late in parts] + [False]], dtype=np.int64),
    )
    return o, tables, int(counts.sum())


def residual(o, tables, nav, extras, z):
    """The residual by calling every part, without the kernel; those of late readings with the
    state of that much before."""
    r, seconds = np.zeros(MAX_DIM), np.zeros(MAX_DIM)
    extras = np.r_[extras, 0.0]
    parts = list(zip(tables.function[0], tables.start[0], tables.late[0], strict=True))
    for address, a, late in parts:
        if address and late:
            assert call_residual(address, nav, np.ascontiguousarray(extras[a:]), z, seconds) == 0
    then = nav.copy()
    then[:3] -= seconds[0] * nav[3:6]
    turned = Rotation.from_rotvec(-seconds[0] * nav[15:18]).as_matrix()
    then[6:15] = (nav[6:15].reshape(3, 3) @ turned).ravel()
    for address, a, late in parts:
        if address and not late:
            assert call_residual(address, then, np.ascontiguousarray(extras[a:]), z, r) == 0
    return r[: o.dim]


def moved(nav, i, step):
    out = nav.copy()
    if i < 6:
        out[i] += step
    elif i < 9:
        phi = np.zeros(3)
        phi[i - 6] = step
        C = Rotation.from_rotvec(phi).as_matrix() @ nav[6:15].reshape(3, 3)
        out[6:15] = C.ravel()
    return out


def difference(o, tables, nav, extras, z, J, step):
    """-d residual / d(error state), by fourth-order differences through nav and extras.

    Biases and IMU constants act through rate and force alone: a larger bias, or constant,
    means that J of it was not motion.
    """
    n = BASE + len(extras)

    def at(i, s):
        changed, own = nav.copy(), extras.copy()
        if i < 9:
            changed = moved(nav, i, s)
        elif i < 15:
            changed[15 + i - 9] -= s
        else:
            own[i - 15] += s
            if i - 15 < J.shape[1]:
                changed[15:21] -= J[:, i - 15] * s
        return residual(o, tables, changed, own, z)

    out = np.empty((o.dim, n))
    for i in range(n):
        near, far = at(i, step) - at(i, -step), at(i, 2 * step) - at(i, -2 * step)
        out[:, i] = -(8 * near - far) / (12 * step)
    return out


@pytest.mark.parametrize("step", [1e-3, 2e-4])
@pytest.mark.parametrize(("kind", "effect", "beside"), [*((*p, None) for p in PAIRS), *LATE])
def test_observation_matrix_is_the_derivative_of_the_residual(kind, effect, beside, step):
    """All columns, with IMU constants in front, at random attitudes and non-zero extras. (A marker
    that sits beside the IMU moves with another velocity: how late it is tells of its own.)"""
    o, tables, count = setup(kind, effect, beside)
    for seed in range(8):
        nav, z = random_case(kind, seed)
        rng = np.random.default_rng(100 + seed)
        mi = 2
        extras = np.r_[np.zeros(mi), 0.05 * rng.normal(0, 1, count)]
        shifted = tables._replace(start=tables.start + mi)
        J = rng.normal(0, 1, (6, mi))
        r, H = np.zeros(MAX_DIM), np.zeros((MAX_DIM, BASE + mi + count))
        assert linearise(0, shifted, nav, extras.copy(), z, J, r, H) == 0
        np.testing.assert_allclose(r[: o.dim], residual(o, shifted, nav, extras, z), atol=1e-15)
        # Differences: 1e-16/step of round-off, step^4 (here) and 1e-10 (kernel) of curvature.
        expected = difference(o, shifted, nav, extras, z, J, step)
        np.testing.assert_allclose(H[: o.dim], expected, rtol=3e-6, atol=2e-8)
        assert np.all(H[o.dim :] == 0)
        assert np.abs(expected).max() > 0.5


@pytest.mark.parametrize("at", [0.3, 0.7])
def test_what_is_held_is_no_column_and_all_else_stays(at):
    """A step at its moment: residual and columns are those of the effect with all its parameters,
    but for the moment's."""
    step = effects()["mag_step"].parameters
    _, whole, count = setup("magnetometer", "mag_step")
    held = whole._replace(
        counts=whole.counts - [0, 0, 1, 0],
        whole=np.array([[0, 0, len(step), 0]]),
        held=whole.held.copy(),
    )
    held.held[0, 2, : len(step)] = [np.nan, np.nan, np.nan, at]
    nav, z = random_case("magnetometer", 0)
    z[TIME] = 0.5
    own = np.random.default_rng(0).normal(0, 0.1, count - 1)
    out = []
    for tables, extras in ((held, own), (whole, np.r_[own, at])):
        r, H = np.zeros(MAX_DIM), np.zeros((MAX_DIM, BASE + len(extras)))
        assert linearise(0, tables, nav, extras.copy(), z, np.zeros((6, 0)), r, H) == 0
        out.append((r, H[:, : BASE + count - 1]))
    np.testing.assert_array_equal(out[0][0], out[1][0])
    np.testing.assert_array_equal(out[0][1], out[1][1])
    assert bool(out[0][1][:3, -3:].any()) == (at < z[TIME])


@pytest.mark.parametrize("kind", KINDS)
def test_a_perfect_reading_leaves_no_residual(kind):
    """Observed equals predicted, with all extras at zero and at any attitude."""
    o, tables, count = setup(kind)
    for seed in range(10):
        nav, z = random_case(kind, seed)
        C = nav[6:15].reshape(3, 3)
        if kind == "heading":
            z[0] = np.arctan2(C[1, 0], C[0, 0])
        elif kind == "magnetometer":
            z[:5] = np.r_[C.T @ [0.0, 2e-5, -4e-5], 2e-5, -4e-5]
        elif kind == "pose":
            z[:7] = np.r_[nav[:3], so3.quaternion_of(C)]
        elif kind == "known_input":
            z = placed(kind, nav[15:21])
        else:
            first = {"fixed_position": 0, "zero_velocity": 3, "zero_rate": 15}[kind]
            z[:3] = nav[first : first + 3]
        np.testing.assert_allclose(residual(o, tables, nav, np.zeros(count), z), 0, atol=1e-14)


def test_residuals_are_observed_minus_predicted():
    """Signs and units by hand, level device at yaw 0."""
    nav = nav_of([1.0, 2.0, 3.0], [0.1, 0.2, 0.3], np.eye(3), [0.4, 0.5, 0.6], [0, 0, 9.8])
    by_hand = {
        "fixed_position": ([0.0] * 3, [-1.0, -2.0, -3.0]),
        "zero_velocity": ([0.0] * 3, [-0.1, -0.2, -0.3]),
        "zero_rate": ([0.0] * 3, [-0.4, -0.5, -0.6]),
        "heading": ([0.2], [0.2]),
        # North is +y of n, and of the body; 20 and -40 uT are the first guess.
        "magnetometer": ([1e-5, 5e-5, -3e-5, 2e-5, -4e-5], [1e-5, 3e-5, 1e-5]),
        "pose": (
            [1.1, 2.0, 2.9, math.cos(0.05), 0.0, 0.0, math.sin(0.05)],
            [0.1, 0.0, -0.1, 0.0, 0.0, 0.1],
        ),
        # an angular acceleration says nothing without a lever arm
        "known_input": (
            [0.5, 0.5, 0.4, 1.0, -1.0, 9.9, 7.0, 8.0, 9.0],
            [0.1, 0.0, -0.2, 1.0, -1.0, 0.1],
        ),
    }
    assert set(by_hand) == set(KINDS)
    for kind, (reading, expected) in by_hand.items():
        o, tables, count = setup(kind)
        z = placed(kind, reading)
        got = residual(o, tables, nav, np.zeros(count), z)
        np.testing.assert_allclose(got, expected, atol=1e-12, err_msg=kind)


@pytest.mark.parametrize("yaw", [math.pi - 0.01, -math.pi + 0.01, math.pi, 0.0, 3.0, -3.0])
@pytest.mark.parametrize("off", [-0.5, -0.02, 0.02, 0.5, 3.0, -3.0])
def test_headings_wrap_at_half_a_turn(yaw, off):
    """The residual is the short way round, whatever the yaw."""
    o, tables, count = setup("heading")
    C = Rotation.from_euler("ZYX", [yaw, 0.3, -0.4]).as_matrix()
    nav = nav_of([0, 0, 0], [0, 0, 0], C, [0, 0, 0], [0, 0, 9.8])
    z = np.zeros(Z_DIM)
    z[0] = float(wrap(np.array(yaw + off)))
    got = residual(o, tables, nav, np.zeros(count), z)
    np.testing.assert_allclose(got, [off], atol=1e-12)
    J, r, H = np.zeros((6, 0)), np.zeros(MAX_DIM), np.zeros((MAX_DIM, BASE + count))
    assert linearise(0, tables, nav, np.zeros(max(1, count)), z, J, r, H) == 0
    # about the vertical it is one to one
    assert H[0, 8] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("from_vertical_deg", [0.0, 5.0, 14.9, 15.1, 30.0, 90.0])
def test_headings_are_skipped_within_15_degrees_of_body_x_vertical(from_vertical_deg):
    """Contract; up and down alike."""
    _, tables, _ = setup("heading")
    for seed in range(10):
        C = tilted(np.random.default_rng(seed), from_vertical_deg)
        nav = nav_of([0, 0, 0], [0, 0, 0], C, [0, 0, 0], [0, 0, 9.8])
        r, H = np.zeros(MAX_DIM), np.zeros((MAX_DIM, BASE))
        z = np.zeros(Z_DIM)
        skipped = linearise(0, tables, nav, np.zeros(1), z, np.zeros((6, 0)), r, H)
        assert skipped == (from_vertical_deg < 15.0)
        if skipped:
            assert np.all(H == 0)


@pytest.mark.parametrize("off", [-3.0, -0.5, 0.02, 0.1])
def test_a_field_shows_a_heading_in_any_attitude(off):
    """Body x vertical or not; of a north that differs from its first guess by 5 uT."""
    o, tables, count = setup("magnetometer")
    for seed in range(10):
        rng = np.random.default_rng(seed)
        C = tilted(rng, 0.5 if seed % 2 else rng.uniform(1.0, 90.0))
        nav = nav_of([0, 0, 0], [0, 0, 0], C, [0, 0, 0], [0, 0, 9.8])
        z = np.zeros(Z_DIM)
        z[:3] = (so3.matrix_exp(np.array([0, 0, off])) @ C).T @ [0.0, 2.5e-5, -4e-5]
        z[HORIZONTAL], z[UPWARD] = 2e-5, -3e-5
        theta = np.r_[5e-6, -1e-5, np.zeros(count - 2)]
        r = residual(o, tables, nav, theta, z)
        got = heading_off(C[None], r[None], np.array([2.5e-5]))
        np.testing.assert_allclose(got, [off], atol=1e-12)


def a_field(seed, rate_hz=50.0, noise=0.0, iron=(0.0, 0.0, 0.0)):
    """A slowly turning magnetometer of 20 uT to the north and 40 downwards, as a recording."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 1.0 / rate_hz)
    C = so3.rotations(np.stack([np.sin(0.9 * t), np.cos(0.7 * t), t], axis=1))
    field = np.einsum("kji,j->ki", C, [0.0, 2e-5, -4e-5]) + noise * rng.standard_normal((len(t), 3))
    imu = Imu(t, np.zeros((len(t), 3)), 9.8 * C[:, 2, :], np.ones(len(t), dtype=bool))
    return Recording("made", imu, {"mag": Series(t, field + np.array(iron))})


def test_first_guesses_of_a_field_and_its_noise():
    """Strengths without a strong iron, to 2 uT; white noise to a quarter, repeated readings or
    not; at most ten rows a second."""
    o = catalogue()["magnetometer"]
    for seed in range(3):
        recording = a_field(seed, noise=5e-7, iron=(1e-4, -5e-5, 8e-5))
        rows = o.rows(recording, SCENE)
        np.testing.assert_allclose(rows.z[0, [HORIZONTAL, UPWARD]], [2e-5, -4e-5], atol=2e-6)
        assert o.guess(rows.z)["mag_noise"] == pytest.approx(5e-7, rel=0.25)
        assert len(rows.t) <= 10.5 * 20.0
        mag = recording.streams["mag"]
        twice = np.repeat(mag.t, 2) + np.tile([0.0, 0.01], len(mag.t))
        held = Series(twice, np.repeat(mag.value, 2, axis=0))
        again = o.rows(replace(recording, streams={"mag": held}), SCENE)
        assert o.guess(again.z)["mag_noise"] == pytest.approx(5e-7, rel=0.25)


def test_pose_constants_turn_world_and_marker():
    """theta: the pose's world against n, and the marker in b, each by hand about one axis."""
    o, tables, count = setup("pose")
    C = Rotation.from_euler("ZYX", [1.0, 0.4, -0.7]).as_matrix()
    nav = nav_of([1.0, 2.0, 3.0], [0, 0, 0], C, [0, 0, 0], [0, 0, 9.8])
    z = np.zeros(Z_DIM)
    for k in range(3):
        small = np.zeros(3)
        small[k] = 0.1
        turn = so3.matrix_exp(small)
        # W takes n to the pose's world, which reads W p and W C
        z[:7] = np.r_[turn @ nav[:3], so3.quaternion_of(turn @ C)]
        extras = np.zeros(count)
        extras[k] = 0.1
        got = residual(o, tables, nav, extras, z)
        np.testing.assert_allclose(got, 0, atol=1e-13)
        z[:7] = np.r_[nav[:3], so3.quaternion_of(C @ turn)]
        extras = np.zeros(count)
        extras[3 + k] = 0.1
        np.testing.assert_allclose(residual(o, tables, nav, extras, z), 0, atol=1e-13)


def test_known_input_constants_turn_the_reference():
    """theta: the reference's axes against b; a reading in turned axes leaves no residual."""
    o, tables, count = setup("known_input")
    w, f = np.array([0.4, -0.5, 0.6]), np.array([1.0, 2.0, 9.0])
    nav = nav_of([0, 0, 0], [0, 0, 0], np.eye(3), w, f)
    for k in range(3):
        theta = np.zeros(3)
        theta[k] = 0.1
        turn = so3.matrix_exp(theta)
        z = placed("known_input", np.r_[turn @ w, turn @ f])
        extras = np.zeros(count)
        extras[:3] = theta
        np.testing.assert_allclose(residual(o, tables, nav, extras, z), 0, atol=1e-14)


# --- declarations ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_declarations_fit_together(kind):
    o = catalogue()[kind]
    assert o.kind == kind
    assert o.title
    assert len(o.channels) == o.dim <= MAX_DIM
    levels = {lv.name: lv.initial for lv in o.levels}
    assert len(levels) == len(o.levels) > 0
    assert all(0 < lv.lower < lv.initial < lv.upper for lv in o.levels)
    R = o.variance(levels)
    assert R.shape == (o.dim,)
    assert np.all(R > 0)
    # variances are squares of levels: twice the level, four times the variance
    np.testing.assert_allclose(o.variance({n: 2 * x for n, x in levels.items()}), 4 * R)
    assert (o.markov is None) == (o.markov_residual == 0)
    assert NAV == 21


# --- Markov states -------------------------------------------------------------------------------

MARKOV = [k for k in KINDS if catalogue()[k].markov is not None]


def levels_of(kind, seed):
    """Levels anywhere in their allowed range (uniform in the logarithm)."""
    rng = np.random.default_rng(seed)
    return {
        lv.name: math.exp(rng.uniform(math.log(lv.lower), math.log(lv.upper)))
        for lv in catalogue()[kind].levels
    }


@pytest.mark.parametrize("kind", MARKOV)
@pytest.mark.parametrize("rate", [0.0, 0.01, 0.5, 6.0])
def test_markov_transitions_are_a_semigroup(kind, rate):
    """Two steps are one: Phi(a+b) = Phi(b) Phi(a), Q(a+b) = Phi(b) Q(a) Phi(b)' + Q(b)."""
    markov = catalogue()[kind].markov
    for seed in range(5):
        levels = levels_of(kind, seed)
        a, b = np.random.default_rng(seed).uniform(0.001, 0.5, 2)
        Phi, Q = markov.transition(levels, np.array([a, b, a + b]), np.full(3, rate))
        assert Phi.shape == Q.shape == (3, markov.size, markov.size)
        np.testing.assert_allclose(Phi[2], Phi[1] @ Phi[0], rtol=1e-10, atol=1e-14)
        scale = np.sqrt(np.diag(markov.start(levels, rate)))
        both = Phi[1] @ Q[0] @ Phi[1].T + Q[1]
        np.testing.assert_allclose((Q[2] - both) / np.outer(scale, scale), 0, atol=1e-11)


@pytest.mark.parametrize("kind", MARKOV)
@pytest.mark.parametrize("rate", [0.0, 0.5, 6.0])
def test_markov_noise_keeps_what_is_stationary(kind, rate):
    """At a steady turning rate the start's covariance stays, from a millisecond to a minute."""
    markov = catalogue()[kind].markov
    dt = np.array([0.0, 1e-6, 1e-3, 0.01, 0.1, 1.0, 60.0])
    for seed in range(5):
        levels = levels_of(kind, seed)
        P = markov.start(levels, rate)
        scale = np.outer(*[np.sqrt(np.diag(P))] * 2)
        assert P.shape == (markov.size, markov.size)
        Phi, Q = markov.transition(levels, dt, np.full(len(dt), rate))
        np.testing.assert_array_equal(Phi[0], np.eye(markov.size))
        np.testing.assert_allclose(Q[0], 0, atol=1e-18)
        for k in range(len(dt)):
            after = Phi[k] @ P @ Phi[k].T + Q[k]
            np.testing.assert_allclose(after / scale, P / scale, atol=1e-12)
            np.testing.assert_allclose(Q[k] / scale, Q[k].T / scale, atol=1e-15)
            # round-off of 1 - phi^2 in units of the stationary variance
            assert np.linalg.eigvalsh(Q[k] / scale).min() > -2e-15
        # something is forgotten, and nothing grows
        assert np.all(np.abs(np.linalg.eigvals(Phi[-1])) < 1)


def test_sway_is_a_critically_damped_oscillator():
    """x'' = -2 b x' - b^2 x, against the matrix exponential; more sway while turning."""
    sway = catalogue()["fixed_position"].markov
    levels = {"sway": 0.004, "sway_per_rate": 0.003, "sway_time": 0.7, "position_noise": 1e-3}
    b, dt = 1 / 0.7, np.array([0.01, 0.3, 2.0])
    A = np.kron(np.array([[0.0, 1.0], [-b * b, -2 * b]]), np.eye(3))
    Phi, _ = sway.transition(levels, dt, np.zeros(3))
    for k in range(3):
        np.testing.assert_allclose(Phi[k], expm(A * dt[k]), atol=1e-12)
    P = np.diag(sway.start(levels, 2.0))
    # independent parts add as squares: 4 mm and 3 mm/(rad/s) at 2 rad/s
    np.testing.assert_allclose(P[:3], 0.004**2 + 0.006**2)
    np.testing.assert_allclose(P[3:], b * b * (0.004**2 + 0.006**2))
    assert sway.vectors == 2


@pytest.mark.parametrize("kind", MARKOV)
def test_each_markov_state_moves_its_own_channel(kind):
    """One to one; the velocity of the sway moves nothing. The held point is where sway puts it."""
    o = catalogue()[kind]
    nav, z = random_case(kind, 0)
    for i in range(o.markov.size):
        state, r = np.zeros(o.markov.size), np.zeros(MAX_DIM)
        state[i] = 0.25
        assert call_residual(o.markov_residual, nav, state, z, r) == 0
        expected = np.zeros(MAX_DIM)
        if i < o.dim:
            expected[i] = 0.25 if kind == "fixed_position" else -0.25
        np.testing.assert_array_equal(r, expected)


@pytest.mark.parametrize("kind", sorted(set(MARKOV) - {"fixed_position", "known_input"}))
def test_disturbances_of_place_forget_by_turning(kind):
    """One radian of turning forgets as much at any speed; at rest almost nothing is lost."""
    markov = catalogue()[kind].markov
    levels = levels_of(kind, 0)
    Phi, _ = markov.transition(levels, np.array([1.0, 0.5]), np.array([1.02, 2.02]))
    np.testing.assert_allclose(np.diagonal(Phi, axis1=1, axis2=2), math.exp(-1.0), rtol=2e-3)
    Phi, _ = markov.transition(levels, np.array([10.0]), np.array([0.01]))
    assert np.all(np.diag(Phi[0]) > 0.98)


def test_errors_of_a_reference_grow_with_the_turn_and_are_forgotten_at_once():
    """2 % of the rate, and forces of 1, 2 and 3 mm/s times it; nothing is left a sample later."""
    markov = catalogue()["known_input"].markov
    force = {f"reference_accel_in_motion_{a}": 1e-3 * (i + 1) for i, a in enumerate("xyz")}
    P = markov.start({"reference_gyro_in_motion": 0.02, **force}, 5.0)
    np.testing.assert_allclose(np.sqrt(np.diag(P)), [0.1] * 3 + [0.005, 0.010, 0.015], rtol=1e-5)
    levels = {"reference_gyro_in_motion": 0.02, **force}
    Phi, Q = markov.transition(levels, np.array([0.01, 0.01]), np.array([5.0, 0.0]))
    assert np.abs(Phi).max() < 1e-4
    np.testing.assert_allclose(Q[0], P, rtol=1e-6)
    # at rest hardly anything remains
    assert np.sqrt(Q[1].max()) < 3e-4
    assert markov.vectors == 0


# --- known input ---------------------------------------------------------------------------------

AXES = Rotation.from_euler("ZYX", [2.0, 0.7, -1.1]).as_matrix()


def two_imus(rate_hz=100.0, reference_hz=100.0, phase_s=0.0, gap=(9.0, 9.0), spoilt=()):
    """A turn about all axes read by an IMU and by a reference in axes of its own.

    Returns the recording, and functions of time for rate and angular acceleration in b.
    """
    amplitude, frequency = np.array([3.0, -2.0, 4.0]), np.array([7.0, 9.0, 11.0])

    def rate(t):
        return amplitude * np.sin(np.multiply.outer(t, frequency))

    def acceleration(t):
        return amplitude * frequency * np.cos(np.multiply.outer(t, frequency))

    def both(t):
        return np.hstack([rate(t), np.array([1.0, 2.0, 9.0]) + 0.5 * rate(t)[:, [1, 2, 0]]])

    t = np.arange(0.0, 6.0, 1.0 / rate_hz)
    s = np.arange(phase_s, 6.0, 1.0 / reference_hz)
    s = s[(s < gap[0]) | (s > gap[1])]
    readings, valid = both(t), np.ones(len(t), dtype=bool)
    for at in spoilt:
        readings[at], valid[at] = 40.0, False
    turned = both(s).reshape(-1, 2, 3) @ AXES.T
    imu = Imu(t, readings[:, :3].copy(), readings[:, 3:].copy(), valid)
    streams = {"reference": Series(s, turned.reshape(-1, 6))}
    return Recording("made", imu, streams), rate, acceleration


@pytest.mark.parametrize(("reference_hz", "phase_s"), [(100.0, 0.0), (100.0, 0.004), (250.0, 0.0)])
def test_a_reference_is_turned_and_read_at_the_stamps_of_the_imu(reference_hz, phase_s):
    """Its axes point anywhere; rate to 0.1 %, angular acceleration to 0.5 % at 1 to 2 Hz."""
    recording, rate, acceleration = two_imus(reference_hz=reference_hz, phase_s=phase_s)
    rows = catalogue()["known_input"].rows(recording, SCENE)
    assert set(rows.t) <= set(recording.imu.t)
    assert len(rows.t) > 0.97 * len(recording.imu.t)
    np.testing.assert_allclose(rows.z[:, NOW : NOW + 3], rate(rows.t), atol=4e-3)
    np.testing.assert_allclose(rows.z[:, SLOPE : SLOPE + 3], acceleration(rows.t), atol=0.2)


def test_a_slow_reference_is_read_where_the_imu_reads():
    """Once for each of its samples, at the nearest of the IMU's stamps."""
    recording, rate, _ = two_imus(rate_hz=400.0, reference_hz=50.0, phase_s=0.0011)
    rows = catalogue()["known_input"].rows(recording, SCENE)
    own = recording.streams["reference"].t
    assert set(rows.t) <= set(recording.imu.t)
    assert 0.9 * len(own) < len(rows.t) <= len(own)
    assert np.abs(rows.t[:, None] - own).min(axis=1).max() < 0.5 / 400.0 + 1e-9
    np.testing.assert_allclose(rows.z[:, NOW : NOW + 3], rate(rows.t), atol=4e-3)


def test_nothing_is_compared_beside_gaps_and_readings_that_are_none():
    """Three samples on either side, of a saturated IMU (at 2 s) and a missing reference."""
    recording, rate, acceleration = two_imus(gap=(3.995, 4.035), spoilt=[200])
    rows = catalogue()["known_input"].rows(recording, SCENE)
    for a, b in ((2.0, 2.0), (4.0, 4.03)):
        assert not np.any((rows.t > a - 0.035) & (rows.t < b + 0.035))
        assert np.any(np.abs(rows.t - (a - 0.05)) < 1e-6)
        assert np.any(np.abs(rows.t - (b + 0.05)) < 1e-6)
    np.testing.assert_allclose(rows.z[:, NOW : NOW + 3], rate(rows.t), atol=0.02)
    assert np.abs(rows.z[:, SLOPE : SLOPE + 3] - acceleration(rows.t)).max() < 2.0


def test_a_long_rest_tells_no_more_than_its_share():
    """Ten a second at rest, all in motion."""
    recording, _, _ = two_imus()
    rows = catalogue()["known_input"].rows(recording, replace(SCENE, rests=np.array([[1.0, 5.0]])))
    resting = (rows.t >= 1.0) & (rows.t <= 5.0)
    assert 38 <= resting.sum() <= 42
    assert (~resting).sum() > 190


def test_a_reference_of_a_few_readings_is_none():
    recording, _, _ = two_imus(reference_hz=0.5)
    assert catalogue()["known_input"].rows(recording, SCENE) is None
    empty = replace(recording, streams={})
    assert catalogue()["known_input"].rows(empty, SCENE) is None


MOVABLE = [k for k, o in catalogue().items() if o.moved is not None]


def seen_pose(n=200):
    """A recording with a pose whose marker and world are turned, and its attitudes C_nb."""
    t = np.linspace(0.0, 10.0, n)
    angle = np.stack([np.sin(0.9 * t), np.cos(0.7 * t), np.sin(1.3 * t + 1.0)], axis=1)
    C = so3.rotations(angle)
    rate = so3.matrix_log(C[:-1].transpose(0, 2, 1) @ C[1:]) / (t[1] - t[0])
    imu = Imu(t, np.vstack([rate, rate[-1:]]), 9.8 * C[:, 2, :], np.ones(n, dtype=bool))
    world, marker = Rotation.random(2, random_state=3).as_matrix()
    q = so3.quaternion_of(world @ C @ marker)
    return Recording("made", imu, {"pose": Series(t, np.hstack([angle, q]))})


def test_every_observation_of_a_stream_can_be_moved_but_a_reference():
    of_streams = {o.kind for o in catalogue().values() if observed_by(o.kind)}
    assert of_streams == {*MOVABLE, "known_input"}


@pytest.mark.parametrize("kind", MOVABLE)
def test_a_moved_reading_has_a_residual_larger_by_the_shift(kind):
    o, rng, recording = catalogue()[kind], np.random.default_rng(0), seen_pose()
    name, t = observed_by(kind).name, recording.imu.t
    shift = 0.05 * rng.standard_normal((len(t), o.dim))
    R_bm, R_nw = aligned(recording, recording.streams["pose"])
    C_nb = R_nw @ so3.matrix_of(recording.streams["pose"].value[:, 3:]) @ R_bm.T
    if name != "pose":
        value = rng.uniform(1.0, 3.0, (len(t), len(STREAMS[name].columns)))
        recording = replace(recording, streams={name: Series(t, value)})
    series = recording.streams[name]
    residuals, used = [], np.ones(len(t), dtype=bool)
    for s in (series, o.moved(recording, series, C_nb, shift)):
        z, r = np.zeros((len(t), Z_DIM)), np.zeros((len(t), o.dim))
        z[:, : s.value.shape[1]] = s.value
        if name == "pose":
            q = so3.quaternion_of(R_nw @ so3.matrix_of(s.value[:, 3:]) @ R_bm.T)
            z[:, :7] = np.hstack([s.value[:, :3] @ R_nw.T, q])
        for k, C in enumerate(C_nb):
            nav = nav_of(*np.zeros((2, 3)), C, *np.zeros((2, 3)))
            used[k] &= call_residual(int(o.residual), nav, np.zeros(6), z[k], r[k]) == 0
        residuals.append(r)
    grown = residuals[1] - residuals[0]
    grown = wrap(grown) if o.dim == 1 else grown
    assert used.mean() > 0.5  # (the others are skipped: body x is near the vertical)
    np.testing.assert_allclose(grown[used], shift[used], atol=1e-9)


def test_each_part_of_a_reference_reading_is_in_its_place() -> None:
    """What ``known_input`` writes is what effects read by the same names; nothing overlaps, and
    what every kind has in z is left alone."""
    widths = (6, 6, 6, 6, 6, 6, 1, 1, 6)
    parts = [np.arange(3.0)[:, None] + np.arange(w) + 100.0 * k for k, w in enumerate(widths)]
    z = _reference.ReferenceRows(*parts).joined()
    for first, part in zip(_reference.PLACES, parts, strict=True):
        np.testing.assert_array_equal(z[:, first : first + part.shape[1]], part)
    assert z.shape == (3, Z_DIM + sum(widths))
    assert max(DELAY, TIME, WARMTH) < NOW
    np.testing.assert_array_equal(z[:, :NOW], 0.0)
    with pytest.raises(ValueError, match="broadcast"):
        _reference.ReferenceRows(*parts[:-1], parts[-1][:, :5]).joined()

"""Laws that every effect of the catalogue obeys: one file runs them all."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from proved import proved
from scipy.spatial.transform import Rotation
from settled import solve
from worlds import injected, recording_of, true_levels

from handcal import calibrate
from handcal.compiled.jit import call_residual
from handcal.compiled.kernel import BASE, MAX_DIM
from handcal.earth import local_earth
from handcal.effects import (
    DELAY,
    TIME,
    Z_DIM,
    Effect,
    Param,
    Signals,
    catalogue,
    imu_jacobian,
    mag_hard_iron,
    select,
)
from handcal.estimate import smoother
from handcal.estimate.assemble import build
from handcal.estimate.corrected import substituted
from handcal.estimate.derivatives import relinearised
from handcal.estimate.linear import linearise_about
from handcal.estimate.observed import observed_of
from handcal.laws import grammar
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.vocabulary import driver_of
from handcal.observations import catalogue as observations
from handcal.signals import of_arrays, probe, units
from handcal.types import InputError, Series
from handcal_sim import simulate
from handcal_sim.effects import EFFECTS as SIMULATED
from handcal_sim.phone import (
    Clocking,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
    trusted_reference,
    with_rate,
)

NINE = "xx xy xz yx yy yz zx zy zz"
PRODUCTS = "x_xy x_yz x_xz y_xy y_yz y_xz z_xy z_yz z_xz"
# The contract's table: names, unit of each (or of all), prior of each (or of all).
CONTRACT = {
    "gyro_bias": ("x y z", "rad/s", math.radians(1.0)),
    "accel_bias": ("x y z", "m/s^2", 0.6),
    "gyro_scale": ("x y z", "1", 0.01),
    "accel_scale": ("x y z", "1", 0.01),
    "gyro_misalignment": ("xy xz yx yz zx zy", "rad", 0.01),
    "accel_misalignment": ("yx zx zy", "rad", 0.01),
    "gyro_g_sensitivity": (NINE, "(rad/s)/(m/s^2)", 1.8e-4),
    "gyro_quadratic": ("x y z", "s/rad", 0.005),
    "gyro_cross_products": (PRODUCTS, "s/rad", 0.005),
    "accel_cross_products": (PRODUCTS, "s^2/m", 4e-4),
    "accel_asymmetry": ("x y z", "1", 0.01),
    "lever_arm": ("x y z", "m", 0.1),
    "size_effect": (NINE, "m", 0.02),
    "gyro_temperature": ("x y z", "(rad/s)/K", 9e-4),
    "accel_temperature": ("x y z", "(m/s^2)/K", 0.01),
    "accel_delay": ("delay", "s", 0.02),
    "gyro_bandwidth": ("tau", "s", 0.02),
    "gyro_bias_walk": ("density", "(rad/s)/sqrt(s)", 1e-3),
    "accel_bias_walk": ("density", "(m/s^2)/sqrt(s)", 1e-3),
    "gyro_bias_step": ("x y z at", ("rad/s", "rad/s", "rad/s", "s"), None),
    "heading_hard_iron": ("sin cos", "rad", 0.2),
    "heading_soft_iron": ("sin cos", "rad", 0.15),
    "mag_hard_iron": ("x y z", "tesla", 1e-4),
    "mag_soft_iron": ("xx yy zz xy xz yz", "1", 0.1),
    "mag_gradient": ("xx yy xy xz yz", "tesla/m", 2e-5),
    "mag_step": ("x y z at", ("tesla", "tesla", "tesla", "s"), None),
    "heading_delay": ("delay", "s", 0.15),
    "pose_delay": ("delay", "s", 0.02),
    "pose_scale": ("scale", "1", 0.02),
    "pose_drift": ("position attitude", ("m/sqrt(s)", "rad/sqrt(s)"), (0.005, 5e-4)),
    "heading_drift": ("rate", "rad/s", 0.005),
    "heading_correlated_noise": ("sigma tau", ("rad", "s"), (0.15, 3.0)),
    "heading_outliers": ("fraction", "1", 0.1),
    "gravity": ("delta", "m/s^2", 0.02),
    "earth_rate": ("north up", "rad/s", 7.3e-5),
    "clock_rate": ("ppm", "1e-6", 100.0),
}
IDS = sorted(catalogue())
ACTING = [i for i in IDS if catalogue()[i].imu_error is not None]
MOMENTARY = [i for i in IDS if catalogue()[i].moments is not None]
NOISY = [i for i in IDS if catalogue()[i].process is not None]
STRAYING = [i for i in IDS if catalogue()[i].outliers]
OBSERVED = [(i, kind) for i in IDS for kind in catalogue()[i].observation_error]
LATE = [(i, kind) for i in IDS for kind in catalogue()[i].lateness]


def each(value, n):
    return list(value) if isinstance(value, tuple) else [value] * n


@pytest.mark.parametrize("name", IDS)
def test_declares_what_the_contract_promises(name):
    names, unit, prior = CONTRACT[name]
    effect, names = catalogue()[name], names.split()
    assert effect.id == name
    assert [p.name for p in effect.parameters] == names
    assert [p.unit for p in effect.parameters] == each(unit, len(names))
    if prior is not None:
        np.testing.assert_allclose(effect.prior_sigma, each(prior, len(names)), rtol=0.01)
    # the simulator, written apart, means the same by it
    assert [(p.name, p.unit) for p in SIMULATED[name]] == [
        (p.name, p.unit) for p in effect.parameters
    ]


@pytest.mark.parametrize("name", IDS)
def test_tells_its_story(name):
    """Plain sentences for the user; where it comes from; how to see it; how it was checked."""
    effect = catalogue()[name]
    for text in (effect.title, effect.story, effect.source, effect.motion, effect.validated):
        assert len(text.strip()) > 3
    assert effect.title[0].isupper()
    for sentence in (effect.story, effect.motion):
        assert sentence[0].isupper()
        assert sentence.endswith(".")


@pytest.mark.parametrize("name", IDS)
def test_acts_somewhere(name):
    """On the readings, or on observations that exist; a file without physics does nothing."""
    effect = catalogue()[name]
    known = observations()
    assert set(effect.observation_error) <= set(known)
    assert set(effect.outliers) <= set(known)
    assert set(effect.delays) <= set(effect.lateness) <= set(known)
    assert not set(effect.lateness) & set(effect.observation_error)
    if effect.process is not None:
        assert effect.walks in ("gyro", "accel") or effect.observation_error
        assert effect.imu_error is None
    else:
        assert effect.imu_error is not None or effect.acts_on or effect.outliers


def test_selection_keeps_order_drops_doubles_and_refuses_the_unknown():
    chosen = select(["lever_arm", "gyro_scale", "lever_arm"])
    assert [e.id for e in chosen] == ["lever_arm", "gyro_scale"]
    with pytest.raises(InputError, match="giro_scale"):
        select(["giro_scale"])


# --- effects on the readings ----------------------------------------------------------------------


def random_signals(seed, n=60):
    """Smooth rates and forces, any attitudes; a temperature that rises."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.01
    phase = rng.uniform(0, 6, (6, 1))
    x = (np.array([3, 3, 3, 9, 9, 9])[:, None] * np.sin(t * rng.uniform(2, 8, (6, 1)) + phase)).T
    C_nb = Rotation.random(n, random_state=rng).as_matrix()
    made = of_arrays(t, x[:, :3].copy(), x[:, 3:].copy(), 25.0 + 20.0 * t)
    return replace(made, C_nb=C_nb)


@pytest.mark.parametrize("name", ACTING)
def test_zero_parameters_change_no_reading(name):
    effect = catalogue()[name]
    error = effect.imu_error(np.zeros(len(effect.parameters)), random_signals(0))
    assert error.shape == (60, 6)
    assert np.all(error == 0.0)


@pytest.mark.parametrize("at", [0.0, 0.7])
@pytest.mark.parametrize("name", ACTING)
def test_jacobian_of_the_readings(name, at):
    """Against a fourth-order difference whose step is not the default's (a thousandth prior).

    At prior sizes effects are linear but for terms of their square: rel 1e-5.
    """
    effect = catalogue()[name]
    for seed in range(3):
        signals = random_signals(seed)
        point = at * effect.prior_sigma * np.random.default_rng(seed).uniform(0.5, 1, 1)
        if effect.moments is not None:
            point[-1] = 0.3
        got = imu_jacobian(effect, point, signals)
        # by a moment between samples there is no derivative but on average: see below
        for i, sigma in enumerate(effect.prior_sigma[: None if effect.moments is None else -1]):
            e = np.zeros(len(point))
            e[i] = 2.3e-4 * sigma

            def f(k, e=e, point=point, signals=signals):
                return effect.imu_error(point + k * e, signals)

            expected = (8 * (f(1) - f(-1)) - (f(2) - f(-2))) / (12 * e[i])
            size = np.abs(expected).max()
            assert size > 0
            # at the ends a delay or a low pass has no slope before or after: a kink at zero
            inner = slice(5, -5) if name in RAMPS else slice(None)
            np.testing.assert_allclose(got[inner, :, i], expected[inner], rtol=0, atol=1e-5 * size)


@pytest.mark.parametrize("name", MOMENTARY)
def test_moments_to_try(name):
    """About a second apart, not at the very ends, and nothing has happened there yet."""
    effect = catalogue()[name]
    for duration in (3.0, 30.0, 300.0):
        t = 7.0 + np.arange(0.0, duration, 0.01)
        points = effect.moments(t)
        at, n = points[:, -1], len(t)
        assert points.shape == (len(points), len(effect.parameters))
        assert 2 <= len(points) <= 64
        assert at[0] == pytest.approx(0.05 * duration, abs=0.01)
        assert at[-1] == pytest.approx(0.95 * duration, abs=0.01)
        if duration < 60.0:
            assert np.diff(at).max() < 1.5
        if effect.imu_error is not None:
            signals = Signals(t, np.ones((n, 3)), np.ones((n, 3)))
            assert np.all(effect.imu_error(points[0], signals) == 0.0)
        for kind in effect.observation_error:
            nav = nav_of(VELOCITY, NORTH, SPIN)
            assert np.all(corrected(name, kind, nav, points[0], READINGS[kind]) == 0.0)


@pytest.mark.parametrize("name", [i for i in MOMENTARY if i in ACTING])
def test_a_later_moment_takes_away_the_time_between(name):
    """By the moment: what the error would have added up to in between, wherever it falls."""
    effect = catalogue()[name]
    signals = replace(random_signals(0, 600), t=7.0 + 0.01 * np.arange(600))
    for at in (2.0, 2.003, 2.005, 2.009):
        point = np.r_[0.1 * np.arange(1, len(effect.parameters)), at]
        got = imu_jacobian(effect, point, signals)[:, :, -1]
        np.testing.assert_allclose(0.01 * got.sum(axis=0)[:3], -point[:-1], rtol=1e-9)
        assert np.all(got[(signals.t < 8.9) | (signals.t > 9.1)] == 0.0)


@pytest.mark.parametrize("name", [i for i in IDS if catalogue()[i].together is not None])
def test_together_only_what_the_other_lacks_is_left(name):
    """A projection; places that all three accelerometers share are the lever arm's, and iron that
    is the same along all axes is a stronger field."""
    P = catalogue()[name].together
    np.testing.assert_allclose(P @ P, P, atol=1e-15)
    np.testing.assert_allclose(P, P.T, atol=1e-15)
    others, common, rank = {
        "size_effect": (("lever_arm",), np.tile([0.1, 0.2, 0.3], 3), 6),
        "mag_soft_iron": ((), np.repeat([0.1, 0.0], 3), 5),
    }[name]
    assert catalogue()[name].exclusive == others
    np.testing.assert_allclose(P @ common, 0.0, atol=1e-15)
    assert np.linalg.matrix_rank(P) == rank


@pytest.mark.parametrize("name", ACTING)
def test_works_without_temperature_and_attitude(name):
    """A recording without a thermometer must not break any effect, nor the first pass."""
    effect = catalogue()[name]
    signals = replace(random_signals(0), streams={}, C_nb=None)
    error = effect.imu_error(effect.prior_sigma, signals)
    assert np.all(np.isfinite(error))
    if "temperature" in effect.needs:
        assert np.all(error == 0.0)


# By hand: rate (1, 2, 3) rad/s, force (4, -5, 6) m/s^2, 35 degC; parameters 0.1, 0.2, ...;
# body x up, y to the east, z to the north.
RATE, FORCE = np.array([1.0, 2.0, 3.0]), np.array([4.0, -5.0, 6.0])
X_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
BY_HAND = {
    "gyro_scale": [0.1, 0.4, 0.9, 0, 0, 0],
    "accel_scale": [0, 0, 0, 0.4, -1.0, 1.8],
    "gyro_bias": [0.1, 0.2, 0.3, 0, 0, 0],
    "accel_bias": [0, 0, 0, 0.1, 0.2, 0.3],
    # xy 0.1, xz 0.2, yx 0.3, yz 0.4, zx 0.5, zy 0.6
    "gyro_misalignment": [0.1 * 2 + 0.2 * 3, 0.3 + 0.4 * 3, 0.5 + 0.6 * 2, 0, 0, 0],
    # yx 0.1, zx 0.2, zy 0.3
    "accel_misalignment": [0, 0, 0, 0, 0.1 * 4, 0.2 * 4 - 0.3 * 5],
    "gyro_g_sensitivity": [0.4 - 1.0 + 1.8, 1.6 - 2.5 + 3.6, 2.8 - 4.0 + 5.4, 0, 0, 0],
    "gyro_quadratic": [0.1, 0.2 * 4, 0.3 * 9, 0, 0, 0],
    # products xy 2, yz 6, xz 3
    "gyro_cross_products": [
        0.2 + 1.2 + 0.9,
        0.8 + 3.0 + 1.8,
        1.4 + 4.8 + 2.7,
        0, 0, 0,
    ],
    # products xy -20, yz -30, xz 24
    "accel_cross_products": [
        0, 0, 0,
        -2.0 - 6.0 + 7.2,
        -8.0 - 15.0 + 14.4,
        -14.0 - 24.0 + 21.6,
    ],
    "accel_asymmetry": [0, 0, 0, 0.4, 1.0, 1.8],
    # omega x (omega x r) = omega (omega.r) - r 14 at rows (.1 .2 .3), (.4 .5 .6), (.7 .8 .9)
    "size_effect": [0, 0, 0, 1.4 - 1.4, 2 * 3.2 - 7.0, 3 * 5.0 - 12.6],
    "gyro_temperature": [1.0, 2.0, 3.0, 0, 0, 0],
    "accel_temperature": [0, 0, 0, 1.0, 2.0, 3.0],
    "gravity": [0, 0, 0, 0.1, 0, 0],
    # 0.1 to the north, 0.2 up
    "earth_rate": [0.2, 0, 0.1, 0, 0, 0],
    # 1e-7 of the rate, 2e-7 of the force but for gravity
    "clock_rate": [1e-7, 2e-7, 3e-7, 2e-7 * (4.0 - 9.80665), -1e-6, 1.2e-6],
    # seen at 2 s: long after 0.4 s
    "gyro_bias_step": [0.1, 0.2, 0.3, 0, 0, 0],
}  # fmt: skip
# Of the moment, not of constant signals: f(t) = f0 + 2 t (1, 2, 3), delay 0.1 s reads 0.2 (1, 2, 3)
# less; a low pass of 0.1 s lags a ramp by just that.
RAMPS = {"accel_delay": ("accel", -0.2), "gyro_bandwidth": ("gyro", -0.2)}


@pytest.mark.parametrize("name", ACTING)
def test_units_and_signs_of_the_readings_by_hand(name):
    effect = catalogue()[name]
    parameters = 0.1 * np.arange(1, len(effect.parameters) + 1)
    n = 400
    t = np.arange(n) * 0.01
    still = np.ones((n, 1))
    if name in RAMPS:
        which, error = RAMPS[name]
        ramp = 2.0 * t[:, None] * np.array([1.0, 2.0, 3.0])
        gyro, accel = (ramp, still * FORCE) if which == "gyro" else (still * RATE, ramp)
        # in the middle, where no edge is felt (a low pass settles as exp(-20))
        got = effect.imu_error(parameters, Signals(t, gyro, accel))[n // 2]
        expected = np.zeros(6)
        expected[slice(0, 3) if which == "gyro" else slice(3, 6)] = error * np.array([1, 2, 3])
    else:
        attitude = np.tile(X_UP, (n, 1, 1))
        made = of_arrays(t, still * RATE, still * FORCE, 35.0 * np.ones(n))
        signals = replace(made, C_nb=attitude)
        got = effect.imu_error(parameters, signals)[n // 2]
        expected = BY_HAND[name]
    np.testing.assert_allclose(got, expected, atol=1e-6 if name in RAMPS else 1e-12)


def test_a_step_begins_at_its_moment_after_the_first_sample():
    t = 100.0 + np.arange(400) * 0.01
    error = catalogue()["gyro_bias_step"].imu_error(
        np.array([0.1, 0.2, 0.3, 2.0]), Signals(t, np.zeros((400, 3)), np.zeros((400, 3)))
    )
    assert np.all(error[:199] == 0.0)
    np.testing.assert_allclose(error[201:, :3], np.tile([0.1, 0.2, 0.3], (199, 1)))


@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_size_effect_is_that_of_a_place_on_the_body(rate):
    """Against the acceleration of the places themselves, differenced twice from a known turn."""
    t = np.arange(0.0, 3.0, 1.0 / rate)
    axis, w = np.array([2.0, -1.0, 2.0]) / 3.0, 5.0
    places = np.array([[0.01, 0.02, -0.03], [0.02, -0.01, 0.01], [-0.02, 0.03, 0.02]])

    def at(s):
        return Rotation.from_rotvec(np.outer(np.sin(w * s), axis)).as_matrix()

    e = 1e-4
    second = (at(t + e) - 2 * at(t) + at(t - e)) / e**2
    body = np.einsum("nji,njk,pk->npi", at(t), second, places)
    gyro = np.outer(w * np.cos(w * t), axis)
    signals = Signals(t, gyro, np.zeros_like(gyro))
    got = catalogue()["size_effect"].imu_error(places.ravel(), signals)[:, 3:]
    expected = np.stack([body[:, i, i] for i in range(3)], axis=1)
    # a fourth-order difference at 0.05 rad a sample
    np.testing.assert_allclose(got[5:-5], expected[5:-5], atol=1e-4)


@pytest.mark.parametrize("rate", [100.0, 400.0])
@pytest.mark.parametrize("tau", [0.003, 0.02, 0.3])
def test_bandwidth_is_that_of_the_exact_filter_and_its_inverse(tau, rate):
    """A low-passed sine, known in closed form, at irregular times."""
    rng = np.random.default_rng(0)
    t = np.sort(np.arange(0.0, 8.0, 1.0 / rate) + rng.normal(0, 1e-4, int(8 * rate)))
    w = 2 * np.pi * 1.5
    true = np.sin(w * t[:, None] + np.arange(3))
    lag = np.imag(np.exp(1j * (w * t[:, None] + np.arange(3))) / (1 + 1j * w * tau))
    still = np.zeros_like(true)
    effect, point = catalogue()["gyro_bandwidth"], np.array([tau])
    # what was before the start is forgotten as exp(-t / tau)
    settled = (t > 15 * tau + 0.05) & (t < 7.9)
    error = effect.imu_error(point, Signals(t, true, still))[:, :3]
    np.testing.assert_allclose(error[settled], (lag - true)[settled], atol=2e-3)
    inverse = effect.imu_inverse(point, Signals(t, lag, still))[:, :3]
    # to first order in how irregular the times are
    np.testing.assert_allclose(inverse[5:-5], true[5:-5], atol=1e-3 + 0.02 * tau)


# --- what is taken off ---------------------------------------------------------------------------

IMU_EFFECTS = [e for e in catalogue().values() if e.imu_error is not None and not e.moments]


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("effect", IMU_EFFECTS, ids=lambda e: e.id)
def test_what_is_taken_off_changes_as_the_jacobian_says(effect, share):
    """About errors of no size and of the usual one. To first order in the errors: a twentieth.

    (The Jacobian of what an effect adds, instead of what is taken off, once held a large delay
    of the accelerometer back at a tenth of its size.)
    """
    world = simulate("free-hand", seed=0, duration_s=20.0)
    recording = recording_of(world)
    imu = replace(recording.imu, gyro=world.truth.omega, accel=world.truth.f)
    recording = replace(recording, imu=imu)
    if "temperature" in effect.needs:
        t = recording.imu.t
        recording = replace(recording, streams={"temperature": Series(t, 20.0 + t[:, None])})
    problem = build(recording, [effect], [], *local_earth(None, 0.0), linearised=False)
    C_nb = world.truth.C_nb
    rng, size = np.random.default_rng(0), effect.prior_sigma
    at = share * size * (1.0 if effect.parameters[0].positive else rng.choice([-1, 1], len(size)))
    step = 0.02 * size * rng.uniform(0.5, 1.0, len(size))
    zero = np.zeros(3)
    here = relinearised(problem, at, zero, zero, C_nb)
    less, more = (relinearised(problem, at + x, zero, zero, C_nb) for x in (-step, step))
    changed = np.hstack([more.nodes.gyro - less.nodes.gyro, more.nodes.accel - less.nodes.accel])
    said = -2.0 * here.nodes.J @ step
    inner = slice(50, -50)
    miss, whole = (np.sqrt(np.mean(x[inner] ** 2)) for x in (changed - said, changed))
    assert whole > 0.0
    assert miss < 0.05 * whole


# --- effects on the observations ------------------------------------------------------------------


def corrected(name, kind, nav, parameters, z, taken_off=0.0):
    """What the effect adds to a residual of ones, 40 s after the start."""
    r = np.ones(MAX_DIM)
    z = np.r_[np.asarray(z, dtype=float), np.zeros(max(0, Z_DIM - len(z)))]
    z[DELAY], z[TIME] = taken_off, 40.0
    address = catalogue()[name].observation_error[kind]
    assert call_residual(address, nav, np.asarray(parameters, dtype=float), z, r) == 0
    return r - 1.0


def nav_of(v, C, w):
    return np.concatenate([np.zeros(3), v, np.ravel(C), w, [0, 0, 9.8]]).astype(float)


# Of a reference: rate and force that grow evenly, and the force's y by CUBE t^3 besides; now,
# and 8 ms earlier and later.
CUBE, GROWTH = 1e4, np.array([3, -1, 2, 10, 20, 30])
BENT = np.array([0, 0, 0, 0, 1, 0])
REFERENCE = [
    *np.zeros(Z_DIM), *np.zeros(6), *GROWTH,
    *(-0.008 * GROWTH - CUBE * 0.008**3 * BENT), *(0.008 * GROWTH + CUBE * 0.008**3 * BENT),
    *(GROWTH + 3 * CUBE * 0.008**2 * BENT), *(GROWTH + 3 * CUBE * 0.008**2 * BENT), 0.008,
    3, -1, 2,
]  # fmt: skip
READINGS = {"magnetometer": [1e-5, 2e-5, -4e-5, 0, 0, 0, 2e-5, -4e-5], "known_input": REFERENCE}


@pytest.mark.parametrize(("name", "kind"), OBSERVED)
def test_zero_parameters_change_no_residual(name, kind):
    effect = catalogue()[name]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        nav = nav_of(rng.normal(0, 1, 3), Rotation.random(random_state=rng).as_matrix(), RATE)
        zero = np.zeros(len(effect.parameters) if effect.process is None else effect.process.size)
        assert np.all(corrected(name, kind, nav, zero, READINGS.get(kind, [0.3])) == 0.0)


# Yaw 90 degrees: body x to the north, body y to the west. Observed minus predicted: the
# prediction grows by the error that the effect makes, so the residual falls by it.
NORTH = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
VELOCITY, SPIN = [1.0, 2.0, 3.0], [0.0, 0.0, 0.5]
OBSERVED_BY_HAND = {
    # noise: what the Markov state holds is in the reading
    ("heading_correlated_noise", "heading"): ([0.1], [-0.1]),
    # after 40 s
    ("heading_drift", "heading"): ([0.01], [-0.4]),
    # north has turned to the east, which is -y of the body; north itself is x
    ("heading_drift", "magnetometer"): (
        [0.01],
        [2e-5 * (1.0 - math.cos(0.4)), 2e-5 * math.sin(0.4), 0.0],
    ),
    # 0.1 sin(90 deg) + 0.2 cos(90 deg); 0.1 sin(180 deg) + 0.2 cos(180 deg)
    ("heading_hard_iron", "heading"): ([0.1, 0.2], [-0.1]),
    ("heading_soft_iron", "heading"): ([0.1, 0.2], [0.2]),
    # of a field of (20, 0, -40) uT in the body
    ("mag_soft_iron", "magnetometer"): ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [1.8e-5, 1.6e-5, 2e-6]),
    # What the device shows is of 4 ms before: slopes (3, -1, 2, 10, 20, 30), and the third power
    # of the time along y of the force.
    ("clock_rate", "known_input"): (
        [100.0],
        [-0.012, 0.004, -0.008, -0.04, -0.08 - CUBE * 0.004**3, -0.12],
    ),
    # IMU at (0.1, 0.2, 0.3) of the body: in n at (-0.2, 0.1, 0.3) from the point held, whose
    # place is that of the IMU less this arm.
    ("lever_arm", "fixed_position"): ([0.1, 0.2, 0.3], [-0.2, 0.1, 0.3]),
    ("lever_arm", "pose"): ([0.1, 0.2, 0.3], [-0.2, 0.1, 0.3, 0, 0, 0]),
    # What the reference lacks: 0.5 z x (0.5 z x r) = -0.25 (0.1, 0.2, 0), and (3, -1, 2) x r.
    ("lever_arm", "known_input"): (
        [0.1, 0.2, 0.3],
        [0, 0, 0, -0.7 - 0.025, -0.7 - 0.05, 0.7],
    ),
    # its velocity is 0.5 z x (-0.2, 0.1) = (-0.05, -0.1) more than that of the point
    ("lever_arm", "zero_velocity"): ([0.1, 0.2, 0.3], [-0.05, -0.1, 0.0]),
    ("mag_hard_iron", "magnetometer"): ([1e-5, 2e-5, -3e-5], [-1e-5, -2e-5, 3e-5]),
    # 39 s after the start; it is 40 s
    ("mag_step", "magnetometer"): ([1e-5, 2e-5, -3e-5, 39.0], [-1e-5, -2e-5, 3e-5]),
    # (the device is at the origin, see below)
    ("mag_gradient", "magnetometer"): ([0.1, 0.2, 0.3, 0.4, 0.5], [0.0] * 3),
    # (the device is at the origin, see below)
    ("pose_scale", "pose"): ([0.1], [0.0] * 6),
    ("pose_drift", "pose"): ([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], [-1.0, -2.0, -3.0, -0.1, -0.2, -0.3]),
}


def test_the_world_of_a_pose_grows_and_turns_about_its_origin():
    """At (2, 0, 0) m: metres too long by a tenth read 0.2 m more; a world that turned by 0.1 rad
    about up reads 0.2 m more along y."""
    nav = nav_of(VELOCITY, NORTH, SPIN)
    nav[0] = 2.0
    grown = corrected("pose_scale", "pose", nav, [0.1], [0])
    turned = corrected("pose_drift", "pose", nav, [0, 0, 0, 0, 0, 0.1], [0])
    np.testing.assert_allclose(grown[:6], [-0.2, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turned[:6], [0, -0.2, 0, 0, 0, -0.1], atol=1e-12)


def test_a_step_of_the_readings_begins_at_its_moment():
    nav, values = nav_of(VELOCITY, NORTH, SPIN), [1e-5, 2e-5, -3e-5]
    for at, there in ((39.99, True), (40.0, True), (40.01, False)):
        got = corrected("mag_step", "magnetometer", nav, [*values, at], READINGS["magnetometer"])
        np.testing.assert_array_equal(got[:3] != 0.0, there)


def test_the_field_changes_with_the_place():
    """At (1, 2, 3) m: 1.9 uT more to the east, 2.2 to the north and 0.5 up, where body x points
    north and y west. Soft iron draws the field as it is there, once the change is believed."""
    nav = nav_of(VELOCITY, NORTH, SPIN)
    nav[:3] = 1.0, 2.0, 3.0
    G = np.array([1e-7, 2e-7, 3e-7, 4e-7, 5e-7])
    effect, z = catalogue()["mag_gradient"], np.zeros((1, Z_DIM))
    z[0, : len(READINGS["magnetometer"])] = READINGS["magnetometer"]
    got = corrected("mag_gradient", "magnetometer", nav, G, z[0])
    np.testing.assert_allclose(got[:3], [-2.2e-6, 1.9e-6, -0.5e-6], atol=1e-18)
    z = effect.believed["magnetometer"](z, G)
    got = corrected("mag_soft_iron", "magnetometer", nav, [0.1, 0.2, 0.3, 0.0, 0.0, 0.0], z[0])
    np.testing.assert_allclose(got[:3], [-2.22e-6, 0.38e-6, 11.85e-6], atol=1e-18)


@pytest.mark.parametrize(("name", "kind"), OBSERVED)
def test_units_and_signs_of_the_residuals_by_hand(name, kind):
    parameters, expected = OBSERVED_BY_HAND[name, kind]
    got = corrected(name, kind, nav_of(VELOCITY, NORTH, SPIN), parameters, READINGS.get(kind, [0]))
    full = np.zeros(MAX_DIM)
    full[: len(expected)] = expected
    np.testing.assert_allclose(got, full, atol=1e-15)


# By how many seconds readings come late that were taken 40 s after the start.
LATE_BY_HAND = {
    # a clock that is 100 ppm fast is 4 ms ahead by then: the pose at that stamp is still to come
    ("clock_rate", "pose"): (100.0, -0.004),
    ("heading_delay", "heading"): (0.2, 0.2),
    ("heading_delay", "magnetometer"): (0.2, 0.2),
    ("pose_delay", "pose"): (0.2, 0.2),
}


def lateness(name, kind, parameter, taken_off=0.0):
    """Seconds that the effect adds, at 40 s; the first number of what it writes, and no other."""
    out, z = np.zeros(MAX_DIM), np.zeros(Z_DIM)
    z[DELAY], z[TIME] = taken_off, 40.0
    nav = nav_of(VELOCITY, NORTH, SPIN)
    address = catalogue()[name].lateness[kind]
    assert call_residual(address, nav, np.array([parameter]), z, out) == 0
    assert not out[1:].any()
    return out[0]


@pytest.mark.parametrize(("name", "kind"), LATE)
def test_by_how_much_readings_are_late(name, kind):
    parameter, expected = LATE_BY_HAND[name, kind]
    assert lateness(name, kind, parameter) == pytest.approx(expected, rel=1e-12)
    assert lateness(name, kind, 0.0) == 0.0


@pytest.mark.parametrize(("name", "kind"), [x for x in LATE if x[1] in catalogue()[x[0]].delays])
def test_a_delay_already_taken_off_counts_no_more(name, kind):
    """Observations moved to 0.3 s before their stamps: what is left of 0.32 s is 0.02 s."""
    assert lateness(name, kind, 0.32, taken_off=0.3) == pytest.approx(0.02, abs=1e-15)


# --- effects that are noise -----------------------------------------------------------------------


@pytest.mark.parametrize("name", NOISY)
def test_levels_of_noise_are_its_parameters(name):
    """A level of the parameter's name behind the id, first guessed below the prior."""
    effect = catalogue()[name]
    assert [lv.name for lv in effect.levels] == [f"{name}_{p.name}" for p in effect.parameters]
    for level, parameter in zip(effect.levels, effect.parameters, strict=True):
        assert parameter.positive
        assert level.unit == parameter.unit
        prior = parameter.prior_sigma
        assert level.lower < 0.1 * prior < level.initial < prior < 3.0 * prior < level.upper


@pytest.mark.parametrize("name", NOISY)
def test_noise_does_not_care_where_the_steps_are(name):
    """Two steps are one of both lengths; none is none; at rest and in motion alike."""
    effect = catalogue()[name]
    levels = {lv.name: 2.0 * lv.initial for lv in effect.levels}
    dt, rate = np.array([0.3, 0.9, 1.2, 0.0]), np.array([0.0, 5.0, 1.0, 1.0])
    Phi, Q = effect.process.transition(levels, dt, rate)
    assert Phi.shape == Q.shape == (4, effect.process.size, effect.process.size)
    np.testing.assert_allclose(Phi[1] @ Phi[0], Phi[2], rtol=1e-12)
    np.testing.assert_allclose(Phi[1] @ Q[0] @ Phi[1].T + Q[1], Q[2], rtol=1e-12)
    np.testing.assert_array_equal(Phi[3], np.eye(effect.process.size))
    assert np.all(Q[3] == 0.0)
    # the sensors' axes, or those of n
    assert effect.process.vectors == (2 if name == "pose_drift" else 0)


# Levels, and by hand after 4 s: Phi, Q and the covariance at the start, each times the identity.
NOISE_BY_HAND = {
    "gyro_bias_walk": ([0.1], 1.0, 0.04, 0.0),
    "accel_bias_walk": ([0.1], 1.0, 0.04, 0.0),
    "heading_correlated_noise": ([0.2, 2.0], math.exp(-2), 0.04 * (1 - math.exp(-4)), 0.04),
    "pose_drift": ([0.1, 0.2], 1.0, np.repeat([0.04, 0.16], 3), 0.0),
}


@pytest.mark.parametrize("name", NOISY)
def test_units_of_noise_by_hand(name):
    effect = catalogue()[name]
    values, Phi, Q, start = NOISE_BY_HAND[name]
    levels = {lv.name: v for lv, v in zip(effect.levels, values, strict=True)}
    eye = np.eye(effect.process.size)
    got = effect.process.transition(levels, np.array([4.0]), np.array([1.0]))
    np.testing.assert_allclose(got[0][0], Phi * eye, rtol=1e-12)
    np.testing.assert_allclose(got[1][0], Q * eye, rtol=1e-12)
    np.testing.assert_allclose(effect.process.start(levels, 1.0), start * eye, rtol=1e-12)


@pytest.mark.parametrize("name", STRAYING)
def test_wrong_readings_have_a_density_of_one_and_no_other_physics(name):
    """A heading that is merely wrong lies somewhere on the circle, a field in a cube."""
    effect = catalogue()[name]
    assert not effect.observation_error
    assert effect.imu_error is None
    volume = {"rad": 2 * math.pi, "tesla": 1e-4**3}
    for kind, density in effect.outliers.items():
        assert density * volume[observations()[kind].unit] == pytest.approx(1.0)
    assert effect.parameters[0].unit == "1"


# --- what the simulator injects comes back --------------------------------------------------------


def with_pose(rng):
    return replace(consumer_phone(rng), heading=None, pose=capture_pose(rng))


def with_magnetometer(rng):
    return replace(consumer_phone(rng), heading=None, mag=consumer_magnetometer(rng))


def with_reference(rng):
    return replace(consumer_phone(rng), heading=None, reference=trusted_reference(rng))


def good_heading(rng):
    """A heading of half a degree (a camera's), so that a short recording tells enough."""
    phone = with_rate(consumer_phone(rng), 50.0)
    clocking = Clocking(50.0, phone.heading.clocking.phase_s)
    return replace(
        phone, heading=replace(phone.heading, sigma=math.radians(0.5), clocking=clocking)
    )


def with_thermometer(rng):
    phone = good_heading(rng)
    return replace(phone, thermometer=replace(phone.thermometer, reported=True))


def fast_with_pose(rng):
    return with_rate(with_pose(rng), 400.0)


def quiet_gyro(rng):
    """A tenth of a phone's noise, or a minute would not show the turning of the Earth."""
    phone = good_heading(rng)
    return replace(phone, gyro=replace(phone.gyro, noise=0.1 * phone.gyro.noise, quantum=0.0))


# id, motion, phone, stream, size in priors
TRIALS = [
    ("gyro_scale", "three-turns", good_heading, "heading", 1.0),
    ("gyro_misalignment", "free-hand", good_heading, "heading", 1.0),
    ("accel_scale", "free-hand", good_heading, "heading", 1.0),
    ("accel_misalignment", "free-hand", good_heading, "heading", 1.0),
    *proved(("accel_delay", "free-hand", good_heading, "heading", 0.2)),
    ("accel_delay", "free-hand", good_heading, "heading", 1.0),
    *proved(("heading_delay", "free-hand", good_heading, "heading", 0.15)),
    ("heading_delay", "free-hand", good_heading, "heading", 1.0),
    *proved(("heading_delay", "free-hand", with_magnetometer, "mag", 0.15)),
    ("lever_arm", "free-hand", good_heading, "heading", 1.0),
    *proved(("lever_arm", "free-hand", with_pose, "pose", 1.0)),
    *proved(("lever_arm", "free-hand", with_reference, "reference", 1.0)),
    *proved(("clock_rate", "free-hand", with_reference, "reference", 1.0)),
    *proved(("clock_rate", "free-hand", with_reference, "reference", 3.0)),
    *proved(("gyro_misalignment", "free-hand", with_reference, "reference", 1.0)),
    ("pose_delay", "free-hand", with_pose, "pose", 1.0),
    ("pose_scale", "free-hand", with_pose, "pose", 1.0),
    *proved(("mag_hard_iron", "free-hand", with_magnetometer, "mag", 0.1)),
    ("mag_hard_iron", "free-hand", with_magnetometer, "mag", 1.0),
    *proved(("mag_hard_iron", "free-hand", with_magnetometer, "mag", 3.0)),
    ("gyro_g_sensitivity", "free-hand", good_heading, "heading", 1.0),
    ("gyro_quadratic", "free-hand", good_heading, "heading", 1.0),
    ("gyro_cross_products", "free-hand", good_heading, "heading", 1.0),
    ("accel_cross_products", "free-hand", good_heading, "heading", 1.0),
    *proved(("accel_cross_products", "free-hand", with_pose, "pose", 1.0)),
    ("accel_asymmetry", "free-hand", good_heading, "heading", 1.0),
    ("size_effect", "free-hand", good_heading, "heading", 1.0),
    *proved(("size_effect", "free-hand", with_pose, "pose", 1.0)),
    ("gyro_temperature", "free-hand", with_thermometer, "heading temperature", 1.0),
    ("accel_temperature", "free-hand", with_thermometer, "heading temperature", 1.0),
    *proved(("gyro_bandwidth", "free-hand", good_heading, "heading", 0.2)),
    ("gyro_bandwidth", "free-hand", good_heading, "heading", 1.0),
    *proved(("gyro_bandwidth", "free-hand", fast_with_pose, "pose", 10.0)),
    ("gravity", "free-hand", good_heading, "heading", 1.0),
    ("earth_rate", "free-hand", quiet_gyro, "heading", 1.0),
    ("clock_rate", "free-hand", with_pose, "pose", 1.0),
    *proved(("clock_rate", "free-hand", with_pose, "pose", 10.0)),
    ("heading_hard_iron", "free-hand", good_heading, "heading", 1.0),
    ("heading_soft_iron", "free-hand", good_heading, "heading", 1.0),
    *proved(("mag_soft_iron", "free-hand", with_magnetometer, "mag", 0.3)),
    ("mag_soft_iron", "free-hand", with_magnetometer, "mag", 1.0),
    ("heading_drift", "free-hand", good_heading, "heading", 1.0),
    *proved(("heading_drift", "free-hand", with_magnetometer, "mag", 1.0)),
]
SEEDS = (0, *proved(1))
LONGER = {"earth_rate": 84.0}
# id, levels, how many times too large or too small each may be found: 84 s hold some twenty
# independent moments of noise that is remembered for 3 s, or of a walk
NOISE_TRIALS = [
    ("gyro_bias_walk", [1e-3], [1.5]),
    *proved(("accel_bias_walk", [1e-2], [1.5])),
    *proved(("heading_correlated_noise", [0.05, 3.0], [1.5, 2.0])),
]


def test_every_effect_is_on_trial():
    tried = {getattr(trial, "values", trial)[0] for trial in TRIALS}
    tried |= {getattr(t, "values", t)[0] for t in NOISE_TRIALS} | set(STRAYING) | set(MOMENTARY)
    tried |= {"pose_drift", "mag_gradient"}
    assert tried == {i for i in IDS if not catalogue()[i].baseline}


def as_seen(world, name, truth):
    """With the yaw counted from the heading's own north: its constant offset.

    Nothing else tells n's yaw, so sin and cos of an iron are those of yaw + offset. A soft iron
    that is the same along all axes is a stronger field.
    """
    if name == "mag_soft_iron":
        more = truth[:3].mean()
        return (truth - np.repeat([more, 0.0], 3)) / (1.0 + more)
    if name not in ("heading_hard_iron", "heading_soft_iron"):
        return truth
    turn = world.parameters["phone"]["heading_errors"]["offset"]
    turn *= 2 if name == "heading_soft_iron" else 1
    sin, cos = truth
    return np.array(
        [
            sin * math.cos(turn) + cos * math.sin(turn),
            cos * math.cos(turn) - sin * math.sin(turn),
        ]
    )


def trial(name, motion, phone, stream, priors, seed):
    """Truth, recording, noise levels and how many sigmas it may be off: 4, of which the chance of
    a false alarm is 6e-5 for each of some 60 parameters."""
    effect = catalogue()[name]
    rng = np.random.default_rng(1000 + seed)
    size = priors * effect.prior_sigma * rng.uniform(0.7, 1.3, len(effect.parameters))
    truth = size * rng.choice([-1, 1], len(size))
    truth = np.where([p.positive for p in effect.parameters], np.abs(truth), truth)
    duration = LONGER.get(name, 32.0)
    world = simulate(motion, seed=seed, phone=phone, duration_s=duration, effects={name: truth})
    np.testing.assert_allclose(injected(world, name), truth)
    # A turning hand's sway is not quite the process that it is taken for, and an arm shows it: six
    # seeds scattered by 1.3 sigma, 1.7 at the true levels (explain widens an arm's sigmas).
    swung = name in ("lever_arm", "size_effect") and stream == "heading"
    levels, most = ({}, 6.0) if swung else (true_levels(world), 4.0)
    return as_seen(world, name, truth), recording_of(world, *stream.split()), levels, most


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "motion", "phone", "stream", "priors"), TRIALS)
def test_what_the_simulator_injects_comes_back(name, motion, phone, stream, priors, seed):
    """Within its own sigmas, which are sharper than the prior."""
    truth, recording, levels, most = trial(name, motion, phone, stream, priors, seed)
    found = calibrate(recording, [name], assume="fixed-point", noise=levels, only=True)
    for parameter, value in zip(catalogue()[name].parameters, truth, strict=True):
        got = found.parameter(name, parameter.name)
        assert got.unit == parameter.unit
        assert abs(got.value - value) < most * got.sigma, (parameter.name, got, value)
        assert got.sigma < parameter.prior_sigma
        assert got.shown


@pytest.mark.prove
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "motion", "phone", "stream", "priors"), TRIALS)
def test_beside_all_else_that_a_device_has_it_is_as_far_off_as_is_said(
    name, motion, phone, stream, priors, seed
):
    if not catalogue()[name].common:
        pytest.skip("no error that every device has")
    truth, recording, levels, most = trial(name, motion, phone, stream, priors, seed)
    alone = calibrate(recording, [name], assume="fixed-point", noise=levels, only=True)
    beside = calibrate(recording, assume="fixed-point", noise=levels)
    for parameter, value in zip(catalogue()[name].parameters, truth, strict=True):
        got = beside.parameter(name, parameter.name)
        assert abs(got.value - value) < most * got.sigma, (parameter.name, got, value)
        assert got.sigma > alone.parameter(name, parameter.name).sigma * 0.9


@pytest.mark.prove
@pytest.mark.parametrize("seed", SEEDS)
def test_a_field_that_changes_with_place_comes_back(seed):
    """Shown by the arm at whose end the device is, which is unknown too."""
    rng = np.random.default_rng(1000 + seed)
    truth = {
        "lever_arm": 0.1 * rng.choice([-1, 1], 3) * rng.uniform(0.7, 1.3, 3),
        "mag_gradient": 2e-5 * rng.choice([-1, 1], 5) * rng.uniform(0.7, 1.3, 5),
    }
    world = simulate(
        "free-hand", seed=seed, phone=with_magnetometer, duration_s=32.0, effects=truth
    )
    found = calibrate(recording_of(world, "mag"), [*truth], assume="fixed-point")
    for parameter, value in zip(
        catalogue()["mag_gradient"].parameters, truth["mag_gradient"], strict=True
    ):
        got = found.parameter("mag_gradient", parameter.name)
        assert abs(got.value - value) < 4.0 * got.sigma, (parameter.name, got, value)
        assert got.sigma < 0.2 * parameter.prior_sigma


@pytest.mark.parametrize("seed", [0, *proved(1, 2, 3)])
def test_a_step_comes_back_from_the_best_of_its_moments(seed):
    """About each moment in turn, as explain does; then settled about the best of them."""
    name, rng = "gyro_bias_step", np.random.default_rng(1000 + seed)
    truth = np.r_[0.01 * rng.choice([-1, 1], 3) * rng.uniform(0.7, 1.3, 3), rng.uniform(6, 26)]
    world = simulate(
        "free-hand", seed=seed, phone=good_heading, duration_s=32.0, effects={name: truth}
    )
    effect, recording = catalogue()[name], recording_of(world, "heading")
    kinds, levels = ["fixed_position", "heading"], true_levels(world)
    observed, start = observed_of(recording, kinds, np.zeros((0, 2)), local_earth(None), None)
    problem = build(recording, [effect], observed, *local_earth(None))
    nominal = solve(problem, start, levels).linear.trajectory
    tried = []
    for point in effect.moments(recording.imu.t):
        constants = np.r_[point, nominal.constants[len(point) :]]
        linear = linearise_about(problem, start, replace(nominal, constants=constants))
        tried.append((smoother.smoothed_mean(linear, levels)[1], len(tried), linear))
    # As long as there is no step nothing tells its moment, which would fall back to its prior:
    # first the step, the moment held.
    best = max(tried)[2]
    there = smoother.moved(best.trajectory, smoother.smoothed_mean(best, levels)[0])
    there.constants[3] = best.trajectory.constants[3]
    linear, settled, _ = smoother.relinearise(linearise_about(problem, start, there), levels)
    assert settled
    forward = smoother.forward(linear, levels)
    got = linear.trajectory.constants[:4] + forward.x[-1, BASE : BASE + 4]
    sigma = np.sqrt(np.diag(forward.P[-1])[BASE : BASE + 4])
    assert np.all(np.abs(got - truth) < 4 * sigma), (got, truth, sigma)
    assert np.all(sigma < 0.5 * effect.prior_sigma)


# id, phone, stream, kind, true delay, delay that is taken off
LARGE_DELAYS = [
    ("heading_delay", good_heading, "heading", "heading", 0.3, 0.28),
    ("heading_delay", good_heading, "heading", "heading", -0.3, -0.31),
    ("heading_delay", with_magnetometer, "mag", "magnetometer", 0.3, 0.28),
    ("pose_delay", with_pose, "pose", "pose", 0.3, 0.298),
]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "phone", "stream", "kind", "truth", "shift"), LARGE_DELAYS)
def test_a_large_delay_comes_back_about_a_shifted_time(
    name, phone, stream, kind, truth, shift, seed
):
    world = simulate("free-hand", seed=seed, phone=phone, duration_s=32.0, effects={name: [truth]})
    recording, earth, rests = recording_of(world, stream), local_earth(None), np.zeros((0, 2))
    kinds = [kind] if kind == "pose" else ["fixed_position", kind]
    observed, start = observed_of(recording, kinds, rests, earth, None)
    observed = [
        (o, replace(rows, delay=shift if o.kind == kind else 0.0), constants)
        for o, rows, constants in observed
    ]
    problem = build(recording, select([name]), observed, *earth)
    solution = solve(problem, start, true_levels(world))
    got = solution.linear.trajectory.constants[0]
    P = solution.forward.P[-1]
    assert abs(got - truth) < 4 * math.sqrt(P[BASE, BASE]), (got, math.sqrt(P[BASE, BASE]))


def noisy_world(seed, effects, seconds=84.0):
    world = simulate(
        "free-hand", seed=seed, phone=good_heading, duration_s=seconds, effects=effects
    )
    return world, recording_of(world, "heading")


@pytest.mark.prove
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "truth", "factors"), NOISE_TRIALS)
def test_noise_that_the_simulator_injects_comes_back(name, truth, factors, seed):
    """Its levels, all others unknown too; and of a bias that walks its mean."""
    effect = catalogue()[name]
    world, recording = noisy_world(seed, {name: truth})
    np.testing.assert_allclose(injected(world, name), truth)
    found = calibrate(recording, [name], assume="fixed-point", only=True)
    levels = {n.name: n for n in found.noise}
    for parameter, value, factor in zip(effect.parameters, truth, factors, strict=True):
        level = levels[f"{name}_{parameter.name}"]
        assert level.estimated
        assert level.unit == parameter.unit
        assert value / factor < level.value < value * factor
    # noise has no constants
    assert {p.effect for p in found.parameters} == {"gyro_bias", "accel_bias"}
    assert found.covariance.shape == (6, 6)
    sigma = [p.sigma for p in found.parameters]
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigma, rtol=1e-9)
    walk = world.parameters["mean_walk"]
    for i, axis in enumerate("xyz"):
        for sensor in ("gyro", "accel"):
            got = found.parameter(f"{sensor}_bias", axis)
            true = injected(world, f"{sensor}_bias")[i] + walk[sensor][i]
            # with the hand's sway unknown, sigmas of the accelerometer's biases are a bit small
            assert abs(got.value - true) < 5 * got.sigma, (got, true)


@pytest.mark.prove
@pytest.mark.parametrize("seed", SEEDS)
def test_a_world_that_wanders_comes_back(seed):
    """Both densities, beside motion capture's own noise; evidence knows it from a still one."""
    truth = {"pose_drift": [5e-3, 2e-3]}
    world = simulate("free-hand", seed=seed, duration_s=84.0, phone=with_pose, effects=truth)
    recording = recording_of(world, "pose")
    found = calibrate(recording, ["pose_drift"], assume="fixed-point")
    levels = {n.name: n.value for n in found.noise}
    for name, value in zip(("position", "attitude"), truth["pose_drift"], strict=True):
        assert value / 1.5 < levels[f"pose_drift_{name}"] < 1.5 * value
    without = calibrate(recording, assume="fixed-point")
    assert found.log_evidence > without.log_evidence + 20.0


@pytest.mark.prove
@pytest.mark.parametrize(("name", "truth", "factors"), NOISE_TRIALS[:1])
def test_noise_that_is_not_there_is_not_found(name, truth, factors):  # noqa: ARG001
    """Far below what would be noticed, and no worse than without."""
    _, recording = noisy_world(3, {}, 42.0)
    found = calibrate(recording, [name], assume="fixed-point")
    level = {n.name: n.value for n in found.noise}[catalogue()[name].levels[0].name]
    assert level < 0.2 * truth[0]
    without = calibrate(recording, assume="fixed-point")
    assert found.log_evidence == pytest.approx(without.log_evidence, abs=3.0)


@pytest.mark.parametrize("name", STRAYING)
def test_only_explain_handles_wrong_readings(name):
    world = simulate("free-hand", seed=0, duration_s=8.0)
    with pytest.raises(InputError, match="explain"):
        calibrate(recording_of(world, "heading"), [name])


# --- first values ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_hard_iron_is_guessed_from_the_sphere(seed):
    """Twice the Earth's field, from two turns of the hand: to a few percent of the iron."""
    rng = np.random.default_rng(seed)
    iron = rng.normal(0, 1e-4, 3)
    effects = {"mag_hard_iron": iron}
    world = simulate("free-hand", seed=seed, phone=with_magnetometer, effects=effects)
    guess, sigma = mag_hard_iron.sphere(recording_of(world, "mag"))
    np.testing.assert_allclose(guess, iron, rtol=0, atol=2e-6)
    assert np.all(np.abs(guess - iron) < 3.0 * sigma)
    assert np.all(sigma < 0.05 * mag_hard_iron.PRIOR)


def test_hard_iron_is_not_guessed_where_the_motion_does_not_show_it():
    """A turn about z shows the iron along x and y; along z the prior's zero stays."""
    iron = np.array([8e-5, -6e-5, 3e-5])
    angle = np.linspace(0, 2 * np.pi, 400)
    field = np.stack([2e-5 * np.sin(angle), 2e-5 * np.cos(angle), np.full(400, -4e-5)], axis=1)
    world = simulate("free-hand", seed=0, duration_s=8.0)
    recording = recording_of(world)
    streams = {"mag": Series(np.linspace(0, 8, 400), field + iron)}
    guess, sigma = mag_hard_iron.sphere(replace(recording, streams=streams))
    np.testing.assert_allclose(guess[:2], iron[:2], atol=1e-6)
    assert abs(guess[2]) < 1e-4
    assert np.all(sigma[:2] < 0.05 * mag_hard_iron.PRIOR)
    assert sigma[2] > 0.5 * mag_hard_iron.PRIOR
    with pytest.raises(InputError, match="magnetometer"):
        mag_hard_iron.guess(recording)


@pytest.mark.parametrize("last", [True, False])
def test_a_filter_is_undone_on_its_side_of_the_other_errors(last: bool) -> None:
    """A gyro that squares the rate and then smooths it, or does both to the rate itself."""
    t = np.arange(0.0, 20.0, 0.01)
    rate = np.stack([3.0 * np.sin(1.3 * t), 2.0 * np.sin(1.7 * t), 2.5 * np.cos(t) - 2.5], axis=1)
    truth = Signals(t, rate, np.tile([0.0, 0.0, 9.8], (len(t), 1)))
    lag, square = catalogue()["gyro_bandwidth"], catalogue()["gyro_quadratic"]
    tau, q = np.array([0.02]), np.array([0.005, -0.004, 0.005])
    assert lag.imu_error is not None
    assert square.imu_error is not None
    squared = square.imu_error(q, truth)
    felt = replace(truth, gyro=rate + squared[:, :3]) if last else truth
    error = squared + lag.imu_error(tau, felt)
    read = replace(truth, gyro=rate + error[:, :3])
    inside = slice(200, -200)
    wrong = [
        substituted([replace(lag, last=order), square], np.r_[tau, q], read) - error
        for order in (last, not last)
    ]
    near, far = (float(np.abs(w[inside]).max()) for w in wrong)
    assert near < 0.1 * far


def _acting(error: Callable[[np.ndarray, Signals], np.ndarray], *names: str) -> Effect:
    """An effect with this error, and parameters of these names."""
    parameters = tuple(Param(name, "1", 1.0) for name in names)
    scale = replace(catalogue()["gyro_scale"], features=None, proportional=False)
    return replace(scale, parameters=parameters, imu_error=error)


@pytest.mark.parametrize("slope", [-0.7, -0.3, 0.3, 0.77, 1.2, 2.5])
def test_an_error_as_steep_as_what_is_measured_is_taken_off(slope: float) -> None:
    """What bends by three quarters of the rate: substitution crawls, and must not stop halfway.
    What grows faster than the rate: it would go to and fro."""
    t = np.arange(0.0, 10.0, 0.01)
    rate = np.stack([3.0 * np.sin((1.3 + 0.3 * a) * t) for a in range(3)], axis=1)

    def bent(k: np.ndarray, signals: Signals) -> np.ndarray:
        return np.hstack([k[0] * np.tanh(signals.gyro), np.zeros_like(signals.accel)])

    law = _acting(bent, "k")
    truth = Signals(t, rate, np.tile([0.0, 0.0, 9.8], (len(t), 1)))
    error = bent(np.array([slope]), truth)
    found = substituted([law], np.array([slope]), replace(truth, gyro=rate + error[:, :3]))
    np.testing.assert_allclose(found, error, atol=1e-5)


def test_where_an_error_jumps_no_other_sample_suffers() -> None:
    """What reads too much by a constant whichever way it turns, and bends by more than the rate:
    of what noise puts into the jump there is no truth that leads to it. All else is found."""
    t = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(0)
    rate = np.stack([3.0 * np.sin((1.3 + 0.3 * a) * t) for a in range(3)], axis=1)

    def jumping(k: np.ndarray, signals: Signals) -> np.ndarray:
        own = k[0] * np.sign(signals.gyro) + k[1] * np.tanh(signals.gyro)
        return np.hstack([own, np.zeros_like(signals.accel)])

    law = _acting(jumping, "k", "b")
    truth, k = Signals(t, rate, np.tile([0.0, 0.0, 9.8], (len(t), 1))), np.array([0.05, 1.5])
    read = rate + jumping(k, truth)[:, :3] + 0.02 * rng.normal(size=rate.shape)
    lost = np.abs(read) < k[0]
    assert 0 < lost.sum() < 0.05 * lost.size
    found = substituted([law], k, replace(truth, gyro=read))[:, :3]
    asked = jumping(k, replace(truth, gyro=read - found))[:, :3]
    np.testing.assert_allclose(found[~lost], asked[~lost], atol=1e-5)


def test_an_error_that_undoes_what_it_acts_on_leaves_the_readings() -> None:
    """A sensor that reads no turn in one direction: from that no step leads to the rate."""
    t = np.arange(0.0, 4.0, 0.01)
    rate = np.tile([0.5, 0.0, 0.5], (len(t), 1))

    def dead(k: np.ndarray, signals: Signals) -> np.ndarray:
        return np.hstack([-k[0] * np.abs(signals.gyro), np.zeros_like(signals.accel)])

    law = _acting(dead, "k")
    read = Signals(t, rate, np.tile([0.0, 0.0, 9.8], (len(t), 1)))
    found = substituted([law], np.array([1.0]), read)
    assert found.shape == (len(t), 6)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("late", [0.02, -0.06, -0.095])
def test_a_delay_of_many_samples_is_undone_beside_a_steep_law(late: float) -> None:
    """An accelerometer that is late, though not by what else is read, as wide as twelve samples of
    noise; while the gyro bends by more than the rate. (Newton's steps, which the gyro asks for,
    took what the delay adds from one step to the next, and doubled it each time.)"""
    t = np.arange(0.0, 10.0, 0.008)
    rng = np.random.default_rng(0)
    rate = np.stack([3.0 * np.sin((1.3 + 0.3 * a) * t) for a in range(3)], axis=1)
    force = 9.8 * np.sin(rate) + 0.1 * rng.normal(size=rate.shape)

    def bent(k: np.ndarray, signals: Signals) -> np.ndarray:
        return np.hstack([k[0] * np.tanh(signals.gyro), np.zeros_like(signals.accel)])

    law, delay = _acting(bent, "k"), replace(catalogue()["accel_delay"], last=False)
    assert delay.imu_inverse is not None
    read = replace(
        Signals(t, rate, force), gyro=rate + bent(np.array([1.5]), Signals(t, rate, force))[:, :3]
    )
    found = substituted([delay, law], np.array([late, 1.5]), read)
    raw = np.hstack([read.gyro, read.accel])
    np.testing.assert_allclose(raw[:, :3] - found[:, :3], rate, atol=1e-5)
    truth = delay.imu_inverse(np.array([late]), read)
    np.testing.assert_allclose(raw[:, 3:] - found[:, 3:], truth[:, 3:], atol=1e-5)


@pytest.mark.parametrize("effect", [e for e in catalogue().values() if e.imu_error is not None])
def test_what_is_proportional_says_so(effect: Effect) -> None:
    """A matrix times the reading, in a motion of which no two signals are alike, and nothing
    else."""
    assert effect.imu_error is not None
    there, at = probe(), effect.prior_sigma
    read = np.hstack([there.gyro, there.accel])
    error = effect.imu_error(at, there)
    matrix = np.linalg.lstsq(read, error, rcond=None)[0]
    rest, size = (float(np.abs(x).max()) for x in (error - read @ matrix, error))
    assert (rest < 1e-9 * size) == effect.proportional
    if effect.proportional:
        np.testing.assert_allclose(effect.imu_error(at, units()), matrix, atol=1e-12)


@pytest.mark.parametrize("late", [0.5, 2.0, -6.0, 12.0])
def test_an_error_by_angular_acceleration_is_taken_off(late: float) -> None:
    """As large as the rate changes in so many samples: noise moves it by as many times as much as
    itself from sample to sample, and substitution would make that ever more."""
    t = np.arange(0.0, 20.0, 0.01)
    rng = np.random.default_rng(0)
    rate = np.stack([3.0 * np.sin((1.3 + 0.3 * a) * t) for a in range(3)], axis=1)
    truth = Signals(
        t, rate + 0.01 * rng.normal(size=(len(t), 3)), np.tile([0.0, 0, 9.8], (len(t), 1))
    )
    form = grammar.formula([("line", ())])
    law = effect_of(Law(0, (0, 1, 2), False, driver_of("alpha_{i} * |omega|"), form, (1.0,)))
    k = np.array([0.01 * late / 3.0])
    assert law.imu_error is not None
    error = law.imu_error(k, truth)
    found = substituted([law], k, replace(truth, gyro=truth.gyro + error[:, :3]))
    np.testing.assert_allclose(found, error, atol=1e-5)


@pytest.mark.parametrize(
    ("effect", "value"),
    [("gyro_quadratic", 1e60), ("gyro_scale", math.inf), ("gyro_scale", math.nan)],
)
def test_numbers_that_run_away_are_no_warning(effect: str, value: float) -> None:
    """A fit on its way may ask for what no sensor has; that it leads nowhere is seen later."""
    t = np.linspace(0.0, 1.0, 11)
    read = Signals(t, np.full((11, 3), 30.0), np.zeros((11, 3)))
    assert not np.isfinite(substituted([catalogue()[effect]], np.full(3, value), read)).all()

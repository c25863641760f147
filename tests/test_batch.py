"""The batch estimator against dense Gaussian algebra, and what it may claim to know."""

import math
from dataclasses import replace

import numpy as np
import pytest
from proved import proved
from worlds import injected, problem_of, recording_of, true_levels

from handcal import calibrate
from handcal.compiled import so3, strapdown
from handcal.compiled.kernel import BASE
from handcal.estimate import linear, smoother
from handcal.estimate.filter import empty_track, full_prior, initial_state, run_compiled
from handcal.estimate.linear import linearise_about
from handcal.estimate.problem import markov_transitions, noise_arrays, observation_variances
from handcal.estimate.trajectory import epochs, trajectory_of
from handcal_sim import simulate
from handcal_sim.motion import Start
from handcal_sim.phone import Clocking, consumer_phone, paper_phone

MG = 9.80665e-3
EFFECTS = ("gyro_scale", "lever_arm")


def linearised(world, effects=EFFECTS, kinds=("fixed_position", "heading")):
    problem, start = problem_of(recording_of(world, "heading"), effects, kinds)
    levels = true_levels(world)
    track = empty_track(problem, epochs(problem))
    state = initial_state(problem, start, levels)
    state = run_compiled(problem, noise_arrays(problem, levels), state, track)
    nominal = trajectory_of(problem, track, state.bg, state.ba, state.extras)
    return linearise_about(problem, start, nominal), levels


def slow_heading(rng):
    """Twenty headings a second, between the samples."""
    phone = consumer_phone(rng)
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(20.0, 0.0123)))


@pytest.fixture(scope="module")
def short():
    """Two seconds of brisk motion. Noise of 3 mm, lest dense algebra lose the digits asked for:
    round-off is 1e-16 of (prior / noise)^2."""
    world = simulate(
        "free-hand",
        seed=0,
        phone=slow_heading,
        duration_s=2.0,
        effects={"lever_arm": [0.1, 0, -0.1]},
    )
    linear, levels = linearised(world)
    return linear, levels | {"position_noise": 3e-3}


# --- dense algebra -----------------------------------------------------------------------------


def skew(x):
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def dense(linear, levels):
    """Every state as a linear function of the first one and of the noise of each interval.

    Returns the prior mean (k, n), that function G (k, n, k n), the covariance (k, n, n) of
    those independent vectors, and of all observations the rows H G, the residual and R. No
    recursion over covariances.
    """
    problem, nominal = linear.problem, linear.trajectory
    k, n, e0 = len(linear.t), problem.size, BASE + problem.constants
    Phi_e, Q_e = markov_transitions(problem, levels, linear.t, linear.rate)
    mean15, P15 = linear.start.prior(
        nominal.p[0], nominal.v[0], nominal.C[0], nominal.bg, nominal.ba
    )
    mean, G = np.zeros((k, n)), np.zeros((k, n, k, n))
    mean[0] = np.r_[mean15, -nominal.constants, -nominal.markov[0]]
    noise = np.zeros((k, n, n))
    noise[0] = full_prior(problem, P15, levels)
    G[0, :, 0] = np.eye(n)
    for j in range(1, k):
        F = np.eye(n)
        F[:9, : linear.Phi.shape[2]] = linear.Phi[j]
        F[e0:, e0:] = Phi_e[j]
        step = Phi_e[j] @ nominal.markov[j - 1] - nominal.markov[j]
        # sway: displacement and velocity are vectors, which an error of attitude turns
        for i in range(0, problem.markov_size, 3):
            F[e0 + i : e0 + i + 3, 6:9] = skew(step[i : i + 3])
        mean[j] = F @ mean[j - 1]
        mean[j, :9] += linear.d[j]
        mean[j, e0:] += step
        G[j] = np.tensordot(F, G[j - 1], 1)
        G[j, :, j] = np.eye(n)
        noise[j, :9, :9] = (
            levels["gyro_noise"] ** 2 * linear.Q_gyro[j]
            + levels["accel_noise"] ** 2 * linear.Q_accel[j]
            + linear.Q_extra[j]
        )
        noise[j, e0:, e0:] = Q_e[j]
    G = G.reshape(k, n, k * n)
    R_kind = observation_variances(problem, levels)
    epoch = np.repeat(np.arange(k), np.diff(linear.first))
    HG, nu, R = [], [], []
    for q in np.flatnonzero(linear.used):
        for i in range(problem.tables.dim[linear.kind[q]]):
            row = linear.H[q, i]
            HG.append(row @ G[epoch[q]])
            nu.append(linear.r[q, i] - row @ mean[epoch[q]])
            R.append(R_kind[linear.kind[q], i])
    return mean, G, noise, np.array(HG), np.array(nu), np.diag(R)


@pytest.fixture(scope="module")
def brute(short):
    """Log density of all residuals, and of every state the mean and covariance given them."""
    mean, G, noise, HG, nu, R = dense(*short)
    k, n, _ = noise.shape
    HGN = np.einsum("qbc,bcd->qbd", HG.reshape(-1, k, n), noise).reshape(len(HG), k * n)
    S = HGN @ HG.T + R
    L = np.linalg.cholesky(S)
    w = np.linalg.solve(L, nu)
    evidence = -0.5 * (w @ w + len(nu) * math.log(2 * math.pi)) - np.log(np.diag(L)).sum()
    x, P = np.empty((k, n)), np.empty((k, n, n))
    for j in range(k):
        PH = G[j] @ HGN.T
        GN = np.einsum("abc,bcd->abd", G[j].reshape(n, k, n), noise).reshape(n, k * n)
        x[j] = mean[j] + PH @ np.linalg.solve(S, nu)
        P[j] = GN @ G[j].T - PH @ np.linalg.solve(S, PH.T)
    return evidence, x, P


def test_evidence_is_the_density_of_all_residuals(short, brute):
    """One multivariate normal of some 120 numbers."""
    linear, levels = short
    assert linear.used.sum() > 50
    for keep in (True, False):
        assert smoother.forward(linear, levels, keep).log_evidence == pytest.approx(
            brute[0], abs=1e-6
        )


def test_smoother_is_the_dense_posterior(short, brute):
    linear, levels = short
    x, P = smoother.smooth(linear, levels, smoother.forward(linear, levels))
    _, mean, blocks = brute
    sigma = np.sqrt(np.einsum("kii->ki", blocks))
    scale = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose((x - mean) / sigma, 0, atol=1e-6)
    np.testing.assert_allclose(P / scale, blocks / scale, atol=1e-6)


def test_filter_of_the_last_epoch_is_the_smoother_there(short):
    linear, levels = short
    forward = smoother.forward(linear, levels)
    x, P = smoother.smooth(linear, levels, forward)
    np.testing.assert_array_equal(x[-1], forward.x[-1])
    np.testing.assert_array_equal(P[-1], forward.P[-1])
    # knowing the future as well never makes a variance larger
    more = np.einsum("kii->ki", P) / np.einsum("kii->ki", forward.P)
    assert more.max() < 1 + 1e-6


# --- preintegration ----------------------------------------------------------------------------


def test_preintegrated_transition_is_the_derivative_of_navigation(short):
    """From epoch to epoch, against free inertial navigation with perturbed start and biases."""
    linear, _ = short
    problem, nominal = linear.problem, linear.trajectory
    nodes = problem.nodes
    J = problem.slopes.dense(problem.imu_constants)
    for j in range(5, len(nominal.node), 9):
        a, b = nominal.node[j - 1], nominal.node[j]
        span = slice(a, b + 1)

        def end(error, span=span, j=j):
            extras = nominal.constants[: problem.imu_constants] + error[15:] - problem.ref[:3]
            wrong = J[span] @ extras
            gyro, accel = np.hsplit(np.hstack([nodes.gyro, nodes.accel]) + nodes.bend, 2)
            gyro = gyro[span] - (nominal.bg + error[9:12]) - wrong[:, :3]
            accel = accel[span] - (nominal.ba + error[12:15]) - wrong[:, 3:]
            C = so3.matrix_exp(error[6:9]) @ nominal.C[j - 1]
            p, v, C = strapdown.integrate(
                nodes.t[span], gyro, accel, nominal.p[j - 1] + error[:3],
                nominal.v[j - 1] + error[3:6], C, problem.g_n, problem.omega_ie_n,
            )  # fmt: skip
            return p[-1], v[-1], C[-1]

        width = linear.Phi.shape[2]
        p, v, C = end(np.zeros(width))
        d = np.r_[p - nominal.p[j], v - nominal.v[j], so3.matrix_log(C @ nominal.C[j].T)]
        np.testing.assert_allclose(linear.d[j], d, atol=1e-12)
        expected = np.empty((9, width))
        for i in range(width):
            e = np.zeros(width)
            e[i] = 1e-5
            (pp, vp, Cp), (pm, vm, Cm) = end(e), end(-e)
            expected[:, i] = np.r_[pp - pm, vp - vm, so3.matrix_log(Cp @ Cm.T)] / 2e-5
        # on purpose, an attitude error also turns the noise that the nominal implies: half of
        # it at either end (sensor noise lives in the body)
        half = 0.5 * expected[6:9].copy()
        half[:, 6:9] += 0.5 * np.eye(3)
        for i in (0, 3, 6):
            expected[i : i + 3] += skew(linear.d[j, i : i + 3]) @ half
        # third order in the interval: (3 rad/s)^2 10 m/s^2 dt^3 / 6
        third = 15.0 * (nodes.t[b] - nodes.t[a]) ** 3
        np.testing.assert_allclose(linear.Phi[j], expected, atol=5e-5 + third)


def test_two_halves_are_integrated_as_the_whole_is(short, monkeypatch):
    """To the last bit, and nothing is left out where they meet."""
    whole, _ = short
    monkeypatch.setattr(linear, "MANY", 2)
    halves = linearise_about(whole.problem, whole.start, whole.trajectory)
    monkeypatch.setattr(linear, "MANY", len(whole.t))
    again = linearise_about(whole.problem, whole.start, whole.trajectory)
    for name in ("Phi", "d", "Q_gyro", "Q_accel", "Q_extra"):
        assert np.array_equal(getattr(halves, name), getattr(again, name)), name


def test_preintegrated_noise_is_that_of_its_samples(short):
    """Gyro noise of density 1: angle grows as t, velocity as (f t)^2 t / 3 across the force."""
    linear, _ = short
    dt = np.diff(linear.t)
    force = np.linalg.norm(linear.problem.nodes.accel - linear.trajectory.ba, axis=1)
    for j in range(1, len(linear.t)):
        Q = linear.Q_gyro[j]
        np.testing.assert_allclose(np.diag(Q)[6:9], dt[j - 1], rtol=1e-6)
        np.testing.assert_allclose(np.diag(linear.Q_accel[j])[3:6], dt[j - 1], rtol=1e-6)
        f = force[linear.trajectory.node[j - 1] : linear.trajectory.node[j] + 1]
        # two directions; the sum over few samples against the integral
        most = 2 * f.max() ** 2 * dt[j - 1] ** 3 / 3
        assert np.trace(Q[3:6, 3:6]) <= 1.05 * most
        assert np.all(linear.Q_extra[j] == 0)


# --- relinearisation ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def half_minute():
    world = simulate(
        "three-turns",
        seed=1,
        effects={"gyro_scale": [0.01, -0.01, 0.01], "lever_arm": [0.1, -0.05, 0.1]},
    )
    linear, levels = linearised(world)
    settled, done, _ = smoother.relinearise(linear, levels)
    return linear, levels, (settled, smoother.forward(settled, levels), done)


def test_relinearisation_settles(half_minute):
    """Another round changes nothing: evidence to the tolerance, estimates to a hundredth sigma."""
    linear, levels, (settled, forward, done) = half_minute
    assert done
    x, P = smoother.smooth(settled, levels, forward)
    again = linearise_about(settled.problem, settled.start, smoother.moved(settled.trajectory, x))
    second = smoother.forward(again, levels)
    assert abs(second.log_evidence - forward.log_evidence) < 0.05
    sigma = np.sqrt(np.diag(P[-1]))[9 : BASE + settled.problem.constants]
    first = x[-1, 9 : BASE + settled.problem.constants]
    # what is estimated about the moved trajectory is what was estimated before, less the move
    assert np.all(np.abs(second.x[-1, 9 : BASE + settled.problem.constants]) < 0.02 * sigma)
    assert np.all(np.abs(first) < 0.5 * sigma)
    # the first pass was not good enough, or this test would show nothing
    assert abs(forward.log_evidence - smoother.forward(linear, levels).log_evidence) > 0.05


@pytest.mark.parametrize("seed", range(2))
def test_the_result_does_not_depend_on_where_the_passes_began(half_minute, seed):
    """A nominal that is off by 3 degrees, 3 cm, 0.3 deg/s, 30 mg: the same evidence, estimate."""
    _, levels, (settled, forward, _) = half_minute
    rng = np.random.default_rng(seed)
    nominal = settled.trajectory
    turn = so3.matrix_exp(rng.normal(0, math.radians(3.0), 3))
    wrong = replace(
        nominal,
        p=nominal.p + rng.normal(0, 0.03, 3),
        v=nominal.v + rng.normal(0, 0.03, 3),
        C=turn @ nominal.C,
        bg=nominal.bg + rng.normal(0, math.radians(0.3), 3),
        ba=nominal.ba + rng.normal(0, 30 * MG, 3),
        constants=nominal.constants + rng.normal(0, 0.005, len(nominal.constants)),
    )
    off = linearise_about(settled.problem, settled.start, wrong)
    linear, done, _ = smoother.relinearise(off, levels)
    assert done
    other = smoother.forward(linear, levels)
    assert other.log_evidence == pytest.approx(forward.log_evidence, abs=0.1)
    c = settled.problem.constants
    sigma = np.sqrt(np.diag(forward.P[-1]))[9 : BASE + c]

    def estimate(at, result):
        t = at.trajectory
        return np.r_[t.bg, t.ba, t.constants] + result.x[-1, 9 : BASE + c]

    difference = estimate(linear, other) - estimate(settled, forward)
    assert np.all(np.abs(difference) < 0.05 * sigma)


# --- what accelerometer biases must not do -----------------------------------------------------


def biased(rng, size):
    phone = consumer_phone(rng)
    bias = size * MG * np.array([1.0, -0.8, 0.9])
    # a converter's steps would round a biased reading otherwise than an unbiased one
    accel = replace(phone.accel, bias=bias, quantum=0.0)
    return replace(phone, accel=accel)


@pytest.mark.prove
@pytest.mark.parametrize("name", ["three-turns", "z-turn"])
@pytest.mark.parametrize("seed", [0, 1])
def test_large_accelerometer_biases_cost_their_prior_and_nothing_else(name, seed):
    """60 to 80 mg against none, the same draws otherwise.

    The start is levelled on biased readings. The evidence is to differ by what the prior of
    the bias says, b^2 / (2 0.6^2), and by less than half a nat more; the estimate by the bias.
    """
    results, bias = [], None
    for size in (0.0, 80.0):
        world = simulate(name, seed=seed, phone=lambda rng, size=size: biased(rng, size))
        bias = injected(world, "accel_bias")
        recording = recording_of(world, "heading")
        results.append(calibrate(recording, assume="fixed-point", noise=true_levels(world)))
    none, large = results
    accel = [[p for p in r.parameters if p.effect == "accel_bias"] for r in results]
    assert all(60 * MG < abs(b) <= 80 * MG for b in bias)
    for a, b, injected_bias in zip(*accel, bias, strict=True):
        # the prior pulls a little: by (sigma / prior)^2 of the bias
        pull = injected_bias * (b.sigma / b.prior_sigma) ** 2
        assert b.value - a.value == pytest.approx(injected_bias - pull, abs=0.2 * b.sigma)
        assert b.sigma == pytest.approx(a.sigma, rel=0.05)
        assert abs(b.value - injected_bias) < 4 * b.sigma
    if name == "three-turns":
        cost = float((bias**2).sum() / (2 * 0.6**2))
        assert none.log_evidence - large.log_evidence == pytest.approx(cost, abs=0.5)


# --- what can be seen --------------------------------------------------------------------------


QUIET = {"sway": 1e-3, "sway_per_rate": 1e-3, "sway_time": 0.4, "position_noise": 3e-4}


def level_turns(name, seed, *streams):
    world = simulate(name, seed=seed, phone=paper_phone(), start=Start(heading=0.5), sway=0.0)
    noise = true_levels(world) | QUIET
    return calibrate(recording_of(world, *streams), assume="fixed-point", noise=noise)


@pytest.mark.parametrize("seed", range(2))
def test_a_level_turn_without_a_heading_does_not_show_the_vertical_gyro_bias(seed):
    """Paper 002: b_gz and yaw are not observable; x and y are, through gravity."""
    x, y, z = level_turns("z-turn", seed).parameters[:3]
    assert not z.shown
    assert 0.7 * z.prior_sigma < z.sigma <= z.prior_sigma * (1 + 1e-6)
    assert x.shown
    assert y.shown


@pytest.mark.parametrize(("name", "streams"), [("z-turn", ["heading"]), ("three-turns", [])])
@pytest.mark.parametrize("seed", [0, *proved(1)])
def test_a_heading_or_turns_about_three_axes_show_every_gyro_bias(name, streams, seed):
    """Truth: 1000, 1200, 1500 deg/h."""
    result = level_turns(name, seed, *streams)
    truth = np.radians([1000.0, 1200.0, 1500.0]) / 3600
    for p, value in zip(result.parameters[:3], truth, strict=True):
        assert p.shown
        assert abs(p.value - value) < 4 * p.sigma
        assert p.converged_at_s is not None

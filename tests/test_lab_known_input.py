"""Calibration against a known input: papers 000 and 004, tables, recordings with a reference."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from lab_world import command, off, recording

from handcal.compiled.so3 import matrix_exp
from handcal.effects import select
from handcal.estimate import regression
from handcal.lab import steady_tests
from handcal.lab.known_input import BAD_CONDITION, DEFAULT, known_input
from handcal.lab.papers import paper_000, paper_004
from handcal.lab.papers.paper import computed, markdown, numbers
from handcal.lab.table import ARCMIN, ARCSEC, error_covariance, table
from handcal.lab.ten_tests import best_rates, magnification, proposal
from handcal.recordings import segment
from handcal.recordings.inputs._checks import saturated
from handcal.show.lab.known_input import known_input_sheet
from handcal.types import HandcalError, InputError, Series

EXACT = {"gyro": 0.0, "accel": 0.0}
ACCEL, GYRO = DEFAULT[:2], DEFAULT[2:]


def samples():
    """The four of paper 000, the first two in the twelve sequences of axes."""
    for sequence in paper_000.sequences():
        yield f"1 {sequence}", paper_000.accelerometers(sequence)
        yield f"2 {sequence}", paper_000.accelerometers(sequence, pendulous=True)
    yield "3", paper_000.gyros(paper_000.rates_3())
    yield "4", paper_000.gyros(paper_000.rates_4(), extended=True)


SAMPLES = dict(samples())


# --- paper 000 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_of_paper_000_come_back_without_noise(name):
    sample = SAMPLES[name]
    result, X = paper_000.solved(sample)
    assert X.shape == sample.X.shape
    assert np.abs(X - sample.X).max() < 1e-9
    # the numbers that went in, from the paper rather than from the code under test
    assert X[1, 1] == pytest.approx(-0.01, abs=1e-9)
    assert X[0, 2] == pytest.approx(2.0 if name in "34" else 2.5, abs=1e-9)
    if len(X) == 7:
        np.testing.assert_allclose(X[4:], 1e-3 * (1 - 2 * np.eye(3)), atol=1e-9)
    assert result.kalman < 1e-9


@pytest.mark.parametrize("name", ["1 ZXZ", "2 XYZ", "3", "4"])
def test_least_squares_and_kalman_filter_are_one(name):
    """With 1 mV of noise, without a prior and with one (least squares has it as more rows)."""
    sample = SAMPLES[name]
    rng = np.random.default_rng(0)
    noisy = sample.bench.reading + 1e-3 * rng.standard_normal(sample.bench.reading.shape)
    b = replace(sample.bench, reading=noisy, variance=np.full_like(noisy, 1e-6))
    result = known_input(b, sample.effects, "table", EXACT)
    assert result.kalman < 1e-9
    A = result.A
    y = 1e3 * noisy[:, b.used].ravel()
    k = A.shape[1]
    mean, sigma = rng.standard_normal(k), rng.uniform(0.1, 1.0, k)
    x, P = regression.kalman(A, y, (mean, np.diag(sigma**2)))
    with_rows = regression.least_squares(
        np.vstack([A, np.diag(1.0 / sigma)]), np.r_[y, mean / sigma]
    )
    np.testing.assert_allclose(x, with_rows.x, rtol=0, atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(P, with_rows.P, rtol=0, atol=1e-9 * np.abs(P).max())
    x, P = regression.kalman(A, y)
    alone = regression.least_squares(A, y)
    np.testing.assert_allclose(P, alone.P, rtol=0, atol=1e-9 * np.abs(P).max())
    np.testing.assert_allclose(x, np.linalg.lstsq(A, y, rcond=None)[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("apart", "tile"), [(1e-17, "agree"), (0.02, "0.02")])
def test_rounding_is_no_number_to_show(apart, tile):
    """The page and the terminal said 1e-17; and that the two agree, whatever came out."""
    sample = SAMPLES["3"]
    result = replace(known_input(sample.bench, sample.effects, "table", EXACT), kalman=apart)
    sheet = known_input_sheet(result, "a.csv", None, pictures=False)
    assert tile in [value for value, _ in sheet.facts]
    assert any(("readings agree" if tile == "agree" else "differ by 0.02") in s
               for s in sheet.sentences)  # fmt: skip


def test_condition_numbers_that_paper_000_leaves_out():
    """Verified elsewhere: 3.6 and 14.5 for ZXZ, 1.1e3 and 2.3e5 for samples 3 and 4."""
    known = {"1 ZXZ": 3.6, "2 ZXZ": 14.5, "3": 1131.0, "4": 2.33e5}
    for name, value in known.items():
        assert paper_000.plain_condition(SAMPLES[name]) == pytest.approx(value, rel=0.005)
    least = min((s for s in SAMPLES if s[0] == "1"),
                key=lambda s: paper_000.plain_condition(SAMPLES[s]))  # fmt: skip
    assert paper_000.plain_condition(SAMPLES[least]) == pytest.approx(3.596, abs=1e-3)


@pytest.mark.parametrize("extended", [False, True])
def test_ten_tests_are_a_hundred_times_less_sensitive(extended):
    sample = SAMPLES["4" if extended else "3"]
    result, _ = paper_000.solved(sample)
    assert result.condition > BAD_CONDITION
    assert "badly conditioned" in " ".join(result.warnings)
    rates, gain = paper_000.ten_tests(extended)
    assert rates.shape == (10, 3)
    assert np.abs(rates).max() <= max(100.0, 1e-9)
    assert gain > 100.0
    # by simulation too: the worst coefficient of the sample, 400 draws of 1 mV each way
    better = paper_000.gyros(rates, extended)
    worst = np.unravel_index(np.argmax(spread(sample)), sample.X.shape)
    assert spread(sample)[worst] > 100.0 * spread(better)[worst]
    assert known_input(better.bench, better.effects, "table", EXACT).condition < 10.0
    shown, times = proposal(result)
    np.testing.assert_allclose(shown, rates, atol=1e-9)
    assert times.max() >= gain > 100.0


def test_rates_are_the_best_there_are():
    """Eight tests at all corners make every column as long as can be and all orthogonal: no
    set of eight tells more (Hadamard)."""
    effects = (regression.BIASES[0], *select(GYRO))
    rates = best_rates(effects, 2.0, 8)
    assert len({tuple(r) for r in rates}) == 8
    np.testing.assert_allclose(np.abs(rates), 2.0)
    sigma = magnification(effects, rates)
    np.testing.assert_allclose(sigma[:3], 8**-0.5, rtol=1e-12)
    np.testing.assert_allclose(sigma[3:], 8**-0.5 / 2.0, rtol=1e-12)


def spread(sample, runs=400):
    """Standard deviations of X (c, 3) for 1 mV of noise, by drawing it."""
    U = sample.bench.mean(np.hstack([sample.bench.truth.gyro, sample.bench.truth.accel]))
    x = U[:, :3]
    G = np.c_[np.ones(len(x)), x]
    G = np.c_[G, paper_000.products(x)] if len(sample.X) == 7 else G
    noise = 1e-3 * np.random.default_rng(0).standard_normal((runs, len(x), 3))
    return (np.linalg.pinv(G) @ noise).std(axis=0)


@pytest.mark.parametrize(("angle", "tilt"), [(1.5 * ARCSEC, 0.0), (0.0, 2.0 * ARCMIN)])
def test_the_error_formula_is_monte_carlo_within_two_percent(angle, tilt):
    """N = 20000 runs: a standard deviation is known to 0.5 %, so that 2 % are four sigma."""
    runs, kept, alone = paper_000.monte_carlo(angle, tilt, np.random.default_rng(0))
    assert np.abs(kept / runs - 1.0).max() < 0.02
    if tilt:
        # what the correlations are worth: without them some are far off, both ways
        assert (alone / runs).max() > 5.0
        assert (alone / runs).min() < 0.5


def test_the_formula_takes_the_estimate_where_it_is():
    """About other parameters, in the IMU's axes and with products, too: the same Monte Carlo.

    2000 runs: 1.6 % for one sigma of a standard deviation, of 24 parameters: 5 sigma.
    """
    poses = paper_000.poses("XYZ")
    R = matrix_exp(np.array([0.5, -0.3, 0.4]))
    effects = (*ACCEL, "accel_cross_products")
    M = np.eye(3) + np.array([[0.02, 0, 0], [0.01, -0.03, 0], [-0.02, 0.015, 0.01]])
    L = 0.02 * np.random.default_rng(1).standard_normal((3, 3))

    def read(f):
        body = f @ R.T
        return body @ M.T + [0.3, 0.1, -0.2] + paper_000.products(body) @ L.T

    tests = steady_tests.of_arrays(None, poses.force(), None, read(poses.force()))
    result = known_input(tests, effects, "imu", EXACT)
    formula = np.sqrt(np.diag(error_covariance(result, poses, 20 * ARCSEC, ARCMIN)))
    rng = np.random.default_rng(0)
    force = poses.force(20 * ARCSEC * rng.standard_normal((2000, 41, 3)),
                        ARCMIN * rng.standard_normal((2000, 2)))  # fmt: skip
    missed = np.array([read(f) for f in force]) - read(poses.force())
    B = np.linalg.pinv(result.A)
    found = (B @ missed.reshape(2000, -1).T).std(axis=1)
    assert np.abs(formula / found - 1.0).max() < 0.08


def test_a_table_turns_as_it_says():
    angles = np.radians([[10.0, 20.0, 30.0]])
    x, _, z = np.eye(3)
    C = matrix_exp(angles[0, 0] * z) @ matrix_exp(angles[0, 1] * x) @ matrix_exp(angles[0, 2] * z)
    made = table("zxz", angles, 9.8)
    np.testing.assert_allclose(made.force()[0], C.T @ [0, 0, 9.8], atol=1e-14)
    tilt = np.array([0.01, -0.02])
    base = matrix_exp(np.r_[tilt, 0.0])
    np.testing.assert_allclose(made.force(tilt=tilt)[0], C.T @ base.T @ [0, 0, 9.8], atol=1e-14)
    more = np.array([[0.1, 0, 0]])
    by_error = made.force(more)[0]
    np.testing.assert_allclose(by_error, table("ZXZ", angles + more, 9.8).force()[0])
    for wrong in ("XX", "XXY", "ABC", "XYZX"):
        with pytest.raises(InputError, match="sequence"):
            table(wrong, angles, 9.8)


# --- rank ---------------------------------------------------------------------------------------


def refusal(b, effects, axes="table", extra=EXACT):
    with pytest.raises(HandcalError) as refused:
        known_input(b, effects, axes, extra)
    return str(refused.value)


def test_a_deficient_design_is_refused_with_what_it_cannot_see():
    """Equal rates about all axes: only the sum of a row of K is seen (rank 2 of 4)."""
    w = np.repeat(10.0 * np.arange(11.0)[:, None], 3, axis=1)
    said = refusal(paper_000.gyros(w).bench, GYRO)
    assert "No reading changes" in said
    for name in ("gyro_scale x", "gyro_misalignment xy", "gyro_misalignment xz"):
        assert name in said or "others" in said or "more such" in said
    unseen = unseen_of(paper_000.gyros(w))
    # rank 2 of 4 for each of three axes
    assert len(unseen) == 6


def unseen_of(sample):
    """What the regression says the rows of a sample do not show."""
    effects = (regression.BIASES[0], *select(sample.effects))
    of = regression.unknowns(effects)
    A = steady_tests.design(sample.bench, effects, np.zeros(len(of)), sample.bench.truth)
    A = A[:, :3].reshape(-1, len(of))
    found = regression.unseen(A, regression.priors(of))
    for c in found:
        assert np.abs(A @ (c * regression.priors(of))).max() < 1e-9
    assert np.linalg.matrix_rank(np.array(found)) == len(found)
    return found


@pytest.mark.parametrize(
    ("force", "names"),
    [
        (np.tile([0.0, 0.0, 9.8], (12, 1)), ["accel_bias", "accel_scale z"]),
        (9.8 * np.vstack([np.eye(3)] * 4), ["accel_bias x", "accel_scale x"]),
        (9.8 * np.vstack([np.eye(3)[:2], -np.eye(3)[:2]] * 3), ["accel_scale z"]),
    ],
)
def test_poses_that_do_not_do_are_refused(force, names):
    said = refusal(steady_tests.of_arrays(None, force, None, force), ACCEL)
    for name in names:
        assert name in said


def test_too_few_tests_and_numbers_that_are_none():
    force = 9.8 * np.eye(3)
    assert "too few" in refusal(steady_tests.of_arrays(None, force, None, force), ACCEL)
    nan = np.vstack([9.8 * np.eye(3), -9.8 * np.eye(3), [[np.nan, 0, 0]]])
    with pytest.raises(InputError, match="not finite"):
        known_input(steady_tests.of_arrays(None, nan, None, nan), ACCEL)


@pytest.mark.parametrize("seed", range(5))
def test_unseen_are_all_and_only_what_the_rows_do_not_show(seed):
    """Random rows of random rank, columns of very different size."""
    rng = np.random.default_rng(seed)
    rank, k = int(rng.integers(1, 8)), 8
    A = rng.standard_normal((20, rank)) @ rng.standard_normal((rank, k))
    A = A * 10.0 ** rng.uniform(-4, 4, k)
    usual = 10.0 ** rng.uniform(-3, 0, k)
    found = regression.unseen(A, usual)
    assert len(found) == k - rank
    size = np.abs(A).max(axis=0)
    for c in found:
        assert np.abs(A @ (c * usual)).max() < 1e-6 * (size * np.abs(c * usual)).max()


# --- recordings ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setup", "effects"), [("steady-spins", DEFAULT), ("dividing-head", ACCEL)]
)
def test_a_recording_without_noise_gives_back_what_was_injected(setup, effects):
    """At the reference's own 100 Hz, so that nothing is interpolated."""
    b = steady_tests.of_recording(recording(setup, perfect=True))
    result = known_input(b, effects)
    assert len(off(result.parameters)["accel"]) == 9
    missed = off(result.parameters)
    # the head is no rate table: its moves would need the gyro's scale, which is not asked for
    for sensor in ("accel", "gyro") if effects == DEFAULT else ("accel",):
        assert np.abs(missed[sensor]).max() < 1e-12
    mounting = [p.value for p in result.parameters if p.effect == "mounting"]
    assert np.abs(mounting).max() < 1e-12
    assert np.abs(result.residual[:, 3:, 1]).max() < 1e-12
    assert result.kalman < 1e-9


def test_arms_show_in_steady_turns():
    """An effect of rates of change: nothing wrong comes in where two tests meet."""
    arms = [0.03, -0.05, 0.02, 0.01, 0.0, -0.02, 0.04, 0.03, -0.01]
    r = recording("steady-spins", perfect=True, effects={"size_effect": arms})
    result = known_input(steady_tests.of_recording(r), (*DEFAULT, "size_effect"))
    found = [p.value for p in result.parameters if p.effect == "size_effect"]
    np.testing.assert_allclose(found, arms, atol=1e-9)


def test_noise_and_mounting_are_within_the_sigmas():
    result = known_input(steady_tests.of_recording(recording("steady-spins", seed=1)))
    for z in off(result.parameters, sigmas=True).values():
        assert 0.3 < np.sqrt((z**2).mean()) < 2.0
        assert np.abs(z).max() < 4.5
    mounting = [p for p in result.parameters if p.effect == "mounting"]
    assert max(abs(p.value) for p in mounting) > 0.01


def test_position_errors_of_the_table_show_in_the_sigmas():
    """20 arcmin in every axis and pose: 58 mm/s^2, far above the noise."""
    exact = known_input(steady_tests.of_recording(recording("table-poses", seed=2)), ACCEL)
    loose = known_input(steady_tests.of_recording(
        recording("table-poses", seed=2, angle=20 * ARCMIN)), ACCEL)  # fmt: skip
    assert loose.extra["accel"] == pytest.approx(20 * ARCMIN * 9.8, rel=0.5)
    assert exact.extra["accel"] < 0.1 * loose.extra["accel"]
    z = off(loose.parameters, sigmas=True)["accel"]
    assert 0.3 < np.sqrt((z**2).mean()) < 2.0


def test_a_table_that_never_stops_and_one_without_reference():
    r = recording("steady-spins", seed=3)
    swing = np.sin(2.0 * r.imu.t)[:, None] * [1.0, 0.5, 0.3]
    with pytest.raises(HandcalError, match="No rest and no steady turn"):
        steady_tests.of_recording(replace(r, imu=replace(r.imu, gyro=r.imu.gyro + 3.0 * swing)))
    with pytest.raises(InputError, match="known input"):
        steady_tests.of_recording(replace(r, streams={}))


def test_tests_in_which_something_is_missing_are_left_out():
    r = recording("steady-spins", seed=3)
    whole = steady_tests.of_recording(r)
    ref = r.streams["reference"]
    lost = (ref.t > whole.span[2, 0]) & (ref.t < whole.span[2, 1])
    gap = replace(r, streams={"reference": Series(ref.t[~lost], ref.value[~lost])})
    assert len(steady_tests.of_recording(gap)) == len(whole) - 1
    valid = r.imu.valid & ~((r.imu.t > whole.span[2, 0]) & (r.imu.t < whole.span[2, 1]))
    clipped = replace(r, imu=replace(r.imu, valid=valid))
    assert len(steady_tests.of_recording(clipped)) == len(whole) - 1


def test_steady_turns_are_found_where_they_are():
    """Nine attitudes: a rest and two turns each, of 100 deg/s."""
    r = recording("steady-spins", seed=4)
    spans = segment.steady(r)
    rates = []
    for a, b in spans:
        own = (r.imu.t >= a) & (r.imu.t <= b)
        rates.append(np.linalg.norm(r.imu.gyro[own].mean(axis=0)))
    rates = np.degrees(rates)
    assert np.sum(rates < 3.0) >= 9
    assert np.sum(np.abs(rates - 100.0) < 3.0) == 18


def test_a_turn_may_ripple_by_a_part_of_itself():
    """0.35 % of 100 deg/s at 10 Hz: far above the noise, and steady for a table."""
    r = recording("steady-spins", perfect=True)
    rate = np.linalg.norm(r.imu.gyro, axis=1, keepdims=True)
    ripple = 1.0 + 0.0035 * np.sqrt(2.0) * np.sin(2 * np.pi * 10.0 * r.imu.t)[:, None]
    rippled = replace(r, imu=replace(r.imu, gyro=r.imu.gyro * ripple))
    turning = [np.interp(0.5 * (a + b), r.imu.t, rate[:, 0]) > 1.5
               for a, b in segment.steady(rippled)]  # fmt: skip
    assert sum(turning) == 18


def test_a_commanded_rate_is_not_taken_for_saturation():
    """All three numbers stay the same: no sensor, but what a table was told."""
    told = np.zeros((400, 3))
    told[100:150] = [2.0, -0.1, 0.3]
    told[:, 1] += np.r_[np.zeros(200), np.linspace(0.0, 1.0, 200)]
    assert not saturated(told, 1.0).any()
    rng = np.random.default_rng(0)
    read = told + 0.01 * rng.standard_normal(told.shape)
    read[100:150, 0] = 2.0
    assert saturated(read, 1.0).sum() == 50


@pytest.mark.prove
@pytest.mark.parametrize("setup", ["table-poses", "steady-spins", "dividing-head", "soak"])
def test_sigmas_of_simulated_set_ups(setup):
    """20 devices each; the noise levels are estimated too: 0.8 to 1.25."""
    effects = DEFAULT if setup in ("steady-spins", "dividing-head") else ACCEL
    tests = [steady_tests.of_recording(recording(setup, seed=s)) for s in range(20)]
    z = [off(known_input(t, effects).parameters, True) for t in tests]
    rms = np.sqrt(np.mean([np.mean(one["accel"] ** 2) for one in z]))
    print(f"\n{setup}: rms of errors of the accelerometer in sigmas {rms:.3f}, 20 devices")
    assert 0.8 < rms < 1.25


@pytest.mark.prove
def test_real_imus_of_one_board_against_each_other(real_recordings):
    import handcal

    b = steady_tests.of_recording(handcal.load(real_recordings / "array_1_imu5.mcap"))
    result = known_input(b, ACCEL)
    left = np.sqrt((result.residual[:, 3:] ** 2).mean(axis=(0, 1)))
    assert left[0] > 0.1
    assert 1e-4 < left[1] < 0.01
    assert result.kalman < 1e-9


# --- paper 004 ----------------------------------------------------------------------------------


def test_the_bank_of_filters_is_least_squares():
    filtered, fitted = paper_004.bank(np.random.default_rng(0))
    assert np.abs(filtered - fitted).max() < 1e-9
    assert np.abs(filtered - paper_004.true_bank()).max() < 5 * 1e-3 * 0.14
    assert np.abs(filtered - paper_004.true_bank()).max() > 0.0


def test_six_positions_beat_the_printed_rows():
    """det 0.0286 and 1/27 are verified elsewhere; six reach 1/27."""
    assert paper_004.determinant(paper_004.NINE) == pytest.approx(0.0286, abs=5e-5)
    assert paper_004.efficiency(paper_004.NINE) == pytest.approx(0.937, abs=5e-4)
    assert paper_004.determinant(paper_004.SIX) == pytest.approx(1 / 27, abs=1e-15)
    four = paper_004.NINE[list(paper_004.BANK[0])]
    assert paper_004.efficiency(four) == pytest.approx(0.570, abs=5e-4)
    # 200 readings in each of nine positions: an axis's filter uses four of these, six use all
    six, nine = paper_004.sigmas(paper_004.SIX, 1800), paper_004.sigmas(paper_004.NINE, 1800)
    assert np.all(six < nine)
    assert np.all(six < paper_004.sigmas(four, 800))


def test_the_bank_by_simulation_is_as_sure_as_it_says():
    """300 runs of 40 readings: a standard deviation to 4 %, 12 of them: 16 %."""
    runs = np.array([
        paper_004.fitted([paper_004.measured(a, rng, samples=10) for a in range(3)])
        for rng in map(np.random.default_rng, range(300))
    ])  # fmt: skip
    four = paper_004.NINE[list(paper_004.BANK[0])]
    assert runs.std(axis=0)[0] == pytest.approx(
        paper_004.NOISE * paper_004.sigmas(four, 40), rel=0.16
    )


# --- tables and the commands --------------------------------------------------------------------


def csv_of(path, columns):
    names = ",".join(columns)
    np.savetxt(path, np.stack(list(columns.values()), axis=1), delimiter=",", header=names,
               comments="")  # fmt: skip
    return path


def rate_table():
    rates = np.degrees(paper_000.ten_tests(False)[0]) / 60.0
    read = rates @ (np.eye(3) + 0.01 * np.arange(9).reshape(3, 3)).T + 0.5
    return {f"w{a} (deg/s)": c for a, c in zip("xyz", rates.T, strict=True)} | {
        f"g{a} [deg/s]": c for a, c in zip("xyz", read.T, strict=True)
    }


def test_a_table_of_rates(tmp_path, monkeypatch, capsys):
    file = csv_of(tmp_path / "rates.csv", rate_table())
    numbers_file, page = tmp_path / "r.json", tmp_path / "r.html"
    done = command(monkeypatch, capsys, "lab", "known-input", file, "--json", numbers_file,
                   "--report", page)  # fmt: skip
    assert done[0] == 0
    found = {(p["effect"], p["name"]): p["value"]
             for p in json.loads(numbers_file.read_text())["parameters"]}  # fmt: skip
    assert found["gyro_scale", "y"] == pytest.approx(0.04, abs=1e-9)
    assert found["gyro_misalignment", "zx"] == pytest.approx(0.06, abs=1e-9)
    assert found["gyro_bias", "x"] == pytest.approx(np.radians(0.5), abs=1e-9)
    assert page.read_text().count("<svg") == 1


def test_a_table_of_angles_with_the_errors_of_the_table(tmp_path, monkeypatch, capsys):
    poses = paper_000.poses()
    read = 9.80665 * (poses.force() @ paper_000.K_ACCEL.T) + 0.2
    rng = np.random.default_rng(0)
    read += 1e-3 * rng.standard_normal(read.shape)
    names = ("alpha (deg)", "beta (deg)", "gamma (deg)", "ax", "ay", "az")
    columns = dict(zip(names, np.hstack([np.degrees(poses.angles), read]).T, strict=True))
    file = csv_of(tmp_path / "poses.csv", columns)
    options = ("--axes", "table", "--sequence", "zxz", "--tilt-sigma", "2")
    status, out, _ = command(monkeypatch, capsys, "lab", "known-input", file, *options, "--json",
                             tmp_path / "p.json")  # fmt: skip
    assert status == 0
    assert "What the table's errors bring" in out
    document = json.loads((tmp_path / "p.json").read_text())
    lean = {p["name"]: p["value"] for p in document["parameters"]
            if p["effect"] == "accel_misalignment"}  # fmt: skip
    assert lean == pytest.approx({"yx": -0.01, "zx": 0.01, "zy": -0.01, "xy": 0.01, "xz": -0.01,
                                  "yz": 0.01}, abs=1e-3)  # fmt: skip
    # 2 arcmin of tilt on 9.8 m/s^2; sample 1 in g is verified by Monte Carlo above
    kept = paper_000.monte_carlo(0.0, 2 * ARCMIN, np.random.default_rng(0), 2)[1][0, 0]
    bias = next(e for e in document["table_errors"] if e["effect"] == "accel_bias")
    assert bias["sigma"] == pytest.approx(9.80665 * kept, rel=0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "rows of tests"),
        ("wx,wy,wz,gx,gy,gz\n", "rows of tests"),
        ("a,b\n1,2\n", "no column that is known"),
        ("wx,wy,gx,gy,gz\n1,2,3,4,5\n", "not all of"),
        ("gx,gy,gz\n1,2,3\n", "no known rate"),
        ("ax,ay,az\n1,2,3\n", "no known force"),
        ("wx,wy,wz\n1,2,3\n", "no readings"),
        ("wx,wy,wz,gx,gy,gz\n1,2,3,4,5,\n", "test 1: gz is not a finite number"),
        ("wx,wy,wz,gx,gy,gz\n1,2,3,4,5,nan\n", "not a finite number"),
        ("wx,wy,wz,gx,gy,gz (m)\n1,2,3,4,5,6\n", "unit"),
        ("wx,wx,wz,gx,gy,gz\n1,2,3,4,5,6\n", "twice"),
        ("wx,wy,wz,gx,gy,gz\n1,2,3,4,5,6\n", "too few"),
    ],
)
def test_tables_that_say_too_little_get_a_sentence(text, said, tmp_path, monkeypatch, capsys):
    file = tmp_path / "x.csv"
    file.write_text(text)
    status, out, err = command(monkeypatch, capsys, "lab", "known-input", file)
    assert status == (1 if said == "too few" else 2)
    assert out == ""
    assert said in err
    assert len(err.splitlines()) == 1


def test_the_lab_lists_its_commands_without_loading_them(monkeypatch, capsys):
    status, out, _ = command(monkeypatch, capsys, "lab", "--help")
    assert status == 0
    for name in ("known-input", "scalar", "paper"):
        assert name in out
    assert "Calibrate against the magnitude of gravity alone" in " ".join(out.split())
    assert command(monkeypatch, capsys, "lab", "nonsense")[0] == 2
    status, _, err = command(monkeypatch, capsys, "lab")
    assert (status, len(err.splitlines())) == (2, 1)


def test_papers_are_found_and_printed(monkeypatch, capsys, tmp_path):
    assert {"000", "001", "004"} <= set(numbers())
    status, out, _ = command(monkeypatch, capsys, "lab", "paper", "000", "--json", tmp_path / "p")
    assert status == 0
    document = json.loads((tmp_path / "p").read_text())
    assert {c["verdict"] for c in document["claims"]} == {
        "holds", "holds, corrected", "does not hold"}  # fmt: skip
    for claim in document["claims"]:
        assert claim["claim"][:10] in out
    status, _, err = command(monkeypatch, capsys, "lab", "paper", "042")
    assert status == 2
    assert "There is no paper 042" in err
    status, _, err = command(monkeypatch, capsys, "lab", "paper", "002")
    assert status == 2
    assert "handcal sweep" in err
    assert "no paper 002" not in err


@pytest.mark.prove
@pytest.mark.parametrize("number", ["000", "001", "004"])
def test_pages_of_papers_are_what_the_code_computes(number):
    """If not: `make docs`, or docs/make_paper_tables.py alone."""
    from pathlib import Path

    page = Path(__file__).resolve().parents[1] / "docs" / f"paper-{number}.md"
    assert markdown(computed(number).tables()) in page.read_text(encoding="utf-8")


# --- what does not fit (issue 75) ---------------------------------------------------------------


def six_sides(asymmetry, noise=0.02, seed=0):
    """Averages of the six sides of a device whose z reads up and down differently."""
    f = 9.80665 * np.vstack([np.eye(3), -np.eye(3)])
    read = f * [1.005, 0.99, 1.01] + [0.1, -0.2, 0.15] + asymmetry * np.abs(f) * [0.0, 0.1, 1.0]
    read += noise * np.random.default_rng(seed).standard_normal(f.shape)
    return steady_tests.of_arrays(None, f, None, read, (1e-11, 1e-11))


def test_a_misfit_is_none_of_too_few_tests_and_names_what_would_leave_less():
    with pytest.raises(HandcalError) as refused:
        known_input(six_sides(-0.15), ACCEL)
    said = str(refused.value)
    assert re.match(r"These effects leave \d+ mg of the accelerometer's readings unexplained", said)
    assert "add tests" not in said.lower()
    option = re.search(r"accel_asymmetry would leave ([\d.]+) mg: --effects (\S+)\.$", said)
    assert float(option[1]) < 10.0
    again = known_input(six_sides(-0.15), option[2].split(","))
    z = next(p for p in again.parameters if (p.effect, p.name) == ("accel_asymmetry", "z"))
    assert abs(z.value + 0.15) < 4.0 * z.sigma


def test_a_misfit_that_no_effect_explains_is_said_to_be_one():
    rng = np.random.default_rng(1)
    b = six_sides(0.0)
    torn = replace(b, reading=b.reading + np.r_[0, 0, 0, 3, 3, 3] * rng.standard_normal((6, 6)))
    with pytest.raises(HandcalError, match="no further effect would leave half of it"):
        known_input(torn, ACCEL)


def test_sides_that_fit_are_calibrated_without_a_word():
    assert not any("unexplained" in w for w in known_input(six_sides(0.0), ACCEL).warnings)


def test_six_averages_typed_in_by_hand(cases, monkeypatch, capsys):
    path = cases / "six_sides_averages.csv"
    status, _, said = command(monkeypatch, capsys, "lab", "known-input", path)
    assert status == 1
    assert "accel_asymmetry would leave" in said
    effects = said.split("--effects ")[1].strip().rstrip(".")
    status, out, _ = command(monkeypatch, capsys, "lab", "known-input", path, "--effects", effects)
    assert status == 0
    assert "Accelerometer asymmetry z" in out

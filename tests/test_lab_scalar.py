"""Calibration against the size of gravity: rests in many attitudes, and the turns between."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hand_world import Held, alternating, record, turns
from lab_world import command, off, recording
from proved import proved
from scipy.optimize import least_squares

import handcal
from handcal.compiled.so3 import matrix_exp, matrix_log
from handcal.device.apply import apply, read
from handcal.estimate.regression import BIASES as CONSTANT
from handcal.estimate.regression import unknowns
from handcal.lab.norm_rows import Problem, carried_by_gyro, unit
from handcal.lab.papers import paper_001
from handcal.lab.scalar import DEFAULT, from_poses, halves, of_few_rests, scalar
from handcal.lab.stretches import extra_variance, means
from handcal.lab.turns import turns as between
from handcal.recordings import segment
from handcal.types import HandcalError, Imu, InputError

G = 9.80665


def directions(n, seed=0):
    u = np.random.default_rng(seed).standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def table():
    """Table poses of a consumer device."""
    return recording("table-poses")


# --- poses alone --------------------------------------------------------------------------------


def test_exact_readings_give_the_parameters_to_rounding():
    f = G * directions(30)
    M = np.eye(3) + np.array([[0.02, 0, 0], [0.01, -0.03, 0], [-0.02, 0.015, 0.01]])
    bias, lean = np.array([0.3, -0.5, 0.1]), [0.01, -0.02, 0.005]
    u = f @ M.T + bias + np.abs(f) * lean
    of, x, _ = from_poses(u, (*DEFAULT[:2], "accel_asymmetry"))
    got = {(p.effect, p.param.name): v for p, v in zip(of, x, strict=True)}
    want = {
        **{("accel_bias", a): v for a, v in zip("xyz", bias, strict=True)},
        **{("accel_scale", a): M[i, i] - 1.0 for i, a in enumerate("xyz")},
        **{("accel_misalignment", n): M["xyz".index(n[0]), "xyz".index(n[1])]
           for n in ("yx", "zx", "zy")},
        **{("accel_asymmetry", a): v for a, v in zip("xyz", lean, strict=True)},
    }  # fmt: skip
    assert got == pytest.approx(want, abs=1e-12)


def test_products_that_a_length_cannot_tell_apart_are_named():
    """f_x f_y f_z is in the length by x_yz, y_xz and z_xy alike."""
    with pytest.raises(HandcalError) as refused:
        from_poses(G * directions(40), (*DEFAULT[:2], "accel_cross_products"))
    for name in ("x_yz", "y_xz", "z_xy"):
        assert name in str(refused.value)
    assert "x_xy" not in str(refused.value)


def test_it_is_the_least_squares_of_the_norm():
    """With equal noise on all axes: scipy on the length of the corrected readings alone.

    The noise of a length is that along the force, up to the errors themselves (2 %); both
    minimise it, so they differ by a small part of a sigma.
    """
    rng = np.random.default_rng(0)
    f, sigma = G * directions(18), 3e-3
    u = f * [1.01, 0.99, 1.005] + [0.2, -0.1, 0.05] + sigma * rng.standard_normal(f.shape)
    _, x, P = from_poses(u, sigma=sigma)

    def lengths(p):
        M = np.diag(1.0 + p[3:6])
        M[1, 0], M[2, 0], M[2, 1] = p[6:]
        return np.linalg.norm(np.linalg.solve(M, (u - p[:3]).T), axis=0) - G

    other = least_squares(lengths, np.zeros(9), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    z = (x - other) / np.sqrt(np.diag(P))
    assert np.abs(z).max() < 0.1
    assert np.abs(z).max() > 0.0


def test_its_sigmas_are_right():
    """N = 60 draws of 12 readings: normalised squared errors have mean 9, sd sqrt(2 9 / N)."""
    f, sigma = G * directions(12, 1), 2e-3
    true = np.array([0.2, -0.1, 0.05, 0.01, -0.01, 0.005, 0, 0, 0])
    total = 0.0
    for seed in range(60):
        noise = sigma * np.random.default_rng(seed).standard_normal(f.shape)
        _, x, P = from_poses(f * (1 + true[3:6]) + true[:3] + noise, sigma=sigma)
        total += (x - true) @ np.linalg.solve(P, x - true)
    assert abs(total / 60 - 9.0) < 4.0 * np.sqrt(2 * 9 / 60)


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        (G * directions(8), "too few"),
        (np.tile(G * directions(1), (20, 1)), "No reading changes"),
        (np.vstack([np.eye(3), -np.eye(3)] * 3) * G, "accel_misalignment"),
        (np.full((12, 3), np.nan), "not finite"),
        (np.full((12, 3), 1e9) * directions(12), "do not fit"),
    ],
)
def test_poses_that_do_not_tell_are_refused_in_a_sentence(reading, said):
    with pytest.raises(HandcalError, match=said):
        from_poses(reading)


def test_what_is_unseen_is_named_rightly():
    """All rests with z level: z's scale, bias and misalignments change no length."""
    angle = np.linspace(0.0, 6.0, 14)
    f = G * np.stack([np.cos(angle), np.sin(angle), np.zeros(14)], axis=1)
    with pytest.raises(HandcalError) as refused:
        from_poses(f)
    for name in ("accel_bias z", "accel_scale z", "accel_misalignment zx"):
        assert name in str(refused.value)
    for name in ("accel_bias x", "accel_scale y", "accel_misalignment yx"):
        assert name not in str(refused.value)


def test_extra_variance_is_what_the_residuals_lack():
    """The moment equation: sum r^2 / (v + extra) = dof."""
    rng = np.random.default_rng(0)
    v = rng.uniform(0.5, 2.0, 200)
    r = np.sqrt(v + 3.0) * rng.standard_normal(200)
    extra = extra_variance(r, v, 190.0)
    assert (r**2 / (v + extra)).sum() == pytest.approx(190.0, rel=1e-3)
    assert extra == pytest.approx(3.0, abs=4 * np.sqrt(2 / 200) * 4.2)
    assert extra_variance(0.1 * r, v, 190.0) == 0.0


# --- recordings ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exact():
    """Without noise, at 50 and 100 Hz."""
    made = [recording("table-poses", perfect=True, rate_hz=r)
            for r in (50.0, 100.0)]  # fmt: skip
    return [scalar(r) for r in made]


def test_a_recording_without_noise_gives_back_what_was_injected(exact):
    slow, fast = (off(result.parameters) for result in exact)
    assert np.abs(fast["accel"]).max() < 1e-12
    assert len(fast["accel"]) == 9
    # the gyro's readings are known at the samples only: fourth order in their distance
    assert np.abs(fast["gyro"]).max() < 1e-9
    assert len(fast["gyro"]) == 12
    assert 8.0 < np.abs(slow["gyro"]).max() / np.abs(fast["gyro"]).max() < 32.0
    assert np.abs(exact[1].norm[:, 1]).max() < 1e-12
    assert np.abs(exact[1].norm[:, 0]).max() > 0.1


def test_derivatives_of_a_turn_are_its_differences(exact):
    result = exact[0]
    acting = (*CONSTANT, *handcal.effects.select([*DEFAULT, "gyro_g_sensitivity"]))
    problem = Problem(acting, unknowns(acting), result.rests, result.turns, G)
    k = len(problem.unknowns)
    rng = np.random.default_rng(0)
    x = 5e-3 * rng.standard_normal(k)
    d = unit(result.rests.reading[:, 3:])
    C, slope = carried_by_gyro(problem, x, d)
    for _ in range(3):
        e = 1e-5 * rng.standard_normal(k)
        up, down = carried_by_gyro(problem, x + e, d)[0], carried_by_gyro(problem, x - e, d)[0]
        # the slope's own integral is of second order in the sampling
        want = 0.5 * matrix_log(down.transpose(0, 2, 1) @ up)
        assert np.abs(slope @ e - want).max() < 2e-3 * np.abs(want).max()
    assert np.abs(C @ C.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12


@pytest.mark.prove
def test_a_drifting_gyro_bias_harms_neither_scale_nor_its_own_sigma(table):
    """A bias that climbs by 0.2 deg/s: turns are judged by the rests around them."""
    r = table
    climb = np.radians(0.2) * (r.imu.t / r.imu.t[-1] - 0.5)
    drifting = replace(r, imu=replace(r.imu, gyro=r.imu.gyro + climb[:, None]))
    plain, moved = scalar(r), scalar(drifting)
    for p, q in zip(plain.parameters, moved.parameters, strict=True):
        if p.effect in ("gyro_scale", "gyro_misalignment"):
            assert abs(p.value - q.value) < p.sigma
    bias = [p for p in moved.parameters if p.effect == "gyro_bias"]
    # a uniform climb has standard deviation range / sqrt(12); rests stand all along it
    assert bias[0].sigma == pytest.approx(np.radians(0.2) / np.sqrt(12), rel=0.3)


def test_saturated_turns_are_left_out_and_counted(table):
    r = table
    a, b = np.searchsorted(r.imu.t, (5.5, 6.0))
    valid = r.imu.valid.copy()
    valid[a:b] = False
    gyro = r.imu.gyro.copy()
    gyro[a:b] = 35.0
    result = scalar(replace(r, imu=replace(r.imu, gyro=gyro, valid=valid)))
    assert len(result.turns) == len(result.rests) - 2
    assert "1 of the turns" in " ".join(result.warnings)
    assert np.abs(off(result.parameters, sigmas=True)["gyro"]).max() < 5.0


def test_effects_that_rests_cannot_show_are_refused(table):
    r = table
    refused = {"gravity": "place", "gyro_temperature": "temperature", "nonsense": "Unknown",
               "heading_delay": "no constant error"}  # fmt: skip
    for name, said in refused.items():
        with pytest.raises(InputError, match=said):
            scalar(r, (name,))
    with pytest.raises(HandcalError, match="lever_arm"):
        scalar(r, (*DEFAULT, "lever_arm"))


def test_a_recording_without_rests_is_refused(table):
    r = table
    shaking = 3.0 * np.sin(20.0 * r.imu.t)[:, None] * np.ones(3)
    with pytest.raises(HandcalError, match="No rest"):
        scalar(replace(r, imu=replace(r.imu, gyro=r.imu.gyro + shaking)))
    n = np.searchsorted(r.imu.t, 30.0)
    imu = Imu(r.imu.t[:n], r.imu.gyro[:n], r.imu.accel[:n], r.imu.valid[:n])
    with pytest.raises(HandcalError, match="too few"):
        scalar(replace(r, imu=imu))


@pytest.mark.prove
def test_sigmas_of_simulated_tables():
    """30 devices: normalised errors of 15 parameters each. Those of one device are correlated
    and its noise levels are estimated from few rests, so the band is wide: 0.8 to 1.25."""
    z = [off(scalar(recording("table-poses", seed=s)).parameters, sigmas=True) for s in range(30)]
    for sensor in ("accel", "gyro"):
        rms = np.sqrt(np.mean([np.mean(one[sensor] ** 2) for one in z]))
        print(f"\n{sensor}: rms of errors in sigmas {rms:.3f} over 30 devices")
        assert 0.8 < rms < 1.25


# --- real hands ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["array_1_imu5", *proved("array_2_imu3")])
def test_real_rests_to_a_hundredth_and_halves_that_agree(name, real_recordings):
    """Issue 5: 20 rest poses; norm within 0.01 m/s^2; both halves within 3 sigma."""
    result = scalar(handcal.load(real_recordings / f"{name}.mcap"))
    assert len(result.rests) >= 20
    before, after = np.abs(result.norm).max(axis=0)
    assert before > 0.3
    assert 1e-5 < after < 0.01
    a, b = halves(result)
    apart = [abs(p.value - q.value) / np.hypot(p.sigma, q.sigma)
             for p, q in zip(a.parameters, b.parameters, strict=True)]  # fmt: skip
    print(f"\n{name}: norm {before:.3f} to {after:.4f} m/s^2, halves apart {max(apart):.2f} sigma")
    assert max(apart) < 3.0
    # and not because the halves know nothing: each parameter better than is usual
    assert all(p.sigma < p.prior_sigma for p in (*a.parameters, *b.parameters))
    assert np.sqrt((result.closure[:, 1] ** 2).mean()) < 0.5 * np.sqrt(
        (result.closure[:, 0] ** 2).mean()
    )


# As somebody else calibrated the same recordings: value and tolerance, in order of the names.
PUBLISHED = {
    # imu_tk
    "xsens_poses": {
        "accel_bias": ((0.858, 1.222, -0.973), 0.02),
        "accel_scale": ((-0.0013, -0.0070, -0.0011), 0.003),
        "accel_misalignment": ((0.0035, 0.0090, 0.0213), 0.004),
        "gyro_bias": ((0.0019, -0.0642, -0.0534), 0.002),
        "gyro_scale": ((-0.0046, -0.0063, -0.0054), 0.008),
        "gyro_misalignment": ((-0.0095, -0.0102, -0.0056, 0.0321, -0.0163, 0.0240), 0.012),
    },
    # imucal, which is told that the sides are square and that each turn closes
    "nilspod_ferraris": {
        "accel_bias": ((0.537, -0.616, 0.399), 0.06),
        "accel_scale": ((-0.0033, 0.0024, 0.0234), 0.006),
        "accel_misalignment": ((-0.0063, 0.0060, 0.0041), 0.01),
        "gyro_bias": ((-0.0105, -0.0065, 0.0010), 0.002),
        "gyro_scale": ((0.0278, -0.0177, -0.0017), 0.01),
        "gyro_misalignment": ((0.0148, 0.0011, -0.0148, -0.0046, 0.0021, 0.0096), 0.02),
    },
}


@pytest.mark.parametrize(
    "name",
    ["nilspod_ferraris", *proved("xsens_poses")],
)
def test_real_devices_agree_with_published_calibrations(name, real_recordings):
    result = scalar(handcal.load(real_recordings / "devices" / f"{name}.mcap"))
    found = {e: [p for p in result.parameters if p.effect == e] for e in PUBLISHED[name]}
    assert sum(len(p) for p in found.values()) == len(result.parameters) == 21
    for effect, (values, tolerance) in PUBLISHED[name].items():
        for p, value in zip(found[effect], values, strict=True):
            assert abs(p.value - value) < tolerance, (effect, p.name, p.value)
            assert p.sigma < tolerance, (effect, p.name, p.sigma)


# Mikov, Reginya and Moschevikin (2020), in per cent, each to 0.12; a common factor of the
# accelerometer's scales is their gravity.
IMU_CALIB = {
    0: {"accel_scale": (0.363, 0.315, 0.647), "gyro_scale": (0.041, 0.457, 0.826)},
    3: {"accel_scale": (0.263, 0.448, 0.721), "gyro_scale": (0.227, 0.599, 0.308)},
}


@pytest.mark.prove
@pytest.mark.parametrize("device", [3, 0])
def test_rests_a_few_samples_apart_calibrate_as_published(device, real_recordings):
    """Issue 75: in the recording of device 3 two pauses are three samples apart."""
    result = scalar(handcal.load(real_recordings / "devices" / f"imu_calib_{device}.csv"))
    for effect, per_cent in IMU_CALIB[device].items():
        own = [p for p in result.parameters if p.effect == effect]
        apart = np.array([p.value for p in own]) - 0.01 * np.array(per_cent)
        sigma = np.hypot(0.0012, [p.sigma for p in own])
        if effect == "accel_scale":
            apart -= np.average(apart, weights=1.0 / sigma**2)
        assert np.abs(apart / sigma).max() < 2.0, (effect, apart)


def test_a_turn_of_three_samples_is_one(table):
    """Issue 75: two rests as near as that gave a turn of which nothing was a number."""
    rests = means(table, segment.with_pauses(table))
    a, b = int(rests.first[0]), int(rests.last[0])
    middle = (a + b) // 2
    near = means(
        table,
        np.array(
            [[table.imu.t[a], table.imu.t[middle]], [table.imu.t[middle + 2], table.imu.t[b]]]
        ),
    )
    found = between(table, near)
    assert len(found) == 1
    assert 0.0 < found.missed[0] < 1e-3


def test_an_accelerometer_alone_is_calibrated(table, tmp_path, monkeypatch, capsys):
    imu = table.imu
    path, numbers = tmp_path / "a.csv", tmp_path / "a.json"
    header = "t,ax,ay,az"
    np.savetxt(path, np.c_[imu.t, imu.accel], delimiter=",", header=header, comments="")
    status, out, _ = command(monkeypatch, capsys, "lab", "scalar", path, "--json", numbers)
    assert status == 0
    assert "Gyro" not in out
    found = json.loads(numbers.read_text())["parameters"]
    both = {(p.effect, p.name): p for p in scalar(table).parameters}
    assert len(found) == 9
    for p in found:
        other = both[p["effect"], p["name"]]
        assert abs(p["value"] - other.value) < 3.0 * np.hypot(p["sigma"], other.sigma)
        assert p["sigma"] < 3.0 * other.sigma
    said = command(monkeypatch, capsys, "lab", "scalar", path, "--effects", "gyro_scale")
    assert said[0] == 2
    assert "holds the accelerometer alone" in said[2]


@pytest.mark.prove
def test_a_misfit_of_rests_names_what_would_leave_less(table):
    """Issue 75: it was called a lack of rests."""
    lean = table.imu.accel + 0.2 * np.abs(table.imu.accel) * [0.0, 0.0, 1.0]
    with pytest.raises(HandcalError) as refused:
        scalar(replace(table, imu=replace(table.imu, accel=lean)))
    said = str(refused.value)
    assert re.match(r"These effects leave .* unexplained; accel_asymmetry would leave", said)
    assert "--effects accel_scale,accel_misalignment,gyro_scale,gyro_misalignment,accel_asy" in said


@pytest.mark.prove
def test_info_and_lab_scalar_agree_about_ten_rests(cases, monkeypatch, capsys):
    path = cases / "ten_rests_real.csv"
    status, _, refusal = command(monkeypatch, capsys, "lab", "scalar", path)
    assert status == 1
    asked = re.search(r"These would work: --effects (\S+)\.$", refusal.strip())[1]
    _, out, _ = command(monkeypatch, capsys, "info", path)
    assert f"--effects {asked}" in " ".join(out.split())
    numbers = ["--effects", asked, "--json", "-"]
    status, out, _ = command(monkeypatch, capsys, "lab", "scalar", path, *numbers)
    assert status == 0
    # as published, in per cent and mg
    found = [(p["effect"], p["value"], p["sigma"]) for p in json.loads(out)["parameters"]]
    for effect, si, published in (
        ("accel_scale", 0.01, (-0.57, 0.29, 2.16)), ("accel_bias", G * 1e-3, (43.4, -21.9, -112.3)),
    ):  # fmt: skip
        own = [(value, sigma) for e, value, sigma in found if e == effect]
        for (value, sigma), known in zip(own, published, strict=True):
            assert abs(value - si * known) < 3.0 * sigma, effect


def test_few_rests_are_refused_with_the_effects_that_would_work(table):
    """Eight rests: seven unknowns of the accelerometer are one less than they are."""
    rests = means(table, segment.with_pauses(table))
    end = rests.span[7, 1] + 0.2
    m = table.imu.t < end
    imu = Imu(*(x[m] for x in (table.imu.t, table.imu.gyro, table.imu.accel, table.imu.valid)))
    short = replace(table, imu=imu, streams={})
    with pytest.raises(HandcalError, match="too few") as refused:
        scalar(short)
    asked = re.search(r"These would work: --effects (\S+)\.$", str(refused.value))[1]
    result = scalar(short, asked.split(","))
    assert {p.effect for p in result.parameters} >= {"accel_scale", "gyro_scale"}
    assert asked in of_few_rests(short)


# What is injected in the next test: small, of all kinds.
OWN = {"accel_bias": (0.2, -0.1, 0.3), "accel_scale": (0.01, -0.02, 0.015),
       "accel_misalignment": (0.01, -0.008, 0.005)}  # fmt: skip


def held_poses(seed):
    """Twenty poses held by hand, half of them with ten times the tremor of the others."""
    quiet, loud = Held(5.0, 0.1, 0.03, 0.1), Held(5.0, 1.0, 0.3, 0.3)
    world, _ = record(alternating([quiet, loud] * 10, turns(19, seed)), seed)
    M = np.diag(1.0 + np.array(OWN["accel_scale"]))
    M[1, 0], M[2, 0], M[2, 1] = OWN["accel_misalignment"]
    accel = world.imu.accel @ M.T + OWN["accel_bias"]
    return replace(world, imu=replace(world.imu, accel=accel))


@pytest.mark.prove
def test_poses_held_by_hand_calibrate_with_the_noise_each_has():
    """Six hands; nine parameters of the accelerometer each. Of 54 normalised errors the mean
    square is 1 with a standard deviation of 0.19 where independent; those of one device are not,
    so up to twice that, three times."""
    z = []
    for seed in range(6):
        result = scalar(held_poses(seed), tuple(list(OWN)[1:]))
        assert len(result.rests) == 20
        spread = result.rests.variance[:, 3:].mean(axis=1)
        assert spread[1::2].min() > 4.0 * spread[::2].max()
        for effect, values in OWN.items():
            own = [p for p in result.parameters if p.effect == effect]
            z += [(p.value - v) / p.sigma for p, v in zip(own, values, strict=True)]
    assert len(z) == 54
    assert abs(np.mean(np.square(z)) - 1.0) < 3.0 * 2.0 * 0.19


# --- paper 001 ----------------------------------------------------------------------------------


def test_paper_001_table_2_has_its_condition_number():
    """Printed 263.6104; the nominal angles of 30'' in its table 3 make the difference."""
    assert paper_001.condition(paper_001.up_of(paper_001.TABLE_2)) == pytest.approx(
        263.61, abs=5e-3
    )


def test_paper_001_floor_is_there_and_goes():
    assert 100 * paper_001.floor().angle == pytest.approx(0.86, abs=0.005)
    u = paper_001.readings(paper_001.force(np.radians(paper_001.TABLE_2)))
    left = paper_001.relative(paper_001.iterated(u), paper_001.truth())
    assert max(left.angle, left.scale, left.bias) < 1e-9


@pytest.mark.prove
def test_paper_001_own_nine_poses_beat_table_2_on_the_same_draws():
    """N = 50 draws at 600 arcsec; handcal's estimate needs no angle, the paper's does."""
    nine = paper_001.gimbals_of(paper_001.own_poses(9))
    sets = [np.radians(paper_001.TABLE_2), nine]
    two, own = paper_001.imitation(sets, paper_001.ANGLE, np.random.default_rng(0), False, 50)
    (mine,) = paper_001.imitation_iterated(
        [nine], paper_001.ANGLE, np.random.default_rng(0), 0.0, 5
    )
    assert max(mine.scale, mine.bias) < 1e-6 < min(two.scale, two.bias)
    assert own.scale < two.scale
    assert own.bias < two.bias


def test_gimbal_angles_bring_a_direction_up():
    up = directions(9)
    np.testing.assert_allclose(
        paper_001.force(paper_001.gimbals_of(up)), paper_001.GRAVITY * up, atol=1e-13
    )
    z, x, y = np.radians(paper_001.TABLE_2[3])
    e = np.eye(3)
    C = matrix_exp(y * e[1]) @ matrix_exp(x * e[0]) @ matrix_exp(z * e[2])
    np.testing.assert_allclose(
        C.T @ [0, paper_001.GRAVITY, 0], paper_001.force(np.array([z, x, y])), atol=1e-13
    )


# --- the command --------------------------------------------------------------------------------


def test_the_command_writes_what_apply_takes(real_recordings, tmp_path, monkeypatch, capsys):
    source = real_recordings / "array_1_imu5.mcap"
    numbers, page = tmp_path / "s.json", tmp_path / "s.html"
    status, out, _ = command(
        monkeypatch, capsys, "lab", "scalar", source, "--json", numbers, "--report", page
    )
    assert status == 0
    assert "Accelerometer scale x" in out
    document = json.loads(numbers.read_text())
    assert document["schema"] == "handcal/calibration/1"
    assert len(document["rests"]) == 21
    assert len(document["halves"]) == len(document["parameters"]) == 21
    assert page.read_text().count("<svg") == 3
    corrected = apply(handcal.load(source), read(numbers), biases=True).recording
    lengths = []
    for rest in document["rests"]:
        m = (corrected.imu.t >= rest["from_s"]) & (corrected.imu.t <= rest["to_s"])
        lengths.append(np.linalg.norm(corrected.imu.accel[m].mean(axis=0)) - G)
    assert np.abs(lengths).max() < 0.01


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["nothing-there.mcap"], 2),
        (["x.csv", "--gravity", "5"], 2),
        (["x.csv", "--gravity", "9.8", "--latitude", "50"], 2),
        (["x.csv", "--effects", "nonsense"], 2),
        (["x.csv"], 1),
    ],
)
def test_wrong_use_is_one_line(arguments, status, tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.01)
    read = np.tile([0, 0, 0, 0, 0, G], (len(t), 1)) + 1e-3 * rng.standard_normal((len(t), 6))
    header = "t,gx,gy,gz,ax,ay,az"
    np.savetxt(tmp_path / "x.csv", np.c_[t, read], delimiter=",", header=header, comments="")
    file, *options = arguments
    done = command(monkeypatch, capsys, "lab", "scalar", tmp_path / file, *options)
    assert done[0] == status
    assert len(done[2].splitlines()) == 1
    assert done[1] == ""

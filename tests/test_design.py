"""Poses and motions that tell most: against the papers, geometry and brute force."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from handcal.commands._app import app
from handcal.design.motion import Plan, plan
from handcal.design.poses import NOISE, PLAIN, Experiment, everywhere, experiment
from handcal.design.search import (
    CRITERIA,
    anywhere,
    design,
    efficiency_function,
    judged,
    one_by_one,
    value,
)
from handcal.earth import STANDARD_GRAVITY
from handcal.effects import select
from handcal.estimate.calibration import calibrate
from handcal.estimate.case import case_of, problem_with
from handcal.motions import MOTIONS, recording_of
from handcal.show.design.motion_report import print_motions, sentences
from handcal.show.design.picture import save_picture
from handcal.show.design.words import attitude_of, instruction
from handcal.types import Array, HandcalError, Imu, InputError, Recording, Series

STATIC = ("accel_scale", "accel_misalignment")
# Paper 001, table 2: angles of the gimbals Z, X and Y, deg.
TABLE_2 = np.array(
    [
        [0.0, 90.0074, -90.0, -136.0061, 138.6793, 50.5226, 135.177, -136.9260, -43.8877],
        [0.0, -89.9926, 0.5947, 35.6601, 36.9652, 33.2264, -34.32, -34.5039, 36.9528],
        [0.0, 90.0, 0.5947, 77.0549, -83.1103, -16.0279, 73.648, -76.3967, 15.3341],
    ]
)
# Paper 004, table 2.
NINE = np.array(
    [[1, 0, 0], [-1, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 0], [0, -1, 0], [0, 1, 1], [0, 0, 1],
     [0, 0, -1]], dtype=float
)  # fmt: skip
NINE /= np.linalg.norm(NINE, axis=1, keepdims=True)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def turn(axis: int, degrees: float) -> Array:
    """Rotation (3, 3) about one axis, by hand."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[[i, j, i, j], [i, j, j, i]] = c, c, -s, s
    return R


def printed_poses() -> Array:
    """Paper 001's nine: gravity along Y, seen through gimbals Y X Z."""
    up = [turn(1, y) @ turn(0, x) @ turn(2, z) for z, x, y in TABLE_2.T]
    return np.array([R.T @ [0.0, 1.0, 0.0] for R in up])


def printed_matrix(up: Array, g: float) -> Array:
    """Rows of paper 001, equation 8, by hand: of the sum of squared readings, SI units."""
    x, y, z = g * up.T
    return 2.0 * np.stack([x * x, y * y, z * z, x, y, z, x * y, x * z, y * z], axis=1)


def test_table_2_of_paper_001_has_the_printed_condition_number() -> None:
    A = printed_matrix(printed_poses(), 9.815)
    assert np.linalg.cond(A.T @ A) == pytest.approx(263.6104, abs=1e-3)


def test_rows_are_those_of_the_paper_but_for_units() -> None:
    e = experiment(STATIC)
    up = printed_poses()
    ours = e.jacobian(up)[:, 0] / e.scale * NOISE[1]
    x, y, z = range(3)
    names = [(u.effect, u.param.name) for u in e.unknowns]
    by_hand = {("accel_scale", "x"): (x, x), ("accel_misalignment", "zy"): (z, y)}
    for name, (i, j) in by_hand.items():
        assert ours[:, names.index(name)] == pytest.approx(
            STANDARD_GRAVITY * up[:, i] * up[:, j], abs=1e-9
        )
    assert ours[:, names.index(("accel_bias", "y"))] == pytest.approx(up[:, 1], abs=1e-12)


def test_efficiency_of_paper_001_and_own_poses() -> None:
    e = experiment(STATIC)
    # of all weightings of directions none is better than the same everywhere: the variance of
    # a predicted reading is nowhere above the number of parameters (Kiefer and Wolfowitz)
    sphere, weight = everywhere()
    M = e.information(sphere, weight)
    J = e.jacobian(np.vstack([PLAIN, sphere]))[:, 0]
    assert np.einsum("ni,ij,nj->n", J, np.linalg.inv(M), J).max() == pytest.approx(9.0, abs=1e-6)
    theirs = judged(e, printed_poses(), "D", "global", rng())
    assert theirs.d_efficiency == pytest.approx(0.830, abs=5e-4)
    assert theirs.condition == pytest.approx(16.75, abs=0.01)
    assert design(e, 9, "D", rng(), starts=4).d_efficiency >= 0.975
    twelve = design(e, 12, "D", rng(), starts=2)
    assert 0.999 <= twelve.d_efficiency <= 1.0 + 1e-12
    one_at_a_time = judged(e, one_by_one(e, 9), "D", "sequential", rng())
    assert theirs.d_efficiency < one_at_a_time.d_efficiency < 0.975


@pytest.mark.prove
def test_each_criterion_is_best_at_its_own() -> None:
    e = experiment(STATIC)
    found = {c: design(e, 10, c, rng(), starts=3) for c in CRITERIA}
    for criterion, own in found.items():
        scores = {c: value(d.information, criterion) for c, d in found.items()}
        assert scores[criterion] == min(scores.values()), scores
        assert own.d_efficiency <= 1.0
        assert own.a_efficiency <= 1.0
    # the least condition number: eigenvalues 1/3 of the biases over 1/12 of the cross terms
    M = e.information(*anywhere(e, "condition"))
    assert math.exp(value(M, "condition")) == pytest.approx(4.0, abs=0.01)


@pytest.mark.parametrize("n", [4, 6, 9, 10, 12, 13])
def test_optimum_of_paper_004_is_reached(n: int) -> None:
    e = experiment(("gyro_scale", "gyro_misalignment"), "rate")
    found = design(e, n, "D", rng(), starts=2)
    rows = np.c_[found.up, np.ones(n)]
    assert np.linalg.det(rows.T @ rows / n) == pytest.approx(1.0 / 27.0, rel=1e-9)
    assert found.d_efficiency == pytest.approx(1.0, abs=1e-9)


def test_nine_positions_of_paper_004_are_not_optimal() -> None:
    rows = np.c_[NINE, np.ones(9)]
    det = np.linalg.det(rows.T @ rows / 9)
    assert det == pytest.approx(0.0286, abs=5e-5)
    e = experiment(("gyro_scale", "gyro_misalignment"), "rate")
    theirs = judged(e, NINE, "D", "global", rng())
    assert theirs.d_efficiency == pytest.approx((27.0 * det) ** 0.25, rel=1e-9)
    assert theirs.d_efficiency == pytest.approx(0.937, abs=5e-4)
    # five positions cannot be alike in all directions
    assert design(e, 5, "D", rng(), starts=2).d_efficiency < 0.995


def test_arms_want_spins_about_the_diagonals_of_the_cube() -> None:
    e = experiment(("size_effect",), "spin", math.radians(200.0))
    four = design(e, 4, "D", rng(), starts=1)
    assert np.abs(four.up) == pytest.approx(np.full((4, 3), 1.0 / math.sqrt(3.0)), abs=1e-6)
    assert four.d_efficiency == pytest.approx(1.0, abs=1e-9)
    # off-axis arms: 1 / (omega^2 sqrt(n u_x^2 u_y^2)) = 3 / (omega^2 sqrt 4)
    off = [i for i, u in enumerate(e.unknowns) if u.param.name[0] != u.param.name[1]]
    expected = NOISE[1] * 1.5 / e.rate**2
    assert four.sigma[off] == pytest.approx(expected, rel=1e-6)
    assert "size_effect" in e.hidden(np.vstack([np.eye(3), -np.eye(3)]))


def test_sequential_design_projects_least_on_what_is_there() -> None:
    e = experiment(STATIC)
    up = one_by_one(e, 9)
    assert np.allclose(up[0], [0.0, 0.0, 1.0])
    J = e.jacobian(up) / e.scale
    for k in range(1, 9):
        rows = J[:k, 0]
        Q, _ = np.linalg.qr(rows.T)
        unit = J[k, 0] / np.linalg.norm(J[k, 0])
        share = float(np.sum((Q.T @ unit) ** 2))
        assert efficiency_function(J[k : k + 1], rows)[0] == pytest.approx(share, abs=1e-9)
        others = efficiency_function(e.jacobian(printed_poses()) / e.scale, rows)
        assert share <= others.min() + 1e-9
    A = printed_matrix(up, 9.815)
    assert np.linalg.cond(A.T @ A) < 263.6104


@pytest.mark.parametrize(
    ("effects", "known", "reason"),
    [
        (("gyro_scale",), "norm", "size of gravity"),
        (("size_effect",), "pose", "no reading at rest"),
        (("lever_arm",), "norm", "no constant error"),
        (("accel_scale",), "spin", "does not change"),
        (("gyro_bias_walk",), "pose", "no constant error"),
        (("accel_temperature",), "norm", "temperature"),
        (("gyro_g_sensitivity", "gyro_misalignment"), "rate", "apart"),
        ((), "norm", "No effects"),
        (("nonsense",), "norm", "Unknown effect"),
    ],
)
def test_what_no_pose_can_tell_is_refused(
    effects: tuple[str, ...], known: str, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        experiment(effects, known)


def test_too_few_poses_are_refused() -> None:
    with pytest.raises(HandcalError, match="at least 9 poses"):
        design(experiment(STATIC), 8, "D", rng())


def test_a_mounting_is_estimated_only_where_nothing_else_says_it() -> None:
    def ids(e: Experiment) -> list[str]:
        return [x.id for x in e.effects]

    assert "mounting" in ids(experiment(("accel_scale",), "pose"))
    assert "mounting" in ids(experiment(("gyro_scale",), "rate"))
    assert "mounting" not in ids(experiment(("gyro_scale", "gyro_misalignment"), "rate"))
    assert ids(experiment(("gyro_g_sensitivity",), "pose"))[1:] == ["gyro_bias"]


def test_sigmas_are_those_of_least_squares() -> None:
    found = design(experiment(STATIC), 12, "D", rng(), starts=1)
    e = replace(found.experiment, scale=np.ones(9))
    A = e.jacobian(found.up).reshape(-1, 9)
    expected = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    assert found.sigma == pytest.approx(expected, rel=1e-9)


def test_instructions_can_be_followed() -> None:
    assert instruction(np.array([0.0, 0.0, 1.0])) == "screen up"
    assert instruction(np.array([-1.0, 0.0, 0.0])) == "left edge up"
    half = math.sqrt(0.5)
    assert instruction(np.array([half, 0.0, half])) == "screen up, its right edge raised by 45°"
    assert instruction(np.array([0.5, 0.5, -half])) == (
        "screen down, its side between right and top raised by 45°"
    )
    for up in PLAIN:
        C = attitude_of(up)
        assert pytest.approx(up, abs=1e-12) == C[2]
        assert np.linalg.det(C) == pytest.approx(1.0)


def test_command_writes_what_it_shows(tmp_path: Path) -> None:
    options = ["design", "poses", "--n", "4", "--known", "pose", "--effects", "accel_scale"]
    files = {k: tmp_path / f"out.{k}" for k in ("json", "html", "png", "rrd")}
    more = ["--seed", "0", "--json", files["json"], "--report", files["html"],
            "--picture", files["png"], "--rrd", files["rrd"]]  # fmt: skip
    done = CliRunner().invoke(app, [*options, *map(str, more)])
    assert done.exit_code == 0, done.output
    said = json.loads(files["json"].read_text())
    assert said["schema"] == "handcal/design-poses/1"
    assert len(said["poses"]) == 4
    assert said["d_efficiency"] == pytest.approx(1.0, abs=1e-6)
    assert all(abs(np.linalg.norm(p["up"]) - 1.0) < 1e-9 for p in said["poses"])
    for pose in said["poses"]:
        assert pose["instruction"] in files["html"].read_text()
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    assert files["rrd"].stat().st_size > 1000
    again = CliRunner().invoke(app, [*options, "--seed", "0", "--json", str(tmp_path / "b.json")])
    assert again.exit_code == 0
    assert json.loads((tmp_path / "b.json").read_text()) == said


@pytest.mark.parametrize(
    ("options", "status"),
    [
        (["--effects", "gyro_scale"], 2),
        (["--n", "3"], 1),
        (["--n", "0"], 2),
        (["--known", "spin", "--effects", "size_effect", "--rate", "nan"], 2),
        (["--picture", "here.txt"], 2),
        (["--json", "/no/such/folder/a.json"], 2),
    ],
)
def test_wrong_use_is_one_sentence(options: list[str], status: int) -> None:
    done = CliRunner().invoke(app, ["design", "poses", *options])
    assert done.exit_code == status


def test_a_picture_needs_an_ending(tmp_path: Path) -> None:
    found = judged(experiment(STATIC), printed_poses(), "D", "global", rng())
    with pytest.raises(InputError, match=r"\.png"):
        save_picture(found, tmp_path / "poses.txt")


# --- motions ------------------------------------------------------------------------------------


def after(plan_: Plan, begins: str) -> dict[tuple[str, str], float]:
    """Sigmas after the motion whose sentence begins so, by parameter."""
    (one,) = [p for p in plan_.prospects if p.motion.sentence.startswith(begins)]
    return {(w.effect, w.name): float(s) for w, s in zip(plan_.wanted, one.sigma, strict=True)}


@pytest.fixture(scope="module")
def nothing_yet() -> Plan:
    return plan(["gyro_scale", "accel_bias"])


def test_motions_tell_what_they_turn_about(nothing_yet: Plan) -> None:
    prior = 0.01
    about_x = after(nothing_yet, "Begin with the screen up and turn it once about its x")
    assert about_x["gyro_scale", "x"] < 0.01 * prior
    assert about_x["gyro_scale", "y"] == pytest.approx(prior, rel=1e-3)
    assert about_x["accel_bias", "x"] == pytest.approx(0.6, rel=1e-3)
    assert about_x["accel_bias", "y"] < 0.01
    wheel = after(nothing_yet, "Hold it upright")
    assert wheel["gyro_scale", "z"] < 0.01 * prior
    assert wheel["gyro_scale", "y"] == pytest.approx(prior, rel=1e-3)
    # about the vertical nothing shows a gyro's scale, unless there is a heading
    flat = after(nothing_yet, "Hold it screen up")
    assert flat["gyro_scale", "z"] == pytest.approx(prior, rel=1e-3)
    headed = plan(["gyro_scale"], heading_sigma=math.radians(5.0))
    assert after(headed, "Hold it screen up")["gyro_scale", "z"] < 0.5 * prior
    # (equal but for rounding are those that differ in the last digits; of them the shorter first)
    order = [(-round(p.times, 6), p.motion.duration_s) for p in nothing_yet.prospects]
    assert order == sorted(order)
    assert all(s < 0.02 * prior for (e, _), s in after(nothing_yet, "Turn it once about its x axis"
               ).items() if e == "gyro_scale")  # fmt: skip


@pytest.mark.prove
@pytest.mark.parametrize("heading_sigma", [None, math.radians(5.0)], ids=["alone", "heading"])
def test_what_is_promised_is_what_the_filter_then_says(heading_sigma: float | None) -> None:
    """The motion itself, recorded without noise and calibrated at the same levels."""
    promise = plan(["gyro_scale", "accel_bias"], heading_sigma=heading_sigma)
    best = promise.prospects[0 if heading_sigma is None else -4]
    still = Recording("like", _still(), {})
    levels = {}
    if heading_sigma is not None:
        t = np.arange(0.0, 5.0, 0.02)
        still = replace(still, streams={"heading": Series(t, np.zeros((len(t), 1)))})
        # so many fewer headings say as much together
        levels = {"heading_noise": heading_sigma * math.sqrt(10.0 / 50.0)}
    recording = recording_of(best.motion, still, np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    assert recording.rate_hz == pytest.approx(50.0, rel=1e-6)
    of = problem_with(case_of(still, "fixed-point"), select(["gyro_scale"]))
    levels = {lv.name: lv.initial for lv in of.levels} | levels
    found = calibrate(recording, ["gyro_scale"], assume="fixed-point", noise=levels, only=True)
    for w, promised in zip(promise.wanted, best.sigma, strict=True):
        assert found.parameter(w.effect, w.name).sigma == pytest.approx(promised, rel=0.1)


def _still() -> Imu:
    t = np.arange(0.0, 5.0, 0.01)
    accel = np.tile([0.0, 0.0, STANDARD_GRAVITY], (len(t), 1))
    return Imu(t, np.zeros_like(accel), accel, np.ones(len(t), dtype=np.bool_))


def test_after_a_recording_nothing_becomes_less_certain() -> None:
    turn_x = next(m for m in MOTIONS if "its x axis" in m.sentence)
    like = Recording("like", _still(), {})
    recording = recording_of(turn_x, like, np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    rng_ = rng()
    noisy = replace(
        recording.imu,
        gyro=recording.imu.gyro + 0.001 * rng_.standard_normal(recording.imu.gyro.shape),
        accel=recording.imu.accel + 0.01 * rng_.standard_normal(recording.imu.gyro.shape),
    )
    known = plan(["gyro_scale"], replace(recording, imu=noisy), assume="fixed-point")
    before = np.array([w.sigma for w in known.wanted])
    assert before[0] < 1e-3 < before[1]
    for p in known.prospects:
        assert (p.sigma <= before * (1.0 + 1e-9)).all()
    # x is known: what remains is y and z, and the motions that show them come first
    assert known.best.sigma.max() < 1e-3
    assert sentences(known)[0] == known.best.motion.sentence


@pytest.mark.prove
def test_after_a_recording_with_a_magnetometer() -> None:
    """Its iron is in every fit, so it is in what a motion would tell too."""
    like_mag = np.tile([0.0, 2e-5, -4e-5], (250, 1))
    like = Recording("like", _still(), {"mag": Series(np.arange(250) * 0.02, like_mag)})
    tumble = next(m for m in MOTIONS if "Tumble" in m.sentence)
    recording = recording_of(tumble, like, np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    rng_ = rng()
    imu, mag = recording.imu, recording.streams["mag"]
    noisy = replace(
        recording,
        imu=replace(
            imu,
            gyro=imu.gyro + 0.001 * rng_.standard_normal(imu.gyro.shape),
            accel=imu.accel + 0.01 * rng_.standard_normal(imu.accel.shape),
        ),
        streams={
            "mag": replace(mag, value=mag.value + 1e-7 * rng_.standard_normal(mag.value.shape))
        },
    )
    known = plan(["gyro_scale"], noisy, assume="fixed-point")
    assert {w.effect for w in known.wanted} == {"gyro_scale"}
    before = np.array([w.sigma for w in known.wanted])
    for p in known.prospects:
        assert (p.sigma <= before * (1.0 + 1e-9)).all()
    assert known.best.times > 1.2


def test_an_effect_has_one_unit_wherever_it_is_written(nothing_yet: Plan) -> None:
    """Of a gyro's scale: per cent before, and per cent after, in sentences and in the table."""
    (scale,) = [s for s in sentences(nothing_yet) if s.startswith("Gyro scale")]
    assert " % before" in scale
    assert " % after" in scale
    console = Console(width=200, record=True, file=io.StringIO())
    print_motions(nothing_yet, console)
    assert "gyro scale, %" in console.export_text()


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        ((), "No parameters"),
        (("gyro_bias_walk",), "no constant"),
        (("heading_hard_iron",), "cannot be told"),
        (("accel_temperature",), "cannot be told"),
        (("nonsense",), "Unknown effect"),
    ],
)
def test_what_no_motion_can_tell_is_refused(wanted: tuple[str, ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        plan(list(wanted))


def test_motion_command_writes_what_it_shows(tmp_path: Path) -> None:
    files = {k: tmp_path / f"out.{k}" for k in ("json", "html", "png")}
    options = ["--reduce", "gyro_bias", "--json", files["json"], "--report", files["html"],
               "--picture", files["png"]]  # fmt: skip
    done = CliRunner().invoke(app, ["design", "motion", *map(str, options)])
    assert done.exit_code == 0, done.output
    said = json.loads(files["json"].read_text())
    assert said["schema"] == "handcal/design-motion/1"
    assert said["motions"][0]["motion"] in files["html"].read_text()
    assert said["motions"][0]["motion"].split(",")[0] in " ".join(done.output.split())
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    assert CliRunner().invoke(app, ["design", "motion"]).exit_code == 2
    for wrong in ("lever_arm,,nothing", "gyro_bias_walk"):
        assert CliRunner().invoke(app, ["design", "motion", "--reduce", wrong]).exit_code == 2

"""The blind trial: what is drawn, what is written, how it is scored."""

import dataclasses
import io
import json
import math
import sys

import numpy as np
import pytest
import schemas
import typer
from mcap.reader import make_reader
from rich.console import Console
from typer.testing import CliRunner

import handcal
from handcal.types import InputError
from handcal_sim import seal, strangers
from handcal_sim.commands import prove as proving
from handcal_sim.effects import EFFECTS
from handcal_sim.errors import SimulationError
from handcal_sim.mcap_writer import write
from handcal_sim.prove import draw, paired, run
from handcal_sim.prove import score as prove_score
from handcal_sim.prove import trial as prove_trial
from handcal_sim.prove import workers as prove_workers
from handcal_sim.prove.given import Ticket, in_turn
from handcal_sim.prove.show import show
from handcal_sim.prove.suites import BESIDE, LARGE, NEEDS, SIZES, SUITES, Answer
from handcal_sim.prove.terms import formula_fits
from handcal_sim.scenario import simulate


def promised(_world, _effect, values):
    """Nats as they are: a square of the size, less a constant."""
    return 3e4 * float(np.sum(np.square(values))) - 2.0


# ---- drawing ----------------------------------------------------------------------------


def test_sizes_are_known_for_every_effect_but_the_biases():
    assert set(SIZES) == set(EFFECTS) - {"gyro_bias", "accel_bias"}


@pytest.mark.parametrize(
    "suite",
    [
        s if s in ("one", "wild", "phone") else pytest.param(s, marks=pytest.mark.prove)
        for s in SUITES
    ],
)
def test_one_seed_gives_one_recording_and_another_seed_another(suite):
    draws = [draw.draw(suite, 2, seed, promised) for seed in (5, 5, 6)]
    (one, said), (same, again), (other, _) = draws
    np.testing.assert_array_equal(one.imu.values, same.imu.values)
    assert json.dumps(dataclasses.asdict(said)) == json.dumps(dataclasses.asdict(again))
    assert one.imu.values.shape != other.imu.values.shape or np.any(
        one.imu.values != other.imu.values
    )


def test_one_effect_each_in_turn_with_what_it_needs(monkeypatch):
    monkeypatch.setattr(draw, "simulated", lambda given, effects: (given, effects))
    monkeypatch.setattr(draw, "completed", lambda _world, drawn: drawn)
    for start in (0, len(SIZES)):
        seen = set()
        for number in range(start, start + len(SIZES)):
            (given, effects), answer = draw.draw("one", number, 3)
            (name, values), *beside = effects.items()
            seen.add(name)
            assert [n for n, _ in beside] == [BESIDE[n] for n in (name,) if n in BESIDE]
            assert list(answer.effects) == list(effects)
            assert list(answer.effects[name].values()) == values
            assert NEEDS.get(name, frozenset()) <= given.streams
            assert given.duration_s == 84.0
            assert (given.heading_hz > 0.0) != given.mag
            if name.endswith("temperature"):
                assert given.warming_K >= 10.0
            check_amplitudes(name, values, given.duration_s)
        assert seen == set(SIZES)


def check_amplitudes(name, values, duration):
    if name == "earth_rate":
        assert math.hypot(*values) == pytest.approx(7.292115e-5)
        return
    sizes = SIZES[name]
    for k, (parameter, value) in enumerate(zip(EFFECTS[name], values, strict=True)):
        if parameter.name == "at":
            assert 0.25 * duration <= value <= 0.75 * duration
            continue
        assert 0.5 <= abs(value) / sizes[min(k, len(sizes) - 1)] <= 1.5
        if parameter.name in ("tau", "density", "sigma", "fraction"):
            assert value > 0.0


def test_mixed_has_up_to_three_effects_of_any_kind_and_nothing_has_none(monkeypatch):
    monkeypatch.setattr(draw, "simulated", lambda given, effects: (given, effects))
    monkeypatch.setattr(draw, "completed", lambda _world, drawn: drawn)
    counts, motions = [], set()
    for number in range(200):
        (given, effects), answer = draw.draw("mixed", number, 1)
        counts.append(len(set(effects) - {BESIDE.get(name) for name in effects}))
        motions.add(given.scenario)
        assert set(effects) == set(answer.effects)
        assert not {"gravity", "accel_scale"} <= set(effects)
        for name in effects:
            assert NEEDS.get(name, frozenset()) <= given.streams
        if {"lever_arm", "size_effect"} <= set(effects):
            middle = np.reshape(effects["size_effect"], (3, 3)).mean(axis=0)
            np.testing.assert_allclose(middle, 0.0, atol=1e-15)
        (given, effects), answer = draw.draw("nothing", number, 1)
        assert effects == {}
        assert answer.effects == {}
        assert 50.0 <= given.rate_hz <= 400.0
        assert 1.0 <= given.heading_sigma_deg <= 30.0
    assert set(counts) == {0, 1, 2, 3}
    assert motions == {"z-turn", "three-turns", "free-hand"}


def test_a_device_warms_as_said_and_has_biases_of_any_likely_size():
    world, answer = draw.draw("one", number_of("accel_temperature"), 3)
    warm = world.streams["temperature"].values[:, 0]
    assert warm[-1] - warm[0] == pytest.approx(answer.circumstances["warming_K"], abs=0.3)
    assert warm[-1] - warm[0] > 9.7
    bias = list(answer.baseline["accel_bias"].values())
    assert max(map(abs, bias)) <= 0.080 * 9.80665
    assert world.parameters["effects"]["accel_temperature"][0]["value"] == pytest.approx(
        answer.effects["accel_temperature"]["x"]
    )


@pytest.mark.parametrize(("name", "periods"), [("heading_hard_iron", 1), ("heading_soft_iron", 2)])
def test_iron_is_compared_in_the_frame_that_headings_define(name, periods):
    """offset + a sin(n yaw) + b cos(n yaw) in terms of yaw + offset, which is all one can see."""
    world, answer = draw.draw("one", number_of(name), 3)
    offset = world.parameters["phone"]["heading_errors"]["offset"]
    yaw = np.linspace(-3.0, 3.0, 50)
    injected, seen = answer.effects[name], answer.truth(name)
    assert seen is not None
    assert seen != injected
    angle = periods * (yaw + offset)
    np.testing.assert_allclose(
        seen["sin"] * np.sin(angle) + seen["cos"] * np.cos(angle),
        injected["sin"] * np.sin(periods * yaw) + injected["cos"] * np.cos(periods * yaw),
        atol=1e-12,
    )
    assert answer.truth("gyro_scale") is None


def test_soft_iron_is_compared_in_a_field_of_unknown_strength():
    _, answer = draw.draw("one", number_of("mag_soft_iron"), 3)
    injected, seen = (
        np.array([[b[i + j] for j in "xyz"] for i in "xyz"])
        for b in (both(answer.effects["mag_soft_iron"]), both(answer.truth("mag_soft_iron")))
    )
    assert np.trace(seen) == pytest.approx(0.0, abs=1e-12)
    ratio = (np.eye(3) + injected) @ np.linalg.inv(np.eye(3) + seen)
    np.testing.assert_allclose(ratio, ratio[0, 0] * np.eye(3), atol=1e-12)


def both(bend):
    """A symmetric matrix's numbers by either order of their axes."""
    return dict(bend) | {n[::-1]: v for n, v in bend.items()}


def number_of(name, seed=3, suite="one"):
    """The number of the recording that conceals this effect."""
    drawn = (in_turn(list(SIZES), Ticket(suite, k, seed)) for k in range(len(SIZES)))
    return list(drawn).index(name)


def test_faint_effects_promise_what_was_asked(monkeypatch):
    monkeypatch.setattr(draw, "simulated", lambda given, effects: (given, effects))
    monkeypatch.setattr(draw, "completed", lambda _world, drawn: drawn)
    for number, nats in ((0, 10.0), (1, 25.0)):
        world, answer = draw.draw("faint", number, 4, promised)
        ((name, values),) = answer.effects.items()
        assert promised(world, name, list(values.values())) == pytest.approx(nats, rel=0.02)
        assert answer.group == f"{nats:g} nats"
    with pytest.raises(ValueError, match="whatever its size"):
        draw.draw("faint", 0, 4, lambda *_: 0.0)


def test_a_plan_mixes_suites_and_its_names_tell_nothing():
    cases = run.plan("all", 24, 7)
    counts = {suite: sum(case[1] == suite for case in cases) for suite in SUITES}
    assert counts == {
        "nothing": 6,
        "one": 7,
        "mixed": 5,
        "unknown": 4,
        "turn": 2,
        "faint": 0,
        "reference": 0,
        "large": 0,
        "phone": 0,
        "odometry": 0,
        "people": 0,
        "budget": 0,
        "wild": 0,
        "strange": 0,
        "axis": 0,
        "walks": 0,
        "latest": 0,
        "ordinary": 0,
    }
    assert [case[0] for case in cases] == [f"r{k:04d}" for k in range(1, 25)]
    assert cases == run.plan("all", 24, 7) != run.plan("all", 24, 8)
    assert len(run.plan("all", None, 1)) == 24
    assert len(run.plan("nothing", None, 1)) == 200
    assert {case[1] for case in run.plan("turn", 3, 1)} == {"turn"}


@pytest.mark.parametrize("number", range(8))
def test_large_errors_are_as_large_as_they_say(number):
    _, answer = draw.draw("large", number, 5)
    assert 1 <= len(answer.effects) <= 3
    for name, values in answer.effects.items():
        low, high = LARGE[name]
        assert all(low <= abs(v) <= high for v in values.values())
        assert set(NEEDS.get(name, ())) <= {
            "mag" if answer.circumstances["mag"] else "heading", "pose", "temperature"
        }  # fmt: skip


# ---- strangers --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain():
    return simulate("free-hand", seed=8, duration_s=40.0)


@pytest.mark.parametrize("kind", strangers.KINDS)
def test_strangers_change_one_channel_and_that_plainly(kind, plain):
    world, strange = strangers.estrange(kind, plain, np.random.default_rng(2))
    imu = np.flatnonzero(np.any(world.imu.values != plain.imu.values, axis=0))
    if strange.channel == "heading":
        assert len(imu) == 0
        change = world.streams["heading"].values - plain.streams["heading"].values
        change = np.angle(np.exp(1j * change[:, 0]))
    else:
        names = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
        assert [names[k] for k in imu] == [strange.channel]
        change = (world.imu.values - plain.imu.values)[:, imu[0]]
    np.testing.assert_allclose(change, np.angle(np.exp(1j * strange.error)), atol=1e-9)
    noise = {"gyro": 0.003, "accel": 0.03, "heading": 0.087}[strange.channel.split("_")[0]]
    assert np.sqrt(np.mean(change**2)) > noise
    assert strange.formula.startswith(f"{strange.channel} += ")
    assert formula_fits(strange.formula, strangers.said_of(strange)) == (True, True)
    np.testing.assert_array_equal(world.truth.omega, plain.truth.omega)


def test_strangers_are_functions_of_the_truth(plain):
    scene = strangers.scene_of(plain)
    np.testing.assert_array_equal(scene.omega, plain.truth.omega)
    np.testing.assert_array_equal(scene.f, plain.truth.f)
    assert scene.at_heading is not None
    read = plain.streams["heading"].values[:, 0]
    offset = plain.parameters["phone"]["heading_errors"]["offset"]
    off = np.angle(np.exp(1j * (read - scene.at_heading.heading - offset)))
    assert np.sqrt(np.mean(off**2)) == pytest.approx(math.radians(5.0), rel=0.1)
    rng = np.random.default_rng(0)
    play = strangers.accel_hysteresis(scene, rng)
    half = float(play.formula.split("(")[1].split()[0])
    assert np.max(np.abs(play.error)) == pytest.approx(half, abs=0.006)


@pytest.mark.parametrize(
    ("formula", "fits"),
    [
        ("accel_x += k * omega_y * T", (True, True)),
        ("accel_x += k * T * gyro_y", (True, True)),
        ("accel_x += k * omega_y", (True, False)),
        ("accel_y += k * omega_y * T", (False, False)),
        ("accel_x += k * omega_yaw * T2", (True, False)),
    ],
)
def test_formulas_are_compared_by_their_signals(formula, fits):
    assert formula_fits(formula, {"channel": "accel_x", "signals": ["T", "omega_y"]}) == fits


# ---- writing ----------------------------------------------------------------------------


def test_no_truth_is_written(tmp_path):
    world, answer = draw.draw("one", number_of("gyro_scale"), 3)
    file = tmp_path / "r.mcap"
    count = write(world, file, truth=False)
    with file.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        data = b"".join(message.data for _, _, message in reader.iter_messages())
        assert not list(reader.iter_metadata())
        assert not list(reader.iter_attachments())
    assert summary is not None
    assert summary.statistics.message_count == count
    topics = {channel.topic for channel in summary.channels.values()}
    assert topics == {"/imu", *(f"/{name}" for name in world.streams)}
    assert b"truth" not in data + file.read_bytes()
    assert handcal.load(file).imu.gyro.shape == (len(world.t), 3)
    assert answer.effects


def test_sealed_recordings_are_small_and_their_names_tell_nothing(tmp_path):
    files = seal.seal(tmp_path, 11)
    assert [file.name for file in files] == [
        *(f"sealed_{k:02d}.mcap" for k in range(1, 13)),
        "answers.json",
    ]
    assert all(file.stat().st_size < 700_000 for file in files)
    assert sum(file.stat().st_size for file in files) < 6_000_000
    answers = json.loads(files[-1].read_text())["recordings"]
    groups = sorted(answer["group"] for answer in answers.values())
    assert groups == sorted(["nothing"] * 3 + ["one"] * 5 + ["two"] * 2 + ["unknown", "gauge"])
    with pytest.raises(SimulationError, match="already"):
        seal.seal(tmp_path, 11)


# ---- scoring ----------------------------------------------------------------------------


def said(verdict, *sets, p=0.99, parameters=(), unnamed=(), gain=None, baseline=()):
    """An explanation that names these sets."""
    document = {
        "schema": "handcal/explanation/1",
        "verdict": verdict,
        "missing": [
            {
                "effect": names[0],
                "indistinguishable_from": list(names[1:]),
                "probability": p,
                "parameters": list(parameters),
            }
            for names in sets
        ],
        "unnamed": [{"formula": formula} for formula in unnamed],
        "parameters": list(baseline),
    }
    if gain is not None:
        document["held_out"] = {"log_score_before": 1.0, "log_score_after": 1.0 + gain}
    return document


def answered(*effects, suite="mixed", stranger=None, group=""):
    truth = {name: {"x": 1.0} for name in effects}
    return Answer(suite, group, truth, stranger or {}, {"gyro_bias": {"x": 0.0}})


def trial(answer, document, **expected):
    return prove_trial.Trial("r0001", answer, document, 2.0, expected)


A, B, C = "gyro_scale", "lever_arm", "gravity"
STRANGE = {"kind": "accel_rate", "channel": "accel_x", "signals": ["omega_y"]}


@pytest.mark.parametrize(
    ("truth", "document", "expected"),
    [
        ((), said("nothing_missing"), "exact"),
        ((), said("explained", [A]), "false"),
        ((), said("unexplained"), "false"),
        ((), said("cannot_tell", [A, B]), "false"),
        ((), {"error": "x"}, "failed"),
        ((A,), said("explained", [A]), "exact"),
        ((A,), said("explained", [A, B]), "exact"),
        ((A,), said("cannot_tell", [A, B]), "right_set"),
        ((A,), said("cannot_tell", [B, A]), "right_set"),
        ((A,), said("explained", [B, A]), "right_set"),
        ((A,), said("cannot_tell", [A]), "right_set"),
        ((A,), said("nothing_missing"), "missed"),
        ((A,), said("nothing_missing", [A]), "missed"),
        ((A,), said("explained", [B]), "wrong"),
        ((A,), said("explained", [A], [B]), "false"),
        ((A,), said("unexplained", [A]), "unexplained"),
        ((A,), {"error": "x"}, "failed"),
        ((A, B), said("explained", [A], [B]), "exact"),
        ((A, B), said("explained", [B], [A]), "exact"),
        ((A, B), said("cannot_tell", [A, B], [B]), "right_set"),
        ((A, B), said("cannot_tell", [C, A], [A, B]), "right_set"),
        ((A, B), said("explained", [A]), "missed"),
        ((A, B), said("cannot_tell", [A, B]), "missed"),
        ((A, B), said("explained", [A], [C]), "wrong"),
        ((A, B), said("explained", [A], [B], [C]), "false"),
    ],
)
def test_outcomes(truth, document, expected):
    assert prove_score.outcome(trial(answered(*truth), document)) == expected


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [("unexplained", "exact"), ("nothing_missing", "missed"),
     ("explained", "wrong"), ("cannot_tell", "wrong")],
)  # fmt: skip
def test_outcomes_beyond_the_catalogue(verdict, expected):
    assert prove_score.outcome(trial(answered(stranger=STRANGE), said(verdict))) == expected


def test_what_promised_too_little_is_not_judged():
    answer, nothing = answered(A, B), said("nothing_missing")
    assert prove_score.outcome(trial(answer, nothing, gyro_scale=4.9, lever_arm=1.0)) == "too_faint"
    assert prove_score.outcome(trial(answer, nothing, gyro_scale=4.9)) == "missed"
    assert prove_score.outcome(trial(answer, said("explained", [C]), gyro_scale=0.0)) == "wrong"
    faint = trial(answered(A), nothing, gyro_scale=1.0)
    (row,) = prove_score.suites([faint, trial(answered(A), said("explained", [A]))])
    assert row["right"]["n"] == row["right"]["count"] == 1
    assert row["n"] == 2
    assert row["met"] is None


@pytest.mark.parametrize(
    # Newcombe 1998, table I, method 3.
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611),
     (1, 29, 0.0061, 0.1718)],
)  # fmt: skip
def test_intervals_are_wilsons(successes, n, low, high):
    assert prove_trial.wilson(successes, n) == pytest.approx((low, high), abs=5e-5)
    assert prove_trial.wilson(0, 0) == (0.0, 1.0)


def test_each_suite_counts_as_right_what_it_asks_for():
    cannot, miss = said("cannot_tell", [A, B]), said("nothing_missing")
    rows = {
        suite: prove_score.suites([trial(answered(A, suite=suite), d) for d in (cannot, miss)])[0]
        for suite in ("one", "mixed", "turn", "faint")
    }
    assert {suite: row["right"]["count"] for suite, row in rows.items()} == {
        "one": 0, "mixed": 1, "turn": 2, "faint": 1,
    }  # fmt: skip
    assert [row["met"] for row in rows.values()] == [False, False, None, None]
    assert rows["mixed"]["mean_set_size"] == 2.0
    (grouped,) = prove_score.suites([trial(answered(A, suite="one", group="g"), miss)])
    assert grouped["met"] is None


def test_confusion_says_what_was_named_instead():
    table = prove_score.confusion([
        trial(answered(A), said("explained", [A])),
        trial(answered(A), said("cannot_tell", [B, A])),
        trial(answered(A), said("explained", [B])),
        trial(answered(A), said("nothing_missing")),
        trial(answered(A, B), said("explained", [A], [B], [C])),
        trial(answered(A), said("unexplained")),
        trial(answered(), said("explained", [C])),
        trial(answered(), said("nothing_missing")),
        trial(answered(stranger=STRANGE), said("explained", [C])),
        trial(answered(A), {"error": "x"}),
    ])  # fmt: skip
    assert table[A] == {
        "n": 6, "named": 2, "in_set": 1, "instead": {B: 1, "nothing": 1, "unexplained": 1},
    }  # fmt: skip
    assert table["nothing"] == {"n": 2, "named": 0, "in_set": 0, "instead": {C: 2}}
    assert table["unknown: accel_rate"]["instead"] == {C: 1}


def test_coverage_counts_sigmas_of_rightly_named_effects():
    def x(value, sigma=1.0, effect=A):
        return [{"effect": effect, "name": "x", "value": value, "sigma": sigma}]

    trials = [
        trial(answered(A), said("explained", [A], parameters=x(1.5))),
        trial(answered(A), said("explained", [A], parameters=x(3.0))),
        trial(answered(A), said("cannot_tell", [A, B], parameters=x(5.0))),
        trial(answered(A), said("explained", [A], parameters=x(9.0, 0.0))),
        trial(answered(A), said("explained", [B], parameters=x(9.0))),
        trial(answered(A), said("unexplained", [A], parameters=x(9.0))),
        trial(answered(), said("nothing_missing", baseline=x(0.5, effect="gyro_bias"))),
        trial(answered(), said("explained", [A], baseline=x(5.0, effect="gyro_bias"))),
    ]
    every = prove_score.coverage(trials)["all"]
    assert every["within_1_sigma"]["n"] == 3
    assert [every[f"within_{k}_sigma"]["count"] for k in (1, 3)] == [1, 2]
    assert every["rms"] == pytest.approx(math.sqrt((0.25 + 4.0 + 16.0) / 3))
    baseline = prove_score.baseline_coverage(trials)
    assert baseline["within_1_sigma"]["n"] == baseline["within_1_sigma"]["count"] == 1


def test_claims_are_compared_with_what_came_of_them():
    rows = prove_score.probabilities([
        trial(answered(A), said("explained", [A], p=0.9)),
        trial(answered(A), said("explained", [B], p=0.85)),
        trial(answered(A), said("cannot_tell", [B, A], p=1.0)),
        trial(answered(), {"error": "x"}),
    ])  # fmt: skip
    found = {row["from"]: (row["count"], row["n"]) for row in rows if row["n"]}
    assert found == {0.8: (1, 2), 0.999: (1, 1)}
    assert rows[2]["claimed"] == pytest.approx(0.875)


def test_the_rest_of_the_score_and_its_tables():
    trials = [
        trial(answered(A, suite="one"), said("explained", [A], gain=5.0)),
        trial(answered(suite="nothing"), said("nothing_missing", gain=-1.0)),
        trial(answered(B), said("explained", [A], gain=-2.0)),
        trial(
            answered(stranger=STRANGE, suite="unknown"),
            said("unexplained", unnamed=["accel_x += k * omega_y", "gyro_x += k"], gain=3.0),
        ),
        trial(answered(A, suite="turn"), {"error": "Traceback\nValueError: odd"}),
    ]
    proof = prove_score.score(trials, 5)
    schemas.check(proof)
    assert proof["unknown"] == {
        "accel_rate": {"n": 1, "unexplained": 1, "channel": 1, "formula": 1}
    }
    assert proof["held_out"]["gained"]["count"] == 2
    assert proof["held_out"]["gained"]["n"] == 3
    assert proof["held_out"]["median"] == 3.0
    assert proof["seconds"] == {"median": 2.0, "p90": 2.0, "most": 2.0}
    assert [line["outcome"] for line in proof["recordings"]] == [
        "exact", "exact", "wrong", "exact", "failed",
    ]  # fmt: skip
    assert proof == json.loads(json.dumps(proof))
    text = io.StringIO()
    show(proof, Console(file=text, width=160))
    for part in ("one", "100.0 %", "met", "gyro_scale 1", "accel_rate", "2.0 s", "ValueError: odd"):
        assert part in text.getvalue()
    show(prove_score.score([], 5), Console(file=text, width=160))


# ---- running ----------------------------------------------------------------------------


def test_a_trial_from_end_to_end_with_an_oracle(tmp_path, monkeypatch):
    folder = tmp_path / "trial"
    cases = run.plan("turn", 2, 3)
    seen = []

    def explain(file):
        assert not (folder / "answers.json").exists()
        seen.append(handcal.load(file).duration_s)
        return said("nothing_missing"), 1.5

    trials = run.run(cases, 3, folder, explain, 1, lambda: None)
    assert [t.name for t in trials] == ["r0001", "r0002"]
    assert seen == pytest.approx([30.0, 30.0], abs=0.1)
    monkeypatch.setattr(run, "expected_gain", lambda _file, _effect, values: 10.0 * len(values))
    with_limits = [run.with_limits(t, folder) for t in trials]
    assert all(list(t.expected) == list(t.answer.effects) for t in with_limits)
    run.write_answers(trials, 3, folder / "answers.json")
    written = json.loads((folder / "answers.json").read_text())["recordings"]
    assert {t.name: dict(t.answer.effects) for t in trials} == {
        name: answer["effects"] for name, answer in written.items()
    }
    assert sorted(f.name for f in (folder / "explanations").iterdir()) == [
        "r0001.json", "r0002.json",
    ]  # fmt: skip


ECHO = """
import os, sys
from handcal_sim.prove.workers import serve
def explain(path):
    print("chatter")
    if "dies" in path:
        os._exit(3)
    if "fails" in path:
        raise ValueError("odd")
    return {"path": path}
serve(explain)
"""


def test_processes_answer_fail_and_are_started_again_when_they_die(tmp_path):
    workers = prove_workers.Workers([sys.executable, "-c", ECHO], 1)
    try:
        document, taken = workers(tmp_path / "a file")
        assert document == {"path": str(tmp_path / "a file")}
        assert taken >= 0.0
        assert "ValueError: odd" in workers(tmp_path / "fails")[0]["error"]
        assert workers(tmp_path / "dies")[0] == {"error": "the process ended with status 3"}
        assert workers(tmp_path / "b")[0] == {"path": str(tmp_path / "b")}
    finally:
        workers.stop()
    with pytest.raises(prove_workers.Stopped):
        workers(tmp_path / "c")


def test_an_interrupt_leaves_what_was_explained_by_then(tmp_path):
    done = []

    def advance():
        done.append(1)
        raise KeyboardInterrupt

    cases = run.plan("turn", 4, 1)
    trials = run.run(cases, 1, tmp_path / "t", lambda _: (said("nothing_missing"), 0.1), 1, advance)
    assert len(done) == 1
    assert 1 <= len(trials) < 4


app = typer.Typer()
app.command()(proving.prove)


@pytest.fixture
def says_nothing(monkeypatch):
    """The processes that explain find nothing missing; those of another program are its own."""
    fake = "import handcal_sim.prove.workers as w; w.serve(lambda path: %r)"
    original = prove_workers.Workers.__init__

    def start(self, command, count):
        code = [sys.executable, "-c", fake % (said("nothing_missing"),)]
        original(self, command if "handcal_sim.prove.paired" in command else code, count)

    monkeypatch.setattr(prove_workers.Workers, "__init__", start)


@pytest.mark.usefixtures("says_nothing")
def test_the_command_runs_and_refuses(tmp_path, monkeypatch):
    monkeypatch.setattr(proving, "with_limits", lambda trial, _folder: trial)
    arguments = ["--suite", "turn", "--n", "2", "--seed", "3", "--out", str(tmp_path / "kept")]
    result = CliRunner().invoke(app, [*arguments, "--json", str(tmp_path / "score.json")])
    assert result.exit_code == 0, result.output
    assert "Blind trial" in result.output
    score = json.loads((tmp_path / "score.json").read_text())
    schemas.check(score)
    schemas.check(json.loads((tmp_path / "kept" / "answers.json").read_text()))
    assert score["schema"] == "handcal-sim/proof/1"
    assert score["suites"][0]["outcomes"]["missed"] == 2
    assert (tmp_path / "kept" / "answers.json").exists()
    assert "against" not in score
    again = CliRunner().invoke(app, arguments)
    assert isinstance(again.exception, InputError)
    odd = CliRunner().invoke(app, ["--suite", "odd"])
    assert isinstance(odd.exception, InputError)


# Names what is not there, and breaks off at the third recording.
OTHER = """#!{python}
import json, pathlib, sys
_, explain, recording, option, file = sys.argv
assert (explain, option) == ("explain", "--json")
if pathlib.Path(recording).stem == "r0003":
    sys.exit("It is too hard.")
pathlib.Path(file).write_text(json.dumps({document!r}))
"""


@pytest.mark.usefixtures("says_nothing")
def test_another_program_explains_the_same_recordings(tmp_path):
    other = tmp_path / "other"
    other.write_text(OTHER.format(python=sys.executable, document=said("explained", [A])))
    other.chmod(0o755)
    arguments = ["--suite", "nothing", "--n", "3", "--seed", "3", "--against", str(other)]
    kept = ["--json", str(tmp_path / "score.json"), "--out", str(tmp_path / "kept")]
    result = CliRunner().invoke(app, [*arguments, *kept])
    assert result.exit_code == 0, result.output
    assert "other alone" in result.output
    score = json.loads((tmp_path / "score.json").read_text())
    schemas.check(score)
    assert score["against"]["suites"][0]["outcomes"]["failed"] == 1
    assert score["against"]["suites"][0]["outcomes"]["false"] == 2
    assert "hard" in next(r["error"] for r in score["against"]["recordings"] if "error" in r)
    assert score["paired"] == [
        {"suite": "nothing", "both": 0, "this_alone": 3, "other_alone": 0, "neither": 0,
         "chance": pytest.approx(0.25)},
    ]  # fmt: skip
    none = CliRunner().invoke(app, [*arguments[:-1], str(tmp_path / "none")])
    assert isinstance(none.exception, InputError)


def test_an_interrupt_leaves_what_the_other_program_said_by_then(tmp_path):
    (tmp_path / "recordings").mkdir()
    cases = run.plan("nothing", 3, 3)
    trials = [
        prove_trial.Trial(name, Answer(suite, "", {}, {}, {}, {}), said("nothing_missing"), 1.0)
        for name, suite, _ in cases
    ]
    asked = []

    def explain(path):
        asked.append(path.stem)
        if len(asked) > 1:
            raise prove_workers.Stopped
        return said("explained", ["gyro_scale"]), 1.0

    def advance():
        raise KeyboardInterrupt

    others = paired.again(trials, cases, 3, tmp_path, explain, 1, advance)
    assert [t.name for t in others] == [trials[0].name]
    (row,) = paired.compared(trials, others)
    assert (row["both"], row["this_alone"], row["other_alone"], row["neither"]) == (0, 1, 0, 0)

"""The suite `ordinary`: what is drawn, that its truth is what sensors read, and its score."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import schemas
from prove_help import parameter, said
from rich.console import Console

import handcal
from handcal.device import apply as device
from handcal.device.priors import prior, read
from handcal.recordings.export import write_mcap
from handcal_sim.effects import EFFECTS
from handcal_sim.mcap_writer import write
from handcal_sim.motion import evaluate, random_start
from handcal_sim.motion_ordinary import six_sides, two_axes, yaw_on_a_table
from handcal_sim.prove import draw_ordinary, ordinary, ordinary_apply, score, score_ordinary
from handcal_sim.prove import told as told_further
from handcal_sim.prove.draw import draw
from handcal_sim.prove.draw_ordinary import RARE, SUITE, case_of, recorded
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.ordinary_devices import (
    KINDS,
    PHONE,
    SLOPES,
    SPREADS,
    TAILS,
    spread,
)
from handcal_sim.prove.ordinary_devices import (
    device as a_device,
)
from handcal_sim.prove.ordinary_numbers import asked, coverage, deviations, worst
from handcal_sim.prove.show import show
from handcal_sim.prove.suites import Answer
from handcal_sim.prove.trial import Trial

ALL_STREAMS = frozenset({"heading", "mag", "pose"})


def plain_case(wanted):
    """Number and case of the first recording of seed 0 with nothing rare that is as wanted."""
    cases = ((number, case_of(Ticket(SUITE, number, 0))) for number in range(100))
    return next((n, case) for n, case in cases if wanted(case) and not (case.rare or case.laws))


def test_a_recording_is_drawn_from_seed_and_number_alone():
    (one, first), (two, second) = (draw(SUITE, 7, 3) for _ in range(2))
    assert first == second
    np.testing.assert_array_equal(one.imu.values, two.imu.values)
    assert draw(SUITE, 8, 3)[1].effects != first.effects
    assert draw(SUITE, 7, 4)[1].effects != first.effects


@pytest.mark.parametrize("kind", KINDS)
def test_devices_of_a_class_have_its_spreads(kind):
    rng = np.random.default_rng(0)
    made = [a_device(kind, ALL_STREAMS, rng) for _ in range(300)]
    for effect in SPREADS:
        values = np.array([one.effects[effect] for one in made]) / spread(kind, effect)
        # Sigma of a variance is root 2 over n for a normal density; of the tails' (kurtosis 4.5)
        # it is root 3.5. Four of them; the diagonal of a soft iron is three numbers with two free.
        n = values.size * (5 / 6 if effect == "mag_soft_iron" else 1)
        allowed = 4.0 * math.sqrt((3.5 if effect in TAILS else 2.0) / n)
        assert abs(np.mean(values**2) - 1.0) < allowed, effect
        assert abs(values.mean()) < 4.0 / math.sqrt(n), effect
    bend = np.array([one.effects["mag_soft_iron"] for one in made])
    np.testing.assert_allclose(bend[:, :3].sum(axis=1), 0.0, atol=1e-15)


def test_most_have_nothing_rare_and_each_class_meets_each_motion(monkeypatch):
    monkeypatch.setattr(draw_ordinary, "_law", lambda *_: ("a law",))
    cases = [case_of(Ticket(SUITE, number, 0)) for number in range(400)]
    # (four sigma of a share)
    assert abs(np.mean([bool(c.rare) for c in cases]) - 0.15) < 4.0 * math.sqrt(0.15 * 0.85 / 400)
    assert abs(np.mean([bool(c.laws) for c in cases]) - 0.10) < 4.0 * math.sqrt(0.1 * 0.9 / 400)
    assert len({(c.device.kind, c.first.motion) for c in cases[:18]}) == 18
    assert {name for c in cases for name in c.rare} <= set(RARE)
    assert len({name for c in cases for name in c.rare}) > 12
    warm = [c.first.start_degC for c in cases]
    assert 5.0 <= min(warm) < 8.0
    assert 42.0 < max(warm) <= 45.0
    assert all(50 <= c.device.phone.rate_hz <= 200 for c in cases)
    assert all(c.first.motion != c.second.motion for c in cases)
    seen = [c for c in cases if c.first.thermometer]
    assert 0.78 < len(seen) / 400 < 0.92
    assert all(c.first.drift_K == 0.0 for c in cases if not c.first.thermometer)
    assert 0.4 < np.mean([c.first.drift_K != 0.0 for c in seen]) < 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_the_answer_is_what_the_sensors_read_too_much(kind):
    """Of a device without anything rare, and but for the delay."""
    number, case = plain_case(lambda case: case.device.kind == kind)
    _, answer = draw(SUITE, number, 0)
    plain = {**case.device.effects, "accel_delay": [0.0]}
    case = replace(case, device=replace(case.device, effects=plain))
    world = recorded(case, silent=True)
    true, warm = world.truth, draw_ordinary.scene_of(world).warm - answer.circumstances["mean_K"]
    e = {k: np.array(list(v.values())) for k, v in {**answer.effects, **answer.baseline}.items()}
    gyro, accel = (np.diag(e[f"{s}_scale"]) for s in ("gyro", "accel"))
    gyro[~np.eye(3, dtype=bool)] = e["gyro_misalignment"]
    accel[np.tril_indices(3, -1)] = e["accel_misalignment"]
    read = np.hstack([
        e["gyro_bias"] + warm[:, None] * e["gyro_temperature"] + true.omega @ gyro.T
        + true.f @ e["gyro_g_sensitivity"].reshape(3, 3).T,
        e["accel_bias"] + warm[:, None] * e["accel_temperature"] + true.f @ accel.T,
    ])  # fmt: skip
    np.testing.assert_allclose(world.imu.values - np.hstack([true.omega, true.f]), read, atol=1e-12)


@pytest.mark.parametrize("made", [yaw_on_a_table, two_axes, six_sides])
def test_motions_turn_as_they_are_called(made):
    rng = np.random.default_rng(3)
    motion = made(45.0, random_start(rng), rng)
    t = np.arange(0.0, 45.0, 0.01)
    at = evaluate(motion, t)
    resting = np.any([(t >= a) & (t <= b) for a, b in motion.rests], axis=0)
    assert np.abs(at.omega_nb_b[resting]).max() < 1e-6
    assert 0.5 < np.abs(at.omega_nb_b).max() < 6.0
    step = np.einsum("nji,njk->nik", at.C_nb[:-1], at.C_nb[1:])
    turned = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1) / 0.01
    np.testing.assert_allclose(turned, 0.5 * (at.omega_nb_b[1:] + at.omega_nb_b[:-1]), atol=0.05)
    up = at.C_nb[:, 2]
    sizes = np.sort(at.omega_nb_b.std(axis=0))
    if made is yaw_on_a_table:
        np.testing.assert_allclose(up, np.broadcast_to(up[0], up.shape), atol=1e-12)
    elif made is two_axes:
        assert sizes[0] < 1e-12 < 0.1 < sizes[1]
    else:
        sides = {(int(k), bool(u[k] > 0)) for u in up[resting] for k in [np.argmax(np.abs(u))]}
        assert len(sides) == 6
        # About the vertical it does not turn but by the tips' way.
        assert np.abs(np.sum(at.omega_nb_b[resting] * up[resting], axis=1)).max() < 1e-6


def test_priors_are_those_of_the_drawing(tmp_path):
    ordinary.write_priors(PHONE, tmp_path / "priors.toml")
    known = prior(read(tmp_path / "priors.toml"), PHONE)
    sigma = dict(zip(known.names, np.sqrt(np.diag(known.covariance)), strict=True))
    assert set(sigma) == {(e, p.name) for e in SPREADS for p in EFFECTS[e]}
    assert not known.mean.any()
    for (effect, _), of in sigma.items():
        warmth = 40.0 / math.sqrt(12.0) * spread(PHONE, SLOPES[effect]) if effect in SLOPES else 0.0
        assert of == pytest.approx(math.hypot(spread(PHONE, effect), warmth))


def trial(document, rare="", stranger=None, sigmas=None, mean_K=10.0):
    truth = {"gyro_scale": {"x": 0.01, "y": 0.0, "z": 0.0}, "gyro_temperature": {"x": 1e-3}}
    effects = truth | ({rare: {"x": 0.01}} if rare else {})
    where = {"kind": PHONE, "motion": "swings", "stream": "none", "rare": rare, "mean_K": mean_K}
    answer = Answer(SUITE, "", effects, stranger or {}, {"gyro_bias": {"x": 0.02}}, where)
    further = {} if sigmas is None else {"rare_sigmas": sigmas}
    return Trial("0007", answer, document, 1.0, {}, further)


def told(*values, shown=True):
    names = [("gyro_scale", "x", 1e-3), ("gyro_bias", "x", 1e-3), ("accel_scale", "z", 1e-3)]
    return [parameter(e, n, v, s) | {"shown": shown}
            for (e, n, s), v in zip(names, values, strict=False)]  # fmt: skip


def test_numbers_are_counted_by_what_they_are():
    found = deviations([trial(said(parameters=told(0.0105, 0.0215, 0.003)))])
    assert [(d.what, round(d.sigmas, 6)) for d in found] == [
        ("drawn", 0.5), ("bias", 1.5), ("absent", 3.0),
    ]  # fmt: skip
    parts = coverage(found)
    assert parts["all"]["within_1_sigma"]["count"] == 1
    assert parts["all"]["within_2_sigma"]["count"] == parts["all"]["within_2_sigma"]["n"] == 2
    assert parts["biases"]["within_1_sigma"]["n"] == parts["absent"]["within_1_sigma"]["n"] == 1
    assert parts["shown"]["within_1_sigma"]["n"] == 2
    assert parts["not_shown"]["within_1_sigma"]["n"] == 0
    assert worst(found, 1)[0].effect == "accel_scale"
    # An old document says `observable`; a number without a sigma does not count.
    old = [{k: v for k, v in p.items() if k != "shown"} for p in told(0.0105, 0.0215)]
    old[0]["observable"], old[1]["sigma"] = True, None
    assert [(d.effect, d.shown) for d in deviations([trial(said(parameters=old))])] == [
        ("gyro_scale", True)
    ]


def test_bounds_are_met_by_honest_sigmas_alone():
    rng = np.random.default_rng(0)

    def documents(factor, shown=True):
        return [trial(said(parameters=told(*(np.array([0.01, 0.02]) + factor * 1e-3 * z),
                                           shown=shown)))
                for z in rng.standard_normal((2000, 2))]  # fmt: skip

    def met(trials, drawing):
        return [row["met"] for row in asked(coverage(deviations(trials)), drawing)]

    honest = documents(1.0) + documents(0.5, shown=False)
    assert met(honest, False) == [True, True, True]
    assert met(documents(1.0), True) == [True, True]
    assert met(documents(1.4), True) == [False, False]
    assert met(documents(0.7), True) == [False, False]
    assert met(documents(1.4) + documents(1.4, shown=False), False) == [False, False, False]
    assert met([], True) == [None, None]


def test_names_of_what_few_have_are_right_false_or_missed():
    law = {"kind": "a law", "laws": []}
    unnamed = said() | {"unnamed": [{"formula": "gyro_x += k * t"}]}
    outcomes = [
        (trial(said("gyro_scale", "lever_arm")), "exact"),
        (trial(said("gyro_scale", "gyro_quadratic")), "false"),
        (trial(unnamed), "false"),
        (trial(said("gyro_quadratic"), rare="gyro_quadratic", sigmas=20.0), "exact"),
        (trial(said("gyro_cross_products"), rare="gyro_quadratic", sigmas=20.0), "false"),
        (trial(unnamed, rare="gyro_quadratic", sigmas=20.0), "exact"),
        (trial(said("gyro_scale"), rare="gyro_quadratic", sigmas=20.0), "missed"),
        (trial(said("gyro_scale"), rare="gyro_quadratic", sigmas=9.0), "exact"),
        (trial(said("gyro_scale"), rare="gyro_quadratic"), "exact"),
        (trial(unnamed, stranger=law, sigmas=20.0), "exact"),
        (trial(said(), stranger=law, sigmas=20.0), "missed"),
        (trial({"error": "none"}), "failed"),
    ]  # fmt: skip
    assert [score.outcome(one) for one, _ in outcomes] == [right for _, right in outcomes]
    figures = score_ordinary.score([one for one, _ in outcomes])
    assert (figures["rare_found"]["count"], figures["rare_found"]["n"]) == (3, 6)
    assert (figures["false_rare"]["count"], figures["false_rare"]["n"]) == (3, 11)
    assert figures["names_asked"]["false_rare"]["met"] is False
    assert figures["names_asked"]["rare_found"]["met"] is False


def test_the_score_says_what_is_asked_beside_what_was_measured():
    good, bad = told(0.0105, 0.0205), told(0.02, 0.05)
    trials = [trial(said("gyro_scale", parameters=good))] * 3 + [trial(said(parameters=bad))]
    proof = score.score(trials, 1)
    schemas.check(proof)
    figures = proof["further"][SUITE]
    # (ten sigmas of a scale error are clear; the lone gyro_temperature has no sigma told)
    assert (figures["found"]["count"], figures["found"]["n"]) == (3, 4)
    assert figures["not_found"] == {"gyro_scale": 1}
    assert figures["names_asked"]["found"]["met"] is False
    assert figures["numbers_asked"][0]["met"] is True  # 6 of 8
    assert figures["numbers_asked"][1]["met"] is False
    text = io.StringIO()
    show(proof, Console(file=text, width=160))
    assert "named 75.0 %" in text.getvalue()
    assert "asked +-8 %: 68 % met" in text.getvalue()
    few = score.score([trials[0]], 1)["further"][SUITE]
    assert few["names_asked"]["false_rare"]["met"] is None
    fine = score.score([trials[0]] * 40, 1)["further"][SUITE]
    assert fine["names_asked"]["found"]["met"] is True
    assert fine["names_asked"]["false_rare"]["met"] is True


def test_a_correction_by_the_truth_leaves_nearly_nothing(tmp_path):
    """So that what another leaves is its own."""
    _, case = plain_case(lambda _: True)
    values = [parameter(effect, p.name, v, 1e-9) for effect, of in case.device.effects.items()
              for p, v in zip(EFFECTS[effect], of, strict=True)]  # fmt: skip
    learnt = device.of_document("truth", {
        "schema": "handcal/calibration/1", "recording": {"path": "first.mcap"},
        "parameters": values,
    })  # fmt: skip
    write(ordinary_apply.another(case), tmp_path / "again.mcap", truth=False)
    corrected = device.apply(handcal.load(tmp_path / "again.mcap"), learnt).recording
    write_mcap(corrected, tmp_path / "corrected.mcap")
    found = ordinary_apply.left(case, tmp_path / "corrected.mcap")
    for sensor in ordinary_apply.SENSORS:
        for what in ("", "_varying"):
            assert found[f"{sensor}_after{what}"] < 0.01 * found[f"{sensor}_before{what}"]
    plain = ordinary_apply.left(case, tmp_path / "again.mcap")
    assert plain["gyro_after"] == pytest.approx(plain["gyro_before"])
    rows = ordinary_apply.score([trial({}), Trial("1", trial({}).answer, {}, 0.0, further=found)])
    assert [row["worse"]["count"] for row in rows] == [0, 0, 0, 0]
    assert all(row["worse"]["n"] == 1 and row["median_left"] < 0.01 for row in rows)


@pytest.mark.prove
def test_the_command_calibrates_applies_and_keeps(tmp_path, capsys):
    number, _ = plain_case(lambda case: case.first.motion == "two axes")
    ordinary.main([
        "--only", str(number), "--seed", "0", "--effects", "gyro_scale", "--with-drawing-priors",
        "--apply", "--keep", str(tmp_path / "kept"), "--json", str(tmp_path / "out.json"),
    ])  # fmt: skip
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["failed"] == {}
    assert found["coverage"]["all"]["within_1_sigma"]["n"] > 9
    assert len(found["apply"]) == 4
    answers = json.loads((tmp_path / "kept" / "answers.json").read_text())["recordings"]
    assert set(answers) == {f"{number:04d}"}
    (file,) = (tmp_path / "kept").glob(f"*/{number:04d}.json")
    document = json.loads(file.read_text())
    assert document["priors"]["model"] == answers[f"{number:04d}"]["circumstances"]["kind"]
    assert file.with_suffix(".mcap").exists()
    assert "By motion" in capsys.readouterr().out


def test_what_is_rare_is_as_clear_as_calibrate_would_tell(monkeypatch, tmp_path):
    asked_for = []

    def calibrated(_file, names, _assume):
        asked_for.append(names)
        return {"parameters": [parameter("gyro_quadratic", a, 0.0, 2e-3) for a in "xyz"]}

    monkeypatch.setattr(told_further, "_calibrated", calibrated)
    where = {"rare": "gyro_quadratic", "thermometer": False}
    effects = {"gyro_scale": {}, "gyro_temperature": {},
               "gyro_quadratic": {"x": 6e-3, "y": 0.0, "z": -8e-3}}  # fmt: skip
    answer = Answer(SUITE, "", effects, circumstances=where)
    ticket = Ticket(SUITE, 0, 0)
    found = told_further.told(ticket, answer, tmp_path, {})
    assert found == {"rare_sigmas": pytest.approx(5.0)}
    assert asked_for == [["gyro_scale", "gyro_quadratic"]]
    # A law of the heading stands beside white noise: 400 readings of a hundredth.
    law = {"kind": "a law", "laws": [{"channels": ["heading"], "left": [0.02]}]}
    where = {"rare": "", "thermometer": True, "duration_s": 20.0, "heading_hz": 20.0,
             "heading_sigma_deg": math.degrees(0.01)}  # fmt: skip
    answer = Answer(SUITE, "", {}, law, circumstances=where)
    assert told_further.told(ticket, answer, tmp_path, {}) == {"rare_sigmas": pytest.approx(40.0)}
    answer = Answer(SUITE, "", {}, circumstances=where)
    assert told_further.told(ticket, answer, tmp_path, {}) == {}

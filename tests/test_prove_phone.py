"""The suite `phone`: what is drawn, and that its score can fail."""

import io

import numpy as np
import pytest
import schemas
from prove_help import parameter, said, trial
from rich.console import Console

from handcal_sim.mcap_writer import write
from handcal_sim.motion import Motion, evaluate, random_start
from handcal_sim.motion_phone import figure_of_eight, routine, swings
from handcal_sim.prove import draw, draw_phone, score
from handcal_sim.prove.draw_phone import HABITS
from handcal_sim.prove.given import Ticket
from handcal_sim.prove.run import explained
from handcal_sim.prove.show import show

HARD, SOFT = "mag_hard_iron", "mag_soft_iron"


@pytest.mark.parametrize("number", range(len(HABITS)))
def test_iron_delays_rates_and_arms_are_as_promised(number):
    world, answer = draw.draw("phone", number, 5)
    hard, soft = (np.array(list(answer.effects[name].values())) for name in (HARD, SOFT))
    assert 30e-6 <= np.linalg.norm(hard) <= 300e-6
    S = np.diag(soft[:3]) + sum(
        v * (np.eye(3)[[i]].T @ np.eye(3)[[j]] + np.eye(3)[[j]].T @ np.eye(3)[[i]])
        for v, i, j in zip(soft[3:], (0, 0, 1), (1, 2, 2), strict=True)
    )
    assert np.trace(S) == pytest.approx(0.0, abs=1e-12)
    assert 0.02 <= np.abs(np.linalg.eigvalsh(S)).max() <= 0.15 + 1e-12
    assert 0.02 <= answer.effects["heading_delay"]["delay"] <= 0.15
    assert set(world.streams) == {"mag"}
    assert 20.0 <= answer.circumstances["duration_s"] <= 120.0
    assert 53 <= answer.circumstances["rate_hz"] <= 400
    gaps = np.diff(world.streams["mag"].stamps)
    assert 9.9 <= 1.0 / np.median(gaps) <= 101.0
    arm = np.linalg.norm(list(answer.effects.get("lever_arm", {"x": 0.0}).values()))
    low, high = HABITS[number].reach_m
    assert 0.8 * low <= arm <= 1.3 * max(high, 0.15)
    assert np.abs(world.truth.omega).max() > 0.5


def test_a_third_have_a_field_with_a_gradient_that_fields_can_have(monkeypatch):
    monkeypatch.setattr(draw_phone, "simulated", lambda *_: None)
    monkeypatch.setattr(draw, "completed", lambda _world, drawn: drawn)
    drawn = [draw.draw("phone", 6 * k + 2, 1)[1].effects for k in range(60)]
    some = [e["mag_gradient"] for e in drawn if "mag_gradient" in e]
    assert 10 <= len(some) <= 30
    for g in some:
        last = -g["xx"] - g["yy"]
        G = [[g["xx"], g["xy"], g["xz"]], [g["xy"], g["yy"], g["yz"]], [g["xz"], g["yz"], last]]
        assert 7e-6 <= 0.5 * np.abs(np.linalg.eigvalsh(G)).max() <= 14e-6


def test_the_field_differs_where_the_phone_is():
    """Two readings of one attitude, half a metre apart."""
    from handcal_sim.aiding import read_mag
    from handcal_sim.phone import Magnetometer
    from handcal_sim.profiles import constant

    def read(where, gradient):
        held = Motion("m", 1.0, np.eye(3), (), constant(where), constant([1.0]),
                      constant([0.0]), ())  # fmt: skip
        sensor = Magnetometer(gradient=gradient)
        rng = np.random.default_rng(0)
        return read_mag(sensor, None, held, np.array([0.1, 0.0, 0.0]), np.zeros(1), rng)[0]

    G = np.diag([2e-5, -3e-5, 1e-5])
    plain = read([0.0, 0.0, 0.0], np.zeros((3, 3)))
    np.testing.assert_allclose(read([0.4, 1.0, 0.0], G) - plain, [1e-5, -3e-5, 0.0], atol=1e-18)


@pytest.mark.parametrize("made", [swings(0.7, 1.0), routine(True), routine(False),
                                  figure_of_eight(1.0, 0.6)])  # fmt: skip
def test_motions_turn_about_all_axes_and_rest_where_they_say(made):
    rng = np.random.default_rng(3)
    motion = made(40.0, random_start(rng), rng)
    t = np.arange(0.0, 40.0, 0.01)
    at = evaluate(motion, t)
    assert np.all(at.omega_nb_b.std(axis=0) > 0.1)
    resting = np.any([(t >= a) & (t <= b) for a, b in motion.rests], axis=0)
    assert np.any(resting)
    assert np.abs(at.omega_nb_b[resting]).max() < 1e-6
    # Rates are what the attitude does.
    step = np.einsum("nji,njk->nik", at.C_nb[:-1], at.C_nb[1:])
    turned = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1) / 0.01
    np.testing.assert_allclose(turned, 0.5 * (at.omega_nb_b[1:] + at.omega_nb_b[:-1]), atol=0.05)


def test_the_score_counts_parameters_and_impossible_claims():
    effects, bias = {HARD: {"x": 1e-4}}, {"gyro_bias": {"x": 0.01}}
    good = [parameter(HARD, "x", 1.1e-4, 1e-5), parameter("gyro_bias", "x", 0.011, 1e-3),
            parameter("gyro_scale", "x", 0.002, 1e-3)]  # fmt: skip
    bad = [parameter("lever_arm", "x", 0.04, 0.01)]
    claim = said(("gyro_scale", {"x": -0.06}), parameters=good + bad)
    untold = said(HARD, parameters=bad, untellable=[("lever_arm", "x")])
    trials = [trial("phone", effects, said(HARD, parameters=good), bias),
              trial("phone", effects, claim, bias),
              trial("phone", effects, untold)]  # fmt: skip
    proof = score.score(trials, 1)
    schemas.check(proof)
    figures = proof["further"]["phone"]
    every = figures["parameters"]["all"]["within_3_sigma"]
    assert (every["count"], every["n"]) == (6, 7)
    assert figures["asked"]["met"] is False
    assert figures["impossible"]["count"] == 1
    text = io.StringIO()
    show(proof, Console(file=text, width=160))
    assert "lever_arm 1 of 1" in text.getvalue()
    assert "1 of 3 recordings claim" in text.getvalue()
    few = score.score(trials[:1], 1)["further"]["phone"]
    assert few["asked"]["met"] is None
    fine = score.score(trials[:1] * 20, 1)["further"]["phone"]
    assert fine["asked"]["met"] is True
    assert fine["impossible"]["count"] == 0


PAIRS = 10
OF_THE_PHONE = {
    "mag_hard_iron", "mag_soft_iron", "heading_delay", "gyro_scale", "gyro_misalignment",
    "gyro_g_sensitivity", "accel_scale", "accel_misalignment",
}  # fmt: skip


@pytest.mark.prove
def test_two_recordings_of_one_phone_agree(tmp_path):
    """Another habit, hand and room each: of all parameters of the phone that both explanations
    tell, 95 % differ by less than three sigma."""
    differences = []
    for number in range(PAIRS):
        ticket = Ticket("phone", number, 0)
        world, answer = draw.draw("phone", number, 0)
        worlds = world, draw_phone.again(ticket, answer, np.random.default_rng([0, number, 1]))
        told = []
        for k, one in enumerate(worlds):
            write(one, tmp_path / f"{k}.mcap", truth=False)
            said = explained(str(tmp_path / f"{k}.mcap"))
            hidden = {(u["effect"], u["name"]) for u in said["untellable"]}
            rows = {(p["effect"], p["name"]): p for p in said["parameters"]}
            told.append({n: p for n, p in rows.items() if n not in hidden})
        for name in sorted(told[0].keys() & told[1].keys()):
            if name[0] in OF_THE_PHONE:
                a, b = told[0][name], told[1][name]
                differences.append((a["value"] - b["value"]) / np.hypot(a["sigma"], b["sigma"]))
                if abs(differences[-1]) > 3.0:
                    print(number, *name, a["value"], a["sigma"], b["value"], b["sigma"])
    agree = int(np.sum(np.abs(differences) < 3.0))
    print(f"{agree} of {len(differences)} compared parameters agree within three sigma")
    assert len(differences) >= 60
    assert agree >= 0.95 * len(differences)

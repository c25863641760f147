"""The suite `budget`: what is drawn, what is left of a gyro's error, and how the score fails."""

import io

import numpy as np
import pytest
import schemas
from prove_help import parameter, said, trial
from rich.console import Console

from handcal_sim import leftover
from handcal_sim.effects import EFFECTS
from handcal_sim.mcap_writer import write
from handcal_sim.motion import build, random_start
from handcal_sim.phone import Gyro, Phone
from handcal_sim.prove import draw, score
from handcal_sim.prove.draw_budget import ALWAYS, AT_TIMES, left, planned
from handcal_sim.prove.further import worked_out
from handcal_sim.prove.given import Ticket, generator
from handcal_sim.prove.score_budget import MEDIAN
from handcal_sim.prove.show import show
from handcal_sim.prove.suites import NEEDS
from handcal_sim.prove.told import told


def test_eight_to_twelve_effects_as_the_streams_allow():
    counts = set()
    for number in range(60):
        budget = planned(generator(Ticket("budget", number, 2)))
        given = budget.given
        counts.add(len(budget.effects))
        assert set(ALWAYS) <= set(budget.effects) <= {*ALWAYS, *AT_TIMES}
        assert all(NEEDS.get(n, frozenset()) <= given.streams for n in budget.effects)
        assert 50 <= given.rate_hz <= 500
        assert 60.0 <= given.duration_s <= 120.0
        assert budget.phone.gyro.quantum > 0.0
    assert counts == {8, 9, 10, 11, 12}


def test_the_recording_jitters_and_has_lost_samples():
    world, answer = draw.draw("budget", 1, 5)
    rate, lost = answer.circumstances["rate_hz"], answer.circumstances["lost"]
    gaps = np.diff(world.imu.stamps) * rate
    assert np.mean(gaps > 1.5) == pytest.approx(lost, rel=0.5)
    assert 0.005 < np.std(gaps[gaps < 1.5]) < 0.2
    assert len(world.truth.omega) == len(world.t) == len(world.imu.stamps)
    steps = np.diff(np.unique(world.imu.values[:, 0]))
    assert steps.min() > 1e-4


def parameters_of(effects):
    return [
        parameter(effect, p.name, value)
        for effect, values in effects.items()
        for p, value in zip(EFFECTS[effect], values, strict=True)
    ]


def test_nothing_is_left_of_what_is_known_and_everything_of_what_is_not():
    ticket = Ticket("budget", 3, 5)
    effects = dict(planned(generator(ticket)).effects)
    known = left(ticket, said(parameters=parameters_of(effects)))
    assert known["share_left"] < 1e-9
    assert worked_out(ticket, said())["share_left"] == pytest.approx(1.0)
    effects["gyro_scale"] = [0.9 * v for v in effects["gyro_scale"]]
    some = left(ticket, said(parameters=parameters_of(effects)))
    assert 0.005 < some["share_left"] < 0.2
    assert some["before"] == known["before"] > 0.005
    assert worked_out(ticket, {"error": "x"}) == {}
    assert worked_out(Ticket("phone", 3, 5), said()) == {}


@pytest.mark.prove
def test_what_the_names_alone_leave_is_asked_where_it_matters(tmp_path):
    ticket = Ticket("budget", 2, 5)
    world, answer = draw.draw("budget", 2, 5)
    file = tmp_path / "x.mcap"
    write(world, file, truth=False)
    assert told(ticket, answer, file, {"share_left": MEDIAN}) == {}
    assert told(ticket, answer, file, {}) == {}
    assert 0.0 < told(ticket, answer, file, {"share_left": 1.0})["told"] < 1.0


def test_a_scale_error_leaves_its_share_of_the_rate():
    rng = np.random.default_rng(1)
    motion = build("free-hand", 12.0, random_start(rng), rng)
    true = Phone(gyro=Gyro(bias=np.ones(3), response=np.diag([0.01, 0.01, 0.01]), lag_s=0.005))
    found = leftover.estimated(true, parameters_of({
        "gyro_scale": [0.009] * 3, "gyro_bandwidth": [0.005], "accel_scale": [1.0] * 3,
    }))  # fmt: skip
    t = np.arange(0.0, 12.0, 0.01)
    slow = leftover.estimated(true, parameters_of({"gyro_bandwidth": [0.005]}))
    before, after = leftover.gyro_error_left(true, found, motion, t)
    _, scale_alone = leftover.gyro_error_left(true, slow, motion, t)
    assert after == pytest.approx(0.1 * scale_alone, rel=1e-6)
    assert before > scale_alone


def test_the_score_asks_for_median_and_worst():
    def of(share, *names, **more):
        truth = {"gyro_scale": {"x": 0.01}, "lever_arm": {"x": 0.1}}
        return trial("budget", truth, said(*names), further={"share_left": share, **more})

    fine = [of(0.01, "gyro_scale", "lever_arm"), of(0.04, "gyro_scale"), of(0.19)]
    proof = score.score(fine, 1)
    schemas.check(proof)
    figures = proof["further"]["budget"]
    assert figures["left"]["met"] is True
    assert (figures["left"]["median"], figures["left"]["worst"]) == (0.04, 0.19)
    assert (figures["names"]["count"], figures["names"]["n"]) == (3, 6)
    failed = trial("budget", {"gyro_scale": {"x": 0.01}}, {"error": "x"})
    for worse in ([*fine, of(0.21)], [of(0.06)], [*fine, failed]):
        again = score.score(worse, 1)
        assert again["further"]["budget"]["left"]["met"] is False
    for share, beyond in ((0.32, 0), (0.34, 1)):
        again = score.score([*fine[:2], of(0.02), of(share, told=0.3)], 1)["further"]["budget"][
            "left"
        ]
        assert (again["beyond"], again["met"]) == (beyond, beyond == 0)
        assert again["told"] == {"median": pytest.approx(0.03), "worst": 0.3}
    text = io.StringIO()
    show(proof, Console(file=text, width=200))
    assert "median 4.0 %, worst 19.0 %" in text.getvalue()

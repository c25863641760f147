"""What a session asks for, whether it was done, what it brought, when it is enough, and what goes
wrong on the way."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sample_recording import sample

from handcal.design.motion import updated
from handcal.live import goals
from handcal.live.doubts import doubts
from handcal.live.guide import ENOUGH, WAIT, Guide, brought
from handcal.live.looks import Look, Looks, carried
from handcal.live.planning import MOST, best
from handcal.live.rounding import less_sure, rounded
from handcal.live.turns import CHOICE, FIRST, Watched
from handcal.motions import attitude
from handcal.types import InputError, Parameter, Recording, Series

RATE = 50.0


def rates(motion: Any, faster: float = 1.0, sign: float = 1.0) -> np.ndarray:
    """What a gyro reads of a motion."""
    t = np.arange(0.0, motion.duration_s, 1.0 / RATE)
    return sign * np.asarray(attitude(motion, t)[1]) * faster


def parameter(effect: str, name: str, sigma: float, unit: str = "1") -> Parameter:
    return Parameter(effect, name, 0.0, sigma, unit, 0.01, None)


def look(*parameters: Parameter, end_s: float = 10.0, following: str = "", enough: bool = False,
         at_rest: bool = True) -> Look:  # fmt: skip
    proposal: Any = SimpleNamespace(name=following) if following else None
    covariance = np.diag([p.sigma**2 for p in parameters])
    return Look(0, end_s, parameters, covariance, {}, {}, "fixed-point", at_rest,
                np.array([1.0, 0.0, 0.0, 0.0]), enough, proposal, ())  # fmt: skip


@pytest.mark.parametrize("asked", CHOICE, ids=lambda a: a.name)
def test_a_motion_that_is_done_is_seen_and_another_is_not(asked):
    """Either way round, faster or slower; half of it, or about another axis, is not it."""
    own = rates(asked.motion)
    step = np.full(len(own), 1.0 / RATE)
    for sign in (1.0, -1.0):
        tips = any(0.0 < abs(degrees) < 180.0 for _, degrees, _ in asked.motion.turns)
        done = Watched(asked)
        done.saw(sign * own, step)
        if sign < 0.0 and tips:
            assert not done.over  # (how it is to lie is not left open)
            continue
        assert done.over
        assert done.done == 1.0
    half = Watched(asked)
    half.saw(own[: len(own) // 2], step[: len(own) // 2])
    assert not half.over
    assert 0.1 < half.done < 0.9
    if any(degrees for _, degrees, _ in asked.motion.turns):
        other = Watched(asked)
        other.saw(own[:, [1, 2, 0]], step)
        assert not other.over


def test_back_is_the_other_way():
    """Half round twice the same way is not there and back; and how it is to lie is said."""
    asked = next(a for a in CHOICE if a.name == "half round about y, rest, and back")
    own = rates(asked.motion)
    same = Watched(asked)
    same.saw(np.abs(own), np.full(len(own), 1.0 / RATE))
    assert same.at == 2
    left = Watched(next(a for a in CHOICE if a.name == "on its left edge, rest, and back"))
    said = [left.sentence]
    for k in range(0, 400, 10):
        own = rates(left.asked.motion)[k : k + 10]
        left.saw(own, np.full(len(own), 1.0 / RATE))
        said.append(left.sentence)
    told = list(dict.fromkeys(said))
    assert "onto its left edge" in told[0]
    assert "Hold it still" in told[1]
    assert "as it lay before" in told[2]


def test_a_turn_about_another_axis_is_said():
    asked = next(a for a in CHOICE if a.name == "once about x and back")
    other = Watched(asked)
    own = rates(asked.motion)[:, [1, 0, 2]]
    other.saw(own, np.full(len(own), 1.0 / RATE))
    assert "another axis" in other.hint
    right = Watched(asked)
    right.saw(rates(asked.motion)[:300], np.full(300, 1.0 / RATE))
    assert right.hint == ""


def test_the_guide_asks_waits_and_says_what_a_motion_brought():
    guide, now = Guide(), 0

    def read(gyro: np.ndarray) -> None:
        nonlocal now
        ns = now + (1 + np.arange(len(gyro))) * round(1e9 / RATE)
        now = int(ns[-1])
        guide.saw(ns, gyro)

    assert guide.told()["turn"]["say"] == FIRST.motion.sentence
    read(np.zeros((int(4 * RATE), 3)))
    assert guide.told()["turn"]["say"] == WAIT
    bias = parameter("gyro_bias", "z", 0.01, "rad/s")
    guide.learned(look(bias, end_s=0.5, following=CHOICE[2].name))  # (older than the rest's end)
    assert guide.told()["turn"]["say"] == WAIT
    guide.learned(look(bias, end_s=now / 1e9, following=CHOICE[2].name))
    assert "like a plate" in guide.told()["turn"]["say"]
    read(rates(CHOICE[2].motion)[: int(5.0 * RATE)])
    assert "back" in guide.told()["turn"]["say"]
    read(rates(CHOICE[2].motion)[int(5.0 * RATE) :])
    assert guide.told()["turn"]["say"] == WAIT
    better = replace(bias, sigma=0.001)
    guide.learned(look(better, end_s=now / 1e9, following=CHOICE[0].name))
    assert guide.told()["brought"].startswith("That brought gyro bias z from ± ")
    assert guide.asked == [CHOICE[2].name, CHOICE[0].name]
    guide.learned(look(better, end_s=now / 1e9, enough=True))
    assert guide.told()["turn"]["say"] == ENOUGH
    assert "little that was new" in brought(look(better), look(better), "x")


def test_a_motion_that_gets_no_further_gives_way_to_the_one_that_is_best():
    """A recording that is fed does not do what is asked: it had one instruction in 35 s."""
    guide, bias = Guide(), parameter("gyro_bias", "z", 0.01, "rad/s")
    said = []
    for k in range(35):
        ns = k * 10**9 + np.arange(int(RATE)) * round(1e9 / RATE)
        guide.saw(ns, np.full((int(RATE), 3), 0.5))
        guide.learned(look(bias, end_s=k + 1.0, following=CHOICE[0].name))
        said.append((guide.told()["turn"]["say"], guide.open))
    sentences = list(dict.fromkeys(sentence for sentence, _ in said))
    assert sentences[0] == FIRST.motion.sentence
    assert sentences[1].startswith("Turn it once all the way round")
    assert guide.asked[0] == CHOICE[0].name
    assert said[3][1] == "“lie still” is 0 % done."
    assert "100 % done" not in {far for _, far in said}


def test_a_motion_that_separates_explanations_comes_first_and_once():
    guide, bias = Guide(), parameter("gyro_bias", "z", 0.01, "rad/s")
    for k, motion in enumerate((FIRST.motion, CHOICE[3].motion)):
        if k == 0:
            guide.wanted = CHOICE[3], "It separates this from that."
        gyro = rates(motion)
        begin = 60 * 10**9 * k
        guide.saw(begin + np.arange(len(gyro)) * round(1e9 / RATE), gyro)
        guide.learned(look(bias, end_s=60.0 * k + 59.0, following=CHOICE[0].name))
        assert ("It separates" in guide.told()["turn"]["hint"]) == (k == 0)
    assert guide.asked == [CHOICE[3].name, CHOICE[0].name]


def test_a_motion_that_gets_on_slowly_is_waited_for():
    guide = Guide()
    own = rates(CHOICE[0].motion, faster=0.1)
    slow = np.repeat(own, 10, axis=0)[: int(30 * RATE)]
    guide.saw(np.arange(int(5 * RATE)) * round(1e9 / RATE), np.zeros((int(5 * RATE), 3)))
    bias = parameter("gyro_bias", "z", 0.01, "rad/s")
    guide.learned(look(bias, end_s=5.0, following=CHOICE[0].name))
    for k, rate in enumerate(slow):
        guide.saw(5 * 10**9 + np.array([(k + 1) * round(1e9 / RATE)]), rate[None])
        guide.learned(look(bias, end_s=5.0 + k / RATE, following=CHOICE[1].name))
    assert guide.asked == [CHOICE[0].name]


def test_without_an_estimate_turns_are_asked_for_all_the_same():
    guide = Guide()
    for k in range(30):
        ns = k * 10**9 + np.arange(int(RATE)) * round(1e9 / RATE)
        guide.saw(ns, np.zeros((int(RATE), 3)))
    assert guide.asked[0] == CHOICE[0].name


def test_the_plan_is_the_best_of_all():
    """Against every plan, each weighed by itself."""
    rng = np.random.default_rng(1)
    few = CHOICE[:4]
    told = {}
    for asked in few:
        root = rng.normal(0.0, 3.0, (5, 2))
        told[asked] = root @ root.T
    known, goal, at = np.eye(5), rng.uniform(0.5, 3.0, 5), np.arange(5)
    horizon = 45.0

    def left(plan: tuple[Any, ...]) -> float:
        P = known
        for asked in plan:
            P = updated(P, told[asked])
        return float((np.sqrt(np.diag(P)) * goal).max())

    plans = [p for k in range(1, MOST + 1) for p in combinations_with_replacement(few, k)
             if sum(a.motion.duration_s for a in p) <= horizon]  # fmt: skip
    found = best(told, known, goal, at, horizon)
    own = tuple(next(a for a in few if a.name == n) for n in found.planned)
    assert left(own) == pytest.approx(found.worst[2])
    assert left(own) < 1.1 * min(map(left, plans))
    assert found.name in found.planned
    # what is wanted is easily had: then the shortest plan that has it
    easy = goal * 0.5 * min(1.0 / left(p) for p in plans if len(p) == 2)
    soon = best(told, known, easy, at, horizon)
    assert soon.worst[2] <= 1.0
    lengths = [sum(a.motion.duration_s for a in p) for p in plans if max(
        np.sqrt(np.diag(_after(known, told, p))) * easy) <= 1.0]  # fmt: skip
    took = sum(next(a for a in few if a.name == n).motion.duration_s for n in soon.planned)
    assert took == pytest.approx(min(lengths))


def _after(P: np.ndarray, told: Any, plan: Any) -> np.ndarray:
    for asked in plan:
        P = updated(P, told[asked])
    return P


def test_what_is_enough_is_said_in_units_of_ones_own():
    wanted = goals.parse("gyro_scale=0.1%, gyro_bias=15 deg/h,accel_bias=2mg,lever_arm=5mm")
    assert wanted["gyro_scale"] == pytest.approx(1e-3)
    assert wanted["gyro_bias"] == pytest.approx(np.radians(15.0) / 3600.0)
    assert wanted["accel_bias"] == pytest.approx(2e-3 * 9.80665)
    assert wanted["lever_arm"] == pytest.approx(5e-3)
    assert goals.parse("gyro_scale=1e-3")["gyro_scale"] == 1e-3
    assert goals.parse("accel_bias=0.01m/s^2")["accel_bias"] == 0.01
    for text, why in (
        ("gyro_scales=1%", "gyro_scale"), ("gyro_scale=1mg", "is in %, ppm"),
        ("gyro_scale=-1%", "expected"), ("gyro_scale", "expected"), ("gyro_scale=x", "in %"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=why):
            goals.parse(text)
    scale, bias = parameter("gyro_scale", "x", 9e-4), parameter("gyro_bias", "x", 1e-2, "rad/s")
    until = goals.parse("gyro_scale=0.1%")
    assert goals.enough([scale, bias], until)
    assert not goals.enough([replace(scale, sigma=2e-3), bias], until)
    assert not goals.enough([scale, bias], {})  # (the bias is not known to 15 deg/h)
    assert not goals.enough([bias], until)  # (what is not estimated is not known)


def test_what_every_device_has_is_no_goal_by_itself():
    """Some of it no motion shows without a heading; biases hold how little is known of it."""
    bias = parameter("gyro_bias", "x", np.radians(14.0) / 3600.0, "rad/s")
    other = replace(parameter("gyro_g_sensitivity", "xx", 2e-4), prior_sigma=1.8e-4)
    rare = replace(parameter("gyro_quadratic", "x", 4e-3), prior_sigma=5e-3)
    assert goals.enough([bias, other], {})
    assert not goals.enough([replace(bias, sigma=2.0 * bias.sigma), other], {})
    assert not goals.enough([bias, other], {"gyro_g_sensitivity": 1e-4})
    assert not goals.enough([bias, other, rare], {})


def test_whether_all_was_reached_is_said():
    until = goals.parse("gyro_scale=0.1%,gyro_bias=15deg/h")
    scale, bias = parameter("gyro_scale", "x", 9e-4), parameter("gyro_bias", "z", 1e-3, "rad/s")
    assert goals.said_of([scale], {}) == ()
    assert goals.said_of([scale], {"gyro_scale": 1e-3})[0].startswith("All is known")
    (said,) = goals.said_of([scale, bias], until)
    assert "Gyro bias z, ± 0.057 instead of 0.0042 deg/s" in said
    assert "scale" not in said
    (said,) = goals.said_of([scale], until)
    assert said.endswith("Gyro bias, not estimated.")


def recording(**more: Any) -> Recording:
    t = np.arange(0.0, 20.0, 0.02)
    base = sample(n=len(t), streams=False)
    return replace(base, imu=replace(base.imu, t=t), **more)


def kinds(r: Recording, result: Any = None) -> list[str]:
    return [d.kind for d in doubts(r, result)]


def test_what_goes_wrong_is_said_each_for_itself():
    good = recording()
    imu = good.imu
    assert kinds(good) == []
    keep = (imu.t < 17.5) | (imu.t > 18.3)
    assert kinds(_kept(good, keep)) == ["gap"]
    assert kinds(_kept(good, (imu.t < 15.0) | (np.arange(len(imu.t)) % 2 == 0))) == ["rate"]
    warm = np.linspace(25.0, 50.0, 20)[:, None]
    at = np.linspace(0.0, 20.0, 20)
    assert kinds(replace(good, streams={"temperature": Series(at, warm)})) == ["hot"]
    assert kinds(replace(good, streams={"temperature": Series(at, 0.3 * warm)})) == []
    rng = np.random.default_rng(0)
    u = rng.normal(size=(400, 3))
    field = 5e-5 * u / np.linalg.norm(u, axis=1)[:, None] + rng.normal(0.0, 2e-7, (400, 3))
    mag = Series(np.linspace(0.0, 20.0, 400), field)
    assert kinds(replace(good, streams={"mag": mag})) == []
    near = field.copy()
    near[mag.t > 17.0] *= 2.5
    assert kinds(replace(good, streams={"mag": Series(mag.t, near)})) == ["magnet"]

    def held(late: float) -> Any:
        at = np.arange(0.0, 20.0, 0.5)
        nis = np.where(at > 17.0, late, 3.0)
        one = SimpleNamespace(t=at, nis=nis, residual=np.zeros((len(at), 3)))
        return SimpleNamespace(assume="fixed-point", innovations={"fixed_position": one})

    assert kinds(good, held(3.0)) == []
    assert kinds(good, held(300.0)) == ["travels"]
    away = SimpleNamespace(assume="rest-only", innovations={})
    assert kinds(good, away) == ["travels"]


def _kept(r: Recording, keep: np.ndarray) -> Recording:
    imu = r.imu
    return replace(r, imu=replace(imu, t=imu.t[keep], gyro=imu.gyro[keep], accel=imu.accel[keep],
                                  valid=imu.valid[keep]))  # fmt: skip


def test_a_window_that_is_closed_is_what_is_known_before_the_next():
    """Its scales are as sure as they were, its biases a little less."""

    class Now:
        def submit(self, *_: Any) -> Any:
            return SimpleNamespace(done=lambda: True, result=lambda: found)

    forgotten: list[int] = []
    session: Any = SimpleNamespace(forget=forgotten.append)
    scale = parameter("gyro_scale", "x", 1e-3)
    bias = parameter("gyro_bias", "x", 1e-6, "rad/s")
    worker: Any = Now()
    looks = Looks(worker)
    for seconds, at_rest, closed in ((60.0, True, 0), (130.0, False, 0), (130.0, True, 1)):
        found = look(scale, bias, end_s=seconds, at_rest=at_rest)
        looks.tick(session, recording())
        assert looks.tick(session, recording()) is found
        assert len(forgotten) == closed
    assert looks.before is not None
    assert looks.before.names == (("gyro_scale", "x"), ("gyro_bias", "x"))
    sigma = np.sqrt(np.diag(carried(found).covariance))
    assert sigma[0] == pytest.approx(1e-3)
    assert 1e-6 < sigma[1] < 1e-4


def test_of_rounded_readings_one_is_less_sure():
    """Twice, but no less sure than at the start; correlations stay."""
    known, unknown = parameter("gyro_scale", "x", 1e-3), parameter("gyro_scale", "y", 9.9e-3)
    covariance = np.array([[1e-6, 4e-6], [4e-6, 9.801e-5]])
    (first, second), wider = less_sure([known, unknown], covariance)
    assert first.sigma == pytest.approx(2e-3)
    assert second.sigma == pytest.approx(1e-2)
    np.testing.assert_allclose(np.sqrt(np.diag(wider)), [2e-3, 1e-2])
    correlation = wider[0, 1] / np.sqrt(wider[0, 0] * wider[1, 1])
    assert correlation == pytest.approx(4e-6 / np.sqrt(1e-6 * 9.801e-5))
    plain = recording()
    assert not rounded(plain)
    imu = plain.imu
    assert rounded(replace(plain, imu=replace(imu, accel=np.round(imu.accel, 1))))

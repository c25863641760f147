"""The search over sets of effects, on made-up linear readings of which everything is known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp
from worlds import recording_of

from handcal.effects import Effect, Param, catalogue, select
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.prior_scales import LOG_SHARES, SCALES
from handcal.estimate.quadratic import Quadratic
from handcal.model_score import PRIOR
from handcal.search.beyond_columns import akin
from handcal.search.candidates import scanned_about
from handcal.search.space import (
    Space,
    best_set,
    expected_gain,
    gains,
    probabilities,
    rivals,
    space,
)
from handcal.types import Array
from handcal_sim import simulate
from handcal_sim.phone import Phone, capture_pose, consumer_phone


def _effect(name: str, parameters: int, positive: bool = False) -> Effect:
    own = tuple(Param(str(i), "1", 1.0, positive) for i in range(parameters))
    return replace(select(["gravity"])[0], id=name, parameters=own)


def _space(
    y: Array,
    columns: Mapping[str, Array],
    prior: Mapping[str, float] | None = None,
    positive: Sequence[str] = (),
) -> Space:
    """Readings y (n,) = columns @ u + white noise of 1, each effect with columns (n, k)."""
    X = np.hstack([c.reshape(len(y), -1) for c in columns.values()])
    effects = [_effect(i, c.reshape(len(y), -1).shape[1], i in positive)
               for i, c in columns.items()]  # fmt: skip
    names = tuple((e.id, p.name) for e in effects for p in e.parameters)
    q = Quadratic(names, float(-0.5 * y @ y), X.T @ y, X.T @ X)
    return space(q, effects, prior or {})


def _subsets(ids: Sequence[str]) -> list[frozenset[str]]:
    return [frozenset(s) for k in range(len(ids) + 1) for s in combinations(ids, k)]


# --- which set ---------------------------------------------------------------------------------

UNIT = np.eye(12)


def test_a_set_is_worth_its_evidence_and_its_odds() -> None:
    """One reading z = 3 u + noise: log N(z; 0, 1 + 9) - log N(z; 0, 1), and the same with the
    wider scales that a prior has."""
    where = _space(np.array([7.0]), {"a": np.array([3.0])}, {"a": -2.0})
    S = 1.0 + 9.0 * SCALES**2
    gained = float(logsumexp(0.5 * 49.0 * (1.0 - 1.0 / S) - 0.5 * np.log(S) + LOG_SHARES))
    assert where.score(["a"]) - where.score([]) == pytest.approx(gained - 2.0)
    assert gains(where, frozenset()) == {"a": pytest.approx(gained)}
    assert gains(where, frozenset("a")) == {"a": pytest.approx(gained)}
    assert space(where.quadratic, [_effect("a", 1)], {}).prior == {"a": PRIOR}


def test_two_that_a_third_stands_in_for_are_found() -> None:
    """The third is better than either of them alone, and neither helps beside it as much as
    both instead of it: only two at once, for one, lead on."""
    a, b, away = UNIT[:3]
    readings = {"a": 10.0 * a, "b": 10.0 * b, "c": 8.0 * (a + b) + 3.0 * away}
    where = _space(12.0 * (a + b), readings)
    alone = gains(where, frozenset())
    assert alone["c"] > max(alone["a"], alone["b"]) + 10.0
    assert where.score("c") > max(where.score(s) for s in ("ac", "bc", "a", "b", ""))
    assert best_set(where) == frozenset("ab")


def test_one_is_exchanged_for_another() -> None:
    """A stand-in that is better alone, since it mimics a second effect too, and worse beside
    that second one."""
    a, b, away = UNIT[:3]
    readings = {"a": 10.0 * a, "b": 10.0 * b, "s": 10.0 * a + 6.0 * b + 2.0 * away}
    where = _space(15.0 * (a + b), readings)
    alone = gains(where, frozenset())
    assert max(alone, key=lambda i: alone[i]) == "s"
    assert where.score("sb") > max(where.score("s"), where.score("sba"))
    assert best_set(where, "sb") == frozenset("ab")
    assert best_set(where) == frozenset("ab")


def test_one_takes_the_place_of_two() -> None:
    """Dropping either of the two, adding the one or exchanging one for it makes it worse."""
    a, b = UNIT[:2]
    readings = {"a": 10.0 * a, "b": 10.0 * b, "one": 10.0 * (a + b)}
    where = _space(6.0 * (a + b), readings, {"a": -8.0, "b": -8.0, "one": -12.0})
    others = [s for s in _subsets(["a", "b", "one"]) if s not in ({"one"}, {"a", "b"})]
    assert where.score("ab") > max(where.score(s) for s in others)
    assert best_set(where, "ab") == {"one"}


def test_two_that_show_only_together() -> None:
    """Readings of their difference: each of them alone explains nearly nothing."""
    a, b = UNIT[:2]
    readings = {"a": 50.0 * a, "b": 50.0 * a + 6.0 * b, "other": UNIT[5]}
    where = _space(8.0 * b, readings)
    assert max(gains(where, frozenset())[i] for i in "ab") < -PRIOR
    assert best_set(where) == frozenset("ab")
    # and which, if they show too little for two, are dropped together
    where = _space(5.0 * b, readings)
    assert max(where.score("a"), where.score("b")) < where.score("ab") < where.score("")
    assert best_set(where, "ab") == frozenset()


def test_an_effect_that_is_not_missed_is_dropped() -> None:
    where = _space(12.0 * UNIT[0], {"a": 10.0 * UNIT[0], "b": 10.0 * UNIT[1]})
    assert best_set(where, "ab") == frozenset("a")
    assert best_set(where, "b") == frozenset("a")
    assert best_set(_space(UNIT[3], {"a": UNIT[0]}), "a") == frozenset()


def test_as_good_as_trying_every_set() -> None:
    """Seven effects of one to three parameters that look alike (correlations of about a half),
    two or three of them present. One local optimum in forty is allowed for."""
    missed = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        common = rng.normal(size=(30, 1))
        readings = {
            i: 2.0 * (rng.normal(size=(30, rng.integers(1, 4))) + common) for i in "abcdefg"
        }
        y = rng.normal(size=30)
        for i in rng.choice(list("abcdefg"), rng.integers(2, 4), replace=False):
            y = y + readings[i] @ rng.normal(size=readings[i].shape[1])
        where = _space(y, readings)
        best = max(where.score(s) for s in _subsets("abcdefg"))
        if where.score(best_set(where)) < best - 1e-9:
            missed.append(seed)
    assert len(missed) <= 1


# --- positive parameters, moments --------------------------------------------------------------


@pytest.mark.parametrize("z", [-9.0, -2.0, 0.0, 0.5, 4.0, 9.0])
def test_a_positive_parameter_has_half_a_prior_twice_as_dense(z: float) -> None:
    """Against the integral over u > 0."""
    where = _space(np.array([z]), {"tau": np.array([3.0])}, positive=["tau"])
    u, step = np.linspace(0.0, 9.0, 900001, retstep=True)
    prior = sum(
        math.exp(w) / s * np.exp(-0.5 * (u / s) ** 2)
        for s, w in zip(SCALES, LOG_SHARES, strict=True)
    )
    density = np.exp(-0.5 * (z - 3.0 * u) ** 2) * prior * math.sqrt(2.0 / math.pi)
    expected = math.log(float(np.sum(0.5 * (density[1:] + density[:-1])) * step)) + PRIOR
    assert where.score(["tau"]) == pytest.approx(expected, abs=1e-6)


def test_a_time_constant_below_zero_is_refused() -> None:
    """A lag of less than nothing fits better than anything, and is no lag."""
    readings = {"tau": 10.0 * UNIT[0], "delay": 8.0 * UNIT[0] + 2.0 * UNIT[1]}
    found = {}
    for sign in (1.0, -1.0):
        either = [_space(sign * 12.0 * UNIT[0], readings, positive=p) for p in ((), ("tau",))]
        assert best_set(either[0]) == {"tau"}
        found[sign] = best_set(either[1])
        assert (either[1].score(["tau"]) < either[1].score([])) == (sign < 0.0)
    assert found == {1.0: {"tau"}, -1.0: {"delay"}}


def test_a_step_happens_at_one_moment_at_most() -> None:
    """Even if the readings show two jumps."""
    readings = {f"step@{k}.000": 10.0 * UNIT[k] for k in range(4)} | {"a": 10.0 * UNIT[6]}
    where = _space(12.0 * (UNIT[1] + 1.5 * UNIT[2] + UNIT[6]), readings)
    assert best_set(where) == {"step@2.000", "a"}
    assert best_set(where, ["step@1.000"]) == {"step@2.000", "a"}
    assert where.score(["step@1.000", "step@2.000"]) == -math.inf
    probable = probabilities(where, frozenset({"step@2.000", "a"}))
    assert sum(p for i, p in probable.items() if "@" in i) <= 1.0 + 1e-12


# --- how probable ------------------------------------------------------------------------------


def _drawn(rng: np.random.Generator, odds: Mapping[str, float]) -> tuple[Space, frozenset[str]]:
    """Effects present as their odds say, sizes as their priors say, and readings of those."""
    common = rng.normal(size=(8, 1))
    readings = {i: 1.5 * (rng.normal(size=(8, 1 + k % 2)) + common) for k, i in enumerate(odds)}
    there = frozenset(i for i, x in odds.items() if rng.random() < 1.0 / (1.0 + math.exp(-x)))
    y = rng.normal(size=8)
    for i in there:
        scale = rng.choice(SCALES, p=np.exp(LOG_SHARES))
        y = y + readings[i] @ (scale * rng.normal(size=readings[i].shape[1]))
    return _space(y, readings, odds), there


@pytest.mark.parametrize("seed", range(5))
def test_probabilities_of_two_are_those_of_bayes(seed: int) -> None:
    where, _ = _drawn(np.random.default_rng(seed), {"a": -1.0, "b": 0.5})
    weight = {s: math.exp(where.score(s) - where.quadratic.a) for s in _subsets("ab")}
    for chosen in _subsets("ab"):
        for i, p in probabilities(where, chosen).items():
            expected = sum(w for s, w in weight.items() if i in s) / sum(weight.values())
            if len(chosen) == 1:  # then every set is a neighbour
                assert p == pytest.approx(expected, rel=1e-9)
            assert 0.0 <= p <= 1.0


def test_what_a_fit_did_not_keep_speaks_for_nobody() -> None:
    """A scan promised 19 nats for a law beside an effect that gains 9.7, and a fit refused it; the
    effect was said to be there at 99.9999 % for the sake of that promise."""
    where = _space(4.4 * UNIT[0] + 9.0 * UNIT[1], {"a": 9.0 * UNIT[0], "law": 9.0 * UNIT[1]})
    chosen = frozenset("a")
    odds = where.score(chosen) - where.score(())
    assert 0.0 < odds < 6.0
    assert where.score(["a", "law"]) > where.score(chosen) + 10.0
    probable = probabilities(where, chosen, most=where.score(chosen))
    assert probable == {"a": pytest.approx(1.0 / (1.0 + math.exp(-odds))), "law": 0.0}


def test_of_those_said_to_be_probable_as_many_are_there() -> None:
    """3000 draws from the prior, six bins of what is said; of each bin's N a share of the mean
    said is there, within 4 sigma of the binomial."""
    odds = {"a": -0.5, "b": -1.0, "c": -1.5}
    said, there = [], []
    for seed in range(1000):
        where, present = _drawn(np.random.default_rng(seed), odds)
        probable = probabilities(where, best_set(where))
        said += [probable[i] for i in odds]
        there += [i in present for i in odds]
    p, seen = np.array(said), np.array(there)
    assert len(p) == 3000
    for low, high in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.0)):
        mine = (p >= low) & (p <= high)
        assert mine.sum() >= 50
        expected, sigma = p[mine].sum(), math.sqrt((p[mine] * (1.0 - p[mine])).sum())
        assert abs(seen[mine].sum() - expected) < 4.0 * sigma, (low, high)


def test_rivals_are_compared_in_one_place() -> None:
    where, _ = _drawn(np.random.default_rng(1), {"a": -1.0, "b": 0.5, "c": 0.0})
    found = rivals(where, frozenset("ab"), "a")
    assert found == {"a": 0.0, "c": pytest.approx(where.score("cb") - where.score("ab"))}


# --- how much is to be expected ----------------------------------------------------------------


@pytest.mark.parametrize(
    "chosen", [("b",), *(pytest.param(k, marks=pytest.mark.prove) for k in ((), ("b", "c")))]
)
def test_expected_gain_is_the_mean_gain(chosen: tuple[str, ...]) -> None:
    """Over the noise, and over effects in the model of which only the prior is known; 4 sigma
    of the mean of 4000."""
    rng = np.random.default_rng(3)
    k = {"a": 2, "b": 1, "c": 2}
    readings = {i: rng.normal(size=(10, n)) for i, n in k.items()}
    size, N = np.array([1.5, -2.0]), 4000
    gained = np.empty(N)
    for n in range(N):
        y = readings["a"] @ size + rng.normal(size=10)
        for i in chosen:
            y = y + readings[i] @ rng.normal(size=k[i])
        where = _space(y, readings)
        gained[n] = gains(where, frozenset(chosen))["a"]
    expected = expected_gain(where, "a", frozenset(chosen), size)
    assert abs(gained.mean() - expected) < 4.0 * gained.std() / math.sqrt(N)
    # in the model or not, it is what it adds to the rest
    assert expected_gain(where, "a", frozenset({*chosen, "a"}), size) == pytest.approx(expected)
    assert expected > 1.0


def test_effects_that_are_one_to_the_first_order_know_each_other() -> None:
    """Whatever the linearisation says, one is fitted in the other's place."""
    assert akin("gyro_bandwidth", "accel_delay")
    assert akin("accel_delay", "gyro_bandwidth")
    assert not akin("gyro_scale", "accel_delay")
    assert not akin("accel_delay", "gyro_bias_step@4.500")
    for effect in catalogue().values():
        assert set(effect.akin) <= set(catalogue())


def test_a_hand_that_turns_about_no_single_point_is_no_size_effect() -> None:
    """Where only the held point tells where the device was, real hands show some of it; a pose
    is not fooled."""

    def tracked(rng: np.random.Generator) -> Phone:
        return replace(consumer_phone(rng), pose=capture_pose(rng))

    held = simulate("free-hand", seed=0, duration_s=20.0, phone=tracked)
    odds = {}
    for stream in ("heading", "pose"):
        case = case_of(recording_of(held, stream))
        model = fitted([started(case)], ())
        odds[stream] = scanned_about(model).prior["size_effect"]
    assert odds["pose"] == PRIOR
    assert odds["heading"] == PRIOR - catalogue()["size_effect"].imitated < PRIOR - 10.0

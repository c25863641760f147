"""Three accelerometers at one place are a lever arm, and are called so."""

from __future__ import annotations

import math

import numpy as np
import pytest

from handcal.effects import catalogue, select
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic
from handcal.explain import gauge
from handcal.explanation import Hypothesis, Missing

SIZE = 0.02
SIGMA = 0.0006
# as the information matrix says
EXCESS = dict.fromkeys(catalogue(), 1.0)


def model_of(places: np.ndarray, C: np.ndarray, *others: str) -> Model:
    """A fit of the size effect with these places (9,) m of covariance C (9, 9) m^2."""
    effects = select(["size_effect", *others])
    names = tuple((e.id, p.name) for e in effects for p in e.parameters)
    n = len(names)
    u, covariance = np.zeros(n), np.eye(n)
    u[:9], covariance[:9, :9] = places / SIZE, C / SIZE**2
    quadratic = Quadratic(names, 0.0, np.zeros(n), np.eye(n))
    return Model(tuple(effects), (), quadratic, u, covariance, 0.0, True)


def entry(gain: float = 100.0) -> Missing:
    effect = catalogue()["size_effect"]
    return Missing("size_effect", effect.title, 0.999, gain, ("gravity",), (), "", "")


def covariance(rng: np.random.Generator) -> np.ndarray:
    L = SIGMA * (np.tril(rng.normal(0.0, 0.4, (9, 9)), -1) + np.diag(rng.uniform(0.3, 1.5, 9)))
    return np.asarray(L @ L.T)


def test_equal_rows_are_a_lever_arm_and_the_size_effect_is_listed() -> None:
    """Of 400 fits of one place, as many keep the larger name as chance has it: one in a
    thousand, so at most three (four or more: once in a thousand such tests)."""
    rng = np.random.default_rng(0)
    arm = np.array([-0.05, -0.12, 0.07])
    kept, z = 0, []
    for _ in range(400):
        C = covariance(rng)
        places = rng.multivariate_normal(np.tile(arm, 3), C)
        told = gauge.plainly(model_of(places, C), entry(), EXCESS)
        if told.effect == "size_effect":
            kept += 1
            continue
        assert told.effect == "lever_arm"
        assert told.indistinguishable_from == ("size_effect", "gravity")
        assert [p.name for p in told.parameters] == ["x", "y", "z"]
        assert told.log_evidence_gain == 100.0
        z += [(p.value - a) / p.sigma for p, a in zip(told.parameters, arm, strict=True)]
    assert kept <= 3
    # 1,200 of them: the root of their mean square is 1 within four of its sigmas
    assert math.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=4 / math.sqrt(2 * len(z)))


def test_rows_that_differ_stay_a_size_effect() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        C = covariance(rng)
        places = np.tile([-0.05, -0.12, 0.07], 3)
        places[rng.integers(9)] += 0.01
        assert gauge.plainly(model_of(places, C), entry(), EXCESS) == entry()


def test_beside_a_lever_arm_the_size_effect_is_what_is_left() -> None:
    C = SIGMA**2 * np.eye(9)
    assert gauge.plainly(model_of(np.zeros(9), C, "lever_arm"), entry(), EXCESS) == entry()


def test_other_effects_keep_their_names() -> None:
    model = model_of(np.zeros(9), SIGMA**2 * np.eye(9), "gyro_scale")
    scale = Missing("gyro_scale", "", 0.999, 50.0, (), (), "", "")
    assert gauge.plainly(model, scale, EXCESS) == scale


def test_evidence_is_told_of_the_name_that_is_told() -> None:
    """Once found of the size effect and called a lever arm, the table of evidence says the same."""
    model = model_of(np.tile([0.05, 0.02, 0.01], 3), np.eye(9) * SIGMA**2)
    table = [
        Hypothesis("gravity", "", 1.0, 0.0, 2.0, 0.01, ""),
        Hypothesis("lever_arm", "", 1.0, -86.0, 2.0, 0.0, ""),
        Hypothesis("size_effect", "", 1.0, 100.0, 2.0, 0.999, ""),
    ]
    told = gauge.plainly(model, entry(), EXCESS)
    after = {h.effect: (h.final, h.probability) for h in gauge.renamed(model, [told], table)}
    assert after == {
        "gravity": (0.0, 0.01), "lever_arm": (100.0, 0.999), "size_effect": (-86.0, 0.0),
    }  # fmt: skip
    assert gauge.renamed(model, [entry()], table) == tuple(table)

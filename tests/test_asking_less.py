"""What a search does not ask twice, nor where the answer would not count; and what it does ask."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import catalogue
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.model import Model
from handcal.explain import pipeline
from handcal.laws.drivers import Driver, by
from handcal.laws.grammar import formula, shorter
from handcal.laws.law_effect import COMPOSED, SIZE, Law
from handcal.laws.over_drivers import (
    is_product,
    of_one_signal,
    over,
    signals_of,
)
from handcal.laws.vocabulary import driver_of
from handcal.model_score import GAINED, PRIOR, better, of_use
from handcal.search import multistart
from handcal_sim import simulate


@pytest.fixture(scope="module")
def base() -> Model:
    world = simulate("free-hand", seed=0, duration_s=15.0, effects={})
    return baseline([case_of(recording_of(world, "heading"))])


def _search(
    base: Model, monkeypatch: pytest.MonkeyPatch, first: Model, wide: Any, **how: Any
) -> tuple[Model, list[Model]]:
    """The model of a search of which the first climb begins with a model of its own and each ends
    where it began, and these beginnings."""
    begun: list[Model] = []
    monkeypatch.setattr(multistart, "climbed", lambda _, start, __: begun.append(start) or start)
    monkeypatch.setattr(multistart, "steadied", lambda _: first)
    monkeypatch.setattr(multistart, "sways_far", wide)
    return multistart.search(base, **how).model, begun


def test_an_end_that_explains_less_than_the_baseline_is_not_the_last(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the usual noise in the place of a wide sway nothing was found, and with that the search
    was over: the baseline itself, 1,100 nats likelier, was never searched about."""
    wide = iter((True, *[False] * 9))  # (of the baseline alone)
    worse = replace(base, log_evidence=base.log_evidence - 50.0)
    found, begun = _search(base, monkeypatch, worse, lambda _: next(wide))
    assert found.log_evidence == base.log_evidence
    assert len(begun) == 2


def test_a_sum_without_each_of_its_functions():
    whole = formula([("cube", ()), ("compression", (2.6,))])
    assert [(form.kind, kept) for form, kept in shorter(whole)] == [
        ("compression", [1]),
        ("cube", [0]),
    ]
    same = formula([("limit", (0.2,)), ("jump", (0.2,))], same=True)
    assert [form.numbers for form, _ in shorter(same)] == [(0.2,), (0.2,)]
    assert not list(shorter(formula([("cube", ())])))


@pytest.mark.parametrize(("promised", "asked"), [(94.0, False), (96.0, True)])
def test_all_readings_are_asked_again_where_a_scan_promises_what_some_cost(
    promised, asked, monkeypatch
):
    """The model has a hundred nats more without some; their share costs five."""
    scores = {frozenset(): 0.0, frozenset("a"): promised}
    about = SimpleNamespace(score=lambda s: scores[s], quadratic=SimpleNamespace(worth=1.0))
    monkeypatch.setattr(pipeline, "scanned_about", lambda *_: about)
    monkeypatch.setattr(pipeline, "best_set", lambda *_: frozenset("a"))
    whole: Any = SimpleNamespace(bare=None, chosen=frozenset(), log_evidence=-40.0)
    model: Any = SimpleNamespace(log_evidence=60.0)
    assert pipeline._promises(whole, model) is asked
    whole.log_evidence = -np.inf  # (of no fit nothing is known)
    assert pipeline._promises(whole, model)


@pytest.mark.parametrize(
    ("driver", "alone"),
    [
        ("omega_{j} * |f|", ["omega_{j}", "|f|"]),
        ("f_{i} by |omega|", ["f_{i}", "|omega|"]),
        ("|f|", []),
    ],
)
def test_a_product_is_tried_without_each_of_its_signals(driver, alone, base: Model) -> None:
    """One of them may hardly change (a gyro's rate times the square of a force that is gravity)."""
    law = Law(1, (2,), False, driver_of(driver), formula([("line", ())]), (0.01,))
    assert is_product(law.driver) == bool(alone)
    found = of_one_signal(law, signals_of(base.parts[0]))
    assert [x.driver.name for x in found] == alone
    for x in found:
        assert x.form.parts == (("line", ()),)
        size = np.std(x.values(signals_of(base.parts[0]), 2)) * x.sigmas[0]
        assert size <= SIZE[1] * 1.01  # (as large as any law may be)
    cost = replace(law, driver=driver_of("omega_{j}")).cost
    assert law.cost == pytest.approx(cost + (COMPOSED if alone else 0.0))


def test_of_what_is_never_felt_there_is_no_law(base: Model) -> None:
    """A threshold on trial may be one that nothing reaches: `explain` ended in a division by
    zero."""
    signals = signals_of(base.parts[0])
    silent = Driver("(nothing)", "rad/s", lambda s, _: 0.0 * s.t)
    assert over(by(silent, driver_of("|omega|")), signals, (0,)) == []
    assert over(by(driver_of("omega_{i}"), driver_of("|omega|")), signals, (0,))


@pytest.mark.parametrize("worth", [1.0, 0.2])
def test_a_fit_is_of_use_from_where_noise_levels_may_still_make_it_the_better(
    worth: float, base: Model
) -> None:
    """An effect has to gain its odds, in evidence that counts for less."""
    least = of_use(base, [*base.effects, catalogue()["gyro_quadratic"]], worth)
    assert least == pytest.approx(base.log_evidence - PRIOR / worth - GAINED, abs=1e-6)
    rare = catalogue()["gyro_quadratic"]
    alike = replace(base, effects=(*base.effects, rare), log_evidence=least)
    assert better(base, alike, worth) == pytest.approx(worth * GAINED, abs=1e-6)

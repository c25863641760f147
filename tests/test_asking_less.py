"""What a search does not ask twice, nor where the answer would not count; and what it does ask."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import catalogue
from handcal.estimate import fit, scan
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.model import Model, Rested
from handcal.estimate.specification import Options, Specification
from handcal.explain import pipeline
from handcal.laws import best_law, chosen_again
from handcal.laws.best_law import Term
from handcal.laws.drivers import Driver, by
from handcal.laws.grammar import formula, shorter
from handcal.laws.law_effect import COMPOSED, SIZE, Law, effect_of
from handcal.laws.over_drivers import (
    is_product,
    of_one_signal,
    over,
    signals_of,
)
from handcal.laws.vocabulary import driver_of
from handcal.model_score import GAINED, PRIOR, better, of_use, prior
from handcal.search import multistart
from handcal.search.budget import Budget
from handcal.search.climb import (
    candidates,
    exchange_steps,
    in_place,
    law_steps,
    noise_steps,
    sequence,
    state,
    subset_steps,
)
from handcal_sim import simulate


@pytest.fixture(scope="module")
def base() -> Model:
    world = simulate("free-hand", seed=0, duration_s=15.0, effects={})
    return baseline([case_of(recording_of(world, "heading"))])


def test_no_second_climb_where_the_first_is_superseded(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Model] = []
    rivals: list[Model | None] = []

    def end(start: Model, *_: object, rival: Model | None) -> multistart.Found:
        begun.append(start)
        rivals.append(rival)
        return multistart.Found(start, None, {}, {}, named=start)  # type: ignore[arg-type]

    monkeypatch.setattr(multistart, "_end", end)
    monkeypatch.setattr(multistart, "sways_far", lambda _: True)
    monkeypatch.setattr(multistart, "advantage", lambda *_: 0.0)
    monkeypatch.setattr(multistart, "_may_stand_in", lambda _: False)
    multistart.search(base)
    assert len(begun) == 2
    assert rivals == [None, begun[0]]  # (with what the first began to look for laws)
    begun.clear()
    assert multistart.search(base, superseded=lambda _: True).model is begun[0]
    assert len(begun) == 1


def test_an_end_that_explains_less_than_the_baseline_is_not_the_last(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the usual noise in the place of a wide sway nothing was found, and with that the search
    was over: the baseline itself, 1,100 nats likelier, was never searched about."""
    begun: list[Model] = []

    def end(start: Model, *_: object, **__: object) -> multistart.Found:
        begun.append(start)
        return multistart.Found(start, None, {}, {}, named=start)  # type: ignore[arg-type]

    wide = iter((True, *[False] * 9))  # (of the baseline alone)
    monkeypatch.setattr(multistart, "_end", end)
    monkeypatch.setattr(multistart, "sways_far", lambda _: next(wide))
    monkeypatch.setattr(multistart, "_may_stand_in", lambda _: False)
    monkeypatch.setattr(
        multistart, "advantage", lambda a, b: a.model.log_evidence - b.model.log_evidence
    )
    worse = replace(base, log_evidence=base.log_evidence - 50.0)
    monkeypatch.setattr(multistart, "steadied", lambda _: worse)
    assert multistart.search(base).model.log_evidence == base.log_evidence
    assert len(begun) == 2


def test_a_hand_is_asked_about_once_for_each_end(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(pipeline, "moving", lambda _, model, __: asked.append(model))
    monkeypatch.setattr(pipeline, "_gained", lambda _: {})
    hand = pipeline._Hand(base, True, Budget())
    one, other = (
        multistart.Found(replace(base), None, {}, {})  # type: ignore[arg-type]
        for _ in range(2)
    )
    assert not hand.moves(one)
    assert hand.other(one) is None
    assert len(asked) == 1
    assert hand.other(other) is None
    assert len(asked) == 2
    assert not pipeline._Hand(base, False, Budget()).moves(one)
    assert len(asked) == 2


@pytest.mark.parametrize(("good", "asked"), [(0, 1), (1, 2), (2, 3), (None, 3)])
def test_no_start_of_the_final_fit_is_asked_for_after_one_that_is_as_good(
    good: int | None, asked: int, base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []

    def fits(_: object, written: Specification) -> Model:
        begun.append(written.begin or "exact")
        less = 0.0 if len(begun) - 1 == good else 2.0 * pipeline.SAME + len(begun)
        return replace(base, log_evidence=base.log_evidence - less)

    monkeypatch.setattr(pipeline, "settled", fits)
    monkeypatch.setattr(pipeline, "in_parallel", lambda calls: (call() for call in calls))
    monkeypatch.setattr(pipeline, "_with", lambda found, model: replace(found, model=model))
    found = multistart.Found(base, SimpleNamespace(), {}, {})
    end = SimpleNamespace(base=base, moves=False)
    monkeypatch.setattr(pipeline, "moments", lambda _: {})
    told, written = pipeline._refitted(end, found, Options())
    assert begun == ["baseline", "online", "exact"][:asked]
    best = 0 if good is None else good
    assert (written.begin or "exact") == begun[best]
    worse = 2.0 * pipeline.SAME + 1.0 if good is None else 0.0
    assert told.model.log_evidence == base.log_evidence - worse


def test_a_sum_without_each_of_its_functions():
    whole = formula([("cube", ()), ("compression", (2.6,))])
    assert [(form.kind, kept) for form, kept in shorter(whole)] == [
        ("compression", [1]),
        ("cube", [0]),
    ]
    same = formula([("limit", (0.2,)), ("jump", (0.2,))], same=True)
    assert [form.numbers for form, _ in shorter(same)] == [(0.2,), (0.2,)]
    assert not list(shorter(formula([("cube", ())])))


@pytest.mark.parametrize(("held", "asked"), [(40.0, False), (59.0, False), (61.0, True)])
def test_a_law_is_looked_for_again_where_noise_holds_as_much_more_as_it_lacked(held, asked):
    last = state.Barred(frozenset({"gyro_bias_walk"}), 40.0, 20.0)
    assert in_place._may_hide(last, frozenset({"gyro_bias_walk"}), held) is asked
    assert in_place._may_hide(None, frozenset({"gyro_bias_walk"}), held)  # (nothing was tried)
    assert in_place._may_hide(last, frozenset({"gyro_bias_walk", "gyro_scale"}), held)


def test_by_how_much_the_best_law_of_a_sensor_fell_short(monkeypatch):
    monkeypatch.setattr(in_place, "better", lambda a, b, _: a.log_evidence - b.log_evidence)
    c: Any = SimpleNamespace(model=_named((), 50.0), worth=1.0)

    def end(law, evidence):
        return _named((), evidence), SimpleNamespace(effect=SimpleNamespace(id=law))

    ends = [end("gyro_x += a", 20.0), end("gyro_x += b", 35.0), end("accel_x += a", 90.0)]
    assert in_place._fell_short(c, "gyro", ends) == 15.0
    assert in_place._fell_short(c, "accel", ends) == -40.0
    # of none that was found: what a scan asks of one; of none that could be fitted: nothing
    assert in_place._fell_short(c, "heading", ends) == pytest.approx(np.log(2000.0) + 5.0)
    assert in_place._fell_short(c, "gyro", [end("gyro_x += a", -np.inf)]) == 0.0


@pytest.mark.parametrize(
    ("worth", "last", "asked"),
    [
        ({1: 20.0, 2: 90.0}, False, [1]),  # (a law is found beside the noise: that is enough)
        ({1: -5.0, 2: 90.0}, False, [1, 2]),
        ({1: 20.0, 2: 90.0}, True, [1, 2]),  # (no other can follow: the best of all)
        ({1: -5.0, 2: -9.0}, False, [1, 2]),
    ],
)
def test_in_the_place_of_more_no_law_is_sought_while_there_is_one_in_that_of_less(
    worth, last, asked, monkeypatch
):
    sets = [frozenset({"gyro_bias_walk"}), frozenset({"gyro_bias_walk", "gyro_scale"})]
    seen: list[int] = []

    def beside(_, _sensor, ids, _refused):
        seen.append(len(ids))
        term: Any = SimpleNamespace(effect=SimpleNamespace(id=f"gyro_x += {len(ids)}", made=None))
        return _named((*ids,), 0.0), [term]

    def fits(_, ways):
        return [
            (_named((*rest,), worth[int(law[-1])]), t) for (rest, law, _), (_, t) in ways.items()
        ]

    monkeypatch.setattr(in_place, "beside_the_rest", beside)
    monkeypatch.setattr(in_place, "fits_of", fits)
    monkeypatch.setattr(in_place, "refused_by", lambda _: set())
    monkeypatch.setattr(in_place, "_doubted", lambda _: {"gyro": sets})
    monkeypatch.setattr(in_place, "_hidden_by", lambda *_: (frozenset(), 0.0))
    monkeypatch.setattr(in_place, "forget", lambda *_: None)
    for module in (in_place, state):
        monkeypatch.setattr(module, "score", lambda m, _: m.log_evidence)
        monkeypatch.setattr(module, "likelier", lambda _, m: m.log_evidence > 0.0)
    monkeypatch.setattr(in_place, "better", lambda a, b, _: a.log_evidence - b.log_evidence)
    c: Any = SimpleNamespace(
        model=_named(("gyro_bias_walk", "gyro_scale"), 0.0), worth=1.0, budget=Budget(),
        bared=set(), barred={}, unnamed=[],
    )  # fmt: skip
    found = in_place.instead_of_noise(c, 1 if last else 2)
    best = max(worth[k] for k in asked)
    assert seen == asked
    assert found is None if best < 0.0 else found.log_evidence == best
    # what was not asked is asked the next time, also of the same model
    whole = asked == [1, 2]
    assert (frozenset(c.model.ids) in c.bared, "gyro" in c.barred) == (whole, whole)


def test_a_law_whose_fit_swings_does_not_hide_one_that_rests(monkeypatch):
    monkeypatch.setattr(state, "score", lambda m, _: m.log_evidence)
    monkeypatch.setattr(in_place, "forget", lambda *_: None)
    monkeypatch.setattr(state, "likelier", lambda _, m: m.log_evidence > m.swing)
    law, wild = (SimpleNamespace(effect=SimpleNamespace(id=i)) for i in ("gyro", "accel"))
    rests: Any = SimpleNamespace(log_evidence=20.0, swing=0.0)
    swings: Any = SimpleNamespace(log_evidence=90.0, swing=600.0)
    c: Any = SimpleNamespace(worth=1.0, unnamed=[])
    assert in_place.likeliest(c, [(swings, wild), (rests, law)]) is rests
    assert c.unnamed == [law]
    assert in_place.likeliest(c, [(swings, wild)]) is None


def _named(ids, evidence):
    model: Any = SimpleNamespace(ids=ids, log_evidence=evidence)
    return model


@pytest.mark.parametrize(
    ("ids", "ahead", "ends"),
    [
        (("a",), 4.0, True),  # (the same, but for what a fit is right to)
        (("a",), 6.0, False),
        (("b",), -99.0, False),
        (("b",), -101.0, True),
    ],
)
def test_a_climb_ends_where_another_was_ahead(ids, ahead, ends, monkeypatch):
    monkeypatch.setattr(state, "better", lambda a, b, _: a.log_evidence - b.log_evidence)
    rival = _named(("a",), 0.0)
    c: Any = SimpleNamespace(model=_named(ids, ahead), rival=rival, named=None, worth=1.0)
    c.budget, c.fruitless = Budget(), {}
    step: Any = lambda _: rival  # noqa: E731
    monkeypatch.setattr(sequence, "_LAWS", (step,))
    monkeypatch.setattr(sequence, "_STEPS", {step: "laws"})
    assert (sequence._taken(c, step) is None) is ends
    c.model = _named(("a", "b", "c"), 900.0)  # (what it comes to afterwards says nothing of that)
    assert state.beaten(c) is ends
    c.rival = None
    assert not state.beaten(c)


def test_what_led_nowhere_is_not_asked_by_another_climb_about_the_same_fit(monkeypatch):
    asked = []
    step: Any = lambda c: asked.append(c.model.ids)  # noqa: E731
    monkeypatch.setattr(sequence, "_LAWS", (step,))
    monkeypatch.setattr(sequence, "_STEPS", {step: "laws"})
    fruitless: dict[Any, float] = {}
    for ids, evidence in [("a", 10.0), ("a", 9.0), ("a", 10.9), ("b", 9.0), ("a", 12.0)]:
        c: Any = SimpleNamespace(model=_named((ids,), evidence), rival=None, named=None)
        c.budget, c.fruitless = Budget(), fruitless
        assert sequence._taken(c, step) is None
    assert asked == [("a",), ("b",), ("a",)]


def _climb(base, evidence=0.0):
    c = state.Climb(replace(base, log_evidence=base.log_evidence + evidence), ())
    c.where = SimpleNamespace(quadratic=SimpleNamespace(worth=0.5))
    return c


@pytest.mark.parametrize(("since", "again"), [(0.0, False), (9.0, False), (-9.0, False),
                                              (11.0, True), (-11.0, True)])  # fmt: skip
def test_what_fell_short_is_tried_again_where_the_score_has_changed_by_half_of_that(
    base, since, again
):
    c, what = _climb(base), ("thin", "gyro_scale")
    assert not state.in_vain(c, what)
    state.fell_short(c, what, 10.0)  # (evidence counts half: 5 nats are 10)
    changed = _climb(base, since).model
    assert state.in_vain(c, what, changed) is not again
    assert not state.in_vain(c, ("thin", "accel_scale"), changed)
    state.fell_short(c, what, np.inf)  # (what diverged may not do so beside others)
    assert state.in_vain(c, what, changed)
    assert not state.in_vain(c, what, _climb(base, 2.0 * state.HOPELESS).model)


@pytest.mark.parametrize(("ids", "since", "kept"), [
    (("gyro_bandwidth",), 1.0, True),
    (("gyro_bandwidth",), 50.0, False),  # (the others may have made it the better one)
    ((), 1.0, False),  # (neither is there, or both: nothing was exchanged)
    (("gyro_bandwidth", "accel_delay"), 1.0, False),
])  # fmt: skip
def test_an_exchange_in_vain_is_kept_where_the_others_are_much_the_same(base, ids, since, kept):
    c, pair = _climb(base), ("accel_delay", "gyro_bandwidth")
    c.swaps = {pair: -20.0, pair[::-1]: 20.0}
    state.fell_short(c, pair, 20.0)
    effects = tuple(catalogue()[i] for i in ids)
    # (their own odds are no news)
    odds = state._odds(replace(base, effects=effects)) - state._odds(base)
    other = _climb(base, since - odds / c.worth).model
    state.beside_others(c, replace(other, effects=effects))
    assert c.swaps == ({pair: -20.0, pair[::-1]: 20.0} if kept else {})


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
    assert pipeline._promises(whole, _named((), 60.0)) is asked
    whole.log_evidence = -np.inf  # (of no fit nothing is known)
    assert pipeline._promises(whole, _named((), 60.0))


def _law(kind, smooth, composed=False):
    effect = SimpleNamespace(id=f"gyro_x += {kind}")
    form, driver = SimpleNamespace(smooth=smooth), SimpleNamespace(composed=composed)
    return SimpleNamespace(form=form, effect=effect, driver=driver)


def test_the_best_curve_is_looked_at_whatever_does_better():
    ends = [(_law(str(n), False), 50.0 - n) for n in range(5)]
    curve, worse = (_law("g", True), 20.0), (_law("h", True), 10.0)
    assert best_law._best_of([*ends, curve, worse]) == [*ends[: best_law.CLOSER], curve]
    assert best_law._best_of([curve, *ends]) == [curve, *ends[: best_law.CLOSER - 1]]
    assert best_law._best_of(ends[:2]) == ends[:2]


def test_what_is_no_composition_is_looked_at_whatever_does_better():
    ends = [(_law(str(n), False, composed=True), 50.0 - n) for n in range(5)]
    plain, worse = (_law("p", False), 20.0), (_law("q", False), 10.0)
    assert best_law._best_of([*ends, plain, worse]) == [*ends[: best_law.CLOSER], plain]
    terms = [Term(SimpleNamespace(id=f"accel_z += {n}", made=None), 9.0 - n) for n in range(3)]
    assert best_law._first_ones(terms) == terms[:1]


def test_of_a_law_that_is_a_composition_the_best_of_the_others_is_on_trial():
    names = "f_{i} * (memory(1 s) of omega_{i})", "f_{j} * |f_{k}|", "f_{j}"
    line = formula([("line", ())])
    made = [effect_of(Law(1, (2,), False, driver_of(name), line, (1.0,))) for name in names]
    terms = [Term(e, 9.0) for e in made]
    assert best_law._first_ones(terms) == terms[:2]
    assert best_law._first_ones(terms[1:]) == terms[1:2]


def test_laws_that_a_scan_cannot_tell_apart_are_told_apart_by_fits():
    def term(formula, gain):
        return best_law.Term(SimpleNamespace(id=formula), gain)

    first, near = term("gyro_x += a", 50.0), term("gyro_x += b", 50.0 - best_law.UNTOLD + 0.1)
    far, other = term("gyro_x += c", 50.0 - best_law.UNTOLD - 0.1), term("gyro_y += a", 50.0)
    found = best_law._with_rivals(first, [first, near, far, other])
    assert found.others == (near.effect,)


@pytest.mark.parametrize(
    ("formula_", "sensors"),
    [("gyro_z += k * t^2", ["gyro"]), ("heading += k * t^2", ["heading"])],
)
def test_what_a_course_may_be_is_looked_for_in_the_past_of_its_sensor(
    formula_, sensors, monkeypatch
):
    asked = []
    monkeypatch.setattr(chosen_again, "best_terms", lambda _, **how: asked.append(how["beyond"]))
    where: Any = SimpleNamespace(model=SimpleNamespace(ids=(formula_,)))
    term = best_law.Term(SimpleNamespace(id=formula_, made=None), 9.0)
    assert chosen_again.reshaped(where, 1.0, [term], set()) is None
    assert asked == [sensors]


@pytest.mark.parametrize(
    ("form", "asked"), [((("cube", ()),), False), ((("line", ()), ("sign", (0.1,))), True)]
)
def test_a_sum_is_asked_for_each_of_its_functions_again_when_its_numbers_are_right(
    form: tuple[Any, ...], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of them may have made up for numbers that were not right yet."""
    law = Law(0, (0,), False, driver_of("omega_{i}"), formula(form), (0.01,) * len(form))
    old, new = (replace(effect_of(law), id=name) for name in ("before", "after"))
    monkeypatch.setattr(law_steps, "adjusted", lambda _, e: new if e is old else None)
    monkeypatch.setattr(law_steps, "with_other", lambda *_: SimpleNamespace(ids=("after",)))
    monkeypatch.setattr(law_steps, "likelier", lambda *_: True)
    c = SimpleNamespace(
        unnamed=[Term(old, 1.0)], model=SimpleNamespace(ids=("before",)),
        adjusted=set(), shaped=set(), whole=set(), budget=Budget(), worth=1.0,
    )  # fmt: skip
    found: Any = law_steps.adjust(c)  # type: ignore[arg-type]
    assert found.ids == ("after",)
    assert ("after" not in c.whole) == asked


@pytest.mark.parametrize(("there", "dropped"), [("gyro_bias_step@12", set()), ("lever_arm", {"x"})])
def test_what_fits_at_no_other_moment_stays_where_it_is(there, dropped, monkeypatch):
    """A step moved to where no fit holds; an effect with which none does."""
    wanted = "gyro_bias_step@13" if "@" in there else "x"
    model = SimpleNamespace(chosen=frozenset([there]), log_evidence=0.0)
    c: Any = SimpleNamespace(model=model, refused=set(), dropped=set(), beyond=set(), worth=1.0)
    c.where = SimpleNamespace(score=len)
    lost = SimpleNamespace(log_evidence=-2.0 * subset_steps.GAINED)
    monkeypatch.setattr(subset_steps, "fitted_with", lambda *_: lost)
    monkeypatch.setattr(subset_steps, "likelier", lambda *_: False)
    monkeypatch.setattr(subset_steps, "too_large", lambda _: set())
    more = frozenset([wanted]) if "@" in there else frozenset([there, wanted])
    assert subset_steps._grown(c, more) is None
    assert c.dropped == dropped


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


def test_what_a_survey_found_is_found_once(base: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """On trial one after the other, laws are not written out again; what is asked otherwise is."""
    asked: list[tuple[str, ...]] = []

    def found(where: Any, beyond: tuple[str, ...], without: Any) -> Any:
        asked.append(beyond)
        return where_found(where, beyond, without)

    where_found = best_law._found
    monkeypatch.setattr(best_law, "ENOUGH", 0.0)
    monkeypatch.setattr(best_law, "_found", found)
    where = best_law.survey(base)
    first = best_law.best_term(where)
    assert first is not None
    second = best_law.best_term(where, refused={first.effect.id})
    assert second is None or second.effect.id != first.effect.id
    assert asked == [()]
    best_law.best_terms(where, beyond=("heading",))
    assert asked == [(), ("heading",)]


@pytest.mark.parametrize("worth", [None, 0.5])
def test_evidence_counts_for_what_it_is_known_to(
    base: Model, worth: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scans do not ask how far scores scatter where that is known."""
    counted: list[int] = []
    excess = scan.excess
    monkeypatch.setattr(scan, "excess", lambda *a: counted.append(1) or excess(*a))
    looks = best_law.survey(base, worth=worth).of((), [])
    assert not worth or {q.worth for _, q in looks} == {worth}
    assert bool(counted) is (worth is None)


def test_a_fit_with_a_term_is_not_repeated_without_it(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = Law(0, (0, 1, 2), False, driver_of("|f|"), formula([("line", ())]), (1e-3,))
    term = Term(effect_of(law), 10.0)
    chosen = frozenset({"gyro_scale"})
    monkeypatch.setattr(in_place, "best_set", lambda *_: chosen)
    monkeypatch.setattr(in_place, "fitted_with", lambda *_: pytest.fail("fitted without the term"))
    where = SimpleNamespace(score=lambda _: 1e6)
    monkeypatch.setattr(in_place, "scanned_about", lambda *_: where)
    assert term.effect.id in in_place.with_term(base, term, 1.0, frozenset()).ids


@pytest.mark.parametrize(("promised", "asked"), [(0.0, False), (1e9, True)])
def test_no_name_is_fitted_beside_a_law_where_all_that_it_promises_is_of_no_use(
    promised: float, asked: bool, base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = Law(0, (0, 1, 2), False, driver_of("|f|"), formula([("line", ())]), (1e-3,))
    term = Term(effect_of(law), 10.0)
    chosen = frozenset({"gyro_scale", term.effect.id})
    monkeypatch.setattr(in_place, "best_set", lambda *_: chosen)
    where = SimpleNamespace(score=lambda ids: promised if ids is chosen else 0.0)
    monkeypatch.setattr(in_place, "scanned_about", lambda *_: where)
    fits: list[int] = []
    monkeypatch.setattr(in_place, "fitted_with", lambda m, *_: fits.append(1) or m)
    better_one = replace(base, log_evidence=base.log_evidence + 1e4)
    in_place.with_term(base, term, 1.0, frozenset(), better_one)
    assert bool(fits) is asked


@pytest.mark.parametrize(("short", "since", "asked"), [
    (40.0, 15.0, 1), (40.0, 25.0, 2), (None, 70.0, 1), (None, 80.0, 2),
])  # fmt: skip
def test_a_moment_in_the_place_of_noise_is_sought_again_where_the_score_has_changed(
    short: float | None, since: float, asked: int, base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By half of what a fit fell short by; where none was asked for, of what the noise holds."""
    sought: list[float] = []

    def found(_: object, model: Model) -> Model | None:
        sought.append(model.log_evidence)
        return None if short is None else replace(c.model, log_evidence=sought[-1] - short / 0.5)

    monkeypatch.setattr(noise_steps, "_at_a_moment", found)
    monkeypatch.setattr(noise_steps, "without", lambda model, _: model)
    c = _climb(base)
    noise = catalogue()["gyro_bias_walk"]
    c.model = replace(c.model, effects=(*base.effects, noise))
    c.noise = {noise.id: 150.0}
    assert noise_steps.name_noise(c) is None
    # (evidence counts half; with another name the question is another)
    name = catalogue()["gyro_scale"]
    evidence = c.model.log_evidence + (since - prior(name, [base.parts[0].case])) / 0.5
    c.model = replace(c.model, effects=(*c.model.effects, name), log_evidence=evidence)
    assert noise_steps.name_noise(c) is None
    assert len(sought) == asked


@pytest.mark.parametrize(
    ("room", "worth", "there"),
    [
        # (of each channel the best, and no second one)
        (4, 90.0, {"gyro_x += a", "gyro_z += e", "accel_x += c"}),
        (2, 90.0, {"gyro_x += a", "accel_x += c"}),
        (1, 90.0, {"gyro_x += a"}),
        (4, 30.0, {"gyro_x += a"}),  # (beside the first it is not likelier any more)
    ],
)
def test_laws_of_other_channels_that_are_likelier_are_tried_on_top_at_once(
    room: int, worth: float, there: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    nats = {"gyro_x += a": 40.0, "gyro_x += b": 35.0, "accel_x += c": 20.0, "accel_x += d": 10.0,
            "gyro_z += e": 15.0}  # fmt: skip
    start = _named(("accel_bias_walk", "gyro_bias_walk"), 0.0)
    terms: list[Any] = [SimpleNamespace(effect=SimpleNamespace(id=i, made=None)) for i in nats]
    noise = {i: f"{i.split('_')[0]}_bias_walk" for i in nats}
    ends = [_named((*(set(start.ids) - {noise[i]}), i), nats[i]) for i in nats]
    monkeypatch.setattr(in_place, "_doubted", lambda _: {})
    monkeypatch.setattr(
        in_place, "_ends", lambda *_, **__: (list(zip(ends, terms, strict=True)), [])
    )
    monkeypatch.setattr(in_place, "forget", lambda *_: None)
    monkeypatch.setattr(state, "score", lambda m, _: m.log_evidence)
    for module in (in_place, state):
        monkeypatch.setattr(
            module, "likelier",
            lambda c, m, than=None: m.log_evidence > (than or c.model).log_evidence,
        )  # fmt: skip
    monkeypatch.setattr(
        in_place, "without", lambda m, ids: _named(tuple(i for i in m.ids if i not in ids), 0.0)
    )
    monkeypatch.setattr(
        in_place,
        "with_term",
        lambda m, t, *_: _named((*m.ids, t.effect.id), worth + len(m.ids)),
    )
    c: Any = SimpleNamespace(
        model=start, worth=1.0, budget=Budget(), bared=set(), barred={}, unnamed=[], beyond=set()
    )
    found = in_place.instead_of_noise(c, room)
    # (and what stood in the place of each law is gone)
    left = {i for i in start.ids if not any(noise[law] == i for law in there)}
    assert found is not None
    assert set(found.ids) == there | left
    assert {t.effect.id for t in c.unnamed} == there


def test_what_stands_in_for_an_effect_is_given_up_where_it_cannot_be_the_better_one(
    base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, late = catalogue()["gyro_bandwidth"], catalogue()["accel_delay"]
    c = _climb(base)
    effects = (*base.effects, catalogue()["gyro_scale"], slow)
    c.model = model = replace(c.model, effects=effects, u=np.zeros(0))
    c.where.quadratic.worth = 0.2
    least: list[float] = []

    def fit_of(_: object, effects: Any, of_use: float = -math.inf) -> Model:
        least.append(of_use)
        return replace(model, effects=tuple(effects), log_evidence=model.log_evidence - 1e6)

    monkeypatch.setattr(exchange_steps, "fitted", fit_of)
    monkeypatch.setattr(chosen_again, "fitted", fit_of)
    monkeypatch.setattr(candidates, "fitted", fit_of)
    monkeypatch.setattr(exchange_steps, "gains", lambda *_: dict.fromkeys(model.ids, 1e3))
    monkeypatch.setattr(exchange_steps, "_rivalries", lambda *_: [(slow, late.id)])
    assert exchange_steps.exchange(c) is None
    rest = [e for e in model.effects if e is not slow]
    assert least == [pytest.approx(of_use(model, [*rest, late], 0.2))]
    least.clear()
    assert exchange_steps.reorder(c) is None
    assert least == [pytest.approx(of_use(model, model.effects, 0.2))]
    least.clear()
    where = SimpleNamespace(effects={slow.id: slow})
    monkeypatch.setattr(exchange_steps, "scanned_about", lambda *_: where)
    monkeypatch.setattr(exchange_steps, "best_set", lambda *_: frozenset({slow.id}))
    exchange_steps._beside_delays(base, [slow, late], (), frozenset(), 0.2)
    assert least == [-math.inf, pytest.approx(of_use(base, [slow], 0.2))]


@pytest.mark.parametrize(("above", "anew"), [(-10.0, 1), (10.0, 0)])
def test_noise_levels_are_not_found_for_a_fit_that_rests_below_what_is_of_use(
    above: float, anew: int, base: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = [*base.effects, catalogue()["gyro_scale"]]
    rested = fit.fitted(base.parts, wanted, noise_rounds=0).log_evidence
    counted: list[int] = []
    with_noise = fit.with_noise
    monkeypatch.setattr(fit, "with_noise", lambda *a: counted.append(1) or with_noise(*a))
    tried = fit.fitted(base.parts, wanted, of_use=rested + above)
    assert len(counted) == anew
    assert tried.log_evidence > rested - 1.0


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


@pytest.mark.parametrize(("moved", "times"), [(0.5 * fit.STILL, 1), (2.0 * fit.STILL, 3)])
def test_levels_that_stay_are_followed_once(
    base: Model, moved: float, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a fit cannot follow levels all the way it goes a part of it: but where they are what
    they were it did the same ten rounds three times, and once more to rest."""
    asked: list[float] = []

    def followed(parts: Any, **_: Any) -> Any:
        asked.append(next(iter(parts[0].levels.values())))
        return SimpleNamespace(evidence=-50.0)

    monkeypatch.setattr(fit, "relinearised_parts", followed)
    (f,) = base.parts
    new = replace(f, levels={k: v * math.exp(moved) for k, v in f.levels.items()})
    now, still = Rested([f], True, 0.0, 0.2), fit._change([f], [new]) < fit.STILL
    found = fit._with_levels(now, [], [new], still, base.effects, None, 0.2)
    assert (found is None) is (times > 1)
    begin = next(iter(f.levels.values()))
    assert [math.log(x / begin) / moved for x in asked] == pytest.approx(fit.SHARES[:times])

"""Drivers made of several signals: their names are all that a file has of them, and what a look at
short windows promises is what a scan says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import recording_of

from handcal.effects import Effect, Signals
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.columns import Ground
from handcal.estimate.model import Model
from handcal.estimate.scan import grounds, scan
from handcal.laws import operators
from handcal.laws.compositions import composed, composed_headings
from handcal.laws.driver_code import HELPERS, steps_to
from handcal.laws.drivers import DRIVERS, HEADING, LINE, RATES, Driver, operated, times
from handcal.laws.grammar import formula
from handcal.laws.law_effect import COMPOSED, Law
from handcal.laws.over_drivers import Block, best_of_block, over, signals_of
from handcal.laws.short_windows import (
    MOST_WINDOWS,
    WINDOW,
    Windows,
    courses_of,
    fits_in,
    gains_of,
)
from handcal.laws.vocabulary import driver_of
from handcal.laws.weighing import Beside, beside
from handcal.search.response import response
from handcal.search.select import Priors, chosen, windows_beside
from handcal.search.select_laws import CLOSER, courses_on
from handcal.signals import probe
from handcal_sim import simulate

PROBE = probe(600)
IMU, TURNED = list(composed(PROBE)), list(composed_headings(PROBE))
ALL = [*IMU, *TURNED]


def test_every_name_is_one_drivers_and_says_all_that_it_is() -> None:
    for some in (IMU, TURNED):
        assert len({d.name for d in some}) == len(some) > 3000
    # (what errs in a heading by one signal is no law of the usual vocabulary, which is of the IMU)
    assert not {d.name for d in IMU} & set(DRIVERS)
    for d in ALL[:: len(ALL) // 150]:
        again = driver_of(d.name)
        assert (again.name, again.number, again.composed) == (d.name, d.number, d.composed)
        np.testing.assert_array_equal(again.course(PROBE, 1), d.course(PROBE, 1))
        np.testing.assert_array_equal(again.scale(PROBE, 1), d.scale(PROBE, 1))


def test_the_code_of_a_law_that_is_written_out_makes_the_same_course() -> None:
    names = {"np": np, "signals": PROBE, "Array": np.ndarray, "i": 1}
    for text in HELPERS.values():
        exec(text, names)
    for d in [d for d in ALL if d.factor is None][:: len(ALL) // 150]:
        exec("\n".join(steps_to("x", d.name)), names)
        np.testing.assert_allclose(names["x"], d.course(PROBE, 1), rtol=1e-9, atol=1e-12)


@given(st.lists(st.sampled_from([d for d in ALL if d.factor is None]), min_size=2, max_size=3))
def test_a_product_of_any_drivers_comes_apart_where_it_was_put_together(some: list[Driver]) -> None:
    name = " * ".join(d.name for d in some)
    first, rest = operators.factors(name)
    assert f"{first} * {rest}" == name
    assert operators.factors(first) == (first, "")
    assert operators.parsed(name) is None


def test_what_is_made_of_more_costs_more() -> None:
    one = operated("memory", RATES[0], 1.0)
    pair = times(RATES[1], one)
    assert (one.composed, pair.composed, times(RATES[0], RATES[1]).composed) == (False, True, False)
    costs = [Law(0, (0,), False, d, formula([("line", ())]), (1.0,)).cost for d in (one, pair)]
    assert costs[1] - costs[0] == pytest.approx(COMPOSED)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("sensor", "errors"),
    [
        (0, {"gyro_cross_products": np.full(9, 0.01)}),
        (1, {"accel_asymmetry": np.full(3, 0.03)}),
        (HEADING, {"heading_soft_iron": np.full(2, 0.2)}),
    ],
)
def test_a_look_at_short_windows_says_what_a_scan_does(
    sensor: int, errors: dict[str, np.ndarray]
) -> None:
    """Of a world with large errors, for courses of all kinds."""
    world = simulate("free-hand", seed=0, duration_s=60.0, effects=errors)
    model = baseline([case_of(recording_of(world, "heading"))])
    assert fits_in(signals_of(model.parts[0]))
    r = response(model)
    choice = chosen(r, Priors(lambda _: 0.0), model.chosen, {})
    b, G = windows_beside(r, choice.names, {}, sensor)
    at = {str(a): x for a, x in enumerate(np.arange(b.size).reshape(b.shape))}
    looked = Beside(b.ravel(), G.reshape(b.size, b.size), at)
    ranked = sorted(
        ((nats, d) for of in courses_on(r.windows)[sensor]
         for nats, d in zip(gains_of(of, looked), of.drivers, strict=True) if d.composed),
        key=lambda x: -x[0],
    )  # fmt: skip
    known = [e for e in model.effects if e.process is None]
    every = [d for _, d in ranked]
    base = grounds(model)
    told = _scanned(model, base, known, sensor, every[:30])
    usual = _scanned(model, base, known, sensor, every[30 :: len(every) // 60])
    # In windows that are short against a turn, hardly anything of a course is lost.
    assert told.max() > 20.0
    assert told.max() > 0.85 * usual.max()
    assert np.median(told) > np.quantile(usual, 0.9)
    firsts = {d.kind: n for n, d in reversed([*enumerate(every[:30])])}
    assert told[sorted(firsts.values())[:CLOSER]].max() > 0.85 * told.max()


def _scanned(
    model: Model, base: list[Ground], known: list[Effect], sensor: int, drivers: list[Driver]
) -> np.ndarray:
    """Nats that the best law over each of these drivers gains."""
    blocks = [b for d in drivers for b in over(d, signals_of(model.parts[0]), (sensor,))]
    q = scan(model, [b.effect for b in blocks], base, 1.0)
    seen = beside(q, known, [b.effect for b in blocks])
    return np.array([_most(b, seen) for b in blocks])


def _most(block: Block, seen: Beside) -> float:
    """Nats that the best law of a block gains."""
    return max((nats for _, nats in best_of_block(block, seen)), default=-np.inf)


def test_a_gap_leaves_its_windows_empty_and_every_other_in_its_place() -> None:
    t = np.arange(0.0, 12.0, 0.01)
    t = t[(t < 4.0) | (t > 7.0)]
    turns = np.column_stack([np.sin(t), np.cos(t), np.ones_like(t)])
    windows = Windows(np.linspace(0.0, 12.0, 37), np.arange(36))
    driver = replace(RATES[2], knots=LINE)
    (found,) = courses_of([driver], Signals(t, turns, turns), 0, windows.count, windows.of)
    means = found.means[0, :, 0] * np.sqrt(np.mean(turns[:, 0] ** 2 + turns[:, 1] ** 2 + 1) / 3)
    middle = (np.arange(means.shape[1]) + 0.5) * WINDOW
    there = (middle < 3.8) | (middle > 7.2)
    np.testing.assert_allclose(means[1][there], np.sin(middle[there]), atol=0.03)  # (k of y is x)
    np.testing.assert_array_equal(means[:, (middle > 4.4) & (middle < 6.6)], 0.0)


def test_of_a_long_recording_there_are_too_many_windows() -> None:
    t = np.linspace(0.0, (MOST_WINDOWS + 2) * WINDOW, 1000)
    assert not fits_in(Signals(t, np.zeros((1000, 3)), np.zeros((1000, 3))))

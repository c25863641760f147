"""The numbers of a law (a time, a width, a limit), adjusted about a fit: one scan of what a small
change of each of them adds says how far, and how well they are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.laws import grammar
from handcal.laws.law_effect import Law, adding, effect_of, law_of
from handcal.laws.weighing import beside
from handcal.types import Array

# A number's prior, and the largest step at once, as shares of its unit; and the step of its
# derivative.
OPEN, SMALL = 0.3, 0.01
# Changes by less than this share of their own uncertainty are none.
DONE = 0.3


def numbers_of(law: Law) -> Array:
    """Those of its form, and of its driver if that has one; a curve's are no matter."""
    return _and_the_drivers(law, () if law.form.smooth else law.form.numbers)


def _units(law: Law) -> Array:
    """What a change of each of them is a share of."""
    return _and_the_drivers(law, () if law.form.smooth else grammar.units_of(law.form))


def _and_the_drivers(law: Law, own: tuple[float, ...]) -> Array:
    return np.array([*own, *([law.driver.number] if law.driver.at is not None else [])])


def with_numbers(law: Law, numbers: Array) -> Law:
    """The law with other numbers, in the order of ``numbers_of``."""
    own = 0 if law.form.smooth else len(law.form.numbers)
    form, driver = law.form, law.driver
    if own:
        form = grammar.again(form.kind, tuple(float(n) for n in numbers[:own]))
    if driver.at is not None:
        driver = driver.at(float(numbers[own]))
    return replace(law, form=form, driver=driver)


def adjusted(model: Model, effect: Effect) -> Effect | None:
    """The law that an effect of the model is, with the numbers that the recordings ask for; None
    where it has none, or where they are as good as they get."""
    law = law_of(effect)
    if law is None or not len(numbers_of(law)):
        return None
    mine = [k for k, n in enumerate(model.quadratic.names) if n[0] == effect.id]
    values = model.u[mine] * effect.prior_sigma
    change = _changes(law, values)
    known = [e for e in model.effects if e.process is None]
    seen = beside(scan(model, [change]), known, [change])
    at = seen.at[change.id]
    A = np.eye(len(at)) + seen.G[np.ix_(at, at)]
    u = np.linalg.solve(A, seen.b[at])
    sigma = np.sqrt(np.diag(np.linalg.solve(A, np.eye(len(at)))))
    if np.all(np.abs(u) < DONE * sigma):
        return None
    step = np.clip(OPEN * u, -OPEN, OPEN)
    return effect_of(with_numbers(law, numbers_of(law) + step * _units(law)))


def _changes(law: Law, values: Array) -> Effect:
    """What a change of each number adds, by a share of it of ``OPEN``."""
    numbers = numbers_of(law)

    def columns(truth: Signals, n: int) -> Array:
        return _derivatives(law, numbers, _adds(law, values, n, law.axes[n], truth))

    plain = effect_of(law).parameters[0]
    parameters = tuple(replace(plain, name=f"n{i}", prior_sigma=OPEN) for i in range(len(numbers)))
    return replace(
        effect_of(law), id=f"numbers: {law.said}", parameters=parameters, together=None,
        made=None, **adding(law, 0, columns),
    )  # fmt: skip


def _adds(law: Law, values: Array, n: int, axis: int, truth: Signals) -> Callable[[Law], Array]:
    one = law.form.constants
    own = values[n * one : (n + 1) * one] if law.each else values

    def adds(other: Law) -> Array:
        return np.asarray(other.values(truth, axis) @ own)

    return adds


def _derivatives(law: Law, numbers: Array, adds: Callable[[Law], Array]) -> Array:
    """By each number, in its unit, (n, k)."""
    columns = []
    for step in SMALL * np.diag(_units(law)):
        more, less = (adds(with_numbers(law, numbers + by)) for by in (step, -step))
        columns.append((more - less) / (2.0 * SMALL))
    return np.stack(columns, axis=1)

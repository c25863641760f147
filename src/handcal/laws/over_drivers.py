"""Laws over drivers: curves over all drivers from one scan, and formulas for the best curves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Protocol

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.columns import Ground
from handcal.estimate.model import Fitted, Model
from handcal.estimate.scan import scan
from handcal.estimate.seen import truth
from handcal.laws import operators
from handcal.laws.drivers import (
    BY,
    COURSELESS,
    DRIVERS,
    LINE,
    NEARER,
    Driver,
    times,
    usable,
)
from handcal.laws.grammar import (
    Form,
    Part,
    about,
    cost_of,
    curves,
    formula,
    parts_for,
    range_of,
)
from handcal.laws.law_effect import AXES_OF, SIZE, Law, effect_of, named
from handcal.laws.vocabulary import driver_of
from handcal.laws.weighing import Beside, beside, gains
from handcal.types import Array

# Refinement of a formula's numbers: relative changes, used in turn.
FINER = (0.5, 0.2, 0.06)
# Formulas of each kind on the grid whose numbers are refined.
LIKELY = 4
# Largest count of turns at each refinement, and gain after which another follows, nats.
TURNS, NEARLY = 12, 0.5


@dataclass(frozen=True)
class Block:
    """All laws of one sensor over one driver, as one effect of each axis's coefficients."""

    sensor: int
    driver: Driver
    forms: tuple[Form, ...]
    sigmas: tuple[float, ...]
    effect: Effect

    @cached_property
    def roots(self) -> Array:
        """Square roots (f, k, k) of the prior covariance of each form's constants."""
        one = self.forms[0].constants
        return np.stack([np.eye(one) if f.root is None else f.root for f in self.forms])


def over(driver: Driver, signals: Signals, sensors: Iterable[int]) -> list[Block]:
    """All laws over a driver, one block for each of these sensors. Empty if the driver, or the
    signal whose effect it changes, does not vary."""
    x = np.stack([driver.course(signals, axis) for axis in range(3)])
    rms = float(np.sqrt(np.mean(x**2)))
    if rms < COURSELESS or np.ptp(x) < 1e-6 * rms:
        return []
    sensors = [n for n in sensors if driver.only in (None, n)]
    if driver.knots == LINE:
        forms = (formula([("line", ())]),)
        return [_block(n, driver, forms, SIZE[n] / rms) for n in sensors]
    smooth = tuple(curves(range_of(x, driver.signed), driver.knots, driver.round))
    scale = float(np.sqrt(np.mean(np.square([driver.scale(signals, a) for a in range(3)]))))
    # (the signal may be zero throughout, e.g. stick with a threshold that is never exceeded)
    if scale < COURSELESS:
        return []
    return [_block(n, driver, smooth, SIZE[n] / scale) for n in sensors]


def _block(sensor: int, driver: Driver, forms: tuple[Form, ...], sigma: float) -> Block:
    sigmas = (sigma,) * forms[0].constants
    law = Law(sensor, AXES_OF[sensor], True, driver, replace(forms[0], root=None), sigmas)
    # (the knots are part of the id, since a driver may be scanned with several counts)
    effect = replace(effect_of(law), id=f"basis: {sensor} {driver.knots} {driver.name}")
    return Block(sensor, driver, forms, sigmas, effect)


def ways(block: Block, seen: Beside) -> Iterator[tuple[tuple[int, ...], bool, Array, Array]]:
    """Ways to apply a law to axes: each axis alone, all axes with the same constants, and all with
    their own. Yields the axes, whether each has its own constants, and b and G of these."""
    axes = AXES_OF[block.sensor]
    at = seen.at[block.effect.id].reshape(len(axes), -1)
    b, G = seen.b[at], seen.G[at[:, :, None, None], at[None, None]]
    for axis in axes:
        yield (axis,), False, b[axis], G[axis, :, axis]
    if len(axes) > 1:
        yield (0, 1, 2), False, b.sum(axis=0), G.sum(axis=(0, 2))
        if block.driver.own and not block.driver.free:
            yield (0, 1, 2), True, b.ravel(), G.reshape(b.size, b.size)


def best_of_block(block: Block, seen: Beside) -> Iterator[tuple[Law, float]]:
    """The best law of each of the ``ways``, with its gain, nats."""
    one, roots = block.forms[0].constants, block.roots
    for axes, each, b, G in ways(block, seen):
        # (such a driver has no negative constants)
        lost = block.driver.positive == block.sensor
        if lost and (np.linalg.solve(np.eye(len(b)) + G, b) < 0.0).any():
            continue
        own = len(b) // one
        whole = np.zeros((len(roots), own, one, own, one))
        for n in range(own):
            whole[:, n, :, n] = roots
        many = len(roots), len(b), len(b)
        found = gains(np.broadcast_to(b, many[:2]), np.broadcast_to(G, many), whole.reshape(many))
        top = float(found.max())
        form = block.forms[int(np.argmax(found))]
        law = Law(block.sensor, axes, each, block.driver, form, block.sigmas)
        if form.smooth or not named(law):
            # (marginal over the unknown width and size: the mean evidence)
            yield law, top + math.log(np.mean(np.exp(found - top)))


class Weighing(Protocol):
    """A source of evidence for laws: a scan, or windows."""

    @property
    def signals(self) -> Signals: ...

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """The quadratic of absent effects, beside the known ones."""
        ...


@dataclass(frozen=True)
class About:
    """Evidence for laws from scans about a model.

    grounds: of the model. known: effects beside which laws are evaluated. signals: of the first
    recording. worth: power of the likelihood.
    """

    model: Model
    grounds: Sequence[Ground]
    known: Sequence[Effect]
    signals: Signals
    worth: float

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """The quadratic of absent effects from a scan."""
        q = scan(self.model, absent, self.grounds, self.worth)
        return beside(q, self.known, absent)


def written_out(about_: Weighing, law: Law, quick: Weighing) -> list[tuple[Law, float]]:
    """The best formulas in place of a curve, with their gains: one function, a sum of two, and a
    sum of two with the same numbers.

    quick: cheaper source of evidence, by which functions are chosen and numbers refined.
    """
    driver = law.driver
    x = np.stack([driver.course(about_.signals, axis) for axis in range(3)])
    ends = range_of(x, driver.signed)
    parts = parts_for(ends, driver.signed, driver.round, driver.factor is not None)
    found = _tried(quick, law, parts, LIKELY)
    near = [_adjusted(quick, *end) for end in found]
    likely = dict.fromkeys(part for x, _ in (*found, *near) for part in x.form.parts)
    return _tried(about_, law, list(likely))


def _adjusted(about_: Weighing, law: Law, gain: float) -> tuple[Law, float]:
    """The formula with its numbers refined for the highest gain, and that gain."""
    for share in FINER if law.form.numbers else ():
        for _ in range(TURNS):
            parts = [near for part in law.form.parts for near in about(part, share)]
            before = gain
            for other, value in _tried(about_, law, parts):
                if value > gain and other.form.kind == law.form.kind:
                    law, gain = other, value
            if not gain > before + NEARLY:
                break
    return law, gain


def _tried(
    about_: Weighing, law: Law, parts: Sequence[Part], most: int = 1
) -> list[tuple[Law, float]]:
    """The ``most`` best formulas of each kind from these functions, with their gains: one function,
    a sum of two, and a sum of two with the same numbers."""
    forms = [formula([part]) for part in parts]
    sizes = np.array([rms_of(law, form, about_.signals) for form in forms])
    # (a function that has a name is left to that name)
    some = [
        n for n, form in enumerate(forms)
        if sizes[n] > 1e-9 and not named(_plainly(replace(law, form=form)))
    ]  # fmt: skip
    effects = [
        replace(
            effect_of(replace(law, form=forms[n], sigmas=(SIZE[law.sensor] / sizes[n],))),
            id=f"basis: {n}",
        )
        for n in some
    ]
    seen = about_.seen(effects)
    out: list[tuple[Law, float]] = []
    for sets, same in _sets(some, parts):
        index = [np.concatenate([seen.at[f"basis: {n}"] for n in chosen]) for chosen in sets]
        costs = [cost_of([parts[n] for n in chosen], same) for chosen in sets]
        values, wanted = seen.gains(np.array(index)) - costs, len(out) + most
        for k in np.argsort(-values, kind="stable"):
            sigmas = tuple(float(SIZE[law.sensor] / sizes[n]) for n in sets[k])
            form = formula([parts[n] for n in sets[k]], same)
            candidate = _plainly(replace(law, form=form, sigmas=sigmas))
            if not named(candidate):
                out.append((candidate, float(values[k])))
            if len(out) == wanted:
                break
    return out


def _plainly(law: Law) -> Law:
    """The law over a product of two signals, if it scales one signal in proportion to another."""
    factor = law.driver.factor
    if factor is None or law.driver.number or law.form.parts != (("line", ()),):
        return law
    felt = driver_of(law.driver.over)
    names = f"{factor.name} * {felt.name}", f"{felt.name} * {factor.name}"
    usual = [DRIVERS[name] for name in names if name in DRIVERS]
    return replace(law, driver=usual[0] if usual else times(factor, felt))


def is_product(driver: Driver) -> bool:
    """Whether a driver is a product of signals."""
    return bool(_factors(driver))


def of_one_signal(law: Law, signals: Signals) -> list[Law]:
    """Laws in proportion to each single signal of a law over a product. (If one signal hardly
    varies, the other alone may do.)"""
    out = []
    for name in _factors(law.driver):
        alone = driver_of(name)
        if usable(alone, signals) and alone.only in (None, law.sensor):
            plain = replace(law, driver=alone, form=formula([("line", ())]))
            sigma = SIZE[law.sensor] / max(rms_of(plain, plain.form, signals), 1e-12)
            out.append(replace(plain, sigmas=(sigma,)))
    return out


def _factors(driver: Driver) -> list[str]:
    """Names of the signals in a product; empty if the driver is no product."""
    felt, _, left = driver.name.rpartition(BY)
    names = [felt] if felt else []
    while left:
        first, left = operators.factors(left)
        names.append(first)
    return names if len(names) > 1 else []


def _sets(some: Sequence[int], parts: Sequence[Part]) -> list[tuple[list[tuple[int, ...]], bool]]:
    """Sets of functions on trial: single ones, pairs of different functions, and pairs with the
    same numbers. The flag is true for the last kind."""
    one: list[tuple[int, ...]] = [(n,) for n in some]
    two: list[tuple[int, ...]] = [
        (n, m) for n, m in combinations(some, 2) if parts[n][0] != parts[m][0]
    ]
    same = [both for both in two if parts[both[0]][1] and parts[both[0]][1] == parts[both[1]][1]]
    return [(sets, alike) for sets, alike in ((one, False), (two, False), (same, True)) if sets]


def tuned(about_: Weighing, law: Law, gain: float) -> tuple[Law, float]:
    """The law with its driver's number (a time, a half width) tuned for the highest gain, and that
    gain."""
    for shares in NEARER:
        at, number = law.driver.at, law.driver.number
        if at is None:
            break
        near = [b for s in shares for b in over(at(s * number), about_.signals, (law.sensor,))]
        seen = about_.seen([b.effect for b in near])
        for other, value in (end for block in near for end in best_of_block(block, seen)):
            if value > gain and (other.axes, other.each) == (law.axes, law.each):
                law, gain = other, value
    return law, gain


def rms_of(law: Law, form: Form, signals: Signals) -> float:
    """RMS of the error per unit of each constant, with this form in the law."""
    values = [replace(law, form=form).values(signals, axis) for axis in law.axes]
    return float(np.sqrt(np.mean(np.square(values))))


def signals_of(f: Fitted) -> Signals:
    """The best estimate of rate, force and attitude at the IMU's samples."""
    return truth(f.linear.problem if f.problem.navigated else f.problem, f.trajectory)

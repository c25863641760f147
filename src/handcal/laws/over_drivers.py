"""Laws over drivers: all of them at once as curves, and the formulas that the best of them have."""

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

# Shares of the way to a formula's next numbers on trial at which it is tried once more, in turn.
FINER = (0.5, 0.2, 0.06)
# Formulas of each kind that are looked at closely, of all on the grid.
LIKELY = 4
# Turns at each of these at the most (what is moved and narrowed in turn goes on as far as that
# leads), and nats for which there is another.
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
    """All laws over a driver, of each of these sensors; none where it has no course, or what it
    changes has none."""
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
    # (a stick with another threshold may never let go)
    if scale < COURSELESS:
        return []
    return [_block(n, driver, smooth, SIZE[n] / scale) for n in sensors]


def _block(sensor: int, driver: Driver, forms: tuple[Form, ...], sigma: float) -> Block:
    sigmas = (sigma,) * forms[0].constants
    law = Law(sensor, AXES_OF[sensor], True, driver, replace(forms[0], root=None), sigmas)
    # (the same driver may be there with more knots)
    effect = replace(effect_of(law), id=f"basis: {sensor} {driver.knots} {driver.name}")
    return Block(sensor, driver, forms, sigmas, effect)


def ways(block: Block, seen: Beside) -> Iterator[tuple[tuple[int, ...], bool, Array, Array]]:
    """Axes, whether each has its own constants, and the quadratic of these: each axis alone, and
    all by one law."""
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
    """The best law of each way, and what it gains."""
    one, roots = block.forms[0].constants, block.roots
    for axes, each, b, G in ways(block, seen):
        # (a step that is lost is lost, not gained)
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
            # (its width and size are not known: the mean over all)
            yield law, top + math.log(np.mean(np.exp(found - top)))


class Weighing(Protocol):
    """Where laws are weighed: with these signals, beside something."""

    @property
    def signals(self) -> Signals: ...

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """What is known there of absent effects."""
        ...


@dataclass(frozen=True)
class About:
    """Where laws are weighed: about a model (``grounds`` for its scans), beside its known effects,
    with the signals of its first recording, and what evidence is worth."""

    model: Model
    grounds: Sequence[Ground]
    known: Sequence[Effect]
    signals: Signals
    worth: float

    def seen(self, absent: Sequence[Effect]) -> Beside:
        """What a scan says of absent effects."""
        q = scan(self.model, absent, self.grounds, self.worth)
        return beside(q, self.known, absent)


def written_out(about_: Weighing, law: Law, quick: Weighing) -> list[tuple[Law, float]]:
    """The law as the formulas that gain most over the model, and what they gain: of one function,
    of two, and of two with the same numbers; with their numbers adjusted, as ``quick`` weighs
    them."""
    driver = law.driver
    x = np.stack([driver.course(about_.signals, axis) for axis in range(3)])
    ends = range_of(x, driver.signed)
    parts = parts_for(ends, driver.signed, driver.round, driver.factor is not None)
    found = _tried(quick, law, parts, LIKELY)
    near = [_adjusted(quick, *end) for end in found]
    likely = dict.fromkeys(part for x, _ in (*found, *near) for part in x.form.parts)
    return _tried(about_, law, list(likely))


def _adjusted(about_: Weighing, law: Law, gain: float) -> tuple[Law, float]:
    """The formula with the numbers near its own that gain most, and what it gains."""
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
    """The best of these functions in the law's place, the best sum of two, and of two with the same
    numbers, so many of each; what they gain."""
    forms = [formula([part]) for part in parts]
    sizes = np.array([rms_of(law, form, about_.signals) for form in forms])
    some = np.flatnonzero(sizes > 1e-9)
    effects = [
        replace(
            effect_of(replace(law, form=forms[n], sigmas=(SIZE[law.sensor] / sizes[n],))),
            id=f"basis: {n}",
        )
        for n in some
    ]
    seen = about_.seen(effects)
    out: list[tuple[Law, float]] = []
    for sets, same in _sets([int(n) for n in some], parts):
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
    """The law as one over a product, where by how much a signal is felt goes as another one."""
    factor = law.driver.factor
    if factor is None or law.driver.number or law.form.parts != (("line", ()),):
        return law
    felt = driver_of(law.driver.over)
    names = f"{factor.name} * {felt.name}", f"{felt.name} * {factor.name}"
    usual = [DRIVERS[name] for name in names if name in DRIVERS]
    return replace(law, driver=usual[0] if usual else times(factor, felt))


def is_product(driver: Driver) -> bool:
    """Whether it is a product of signals."""
    return bool(_factors(driver))


def of_one_signal(law: Law, signals: Signals) -> list[Law]:
    """Laws in proportion to each signal alone of the product that a law is over. (One of them may
    hardly change: then the law is the other's.)"""
    out = []
    for name in _factors(law.driver):
        alone = driver_of(name)
        if usable(alone, signals) and alone.only in (None, law.sensor):
            plain = replace(law, driver=alone, form=formula([("line", ())]))
            sigma = SIZE[law.sensor] / max(rms_of(plain, plain.form, signals), 1e-12)
            out.append(replace(plain, sigmas=(sigma,)))
    return out


def _factors(driver: Driver) -> list[str]:
    """Names of the signals that a driver is the product of; none where it is no product."""
    felt, _, left = driver.name.rpartition(BY)
    names = [felt] if felt else []
    while left:
        first, left = operators.factors(left)
        names.append(first)
    return names if len(names) > 1 else []


def _sets(some: Sequence[int], parts: Sequence[Part]) -> list[tuple[list[tuple[int, ...]], bool]]:
    """All of one of these, all of two that are different functions, and all of two with the same
    numbers; each with whether it is that."""
    one: list[tuple[int, ...]] = [(n,) for n in some]
    two: list[tuple[int, ...]] = [
        (n, m) for n, m in combinations(some, 2) if parts[n][0] != parts[m][0]
    ]
    same = [both for both in two if parts[both[0]][1] and parts[both[0]][1] == parts[both[1]][1]]
    return [(sets, alike) for sets, alike in ((one, False), (two, False), (same, True)) if sets]


def tuned(about_: Weighing, law: Law, gain: float) -> tuple[Law, float]:
    """The law with the time or half width of its driver that gains most, and what it gains."""
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
    """Root mean square of what a unit of each constant of a form adds in a law's place."""
    values = [replace(law, form=form).values(signals, axis) for axis in law.axes]
    return float(np.sqrt(np.mean(np.square(values))))


def signals_of(f: Fitted) -> Signals:
    """The best estimate of rate, force and attitude at the IMU's samples."""
    return truth(f.linear.problem if f.problem.navigated else f.problem, f.trajectory)

"""What may drive an error without a name: the vocabulary of response curves.

A driver is a signal for each axis of a sensor. In its name {i} is the sensor's own axis, {j} and
{k} are the two that follow it; what has none of them is the same for all axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import njit
from handcal.effects import ATTITUDE, ROOM, Signals
from handcal.laws import operators
from handcal.laws.operators import MEMORIES, OPERATORS, OVERSHOOTS
from handcal.types import Array, BoolArray

AXES = "xyz"
# The third of the sensors (0 gyro, 1 accelerometer) that laws are of.
HEADING = 2
# Knots of a curve over a driver: over an axis's own signal, where sensors stick, bend and give
# way; over others'; a line over what is itself a law (memory, play, a product).
FINE, COARSE, LINE = 9, 5, 0
# Half widths of play, rad/s and m/s^2: wider than the noise, narrower than the motion.
PLAYS = ((0.03, 0.06, 0.12, 0.25), (0.1, 0.2, 0.4, 0.8))
# Shares by which a time or a half width on trial is changed, in turn, to find the best.
NEARER = ((0.65, 0.8, 1.25, 1.5), (0.9, 1.1), (0.95, 1.05), (0.98, 1.02), (0.99, 1.01))
# Within so much of zero a sign is not one yet: wider than the noise, narrower than the motion.
SIGN = {"rad/s": 0.1, "m/s^2": 0.5}
# Slower than this (rad/s) a device is not being turned.
TURNING = 0.2
# What a sensor and its surroundings take to warm through, s.
WARMING = (3.0, 10.0, 30.0, 60.0)
# How far from the room a device is, as formulas have it.
WARM = "(T - 25)"
# Root mean square below which there is no course.
COURSELESS = 1e-9
# Between the name of a signal and that of a driver that changes how much of it is felt.
BY, PRODUCT = " by ", " * "

Of = Callable[[Signals, int], Array]


@dataclass(frozen=True)
class Driver:
    """name: with {i}, {j}, {k}; unit; of(signals, axis) -> (n,); knots: of a curve over it;
    signed: whether it has a zero where a law may change; positive: the sensor, of which it is the
    own signal, that by a positive factor alone can err so (what plays loses, and gains nothing);
    number, at: its time or half width, and the same with another one; only: the sensor
    (0 gyro, 1 accelerometer) that alone could have it; round: an angle; needs: streams or ATTITUDE
    without which it is none; factor: by which what it drives is multiplied, where it drives how
    much another signal is felt; free: a course over time, which is not each axis's own (three of
    them would be a walk)."""

    name: str
    unit: str
    of: Of
    knots: int = FINE
    signed: bool = True
    positive: int | None = None
    number: float = 0.0
    at: Callable[[float], Driver] | None = None
    only: int | None = None
    round: bool = False
    needs: tuple[str, ...] = ()
    factor: Driver | None = None
    free: bool = False

    @property
    def common(self) -> bool:
        """Whether it is the same for all axes."""
        return "{" not in self.name

    @property
    def own(self) -> bool:
        """Whether it is each axis's own, or all axes'."""
        return "{j}" not in self.name and "{k}" not in self.name

    @property
    def over(self) -> str:
        """The name of what a law is a function of, without that of a factor."""
        return self.name.rpartition(BY)[2]

    @property
    def several(self) -> bool:
        """Whether it is made of several signals."""
        return PRODUCT in self.name or BY in self.name

    @property
    def composed(self) -> bool:
        """Whether it is made of several signals, and of what an operator makes of one."""
        return self.several and operators.remembers(self.name)

    @property
    def kind(self) -> str:
        """Its name, but for a number in it."""
        return operators.without_numbers(self.name)

    def said(self, axis: int | None) -> str:
        """Its name for one axis; None: for each axis i."""
        letters = "ijk" if axis is None else [AXES[(axis + n) % 3] for n in range(3)]
        return self.over.format(i=letters[0], j=letters[1], k=letters[2])

    def scale(self, signals: Signals, axis: int) -> Array:
        """What it drives is multiplied by, (n,)."""
        one = np.ones_like(signals.t)
        return one if self.factor is None else self.factor.course(signals, axis)

    def course(self, signals: Signals, axis: int) -> Array:
        """``of`` these signals, which is not worked out again for each law over it; not to be
        changed."""
        return signals.once((self.of, axis), lambda: self.of(signals, axis))


def _rate(n: int) -> Of:
    return lambda s, axis: s.gyro[:, (axis + n) % 3]


def _force(n: int) -> Of:
    return lambda s, axis: s.accel[:, (axis + n) % 3]


def _slope(of: Of) -> Of:
    return lambda s, axis: np.asarray(np.gradient(of(s, axis), s.t))


def _total(of: Of) -> Of:
    return lambda s, _: np.sqrt(sum(of(s, axis) ** 2 for axis in range(3)))


def _time(s: Signals, _: int) -> Array:
    return np.asarray(s.t - s.t[0])


def _warmth(s: Signals, _: int) -> Array:
    return np.zeros_like(s.t) if s.temperature is None else s.temperature - ROOM


def _yaw(s: Signals, _: int) -> Array:
    return np.zeros_like(s.t) if s.C_nb is None else so3.yaw_of(s.C_nb)


@njit
def _since(t: Array, active: BoolArray) -> Array:
    out = np.empty(len(t))
    last = t[0]
    for i in range(len(t)):
        if active[i]:
            last = t[i]
        out[i] = t[i] - last
    return out


def _settling(s: Signals, axis: int) -> Array:
    return _since(s.t, np.asarray(_total(_rate(0))(s, axis) > TURNING))


RATES = tuple(Driver(f"omega_{{{x}}}", "rad/s", _rate(n)) for n, x in enumerate("ijk"))
FORCES = tuple(Driver(f"f_{{{x}}}", "m/s^2", _force(n)) for n, x in enumerate("ijk"))
TURNS = Driver("|omega|", "rad/s", _total(_rate(0)), signed=False)
LOAD = Driver("|f|", "m/s^2", _total(_force(0)), signed=False)
WARMTH = Driver(WARM, "K", _warmth, COARSE, signed=False, needs=("temperature",))
YAW = Driver("yaw", "rad", _yaw, COARSE, signed=False, round=True, needs=(ATTITUDE,))
TIME = Driver("t", "s", _time, LINE, signed=False, free=True)
_SLOPES = {"omega": ("alpha", "rad/s^2"), "f": ("jerk", "m/s^3")}


def slope(of: Driver) -> Driver:
    """How fast a rate or a force changes."""
    kind, _, axis = of.name.partition("_")
    called, unit = _SLOPES[kind]
    return Driver(f"{called}_{axis}", unit, _slope(of.of), COARSE if of.own else LINE)


def size(of: Driver) -> Driver:
    """The size of a driver."""
    return Driver(f"|{of.name}|", of.unit, lambda s, axis: np.abs(of.course(s, axis)), signed=False)


def square(of: Driver) -> Driver:
    """The square of a driver."""
    return Driver(f"{of.name}^2", f"({of.unit})^2", lambda s, axis: of.course(s, axis) ** 2, LINE,
                  signed=False)  # fmt: skip


def side(of: Driver, sign: int) -> Driver:
    """A driver where it is positive (or where it is negative, its size); else zero."""
    text = f"max({'-' * (sign < 0)}{of.name}, 0)"
    return Driver(text, of.unit, lambda s, axis: np.maximum(sign * of.course(s, axis), 0.0), LINE,
                  signed=False, needs=of.needs)  # fmt: skip


def sign(of: Driver) -> Driver:
    """The sign of a driver, as soon as it has one."""
    near = SIGN[of.unit]
    return Driver(
        f"tanh({of.name} / {near:g})", "", lambda s, axis: np.tanh(of.course(s, axis) / near)
    )


def mixed(a: Driver, b: Driver, share: float) -> Driver:
    """A signal, and a share of another one of the same unit: what acts along neither's axis."""
    share = operators.rounded(share)
    return Driver(
        f"({a.name} {'-' if share < 0.0 else '+'} {abs(share):g} * {b.name})", a.unit,
        lambda s, axis: a.course(s, axis) + share * b.course(s, axis), COARSE,
        number=abs(share), at=lambda n: mixed(a, b, math.copysign(n, share)),
        needs=(*a.needs, *b.needs),
    )  # fmt: skip


def operated(operator: str, of: Driver, number: float, only: int | None = None) -> Driver:
    """What an operator makes of a driver, with this number."""
    op, number = OPERATORS[operator], operators.rounded(number)

    def values(s: Signals, axis: int) -> Array:
        x = of.course(s, axis)
        return op.values(s.t, np.unwrap(x) if of.round else x, number, TURNS.course(s, axis))

    own = {RATES[0].name: 0, FORCES[0].name: 1, YAW.name: HEADING}.get(of.name)
    return Driver(
        operators.said(operator, of.name, of.unit, number), of.unit if op.power else "1", values,
        LINE, positive=own if op.positive else None, number=number,
        at=lambda n: operated(operator, of, n, only), only=only, needs=of.needs,
    )  # fmt: skip


def _table() -> Iterator[Driver]:
    """The vocabulary: curves over signals, and what is a law already."""
    yield from (RATES[0], *(replace(x, knots=COARSE) for x in RATES[1:]))
    yield from (FORCES[0], *(replace(x, knots=COARSE) for x in FORCES[1:]))
    yield from (TURNS, LOAD, *map(slope, (*RATES, *FORCES)))
    own = RATES[0], FORCES[0]
    for of in (*own, TURNS, *map(size, own)):
        yield from (operated("memory", of, tau) for tau in MEMORIES)
    for of in own:
        yield from (operated("lag", of, tau) for tau in OVERSHOOTS)
    for sensor, widths in enumerate(PLAYS):
        yield from (operated("play", own[sensor], half, sensor) for half in widths)
    yield Driver("(time since a turn)", "s", _settling, COARSE, signed=False)
    yield YAW
    yield WARMTH
    *soon, latest = WARMING
    yield operated("memory", WARMTH, latest)
    yield from (operated("lag", WARMTH, tau) for tau in soon)
    yield from _products()
    yield TIME
    yield replace(times(TIME, TIME), name="t^2", unit="s^2")


def _products() -> Iterator[Driver]:
    """A sensor's sensitivity to one signal that another one changes: lines over products."""
    signals = RATES + FORCES
    pairs = [*combinations(RATES, 2), *combinations(FORCES, 2), *product(RATES, FORCES)]
    pairs += list(product((RATES[0], FORCES[0]), (TURNS, LOAD)))
    others = [(a, b) for a in signals for b in signals if a is not b]
    pairs += [(a, size(b)) for a, b in others] + [(a, sign(b)) for a, b in others]
    pairs += [(a, b) for b in (TIME, WARMTH) for a in signals]
    yield from (times(a, b) for a, b in pairs)


_PRODUCTS = {
    ("rad/s", "m/s^2"): "rad*m/s^3", ("rad/s", "rad/s"): "(rad/s)^2",
    ("m/s^2", "m/s^2"): "(m/s^2)^2", ("rad/s", "s"): "rad", ("m/s^2", "s"): "m/s",
    ("rad/s", "K"): "rad/s*K", ("m/s^2", "K"): "m/s^2*K",
}  # fmt: skip


def times(a: Driver, b: Driver) -> Driver:
    """The product of two drivers; its number is that of the second."""
    unit = _PRODUCTS.get((a.unit, b.unit)) or _PRODUCTS.get((b.unit, a.unit))
    if unit is None:
        unit = a.unit if b.unit in ("", "1") else f"{a.unit}*{b.unit}"
    again = b.at
    return Driver(
        f"{a.name} * {b.name}", unit, lambda s, axis: a.course(s, axis) * b.course(s, axis), LINE,
        number=b.number, at=None if again is None else lambda n: times(a, again(n)),
        needs=(*a.needs, *b.needs),
    )  # fmt: skip


def by(factor: Driver, x: Driver) -> Driver:
    """A driver of how much another signal (the factor) is felt; its number is the factor's."""
    again = factor.at
    return replace(
        x, name=f"{factor.name}{BY}{x.name}", factor=factor, needs=(*factor.needs, *x.needs),
        number=factor.number, at=None if again is None else lambda n: by(again(n), x),
    )  # fmt: skip


DRIVERS: Mapping[str, Driver] = {d.name: d for d in _table()}


def usable(driver: Driver, signals: Signals) -> bool:
    """Whether the recording has what the driver needs."""
    have = set(signals.streams) | ({ATTITUDE} if signals.C_nb is not None else set())
    return set(driver.needs) <= have

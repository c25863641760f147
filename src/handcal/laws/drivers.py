"""What may drive an error that nobody named: the vocabulary of response curves.

A driver is a signal for each axis of a sensor. In its name {i} is the sensor's own axis, {j} and
{k} are the two that follow it; what has none of them is the same for all axes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import njit
from handcal.effects import ATTITUDE, ROOM, Signals
from handcal.types import Array, BoolArray

AXES = "xyz"
# Knots of a curve over a driver: over an axis's own signal, where sensors stick, bend and give
# way; over others'; a line over what is itself a law (memory, play, a product).
FINE, COARSE, LINE = 9, 5, 0
# Times of memory, s: from the settling of a filter to that of warm glue.
MEMORIES = (0.4, 1.0, 2.5, 6.0, 15.0)
# And of what overshoots, and comes back to what is there: shorter than most turns.
OVERSHOOTS = (0.4, 1.0, 2.5)
# Half widths of play, rad/s and m/s^2: wider than the noise, narrower than the motion.
PLAYS = ((0.03, 0.06, 0.12, 0.25), (0.1, 0.2, 0.4, 0.8))
# Shares by which a time or a half width on trial is changed, in turn, to find the best.
NEARER = ((0.65, 0.8, 1.25, 1.5), (0.9, 1.1), (0.95, 1.05))
# Within so much of zero a sign is not one yet: wider than the noise, narrower than the motion.
SIGN = {"rad/s": 0.1, "m/s^2": 0.5}
# Slower than this (rad/s) a device is not being turned.
TURNING = 0.2
# What a sensor and its surroundings take to warm through, s.
WARMING = (3.0, 10.0, 30.0, 60.0)
# How far from the room a device is, as formulas have it.
WARM = "(T - 25)"

Of = Callable[[Signals, int], Array]
_NUMBER = re.compile(r"\((memory|play)\(([^ ]+) ")


@dataclass(frozen=True)
class Driver:
    """name: with {i}, {j}, {k}; unit; of(signals, axis) -> (n,); knots: of a curve over it;
    signed: whether it has a zero where a law may change; positive: a factor that can only be
    positive; number, at: its time or half width, and the same with another one; only: the sensor
    (0 gyro, 1 accelerometer) that alone could have it; round: an angle; needs: streams or ATTITUDE
    without which it is none."""

    name: str
    unit: str
    of: Of
    knots: int = FINE
    signed: bool = True
    positive: bool = False
    number: float = 0.0
    at: Callable[[float], Driver] | None = None
    only: int | None = None
    round: bool = False
    needs: tuple[str, ...] = ()

    @property
    def common(self) -> bool:
        """Whether it is the same for all axes."""
        return "{" not in self.name

    @property
    def own(self) -> bool:
        """Whether it is each axis's own, or all axes'."""
        return "{j}" not in self.name and "{k}" not in self.name

    @property
    def kind(self) -> str:
        """Its name, but for a number in it."""
        return _NUMBER.sub(r"(\1 ", self.name)

    def said(self, axis: int | None) -> str:
        """Its name for one axis; None: for each axis i."""
        letters = "ijk" if axis is None else [AXES[(axis + n) % 3] for n in range(3)]
        return self.name.format(i=letters[0], j=letters[1], k=letters[2])


def _rate(n: int) -> Of:
    return lambda s, axis: s.gyro[:, (axis + n) % 3]


def _force(n: int) -> Of:
    return lambda s, axis: s.accel[:, (axis + n) % 3]


def _slope(of: Of) -> Of:
    return lambda s, axis: np.asarray(np.gradient(of(s, axis), s.t))


def _size(of: Of) -> Of:
    return lambda s, axis: np.abs(of(s, axis))


def _sign(name: str, unit: str, of: Of) -> tuple[str, str, Of]:
    near = SIGN[unit]
    return f"tanh({name} / {near:g})", "", lambda s, axis: np.tanh(of(s, axis) / near)


def _total(of: Of) -> Of:
    return lambda s, _: np.sqrt(sum(of(s, axis) ** 2 for axis in range(3)))


def _times(a: Of, b: Of) -> Of:
    return lambda s, axis: a(s, axis) * b(s, axis)


def _time(s: Signals, _: int) -> Array:
    return np.asarray(s.t - s.t[0])


def _warmth(s: Signals, _: int) -> Array:
    return np.zeros_like(s.t) if s.temperature is None else s.temperature - ROOM


_WARMTH = (WARM, "K", _warmth)


def _yaw(s: Signals, _: int) -> Array:
    return np.zeros_like(s.t) if s.C_nb is None else so3.yaw_of(s.C_nb)


@njit
def _remembered(t: Array, x: Array, tau: float) -> Array:
    out = np.empty(len(x))
    out[0] = x[0]
    for i in range(1, len(x)):
        share = -np.expm1(-(t[i] - t[i - 1]) / tau)
        out[i] = out[i - 1] + share * (x[i] - out[i - 1])
    return out


def _memory(of: Of, tau: float) -> Of:
    """The mean of the past, weighed by exp(-age / tau)."""
    return lambda s, axis: _remembered(s.t, np.ascontiguousarray(of(s, axis)), tau)


@njit
def _follower(x: Array, half: float) -> Array:
    out = np.empty(len(x))
    follow = x[0]
    for i in range(len(x)):
        follow = min(max(follow, x[i] - half), x[i] + half)
        out[i] = follow
    return out


def _play(of: Of, half: float) -> Of:
    """By how much what follows a signal with play lags behind it (the operator of which
    Prandtl and Ishlinskii built hysteresis)."""

    def lag(s: Signals, axis: int) -> Array:
        x = np.ascontiguousarray(of(s, axis))
        return np.asarray(_follower(x, half) - x)

    return lag


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


def _table() -> list[Driver]:
    rate, force = "omega_{%s}", "f_{%s}"
    signals = [(rate % x, "rad/s", _rate(n)) for n, x in enumerate("ijk")]
    signals += [(force % x, "m/s^2", _force(n)) for n, x in enumerate("ijk")]
    sizes = [("|omega|", "rad/s", _total(_rate(0))), ("|f|", "m/s^2", _total(_force(0)))]
    out = [Driver(*row, FINE if "{i}" in row[0] else COARSE) for row in signals]
    out += [Driver(*row, signed=False) for row in sizes]
    slopes = {"omega": ("alpha", "rad/s^2"), "f": ("jerk", "m/s^3")}
    for name, _, of in signals:
        kind, _, axis = name.partition("_")
        called, unit = slopes[kind]
        knots = COARSE if axis == "{i}" else LINE
        out.append(Driver(f"{called}_{axis}", unit, _slope(of), knots))
    own = [(f"|{name}|", unit, _size(of)) for name, unit, of in (signals[0], signals[3])]
    for row in (signals[0], signals[3], sizes[0], *own):
        out += [_memory_driver(row, tau) for tau in MEMORIES]
    for row in (signals[0], signals[3]):
        out += [_lag_driver(row, tau) for tau in OVERSHOOTS]
    for sensor, widths in enumerate(PLAYS):
        out += [_play_driver(signals[3 * sensor], sensor, half) for half in widths]
    out.append(Driver("(time since a turn)", "s", _settling, COARSE, signed=False))
    out.append(Driver("yaw", "rad", _yaw, COARSE, signed=False, round=True, needs=(ATTITUDE,)))
    warm = {"knots": COARSE, "signed": False, "needs": ("temperature",)}
    out.append(Driver(*_WARMTH, **warm))  # type: ignore[arg-type]
    *soon, latest = WARMING
    out += [_memory_driver(_WARMTH, latest), *(_lag_driver(_WARMTH, tau) for tau in soon)]
    return out + _products(signals, sizes)


def _memory_driver(row: tuple[str, str, Of], tau: float) -> Driver:
    name, unit, of = row
    tau = float(f"{tau:.3g}")
    called = f"(memory({tau:g} s) of {name})"
    at = partial(_memory_driver, row)
    needs = ("temperature",) if of is _warmth else ()
    return Driver(called, unit, _memory(of, tau), LINE, number=tau, at=at, needs=needs)


def _lag_driver(row: tuple[str, str, Of], tau: float) -> Driver:
    """By how much the memory of a signal lags behind it, which is how fast the signal changes."""
    name, unit, of = row
    memory = _memory_driver(row, tau)

    def lag(s: Signals, axis: int) -> Array:
        return np.asarray(memory.of(s, axis) - of(s, axis))

    called = f"({memory.name[1:-1]} - {name})"
    at = partial(_lag_driver, row)
    return Driver(called, unit, lag, LINE, number=memory.number, at=at, needs=memory.needs)


def _play_driver(row: tuple[str, str, Of], sensor: int, half: float) -> Driver:
    name, unit, of = row
    half = float(f"{half:.3g}")
    called = f"(play({half:g} {unit}) of {name} - {name})"
    at = partial(_play_driver, row, sensor)
    return Driver(called, unit, _play(of, half), LINE, positive=True, number=half, at=at,
                  only=sensor)  # fmt: skip


def _products(signals: list[tuple[str, str, Of]], sizes: list[tuple[str, str, Of]]) -> list[Driver]:
    """A sensor's sensitivity to one signal that another one changes: lines over products."""
    pairs = [(a, b) for n, a in enumerate(signals[:3]) for b in signals[n + 1 : 3]]
    pairs += [(a, b) for n, a in enumerate(signals[3:]) for b in signals[3:][n + 1 :]]
    pairs += list(product(signals[:3], signals[3:]))
    pairs += list(product((signals[0], signals[3]), sizes))
    others = [(a, b) for a in signals for b in signals if a is not b]
    pairs += [(a, (f"|{name}|", unit, _size(of))) for a, (name, unit, of) in others]
    pairs += [(a, _sign(*b)) for a, b in others]
    pairs += [(a, ("t", "s", _time)) for a in signals]
    out = [_product(a, b) for a, b in pairs]
    out += [_product(a, _WARMTH, ("temperature",)) for a in signals]
    out += [Driver("t", "s", _time, LINE), Driver("t^2", "s^2", _times(_time, _time), LINE)]
    return out


_PRODUCTS = {
    ("rad/s", "m/s^2"): "rad*m/s^3", ("rad/s", "rad/s"): "(rad/s)^2",
    ("m/s^2", "m/s^2"): "(m/s^2)^2", ("rad/s", "s"): "rad", ("m/s^2", "s"): "m/s",
    ("rad/s", "K"): "rad/s*K", ("m/s^2", "K"): "m/s^2*K",
}  # fmt: skip


def _product(a: tuple[str, str, Of], b: tuple[str, str, Of], needs: tuple[str, ...] = ()) -> Driver:
    unit = _PRODUCTS.get((a[1], b[1])) or _PRODUCTS.get((b[1], a[1])) or a[1]
    return Driver(f"{a[0]} * {b[0]}", unit, _times(a[2], b[2]), LINE, needs=needs)


DRIVERS: Mapping[str, Driver] = {d.name: d for d in _table()}


def driver_of(name: str) -> Driver:
    """The driver of this name, with whatever time or half width. Raises KeyError."""
    found = _NUMBER.match(name)
    if name in DRIVERS or found is None:
        return DRIVERS[name]
    for driver in DRIVERS.values():
        if driver.at is not None and (new := driver.at(float(found[2]))).name == name:
            return new
    raise KeyError(name)


def usable(driver: Driver, signals: Signals) -> bool:
    """Whether the recording has what the driver needs."""
    have = set(signals.streams) | ({ATTITUDE} if signals.C_nb is not None else set())
    return set(driver.needs) <= have

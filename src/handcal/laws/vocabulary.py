"""The whole vocabulary of drivers: what is looked at for any recording, and what is looked at
further where something errs with the motion, and no law over the first of them says how.

It is made of parts: signals, their sizes and squares, what an operator makes of them, products.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np

from handcal.effects import ATTITUDE, Signals
from handcal.laws import operators
from handcal.laws.drivers import (
    BY,
    COARSE,
    DRIVERS,
    FINE,
    FORCES,
    HEADING,
    LINE,
    LOAD,
    RATES,
    TIME,
    TURNING,
    TURNS,
    WARMING,
    WARMTH,
    YAW,
    Driver,
    Of,
    by,
    mixed,
    operated,
    side,
    sign,
    size,
    slope,
    square,
    times,
    usable,
)
from handcal.laws.operators import OPERATORS, PLAIN
from handcal.types import Array


def _north(n: int) -> Of:
    def of(s: Signals, axis: int) -> Array:
        return np.zeros_like(s.t) if s.C_nb is None else s.C_nb[:, 1, (axis + n) % 3]

    return of


def _yaw_rate(s: Signals, _: int) -> Array:
    return np.zeros_like(s.t) if s.C_nb is None else np.einsum("ni,ni->n", s.C_nb[:, 2], s.gyro)


def _up(n: int) -> Of:
    return lambda s, _: np.zeros_like(s.t) if s.C_nb is None else s.C_nb[:, 2, n]


def _total(of: Driver) -> Of:
    return lambda s, _: np.sqrt(sum(of.course(s, axis) ** 2 for axis in range(3)))


def _along(rate: Driver, slow: float) -> Driver:
    """A component of the axis about which the device turns, where it turns faster than this
    (rad/s)."""
    slow = operators.rounded(slow)

    def of(s: Signals, axis: int) -> Array:
        return np.asarray(rate.course(s, axis) / np.maximum(TURNS.course(s, axis), slow))

    return Driver(
        f"({rate.name} / max(|omega|, {slow:g}))", "1", of, LINE, number=slow,
        at=lambda n: _along(rate, n),
    )  # fmt: skip


TURNED = tuple(_along(rate, TURNING) for rate in RATES)
_HERE = (ATTITUDE,)
NORTH = tuple(
    Driver(f"north_{{{x}}}", "1", _north(n), COARSE, needs=_HERE) for n, x in enumerate("ijk")
)
PITCHES = tuple(
    Driver(f"sin(pitch of {x})", "1", _up(n), COARSE, needs=_HERE) for n, x in enumerate("xy")
)
TILT = Driver("cos(tilt)", "1", _up(2), COARSE, needs=_HERE)
# Phases of a wave round the circle of headings, over half of it, rad.
PHASES = tuple(math.pi * (n + 0.5) / 6.0 for n in range(6))


def bearing(phase: float) -> Driver:
    """A wave once round the circle of headings."""
    phase = operators.rounded(phase)
    return Driver(
        f"cos(yaw - {phase:g})", "1", lambda s, axis: np.cos(YAW.course(s, axis) - phase), LINE,
        number=phase, at=bearing, needs=_HERE,
    )  # fmt: skip


YAW_RATE = Driver("(yaw rate)", "rad/s", _yaw_rate, COARSE, needs=_HERE)
SLOPES = tuple(map(slope, (*RATES, *FORCES)))
SHAKEN = (
    Driver("|alpha|", "rad/s^2", _total(SLOPES[0]), COARSE, signed=False),
    Driver("|jerk|", "m/s^3", _total(SLOPES[3]), COARSE, signed=False),
)
# Knots of a gain over time: two to a swing of which a recording has a dozen.
FINEST = 33
# Signals that are not among the first drivers, over which lie curves.
FURTHER = (*map(size, SLOPES), *SHAKEN, *TURNED, *NORTH, YAW_RATE)
_PLAIN: Mapping[str, Driver] = {d.name: d for d in (*FURTHER, *PITCHES, TILT)}
# What drives a heading's curves (``terms.CURVES``), as drivers of formulas.
CURVED: Mapping[str, Driver] = {
    "yaw": YAW, "pitch of x": PITCHES[0], "pitch of y": PITCHES[1], "tilt": TILT,
    "yaw rate": YAW_RATE,
}  # fmt: skip
# What a compass may do with the heading besides showing it: come late, stick, swing. (What is a
# delay alone has a name.)
NEEDLE = ("lag", "play", "stick", "slew", "swing", "sway")


def driver_of(name: str) -> Driver:
    """The driver of this name, whatever the numbers in it. Raises KeyError."""
    if name in DRIVERS or name in _PLAIN:
        return DRIVERS[name] if name in DRIVERS else _PLAIN[name]
    made = _made(name)
    if made.name != name:  # (a number in it that there is none with)
        raise KeyError(name)
    return made


@cache
def _made(name: str) -> Driver:
    factor, _, x = name.partition(BY)
    if x:
        return by(driver_of(factor), driver_of(x))
    if (found := operators.parsed(name)) is not None:
        operator, number, signal = found
        return operated(operator, driver_of(signal), number)
    first, rest = operators.factors(name)
    if rest:
        return times(driver_of(first), driver_of(rest))
    if name.endswith("^2"):
        return square(driver_of(name[:-2]))
    if (one := operators.SIDE.fullmatch(name)) is not None:
        return side(driver_of(one[2]), -1 if one[1] else 1)
    if (one := operators.SIGN.fullmatch(name)) is not None:
        return sign(driver_of(one[1]))
    if (one := operators.MIXED.fullmatch(name)) is not None:
        share = float(one[3]) if one[2] == "+" else -float(one[3])
        return mixed(driver_of(one[1]), driver_of(one[4]), share)
    if (one := operators.BEARING.fullmatch(name)) is not None:
        return bearing(float(one[1]))
    if (one := operators.DIRECTION.fullmatch(name)) is not None:
        return _along(driver_of(one[1]), float(one[2]))
    if name[:1] == name[-1:] == "|":
        return size(driver_of(name[1:-1]))
    raise KeyError(name)


def further(signals: Signals, sensor: int) -> Iterator[Driver]:
    """What may drive a sensor besides ``DRIVERS`` (a heading: besides what ``terms`` has), in a
    recording that has it."""
    if sensor == HEADING:
        yield from made_by(YAW, signals, NEEDLE)
        yield from made_by(YAW, signals, ("frozen",))
        yield from SLOPES
        for of in filter(lambda d: usable(d, signals), (YAW_RATE, *PITCHES, WARMTH)):
            yield from made_by(of, signals, PLAIN)
        yield from made_by(TURNS, signals, ("memory", "lag", "peak"))
        if usable(WARMTH, signals):  # (what is warmed follows slower than what turns)
            yield from (operated("lag", WARMTH, tau) for tau in WARMING)
        yield from _changing_waves(signals)
        return
    own = (RATES, FORCES)[sensor][0]
    yield from (d for d in FURTHER if usable(d, signals))
    for of in (*RATES, *FORCES, *filter(lambda d: usable(d, signals), (*NORTH, WARMTH))):
        yield from made_by(of, signals, PLAIN)
    sizes = [size(of) for of in (*RATES, *FORCES, *SLOPES)]
    for of in (TURNS, LOAD, *sizes, *SHAKEN, square(own), square(TURNS)):
        yield from made_by(of, signals, ("memory", "lag", "peak"))
    for of in (*RATES, *FORCES):
        yield from made_by(of, signals, ("frozen",))
    for of in map(sign, (RATES[0], FORCES[0])):
        yield from made_by(of, signals, ("memory", "lag"))
    for of in (TURNS, square(TURNS), LOAD, size(own), square(own)):
        yield from (times(own, memory) for memory in made_by(of, signals, ("memory",)))
    heats = list(made_by(square(TURNS), signals, ("memory",)))
    yield from (times(x, heat) for x in (*RATES, *FORCES) if x is not own for heat in heats)
    for of in (side(x, way) for x in FORCES for way in (1, -1)):
        yield from made_by(of, signals, ("memory",))
    others = (TURNS, LOAD, *RATES[1:], *FORCES[1:], (FORCES, RATES)[sensor][0], YAW, WARMTH, TIME)
    for x in filter(lambda d: usable(d, signals), others):
        yield by(own, replace(x, knots=FINEST if x is TIME else COARSE))
    yield from (by(x, replace(TIME, knots=FINEST)) for x in (*RATES, *FORCES) if x is not own)
    if usable(WARMTH, signals):
        yield replace(WARMTH, knots=FINE)
        yield from (times(own, operated("lag", WARMTH, tau)) for tau in WARMING)
    yield from _further_products(signals)


def _changing_waves(signals: Signals) -> Iterator[Driver]:
    """Waves of a heading, felt by as much as another signal says."""
    if not usable(YAW, signals):
        return
    felt = (*RATES, *FORCES, TURNS, LOAD, YAW_RATE, size(YAW_RATE), *PITCHES, TILT, WARMTH, TIME)
    yield YAW
    yield from (by(x, YAW) for x in felt if usable(x, signals))
    yield from (by(bearing(phase), replace(TIME, knots=FINEST)) for phase in PHASES)


def _further_products(signals: Signals) -> Iterator[Driver]:
    """Products that either sensor may err by."""
    pairs = (*combinations(RATES, 2), *combinations(FORCES, 2))
    yield from (replace(times(a, b), knots=COARSE) for a, b in pairs)
    for triple in (RATES, FORCES):
        yield times(triple[0], times(*triple[1:]))
    for a in SLOPES if usable(WARMTH, signals) else ():
        yield times(WARMTH, a)
    for a in SLOPES:
        yield from (times(a, whole) for whole in (TURNS, LOAD))
        yield from (times(b, a) for b in (*RATES, *FORCES) if b.name[-3:] != a.name[-3:])
    for a in filter(lambda d: usable(d, signals), NORTH):
        yield from (times(b, a) for b in (*RATES, *FORCES))


def made_by(of: Driver, signals: Signals, names: tuple[str, ...]) -> Iterator[Driver]:
    """What these operators make of a driver, with the numbers to begin with; but for what the
    first vocabulary has."""
    x = np.stack([of.course(signals, axis) for axis in range(3)], axis=1)
    for name in names:
        for number in OPERATORS[name].begun(signals.t, x):
            if number > 0.0 and (made := operated(name, of, number)).name not in DRIVERS:
                yield made

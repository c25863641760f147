"""Drivers made of several signals and of what an operator makes of them: far more than a scan looks
at, so that only those are that a look at what they are in short windows promises most of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, combinations_with_replacement

from handcal.effects import Signals
from handcal.laws.drivers import (
    COARSE,
    FORCES,
    LOAD,
    RATES,
    TURNS,
    WARMING,
    WARMTH,
    YAW,
    Driver,
    by,
    mixed,
    operated,
    size,
    square,
    times,
    usable,
)
from handcal.laws.operators import OVERSHOOTS, PLAIN
from handcal.laws.vocabulary import NORTH, PITCHES, SLOPES, TILT, YAW_RATE, made_by

# What is remembered of a signal, and of one that has no sign.
_PAST = ("memory", "lag", "friction", "side", "peak")
_PAST_SIZE = ("memory", "lag", "peak")
# Shares of a second axis's signal in what acts along a direction between two.
SHARES = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)


def composed(signals: Signals) -> Iterator[Driver]:
    """All of them that a recording has, for either sensor."""
    plain = (*RATES, *FORCES)
    whole = (TURNS, LOAD)
    turned = tuple(d for d in (*NORTH, *PITCHES, TILT) if usable(d, signals))
    for of in SLOPES:
        yield from made_by(of, signals, PLAIN)
    felt = (*plain, *map(size, plain), *whole)
    for of in (*plain, *whole, *map(size, plain)):
        yield from (times(x, past) for past in _past(of, signals) for x in felt)
    pairs = [times(a, b) for a, b in combinations_with_replacement(plain, 2)]
    pairs += [times(a, size(b)) for a in plain for b in plain]
    pairs += [times(a, square(a)) for a in plain]
    for pair in pairs:
        yield from made_by(pair, signals, _PAST_SIZE)
    yield from _beyond_their_means(plain, signals)
    yield from (times(a, times(b, c)) for a, b, c in combinations(plain, 3))
    for triple in (RATES, FORCES):
        yield from (mixed(a, b, share) for a, b in combinations(triple, 2) for share in SHARES)
    for x in (replace(d, knots=COARSE) for d in (*plain, *whole, WARMTH, YAW)):
        if usable(x, signals):
            yield from (by(a, x) for a in (*RATES[1:], *FORCES[1:]) if a.name != x.name)
    if usable(WARMTH, signals):
        late = [operated("lag", WARMTH, tau) for tau in WARMING]
        yield from (times(x, past) for past in late for x in (*plain, *whole, *turned))


def _beyond_their_means(plain: tuple[Driver, ...], signals: Signals) -> Iterator[Driver]:
    """Products of two signals less what each was, and what is remembered of them."""
    for a, b in combinations(plain, 2):
        for tau in OVERSHOOTS:
            pair = times(operated("lag", a, tau), operated("lag", b, tau))
            yield pair
            yield from made_by(pair, signals, ("memory",))


def composed_headings(signals: Signals) -> Iterator[Driver]:
    """Those of a measured heading: waves of it that are felt by as much as something remembered
    says, products, and what operators make of what turns or tilts the device."""
    turned = tuple(d for d in (YAW_RATE, *PITCHES, TILT) if usable(d, signals))
    plain = (*RATES, *FORCES, *turned)
    whole = (TURNS, LOAD, *map(size, plain))
    for of in (*RATES, *FORCES, LOAD, TILT):
        if usable(of, signals):
            yield from made_by(of, signals, PLAIN if of.signed else _PAST_SIZE)
    past = [made for of in (*plain, *whole) for made in _past(of, signals)]
    if usable(YAW, signals):
        yield from (by(x, YAW) for x in past)
    first = (*turned, *map(size, turned), TURNS)
    yield from (times(x, made) for made in past for x in first)
    pairs = [times(a, b) for a, b in combinations_with_replacement(plain, 2)]
    yield from pairs
    yield from (times(a, size(b)) for a in plain for b in plain if a is not b)
    for pair in pairs:
        yield from made_by(pair, signals, ("memory",))


def _past(of: Driver, signals: Signals) -> Iterator[Driver]:
    """What is remembered of a signal."""
    return made_by(of, signals, _PAST if of.signed else _PAST_SIZE)

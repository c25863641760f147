"""The families of courses over time and over the heading's direction: their values, formulas and
words, and where to begin with their numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal.effects import TIME
from handcal.laws.terms import DIRECTIONS
from handcal.types import Array, BoolArray

# Knots over a recording: as many at most, a power of two of seconds apart.
MOST = 48
# Fewer whole swings than these a walk makes as well.
SWINGS = 2.0
# Shares of a period for which something is on that is switched on and off.
ON = (0.15, 0.25, 0.35, 0.5, 0.65)
# To within what share of how long something lasts its formula says when it was, if it comes and
# goes smoothly or at once: so the text leaves a hundredth of the course, root mean square.
SMOOTH, SHARP = 0.01, 1e-4
Values = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Family:
    """Courses that differ by their numbers (p,): values(numbers, x) -> (m,) of height one,
    their formula, the same in words, where to begin, and the course of a heading's error as a
    function to compile. again: which of several beginnings (m, p) may come besides numbers (q,), as
    high; moment: how many of the first numbers it then adds."""

    name: str
    values: Values
    formula: Callable[[Array], str]
    words: Callable[[Array], str]
    starts: Callable[[float], Iterator[tuple[float, ...]]]
    compiled: Callable[..., Callable[..., int]]
    again: Callable[[Array, Array], BoolArray] | None = None
    moment: int = 0


def _moments(numbers: Array) -> Array:
    """The moments of bumps of one width, which is the second number."""
    return np.delete(numbers, 1)


def _bump(numbers: Array, x: Array) -> Array:
    apart = (x[..., None] - _moments(numbers)) / numbers[1]
    return np.asarray(np.exp(-0.5 * apart**2).sum(axis=-1))


def _as_wide(numbers: Array, starts: Array) -> BoolArray:
    near = np.abs(starts[:, :1] - _moments(numbers)).min(axis=1) < 2.0 * numbers[1]
    return np.asarray((starts[:, 1] == numbers[1]) & ~near)


def _bumps(span: float) -> Iterator[tuple[float, ...]]:
    for width in span * np.geomspace(0.01, 0.15, 6):
        for at in np.arange(0.0, span, 0.7 * width):
            yield float(at), float(width)


def _bump_at(at: float, width: float, *more: float) -> Callable[..., int]:
    moments = (at, *more)

    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        for moment in moments:
            x = (z[TIME] - moment) / width
            r[0] -= k[0] * math.exp(-0.5 * x * x)
        return 0

    return heading


def _while(numbers: Array, x: Array) -> Array:
    # (edges as wide as the grid is fine, so that they can be moved)
    edge = max(1e-3, float(x[1] - x[0]))
    up, down = (x[:, None] - numbers[::2]) / edge + 0.5, (numbers[1::2] - x[:, None]) / edge + 0.5
    return np.asarray((np.clip(up, 0.0, 1.0) * np.clip(down, 0.0, 1.0)).sum(axis=1))


def _apart(numbers: Array, starts: Array) -> BoolArray:
    before = starts[:, 1:] < numbers[::2]
    return np.asarray((before | (starts[:, :1] > numbers[1::2])).all(axis=1))


def _whiles(span: float) -> Iterator[tuple[float, ...]]:
    edges = np.linspace(0.0, span, MOST)
    for i, a in enumerate(edges[:-1]):
        for b in edges[i + 1 :]:
            if a > 0.0 or b < span:
                yield float(a), float(b)


def _while_in(*edges: float) -> Callable[..., int]:
    spans = tuple(zip(edges[::2], edges[1::2], strict=True))

    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        for first, last in spans:
            if first <= z[TIME] <= last:
                r[0] -= k[0]
        return 0

    return heading


def _switched(numbers: Array, x: Array) -> Array:
    period, start, length = numbers
    # (edges as wide as the grid is fine, so that they can be moved)
    edge = max(1e-3, float(x[1] - x[0]))
    since = np.mod(x - start + 0.5 * edge, period)
    return np.asarray(np.clip(np.minimum(since, length + edge - since) / edge, 0.0, 1.0))


def _switches(span: float) -> Iterator[tuple[float, ...]]:
    for k in np.arange(SWINGS, MOST / 4.0, 0.5):
        for start in np.arange(12) / 12.0:
            for on in ON:
                yield float(span / k), float(start * span / k), float(on * span / k)


def _switched_on(period: float, start: float, length: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        if (z[TIME] - start) % period < length:
            r[0] -= k[0]
        return 0

    return heading


def _fade(numbers: Array, x: Array) -> Array:
    # (edges as wide as the grid is fine, so that they can be moved)
    edge = max(1e-3, float(x[1] - x[0]))
    since = x[:, None] - _moments(numbers)
    there = np.clip(since / edge + 0.5, 0.0, 1.0)
    return np.asarray((there * np.exp(-np.maximum(since, 0.0) / numbers[1])).sum(axis=1))


def _as_long(numbers: Array, starts: Array) -> BoolArray:
    near = np.abs(starts[:, :1] - _moments(numbers)).min(axis=1) < 0.5 * numbers[1]
    return np.asarray((starts[:, 1] == numbers[1]) & ~near)


def _fades(span: float) -> Iterator[tuple[float, ...]]:
    for tau in span * np.geomspace(0.02, 0.3, 6):
        for at in np.linspace(0.0, span, MOST)[1:-1]:
            yield float(at), float(tau)


def _fade_at(at: float, tau: float, *more: float) -> Callable[..., int]:
    moments = (at, *more)

    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        for moment in moments:
            if z[TIME] >= moment:
                r[0] -= k[0] * math.exp(-(z[TIME] - moment) / tau)
        return 0

    return heading


def _saw(numbers: Array, x: Array) -> Array:
    return np.asarray(np.mod((x - numbers[1]) / numbers[0], 1.0) - 0.5)


def _saws(span: float) -> Iterator[tuple[float, ...]]:
    for k in np.arange(SWINGS, MOST / 4.0, 0.25):
        for start in np.arange(12) / 12.0:
            yield float(span / k), float(start * span / k)


def _saw_of(period: float, start: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= k[0] * (((z[TIME] - start) / period) % 1.0 - 0.5)
        return 0

    return heading


def _swing(numbers: Array, x: Array) -> Array:
    return np.asarray(np.sin(2.0 * np.pi * x / numbers[0] + numbers[1]))


def _swings(span: float) -> Iterator[tuple[float, ...]]:
    for k in np.arange(SWINGS, MOST / 3.0, 0.5):
        for phase in np.arange(8) * np.pi / 8.0:
            yield float(span / k), float(phase)


def _swing_of(period: float, phase: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= k[0] * math.sin(2.0 * math.pi * z[TIME] / period + phase)
        return 0

    return heading


def _chirp(numbers: Array, x: Array) -> Array:
    first, rate, phase = numbers
    return np.asarray(np.sin(2.0 * np.pi * (first + 0.5 * rate * x) * x + phase))


def _chirps(span: float) -> Iterator[tuple[float, ...]]:
    swings = np.arange(1.0, MOST / 3.0, 1.0)
    for first in swings:
        for last in swings:
            # (less than half a swing apart it is one of a steady rate)
            if abs(last - first) > 1.0:
                for phase in np.arange(8) * np.pi / 8.0:
                    yield float(first / span), float((last - first) / span**2), float(phase)


def _chirp_of(first: float, rate: float, phase: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        turns = (first + 0.5 * rate * z[TIME]) * z[TIME]
        r[0] -= k[0] * math.sin(2.0 * math.pi * turns + phase)
        return 0

    return heading


def _ring(numbers: Array, x: Array) -> Array:
    tau, period, phase = numbers
    return np.asarray(np.exp(-x / tau) * np.sin(2.0 * np.pi * x / period + phase))


def _rings(span: float) -> Iterator[tuple[float, ...]]:
    for k in np.arange(SWINGS, MOST / 3.0, 1.0):
        # (within a swing it is a decay, and longer than the recording a swing)
        for tau in (span / k) * np.geomspace(0.4, 0.7 * k, 6):
            for phase in np.arange(8) * np.pi / 8.0:
                yield float(tau), float(span / k), float(phase)


def _ring_of(tau: float, period: float, phase: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        fade = math.exp(-z[TIME] / tau)
        r[0] -= k[0] * fade * math.sin(2.0 * math.pi * z[TIME] / period + phase)
        return 0

    return heading


def _decay(numbers: Array, x: Array) -> Array:
    return np.asarray(np.exp(-x / numbers[0]))


def _decays(span: float) -> Iterator[tuple[float, ...]]:
    for tau in span * np.geomspace(0.03, 1.0, 12):
        yield (float(tau),)


def _decay_of(tau: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= k[0] * math.exp(-z[TIME] / tau)
        return 0

    return heading


def _lobe(numbers: Array, x: Array) -> Array:
    return np.asarray(np.exp(numbers[1] * (np.cos(x - numbers[0]) - 1.0)))


def _lobes(span: float) -> Iterator[tuple[float, ...]]:
    for sharp in (2.0, 4.0, 8.0, 16.0, 32.0):
        for at in np.arange(DIRECTIONS) * span / DIRECTIONS:
            yield float(at - np.pi), sharp


def _lobe_at(at: float, sharp: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        yaw = math.atan2(nav[9], nav[6])
        r[0] -= k[0] * math.exp(sharp * (math.cos(yaw - at) - 1.0))
        return 0

    return heading


def _bump_formula(n: Array) -> str:
    if len(n) == 2:
        return f"exp(-((t - {_moment(n[0], SMOOTH * n[1])} s) / {n[1]:.4g} s)^2 / 2)"
    at = _all_of(n, SMOOTH)
    return f"(sum of exp(-((t - t_n) / {n[1]:.4g} s)^2 / 2) for t_n = {at} s)"


def _while_formula(n: Array) -> str:
    return f"(t from {_spans(n, SHARP)})"


def _fade_formula(n: Array) -> str:
    if len(n) == 2:
        at = _moment(n[0], SHARP * n[1])
        return f"(t >= {at} s) exp(-(t - {at} s) / {n[1]:.4g} s)"
    at = _all_of(n, SHARP)
    return f"(sum of (t >= t_n) exp(-(t - t_n) / {n[1]:.4g} s) for t_n = {at} s)"


def _switched_formula(n: Array) -> str:
    at = _moment(n[1] % n[0], SHARP * n[2])
    return f"((t - {at} s) mod {n[0]:.6g} s < {n[2]:.5g} s)"


def _saw_formula(n: Array) -> str:
    return f"((t - {_moment(n[1] % n[0], SHARP * n[0])} s) / {n[0]:.6g} s mod 1 - 0.5)"


def _swing_formula(n: Array) -> str:
    return f"sin(2 pi t / {n[0]:.6g} s + {n[1] % (2.0 * np.pi):.3f})"


def _chirp_formula(n: Array) -> str:
    sign, rate = "-" if n[1] < 0.0 else "+", abs(0.5 * n[1])
    return f"sin(2 pi (t {n[0]:.6g} Hz {sign} t^2 {rate:.5g} Hz/s) + {n[2] % (2.0 * np.pi):.3f})"


def _ring_formula(n: Array) -> str:
    return f"exp(-t / {n[0]:.4g} s) sin(2 pi t / {n[1]:.6g} s + {n[2] % (2.0 * np.pi):.3f})"


def _decay_formula(n: Array) -> str:
    return f"exp(-t / {n[0]:.4g} s)"


def _lobe_formula(n: Array) -> str:
    return f"exp({n[1]:.4g} (cos(yaw - {(n[0] + np.pi) % (2.0 * np.pi) - np.pi:.3f}) - 1))"


def _moment(at: float, within: float) -> str:
    """A moment to within so many seconds."""
    return f"{at:.{max(0, math.ceil(-math.log10(max(within, 1e-6))))}f}"


def _all_of(n: Array, share: float) -> str:
    """All moments of a course, in turn, to within a share of how long it lasts."""
    return ", ".join(_moment(moment, share * n[1]) for moment in np.sort(_moments(n)))


def _bump_words(n: Array) -> str:
    at = " s, about ".join(f"{moment:.0f}" for moment in np.sort(_moments(n)))
    return f"Something came and went about {at} s, within some {4.0 * n[1]:.2g} s."


def _while_words(n: Array) -> str:
    return f"It was there from {_spans(n, 0.1, 0.1)} only."


def _fade_words(n: Array) -> str:
    at = " s, at ".join(f"{moment:.3g}" for moment in np.sort(_moments(n)))
    return f"It came at once at {at} s, and fades to a third every {n[1]:.2g} s."


def _switched_words(n: Array) -> str:
    return f"It is switched on every {n[0]:.3g} s, for {n[2]:.3g} s."


def _saw_words(n: Array) -> str:
    return f"It drifts, and is set back every {n[0]:.3g} s."


def _spans(n: Array, share: float, most: float = math.inf) -> str:
    """Spells in turn, to within a share of how long each lasts, and so many seconds at the most."""
    spans = n.reshape(-1, 2)[np.argsort(n[::2])]
    within = np.minimum(share * (spans[:, 1] - spans[:, 0]), most)
    ends = zip(spans, within, strict=True)
    return ", from ".join(f"{_moment(a, w)} s to {_moment(b, w)} s" for (a, b), w in ends)


def _swing_words(n: Array) -> str:
    return f"It swings, once in {n[0]:.3g} s."


def _chirp_words(n: Array) -> str:
    more = "faster" if n[1] * n[0] > 0.0 else "slower"
    return f"It swings, at first once in {1.0 / max(abs(n[0]), 1e-6):.3g} s, and ever {more}."


def _ring_words(n: Array) -> str:
    return (
        f"It swings after the start, once in {n[1]:.3g} s, and fades to a third every {n[0]:.2g} s."
    )


def _decay_words(n: Array) -> str:
    return f"It fades after the start, to a third every {n[0]:.2g} s."


def _lobe_words(n: Array) -> str:
    at = math.degrees((n[0] + math.pi) % (2.0 * math.pi) - math.pi)
    return f"It is felt where the heading is about {at:.0f} deg."


OVER_TIME = (
    Family("bump", _bump, _bump_formula, _bump_words, _bumps, _bump_at, _as_wide, 1),
    Family("while", _while, _while_formula, _while_words, _whiles, _while_in, _apart, 2),
    Family("swing", _swing, _swing_formula, _swing_words, _swings, _swing_of),
    Family("chirp", _chirp, _chirp_formula, _chirp_words, _chirps, _chirp_of),
    Family("ring", _ring, _ring_formula, _ring_words, _rings, _ring_of),
    Family("decay", _decay, _decay_formula, _decay_words, _decays, _decay_of),
    Family("fade", _fade, _fade_formula, _fade_words, _fades, _fade_at, _as_long, 1),
    Family("switched", _switched, _switched_formula, _switched_words, _switches, _switched_on),
    Family("saw", _saw, _saw_formula, _saw_words, _saws, _saw_of),
)
OVER_YAW = (Family("lobe", _lobe, _lobe_formula, _lobe_words, _lobes, _lobe_at),)
# What families are called.
COURSES = frozenset(family.name for family in (*OVER_TIME, *OVER_YAW))

"""Stamps of arrival: what a link hands over in bursts was taken one after the other.

A burst holds equal counts, and comes once in a period; the stamps in it say when it came. Readings
are numbered, and put on a straight line through the earliest arrivals: its slope is the sensor's
own step, by the clock that stamped them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal.types import Array, BoolArray, IntArray

# Fewer readings or bursts than this show no rule; so many a burst at the most.
FEWEST, BURSTS, LARGEST = 60, 8, 64
# Between bursts a step is so many times one within; a burst takes this part of its period.
LONGER, BRIEF = 3.0, 0.6
# Bursts that are like the usual one, of all, and by which part its period may differ.
ALIKE, EVEN = 0.75, 0.4
# A pause of so many periods is a gap, behind which the line begins anew.
PAUSE = 20.0
# Of the arrivals this share is early; shorter than this no step is told from none, s.
EARLY, INSTANT = 0.3, 1e-6


@dataclass(frozen=True)
class Bursts:
    """Stamps of readings (n,), ns, as they were taken, and what is said of it."""

    ns: IntArray
    text: str


def in_bursts(ns: IntArray, value: Array, name: str) -> Bursts | None:
    """Of stamps (n,), ns, that come in bursts; None where they do not. value (n, d): readings that
    repeat with their stamps were taken once."""
    if len(ns) < FEWEST or np.any(np.diff(ns) < 0):
        return None
    t = (ns - ns[0]) / 1e9
    step = np.diff(t)
    begins = _begins(step)
    if begins is None:
        return None
    first = np.flatnonzero(np.r_[True, begins])
    count = np.diff(np.r_[first, len(t)])
    usual = int(np.median(count))
    period = np.diff(t[first])
    whole = float(np.median(period))
    last = t[first + count - 1] - t[first]
    alike = (np.abs(count - usual) <= max(0, usual // 10))[:-1] & (
        np.abs(period / whole - 1.0) < EVEN
    )
    brief = float(np.median(last)) < BRIEF * whole
    if usual < 2 or len(first) < BURSTS or alike.mean() < ALIKE or not brief:
        return None
    if np.mean(np.any(np.diff(value, axis=0) != 0.0, axis=1)[~begins]) < 0.5:
        return None
    taken, own = _on_lines(t, first, count, usual, whole)
    text = (
        f"{name}: the stamps are those of arrival, {usual} readings every {whole:.3g} s; they were "
        f"put at a steady {1.0 / own:.4g} Hz, on a line through the earliest arrivals."
    )
    return Bursts(ns[0] + np.rint(1e9 * taken).astype(np.int64), text)


def _begins(step: Array) -> BoolArray | None:
    """Which steps (n - 1,), s, go on to another burst: those beyond the widest gap among their
    sizes; None where there is no such gap."""
    ordered = np.sort(np.maximum(step, INSTANT))
    low, high = int(0.45 * len(ordered)), len(ordered) - len(ordered) // (LARGEST + 1)
    wider = ordered[low + 1 : high + 1] / ordered[low : min(high, len(ordered) - 1)]
    if not len(wider) or wider.max() < LONGER:
        return None
    return np.asarray(step > ordered[low + int(np.argmax(wider))])


def _on_lines(
    t: Array, first: IntArray, count: IntArray, usual: int, whole: float
) -> tuple[Array, float]:
    """When readings were taken (n,), s, and their step: bursts begin at first (k,) and hold count
    (k,), usual of them every whole, s."""
    number = np.arange(len(t))
    pause = np.diff(t[first])
    # (a burst that is missing leaves its numbers out)
    missing = usual * np.maximum(np.rint(pause / whole).astype(np.int64) - 1, 0)
    number = number + np.repeat(np.r_[0, np.cumsum(missing)], count)
    anew = np.r_[False, pause > PAUSE * whole]
    part = np.cumsum(anew)
    end = first + count - 1
    longest = int(np.argmax(np.bincount(part)))
    x, y = (v[end[part == longest]].astype(np.float64) for v in (number, t))
    third = max(1, len(x) // 3)
    slope = float(np.median((y[-third:] - y[:third]) / (x[-third:] - x[:third])))
    for _ in range(4):
        late = y - slope * x
        early = late <= np.quantile(late, EARLY)
        spread = x[early] - x[early].mean()
        if early.sum() > 2 and np.any(spread):
            slope = float(spread @ y[early] / (spread @ spread))
    offsets = [np.quantile(t[end[part == k]] - slope * number[end[part == k]], 0.5 * EARLY)
               for k in range(int(part[-1]) + 1)]  # fmt: skip
    taken = slope * number + np.repeat(np.array(offsets)[part], count)
    return taken, slope


def moved_along(ns: IntArray, old: IntArray, new: IntArray) -> IntArray:
    """Stamps of another stream (m,) that are among the IMU's old ones, moved as those were."""
    at = np.searchsorted(old, ns).clip(0, len(old) - 1)
    return np.where(old[at] == ns, new[at], ns) if np.mean(old[at] == ns) > 0.9 else ns

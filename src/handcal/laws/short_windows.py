"""What errors of a sensor in short windows of time would do to a fit: one scan of a constant in
each window, beside which any course at all can be weighed, as the means that it has in them, for
the price of a product with a matrix. (A scan of a thousand courses takes as long as this one.)"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.estimate.columns import Ground
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.laws.drivers import Driver
from handcal.laws.law_effect import SIZE
from handcal.laws.weighing import Beside, beside, gains
from handcal.signals import some
from handcal.types import Array, IntArray

# How long a window is, s: as far apart as a held point is looked at; and windows at the most, with
# the square of which the work grows.
WINDOW, MOST_WINDOWS = 1.0 / 3.0, 450
# Courses are worked out so many times a second: in a hand, hardly anything is faster.
RATE = 40.0
# Courses that are handed on, and of one kind (times and widths apart).
LIKELIEST, OF_A_KIND = 36, 2
# Courses that are worked out and weighed at a time.
TOGETHER = 500


@dataclass(frozen=True, eq=False)
class Courses:
    """Drivers, with the means of each on three axes in each window (d, 3, K), as shares of their
    root mean square (d,)."""

    drivers: Sequence[Driver]
    means: Array
    rms: Array


def fits_in(signals: Signals) -> bool:
    """Whether there are not too many windows."""
    return _count(signals.t) <= MOST_WINDOWS


def _count(t: Array) -> int:
    return max(1, math.floor(float(t[-1] - t[0]) / WINDOW))


def _windows(t: Array, all_: Array) -> IntArray:
    """The window of each of some times t (n,) of all."""
    return np.asarray(np.minimum(((t - all_[0]) / WINDOW).astype(np.int64), _count(all_) - 1))


def courses_of(drivers: Sequence[Driver], signals: Signals) -> Courses:
    """Those of them that have a course."""
    rate = len(signals.t) / max(float(signals.t[-1] - signals.t[0]), 1e-9)
    fewer = some(signals, np.arange(0, len(signals.t), max(1, round(rate / RATE)), dtype=np.int64))
    window = _windows(fewer.t, signals.t)
    first = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    count = np.diff(np.r_[first, len(fewer.t)])

    def worked_out(chunk: Sequence[Driver]) -> tuple[Array, Array]:
        # (of a window without a reading there is no mean, and nothing depends on it)
        means: Array = np.zeros((len(chunk), 3, _count(signals.t)))
        rms = np.zeros(len(chunk))
        for n, driver in enumerate(chunk):
            x = np.stack([driver.course(fewer, axis) for axis in range(3)])
            rms[n] = math.sqrt(float(np.mean(x**2)))
            if rms[n] > 0.0:
                means[n][:, window[first]] = np.add.reduceat(x / rms[n], first, axis=1) / count
        return means, rms

    chunks = [drivers[n : n + TOGETHER] for n in range(0, len(drivers), TOGETHER)]
    done = in_parallel(partial(worked_out, chunk) for chunk in chunks)
    means, rms = (np.concatenate(x) for x in zip(*done, strict=True))
    told = (rms > 1e-9) & np.isfinite(means).all(axis=(1, 2))
    return Courses([d for d, yes in zip(drivers, told, strict=True) if yes], means[told], rms[told])


def likeliest(
    model: Model, base: Sequence[Ground], known: Sequence[Effect], sensor: int, courses: Courses
) -> list[Driver]:
    """The drivers over which a law of one constant gains most about a model, on one axis or alike
    on all of them, the best first."""
    windows = [_constant(3 * sensor + axis, courses.means.shape[2]) for axis in range(3)]
    q = scan(model, windows, base, 1.0)
    seen = beside(q, known, windows)
    gain = _gains(courses.means, seen, [seen.at[e.id] for e in windows]).max(axis=1)
    out: list[Driver] = []
    kinds: dict[str, int] = {}
    for n in np.argsort(-gain, kind="stable"):
        driver = courses.drivers[n]
        kinds[driver.kind] = kinds.get(driver.kind, 0) + 1
        if kinds[driver.kind] <= OF_A_KIND:
            out.append(driver)
        if len(out) == LIKELIEST:
            break
    return out


def _constant(channel: int, count: int) -> Effect:
    """An error of a channel that is another constant in each window."""

    def features(signals: Signals) -> list[tuple[int, int, Array]]:
        columns = np.zeros((len(signals.t), count))
        columns[np.arange(len(signals.t)), _windows(signals.t, signals.t)] = 1.0
        return [(channel, 0, columns)]

    size = SIZE[channel // 3]
    return Effect(
        id=f"windows: {channel}", title="", story="", source="", motion="", validated="",
        parameters=tuple(Param(f"w{n}", "", size) for n in range(count)),
        imu_error=added(features), features=features,
    )  # fmt: skip


def _gains(means: Array, seen: Beside, at: Sequence[IntArray]) -> Array:
    """Nats (d, 4) that a law of one constant over each driver gains, on each axis and on all of
    them alike."""
    out = np.empty((len(means), 4))
    for first in range(0, len(means), TOGETHER):
        c = means[first : first + TOGETHER]
        b = np.stack([c[:, a] @ seen.b[at[a]] for a in range(3)], axis=1)
        each = [[((c[:, a] @ seen.G[np.ix_(at[a], at[o])]) * c[:, o]).sum(axis=1)
                 for o in range(3)] for a in range(3)]  # fmt: skip
        G = np.array(each).transpose(2, 0, 1)
        alone = [gains(b[:, a : a + 1], G[:, a : a + 1, a : a + 1]) for a in range(3)]
        alike = gains(b.sum(axis=1)[:, None], G.sum(axis=(1, 2))[:, None, None])
        out[first : first + TOGETHER] = np.stack([*alone, alike], axis=1)
    return out

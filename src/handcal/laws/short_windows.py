"""What errors of a sensor in short windows of time would do to a fit: one scan of a constant in
each window, beside which any course at all can be weighed, as the means that it has in them, for
the price of a product with a matrix. (A scan of a thousand courses takes as long as this one.)"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.estimate.columns import Ground
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.laws.drivers import COURSELESS, HEADING, LINE, Driver
from handcal.laws.grammar import curves, range_of
from handcal.laws.law_effect import AXES_OF, SENSORS, SIZE
from handcal.laws.weighing import Beside, beside, gains
from handcal.signals import some
from handcal.types import Array, IntArray

# How long a window is, s: as far apart as a held point is looked at; and windows at the most, with
# the square of which the work grows.
WINDOW, MOST_WINDOWS = 1.0 / 3.0, 450
# Courses are worked out so many times a second: in a hand, hardly anything is faster.
RATE = 40.0
# Constants of the laws over one kind of course that are handed on, at the most (a scan's work goes
# as these), and laws that differ in times and widths alone.
LIKELIEST, OF_A_KIND = 36, 2
# A signal that changes by less than this share of its size says of none how much it is felt.
CHANGING = 0.3
# Courses that are worked out and weighed at a time.
TOGETHER = 500


@dataclass(frozen=True, eq=False)
class Courses:
    """Drivers of one kind of law, with what a unit of each constant of it adds on each axis, as
    means in each window (d, a, c, K), in shares of a clearly visible error; roots (f, c, c): square
    roots of the prior covariance of the constants, of each of its forms."""

    drivers: Sequence[Driver]
    means: Array
    roots: Array


def fits_in(signals: Signals) -> bool:
    """Whether there are not too many windows."""
    return count_of(signals.t) <= MOST_WINDOWS


def count_of(t: Array, width: float = WINDOW) -> int:
    """How many windows of this width, s, there are in times t (n,)."""
    return max(1, math.floor(float(t[-1] - t[0]) / width))


def windows_of(t: Array, all_: Array, width: float = WINDOW) -> IntArray:
    """The window of each of some times t (n,) of all."""
    last = count_of(all_, width) - 1
    return np.asarray(np.minimum(((t - all_[0]) / width).astype(np.int64), last))


def courses_of(
    drivers: Sequence[Driver], signals: Signals, sensor: int = 0, width: float = WINDOW
) -> list[Courses]:
    """Those of them that have a course, for a sensor (either IMU sensor alike), each kind of law
    together, in windows of this width, s."""
    rate = len(signals.t) / max(float(signals.t[-1] - signals.t[0]), 1e-9)
    fewer = some(signals, np.arange(0, len(signals.t), max(1, round(rate / RATE)), dtype=np.int64))
    window = windows_of(fewer.t, signals.t, width)
    first = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    count = np.diff(np.r_[first, len(fewer.t)])
    axes = len(AXES_OF[sensor])

    def worked_out(chunk: Sequence[Driver]) -> list[tuple[Array, Array] | None]:
        out: list[tuple[Array, Array] | None] = []
        for driver in chunk:
            x, roots = _columns(driver, fewer, axes)
            if not (np.isfinite(x).all() and x.size):
                out.append(None)
                continue
            # (of a window without a reading there is no mean, and nothing depends on it)
            means: Array = np.zeros((*x.shape[:2], count_of(signals.t, width)))
            means[:, :, window[first]] = np.add.reduceat(x, first, axis=2) / count
            out.append((means, roots))
        return out

    chunks = [drivers[n : n + TOGETHER] for n in range(0, len(drivers), TOGETHER)]
    done = in_parallel(partial(worked_out, chunk) for chunk in chunks)
    alike: dict[tuple[int, bool], list[tuple[Driver, Array, Array]]] = {}
    for driver, end in zip(drivers, (end for part in done for end in part), strict=True):
        if end is not None:
            alike.setdefault((driver.knots, driver.round), []).append((driver, *end))
    return [
        Courses([d for d, _, _ in of], np.stack([m for _, m, _ in of]), of[0][2])
        for of in alike.values()
    ]


def _columns(driver: Driver, signals: Signals, axes: int) -> tuple[Array, Array]:
    """What a unit of each constant of a law over a driver adds on each axis (a, c, n), and the
    roots of its forms; nothing where it has no course."""
    x = np.stack([driver.course(signals, axis) for axis in range(axes)])
    nothing: Array = np.zeros((axes, 0, 0))
    if driver.knots == LINE:
        size = _rms(x)
        return (x[:, None] / size if size > COURSELESS else nothing), np.ones((1, 1, 1))
    scale = np.stack([driver.scale(signals, axis) for axis in range(axes)])
    size = _rms(scale)
    felt = driver.factor is None or _rms(scale - scale.mean()) > CHANGING * size > 0.0
    if not (felt and _rms(x) > COURSELESS):
        return nothing, nothing
    forms = curves(range_of(x, driver.signed), driver.knots, driver.round)
    features = np.stack([forms[0].values(row) for row in x])
    columns = (features * (scale / size)[:, :, None]).transpose(0, 2, 1)
    return columns, np.stack([f.root for f in forms if f.root is not None])


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x**2)))


def likeliest(
    model: Model,
    base: Sequence[Ground],
    known: Sequence[Effect],
    sensor: int,
    courses: Sequence[Courses],
) -> list[Driver]:
    """The drivers over which a law gains most about a model, of each kind of course, on one axis or
    alike on all of them, the best first."""
    if not courses:
        return []
    axes = AXES_OF[sensor]
    windows = [constants(sensor, axis, courses[0].means.shape[3]) for axis in axes]
    q = scan(model, windows, base, 1.0)
    seen = beside(q, known, windows)
    at = [seen.at[e.id] for e in windows]
    out: list[Driver] = []
    for of in courses:
        gain = gains_of(of, seen, at)
        kinds: dict[str, int] = {}
        room = LIKELIEST
        for n in np.argsort(-gain, kind="stable"):
            driver = of.drivers[n]
            kinds[driver.kind] = kinds.get(driver.kind, 0) + 1
            if room > 0 and kinds[driver.kind] <= OF_A_KIND:
                out.append(driver)
                room -= of.means.shape[2]
    return out


def constants(sensor: int, axis: int, count: int, width: float = WINDOW) -> Effect:
    """An error of a channel that is another constant in each of so many windows."""

    def columns(signals: Signals) -> Array:
        out = np.zeros((len(signals.t), count))
        out[np.arange(len(signals.t)), windows_of(signals.t, signals.t, width)] = 1.0
        return out

    return _added("windows", sensor, axis, count, columns)


def halves(sensor: int, axis: int, some: IntArray, width: float) -> Effect:
    """An error of a channel that changes its sign in the middle of each of some windows (k,)."""

    def columns(signals: Signals) -> Array:
        passed = (signals.t - signals.t[0]) / width
        there = np.floor(passed)[:, None] == some
        return np.asarray(there * np.where(passed % 1.0 < 0.5, 1.0, -1.0)[:, None])

    return _added("halves", sensor, axis, len(some), columns)


def _added(
    name: str, sensor: int, axis: int, count: int, columns: Callable[[Signals], Array]
) -> Effect:
    physics: dict[str, Any] = {"seen": {SENSORS[HEADING]: columns}}
    if sensor != HEADING:

        def features(signals: Signals) -> list[tuple[int, int, Array]]:
            return [(3 * sensor + axis, 0, columns(signals))]

        physics = {"imu_error": added(features), "features": features}
    return Effect(
        id=f"{name}: {sensor} {axis}", title="", story="", source="", motion="", validated="",
        parameters=tuple(Param(f"w{n}", "", SIZE[sensor]) for n in range(count)), **physics,
    )  # fmt: skip


def gains_of(of: Courses, seen: Beside, at: Sequence[IntArray]) -> Array:
    """Nats (d,) that a law over each driver gains, on an axis or on all of them alike."""
    axes = range(of.means.shape[1])
    G = {(a, o): seen.G[np.ix_(at[a], at[o])] for a in axes for o in axes[a:]}
    out = []
    for first in range(0, len(of.means), TOGETHER):
        c = of.means[first : first + TOGETHER]
        b = [c[:, a] @ seen.b[at[a]] for a in axes]
        # (all drivers as rows of one matrix: less is lost to many small products)
        flat = [c[:, a].reshape(-1, c.shape[3]) for a in axes]
        felt = {
            (a, o): (flat[a] @ G[a, o]).reshape(c[:, a].shape) @ c[:, o].transpose(0, 2, 1)
            for a, o in G
        }
        both = [x if a == o else x + x.transpose(0, 2, 1) for (a, o), x in felt.items()]
        ways = [*((b[a], felt[a, a]) for a in axes), (np.sum(b, axis=0), np.sum(both, axis=0))]
        ends = [
            gains(*way, np.broadcast_to(root, way[1].shape)) for way in ways for root in of.roots
        ]
        out.append(np.max(ends, axis=0))
    return np.concatenate(out)

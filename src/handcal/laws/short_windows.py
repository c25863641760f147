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
from handcal.estimate.columns import Ground, spread
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic, local
from handcal.laws.drivers import COURSELESS, HEADING, LINE, Driver
from handcal.laws.grammar import curves, range_of
from handcal.laws.law_effect import AXES_OF, SENSORS, SIZE
from handcal.laws.weighing import Beside, gains
from handcal.signals import some
from handcal.types import Array, IntArray

# How long a window is, s: as far apart as a held point is looked at; and windows at the most, with
# the square of which the work grows.
WINDOW, MOST_WINDOWS = 1.0 / 3.0, 450
# Where more is observed in between, windows may be as short as this, s.
FINEST = 0.1
# Courses are worked out so many times a second: in a hand, hardly anything is faster.
RATE = 40.0
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


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows that lie within epochs of a filter, or hold several whole ones. edges (K + 1,), s;
    first (E,): the window that each epoch begins in; within: how many there are in an epoch at the
    most; phase (K,): which of those in its epoch each is."""

    edges: Array
    first: IntArray
    within: int
    phase: IntArray

    def of(self, t: Array) -> IntArray:
        """The window of each time t (n,)."""
        at = np.searchsorted(self.edges, t, side="right") - 1
        return np.asarray(np.clip(at, 0, len(self.phase) - 1))


def windows_about(about: Ground) -> Windows:
    """Windows of the recording of which this is the ground."""
    t = about.linear.problem.nodes.t
    begin, end = t[about.windows[0]], t[about.windows[1]]
    often = max(FINEST, min(float(np.median(end - begin)), WINDOW))
    width = max(often, float(end[-1] - begin[0]) / MOST_WINDOWS)
    edges, first, phase = [float(begin[0])], list[int](), list[int]()
    room = 0.0
    for a, b in zip(begin, end, strict=True):
        many = max(1, round((b - a) / width))
        if many == 1 and b - a < 1.01 * room:  # (in the window of the epoch before)
            first.append(len(phase) - 1)
            edges[-1] = float(b)
        else:
            first.append(len(phase))
            phase += range(many)
            edges += np.linspace(a, b, many + 1)[1:].tolist()
            room = width if many == 1 else 0.0
        room -= b - a
    return Windows(np.array(edges), np.array(first), max(phase) + 1, np.array(phase))


def looked_at(model: Model, about: Ground, windows: Windows, sensor: int) -> Quadratic:
    """The quadratic of a model's effects and of a constant in each window on each axis of a sensor,
    whose names are those of ``constants``."""
    axes, count = AXES_OF[sensor], len(windows.phase)
    pattern = [_phases(sensor, axis, windows) for axis in axes]
    own = windows.first[:, None] + np.arange(windows.within)
    own = np.minimum(own, count - 1)
    place = np.hstack([own + count * n for n in range(len(axes))])
    every = [constants(sensor, axis, count) for axis in axes]
    done = spread(about, pattern, every, place)
    return local(done, frozenset([*model.ids, *(e.id for e in every)])).quadratic


def means(e: Effect, sensor: int, signals: Signals, window: IntArray, count: int) -> Array:
    """What each parameter of an effect adds to a sensor's windows, (axes * count, k), in units of
    its prior and of theirs. window (m,): of each sample."""
    axes = AXES_OF[sensor]
    out = np.zeros((len(axes), count, len(e.parameters)))
    first = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    many = np.diff(np.r_[first, len(window)])[:, None]
    features = (
        [(0, 0, e.seen[SENSORS[HEADING]](signals))]
        if sensor == HEADING
        else [
            (c - 3 * sensor, k, x)
            for c, k, x in (e.features or (lambda _: []))(signals)
            if c // 3 == sensor
        ]
    )
    for axis, k, x in features:
        out[axis, window[first], k : k + x.shape[1]] += np.add.reduceat(x, first) / many
    return out.reshape(-1, len(e.parameters)) * e.prior_sigma / SIZE[sensor]


def _phases(sensor: int, axis: int, windows: Windows) -> Effect:
    """An error of a channel that is another constant in each phase of an epoch."""

    def columns(signals: Signals) -> Array:
        out = np.zeros((len(signals.t), windows.within))
        out[np.arange(len(signals.t)), windows.phase[windows.of(signals.t)]] = 1.0
        return out

    return _added("phases", sensor, axis, windows.within, columns)


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
    drivers: Sequence[Driver],
    signals: Signals,
    sensor: int,
    count: int,
    windows: Callable[[Array], IntArray],
) -> list[Courses]:
    """Those of them that have a course, for a sensor (either IMU sensor alike), each kind of law
    together, in so many windows; windows: which one a time t (n,) is in."""
    rate = len(signals.t) / max(float(signals.t[-1] - signals.t[0]), 1e-9)
    fewer = some(signals, np.arange(0, len(signals.t), max(1, round(rate / RATE)), dtype=np.int64))
    window = windows(fewer.t)
    first = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    many = np.diff(np.r_[first, len(fewer.t)])
    axes = len(AXES_OF[sensor])

    def worked_out(chunk: Sequence[Driver]) -> list[tuple[Array, Array] | None]:
        out: list[tuple[Array, Array] | None] = []
        for driver in chunk:
            x, roots = _columns(driver, fewer, axes)
            if not (np.isfinite(x).all() and x.size):
                out.append(None)
                continue
            # (of a window without a reading there is no mean, and nothing depends on it)
            means: Array = np.zeros((*x.shape[:2], count))
            means[:, :, window[first]] = np.add.reduceat(x, first, axis=2) / many
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
    """Nats (d,) that a law over each driver gains, on an axis, on all of them alike, or on each its
    own (beside which the others change little)."""
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
        ends = np.stack(
            [
                [gains(*way, np.broadcast_to(root, way[1].shape)) for root in of.roots]
                for way in ways
            ]
        ).max(axis=1)
        each = np.maximum(ends[: len(axes)], 0.0).sum(axis=0)
        out.append(np.maximum(ends.max(axis=0), each))
    return np.concatenate(out)

"""Constant errors of a sensor in short time windows, scanned once about a fit.

Any course over time can then be evaluated by its means in the windows, at the cost of one product
with a matrix. (A scan of a thousand courses would take as long as this one.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._linear import added
from handcal.estimate.columns import Ground, Wider, spread
from handcal.estimate.forked import in_parallel
from handcal.estimate.quadratic import Quadratic, local
from handcal.laws.drivers import COURSELESS, HEADING, LINE, Driver
from handcal.laws.grammar import curves, range_of
from handcal.laws.law_effect import AXES_OF, SENSORS, SIZE
from handcal.laws.weighing import Beside, gains
from handcal.model_score import MOST_WINDOWS, WINDOW
from handcal.signals import some
from handcal.types import Array, IntArray

# Sampling rate of courses, Hz: a hand has hardly anything faster.
RATE = 40.0
# Relative variation of a signal from which the effect of its size can be told from a constant.
CHANGING = 0.3
# Courses that are computed and evaluated at a time.
TOGETHER = 500
# Drivers of these of which a law of its own on each axis is evaluated exactly.
EXACT = 20


@dataclass(frozen=True, eq=False)
class Courses:
    """Courses of the drivers of one kind of law.

    means (d, a, c, K): of driver d, the error on axis a per unit of constant c, averaged in window
    K, in shares of a clearly visible error. roots (f, c, c): square roots of the prior covariance
    of the constants, one for each form of the law.
    """

    drivers: Sequence[Driver]
    means: Array
    roots: Array


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one or several epochs each. edges (K + 1,), s; first (E,): the window in which
    each epoch lies."""

    edges: Array
    first: IntArray

    @property
    def count(self) -> int:
        return len(self.edges) - 1

    def of(self, t: Array) -> IntArray:
        """The window of each time t (n,)."""
        at = np.searchsorted(self.edges, t, side="right") - 1
        return np.asarray(np.clip(at, 0, self.count - 1))


def windows_about(about: Ground) -> Windows:
    """Windows of a recording from its ground; longer than ``WINDOW`` in a long one."""
    t = about.linear.problem.nodes.t
    begin, end = t[about.windows[0]], t[about.windows[1]]
    width = max(WINDOW, float(end[-1] - begin[0]) / MOST_WINDOWS)
    edges, first, room = [float(begin[0])], list[int](), 0.0
    for a, b in zip(begin, end, strict=True):
        if b - a < 1.01 * room:  # (in the window of the epoch before)
            edges[-1] = float(b)
        else:
            edges.append(float(b))
            room = width
        first.append(len(edges) - 2)
        room -= b - a
    return Windows(np.array(edges), np.array(first))


def looked_at(
    ids: Iterable[str],
    about: Ground,
    windows: Windows,
    sensors: Iterable[int],
    beside: Wider | None = None,
) -> Quadratic:
    """The quadratic of these effects and of a constant in each window on each axis of the sensors,
    named as in ``constants``; beside: the pass with further effects."""
    channels = [(sensor, axis) for sensor in sensors for axis in AXES_OF[sensor]]
    count = windows.count
    pattern = [constants(*channel, 1) for channel in channels]
    every = [constants(*channel, count) for channel in channels]
    done = spread(about, pattern, every, windows.first, beside)
    return local(done, frozenset([*ids, *(e.id for e in every)])).quadratic


def means(e: Effect, sensor: int, signals: Signals, window: IntArray, count: int) -> Array:
    """Mean error (axes * count, k) in a sensor's windows for each parameter of an effect, both in
    units of their priors. window (m,): window of each sample."""
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


def fits_in(signals: Signals) -> bool:
    """Whether a recording has ``MOST_WINDOWS`` or fewer of ``WINDOW``."""
    return float(signals.t[-1] - signals.t[0]) < WINDOW * (MOST_WINDOWS + 1)


def seldom(signals: Signals) -> Signals:
    """Signals no oftener than ``RATE``."""
    rate = len(signals.t) / max(float(signals.t[-1] - signals.t[0]), 1e-9)
    return some(signals, np.arange(0, len(signals.t), max(1, round(rate / RATE)), dtype=np.int64))


def courses_of(
    drivers: Sequence[Driver],
    signals: Signals,
    sensor: int,
    count: int,
    windows: Callable[[Array], IntArray],
) -> list[Courses]:
    """Courses of the drivers that vary in this recording, grouped by kind of law.

    sensor: sets the number of axes, the same for both IMU sensors. count: of windows. windows: maps
    times (n,) to their windows.
    """
    fewer = seldom(signals)
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
            # (a window without a reading stays zero)
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
    """The error (a, c, n) on each axis per unit of each constant of a law over a driver, and the
    roots of its forms. Both are empty if the driver does not vary."""
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


def constants(sensor: int, axis: int, count: int) -> Effect:
    """An error of a channel with ``count`` constants, each the error while it acts."""

    def columns(signals: Signals) -> Array:
        return np.ones((len(signals.t), count))

    return _added("windows", sensor, axis, count, columns)


def halves(sensor: int, axis: int, some: IntArray, windows: Windows) -> Effect:
    """An error of a channel that changes sign in the middle of each of these windows (k,)."""

    def columns(signals: Signals) -> Array:
        own = windows.of(signals.t)
        first = signals.t < 0.5 * (windows.edges[own] + windows.edges[own + 1])
        return np.asarray((own[:, None] == some) * np.where(first, 1.0, -1.0)[:, None])

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


def gains_of(of: Courses, seen: Beside) -> Array:
    """Gain (d,) of a law over each driver, nats: the best of one axis alone, one law for all axes,
    and a law of its own on each axis (for the ``EXACT`` drivers of the largest sums over axes)."""
    axes, at = range(of.means.shape[1]), list(seen.at.values())
    G = {(a, o): seen.G[np.ix_(at[a], at[o])] for a in axes for o in axes[a:]}
    out = []
    for first in range(0, len(of.means), TOGETHER):
        c = of.means[first : first + TOGETHER]
        b = [c[:, a] @ seen.b[at[a]] for a in axes]
        # (all drivers as rows of one matrix, which is faster than many small products)
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
        best = ends.max(axis=0)
        likely = np.argsort(-np.maximum(ends[: len(axes)], 0.0).sum(axis=0))[:EXACT]
        best[likely] = np.maximum(best[likely], _each(b, felt, of.roots, likely))
        out.append(best)
    return np.concatenate(out)


def _each(
    b: Sequence[Array], G: Mapping[tuple[int, int], Array], roots: Array, some: IntArray
) -> Array:
    """Gain of a law of its own on each axis, over some of the drivers; b (d, c) by axis, and G
    (d, c, c) by pair of axes."""
    axes = range(len(b))
    whole = np.block(
        [[(G[a, o] if a <= o else G[o, a].transpose(0, 2, 1))[some] for o in axes] for a in axes]
    )
    apart = [np.kron(np.eye(len(axes)), root) for root in roots]
    every = np.concatenate([x[some] for x in b], axis=1)
    found = [gains(every, whole, np.broadcast_to(root, whole.shape)) for root in apart]
    return np.asarray(np.max(found, axis=0))

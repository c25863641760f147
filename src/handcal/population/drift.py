"""How an error changes from one recording of a device to the next: what differs at every switching
on, what wanders with age, what goes with temperature, and steps (a knock, an update).

Of each device the recordings' values are normal about the device's own mean, which is unknown
(restricted likelihood; Patterson & Thompson, Biometrika 58, 1971): their own sigmas, a turn-on of
one size for all devices, a random walk in time, and a slope by temperature, common to all and of
each device. The sizes maximise the product over devices; one that the likelihood does not ask for
is zero. A step is one offset more from a recording on, found by its evidence against as many
chances as there were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from handcal.population.deconvolved import SURE
from handcal.types import Array, BoolArray, IntArray

# Recordings of devices seen more than once, below which nothing is told of change.
LEAST = 4
# Steps of one parameter that are looked for, the clearest first.
MOST_STEPS = 20
# Part of the devices, those that scatter most, without which sizes are found first: one with a step
# would hide it in a turn-on that is too large.
ASIDE = 0.15
# Sizes at which the search begins, as parts of the scatter, and below which nothing is left of one.
BEGIN, NOTHING = 0.5, 1e-3
# Recordings of one device, spread over all of its time: a matrix of so many rows for each device.
MOST = 40
DAY_S = 86400.0
MONTH = 30.0  # days, over which ageing is told


@dataclass(frozen=True)
class Step:
    """A device's parameter before and after a recording: who, the index of the recording from which
    on it holds, size and sigma (SI), and its probability."""

    who: str
    index: int
    size: float
    sigma: float
    probability: float


@dataclass(frozen=True)
class Drift:
    """count: recordings of devices seen more than once; days: the longest time between two of one;
    turn_on, a standard deviation; ageing, that of a month; slope by temperature and its sigma, per
    K (nan where temperatures are not known or alike), and by how much devices differ in it; shares:
    of the variance within devices that each makes, beside what sigmas allow: "turn_on", "ageing",
    "temperature", "step"; steps, the clearest first. SI."""

    count: int
    days: float
    turn_on: float
    ageing: float
    slope: float
    slope_sigma: float
    slope_spread: float
    shares: dict[str, float]
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class _Devices:
    """d devices with up to n recordings: y, variance, time (days from the device's first) and
    temperature (from the mean of all; zero where not known), (d, n); there (d, n); columns
    (d, n, c): offsets that are free, besides the mean; index (d, n): of the recordings."""

    y: Array
    variance: Array
    time: Array
    warm: Array
    there: BoolArray
    columns: Array
    index: IntArray


def drift(
    value: Array, sigma: Array, owner: IntArray, started: Array, temperature: Array, usual: float,
    names: Sequence[str], trials: int = 1,
) -> Drift | None:  # fmt: skip
    """Of recordings' values (n,) with sigmas (n,), of devices owner (n,), begun at ``started`` (n,)
    s since 1970 (nan: not known), at ``temperature`` (n,) degC (nan). usual: the catalogue's
    size; names (n,): of the recordings' devices; trials: parameters that are looked at. None where
    too few devices were seen twice."""
    d = _gathered(value, sigma, owner, started, temperature)
    if d is None:
        return None
    sizes = _sizes(_without_wildest(d))
    steps: list[Step] = []
    chances = int(d.there.sum() - len(d.y)) * trials
    while len(steps) < MOST_STEPS:
        first = _clearest(d, sizes, usual, chances, names)
        if first is None:
            break
        beside = _with_step(d, first.index)
        sizes = _sizes(beside)
        # (once more, with sizes that have all the others in them)
        step = _clearest(d, sizes, usual, chances, names)
        if step is None or step.index != first.index:
            break
        steps.append(step)
        d = beside
    sizes = _sizes(d)
    slope, slope_sigma = _slope(d, sizes)
    scale = _temperature_scale(d)
    # (a slope makes a part where the likelihood asks for it, as for the others)
    asked = 0.5 * (slope / slope_sigma) ** 2 > SURE
    shares = _shares(d, sizes, slope if asked else 0.0, steps)
    turn_on, walk, spread = sizes * np.array([1.0, math.sqrt(MONTH), 1.0])
    none = math.nan if scale == 0.0 else 1.0
    return Drift(int(d.there.sum()), float(d.time.max()), float(turn_on), float(walk),
                 slope * none, slope_sigma * none, float(spread) * none, shares,
                 tuple(sorted(steps, key=lambda s: -abs(s.size) / s.sigma)))  # fmt: skip


def _gathered(
    value: Array, sigma: Array, owner: IntArray, started: Array, temperature: Array
) -> _Devices | None:
    """Devices seen more than once at known times, in the order of time."""
    good = np.isfinite(value) & np.isfinite(sigma) & np.isfinite(started)
    groups = [np.flatnonzero(good & (owner == o)) for o in np.unique(owner[good])]
    groups = [g[np.argsort(started[g], kind="stable")] for g in groups if len(g) > 1]
    groups = [g[thin(len(g), MOST)] for g in groups]
    if sum(len(g) - 1 for g in groups) < LEAST:
        return None
    n = max(map(len, groups))
    index = np.full((len(groups), n), -1, dtype=np.int64)
    for row, g in zip(index, groups, strict=True):
        row[: len(g)] = g
    there: BoolArray = index >= 0
    y, s, t = (np.where(there, x[index], 0.0) for x in (value, sigma, started))
    known = there & np.isfinite(temperature[index])
    middle = float(temperature[index][known].mean()) if known.any() else 0.0
    # (a device of which only some temperatures are known is one of which none is)
    whole = (known == there).all(axis=1, keepdims=True)
    warm = np.where(known & whole, temperature[index] - middle, 0.0)
    days = np.where(there, (t - t[:, :1]) / DAY_S, 0.0)
    return _Devices(y, s**2, days, warm, there, np.zeros((*y.shape, 0)), index)


def thin(count: int, most: int) -> IntArray:
    """Indices of at most so many of ``count``, evenly spread, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def _without_wildest(d: _Devices) -> _Devices:
    """Without the devices that scatter most about their own means."""
    if len(d.y) < 3:
        return d
    w = d.there / np.where(d.there, d.variance, 1.0)
    mean = (w * d.y).sum(1) / w.sum(1)
    scatter = (np.where(d.there, d.y - mean[:, None], 0.0) ** 2).sum(1) / (d.there.sum(1) - 1)
    keep = np.argsort(scatter, kind="stable")[: max(2, math.ceil((1.0 - ASIDE) * len(d.y)))]
    keep = np.sort(keep)
    return _Devices(*(getattr(d, f.name)[keep] for f in fields(d)))


def _temperature_scale(d: _Devices) -> float:
    """Standard deviation of the temperature within devices, K."""
    means = (d.warm * d.there).sum(1, keepdims=True) / d.there.sum(1, keepdims=True)
    off = np.where(d.there, d.warm - means, 0.0)
    scale = math.sqrt(float((off**2).sum() / max(1, d.there.sum() - len(d.y))))
    return scale if scale > 0.1 else 0.0  # (what thermometers of phones round to)


def _shapes(d: _Devices) -> tuple[Array, Array, Array]:
    """Covariances (d, n, n) that a turn-on, a walk and slopes of size one make."""
    both = d.there[:, :, None] & d.there[:, None, :]
    first = np.minimum(d.time[:, :, None], d.time[:, None, :])
    warm = d.warm[:, :, None] * d.warm[:, None, :]
    return np.eye(d.y.shape[1]) * both, first * both, warm * both


def _covariance(d: _Devices, sizes: Array) -> Array:
    """(d, n, n) of the recordings of each device; 1 on the diagonal where there is none."""
    made = sum(size**2 * C for size, C in zip(sizes, _shapes(d), strict=True))
    own = np.where(d.there, d.variance, 1.0)
    return np.asarray(made + np.eye(d.y.shape[1]) * own[:, :, None])


def _projected(d: _Devices, sizes: Array) -> tuple[Array, float]:
    """P (d, n, n), which weighs what is left beside the free means and offsets, and the logs of
    determinants of the restricted likelihood, summed."""
    L = np.linalg.cholesky(_covariance(d, sizes))
    X = np.concatenate([d.there[:, :, None].astype(float), d.columns], axis=2)
    W = np.linalg.solve(L, np.broadcast_to(np.eye(L.shape[1]), L.shape))  # (whitens)
    Z = W @ X
    # (an offset of one device is a column of zeros for the others)
    used = (np.abs(X) > 0.0).any(axis=1)
    A = np.swapaxes(Z, 1, 2) @ Z + np.eye(X.shape[2]) * ~used[:, :, None]
    B = np.linalg.solve(A, np.swapaxes(Z, 1, 2))
    P = np.swapaxes(W, 1, 2) @ (np.eye(L.shape[1]) - Z @ B) @ W
    logs = 2.0 * np.log(np.einsum("dii->di", L)).sum() + np.linalg.slogdet(A)[1].sum()
    return np.where(d.there[:, :, None] & d.there[:, None, :], P, 0.0), float(logs)


def _log_likelihood(d: _Devices, sizes: Array, by_temperature: bool) -> float:
    """Restricted, up to a constant; the common slope at its best, for which one unit of information
    is paid (a prior as wide as one device's recordings tell it)."""
    P, logs = _projected(d, sizes)
    Py = np.einsum("dij,dj->di", P, d.y)
    square = float((d.y * Py).sum())
    if by_temperature:
        c, G = float((d.warm * Py).sum()), float(np.einsum("di,dij,dj->", d.warm, P, d.warm))
        if G > 0.0:
            square -= c * c / G * len(d.y) / (len(d.y) + 1.0)
            logs += math.log(len(d.y) + 1.0)
    return -0.5 * (logs + square)


def _sizes(d: _Devices) -> Array:
    """turn_on, walk (per square root of a day) and spread of slopes (per K): at the best of the
    likelihood, those that it does not ask for at zero."""
    scale = _temperature_scale(d)
    units = _units(d)
    may = [True, bool((d.time > 0.0).any()), scale > 0.0 and d.there.sum(1).max() > 2]
    free = [k for k in range(3) if may[k]]
    best, log = _best(d, free, units, scale > 0.0)
    while free:
        tried = [(k, *_best(d, [j for j in free if j != k], units, scale > 0.0)) for k in free]
        k, sizes, fewer = max(tried, key=lambda t: t[2])
        if fewer < log - SURE:
            break
        free, best, log = [j for j in free if j != k], sizes, fewer
    return best


def _units(d: _Devices) -> Array:
    """Of turn_on, walk and slopes: what would make all of the scatter by itself."""
    n = d.there.sum(1)
    mean = d.y.sum(1) / n
    off = np.where(d.there, d.y - mean[:, None], 0.0)
    scatter = math.sqrt(float((off**2).sum() / max(1, n.sum() - len(n))))
    scatter = max(scatter, math.sqrt(float(d.variance[d.there].min())))
    time = max(float(np.median(d.time[d.there & (d.time > 0.0)])), 1e-6) if d.time.any() else 1.0
    return scatter * np.array([1.0, time**-0.5, 1.0 / (_temperature_scale(d) or 1.0)])


def _best(
    d: _Devices, free: Sequence[int], units: Array, by_temperature: bool
) -> tuple[Array, float]:
    """The sizes (3,) of those that are free, and the log-likelihood."""
    from scipy.optimize import minimize

    def cost(x: Array) -> float:
        sizes = np.zeros(3)
        sizes[list(free)] = np.abs(x) * units[list(free)]
        return -_log_likelihood(d, sizes, by_temperature)

    if not free:
        return np.zeros(3), -cost(np.zeros(0))
    begin = np.full(len(free), BEGIN / math.sqrt(len(free)))
    found = minimize(cost, begin, method="Nelder-Mead",
                     options={"xatol": NOTHING, "fatol": 1e-3, "maxiter": 200})  # fmt: skip
    sizes = np.zeros(3)
    sizes[list(free)] = np.abs(found.x) * units[list(free)]
    return sizes, -float(found.fun)


def _slope(d: _Devices, sizes: Array) -> tuple[float, float]:
    """Common slope by temperature and its sigma."""
    P, _ = _projected(d, sizes)
    G = float(np.einsum("di,dij,dj->", d.warm, P, d.warm))
    if G <= 0.0:
        return 0.0, math.inf
    return float(np.einsum("di,dij,dj->", d.warm, P, d.y)) / G, G**-0.5


def _clearest(
    d: _Devices, sizes: Array, usual: float, chances: int, names: Sequence[str]
) -> Step | None:
    """The step that has the most evidence, as large as is usual of the error; None where none is
    more probable than not, of so many places where one could be."""
    P, _ = _projected(d, sizes)
    slope, _ = _slope(d, sizes)
    y = d.y - slope * d.warm
    n = d.y.shape[1]
    h = np.triu(np.ones((n, n)))[None] * d.there[:, None, :]  # (row k: from recording k on)
    hP = h @ P
    b, G = np.einsum("dkj,dj->dk", hP, y), np.einsum("dkj,dkj->dk", hP, h)
    free = d.there & (np.arange(n) > 0) & (G > 0.0)
    free &= G * usual**2 > NOTHING
    gain = np.where(
        free,
        0.5 * (b**2 / (G + usual**-2.0) - np.log1p(usual**2 * np.where(free, G, 0.0))),
        -np.inf,
    )
    i, k = np.unravel_index(int(np.argmax(gain)), gain.shape)
    odds = float(gain[i, k]) - math.log(max(1, chances))
    probability = 1.0 / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
    if probability <= 0.5:
        return None
    at = int(d.index[i, k])
    return Step(names[at], at, float(b[i, k] / G[i, k]), float(G[i, k] ** -0.5), probability)


def _with_step(d: _Devices, index: int) -> _Devices:
    """With a free offset from this recording on."""
    ((i, k),) = np.argwhere(d.index == index)
    column = np.zeros((*d.y.shape, 1))
    column[i, k:, 0] = d.there[i, k:]
    return replace(d, columns=np.concatenate([d.columns, column], axis=2))


def _shares(d: _Devices, sizes: Array, slope: float, steps: Sequence[Step]) -> dict[str, float]:
    """Of the variance within devices, without what sigmas allow, the part that each makes; steps:
    in the order of the columns."""
    n = d.there.sum(1)
    centre = d.there[:, :, None] * (np.eye(d.y.shape[1]) - d.there[:, None, :] / n[:, None, None])

    def within(C: Array) -> float:
        return float(np.einsum("dij,djk,dik->", centre, C, centre))

    turn_on, walk, slopes = map(within, _shapes(d))
    offset = d.columns @ np.array([s.size for s in steps])
    parts = {
        "turn_on": sizes[0] ** 2 * turn_on,
        "ageing": sizes[1] ** 2 * walk,
        "temperature": (sizes[2] ** 2 + slope**2) * slopes,
        "step": within(offset[:, :, None] * offset[:, None, :]),
    }
    whole = sum(parts.values())
    return {k: float(v / whole) if whole > 0.0 else 0.0 for k, v in parts.items()}

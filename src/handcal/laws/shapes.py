"""Physics without a name that no product of signals gives: a course over time, or over
the direction of the heading.

A channel is given a cubic spline, whose coefficients one pass of the filter judges
all at once. A course (a passing bump, a while, a swing, a lobe in one direction) is then a
vector of coefficients, so that thousands of them, and every place between, cost no further pass.
The best becomes an effect of one parameter like any other term.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from handcal.compiled.jit import njit, residual_function
from handcal.effects import TIME, Effect, Param, Signals
from handcal.estimate.quadratic import Quadratic
from handcal.laws.courses import COURSES, MOST, OVER_TIME, OVER_YAW, Family
from handcal.laws.grammar import FREEDOM
from handcal.laws.law_effect import CHANNELS, SIZE, UNITS
from handcal.laws.terms import CURVES, DIRECTIONS, HEADING_SIZE, cubic, term
from handcal.types import Array, IntArray

# A course that is short stands out further than one that lasts, of the same mean square.
PEAK = 3.0
# Times that what comes again is looked for at the most, beginnings of it, of the best; and families
# looked at more closely.
AGAIN, BEGINNINGS, CLOSER = 5, 12, 3
# Courses of more numbers are adjusted along their slopes, which differences over these shares of
# the grid's spacing tell, to so many nats. (A simplex asked twice as often, and of 115 courses
# ended more than a nat lower with 31 and higher with 12; with few numbers it is the better.)
FEW_NUMBERS, STEPS, NEARLY = 3, (0.1, 0.003), 1e-3
# Numbers of a course that the odds of any law without a name pay for.
NUMBERS = 2
# What lies between two sizes on trial is that much larger or smaller than one of them.
ABOUT = math.sqrt(2.0)


@dataclass(frozen=True)
class Basis:
    """A cubic spline over a grid (n,) of time, s, or of direction, rad, as one effect of m
    parameters, which are ``through @ values`` (m, n) for values on the grid."""

    effect: Effect
    channel: str
    unit: str
    grid: Array
    through: Array
    families: tuple[Family, ...]


@njit
def _spline(t: Array, spacing: float, k: Array) -> Array:
    """The cubic spline of the coefficients k at the times t (n,)."""
    out = np.empty(len(t))
    for j in range(len(t)):
        x = t[j] / spacing
        i = int(x)
        out[j] = cubic(x - i, k[i], k[i + 1], k[i + 2], k[i + 3])
    return out


@njit
def _spline_columns(t: Array, spacing: float, count: int) -> Array:
    """Each of the cubic splines at the times t: (n, count)."""
    out = np.zeros((len(t), count))
    for j in range(len(t)):
        x = t[j] / spacing
        i = int(x)
        u = x - i
        out[j, i] = cubic(u, 1.0, 0.0, 0.0, 0.0)
        out[j, i + 1] = cubic(u, 0.0, 1.0, 0.0, 0.0)
        out[j, i + 2] = cubic(u, 0.0, 0.0, 1.0, 0.0)
        out[j, i + 3] = cubic(u, 0.0, 0.0, 0.0, 1.0)
    return out


def _spline_over_time(spacing: float) -> Callable[..., int]:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        x = z[TIME] / spacing
        i = int(x)
        r[0] -= cubic(x - i, k[i], k[i + 1], k[i + 2], k[i + 3])
        return 0

    return heading


_OVER_TIME = {2.0**e: residual_function(_spline_over_time(2.0**e)) for e in range(-5, 12)}


def imu_basis(channel: int, duration: float) -> Basis:
    """Splines over time for one channel of the IMU (0 to 5)."""
    grid = _grid(duration)

    def error(k: Array, signals: Signals) -> Array:
        out = np.zeros((len(signals.t), 6))
        out[:, channel] = _spline(signals.t - signals.t[0], grid[1], k)
        return out

    def features(truth: Signals) -> list[tuple[int, int, Array]]:
        t = truth.t - truth.t[0]
        return [(channel, 0, _spline_columns(t, float(grid[1]), len(grid) + 2))]

    own = channel // 3
    effect = _splines(f"{CHANNELS[channel]} over time", UNITS[own], SIZE[own], len(grid) + 2, error)
    effect = replace(effect, features=features)
    return Basis(effect, CHANNELS[channel], UNITS[own], grid, _natural(len(grid)), OVER_TIME)


def heading_bases(duration: float) -> list[Basis]:
    """Splines for the heading: over time, and over its direction."""
    grid = _grid(duration)
    address, count = _OVER_TIME[float(grid[1])], len(grid) + 2
    over = _splines("heading over time", "rad", HEADING_SIZE, count, None, address)
    round_ = _splines("heading over yaw", "rad", HEADING_SIZE, DIRECTIONS, None, CURVES["yaw"][0])
    yaw = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    return [
        Basis(over, "heading", "rad", grid, _natural(len(grid)), OVER_TIME),
        Basis(round_, "heading", "rad", yaw, _periodic(DIRECTIONS), OVER_YAW),
    ]


def _grid(duration: float) -> Array:
    spacing = 2.0 ** math.ceil(math.log2(max(duration, 1.0) / MOST))
    return np.asarray(spacing * np.arange(math.floor(duration / spacing) + 2))


def _natural(n: int) -> Array:
    """Coefficients (n + 2, n) of the cubic spline through n values, straight at both ends."""
    rows = np.zeros((n + 2, n + 2))
    for i in range(n):
        rows[i + 1, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    rows[0, :3] = rows[-1, -3:] = [1.0, -2.0, 1.0]
    return np.asarray(np.linalg.solve(rows, np.eye(n + 2)[:, 1:-1]))


def _periodic(n: int) -> Array:
    """Coefficients (n, n) of the periodic cubic spline through n values."""
    one = np.eye(n)
    rows = (4.0 * one + np.roll(one, 1, axis=1) + np.roll(one, -1, axis=1)) / 6.0
    return np.asarray(np.linalg.solve(rows, one))


def _splines(
    title: str,
    unit: str,
    size: float,
    count: int,
    error: Callable[[Array, Signals], Array] | None,
    address: int | None = None,
) -> Effect:
    return Effect(
        id=f"basis: {title}",
        title=title,
        parameters=tuple(Param(f"k{i}", unit, PEAK * size) for i in range(count)),
        story="Coefficients of a spline.",
        source="found in this recording",
        motion="Any.",
        validated="never reported",
        imu_error=error,
        observation_error={} if address is None else {"heading": address},
    )


def closest(
    basis: Basis, wide: Quadratic, known: IntArray, root: Array | None = None
) -> list[tuple[Effect, float]]:
    """The courses of several families that gain most beside the parameters ``known`` of a quadratic
    that holds the basis, each as an effect of one parameter; and the nats that it gains, less what
    its freedom costs: the best one first.

    root: square root of the prior covariance of the known ones (None: the identity). The gain is
    -inf where float64 holds that of none.
    """
    mine = np.array([i for i, n in enumerate(wide.names) if n[0] == basis.effect.id])
    b, G = integrated(wide, mine, known, root)
    span = 2.0 * np.pi if basis.families is OVER_YAW else float(basis.grid[-1])
    # (of values on the grid)
    b, G = basis.through.T @ b, basis.through.T @ G @ basis.through

    def gain(values: Array) -> Array:
        return _gained(values @ b, values @ G @ values)

    ends: list[tuple[float, Family, Array, Array]] = []
    for family in basis.families:
        starts, values = _tried(family, span, tuple(basis.grid))
        at, begun = _repeated(family, starts, values @ b, values @ G, values)
        ends.append((begun, family, at, starts))
    ends = sorted(ends, key=lambda end: -end[0])[:CLOSER]
    # (between the moments of the grid one course may do what two do on it)
    ends += [
        (begun, family, at[: starts.shape[1]], starts)
        for begun, family, at, starts in ends
        if len(at) > starts.shape[1]
    ]
    found: list[tuple[float, Family, Array]] = []
    for begun, family, numbers, starts in ends:
        lost = partial(_lost, family, basis.grid, gain)
        at = _adjusted(lost, numbers, starts, float(basis.grid[1] - basis.grid[0]))
        value = -lost(at) - FREEDOM - _cost(at) if begun > -math.inf else begun
        found.append((value, family, at))
    best: dict[str, tuple[float, Family, Array]] = {}
    for value, family, at in sorted(found, key=lambda end: -end[0]):
        best.setdefault(family.name, (value, family, at))
    return [(term_of(basis, family, numbers), value) for value, family, numbers in best.values()]


def _gained(linear: Array, information: Array) -> Array:
    """Nats that courses of height one gain, each under its prior; -inf where float64 holds no
    number of it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        nats = 0.5 * linear**2 / (1.0 + information) - 0.5 * np.log1p(information)
    # (information far below none: the difference of two that are nearly all there is, as
    # after a gap of a minute; such a course is no candidate)
    return np.where(information > -1.0, nats, -math.inf)


def _repeated(
    family: Family, starts: Array, linear: Array, through: Array, values: Array
) -> tuple[Array, float]:
    """Numbers of the course of a family that gains most, come again as often as that gains more
    than its moments cost, and that gain; linear (m,), through (m, n): of values (m, n) on
    the grid by what a scan says."""
    own = (through * values).sum(axis=1)
    gained = _gained(linear, own)
    k = int(np.argmax(gained))
    if family.again is None:
        return starts[k], float(gained[k])
    ends = []
    order = np.argsort(-gained)
    alike = np.unique(starts[order][:, family.moment :], axis=0, return_index=True)[1]
    for k in {*order[:BEGINNINGS].tolist(), *order[alike].tolist()}:
        numbers, value, course = starts[k], float(gained[k]), values[k]
        b, G = float(linear[k]), float(own[k])
        for _ in range(AGAIN):
            more = _gained(b + linear, G + own + 2.0 * through @ course)
            more = np.where(family.again(numbers, starts), more, -math.inf)
            j = int(np.argmax(more))
            if more[j] < value + FREEDOM * family.moment:
                break
            b, G = b + float(linear[j]), float(G + own[j] + 2.0 * through[j] @ course)
            numbers, course = np.append(numbers, starts[j, : family.moment]), course + values[j]
            value = float(more[j])
        ends.append((numbers, value - _cost(numbers)))
    return max(ends, key=lambda end: end[1])


def _cost(numbers: Array) -> float:
    """Nats that the numbers cost of a course that has more than most."""
    return FREEDOM * max(0, len(numbers) - NUMBERS)


@lru_cache(maxsize=16)
def _tried(family: Family, span: float, grid: tuple[float, ...]) -> tuple[Array, Array]:
    """Numbers (m, p) from which to begin, and those courses over the grid (m, n)."""
    starts = np.array(list(family.starts(span)))
    return starts, np.array([family.values(n, np.array(grid)) for n in starts])


def _lost(family: Family, grid: Array, gain: Callable[[Array], Array], numbers: Array) -> float:
    with np.errstate(all="ignore"):
        value = -float(gain(family.values(numbers, grid)))
    return value if math.isfinite(value) else 0.0


def _adjusted(
    lost: Callable[[Array], float], numbers: Array, tried: Array, spacing: float
) -> Array:
    """The numbers near these where least is lost, sizes within those that were tried (k, n): a lobe
    that is wide enough is a sine, which has a name. spacing: of the grid."""
    ends = zip(tried.min(axis=0), tried.max(axis=0), strict=True)
    bounds = [(a / ABOUT, b * ABOUT) if a > 0.0 else (None, None) for a, b in ends]
    bounds += [(None, None)] * (len(numbers) - len(bounds))
    at, least = numbers, lost(numbers)
    if len(numbers) > FEW_NUMBERS:
        ways: list[tuple[str, dict[str, float]]] = [
            ("SLSQP", {"eps": share * spacing, "ftol": NEARLY}) for share in STEPS
        ]
    else:
        ways = [("Nelder-Mead", {"maxfev": 100 * max(2, len(numbers)), "xatol": 1e-3})]
    for method, options in ways:
        with warnings.catch_warnings():
            # (of steps that end beyond a bound by round-off)
            warnings.filterwarnings("ignore", "Values in x", RuntimeWarning)
            found = minimize(lost, at, method=method, bounds=bounds, options=options)
        if found.fun < least:
            at, least = np.asarray(found.x), float(found.fun)
    return at


def integrated(
    q: Quadratic, mine: IntArray, known: IntArray, root: Array | None
) -> tuple[Array, Array]:
    """The quadratic of the parameters ``mine`` with those ``known`` integrated out."""
    R = np.eye(len(known)) if root is None else root
    A = np.eye(R.shape[1]) + R.T @ q.G[np.ix_(known, known)] @ R
    half = np.linalg.solve(np.linalg.cholesky(0.5 * (A + A.T)), R.T)
    cross = half @ q.G[np.ix_(known, mine)]
    return (
        q.b[mine] - cross.T @ (half @ q.b[known]),
        q.G[np.ix_(mine, mine)] - cross.T @ cross,
    )


def term_of(basis: Basis, family: Family, numbers: Array) -> Effect:
    """A course as an effect of one parameter, its height."""
    formula = f"{basis.channel} += k * {family.formula(numbers)}"
    story = family.words(numbers)
    size = PEAK * SIZE[UNITS.index(basis.unit)]
    made = family.name, tuple(float(n) for n in numbers)
    cost = _cost(numbers)
    if basis.channel == "heading":
        address = residual_function(family.compiled(*made[1]), kept=False)
        acts = {"heading": address}
        return term(formula, basis.unit, size, story, observation_error=acts, made=made, cost=cost)
    column = CHANNELS.index(basis.channel)

    def error(k: Array, signals: Signals) -> Array:
        out = np.zeros((len(signals.t), 6))
        out[:, column] = k[0] * family.values(numbers, signals.t - signals.t[0])
        return out

    return term(formula, basis.unit, size, story, imu_error=error, made=made, cost=cost)


def again(channel: str, made: tuple[str, tuple[float, ...]]) -> Effect:
    """The course of a channel that was found before, by its kind and its numbers.

    Raises KeyError for a kind or a channel that there is none of.
    """
    basis, family = _kind(channel, made[0])
    return term_of(basis, family, np.array(made[1]))


def course_of(effect: Effect) -> tuple[Basis, Family, Array] | None:
    """The channel, as a basis, family and numbers of the course that an effect is; None where it is
    none."""
    if effect.made is None or effect.made[0] not in COURSES:
        return None
    return *_kind(effect.id.partition(" += ")[0], effect.made[0]), np.array(effect.made[1])


def _kind(channel: str, name: str) -> tuple[Basis, Family]:
    if channel == "heading":
        bases = heading_bases(1.0)
    else:
        bases = [imu_basis({c: i for i, c in enumerate(CHANNELS)}[channel], 1.0)]
    return {f.name: (b, f) for b in bases for f in b.families}[name]

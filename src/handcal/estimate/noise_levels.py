"""Noise levels by maximum evidence: what the recording itself says of its noise.

The quasi-Newton search is our own because none of scipy's that knows bounds can begin with the
curvature that an earlier search ended with, or asks for few enough passes of the filter: in 42
searches about five recordings L-BFGS-B asked for 20 % more, SLSQP for 46 % and TNC for 127 %, and
ended up to 10, 0.1 and 3 nats below it (and up to 0.1, 0.2 and 0.9 above).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import MAX_DIM
from handcal.estimate.adjoint import Slopes, backward
from handcal.estimate.evidence import Reduction, reduced_pass
from handcal.estimate.hand_sway import typical_rate
from handcal.estimate.linear import Linear
from handcal.estimate.problem import Problem, observation_variances
from handcal.estimate.white import white_levels
from handcal.types import Array, Level, Markov

# Logarithmic steps: of central differences, of the search's first curvature, its longest;
# and the least curvature, that of the widest prior.
STEP = 1e-4
DIFFERENCE = 0.01
LONGEST_STEP = 1.5
FLATTEST = 0.25
# How far one of two levels that share what is seen has to have moved (in its logarithm) for the
# other way to share it to be looked at; by how much the lesser is less there.
FAR, NEARLY_NONE = 0.5, 30.0
SENSORS = ("gyro_noise", "accel_noise")
# Epochs (a quarter of an hour) from which levels are first sought in one part of so many, within so
# many nats.
MANY, PART, ROUGH = 10_000, 6, 0.1
# An end that falls short of the best by so many nats in a part is not the best of the whole: if it
# were, such a difference would be three times its scatter there (the root of twice the difference).
CLOSE = 18.0

# What ``minimise`` returns: cost, place, curvature.
_End = tuple[float, Array, Array]


def initial_levels(problem: Problem) -> dict[str, float]:
    """First guess of every level: the sensors' from the readings, the others' own."""
    levels = {lv.name: lv.initial for lv in problem.levels}
    levels.update(white_levels(problem.recording))
    for k, observation in enumerate(problem.observations):
        if observation.guess is not None:
            mine = problem.nodes.kind == k
            levels.update(observation.guess(problem.nodes.z[mine]))
    return levels


def until(linear: Linear, t: float) -> Linear:
    """The part of a linearised problem up to time t, s."""
    k = max(2, int(np.searchsorted(linear.t, t, side="right")))
    return linear if k >= len(linear.t) else _first(linear, k)


def _first(linear: Linear, k: int) -> Linear:
    """Its first k epochs."""
    q = linear.first[k]
    return replace(
        linear,
        Phi=linear.Phi[:k],
        d=linear.d[:k],
        Q_gyro=linear.Q_gyro[:k],
        Q_accel=linear.Q_accel[:k],
        Q_extra=linear.Q_extra[:k],
        t=linear.t[:k],
        rate=linear.rate[:k],
        first=linear.first[: k + 1],
        kind=linear.kind[:q],
        r=linear.r[:q],
        H=linear.H[:q],
        used=linear.used[:q],
    )


def beginning(reduction: Reduction, k: int) -> Reduction:
    """The first k epochs of a reduced problem, without what readings of one window scatter."""
    linear, some = reduction.linear, slice(int(reduction.first[k]))
    return replace(
        reduction, linear=_first(linear, k), D=reduction.D[:k],
        first=reduction.first[: k + 1], g=reduction.g[some], h=reduction.h[some],
        at=reduction.at[some], count=reduction.count[some], slot=reduction.slot[some],
        folded=None, t=linear.t[:k],
    )  # fmt: skip


@dataclass(frozen=True)
class Curvature:
    """How the evidence bends with the logarithms of the levels ``names``: matrix (k, k)."""

    names: tuple[str, ...]
    matrix: Array

    def of(self, names: Sequence[str]) -> Array | None:
        """The matrix of these levels, NaN where it is not known; None where all of it is not."""
        if not self.names:
            return None
        at = np.array([self.names.index(n) if n in self.names else -1 for n in names])
        return np.where(np.outer(at >= 0, at >= 0), self.matrix[np.ix_(at, at)], np.nan)


NO_CURVATURE = Curvature((), np.zeros((0, 0)))


def estimate(
    reduction: Reduction,
    levels: Mapping[str, float],
    names: Sequence[str],
    progress: Callable[[], None] | None = None,
    tolerance: float = 0.01,
    excess: float = 1e6,
    known: Curvature = NO_CURVATURE,
) -> tuple[dict[str, float], Curvature]:
    """Levels that maximise the evidence of a linearised problem, starting from ``levels``.

    names: those to estimate; the others stay. The search runs over logarithms, within
    each level's range, with a log-normal prior around its first guess (its width on either
    side is the level's own), so that a level the recording cannot see stays where it was.
    It ends where less than about ``tolerance`` nats are to be gained. excess: the sensors' own
    noise may not exceed its first guess by more than this factor.
    """
    begins = [(np.array([math.log(levels[n]) for n in names]), known.of(names))]
    ends = partial(_ends, levels=levels, names=names, progress=progress, excess=excess)
    elsewhere = True
    if len(reduction.linear.t) > MANY and not known.names:
        # (an hour asks for dozens of passes from far off, and for a few from near by)
        first = beginning(reduction, len(reduction.linear.t) // PART)
        near = ends(first, begins, ROUGH)
        begins = [(x, PART * B) for _, x, B in _apart(near)]
        elsewhere = len(near) == 1  # (else the other side was looked at there)
    _, found, B = min(ends(reduction, begins, tolerance, elsewhere), key=_cost)
    return dict(levels) | _levels(names, found), Curvature(tuple(names), B)


def _ends(
    reduction: Reduction,
    begins: Sequence[tuple[Array, Array | None]],
    tolerance: float,
    elsewhere: bool = True,
    *,
    levels: Mapping[str, float],
    names: Sequence[str],
    progress: Callable[[], None] | None,
    excess: float,
) -> list[_End]:
    """Where searches end that begin at these logarithms of levels (k,), with the curvature there;
    elsewhere: also those from the other side of levels that share what is seen."""
    problem = reduction.linear.problem
    own = {lv.name: lv for lv in problem.levels}
    guess = initial_levels(problem)
    centre = np.array([math.log(guess[n]) for n in names])
    below, above = (np.array([getattr(own[n], side) for n in names]) for side in ("below", "above"))
    low, high = _range([own[n] for n in names], centre, excess)
    score = Score(reduction, levels, names)

    def cost(x: Array) -> tuple[float, Array]:
        value, slope = score(dict(levels) | _levels(names, x))
        if progress is not None:
            progress()
        sigma = np.where(x < centre, below, above)
        away = (x - centre) / sigma
        return 0.5 * float(away @ away) - value, away / sigma - slope

    def end(x: Array, B: Array | None) -> _End:
        return minimise(cost, np.clip(x, low, high), low, high, tolerance, B)

    out = [end(x, B) for x, B in begins]
    for i, other in _sharing(problem, names) if elsewhere else ():
        _, found, B = min(out, key=_cost)
        if np.abs(found - np.clip(begins[0][0], low, high))[[i, other]].max() > FAR:
            out += [end(x, B) for x in _instead(found, i, other, typical_rate(problem))]
    return out


def _cost(end: _End) -> float:
    return end[0]


def _apart(ends: Sequence[_End]) -> list[_End]:
    """Those ends of a part that may be the best of the whole, each a summit of its own."""
    out: list[_End] = []
    for value, x, B in sorted(ends, key=_cost):
        close = not out or value - out[0][0] < CLOSE
        if close and all(np.abs(x - other).max() > FAR for _, other, _ in out):
            out.append((value, x, B))
    return out


def _sharing(problem: Problem, names: Sequence[str]) -> list[tuple[int, int]]:
    """Places among these names of levels that share what is seen with another, and of that."""
    own = {lv.name: lv.shared for lv in problem.levels}
    return [(i, names.index(own[n])) for i, n in enumerate(names) if own[n] in names]


def _instead(x: Array, by_rate: int, other: int, rate: float) -> list[Array]:
    """Logarithms of levels (k,) where one of two that share what is seen holds nearly all of it:
    there the evidence may have a second summit."""
    whole = math.hypot(math.exp(x[other]), math.exp(x[by_rate]) * rate)
    out = []
    for k, size in ((by_rate, whole / max(rate, 1e-9)), (other, whole)):
        option = x.copy()
        option[[by_rate, other]] -= math.log(NEARLY_NONE)
        option[k] = math.log(size)
        out.append(option)
    return out


def _range(levels: Sequence[Level], centre: Array, excess: float) -> tuple[Array, Array]:
    """The least and the largest logarithm (k,) of each level; see ``estimate``."""
    low = np.array([math.log(lv.lower) for lv in levels])
    high = np.array([math.log(lv.upper) for lv in levels])
    for i, lv in enumerate(levels):
        if lv.name in SENSORS:
            high[i] = min(high[i], centre[i] + math.log(excess))
        high[i] = min(high[i], centre[i] + math.log(lv.most))
    return low, high


def _levels(names: Sequence[str], x: Array) -> dict[str, float]:
    return {n: math.exp(v) for n, v in zip(names, x, strict=True)}


class Score:
    """Log-evidence of a linearised problem and its slope by the logarithms of noise levels.

    One forward and one backward pass give the slope by every variance and every transition of
    Markov states there is; the chain rule does the rest.
    """

    def __init__(
        self, reduction: Reduction, levels: Mapping[str, float], names: Sequence[str]
    ) -> None:
        self.names, self.reduction = names, reduction
        self.linear = linear = reduction.linear
        # a few intervals are enough to see what a level does
        few = np.unique(np.linspace(0, len(linear.t) - 1, 50).astype(int))
        self.dt = np.diff(linear.t, prepend=linear.t[0])
        dt, rate = self.dt[few], 1.0 + linear.rate[few]
        self.processes: list[_Process] = []
        at = 0
        for markov in linear.problem.markovs:
            own = slice(at, at + markov.size)
            at = own.stop
            differ = {n: _by_level(markov, n, levels, dt, rate) for n in names if n not in SENSORS}
            changed = {n: bool(Phi.any()) for n, (Phi, Q) in differ.items() if Phi.any() or Q.any()}
            if changed:
                self.processes.append(_Process(markov, own, tuple(changed), any(changed.values())))
        self.moving = any(p.moves for p in self.processes)

    def __call__(self, levels: Mapping[str, float]) -> tuple[float, Array]:
        """Log-evidence at these levels and its slope by the logarithm of each name's."""
        problem, reduction = self.linear.problem, self.reduction
        done = reduced_pass(reduction, levels, keep=self.moving)
        m, columns = done.gain.shape[1], done.nu.shape[1]
        nothing = np.empty((0, m, columns)), np.empty((0, m, m))
        slopes = backward(done, True, *nothing, steps=self.moving)
        size = len(problem.observations) * MAX_DIM
        by_R = reduction.scatter_slope(observation_variances(problem, levels))
        by_R = by_R + np.bincount(reduction.slot, slopes.R, size)
        out = np.zeros(len(self.names))
        for i, name in enumerate(self.names):
            if name in SENSORS:
                out[i] = 2.0 * levels[name] ** 2 * slopes.densities[int(name == "accel_noise")]
                continue
            up, down = _stepped(name, levels)
            R = observation_variances(problem, up) - observation_variances(problem, down)
            out[i] = by_R @ R.ravel() / (2 * STEP)
        for process in self.processes:
            at = [self.names.index(name) for name in process.names]
            out[at] += self._by_process(process, levels, slopes)
        return done.log_evidence, out

    def _by_process(self, process: _Process, levels: Mapping[str, float], slopes: Slopes) -> Array:
        """Derivatives by the logarithms of a process's levels of what these do to it."""
        linear, own, markov = self.linear, process.own, process.markov
        many = [some for name in process.names for some in _stepped(name, levels)]
        rate = float(linear.problem.rate[0])
        v = self.reduction.navigation
        in_m = slice(v + own.start, v + own.stop)
        by_Q, by_start = np.ascontiguousarray(slopes.Q_e[1:, own, own]), slopes.prior[in_m, in_m]
        by_Phi = self._by_step(process, slopes) if process.moves else by_Q[:0]
        told = getattr(markov, "weighed", partial(weighed, markov))
        sums = told(many, self.dt[1:], linear.rate[1:], by_Phi, by_Q)
        starts = np.array([float(np.vdot(by_start, markov.start(some, rate))) for some in many])
        ends = (sums + starts).reshape(-1, 2)
        return np.asarray((ends[:, 0] - ends[:, 1]) / (2 * STEP))

    def _by_step(self, process: _Process, slopes: Slopes) -> Array:
        """Derivatives (n, size, size) by how a process moves: of its states, and of the vectors in
        n, which turn with the attitude's error."""
        own = process.own
        by_psi, by_state = slopes.step[1:, own, :3], slopes.step[1:, own, 3:][:, :, own]
        by_d = slopes.d_e[1:, own].copy()
        for i in range(0, 3 * process.markov.vectors, 3):
            by_d[:, i : i + 3] += so3.along_skew(by_psi[:, i : i + 3])
        before = self.linear.trajectory.markov[: len(by_d), None, own]
        return np.ascontiguousarray(by_state + by_d[:, :, None] * before)


@dataclass(frozen=True)
class _Process:
    """A process that levels change: its places among the Markov states, their names, and whether
    one changes how they move, besides what drives them."""

    markov: Markov
    own: slice
    names: tuple[str, ...]
    moves: bool


def weighed(
    markov: Markov,
    many: Sequence[Mapping[str, float]],
    dt: Array,
    rate: Array,
    by_Phi: Array,
    by_Q: Array,
) -> Array:
    """A process's Phi and Q (n, size, size) at each of these levels, every entry times what it
    weighs, summed (m,); none of Phi where its weights are empty."""
    out = np.zeros(len(many))
    for i, levels in enumerate(many):
        Phi, Q = markov.transition(levels, dt, rate)
        out[i] = np.vdot(by_Q, Q) + np.vdot(by_Phi, Phi[: len(by_Phi)])
    return out


def _by_level(
    markov: Markov, name: str, levels: Mapping[str, float], dt: Array, rate: Array
) -> tuple[Array, Array]:
    """Differences of a process's Phi and Q (k, size, size) over twice ``STEP`` of the logarithm of
    a level."""
    a, b = (markov.transition(some, dt, rate) for some in _stepped(name, levels))
    return a[0] - b[0], a[1] - b[1]


def _stepped(name: str, levels: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    up, down = math.exp(STEP), math.exp(-STEP)
    return dict(levels) | {name: levels[name] * up}, dict(levels) | {name: levels[name] * down}


def _curvature(
    cost: Callable[[Array], tuple[float, Array]], x: Array, g: Array, known: Array | None
) -> Array:
    """Hessian of the cost with its eigenvalues made positive: where the cost is hollow
    upwards, a step as long as the curvature allows is still the right scale. Of ``known``
    only what is NaN is found out."""
    rows = np.full((len(x), len(x)), np.nan) if known is None else known.copy()
    for i in np.flatnonzero(np.isnan(np.diag(rows))):
        e = np.zeros(len(x))
        e[i] = DIFFERENCE
        rows[i] = (cost(x + e)[1] - g) / DIFFERENCE
    rows = np.where(np.isnan(rows), rows.T, rows)
    eigenvalues, vectors = np.linalg.eigh(0.5 * (rows + rows.T))
    return np.asarray((vectors * np.maximum(np.abs(eigenvalues), FLATTEST)) @ vectors.T)


def minimise(
    cost: Callable[[Array], tuple[float, Array]],
    x: Array,
    low: Array,
    high: Array,
    tolerance: float,
    known: Array | None = None,
    rounds: int = 60,
) -> tuple[float, Array, Array]:
    """The least of ``cost(x) -> (value, gradient)`` within the bounds, where it is, and the
    curvature there.

    All are of order one. A quasi-Newton search (BFGS) that starts from the curvature ``known``
    (k, k; NaN: not known), else from that of differenced gradients; coordinates that press
    against a bound rest there. It ends when the quadratic model promises less than
    ``tolerance``.
    """
    value, g = cost(x)
    B = _curvature(cost, x, g, known)
    for _ in range(rounds):
        free = ~(((x <= low) & (g > 0)) | ((x >= high) & (g < 0)))
        if not free.any() or not np.isfinite(value):
            break
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(B[np.ix_(free, free)], g[free])
        promise = -0.5 * float(g @ step)
        if promise < tolerance:
            break
        step *= min(1.0, LONGEST_STEP / float(np.abs(step).max()))
        for _halving in range(12):
            new = np.clip(x + step, low, high)
            new_value, new_g = cost(new)
            if new_value <= value + 1e-4 * float(g @ (new - x)):
                break
            step *= 0.4
        else:
            break
        s, y = new - x, new_g - g
        x, value, g = new, new_value, new_g
        Bs = B @ s
        if s @ y > 1e-3 * (s @ Bs):
            B = B + np.outer(y, y) / (s @ y) - np.outer(Bs, Bs) / (s @ Bs)
    return value, x, B

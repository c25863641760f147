"""Fits of a set of effects to one or several recordings of one device.

Every recording has its own trajectory, biases and noise levels; the effects' parameters
are shared. Each round of relinearisation adds the recordings' quadratics, solves for the
shared parameters, and updates each trajectory from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate import noise_levels, smoother
from handcal.estimate.convergence import ROUNDS, Rounds
from handcal.estimate.evidence import ReducedPass, Reduction, reduce, reduced_pass
from handcal.estimate.heavy_tails import has_tails, tailed, usual, wider
from handcal.estimate.linear import Linear
from handcal.estimate.model import Fitted, Known, Model, Rested
from handcal.estimate.pieces import holding, is_long, reduced, released
from handcal.estimate.prior_root import prior_root
from handcal.estimate.prior_scales import SCALES
from handcal.estimate.quadratic import Local, Posterior, Quadratic, given, local, posterior, total
from handcal.estimate.transfer import begun, linearised
from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array, Prior

# Convergence tolerances of the evidence, nats: of a fit that is written down, of one that a search
# compares with others, and before a new estimate of the noise levels, which changes it by more.
TOLERANCE, COMPARED, ROUGH = 0.05, 0.2, 2.0
# Share of the tolerance within which noise levels are estimated.
OF_NOISE = 0.25
# Loss of evidence under new noise levels at which a trajectory is given up, nats.
ASTRAY = 20.0
# Shares of the step to new noise levels, tried in turn until the trajectory converges.
SHARES = (1.0, 0.3, 0.1)
# Smallest change of the logarithm of a noise level after which the fit is repeated.
STILL = 0.02
# Largest white noise of a sensor, times what its readings show. More would absorb missing physics.
EXCESS = 1.3
# Longest step of a parameter in one round, in standard deviations of its prior.
TRUSTED = 20.0
# Shares of a step, tried in turn until the trajectory is a plausible motion.
DAMPED = (1.0, 0.3, 0.1)
# Largest discontinuity of a plausible trajectory from one epoch to the next, m and m/s.
BEYOND = 1e3
# Gain of the wider scales of the priors from which they are tried, nats.
MORE = 0.5
# Largest plausible bias, in standard deviations of its prior.
FURTHEST = 25.0
# Largest plausible error, in standard deviations of its prior: two of the widest scale. It bounds
# pairs of effects that nearly cancel, such as all scale errors together and gravity.
LARGEST = 2.0 * float(SCALES[-1])


def known_of(model: Model, free: Set[str] = frozenset()) -> Known:
    """The posterior of a model's parameters, as a prior for a fit of other observations. Effects in
    ``free`` keep their usual prior."""
    names = model.quadratic.names
    own = np.array([n[0] not in free for n in names], dtype=bool)
    C = np.where(np.outer(own, own), model.covariance + 1e-12 * np.eye(len(names)), 0.0)
    C[~own, ~own] = 1.0
    return Known(names, np.where(own, model.u, 0.0), np.asarray(np.linalg.cholesky(C)))


def known_before(effects: Sequence[Effect], before: Prior | None) -> Known | None:
    """The prior of these effects' parameters from ``before``, what is known of the device. Effects
    that it does not cover keep their usual prior. None if it covers none of them."""
    listed = [(e.id, p) for e in effects if e.process is None for p in e.parameters]
    names = tuple((i, p.name) for i, p in listed)
    at = [] if before is None else [k for k, n in enumerate(before.names) if n in names]
    if before is None or not at:
        return None
    mine = [names.index(before.names[k]) for k in at]
    unit = np.array([listed[k][1].prior_sigma for k in mine])
    count = len(names)
    usual = prior_root(Quadratic(names, 0.0, np.zeros(count), np.zeros((count, count))), effects)
    C = np.eye(count) if usual is None else usual @ usual.T
    C[mine], C[:, mine] = 0.0, 0.0
    C[np.ix_(mine, mine)] = before.covariance[np.ix_(at, at)] / np.outer(unit, unit)
    mean = np.zeros(count)
    mean[mine] = before.mean[at] / unit
    root = np.asarray(np.linalg.cholesky(C + 1e-12 * np.eye(count)))
    return Known(names, mean, root)


def believed(model: Model, excess: Mapping[str, float]) -> Model:
    """A fit with a prior from the device, its information from the recordings divided by the
    ``excess`` scatter of their scores. The prior's own information is kept whole.

    excess: by effect, the factor by which scores scatter more than the information matrix says.
    """
    q = model.quadratic
    s = np.array([1.0 / math.sqrt(excess.get(i, 1.0)) for i, _ in q.names])
    G = q.G * np.outer(s, s)
    # (scaled about the fit, since the maximum is undefined along weakly observed directions)
    b = G @ model.u + s**2 * (q.b - q.G @ model.u)
    found = _posterior(Quadratic(q.names, q.a, b, G), model.effects, model.known)
    return replace(model, u=found.mean, covariance=found.covariance)


def own_levels(f: Fitted) -> dict[str, float]:
    """Noise levels of a fit that belong to its effects."""
    own = {lv.name for e in f.problem.effects for lv in e.levels}
    return {k: v for k, v in f.levels.items() if k in own}


def fitted(
    begin: Iterable[Fitted],
    effects: Sequence[Effect],
    noise_rounds: int = 1,
    known: Known | None = None,
    tolerance: float = COMPARED,
    of_use: float = -math.inf,
    trusted: float = TRUSTED,
) -> Model:
    """The fit of these effects to all recordings, from the trajectories and noise of other fits.

    begin: those fits; an iterator saves memory, since its items are released after the first
    round. noise_rounds: how often noise levels are estimated at the most. tolerance: nats within
    which the evidence rests. of_use: evidence below which a sinking fit is given up. trusted:
    longest step before the noise levels are estimated, see ``relinearised_parts``.
    """
    rest = tolerance if noise_rounds == 0 else ROUGH
    parts = [begun(f, effects) for f in begin]
    wide = known is None and any(_begins_wide(f) for f in parts)
    # (handed on one by one, since a reference here would keep their linearisations in memory)
    handed_on = (parts.pop(0) for _ in range(len(parts)))
    constant = sum(f.case.constant for f in parts)
    of_use -= constant
    now = relinearised_parts(
        handed_on, effects, known, wide=wide, tolerance=rest, of_use=of_use, trusted=trusted
    )
    if not math.isfinite(now.evidence):
        return diverged(now.parts, effects)
    for left in range(-1 if now.sank else noise_rounds, -1, -1):
        now = _widened(now, effects, known)
        now = replace(now, sank=now.evidence < of_use)
        if not left or now.sank:
            break
        have = now.reductions or [reduced(f.about) for f in now.parts]
        new = [with_noise(*x, OF_NOISE * tolerance) for x in zip(now.parts, have, strict=True)]
        still = _change(now.parts, new) < STILL
        moved = _with_levels(now, have, new, still, effects, known, tolerance)
        del have
        if moved is None:
            break
        now = moved
        if still:
            break
    if now.rest > tolerance and not now.sank:
        now = relinearised_parts(
            now.parts, effects, known, wide=now.wide, tolerance=tolerance,
            reductions=now.reductions, of_use=of_use,
        )  # fmt: skip
    if not math.isfinite(now.evidence):
        return diverged(now.parts, effects)
    whole = now.whole or _told(now.parts, effects)
    found = _posterior(whole, effects, known, now.wide)
    return Model(
        tuple(effects), _still_reduced(now), whole, found.mean, found.covariance,
        found.log_evidence + constant, now.settled, known, now.swing,
    )  # fmt: skip


def _still_reduced(now: Rested) -> tuple[Fitted, ...]:
    """The parts; long ones keep the reduction of their last round, which displays use."""
    return tuple(
        replace(f, about=holding(f.about, r)) if is_long(f.problem, f.trajectory) else f
        for f, r in zip_longest(now.parts, now.reductions)
    )


def _widened(now: Rested, effects: Sequence[Effect], known: Known | None) -> Rested:
    """The fit with all scales of the priors, if some effect is likelier under a wider one.

    (Only after a fit at the usual scales, since far from convergence any parameter may look large.)
    """
    if now.wide or known is not None:
        return now
    whole = now.whole or _told(now.parts, effects)
    if _asks_for_more(whole, effects):
        tried = relinearised_parts(
            now.parts, effects, known, now.evidence, True, now.rest, now.reductions
        )
        if tried.evidence > now.evidence:
            return tried
    return replace(now, whole=whole)


def _with_levels(
    now: Rested,
    have: list[Reduction],
    new: Sequence[Fitted],
    still: bool,
    effects: Sequence[Effect],
    known: Known | None,
    tolerance: float,
) -> Rested | None:
    """The fit at new noise levels, or at a share of the step to them at which it converges.

    None if it converges at none of ``SHARES``: about one fixed trajectory the evidence may favour
    noise too small for any other. have: reductions of the current parts. new: the parts with the
    new levels. still: whether these differ from the current ones by less than ``STILL``.
    """
    parts = now.parts
    # (if the last step changed less than the tolerance, one pass may confirm the fit)
    near = now.evidence if now.settled and now.step < tolerance else math.nan
    go = partial(relinearised_parts, effects=effects, known=known, wide=now.wide,
                 tolerance=tolerance, reductions=have)  # fmt: skip
    if still:
        # (shares of so small a step would make no difference)
        return go(new, rested=near)
    # (levels that are estimated in one part of a recording may lower the evidence of the whole)
    least = -math.inf if any(f.case.noise_until for f in parts) else now.evidence - ASTRAY
    for share in SHARES:
        towards = [_towards(o, n, share) for o, n in zip(parts, new, strict=True)]
        tried = go(towards, least=least, rested=near if share == 1.0 else math.nan)
        if tried.evidence > least:
            return tried
    return None


def _change(old: Sequence[Fitted], new: Sequence[Fitted]) -> float:
    """The largest change of the logarithm of a noise level."""
    return max(
        abs(math.log(n.levels[k] / o.levels[k]))
        for n, o in zip(new, old, strict=True)
        for k in n.levels
    )


def diverged(parts: Sequence[Fitted], effects: Sequence[Effect]) -> Model:
    """A diverged fit: its evidence is minus infinity."""
    nothing = Quadratic((), -math.inf, np.zeros(0), np.zeros((0, 0)))
    none = np.zeros((0, 0))
    return Model(tuple(effects), tuple(parts), nothing, np.zeros(0), none, -math.inf, False)


def _told(parts: Sequence[Fitted], effects: Sequence[Effect]) -> Quadratic:
    """The quadratic of the effects' parameters, summed over all recordings."""
    return total([_local(f, effects).quadratic for f in parts])


def _asks_for_more(whole: Quadratic, effects: Sequence[Effect]) -> bool:
    """Whether some effect is likelier under a wider scale of its prior than the usual one."""
    index = np.arange(len(whole.names), dtype=np.int64)
    root = prior_root(whole, effects)
    return tailed(whole, index, root).log_evidence > usual(whole, index, root).log_evidence + MORE


def _begins_wide(f: Fitted) -> bool:
    """Whether some effect begins with constants that are likelier under a wider scale."""
    squares: dict[str, list[float]] = {}
    for s, value in zip(f.problem.slots, f.trajectory.constants, strict=True):
        if has_tails(s.owner):
            squares.setdefault(s.owner, []).append(float(value / s.prior_sigma) ** 2)
    return any(wider(len(v), sum(v)) > MORE for v in squares.values())


def _posterior(
    q: Quadratic, effects: Sequence[Effect], known: Known | None, wide: bool = False
) -> Posterior:
    index = np.arange(len(q.names), dtype=np.int64)
    if known is None:
        return (tailed if wide else usual)(q, index, prior_root(q, effects))
    at = [known.names.index(n) for n in q.names]
    mean, root = known.mean[at], known.root[at]
    a = q.a + float(q.b @ mean - 0.5 * mean @ q.G @ mean)
    moved = posterior(Quadratic(q.names, a, q.b - q.G @ mean, q.G), index, root)
    return replace(moved, mean=moved.mean + mean)


def _local(f: Fitted, effects: Sequence[Effect]) -> Local:
    return local(reduced_pass(reduced(f.about), f.levels), frozenset(e.id for e in effects))


def _sane(linear: Linear, *seen: Array) -> bool:
    """Whether a linearised trajectory is a plausible motion: finite, continuous, with biases and
    errors of plausible size. Otherwise its fit would diverge.

    seen: Jacobians of the observations.
    """
    steps = np.abs(linear.d).max(initial=0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        rest = linear.Phi.sum() + linear.r.sum() + sum(x.sum() for x in seen)
    nominal = linear.trajectory
    off = max(
        float(np.abs(nominal.bg).max()) / GYRO_BIAS_PRIOR,
        float(np.abs(nominal.ba).max()) / ACCEL_BIAS_PRIOR,
    )
    effects = catalogue()
    known = [s.owner in effects for s in linear.problem.slots]
    unit = np.array([s.prior_sigma for s in linear.problem.slots])[known]
    largest = float(np.abs(nominal.constants[known] / unit).max(initial=0.0))
    fits = steps < BEYOND and off < FURTHEST and largest < LARGEST
    return bool(fits and np.isfinite(rest))


def _reduced_if_sane(f: Fitted) -> Reduction | None:
    """The reduction of a fit's problem; None if the trajectory is no plausible motion. The
    linearisation is released, since it is large."""
    if not is_long(f.problem, f.trajectory):
        return released(f.about) if _sane(f.linear, f.linear.H) else None
    made = released(f.about)
    return made if _sane(made.linear, made.g, made.h) else None


def _towards(old: Fitted, new: Fitted, share: float) -> Fitted:
    """The new fit with noise levels at a share of the step from the old ones, in logarithms."""
    levels = {k: v * (new.levels[k] / v) ** share for k, v in old.levels.items()}
    return replace(new, levels=levels)


def relinearised_parts(
    begin: Iterable[Fitted],
    effects: Sequence[Effect],
    known: Known | None = None,
    least: float = -math.inf,
    wide: bool = False,
    tolerance: float = TOLERANCE,
    reductions: list[Reduction] | None = None,
    rested: float = math.nan,
    of_use: float = -math.inf,
    trusted: float = TRUSTED,
) -> Rested:
    """Relinearise at fixed noise levels until the joint evidence rests (iterated Gauss-Newton).

    least: evidence below which the fit is given up. wide: use all scales of the priors, not the
    usual one alone. tolerance: nats. reductions: those of the parts, if known; the list is emptied
    to free their memory. rested: evidence at which the parts rested at other noise levels, their
    last step within the tolerance. of_use: evidence below which a fit that sinks is given up.
    trusted: longest step of a parameter in one round, in standard deviations of its prior.
    """
    parts, handed_on = list(begin), reductions or []
    # (a copy, since the caller's list is emptied)
    reductions = [*handed_on]
    handed_on.clear()
    way = Rounds(tolerance)
    reductions += [] if reductions else _all_reduced(parts)
    for _ in range(ROUNDS):
        if len(reductions) < len(parts):
            return Rested(parts, False, math.nan, tolerance, wide)
        parts = [f.bare for f in parts]
        seen = _seen(parts, reductions, effects, known, wide)
        now = seen.evidence
        rests = way.rests(now) or abs(now - rested) < tolerance
        if rests or way.swings(now):
            step = float(np.fmin(abs(now - way.evidence), abs(now - rested)))
            return Rested(parts, rests, now, tolerance, wide, seen.whole, [*reductions], step=step)
        rested = math.nan
        way.went_on(now)
        if way.runs_away:
            return Rested(parts, False, math.nan, tolerance, wide)
        if not now > least or way.sinks(of_use):  # (also true of NaN)
            break
        reductions.clear()  # (frees memory before the next linearisation, which is as large)
        way.aims(seen.aim, seen.whole.G)
        far = float(np.abs(seen.aim).max(initial=0.0))
        reach = way.reach if far < trusted else min(way.reach, trusted / far)
        parts, reductions = _stepped(parts, seen, effects, known, wide, reach)
    # (a fit that was given up has the evidence of its last plausible round)
    sane, sank = len(reductions) == len(parts), way.sinks(of_use)
    evidence = way.evidence if sane else math.nan
    bare = [f.bare for f in parts]
    return Rested(bare, False, evidence, tolerance, wide, swing=way.swing, sank=sank)


def _all_reduced(parts: Iterable[Fitted]) -> list[Reduction]:
    """Reductions of the parts; parts that are no plausible motion are left out."""
    return [r for r in map(_reduced_if_sane, parts) if r is not None]


def _stepped(
    parts: Sequence[Fitted],
    seen: _Seen,
    effects: Sequence[Effect],
    known: Known | None,
    wide: bool,
    reach: float,
) -> tuple[list[Fitted], list[Reduction]]:
    """The parts after one step, and their reductions. The step is shortened by ``DAMPED`` if it
    leads to no plausible motion.

    reach: share of the full step; above 1 it extrapolates.
    """
    for share in DAMPED:
        if share < 1.0:
            seen = _seen(parts, _all_reduced(parts), effects, known, wide)
            parts = [f.bare for f in parts]
        there = _followed(parts, seen, effects, share * reach)
        reductions = _all_reduced(there)
        if len(reductions) == len(there):
            break
    return there, reductions


@dataclass(frozen=True)
class _Seen:
    """One pass over all parts: each part's quadratic, their sum, and the posterior mean (k,) in
    units of the priors, with the joint evidence."""

    passes: list[ReducedPass]
    locals: Sequence[Local]
    whole: Quadratic
    mean: Array
    evidence: float

    @property
    def aim(self) -> Array:
        """The step (k,) from the current parameters to the posterior mean, in prior units."""
        here = {n: u for x in self.locals for n, u in zip(x.quadratic.names, x.here, strict=True)}
        return self.mean - np.array([here[n] for n in self.whole.names], dtype=np.float64)


def _seen(
    parts: Sequence[Fitted],
    reductions: Sequence[Reduction],
    effects: Sequence[Effect],
    known: Known | None,
    wide: bool,
) -> _Seen:
    shared = frozenset(e.id for e in effects)
    # (the smoother needs the covariances only)
    passes = [
        reduced_pass(r, f.levels, keep=True, wide=False)
        for f, r in zip(parts, reductions, strict=True)
    ]
    locals_ = [local(p, shared) for p in passes]
    whole = total([x.quadratic for x in locals_])
    found = _posterior(whole, effects, known, wide)
    return _Seen(passes, locals_, whole, found.mean, found.log_evidence)


def _followed(
    parts: Sequence[Fitted], seen: _Seen, effects: Sequence[Effect], step: float
) -> list[Fitted]:
    """The parts with their trajectories smoothed at the joint posterior mean of the constants.

    step: share of the way that is taken. The passes are consumed, to free their memory.
    """
    out = []
    for f, own in zip(parts, seen.locals, strict=True):
        done = seen.passes.pop(0)
        done = replace(done, w=own.deviations(given(seen.whole, own.quadratic, seen.mean)))
        problem, there = done.reduction.linear.problem, smoother.followed(done, f.trajectory, step)
        del done
        out.append(linearised(f, there(), effects, problem))
    return out


def with_usual_noise(f: Fitted) -> Fitted:
    """The fit with initial noise levels, except fixed ones."""
    levels = noise_levels.initial_levels(f.problem)
    levels |= {k: v for k, v in f.case.fixed.items() if k in levels}
    return replace(f, levels=levels, curvature=noise_levels.NO_CURVATURE)


def with_noise(f: Fitted, reduction: Reduction, near: float) -> Fitted:
    """The fit with new estimates of its noise levels, except fixed ones.

    reduction: of its linearised problem. near: tolerance of the estimate, nats.
    """
    names = tuple(lv.name for lv in f.problem.levels if lv.name not in f.case.fixed)
    if not names:
        return f
    until = f.case.noise_until
    part = reduction if until is None else reduce(noise_levels.until(f.linear, until))
    levels, curvature = noise_levels.estimate(
        part, f.levels, names, tolerance=near, excess=EXCESS, known=f.curvature
    )
    return replace(f, levels=levels, curvature=curvature)

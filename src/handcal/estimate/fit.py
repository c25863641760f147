"""Fits of a set of effects to one or several recordings of one device.

Every recording has its own trajectory, biases and noise levels; the effects' parameters
are shared. Each round of relinearisation adds the recordings' quadratics, solves for the
shared parameters, and moves each trajectory by what follows for it.
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

# Nats within which evidence rests: of a fit that is written down, of one that a search compares
# with others, and before noise levels are found anew, which changes it by more.
TOLERANCE, COMPARED, ROUGH = 0.05, 0.2, 2.0
# Of these, within which noise levels are found (a search ends where less is promised).
OF_NOISE = 0.25
# Nats below what other noise levels gave at which a trajectory is given up.
ASTRAY = 20.0
# Of the way to other noise levels, as far as the trajectory can follow.
SHARES = (1.0, 0.3, 0.1)
# Levels that move by less, in their logarithm, stay where they are: there is nothing to follow.
STILL = 0.02
# White noise of a sensor beyond what its readings show would be an alibi for whatever physics
# is missing.
EXCESS = 1.3
# No parameter is moved by more at once, in standard deviations of its prior.
TRUSTED = 20.0
# Of a step that leads to what is no motion, as much is taken instead.
DAMPED = (1.0, 0.3, 0.1)
# From one epoch to the next, m and m/s, no trajectory jumps so far.
BEYOND = 1e3
# Nats that wider scales of the priors must promise to be tried.
MORE = 0.5
# No device's bias is so many times what is usual: a fit that says so is of something else.
FURTHEST = 25.0
# Nor is any error, in standard deviations of its prior: two of the widest scale. (What two effects
# share, all scales together and gravity, may otherwise run away with both.)
LARGEST = 2.0 * float(SCALES[-1])


def known_of(model: Model, free: Set[str] = frozenset()) -> Known:
    """What a model says of its parameters, for the fit of other observations; of effects that are
    ``free`` no more than their priors do."""
    names = model.quadratic.names
    own = np.array([n[0] not in free for n in names], dtype=bool)
    C = np.where(np.outer(own, own), model.covariance + 1e-12 * np.eye(len(names)), 0.0)
    C[~own, ~own] = 1.0
    return Known(names, np.where(own, model.u, 0.0), np.asarray(np.linalg.cholesky(C)))


def known_before(effects: Sequence[Effect], before: Prior | None) -> Known | None:
    """What is known of a device of these effects; the others as uncertain as is usual."""
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
    """A fit to a device that was known before, the recordings' own say divided by how much their
    scores scatter beyond it: what was known does not become less certain by that."""
    q = model.quadratic
    s = np.array([1.0 / math.sqrt(excess.get(i, 1.0)) for i, _ in q.names])
    G = q.G * np.outer(s, s)
    # (about where the fit is: the likeliest values may be anywhere along what is hardly shown)
    b = G @ model.u + s**2 * (q.b - q.G @ model.u)
    found = _posterior(Quadratic(q.names, q.a, b, G), model.effects, model.known)
    return replace(model, u=found.mean, covariance=found.covariance)


def own_levels(f: Fitted) -> dict[str, float]:
    """Levels that the effects of a fit bring along."""
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
    """Fit these effects to all recordings, beginning from other fits' trajectories and noise,
    until the evidence rests within ``tolerance`` nats, or sinks below what would be ``of_use``, or
    rests there at the noise levels that it began with. trusted: see ``relinearised_parts``, before
    noise levels are found anew.
    (Those that are made as they are asked for are gone when the first round has left them.)"""
    rest = tolerance if noise_rounds == 0 else ROUGH
    parts = [begun(f, effects) for f in begin]
    wide = known is None and any(_begins_wide(f) for f in parts)
    # (handed on one by one: whoever keeps them here keeps what they are linearised to as well)
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
    """The parts; long ones with what they were reduced to when they came to rest, for whoever shows
    them."""
    return tuple(
        replace(f, about=holding(f.about, r)) if is_long(f.problem, f.trajectory) else f
        for f, r in zip_longest(now.parts, now.reductions)
    )


def _widened(now: Rested, effects: Sequence[Effect], known: Known | None) -> Rested:
    """The fit with all scales of the priors, where some effect asks for more than the usual one.

    (First at the usual scales, unless it began beyond them: seen from far off, anything may look
    large.)
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
    """The fit at these noise levels, or as far on the way to them as the trajectory can follow:
    about one trajectory, evidence may favour a noise so small that no other is as good. None where
    it cannot follow at all. still: whether they are where they were, to ``STILL``."""
    parts = now.parts
    # (where the last step and these levels change less than that, there is nothing to follow)
    near = now.evidence if now.settled and now.step < tolerance else math.nan
    go = partial(relinearised_parts, effects=effects, known=known, wide=now.wide,
                 tolerance=tolerance, reductions=have)  # fmt: skip
    if still:
        # (whether it rests or goes to and fro, about these it does so with any share of their way)
        return go(new, rested=near)
    # (of noise that is a part's alone the whole need not be the better)
    least = -math.inf if any(f.case.noise_until for f in parts) else now.evidence - ASTRAY
    for share in SHARES:
        towards = [_towards(o, n, share) for o, n in zip(parts, new, strict=True)]
        tried = go(towards, least=least, rested=near if share == 1.0 else math.nan)
        if tried.evidence > least:
            return tried
    return None


def _change(old: Sequence[Fitted], new: Sequence[Fitted]) -> float:
    """By how much the noise level that moved most has moved, in its logarithm."""
    return max(
        abs(math.log(n.levels[k] / o.levels[k]))
        for n, o in zip(new, old, strict=True)
        for k in n.levels
    )


def diverged(parts: Sequence[Fitted], effects: Sequence[Effect]) -> Model:
    """No fit at all: its evidence is worse than any other."""
    nothing = Quadratic((), -math.inf, np.zeros(0), np.zeros((0, 0)))
    none = np.zeros((0, 0))
    return Model(tuple(effects), tuple(parts), nothing, np.zeros(0), none, -math.inf, False)


def _told(parts: Sequence[Fitted], effects: Sequence[Effect]) -> Quadratic:
    """What all recordings say of the effects' parameters."""
    return total([_local(f, effects).quadratic for f in parts])


def _asks_for_more(whole: Quadratic, effects: Sequence[Effect]) -> bool:
    """Whether some effect is likelier under a wider scale of its prior than the usual one."""
    index = np.arange(len(whole.names), dtype=np.int64)
    root = prior_root(whole, effects)
    return tailed(whole, index, root).log_evidence > usual(whole, index, root).log_evidence + MORE


def _begins_wide(f: Fitted) -> bool:
    """Whether some effect has constants here that wider scales than the usual one make likelier."""
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
    """Whether this is a motion at all; a step astray grows from round to round. seen: what its
    observations see."""
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
    """The fit's problem reduced, and nothing kept of what it was linearised to, which is large;
    None if it is no motion."""
    if not is_long(f.problem, f.trajectory):
        return released(f.about) if _sane(f.linear, f.linear.H) else None
    made = released(f.about)
    return made if _sane(made.linear, made.g, made.h) else None


def _towards(old: Fitted, new: Fitted, share: float) -> Fitted:
    """The fit with its noise levels moved by a share of the way, in their logarithms."""
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
    """Move and linearise again until the joint evidence rests; whether it does, and the evidence.

    least: where the evidence falls below that, there is no use in going on. wide: with all scales
    of the priors instead of the usual one alone. tolerance: nats. reductions: the parts', if known;
    emptied, so that nobody keeps them beside those of the next round. rested: the evidence with
    which the parts came to rest at other noise levels, their last step within the same tolerance.
    of_use: evidence below which there is no use in going on where it only becomes less. trusted: by
    how much a parameter is moved at once, in standard deviations of its prior.
    """
    parts, handed_on = list(begin), reductions or []
    # (a list of its own: what the last round leaves is of these parts, not of the caller's)
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
        if not now > least or way.sinks(of_use):  # (nor where it is no number any more)
            break
        reductions.clear()  # (these and the passes are as large as what is linearised next)
        way.aims(seen.aim, seen.whole.G)
        far = float(np.abs(seen.aim).max(initial=0.0))
        reach = way.reach if far < trusted else min(way.reach, trusted / far)
        parts, reductions = _stepped(parts, seen, effects, known, wide, reach)
    # (what was given up was sane in its last round)
    sane, sank = len(reductions) == len(parts), way.sinks(of_use)
    evidence = way.evidence if sane else math.nan
    bare = [f.bare for f in parts]
    return Rested(bare, False, evidence, tolerance, wide, swing=way.swing, sank=sank)


def _all_reduced(parts: Iterable[Fitted]) -> list[Reduction]:
    """Each part reduced; those left out that are no motion."""
    return [r for r in map(_reduced_if_sane, parts) if r is not None]


def _stepped(
    parts: Sequence[Fitted],
    seen: _Seen,
    effects: Sequence[Effect],
    known: Known | None,
    wide: bool,
    reach: float,
) -> tuple[list[Fitted], list[Reduction]]:
    """The parts a step further, and reduced; of a step to what is no motion, a part of it."""
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
    """One pass over all parts: what each says, and what they say of the effects together."""

    passes: list[ReducedPass]
    locals: Sequence[Local]
    whole: Quadratic
    mean: Array
    evidence: float

    @property
    def aim(self) -> Array:
        """How far the parameters are from where they are thought to be."""
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
    # (of what is kept, a trajectory that follows asks for the covariances alone)
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
    """The fits where their trajectories go with what all parts say of the constants; the passes are
    used up."""
    out = []
    for f, own in zip(parts, seen.locals, strict=True):
        done = seen.passes.pop(0)
        done = replace(done, w=own.deviations(given(seen.whole, own.quadratic, seen.mean)))
        problem, there = done.reduction.linear.problem, smoother.followed(done, f.trajectory, step)
        del done
        out.append(linearised(f, there(), effects, problem))
    return out


def with_usual_noise(f: Fitted) -> Fitted:
    """The fit with its noise levels as they are before anything was fitted, but for those known."""
    levels = noise_levels.initial_levels(f.problem)
    levels |= {k: v for k, v in f.case.fixed.items() if k in levels}
    return replace(f, levels=levels, curvature=noise_levels.NO_CURVATURE)


def with_noise(f: Fitted, reduction: Reduction, near: float) -> Fitted:
    """The fit with its noise levels estimated anew within so many nats, but for those that are
    known; reduction: of its linearised problem."""
    names = tuple(lv.name for lv in f.problem.levels if lv.name not in f.case.fixed)
    if not names:
        return f
    until = f.case.noise_until
    part = reduction if until is None else reduce(noise_levels.until(f.linear, until))
    levels, curvature = noise_levels.estimate(
        part, f.levels, names, tolerance=near, excess=EXCESS, known=f.curvature
    )
    return replace(f, levels=levels, curvature=curvature)

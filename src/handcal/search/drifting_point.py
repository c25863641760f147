"""What a hand does that holds no point. It drifts smoothly, by centimetres where an arm tires,
further on a chair that turns; or it moves on, within a second, to another place: a step aside, the
other hand. A walking bias, an error that goes with the motion or a law of it would stand in for
that, so each such hand is a rival of what is weak or has no name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from handcal.compiled.kernel import MAX_DIM
from handcal.effects import Effect
from handcal.estimate.baseline import baseline, dense, started
from handcal.estimate.case import Case, Edit, edited
from handcal.estimate.case import creeping as creeping_case
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import diverged, fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.hand_sway import HAND_SWAY, TRAVEL_NATS, beyond_a_hand
from handcal.estimate.model import Fitted, Model
from handcal.estimate.sampling import interpolated
from handcal.model_score import PRIOR, better
from handcal.observations.fixed_position import CREEPING
from handcal.search.select_laws import WEAK
from handcal.types import Array, HandcalError

OBSERVED = CREEPING.kind
# A hand moves on where it is so many times as fast as in the median of a recording, and goes
# further in a stroke than it sways: one that holds a point, real or simulated, is seldom more than
# three times as fast. What is less than such a share of the peak beside it is drift. Its speed is
# looked at in such steps, s.
FAST, BESIDE, EACH = 5.0, 0.25, 0.1
# Such moves are so short, and between two there is so much time, s: some steps, some storeys in a
# lift; whoever goes further walks, and of that only the rests tell. Within so much time before and
# after, s, a hand comes to its speed and stops: where it is slowest there, it is held.
LONGEST, APART, REACH = 15.0, 0.5, 1.0
# Of a recording at the most, the fastest: each has numbers of its own.
MOST_MOVES = 6
# Nobody sees a point moved by less, m; and in so much time, s, an arm makes one stroke at the most
# (to reach for something takes half a second to a second).
LEAST, STROKE = 0.01, 0.5


@dataclass(frozen=True)
class Move:
    """From when to when (s) the hand moves on, how far (m), and by how much each stroke (k, 3)
    takes it elsewhere than the one before would have (m)."""

    first: float
    last: float
    far: float
    strokes: Array


def begun(cases: Sequence[Case]) -> Model:
    """The baseline; with a hand that drifts where no trajectory holds the point."""
    base = baseline(cases)
    if math.isfinite(base.log_evidence) or not any(OBSERVED in c.kinds for c in cases):
        return base
    drifting = baseline([creeping_case(c) for c in cases])
    return drifting if math.isfinite(drifting.log_evidence) else base


def moving(base: Model, model: Model, gained: Mapping[str, float]) -> tuple[Model, float] | None:
    """The baseline with a hand that moves, if that with the strong ones of the model's effects,
    or with those of them that have a name, explains as much as all of them, and by how many nats;
    gained: nats by effect.

    Where nothing weak and nothing without a name was found, of a point that sways as one does in a
    hand, there is no need to ask.
    """
    if not any(OBSERVED in f.case.kinds for f in base.parts):
        return None
    strong = [e for e in model.effects if e.common or _no_hand(e) or gained[e.id] > WEAK]
    named = [e for e in strong if "+=" not in e.id]
    far = _far(model)
    nothing = len(named) == len(model.effects)
    if nothing and max(far) < TRAVEL_NATS:
        return None
    ways = [named] if len(strong) in (len(named), len(model.effects)) else [named, strong]
    # (one that travels all along drifts as well: of that the rests know better)
    hands = _hands(fitted(model.parts, named))[1 if nothing else 0 :]
    if not hands:
        return None
    tried = [(hand, way) for hand in hands for way in ways]
    fits = in_parallel(partial(_fit, hand, way) for hand, way in tried)
    # (every arm tires a little, so that costs nothing; what is spared does)
    nats, best = max(
        ((_advantage(m, model, far), hand) for m, (hand, _) in zip(fits, tried, strict=True)),
        key=lambda pair: pair[0],
    )
    return None if nats < 0.0 else (dense(baseline(best)), nats)


def _far(model: Model) -> list[float]:
    """Nats, by recording, by which the point sways further than one that is held."""
    return [beyond_a_hand(f.about, f.levels) for f in model.parts]


def _advantage(other: Model, model: Model, far: Sequence[float]) -> float:
    """Nats by which another hand explains more than a model in which the point sways so ``far``:
    one that sways further than a hand does was not held, whatever else there is, and that is as
    true of the other hand where it still does."""
    if not math.isfinite(other.log_evidence):
        return -math.inf
    held = (f for f, still in zip(far, _far(other), strict=True) if still < TRAVEL_NATS)
    return better(other, model, 1.0) + sum(held)


def _no_hand(e: Effect) -> bool:
    """Whether what an effect does is nothing that a hand's motion could look like."""
    return e.imu_error is None and not e.walks


def _hands(held: Model) -> list[list[Case]]:
    """The recordings with a point that drifts, with one that is moved, and with one that does
    both, given the fit of one that is held."""
    cases = [f.case for f in held.parts]
    out = [[creeping_case(c) for c in cases]]
    # (where that diverged, nothing is known of how fast the hand was)
    known = math.isfinite(held.log_evidence)
    moves = [_moves(f) for f in held.parts] if known else []
    if any(moves):
        first = _fit([_moved(*x) for x in zip(cases, moves, strict=True)], held.effects)
        # (a point that moves on leads a fit of one that is held astray, and hides other moves)
        again = [_moves(f) for f in first.parts]
        moves = again if any(again) else moves
        # (what a look at the point is worth while it is held, a fit tells that knows of the moves)
        worth = [_usual(f) for f in first.parts] or [_usual(f) for f in held.parts]
        moved = [_moved(*x) for x in zip(cases, moves, worth, strict=True)]
        out += [moved, [creeping_case(c) for c in moved]]
    return out


def _moves(f: Fitted) -> list[Move]:
    """Where the hand was much faster than it is elsewhere."""
    t, nominal = f.t, f.trajectory
    if OBSERVED not in f.case.kinds:
        return []
    out = []
    for first, last in _fast(t, nominal.v):
        way = np.diff(nominal.p[(t >= first) & (t <= last)], axis=0)
        far = max(LEAST, float(np.linalg.norm(way, axis=1).sum()))
        ends = np.linspace(first, last, 1 + max(1, round((last - first) / STROKE)))
        v = interpolated(ends, t, nominal.v)
        out.append(Move(first, last, far, np.abs(np.diff(v, axis=0)) * STROKE))
    return out


def _moved(case: Case, moves: Sequence[Move], worth: float = 0.0) -> Case:
    """The case with these moves; worth: nats of one look at the point that is held.

    Meanwhile it is not looked at. That counts neither for nor against it, but for when it was and
    for the way that the hand took: each stroke leads elsewhere than the last one would have, of
    which nobody foretells the size, and what is less than a look tells need not be told (in a lift,
    or from step to step, nearly all of it).
    """
    t0 = case.recording.imu.t[0]
    for m in moves:
        t = case.observed[case.kinds.index(OBSERVED)][1].t
        out = np.flatnonzero((t >= m.first) & (t <= m.last))
        way = float(np.log1p(m.strokes * math.exp(worth / 3.0)).sum())
        cost = 2.0 * math.log(len(t)) - PRIOR + way
        shifted = (m.first, m.last, m.far)
        edit = Edit(OBSERVED, tuple(out.tolist()), shifted, len(out) * worth - cost)
        case = edited(case, edit)
    if not moves:
        return case
    when = " and ".join(f"{m.first - t0:.1f} to {m.last - t0:.1f} s" for m in moves)
    said = f"The held point moves to another place ({when}); it counts as held before and after."
    return replace(case, warnings=(*case.warnings, said))


def _usual(f: Fitted) -> float:
    """Log density of one look at the held point, in the median of all; 0 where there is none."""
    if OBSERVED not in f.case.kinds:
        return 0.0
    done = reduced_pass(reduce(f.linear), f.levels)
    own = done.reduction.slot // MAX_DIM == f.case.kinds.index(OBSERVED)
    S = done.S[own]
    each = np.log(2.0 * math.pi * S) + done.innovations(done.w)[own] ** 2 / S
    return -1.5 * float(np.median(each))


def _fast(t: Array, v: Array) -> list[tuple[float, float]]:
    """From when to when (s) the hand was fast, given its velocity (n, 3) at times t; the fastest
    few. Where it moves on for metres a fit of one that holds its point drifts for half of the
    recording: it is fast compared with half a minute around."""
    from scipy.ndimage import median_filter

    even = np.arange(t[0], t[-1], EACH)
    if not len(even):
        return []
    v = interpolated(even, t, v)
    around = median_filter(v, (1 + 2 * round(LONGEST / EACH), 1), mode="nearest")
    speed = np.linalg.norm(v - around, axis=1)
    fast = speed > max(FAST * np.median(speed), HAND_SWAY / STROKE)
    edges = np.flatnonzero(np.diff(np.r_[False, fast, False].astype(np.int8))).reshape(-1, 2)
    spans: list[tuple[float, float, float]] = []
    for i, j in edges:
        most = float(speed[i:j].max())
        a, b = even[i:j][speed[i:j] > BESIDE * most][[0, -1]]
        a, b = _slowest(even, speed, a - REACH, a), _slowest(even, speed, b, b + REACH)
        if spans and a - spans[-1][1] < APART:
            first, end, before = spans.pop()
            peak = max(before, most)
            a = a if before < BESIDE * peak else first
            b, most = (end if most < BESIDE * peak else b), peak
        spans.append((a, b, most))
    short = sorted((s for s in spans if s[1] - s[0] < LONGEST), key=lambda s: -s[2])[:MOST_MOVES]
    return [(a, b) for a, b, _ in sorted(short)]


def _slowest(t: Array, speed: Array, first: float, last: float) -> float:
    """When it was slowest from then to then, s."""
    here = np.flatnonzero((t >= first) & (t <= last))
    return float(t[here[np.argmin(speed[here])]])


def _fit(cases: Sequence[Case], effects: Sequence[Effect]) -> Model:
    """The fit of such a hand; one that is worse than any other where it diverges.

    (It begins with the usual noise, at which its evidence may sink by a thousand nats on the way to
    the best of all.)
    """
    begin = (started(case, effects) for case in cases)
    try:
        return fitted(begin, effects, noise_rounds=2)
    except HandcalError:
        return diverged((), effects)

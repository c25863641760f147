"""The search for what is missing: scan, choose, fit again, until nothing changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.evidence import reduce, reduced_pass
from handcal.explain.alibi import steadied, sways_far, without_alibi
from handcal.explain.case import Case, applicable, frozen_at, name_of
from handcal.explain.fit import Fitted, Model, fitted, moved_to, scan
from handcal.explain.late import with_delays
from handcal.explain.robust import inflation
from handcal.explain.search import (
    OCCAM_LEVEL,
    PRIOR,
    TERM_PRIOR,
    Space,
    best_set,
    gains,
    priors,
    rivals,
    space,
)
from handcal.explain.unnamed import Term, best_term, reshaped
from handcal.types import Array

ROUNDS = 8
# An effect whose gain is less than this is fitted without, to be sure.
CLOSE = 20.0
# Nats that a noise effect must gain beyond its own levels' freedom, at a first look.
LOOK = 3.0
MAX_TERMS = 3
HALF = 0.5
# A rival that would do so much of what an effect does is fitted in its place.
NEARLY = 0.4
MOST_SWAPS = 6
# Nats below which an effect may be there for the sake of another's wrong name only.
WEAK = 100.0
# Nats below which a model that a scan promised to be better has come to nothing.
LOST = 100.0
# How many of the weakest are fitted without.
FEW = 3
# Log odds of what was fitted without and not missed.
REFUSED = -1e6
FAVOURED = 30.0
# A common part of an exclusive effect that is so much larger than the rest is the simpler one.
COMMON = 3.0
MOMENTS = 16


@dataclass(frozen=True)
class Found:
    """Where the search ended: the final model, the spaces of the first and last scan, and
    what the catalogue's effects gained over the baseline alone; noise: log-evidence gained by
    each noise effect in the model; swaps: (effect, rival) to the nats by which the rival, fitted
    in its place, does worse."""

    model: Model
    space: Space
    alone: dict[str, float]
    noise: dict[str, float]
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)
    first: Space | None = None


def candidates(cases: Sequence[Case], present: Sequence[Effect]) -> list[Effect]:
    """Effects with parameters that at least one recording could show; a step at every moment,
    or near the moment where it is already."""
    out: list[Effect] = []
    t = cases[0].recording.imu.t
    for effect in catalogue().values():
        if effect.process is not None or effect.outliers:
            continue
        if not any(applicable(c, effect) for c in cases):
            continue
        if effect.moments is None:
            out.append(effect)
        elif len(cases) == 1:
            grid = effect.moments(t)
            grid = grid[:: max(1, math.ceil(len(grid) / MOMENTS))]
            out += [frozen_at(effect, m) for m in _near(effect, grid, present)]
    return out


def _near(effect: Effect, grid: Array, present: Sequence[Effect]) -> Array:
    """The grid of moments, with a finer one about the moment that is in the model."""
    for e in present:
        if name_of(e.id) == effect.id:
            at, column = float(e.id.split("@")[1]), int(np.flatnonzero(grid[0])[0])
            step = abs(grid[1, column] - grid[0, column]) if len(grid) > 1 else 1.0
            fine = np.zeros((2 * 8 + 1, grid.shape[1]))
            # halve the spacing each round; what is nearest stays in
            width = step * (0.5 if _on(grid[:, column], at) else 0.1)
            fine[:, column] = at + np.linspace(-width, width, len(fine))
            return fine
    return grid


def _on(grid: Array, at: float) -> bool:
    return bool(np.min(np.abs(grid - at)) < 2e-3)


def search(base: Model, report: Callable[[float], None] = lambda _: None) -> Found:
    """From the baseline to the model that explains the recordings best.

    Where several named effects were needed, they may be stand-ins for one thing without a
    name: if a single term does half as well from the baseline, the search begins again
    with it, and the better of the two ends counts.
    """
    late = with_delays(base)
    found = _climbed(base, (), late, lambda f: report(0.7 * f))
    assert found is not None
    if all(any(sways_far(f) for f in m.parts) for m in (found.model, base)):
        other = _climbed(steadied(base), (), late, lambda f: report(0.7 + 0.2 * f))
        if other is not None and advantage(other, found) > 0.0:
            found = replace(other, alone=found.alone)
    named = [e for e in found.model.effects if "+=" not in e.id]
    several = len(named) > 1 or any(e.process is not None for e in named)
    if several or any(e.observation_error for e in named):
        # (of the heading alone: a scan of few terms)
        term = best_term(base, imu=several)
        first = found.first or found.space
        whole = (first.score(best_set(first)) - first.quadratic.a) / first.quadratic.worth
        if term is not None and term.gain > HALF * whole:
            other = _climbed(base, [term], late, lambda f: report(0.7 + 0.3 * f))
            if other is not None and advantage(other, found) > 0.0:
                found = replace(other, alone=found.alone)
    return found


def advantage(a: Found, b: Found) -> float:
    """Nats by which one end of a search is likelier than another, prior odds included."""
    worth = min(a.space.quadratic.worth, b.space.quadratic.worth)
    return worth * (a.model.log_evidence - b.model.log_evidence) + _odds(a) - _odds(b)


def _odds(found: Found) -> float:
    odds = 0.0
    for e in found.model.effects:
        odds += TERM_PRIOR if "+=" in e.id else PRIOR
        odds -= OCCAM_LEVEL * len(e.levels)
    return odds


def _climbed(
    base: Model,
    needed: Sequence[Term],
    late: Sequence[Model],
    report: Callable[[float], None],
) -> Found | None:
    """The end of a climb from the baseline; None if it would begin without the terms needed.

    late: the baseline with delays that no scan of it would find.
    """
    cases = [f.case for f in base.parts]
    model = base
    alone: dict[str, float] = {}
    first: Space | None = None
    noise: dict[str, float] = {}
    visited: set[frozenset[str]] = set()
    dropped: set[str] = set()
    favoured: set[str] = set()
    swaps: dict[tuple[str, str], float] = {}
    ordered: set[tuple[str, frozenset[str]]] = set()
    unnamed, shaped, stale = list(needed), set[str](), set[str]()
    suspects = set[str]()
    for turn in range(ROUNDS + 2 * MAX_TERMS):
        report(min(0.95, 0.15 + 0.1 * turn))
        where = _scanned(model, cases, [t.effect for t in unnamed], dropped, favoured)
        if first is None:
            first, alone = where, gains(where, frozenset())
        now = model.chosen
        chosen = max((best_set(where, now), best_set(where, ())), key=where.score)
        if turn == 0 and any(t.effect.id not in chosen for t in needed):
            return None
        if turn == 0:
            worth = where.quadratic.worth
            better = [m for m in late if worth * (m.log_evidence - model.log_evidence) > -PRIOR]
            if better:
                model = better[0]
                continue
        if chosen != now and chosen not in visited and not _same(where, now, chosen):
            visited.add(chosen)
            larger = _grown(model, where, now, chosen, dropped)
            if larger is not None:
                model = larger
                swaps.clear()  # (they hold beside the same others only)
            continue
        other = reshaped(model, unnamed, shaped)
        if other is not None:
            model = other
            continue
        swapped = _exchanged(model, where, dropped, swaps, frozenset(base.ids))
        if swapped is not None:
            model = swapped
            continue
        reordered = _reordered(model, ordered)
        if reordered is not None:
            model = reordered
            continue
        processes = _noise_step(model, noise, where.quadratic.worth, dropped)
        if processes is not None:
            model, visited = processes, set()
            continue
        leaner = _leaner(model, where, noise, stale)
        if leaner is not None:
            dropped |= {name_of(i) for i in set(model.ids) - set(leaner.ids)}
            model = leaner
            continue
        freed = without_alibi(model, where.quadratic.worth, suspects)
        if freed is not None:
            dropped -= {name_of(i) for i in freed.ids}
            model, visited = freed, set()
            continue
        if len(unnamed) >= MAX_TERMS:
            break
        split = _split(model, where)
        if split is not None:
            favoured.add(split)
            visited = set()
            continue
        term = best_term(model, refused=dropped)
        if term is None:
            break
        unnamed.append(term)
        visited = set()
        stale |= set(noise)  # (what noise effects gained was weighed without the term)
    return Found(model, where, alone, noise, swaps, first)


def _same(where: Space, now: frozenset[str], chosen: frozenset[str]) -> bool:
    """Whether only a moment would move, for less than a nat."""
    if {name_of(i) for i in now} != {name_of(i) for i in chosen}:
        return False
    return where.score(chosen) - where.score(now) < 1.0


def _split(model: Model, where: Space) -> str | None:
    """The simpler effect that an exclusive one mostly is (an arm that all axes share).

    Alone, the larger effect holds the simpler one too, and evidence hardly tells whether they
    are one or two; where the common part is by far the larger, they are two.
    """
    for e in model.effects:
        if e.together is None or set(e.exclusive) & set(model.ids):
            continue
        u = model.u[[i for i, n in enumerate(model.quadratic.names) if n[0] == e.id]]
        own = e.together @ u
        simple = next((i for i in e.exclusive if i in where.effects), None)
        if simple and np.linalg.norm(u - own) > COMMON * np.linalg.norm(own):
            return simple
    return None


def _scanned(
    model: Model,
    cases: Sequence[Case],
    unnamed: Sequence[Effect],
    dropped: set[str],
    favoured: set[str],
) -> Space:
    own = {e.id: e for e in model.effects}
    options = [own.get(e.id, e) for e in (*candidates(cases, model.effects), *unnamed)]
    have = {e.id for e in options}
    options += [e for e in model.effects if e.id not in have and e.process is None]
    odds = priors(options) | {e.id: REFUSED for e in options if name_of(e.id) in dropped}
    odds |= dict.fromkeys(favoured, FAVOURED)
    return space(scan(model, options), options, odds)


def _fit(model: Model, where: Space, chosen: frozenset[str]) -> Model:
    processes = [e for e in model.effects if e.process is not None]
    return fitted(model.parts, [*(where.effects[i] for i in sorted(chosen)), *processes])


def _grown(
    model: Model, where: Space, now: frozenset[str], chosen: frozenset[str], dropped: set[str]
) -> Model | None:
    """The model with the chosen effects, or with the best of those added if no fit with all of
    them holds; an effect with which none does is not looked at again."""
    for wanted in (chosen, *_singles(where, now, chosen)):
        tried = _fit(model, where, wanted)
        if tried.log_evidence > model.log_evidence - LOST:
            return tried
        if len(wanted - now) == 1:
            dropped |= {name_of(i) for i in wanted - now}
    return None


def _singles(where: Space, now: frozenset[str], chosen: frozenset[str]) -> list[frozenset[str]]:
    added = chosen - now
    return [max((now | {i} for i in added), key=where.score)] if len(added) > 1 else []


def _noise_step(
    model: Model, noise: dict[str, float], worth: float, dropped: set[str]
) -> Model | None:
    """The model with the noise effect that gains most, if one does; or the same fitted anew, if
    that was what the noise effect gained by."""
    best: Model | None = None
    added: Effect | None = None
    have = set(model.ids)
    for effect in catalogue().values():
        if effect.process is None or effect.id in have | dropped:
            continue
        if not any(applicable(f.case, effect) for f in model.parts):
            continue
        if not any(_worth_a_look(f, (*model.effects, effect), effect) for f in model.parts):
            continue
        tried = fitted(model.parts, (*model.effects, effect), noise_rounds=1)
        gain = worth * (tried.log_evidence - model.log_evidence)
        gain -= OCCAM_LEVEL * len(effect.levels)
        if gain + PRIOR > 0.0 and (best is None or tried.log_evidence > best.log_evidence):
            best, added = tried, effect
    if best is None or added is None:
        return None
    without = fitted(best.parts, model.effects, noise_rounds=1)
    if without.log_evidence < model.log_evidence:
        without = model
    gain = worth * (best.log_evidence - without.log_evidence) - OCCAM_LEVEL * len(added.levels)
    if gain + PRIOR <= 0.0:
        return without if without is not model else None
    noise[added.id] = gain
    return best


def _worth_a_look(f: Fitted, effects: Sequence[Effect], effect: Effect) -> bool:
    """Whether the evidence rises with this noise at one of a few sizes, all else kept."""
    here = reduced_pass(reduce(f.linear), f.levels).log_evidence
    wide = moved_to(f, effects)
    reduction = reduce(wide.linear)
    for scale in (0.1, 1.0, 3.0):
        levels = dict(wide.levels)
        levels[effect.levels[0].name] = scale * effect.levels[0].initial
        if reduced_pass(reduction, levels).log_evidence > here + LOOK:
            return True
    return False


def _exchanged(
    model: Model,
    where: Space,
    dropped: set[str],
    swaps: dict[tuple[str, str], float],
    kept: frozenset[str],
) -> Model | None:
    """The model with an effect's closest rival in its place, if that fits better.

    Two effects may be one to the first order (a low pass of the gyro, an early
    accelerometer); about a fit with one of them the other cannot be judged, so it is fitted.
    """
    have = {name_of(i) for i in model.ids}
    now = model.chosen
    gained = gains(where, now)
    for e in model.effects:
        # (what was in the baseline is taken off the readings already)
        if e.id not in now or e.id in kept or len(swaps) >= MOST_SWAPS:
            continue
        if gained[e.id] < -PRIOR:
            continue
        # what a rival would do of all that the effect does
        near = {i: 1.0 + v / gained[e.id] for i, v in rivals(where, now, e.id).items()}
        near = {i: v for i, v in near.items() if i in catalogue() and i != e.id}
        near = {i: v for i, v in near.items() if v > NEARLY or akin(e.id, i)}
        near = {i: v for i, v in near.items() if i not in have | dropped}
        # (what holds this effect and more is not in its place, but beside it)
        near = {i: v for i, v in near.items() if e.id not in catalogue()[i].exclusive}
        near = {i: v for i, v in near.items() if (e.id, i) not in swaps}
        if not near:
            continue
        rival = max(near, key=lambda i: near[i])
        others = [x for x in model.effects if x.id != e.id]
        tried = fitted(model.parts, [*others, catalogue()[rival]])
        worse = where.quadratic.worth * (model.log_evidence - tried.log_evidence)
        swaps[e.id, rival], swaps[rival, e.id] = worse, -worse
        if worse < 0.0:
            return tried
        # the wrong one of the two may need a weak third, which the right one does not
        weakest = min((x for x in others if x.id in now), key=lambda x: gained[x.id], default=None)
        if weakest is not None and worse < -2.0 * PRIOR and gained[weakest.id] < WEAK:
            rest = [x for x in others if x is not weakest]
            fewer = fitted(model.parts, [*rest, catalogue()[rival]])
            if where.quadratic.worth * (fewer.log_evidence - model.log_evidence) - PRIOR > 0.0:
                return fewer
    return None


def akin(a: str, b: str) -> bool:
    """Whether two effects are the same to the first order."""
    known = catalogue()
    return a in known and (b in known[a].akin or a in known[b].akin)


def _reordered(model: Model, seen: set[tuple[str, frozenset[str]]]) -> Model | None:
    """The model with a filter or a delay on the other side of the other errors, if that fits
    better: in the sensor they come one after the other, and nobody tells in which order."""
    for e in model.effects:
        key = e.id, frozenset(model.ids)
        beside = [x for x in model.effects if x.imu_error is not None and x.id != e.id]
        if e.imu_inverse is None or not beside or key in seen:
            continue
        seen.add(key)
        turned = [replace(x, last=not x.last) if x is e else x for x in model.effects]
        tried = fitted(model.parts, turned)
        if tried.log_evidence > model.log_evidence:
            return tried
    return None


def _leaner(model: Model, where: Space, noise: dict[str, float], stale: set[str]) -> Model | None:
    """The model without an effect that it does not miss when all else is fitted again; stale:
    noise effects whose gain is out of date."""
    gained = gains(where, model.chosen)
    excess = inflation(model)
    last = {i: 0.0 if i in stale else v for i, v in noise.items()}
    weakest = sorted(model.effects, key=lambda e: gained.get(e.id, last.get(e.id, 0.0)))
    for e in weakest[:FEW]:
        rest = [x for x in model.effects if x.id != e.id]
        if e.process is None:
            more = max(1.0, excess[e.id] * where.quadratic.worth)
            if gained[e.id] / more + where.prior[e.id] < 0.0:
                return fitted(model.parts, rest)
            if gained[e.id] > CLOSE:
                continue
        elif last.get(e.id, 0.0) > 10.0 * CLOSE:
            continue
        without = fitted(model.parts, rest)
        occam = OCCAM_LEVEL * len(e.levels) if e.process is not None else 0.0
        prior = where.prior.get(e.id, PRIOR)
        gain = where.quadratic.worth * (model.log_evidence - without.log_evidence) - occam
        if e.process is not None:
            noise[e.id] = gain
            stale.discard(e.id)
        if gain + prior < 0.0:
            noise.pop(e.id, None)
            return without
    return None

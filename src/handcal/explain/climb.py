"""The climb from a model to one that explains more: scan, take a step, fit again.

One step, one function: it returns the model to go on from, or None where there is nothing to
do, and the first that does something ends the turn. The climb ends where none does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.beside import side_by_side
from handcal.estimate.case import applicable, frozen_at, name_of
from handcal.estimate.fit import fitted, scan
from handcal.estimate.model import Fitted, Model
from handcal.estimate.robust import inflation
from handcal.explain.budget import Budget
from handcal.explain.jumps import sudden
from handcal.explain.noises import all_noise, looks_of, of_looks, on_fewer_axes
from handcal.explain.score import MOMENTS, PRIOR, better, prior, score
from handcal.explain.space import Space, best_set, gains, rivals, space
from handcal.explain.stand_ins import without_stand_in
from handcal.explain.unnamed.best import Term, best_term, reshaped
from handcal.explain.unnamed.laws import effect_of, law_of
from handcal.types import Array

# Turns of a climb at the most, beside two for each term that may be named.
ROUNDS = 8
# An effect whose gain is less than this is fitted without, to be sure.
CLOSE = 20.0
MAX_TERMS = 3
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


@dataclass
class Climb:
    """A model on its way up, and what was tried.

    needed: terms without which the climb is of no use; late: the baseline with delays that no
    scan of it would find. where: the last scan; alone: what the catalogue's
    effects gained in the first one; noise: log-evidence gained by each noise effect in the model,
    and stale: those for which that is out of date; swaps: (effect, rival) to the nats by which
    the rival, fitted in its place, does worse. dropped: names of what was not missed, or with
    which no fit holds; beyond: of what came out larger than makes sense beside the same others.
    """

    model: Model
    needed: Sequence[Term]
    late: Sequence[Model]
    budget: Budget = field(default_factory=Budget)
    where: Space = field(init=False)
    alone: dict[str, float] = field(init=False)
    noise: dict[str, float] = field(default_factory=dict)
    stale: set[str] = field(default_factory=set)
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)
    dropped: set[str] = field(default_factory=set)
    beyond: set[str] = field(default_factory=set)
    visited: set[frozenset[str]] = field(default_factory=set)
    refused: set[frozenset[str]] = field(default_factory=set)
    ordered: set[tuple[str, frozenset[str]]] = field(default_factory=set)
    shaped: set[str] = field(default_factory=set)
    suspects: set[str] = field(default_factory=set)
    thinned: set[frozenset[str]] = field(default_factory=set)
    whole: set[str] = field(default_factory=set)
    noises: set[tuple[str, frozenset[str]]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.kept = frozenset(self.model.ids)
        self.far = tuple(self.late)
        self.unnamed = list(self.needed)

    @property
    def worth(self) -> float:
        """What evidence counts for, at the last scan."""
        return self.where.quadratic.worth


def climbed(c: Climb, report: Callable[[float], None]) -> bool:
    """Climb as far as it goes; False where that would begin without the terms needed."""
    for turn in range(ROUNDS + 2 * MAX_TERMS):
        report(min(0.95, 0.15 + 0.1 * turn))
        c.where = _scanned(c)
        if turn == 0:
            c.alone = gains(c.where, frozenset())
            if any(t.effect.id not in _favourite(c) for t in c.needed):
                return False
        model = next((m for step in _STEPS if (m := _taken(c, step)) is not None), None)
        if model is None:
            break
        c.model = model
    else:
        # (out of turns: what is said of the model is said by a scan about it)
        c.where = _scanned(c)
    return True


def _taken(c: Climb, step: Callable[[Climb], Model | None]) -> Model | None:
    """Where a step leads, if there is time for it."""
    return None if c.budget.spent(_STEPS[step]) else step(c)


def candidates(parts: Sequence[Fitted], present: Sequence[Effect]) -> list[Effect]:
    """Effects with parameters that at least one recording could show; a step at moments all over
    the recording, near the moment where it is already, and where a reading was least expected."""
    out: list[Effect] = []
    cases = [f.case for f in parts]
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
            grid = _near(effect, grid, present)
            if effect.observation_error:
                grid = _with(grid, sudden(parts[0], effect.observation_error.keys()))
            out += [frozen_at(effect, m) for m in grid]
    return out


def _near(effect: Effect, grid: Array, present: Sequence[Effect]) -> Array:
    """The grid of moments, or a finer one about the moment that is in the model."""
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


def _with(grid: Array, at: Array) -> Array:
    """The grid (k, p) with further moments (m,), in their order."""
    column = int(np.flatnonzero(grid[0])[0])
    more = np.zeros((len(at), grid.shape[1]))
    more[:, column] = at
    out = np.vstack([grid, more[[not _on(grid[:, column], x) for x in at]]])
    return out[np.argsort(out[:, column])]


def _on(grid: Array, at: float) -> bool:
    return bool(np.min(np.abs(grid - at)) < 2e-3)


def _scanned(c: Climb) -> Space:
    own = {e.id: e for e in c.model.effects}
    cases = [f.case for f in c.model.parts]
    terms = [t.effect for t in c.unnamed]
    options = [own.get(e.id, e) for e in (*candidates(c.model.parts, c.model.effects), *terms)]
    have = {e.id for e in options}
    options += [e for e in c.model.effects if e.id not in have and e.process is None]
    odds = {e.id: prior(e, cases) for e in options}
    odds |= {e.id: REFUSED for e in options if name_of(e.id) in c.dropped | c.beyond}
    odds |= {e.id: -REFUSED for e in options if e.always}
    return space(scan(c.model, options), options, odds)


def _favourite(c: Climb) -> frozenset[str]:
    """The set of effects that the last scan likes best."""
    starts = (c.model.chosen, ())
    return max((best_set(c.where, start) for start in starts), key=c.where.score)


def _delay(c: Climb) -> Model | None:
    """A delay that no scan finds, before anything else: it looks like many things."""
    late, c.late = c.late, ()
    best = max(late, key=lambda m: m.log_evidence, default=None)
    return None if best is None or better(best, c.model, c.worth) <= 0.0 else best


def _choose(c: Climb) -> Model | None:
    """The effects that the scan likes best, fitted, if such a fit holds; where one of them came out
    larger than makes sense, those that it likes best without that one."""
    now = c.model.chosen
    for _ in range(FEW):
        chosen, known = _favourite(c), len(c.beyond)
        if chosen == now or chosen in c.visited or _same(c.where, now, chosen):
            return None
        c.visited.add(chosen)
        larger = _grown(c, chosen)
        if larger is not None:
            c.swaps.clear()  # (they hold beside the same others only)
            c.refused.clear()
            c.beyond.clear()
            return larger
        if len(c.beyond) == known:
            return None
        odds = {i: REFUSED if name_of(i) in c.beyond else p for i, p in c.where.prior.items()}
        c.where = replace(c.where, prior=odds, scores={})
    return None


def _same(where: Space, now: frozenset[str], chosen: frozenset[str]) -> bool:
    """Whether only a moment would move, for less than a nat."""
    if {name_of(i) for i in now} != {name_of(i) for i in chosen}:
        return False
    return where.score(chosen) - where.score(now) < 1.0


def _fit(c: Climb, chosen: frozenset[str]) -> Model:
    processes = [e for e in c.model.effects if e.process is not None]
    return fitted(c.model.parts, [*(c.where.effects[i] for i in sorted(chosen)), *processes])


def _grown(c: Climb, chosen: frozenset[str]) -> Model | None:
    """The model with the chosen effects, or with the best of those added, if such a fit is
    likelier than the one there is; an effect with which no fit holds is not looked at again."""
    now = c.model.chosen
    for wanted in (chosen, *_singles(c.where, now, chosen)):
        if wanted in c.refused:
            continue
        tried = _fit(c, wanted)
        if likelier(c, tried):
            return tried
        c.refused.add(wanted)
        if large := too_large(tried) - {name_of(i) for i in now}:
            c.beyond |= large
            return None
        if len(wanted - now) == 1 and tried.log_evidence < c.model.log_evidence - LOST:
            c.dropped |= {name_of(i) for i in wanted - now}
    return None


def likelier(c: Climb, tried: Model) -> bool:
    """Whether a model's score is above that of the one there is; what no device has is no fit."""
    return sensible(tried) and better(tried, c.model, c.worth) > 0.0


def sensible(model: Model) -> bool:
    """Whether no parameter is larger than makes sense."""
    return not too_large(model)


def too_large(model: Model) -> set[str]:
    """Names of the effects of which a parameter is larger than makes sense."""
    known = {(e.id, p.name): p for e in model.effects for p in e.parameters}
    return {
        name_of(n[0])
        for n, u in zip(model.quadratic.names, model.u, strict=True)
        if abs(u) * known[n].prior_sigma > known[n].most
    }


def _singles(where: Space, now: frozenset[str], chosen: frozenset[str]) -> list[frozenset[str]]:
    added = chosen - now
    return [max((now | {i} for i in added), key=where.score)] if len(added) > 1 else []


def _reshape(c: Climb) -> Model | None:
    """A course over time or direction, chosen again."""
    return reshaped(c.model, c.worth, c.unnamed, c.shaped)


def _narrow(c: Climb) -> Model | None:
    """The model with a law on fewer axes, if it does not miss the one where it adds least: far
    from where a law is large a scan cannot tell what it adds there."""
    for i, term in enumerate(c.unnamed):
        old, law = term.effect, law_of(term.effect)
        if law is None or not law.each or old.id not in c.model.ids or old.id in c.whole:
            continue
        c.whole.add(old.id)
        mine = [k for k, n in enumerate(c.model.quadratic.names) if n[0] == old.id]
        sizes = np.abs(c.model.u[mine]).reshape(len(law.axes), -1).sum(axis=1)
        axes = tuple(a for k, a in enumerate(law.axes) if k != int(np.argmin(sizes)))
        new = effect_of(replace(law, axes=axes, each=len(axes) > 1))
        tried = fitted(c.model.parts, [new if e is old else e for e in c.model.effects])
        if likelier(c, tried):
            c.unnamed[i] = replace(term, effect=new)
            c.shaped.add(new.id)
            return tried
    return None


def _exchange(c: Climb) -> Model | None:
    """The model with an effect's closest rival in its place, if that fits better.

    Two effects may be one to the first order (a low pass of the gyro, an early
    accelerometer); about a fit with one of them the other cannot be judged, so it is fitted.
    """
    model, where = c.model, c.where
    gained = gains(where, model.chosen)
    pairs = _rivalries(c, gained)

    def exchanged(e: Effect, rival: str) -> Model:
        # (a delay may have to be begun where the grid found it)
        begin = next((m.parts for m in c.far if rival in m.ids), model.parts)
        return fitted(begin, [*(x for x in model.effects if x is not e), catalogue()[rival]])

    fits = side_by_side(partial(exchanged, *pair) for pair in pairs)
    for (e, rival), tried in zip(pairs, fits, strict=True):
        worse = better(model, tried, c.worth)
        c.swaps[e.id, rival], c.swaps[rival, e.id] = worse, -worse
        if worse < 0.0:
            return tried
        # the wrong one of the two may need a weak third, which the right one does not
        others = [x for x in model.effects if x is not e]
        weakest = min(
            (x for x in others if x.id in model.chosen and not x.always),
            key=lambda x: gained[x.id],
            default=None,
        )
        if weakest is not None and worse < -2.0 * PRIOR and gained[weakest.id] < WEAK:
            rest = [x for x in others if x is not weakest]
            fewer = fitted(model.parts, [*rest, catalogue()[rival]])
            if likelier(c, fewer):
                return fewer
    return None


def _rivalries(c: Climb, gained: Mapping[str, float]) -> list[tuple[Effect, str]]:
    """Effects of the model, each with the rival that would do most of what it does."""
    have, now = {name_of(i) for i in c.model.ids}, c.model.chosen
    pairs: list[tuple[Effect, str]] = []
    tried = set(c.swaps)
    for e in c.model.effects:
        # (what was in the baseline is taken off the readings already)
        if e.id not in now or e.id in c.kept or len(tried) >= MOST_SWAPS:
            continue
        if gained[e.id] < -PRIOR:
            continue
        # what a rival would do of all that the effect does
        near = {i: 1.0 + v / gained[e.id] for i, v in rivals(c.where, now, e.id).items()}
        near = {i: v for i, v in near.items() if i in catalogue() and i != e.id}
        near = {i: v for i, v in near.items() if v > NEARLY or akin(e.id, i)}
        near = {i: v for i, v in near.items() if i not in have | c.dropped}
        # (what holds this effect and more is not in its place, but beside it)
        near = {i: v for i, v in near.items() if e.id not in catalogue()[i].exclusive}
        near = {i: v for i, v in near.items() if (e.id, i) not in tried}
        if near:
            rival = max(near, key=lambda i: near[i])
            pairs.append((e, rival))
            tried |= {(e.id, rival), (rival, e.id)}
    return pairs


def akin(a: str, b: str) -> bool:
    """Whether two effects are the same to the first order."""
    one, other = catalogue().get(a), catalogue().get(b)
    return one is not None and other is not None and (b in one.akin or a in other.akin)


def _reorder(c: Climb) -> Model | None:
    """A filter or a delay on the other side of the other errors, if that fits better: in the
    sensor they come one after the other, and nobody tells in which order."""
    model = c.model
    for e in model.effects:
        key = e.id, frozenset(model.ids)
        beside = [x for x in model.effects if x.imu_error is not None and x.id != e.id]
        if e.imu_inverse is None or not beside or key in c.ordered:
            continue
        c.ordered.add(key)
        turned = [replace(x, last=not x.last) if x is e else x for x in model.effects]
        tried = fitted(model.parts, turned)
        if tried.log_evidence > model.log_evidence:
            return tried
    return None


def _add_noise(c: Climb) -> Model | None:
    """The model with the noise effect that gains most, if one does; or the same fitted anew, if
    that was what the noise effect gained by."""
    model, worth = c.model, c.worth
    have = {*model.ids, *c.dropped}
    looks = looks_of(model.parts, model.effects, [e for e in all_noise() if e.id not in have])
    tried = [(m, e) for m, e in of_looks(looks[:FEW]) if better(m, model, worth) > 0.0]
    if not tried:
        return None
    best, added = on_fewer_axes(*max(tried, key=lambda pair: score(pair[0], worth)), worth)
    without = fitted(best.parts, model.effects, noise_rounds=1)
    if without.log_evidence < model.log_evidence:
        without = model
    gain = better(best, without, worth)
    if gain > 0.0:
        c.noise[added.id] = gain - PRIOR
    elif without is model:
        return None
    else:
        best = without
    c.visited.clear()
    return best


def _exchange_noise(c: Climb) -> Model | None:
    """The model with another noise effect in the place of one on the same reading, if that is
    likelier: what was taken for a walk may go with the motion."""
    model = c.model
    for old in [e for e in model.effects if e.process is not None]:
        rest = [e for e in model.effects if e is not old]
        key = frozenset(e.id for e in rest)
        rivals = [
            e
            for e in all_noise()
            if (e.walks, [*e.observation_error]) == (old.walks, [*old.observation_error])
            and e.id not in {*model.ids, *c.dropped}
            and (e.id, key) not in c.noises
        ]
        c.noises |= {(e.id, key) for e in (old, *rivals)}
        looks = looks_of(model.parts, rest, rivals)
        tried = [(m, e) for m, e in of_looks(looks[:1]) if likelier(c, m)]
        if tried:
            best, new = on_fewer_axes(*tried[0], c.worth)
            c.noise[new.id] = c.noise.pop(old.id, 0.0) + better(best, model, c.worth)
            c.stale.add(new.id)
            c.visited.clear()
            return best
    return None


def _thin(c: Climb) -> Model | None:
    """The model without an effect that it does not miss when all else is fitted again."""
    model, where = c.model, c.where
    gained = gains(where, model.chosen)
    excess = inflation(model)
    last = {i: 0.0 if i in c.stale else v for i, v in c.noise.items()}
    weakest = sorted(model.effects, key=lambda e: gained.get(e.id, last.get(e.id, 0.0)))

    def rest(e: Effect) -> list[Effect]:
        return [x for x in model.effects if x is not e]

    tried: list[Effect] = []
    for e in [e for e in weakest if not e.always][:FEW]:
        if e.process is None:
            more = max(1.0, excess[e.id] * c.worth)
            if gained[e.id] / more + where.prior[e.id] < 0.0:
                c.dropped.add(name_of(e.id))
                return fitted(model.parts, rest(e))
            if gained[e.id] <= CLOSE:
                tried.append(e)
        elif last.get(e.id, 0.0) <= 10.0 * CLOSE:
            tried.append(e)
    fits = side_by_side(partial(fitted, model.parts, rest(e)) for e in tried)
    for e, without in zip(tried, fits, strict=True):
        gain = better(model, without, c.worth)
        if e.process is not None:
            c.noise[e.id] = gain - PRIOR
            c.stale.discard(e.id)
        if gain < 0.0:
            c.noise.pop(e.id, None)
            c.dropped.add(name_of(e.id))
            return without
    return None


def _free(c: Climb) -> Model | None:
    """What noise stands in for, in its place."""
    other = without_stand_in(c.model, c.worth, c.suspects)
    if other is None or not sensible(other):
        return None
    c.dropped -= {name_of(i) for i in other.ids}
    c.visited.clear()
    return other


def _instead(c: Climb) -> Model | None:
    """The model with its laws without a name in the place of many effects with one, noise
    included, if that scores better: what is left out is told by the quadratic, and fitted."""
    model, laws = c.model, [e for e in c.model.effects if _is_law(e)]
    key = frozenset(model.ids)
    if not laws or key in c.thinned or len(model.effects) == len(laws):
        return None
    c.thinned.add(key)
    quiet = [e for e in model.effects if e.process is None]
    bare = model if len(quiet) == len(model.effects) else fitted(model.parts, quiet)
    kept = {e.id for e in laws} | {e.id for e in quiet if e.always}
    wanted = _fewest(bare, kept)
    for ids in dict.fromkeys((wanted, frozenset(kept))):
        if ids == key:
            continue
        tried = fitted(bare.parts, [e for e in quiet if e.id in ids])
        if likelier(c, tried):
            _forget(c, tried)
            return tried
    if bare is not model and likelier(c, bare):
        _forget(c, bare)
        return bare
    return None


def _is_law(e: Effect) -> bool:
    return "+=" in e.id and e.process is None


def _fewest(model: Model, kept: Set[str]) -> frozenset[str]:
    """The best of the sets that are left when one effect after another, the least missed each
    time, is taken out of the model, down to those that are kept."""
    own = [e for e in model.effects if e.process is None]
    cases = [f.case for f in model.parts]
    where = space(scan(model, own), own, {e.id: prior(e, cases) for e in own})
    now = frozenset(e.id for e in own)
    sets = [now]
    while now - kept:
        now = max((now - {i} for i in sorted(now - kept)), key=where.score)
        sets.append(now)
    return max(sets, key=where.score)


def _forget(c: Climb, model: Model) -> None:
    """Let what was weighed beside effects that are gone be weighed anew."""
    c.noise = {i: v for i, v in c.noise.items() if i in model.ids}
    c.visited.clear()
    c.swaps.clear()
    c.stale |= set(c.noise)


def _name_term(c: Climb) -> Model | None:
    """The same, a term that nobody named on trial from now on; or the model with one in the place
    of its noise effects, which hide whatever has no name, or beside them."""
    if len(c.unnamed) >= MAX_TERMS:
        return None
    term = best_term(c.model, refused=c.dropped)
    if term is not None:
        c.unnamed.append(term)
        c.visited.clear()
        c.stale |= set(c.noise)  # (what noise effects gained was weighed without the term)
        return c.model
    key = frozenset(c.model.ids)
    quiet = [e for e in c.model.effects if e.process is None]
    if len(quiet) == len(c.model.effects) or key in c.thinned:
        return None
    if {e.id for e in quiet} == c.kept:
        return None  # (from the baseline alone a climb begins with a law anyway)
    c.thinned.add(key)
    bare = fitted(c.model.parts, quiet)
    term = best_term(bare, refused=c.dropped)
    if term is None:
        return None
    calls = (partial(fitted, m.parts, (*m.effects, term.effect)) for m in (bare, c.model))
    tried = max(side_by_side(calls), key=lambda m: score(m, c.worth))
    if not likelier(c, tried):
        return None
    c.unnamed.append(term)
    _forget(c, tried)
    return tried


# The cheap ones first; nothing is taken away or left without a name before all else rests.
# Each with what is left untried where there is no time for it.
_STEPS: dict[Callable[[Climb], Model | None], str] = {
    _delay: "long delays",
    _choose: "further effects",
    _instead: "one law in the place of several names",
    _reshape: "other forms of a law",
    _narrow: "laws on fewer axes",
    _exchange: "similar effects in the place of those that were found",
    _reorder: "filters in another order",
    _add_noise: "noise effects",
    _exchange_noise: "noise that goes with the motion",
    _thin: "the fit without its weakest effects",
    _free: "the fit without what noise may stand in for",
    _name_term: "laws that have no name",
}

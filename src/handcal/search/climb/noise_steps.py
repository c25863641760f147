"""Steps of a climb about noise effects: add one, exchange one, put in its place what it stands in
for."""

from __future__ import annotations

from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.score import PRIOR, better, score
from handcal.search.climb.state import FEW, WEAK, Climb, likelier, sensible
from handcal.search.confounding import without_confounding
from handcal.search.noise_scan import LOOK, all_noise, looks_of, of_looks, on_fewer_axes
from handcal.search.space import gains


def add_noise(c: Climb) -> Model | None:
    """The model with the noise effect that gains most, if one does; or the same fitted anew, if
    that was what the noise effect gained by."""
    model, worth = c.model, c.worth
    have = {*model.ids, *c.dropped}
    looks = looks_of(model.parts, model.effects, [e for e in all_noise() if e.id not in have], FEW)
    tried = [(m, e) for m, e in of_looks(looks) if better(m, model, worth) > 0.0]
    if not tried:
        return None
    best, added = on_fewer_axes(*max(tried, key=lambda pair: score(pair[0], worth)), worth)
    without = fitted(best.parts, model.effects, noise_rounds=1)
    if without.log_evidence < model.log_evidence:
        without = model
    gain = better(best, without, worth)
    if gain > 0.0:
        c.noise[added.id] = gain - PRIOR
        if c.kept < without.chosen == set(without.ids):
            c.quiet = without
    elif without is model:
        return None
    else:
        best = without
    c.visited.clear()
    return best


def exchange_noise(c: Climb) -> Model | None:
    """The model with another noise effect in the place of one on the same reading, if that is
    likelier: what was taken for a walk may go with the motion."""
    model = c.model
    for old in [e for e in model.effects if e.process is not None]:
        rest = [e for e in model.effects if e is not old]
        key = frozenset(e.id for e in rest)
        rivals = [
            e
            for e in all_noise()
            if (e.walks, e.acts_on) == (old.walks, old.acts_on)
            and e.id not in {*model.ids, *c.dropped}
            and (e.id, key) not in c.noises
        ]
        # (what another took the place of beside more effects may come back, once)
        c.noises |= {(e.id, key) for e in rivals}
        looks = looks_of(model.parts, rest, rivals, 1)
        tried = [(m, e) for m, e in of_looks(looks) if likelier(c, m)]
        if tried:
            best, new = on_fewer_axes(*tried[0], c.worth)
            c.noise[new.id] = c.noise.pop(old.id, 0.0) + better(best, model, c.worth)
            c.stale.add(new.id)
            c.visited.clear()
            return best
    return None


def noise_instead(c: Climb) -> Model | None:
    """The model with a bias that walks in the place of a weak effect on the readings, if that is
    likelier: for a minute a walk may look like what goes with the temperature."""
    model, gained = c.model, gains(c.where, c.model.chosen)
    walks = [e for e in all_noise() if e.walks and not e.passing]
    for old in model.effects:
        rest = [e for e in model.effects if e is not old]
        key = old.id, frozenset(e.id for e in rest)
        weak = old.imu_error is not None and gained.get(old.id, WEAK) < WEAK
        rivals = [e for e in walks if e.id not in {*model.ids, *c.dropped}]
        if not weak or old.id in c.kept or key in c.noises:
            continue
        c.noises.add(key)
        looks = looks_of(model.parts, rest, rivals, 1)
        # (a walk explains any slow thing a little: odds of 20 to 1 against what has a cause)
        tried = [x for x in of_looks(looks) if better(x[0], model, c.worth) > LOOK]
        if tried and sensible(tried[0][0]):
            best, new = tried[0]
            c.noise[new.id] = better(best, model, c.worth) + gained[old.id]
            c.stale.add(new.id)
            c.visited.clear()
            return best
    return None


def free(c: Climb) -> Model | None:
    """What noise stands in for, in its place."""
    other = without_confounding(c.model, c.worth, c.suspects)
    if other is None or not sensible(other):
        return None
    c.dropped -= {name_of(i) for i in other.ids}
    c.visited.clear()
    return other

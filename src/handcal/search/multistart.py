"""The search for what is missing: where its climbs begin, and which end counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.baseline import started
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.laws.best_law import Term, best_term, survey
from handcal.laws.first_look import Vocabulary
from handcal.model_score import better
from handcal.search.budget import Budget
from handcal.search.climb.candidates import scanned
from handcal.search.climb.exchange_steps import lateness
from handcal.search.climb.sequence import climbed
from handcal.search.climb.state import WEAK, Climb, Report, part_of
from handcal.search.space import Space, gains
from handcal.search.wide_sway import steadied, sways_far
from handcal.types import HandcalError

# What a single term has to gain, of all that was found, for a second climb to begin with it.
HALF = 0.5
# A noise level beyond this share of the largest that there is stands at its end.
END = 0.99
# In a fit a third of the innovations lie beyond their own sigma. Where half of them do (their
# median square, in variances), noise levels could not follow what is wrong.
MISFIT = 1.0


@dataclass(frozen=True)
class Found:
    """Where the search ended: the final model, the space of the last scan, and
    what the catalogue's effects gained over the baseline alone; noise: log-evidence gained by
    each noise effect in the model; swaps: (effect, rival) to the nats by which the rival, fitted
    in its place, does worse; named: the model with which it began to look for laws."""

    model: Model
    space: Space
    alone: dict[str, float]
    noise: dict[str, float]
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)
    named: Model | None = None


@dataclass(frozen=True)
class _Common:
    """What all climbs of a search have in common: see ``Climb`` and ``search``."""

    refused: Set[str]
    budget: Budget
    vocabulary: Vocabulary = field(default_factory=Vocabulary)
    fruitless: dict[tuple[str, frozenset[str]], float] = field(default_factory=dict)


def search(
    base: Model,
    report: Report = lambda _, __: None,
    refused: Set[str] = frozenset(),
    budget: Budget | None = None,
    superseded: Callable[[Found], bool] = lambda _: False,
) -> Found:
    """From the baseline to the model that explains the recordings best; refused: effects of which
    no device has as much as a fit came to; budget: how long it may take; superseded: asked before
    a second climb, whether where the first one ended is enough.

    Where the baseline is no fit the search begins with the one error without which there is none.
    Named effects may be stand-ins for one thing without a name: if a single law does half as
    well from the baseline, the search begins again with it, and the better of the two ends counts.
    """
    budget = budget or Budget()
    led = leading(base, refused) if astray(base) else None
    if led is not None:
        end = _end(base, (), _Common(refused, budget), report, led)
        assert end is not None
        return end
    base = base.bare
    common = _Common(refused, budget)
    starts = [base]
    if any(sways_far(f) for f in base.parts):
        # (the usual sway first: in a wide one little of the physics shows)
        starts.insert(0, steadied(base))
    found, enough = _begun(starts, common, partial(part_of, report, 0.0, 0.7), superseded)
    if enough:
        return found
    term = None
    if _may_stand_in(found) and not budget.spent("a search from a law on"):
        term = best_term(survey(base, common.vocabulary))
    if term is None:
        return found
    # (by fits: about the baseline, whose noise holds what is missing, a scan promises too little)
    alone = fitted(base.parts, [*base.effects, term.effect])
    gained, whole = (m.log_evidence - base.log_evidence for m in (alone, found.model))
    if gained > HALF * whole:
        other = _end(base, [term], common, partial(part_of, report, 0.7, 0.3), alone)
        if other is not None and advantage(other, found) > 0.0:
            found = replace(other, alone=found.alone)
    return found


def _may_stand_in(found: Found) -> bool:
    """Whether something in a model may be there in the place of a law: noise, or what is weak.

    (Of strong names alone, a law in whose place they stood would have left something besides.)
    """
    effects = found.model.effects
    others = [e for e in effects if e.process or not ("+=" in e.id or e.common)]
    beside = any("+=" in e.id for e in effects)
    gained = gains(found.space, found.model.chosen)
    return any(beside or e.process or gained[e.id] < WEAK for e in others)


def astray(base: Model) -> bool:
    """Whether a baseline is no fit: it does not settle, and its noise does not hold what is left,
    or only at its end."""
    if base.settled:
        return False
    if not math.isfinite(base.log_evidence):
        return True
    if any(f.levels[lv.name] > END * lv.upper for f in base.parts for lv in f.problem.levels):
        return True
    passes = [reduced_pass(reduce(f.linear), f.levels) for f in base.parts]
    return any(float(np.median(p.innovations(p.w) ** 2 / p.S)) > MISFIT for p in passes)


def leading(base: Model, refused: Set[str] = frozenset()) -> Model | None:
    """The fit with the one error of the readings without which there is none: where a baseline has
    diverged, whatever is scanned about it is nonsense. Begun from the online filter with it."""
    cases = [f.case for f in base.parts]
    acting = [
        e
        for e in catalogue().values()
        if e.imu_error is not None and e.process is None and not e.baseline and e.moments is None
    ]
    tried = [e for e in acting if e.id not in refused and any(applicable(c, e) for c in cases)]
    ways = [partial(_alone, base, e) for e in tried]
    fits = [m for m in in_parallel(ways) if m is not None and m.settled and m.one_sided]
    best = max(fits, key=lambda m: m.log_evidence, default=base)
    return None if best is base or not better(best, base, 1.0) > 0.0 else best


def _alone(base: Model, effect: Effect) -> Model | None:
    wanted = (*base.effects, effect)
    try:
        return fitted([started(f.case, wanted) for f in base.parts], wanted)
    except HandcalError:  # (with this one the online filter diverges too)
        return None


def _begun(
    starts: Sequence[Model],
    common: _Common,
    report: Report,
    superseded: Callable[[Found], bool],
) -> tuple[Found, bool]:
    """The best end of climbs from these starts, the last of which is the baseline, up to the first
    that explains more than that and leaves no wide sway; or one before the last that is superseded,
    and whether that is so."""
    found: Found | None = None
    for number, start in enumerate(starts):
        own = partial(part_of, report, number / len(starts), 1.0 / len(starts))
        end = _end(start, (), common, own, rival=None if found is None else found.named)
        assert end is not None
        if found is None:
            found = end
        elif advantage(end, found) > 0.0:
            found = replace(end, alone=found.alone, named=found.named)
        # (an end that is worse than what it began to explain, at noise of its own, is none)
        held = better(found.model, starts[-1], 1.0) > 0.0
        if held and not any(sways_far(f) for f in found.model.parts):
            break
        if start is not starts[-1] and superseded(found):
            return found, True
    assert found is not None
    return found, False


def advantage(a: Found, b: Found) -> float:
    """Nats by which one end of a search is likelier than another."""
    return better(a.model, b.model, min(a.space.quadratic.worth, b.space.quadratic.worth))


def _end(
    base: Model,
    needed: Sequence[Term],
    common: _Common,
    report: Report,
    begun: Model | None = None,
    rival: Model | None = None,
) -> Found | None:
    """The end of a climb from the baseline, or from one with the terms that are needed; None if it
    would begin without these. rival: see ``Climb``."""
    start = base if begun is None else begun
    c = Climb(start.bare, needed, common.budget, dropped=set(common.refused))
    c.vocabulary, c.fruitless = common.vocabulary, common.fruitless
    c.kept, c.rival = frozenset(base.ids), rival
    if not climbed(c, report):
        return None
    if (late := lateness(c)) is not None:
        c.model = late
        c.where = scanned(c)
    named = None if c.named is None else c.named.bare
    return Found(c.model.bare, c.where, c.alone, c.noise, c.swaps, named)

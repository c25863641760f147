"""The search for missing physics: the starts of its climbs, and the choice of the best end."""

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

# Share of the total gain from which a single law is the start of another climb.
HALF = 0.5
# Share of its upper bound from which a noise level counts as at the bound.
END = 0.99
# Largest median of the normalised innovations squared. A good fit has 0.45; at 1 half of the
# innovations exceed their sigma, and noise levels could not absorb what is wrong.
MISFIT = 1.0


@dataclass(frozen=True)
class Found:
    """The end of a search: the final model and the space of the last scan.

    alone: gain of each effect of the catalogue over the baseline. noise: gain of each noise effect
    of the model. swaps: (effect, rival) to the nats lost with the rival fitted instead. named: the
    model before the search for laws.
    """

    model: Model
    space: Space
    alone: dict[str, float]
    noise: dict[str, float]
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)
    named: Model | None = None


@dataclass(frozen=True)
class _Common:
    """State that all climbs of a search share; see ``Climb`` and ``search``."""

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
    """The model with the highest score, found by climbs from the baseline.

    refused: effects to leave out, because a fit came to an implausible size of them. budget: limit
    of time. superseded: called with the end of a climb; if true, no second climb follows.

    If the baseline does not converge, the search starts with the one error that makes it converge.
    Several names may imitate one law: if a single law gains half as much over the baseline, a
    further climb starts with it, and the better end counts.
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
        # (the usual sway first, since a wide one hides physics)
        starts.insert(0, steadied(base))
    found, enough = _begun(starts, common, partial(part_of, report, 0.0, 0.7), superseded)
    if enough:
        return found
    term = None
    if _may_stand_in(found) and not budget.spent("a search from a law on"):
        term = best_term(survey(base, common.vocabulary))
    if term is None:
        return found
    # (compared by fits: a scan underrates it, since the baseline's noise absorbs missing physics)
    alone = fitted(base.parts, [*base.effects, term.effect])
    gained, whole = (m.log_evidence - base.log_evidence for m in (alone, found.model))
    if gained > HALF * whole:
        other = _end(base, [term], common, partial(part_of, report, 0.7, 0.3), alone)
        if other is not None and advantage(other, found) > 0.0:
            found = replace(other, alone=found.alone)
    return found


def _may_stand_in(found: Found) -> bool:
    """Whether some effect of a model may imitate a law: noise, a weak name, or any rare effect
    beside a law. (Strong names alone would leave traces of the law, as noise or weak effects.)"""
    effects = found.model.effects
    others = [e for e in effects if e.process or not ("+=" in e.id or e.common)]
    beside = any("+=" in e.id for e in effects)
    gained = gains(found.space, found.model.chosen)
    return any(beside or e.process or gained[e.id] < WEAK for e in others)


def astray(base: Model) -> bool:
    """Whether a baseline fit is unusable: it does not settle, and its residuals exceed its noise,
    or a noise level is at its bound."""
    if base.settled:
        return False
    if not math.isfinite(base.log_evidence):
        return True
    if any(f.levels[lv.name] > END * lv.upper for f in base.parts for lv in f.problem.levels):
        return True
    passes = [reduced_pass(reduce(f.linear), f.levels) for f in base.parts]
    return any(float(np.median(p.innovations(p.w) ** 2 / p.S)) > MISFIT for p in passes)


def leading(base: Model, refused: Set[str] = frozenset()) -> Model | None:
    """The best fit with one sensor error, started from the online filter with that error; None if
    none beats the baseline. (A scan about a diverged baseline means nothing.)"""
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
    except HandcalError:  # (the online filter diverges)
        return None


def _begun(
    starts: Sequence[Model],
    common: _Common,
    report: Report,
    superseded: Callable[[Found], bool],
) -> tuple[Found, bool]:
    """The best end of climbs from these starts, and whether it was superseded.

    The last start is the baseline. Climbs stop after the first end that beats it and has no wide
    sway, or that is superseded.
    """
    found: Found | None = None
    for number, start in enumerate(starts):
        own = partial(part_of, report, number / len(starts), 1.0 / len(starts))
        end = _end(start, (), common, own, rival=None if found is None else found.named)
        assert end is not None
        if found is None:
            found = end
        elif advantage(end, found) > 0.0:
            found = replace(end, alone=found.alone, named=found.named)
        # (from the usual sway a climb may end below the baseline)
        held = better(found.model, starts[-1], 1.0) > 0.0
        if held and not any(sways_far(f) for f in found.model.parts):
            break
        if start is not starts[-1] and superseded(found):
            return found, True
    assert found is not None
    return found, False


def advantage(a: Found, b: Found) -> float:
    """Score of one end of a search over another, nats."""
    return better(a.model, b.model, min(a.space.quadratic.worth, b.space.quadratic.worth))


def _end(
    base: Model,
    needed: Sequence[Term],
    common: _Common,
    report: Report,
    begun: Model | None = None,
    rival: Model | None = None,
) -> Found | None:
    """The end of a climb; None if its first scan does not choose all terms in ``needed``.

    base: the baseline. begun: another model to start from. rival: see ``Climb``.
    """
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

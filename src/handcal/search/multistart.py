"""The search for missing physics: the starts of its climbs, and the choice of the best end."""

from __future__ import annotations

import math
from collections.abc import Callable, Set
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.baseline import started
from handcal.estimate.case import applicable, name_of
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.model_score import better
from handcal.search.beyond_columns import by_convention, gains_of_noise, swaps_of, unsure
from handcal.search.budget import Budget, Report, part_of
from handcal.search.candidates import scanned_about
from handcal.search.climb import Climb, Made, climbed
from handcal.search.space import Space, gains
from handcal.search.wide_sway import steadied, sways_far
from handcal.types import HandcalError

# Share of its upper bound from which a noise level counts as at the bound.
END = 0.99
# Largest median of the normalised innovations squared. A good fit has 0.45; at 1 half of the
# innovations exceed their sigma, and noise levels could not absorb what is wrong.
MISFIT = 1.0


@dataclass(frozen=True)
class Found:
    """The end of a search: the final model and the space of the last scan.

    alone: gain of each effect of the catalogue over the baseline. noise: gain of each noise effect
    of the model. swaps: (effect, rival) to the nats lost with the rival fitted instead.
    """

    model: Model
    space: Space
    alone: dict[str, float]
    noise: dict[str, float]
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)


def search(
    base: Model,
    report: Report = lambda _, __: None,
    refused: Set[str] = frozenset(),
    budget: Budget | None = None,
    superseded: Callable[[Found], bool] = lambda _: False,
    made: Made | None = None,
) -> Found:
    """The model with the highest score, found by climbs from the baseline.

    refused: effects to leave out, because a fit came to an implausible size of them. budget: limit
    of time. superseded: called with the end of a climb; if true, no second climb follows. made:
    what other searches of the same recordings worked out once.

    If the baseline does not converge, the search starts with the one error that makes it converge.
    If its held point sways beyond a hand, it starts from the usual sway, since a wide one absorbs
    missing physics, and from the baseline if that climb ends below it or with such a sway.
    """
    led = leading(base, refused) if astray(base) else None
    kept = frozenset(base.ids)
    c = Climb(kept, frozenset(refused), budget or Budget(), made or Made())
    if led is not None:
        return _end(c, led.bare, report)
    base = base.bare
    if not any(sways_far(f) for f in base.parts):
        return _end(c, base, report)
    found = _end(c, steadied(base).bare, partial(part_of, report, 0.0, 0.5))
    held = not any(sways_far(f) for f in found.model.parts)
    if (held and better(found.model, base, 1.0) > 0.0) or superseded(found):
        return found
    other = _end(c, base, partial(part_of, report, 0.5, 0.5))
    return other if advantage(other, found) > 0.0 else found


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


def advantage(a: Found, b: Found) -> float:
    """Score of one end of a search over another, nats."""
    return better(a.model, b.model, min(a.space.quadratic.worth, b.space.quadratic.worth))


def _end(c: Climb, start: Model, report: Report) -> Found:
    """The end of a climb, without rare names that are not sure.

    Raises HandcalError if the fit of the start diverges.
    """
    alone = gains(scanned_about(start, c.refused), frozenset())
    model, refused = climbed(c, start, report), set(c.refused)
    while not c.budget.spent("the fit without its weakest effects"):
        worth = scanned_about(model, refused).quadratic.worth
        weak = unsure(model, c.kept, worth)
        if weak is None:
            break
        effect, model = weak
        refused.add(name_of(effect.id))
        model = climbed(replace(c, refused=frozenset(refused)), model, report)
    where = scanned_about(model, refused)
    worth = where.quadratic.worth
    noise = gains_of_noise(model, c.kept, worth)
    swaps = swaps_of(model, refused, c.kept, worth)
    late = by_convention(model, swaps)
    if late is not None:
        model, where = late, scanned_about(late, refused)
    return Found(model.bare, where, alone, noise, swaps)

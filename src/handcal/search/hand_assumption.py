"""Test of the hand assumption: a held point against a hand that travels.

Integrated sensor errors look like a travelling hand. If the held point sways more than a hand does,
the recording is explained again from its rests alone. The sensor errors estimated from the held
point then predict the other observations: rests, headings, fields and poses. If the point was
held, the prediction is good; if the hand travelled, these observations contradict it.
"""

from __future__ import annotations

import math
from dataclasses import replace

from handcal.estimate.fit import fitted, known_of, own_levels
from handcal.estimate.hand_sway import TRAVEL_NATS, beyond_a_hand
from handcal.estimate.model import Fitted, Model
from handcal.estimate.transfer import at_constants, moved_to
from handcal.explanation import Hand
from handcal.model_score import CERTAIN, log_prior, score
from handcal.search.common_found import names_of
from handcal.search.multistart import Found


def foretold(found: Found, base: Model, laid: Found) -> float:
    """Log odds that the point was held, nats: how much better the sensor errors of ``found``
    predict the observations without the held point than ``laid`` explains them.

    found: end of the search with the held point. laid: end of the search from the rests alone, with
    baseline ``base``. If both name the same constants, the wide sway is no missing physics, and the
    result is -TRAVEL_NATS, the odds against such a sway. (Noise predicts nothing that rests could
    contradict.)
    """
    held = found.model
    first, second = _constant(found), _constant(laid)
    if first == second:
        return -TRAVEL_NATS
    parts = zip(base.parts, held.parts, strict=True)
    begin = [_begun(b, held, h) for b, h in parts]
    # (effects that both name keep their usual prior, or the same readings would count twice)
    both, free = first & second, frozenset(held.ids) - (first - second)
    seen = fitted(begin, held.effects, known=known_of(held, free)).log_evidence
    worth = laid.space.quadratic.worth
    shared = log_prior([e for e in laid.model.effects if e.id in both], [f.case for f in begin])
    return worth * seen + shared - score(laid.model, worth)


def _constant(found: Found) -> frozenset[str]:
    """Ids that the end of a search names, except noise."""
    noise = {e.id for e in found.model.effects if e.process is not None}
    return names_of(found.space, found.model) - noise


def hand_of(f: Fitted, advantage: float) -> Hand:
    """The hand's motion according to a fit, with its probability.

    advantage: log odds over the alternative, nats; nan if none was tried. Then the size of the sway
    gives the odds over a travelling hand.
    """
    if "fixed_position" in f.case.kinds:
        kind = "creeping" if f.case.creeping else "held"
    elif "zero_velocity" in f.case.kinds:
        kind = "carried"
    else:
        return Hand("", 1.0)
    if not math.isfinite(advantage):
        advantage = max(0.0, TRAVEL_NATS - beyond_a_hand(f.about, f.levels))
    return Hand(kind, min(CERTAIN, 1.0 / (1.0 + math.exp(-min(700.0, advantage)))))


def _begun(base: Fitted, held: Model, part: Fitted) -> Fitted:
    """The baseline of the rests with the effects of the held point's fit, at its constants and
    noise levels."""
    sizes = {(e.id, p.name): p.prior_sigma for e in held.effects for p in e.parameters}
    names = held.quadratic.names
    values = {n: float(u) * sizes[n] for n, u in zip(names, held.u, strict=True) if n in sizes}
    out = at_constants(moved_to(base, held.effects), held.effects, values)
    return replace(out, levels={**out.levels, **own_levels(part)})

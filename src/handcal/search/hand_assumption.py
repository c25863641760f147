"""Was the point held, or does the hand travel? What was learnt of the sensors decides.

Errors of the sensors look like a travelling hand: integrated, they lead away from any point. Where
the held point sways as no hand does, the recording is explained again by its rests alone, and then
there are two accounts. What the first learnt of the sensors it learnt from the held point; if that
point was held, it is true of the rests too, and of headings and fields and poses. If it was made
up by a hand that went elsewhere, all those contradict it.
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
    """Nats by which the sensors as the held point shows them (``found``) predict what is observed
    without it better than the best account of that alone, ``laid``, whose baseline is ``base``.

    Where both name the same constants (noise tells nothing that the rests could contradict), the
    sway is no physics that the rests do not show, and as unlikely of a hand that holds as it has to
    be for the rests to be asked.
    """
    held = found.model
    first, second = _constant(found), _constant(laid)
    if first == second:
        return -TRAVEL_NATS
    parts = zip(base.parts, held.parts, strict=True)
    begin = [_begun(b, held, h) for b, h in parts]
    # (of what both name neither may know beforehand, or the same readings would count twice)
    both, free = first & second, frozenset(held.ids) - (first - second)
    seen = fitted(begin, held.effects, known=known_of(held, free)).log_evidence
    worth = laid.space.quadratic.worth
    shared = log_prior([e for e in laid.model.effects if e.id in both], [f.case for f in begin])
    return worth * seen + shared - score(laid.model, worth)


def _constant(found: Found) -> frozenset[str]:
    """What the end of a search names, but for noise."""
    noise = {e.id for e in found.model.effects if e.process is not None}
    return names_of(found.space, found.model) - noise


def hand_of(f: Fitted, advantage: float) -> Hand:
    """What the hand does according to a fit, that being so many nats better than what else was
    tried; where nothing was, than a hand that travels, of which the sway would tell."""
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
    """The baseline of the rests with the effects where the held point has them, and their noise."""
    sizes = {(e.id, p.name): p.prior_sigma for e in held.effects for p in e.parameters}
    names = held.quadratic.names
    values = {n: float(u) * sizes[n] for n, u in zip(names, held.u, strict=True) if n in sizes}
    out = at_constants(moved_to(base, held.effects), held.effects, values)
    return replace(out, levels={**out.levels, **own_levels(part)})

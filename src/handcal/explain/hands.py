"""Was the point held, or does the hand travel? What was learnt of the sensors decides.

Errors of the sensors look like a travelling hand: integrated, they lead away from any point. Where
the held point sways as no hand does, the recording is explained again by its rests alone, and then
there are two accounts. What the first learnt of the sensors it learnt from the held point; if that
point was held, it is true of the rests too, and of headings and fields and poses. If it was made
up by a hand that went elsewhere, all those contradict it.
"""

from __future__ import annotations

from dataclasses import replace

from handcal.estimate.fit import (
    Fitted,
    Model,
    at_constants,
    fitted,
    known_of,
    moved_to,
    own_levels,
)
from handcal.explain.find import Found, odds


def foretells(held: Model, base: Model, laid: Found) -> bool:
    """Whether the sensors as the ``held`` point shows them predict what is observed without it at
    least as well as the best account of that alone, ``laid``, whose baseline is ``base``.

    Where both name the same, the sway is no physics that the rests do not show: False.
    """
    if held.chosen == laid.model.chosen:
        return False
    parts = zip(base.parts, held.parts, strict=True)
    begin = [_begun(b, held, h) for b, h in parts]
    foretold = fitted(begin, held.effects, known=known_of(held)).log_evidence
    worth = laid.space.quadratic.worth
    return worth * (foretold - laid.model.log_evidence) > odds(laid.model)


def _begun(base: Fitted, held: Model, part: Fitted) -> Fitted:
    """The baseline of the rests with the effects where the held point has them, and their noise."""
    sizes = {(e.id, p.name): p.prior_sigma for e in held.effects for p in e.parameters}
    names = held.quadratic.names
    values = {n: float(u) * sizes[n] for n, u in zip(names, held.u, strict=True) if n in sizes}
    out = at_constants(moved_to(base, held.effects), held.effects, values)
    return replace(out, levels={**out.levels, **own_levels(part)})

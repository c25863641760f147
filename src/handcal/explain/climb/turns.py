"""The turns of a climb: its steps in their order, and where it ends."""

from __future__ import annotations

from collections.abc import Callable

from handcal.explain.climb.choose import choose, delay, favourite, thin
from handcal.explain.climb.exchange import exchange, reorder
from handcal.explain.climb.laws import MAX_TERMS, instead, name_term, narrow, reshape
from handcal.explain.climb.noise import add_noise, exchange_noise, free
from handcal.explain.climb.on_trial import scanned
from handcal.explain.climb.state import Climb
from handcal.explain.space import gains

# Turns of a climb at the most, beside two for each term that may be named.
ROUNDS = 8


def climbed(c: Climb, report: Callable[[float], None]) -> bool:
    """Climb as far as it goes; False where that would begin without the terms needed."""
    for turn in range(ROUNDS + 2 * MAX_TERMS):
        report(min(0.95, 0.15 + 0.1 * turn))
        c.where = scanned(c)
        if turn == 0:
            c.alone = gains(c.where, frozenset())
            if any(t.effect.id not in favourite(c) for t in c.needed):
                return False
        model = next((m for step in _STEPS if (m := step(c)) is not None), None)
        if model is None:
            break
        c.model = model
    else:
        # (out of turns: what is said of the model is said by a scan about it)
        c.where = scanned(c)
    return True


# The cheap ones first; nothing is taken away or left without a name before all else rests.
_STEPS = (
    delay, choose, instead, reshape, narrow, exchange, reorder, add_noise, exchange_noise,
    thin, free, name_term,
)  # fmt: skip

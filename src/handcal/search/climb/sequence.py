"""The turns of a climb: the order of its steps, and its end."""

from __future__ import annotations

import math
from collections.abc import Callable

from handcal.estimate.model import Model
from handcal.search.climb.candidates import scanned
from handcal.search.climb.exchange_steps import exchange, hidden, reorder
from handcal.search.climb.law_steps import (
    MAX_TERMS,
    adjust,
    instead_of_travel,
    name_term,
    narrow,
    rename,
    reshape,
    take_in,
)
from handcal.search.climb.noise_steps import add_noise, name_noise, noise_or_step
from handcal.search.climb.state import SAME_FIT, Climb, Report, beaten
from handcal.search.climb.subset_steps import choose, everything, favourite, thin
from handcal.search.space import gains

# Largest count of turns, beside two for each term. It is a safeguard: every step raises the score,
# so that a climb ends by itself.
ROUNDS = 24


def climbed(c: Climb, report: Report) -> bool:
    """Climb until no step helps; False if the first scan does not choose all needed terms."""
    for turn in range(ROUNDS + 2 * MAX_TERMS):
        report(min(0.95, 0.15 + 0.1 * turn), c.model)
        c.where = scanned(c)
        if turn == 0:
            c.alone = gains(c.where, frozenset())
            if any(t.effect.id not in favourite(c) for t in c.needed):
                return False
        if not _moved(c):
            break
    else:
        # (out of turns: the result needs a scan about the last model)
        c.where = scanned(c)
    return True


def _moved(c: Climb) -> bool:
    """Take the first step that returns a model; False if none does."""
    model = next((m for step in _STEPS if (m := _taken(c, step)) is not None), None)
    if model is not None:
        c.model = model
    return model is not None


def _taken(c: Climb, step: Callable[[Climb], Model | None]) -> Model | None:
    """The model that a step returns, if the budget allows it and it is not known to be useless."""
    if step in _LAWS:
        c.named = c.named or c.model
        last = c.fruitless.get(_beside(c, step), -math.inf)
        if beaten(c) or c.model.log_evidence < last + SAME_FIT:
            return None
    if c.budget.spent(_STEPS[step]):
        return None
    model = step(c)
    if c.budget.cut:
        c.budget.note(_STEPS[step])
    elif model is None and step in _LAWS:
        c.fruitless[_beside(c, step)] = c.model.log_evidence
    return model


def _beside(c: Climb, step: Callable[[Climb], Model | None]) -> tuple[str, frozenset[str]]:
    """The key of ``fruitless``: a step and the ids of the model's effects."""
    return step.__name__, frozenset(c.model.ids)


# The steps in their order, the cheap ones first, each with the words for what is left untried
# without it. The search for new laws comes last, after names and noise have settled.
_STEPS: dict[Callable[[Climb], Model | None], str] = {
    everything: "the fit of all effects at once",
    noise_or_step: "noise in the place of steps",
    choose: "further effects",
    reshape: "other forms of a law",
    narrow: "laws on fewer axes",
    adjust: "the numbers in a law",
    exchange: "similar effects in the place of those that were found",
    reorder: "filters in another order",
    add_noise: "noise effects",
    thin: "the fit without its weakest effects",
    hidden: "filters beside delays",
    take_in: "a law's own level in the place of names",
    name_noise: "names in the place of noise",
    name_term: "laws that have no name",
    instead_of_travel: "laws in the place of a hand that travels",
    rename: "laws in the place of laws and names",
}
# Steps that search for laws, which take most of the time.
_LAWS = name_term, instead_of_travel, rename

"""Says in words what a design cannot see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handcal.estimate import regression
from handcal.estimate.regression import Unknown
from handcal.types import Array, HandcalError
from handcal.units import shown

MOST_TERMS, MOST_SENTENCES = 4, 4


class Unseen(HandcalError):
    """Rows do not show combinations of parameters."""


def refuse_unseen(
    A: Array, unknowns: Sequence[Unknown], noise: bool = False, hint: str = ""
) -> None:
    """Unseen, naming the combinations of parameters that rows A (m, k) do not show.

    noise: the rows have unit variance; what is told worse than is usual anyway counts too.
    """
    blind = regression.unseen(A, regression.priors(unknowns), noise)
    if not blind:
        return
    said = [combination(c, unknowns) for c in blind[:MOST_SENTENCES]]
    if len(blind) > len(said):
        said.append(f"nor with {len(blind) - len(said)} more such combinations")
    seen = "No reading changes by more than its noise" if noise else "No reading changes"
    raise Unseen(
        f"{seen} with {'; nor with '.join(said)}. {hint}".replace("nor with nor", "nor").strip()
    )


def combination(c: Array, unknowns: Sequence[Unknown]) -> str:
    """Changes c (k,), in usual sizes, as "accel_bias x by +1 mg together with ..."."""
    order = [i for i in np.argsort(-np.abs(c), kind="stable") if c[i] != 0.0]
    terms = []
    for i in order[:MOST_TERMS]:
        u = unknowns[i]
        change = float(c[i]) * u.param.prior_sigma
        unit = shown(u.param.unit, [change])
        value = f"{unit.factor * change:+.3g}".replace("-", "−")
        terms.append(f"{u.title} by {value} {unit.unit}".rstrip())
    if len(order) > len(terms):
        terms.append(f"{len(order) - len(terms)} others by less")
    head, *rest = terms
    if not rest:
        return head
    return f"{head} together with {', '.join(rest[:-1])}{' and ' if rest[:-1] else ''}{rest[-1]}"

"""What the recordings cannot show, from the information matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.estimate.prior_root import prior_root
from handcal.estimate.quadratic import posterior
from handcal.search.multistart import Found
from handcal.types import Parameter


def untellable(found: Found, told: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """Parameters of which a motion like this leaves more than half of the prior's sigma.

    told: those of the final model, which have a sigma already. Of the others, each effect beside
    the model: what the scan about it says of the covariance.
    """
    where, chosen = found.space, found.model.chosen
    out = [p for p in told if not p.shown]
    have = {p.effect for p in told}
    for name, effect in where.effects.items():
        if name in have or name in chosen or "@" in name or "+=" in name:
            continue
        beside = [i for i in sorted(chosen) if i in where.effects]
        index = np.concatenate([where.where[i] for i in (*beside, name)])
        effects = [where.effects[i] for i in (*beside, name)]
        root = prior_root(where.quadratic, effects, index)
        mine = len(index) - len(where.where[name])
        sigma = np.sqrt(np.diag(posterior(where.quadratic, index, root).covariance))[mine:]
        for p, s in zip(effect.parameters, sigma, strict=True):
            said = Parameter(
                name, p.name, 0.0, float(s * p.prior_sigma), p.unit, p.prior_sigma, None
            )
            out += [] if said.shown else [said]
    return tuple(replace(p, converged_at_s=None) for p in out)

"""Whether the parameters of a fit have sizes and signs that a device can have."""

from __future__ import annotations

from handcal.estimate.case import name_of
from handcal.estimate.model import Model


def sensible(model: Model) -> bool:
    """Whether all parameters have plausible sizes and signs."""
    return model.one_sided and not too_large(model)


def too_large(model: Model) -> set[str]:
    """Names of the effects with an implausibly large parameter."""
    known = {(e.id, p.name): p for e in model.effects for p in e.parameters}
    return {
        name_of(n[0])
        for n, u in zip(model.quadratic.names, model.u, strict=True)
        if abs(u) * known[n].prior_sigma > known[n].most
    }

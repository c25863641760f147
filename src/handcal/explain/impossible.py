"""Residuals that no hand makes: the final fit explains nothing, whatever it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handcal.estimate.impossible import force_off, sentences
from handcal.estimate.model import Model
from handcal.explain import locate
from handcal.types import Parameter


def impossible(model: Model, parameters: Sequence[Parameter], gravity: float) -> tuple[str, ...]:
    """A sentence for each residual that no hand makes. gravity: m/s^2."""
    out: list[str] = []
    for f in model.parts:
        rms = locate.residual_rms(f)
        off = force_off(f.case.recording, f.case.rests, parameters, gravity)
        out += sentences(_size(rms, "position"), _size(rms, "velocity"), off)
    return tuple(dict.fromkeys(out))


def _size(rms: Mapping[str, float], kind: str) -> float:
    """Root of the sum of squares over a kind's channels."""
    return float(np.sqrt(sum(v**2 for k, v in rms.items() if k.startswith(kind))))

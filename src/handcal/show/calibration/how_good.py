"""How good a device is, in sentences and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from handcal.device.quality import ATTITUDE_S, POSITION_S, Drift, Quality, quality
from handcal.show.words import NBSP
from handcal.types import Array, Parameter, Prior
from handcal.units import plain, shown

# Of what is expected, more than this share left is nothing gained.
WORTH = 0.9
NOT_BETTER = "this motion does not show it well enough to correct it"


def quality_of(
    parameters: Sequence[Parameter], covariance: Array | None, before: Prior | None
) -> Quality | None:
    """``device.quality.quality``, the same each time it is asked; before: what was known of the
    device."""
    if covariance is None or not len(parameters):
        return None
    return _worked_out(
        tuple(parameters), np.ascontiguousarray(covariance).tobytes(), before is None
    )


@lru_cache(maxsize=4)
def _worked_out(
    parameters: tuple[Parameter, ...], covariance: bytes, tails: bool
) -> Quality | None:
    """(terminal, page and JSON all ask for it, and it takes a fifth of a second)"""
    C = np.frombuffer(covariance).reshape(len(parameters), -1)
    return quality(parameters, C, np.random.default_rng(0), tails=tails)


def sentences(
    parameters: Sequence[Parameter], covariance: Array | None, before: Prior | None
) -> list[str]:
    """How far dead reckoning is off, and how many usual devices are better; none where that is not
    known."""
    q = quality_of(parameters, covariance, before)
    if q is None:
        return []
    better = [f"{100 * d.better:.0f}{NBSP}%" for d in (q.attitude, q.position)]
    return [
        f"After a minute of turning the attitude is off by {_size(q.attitude, 'rad')}.",
        f"Ten seconds after rest the position is off by {_size(q.position, 'm')}.",
        f"Of usual phones, {better[0]} are better in attitude and {better[1]} in position.",
    ]


def _size(d: Drift, si: str) -> str:
    """ "4.1 deg (3.2 to 5.0); corrected, 0.3 deg", or that nothing is gained by correcting."""
    of = shown(si, [d.before])
    before, low, high, after = (plain(of.factor * x, 2) for x in (d.before, d.low, d.high, d.after))
    span = f" ({low} to {high})" if low != high else ""
    left = f"corrected, {after}{NBSP}{of.unit}" if d.after < WORTH * d.before else NOT_BETTER
    return f"{before}{NBSP}{of.unit}{span}; {left}"


def quality_json(
    parameters: Sequence[Parameter], covariance: Array | None, before: Prior | None
) -> dict[str, Any]:
    """``quality``, or nothing where it is not known."""
    q = quality_of(parameters, covariance, before)
    if q is None:
        return {}
    each = (("attitude", "rad", ATTITUDE_S, q.attitude), ("position", "m", POSITION_S, q.position))
    return {"quality": {
        name: {"unit": unit, "after_s": after_s, "expected": d.before, "p16": d.low, "p84": d.high,
               "corrected": d.after, "usual_better": d.better}
        for name, unit, after_s, d in each
    }}  # fmt: skip

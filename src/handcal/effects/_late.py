"""A pose that is of an earlier moment (no effect of its own: a delay and a clock need it)."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import njit


@njit
def add_lateness(nav: Any, delay: float, out: Any) -> None:
    """Take from a pose's residual (6,) that it comes ``delay`` seconds late, to first order."""
    for i in range(3):
        out[i] += nav[3 + i] * delay
        out[3 + i] += delay * (
            nav[6 + 3 * i] * nav[15] + nav[7 + 3 * i] * nav[16] + nav[8 + 3 * i] * nav[17]
        )

"""Readings that come late (no effect of its own: delays of several streams need it)."""

from __future__ import annotations

from typing import Any

from handcal.compiled.jit import residual_function
from handcal.effects import DELAY


def _late(nav: Any, delay: Any, z: Any, out: Any) -> int:  # noqa: ARG001
    # nav is of the moment z[DELAY] before the reading's stamp
    out[0] += delay[0] - z[DELAY]
    return 0


LATE = residual_function(_late)

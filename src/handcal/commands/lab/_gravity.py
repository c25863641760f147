"""Gravity as typed on the command line: the size itself, or a place."""

from __future__ import annotations

import math
from typing import Annotated

import typer

Gravity = Annotated[
    float | None, typer.Option(metavar="M/S^2", help="Local gravity; 9.80665 if not given.")
]


def gravity_of(gravity: float | None, latitude_deg: float | None, height: float) -> float:
    """m/s^2 as typed, or at the latitude. Errors: InputError."""
    from handcal.earth import STANDARD_GRAVITY, local_earth
    from handcal.types import InputError

    if gravity is not None and latitude_deg is not None:
        raise InputError("--gravity and --latitude both set gravity: give one of them.")
    if gravity is not None:
        if not 9.7 < gravity < 9.9:
            raise InputError(f"--gravity {gravity:g}: expected 9.7 to 9.9 m/s^2, as on the Earth.")
        return gravity
    if latitude_deg is None:
        return STANDARD_GRAVITY
    if not math.isfinite(latitude_deg):
        raise InputError(f"--latitude {latitude_deg}: expected a finite number.")
    return -float(local_earth(math.radians(latitude_deg), height)[0][2])

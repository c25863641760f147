"""A short simulated recording of an IMU alone, for what follows readings as they come."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import handcal
from handcal.types import Recording
from handcal_sim import simulate, write


def recorded(folder: Path) -> Recording:
    """Sixteen seconds of turns about each axis, without a heading."""
    write(simulate("three-turns", seed=5, duration_s=16.0), folder / "x.mcap")
    return replace(handcal.load(folder / "x.mcap"), streams={})

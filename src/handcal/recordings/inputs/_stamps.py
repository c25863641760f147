"""Stamps of a table in ns: of a stated unit, of one that the numbers leave no doubt about, of the
clock, or of counted samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handcal.recordings.inputs._clock import of_clock
from handcal.recordings.inputs._options import unit_factor
from handcal.recordings.inputs._repair import nanoseconds
from handcal.recordings.inputs._rows import is_exact
from handcal.types import Array, IntArray

Clock = Array | IntArray | Sequence[str]
# Moments since 1970, s, of the years 2001 to 2100; and steps, s, as an IMU's are.
_EPOCH_S, _STEPS_S = (1e9, 4.1e9), (1e-5, 1.0)
_ENOUGH = 20  # steps of one each count samples; of fewer it may be chance


def stamped(where: str, clock: Clock, unit: str, said: list[str]) -> IntArray:
    """Stamps (n,) in ns; unit: as ``parse_unit`` spells it, "" where none is stated. Errors:
    InputError."""
    if not isinstance(clock, np.ndarray):
        return of_clock(clock, where)
    if not unit:
        unit = unit_of(clock)
        if unit != "s":
            said.append(f"Time has no unit; by its steps it is taken for {unit}.")
    factor = unit_factor("time", unit)
    if clock.dtype.kind in "iu" and is_exact(clock.astype(np.int64), factor):
        return clock.astype(np.int64) * int(factor)
    return nanoseconds(np.asarray(clock, dtype=np.float64), factor)


def is_counter(clock: Array | IntArray) -> bool:
    """Whether each number is the one before and one more."""
    return len(clock) > _ENOUGH and bool(np.all(np.diff(clock.astype(np.float64)) == 1.0))


def unit_of(clock: Array | IntArray) -> str:
    """s, ms, us or ns: in which stamps lie between 2001 and 2100 and are as far apart as an IMU's;
    or, of whole numbers, the coarsest in which they are. Else s."""
    t = np.asarray(clock, dtype=np.float64)
    t = t[np.isfinite(t)]
    steps = np.abs(np.diff(t))
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    for unit, second in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        apart = _STEPS_S[0] <= step / second <= _STEPS_S[1]
        if apart and _EPOCH_S[0] <= float(np.median(t)) / second <= _EPOCH_S[1]:
            return unit
    if step >= 2.0 and np.all(t == np.rint(t)):
        return next((u for u, s in (("ms", 1e3), ("us", 1e6)) if step < s), "ns")
    return "s"


def counted(clock: Clock | None, size: int, rate_hz: float) -> IntArray:
    """Stamps (n,) in ns of counted samples: by the counter, where there is one, whose gaps count
    too; else of one sample after the other."""
    count = np.arange(size, dtype=np.float64)
    if isinstance(clock, np.ndarray):
        own = np.asarray(clock, dtype=np.float64)
        steps = np.diff(own)
        if len(steps) and np.all(steps >= 1) and np.median(steps) == 1 and np.all(own % 1 == 0):
            count = own - own[0]
    return nanoseconds(count, 1e9 / rate_hz)

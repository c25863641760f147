"""Gyro and accelerometer that report on their own, brought to the gyro's stamps as they come."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from handcal.types import Array, IntArray

Readings = tuple[IntArray, Array]
# An accelerometer that is silent for longer is not interpolated across: the samples are left out.
LONGEST_GAP_NS = 500_000_000
# A gyro without an accelerometer is kept for so long (ten minutes at 200 Hz), no longer.
MOST_WAITING = 120_000


def _none() -> Readings:
    return np.zeros(0, dtype=np.int64), np.zeros((0, 3))


@dataclass
class Pairing:
    """What waits for its other half. late: readings that came behind newer ones, or that no
    accelerometer reading was near enough for."""

    gyro: Readings = field(default_factory=_none)
    accel: Readings = field(default_factory=_none)
    late: int = 0

    def add(self, gyro: Readings, accel: Readings) -> None:
        """Readings of both, stamps (n,) ns and values (n, 3), of any length."""
        self.gyro = self._joined(self.gyro, gyro)
        self.accel = self._joined(self.accel, accel)

    def ready(self) -> tuple[IntArray, Array, Array]:
        """Stamps (n,) ns, rates and forces (n, 3) of all that has both, which is then taken out."""
        (ns, rate), (at, force) = self.gyro, self.accel
        known = ns <= (at[-1] if len(at) else -1)
        if not known.any():
            self.gyro = ns[-MOST_WAITING:], rate[-MOST_WAITING:]
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3))
        self.gyro = ns[~known], rate[~known]
        ns, rate = ns[known], rate[known]
        after = np.searchsorted(at, ns).clip(0, len(at) - 1)
        before = np.maximum(after - 1, 0)
        exact = at[after] == ns
        near = exact | ((at[before] <= ns) & (at[after] - at[before] <= LONGEST_GAP_NS))
        self.late += int((~near).sum())
        ns, rate = ns[near], rate[near]
        before, after, exact = before[near], after[near], exact[near]
        share = np.where(exact, 1.0, (ns - at[before]) / np.maximum(at[after] - at[before], 1))
        value = force[before] + share[:, None] * (force[after] - force[before])
        value[exact] = force[after[exact]]  # (a stamp in common: to the last bit)
        # (the last one may be needed by the next)
        keep = max(0, int(np.searchsorted(at, ns[-1] if len(ns) else at[-1])) - 1)
        self.accel = at[keep:], force[keep:]
        return ns, rate, value

    def _joined(self, have: Readings, more: Readings) -> Readings:
        ns, value = np.r_[have[0], more[0]], np.vstack([have[1], more[1]])
        highest = np.maximum.accumulate(np.r_[np.iinfo(np.int64).min, ns])[:-1]
        fresh = ns > highest
        self.late += int((~fresh).sum())
        return ns[fresh], value[fresh]

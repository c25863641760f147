"""How a sender's clock goes beside this machine's, by when its batches arrive.

A batch cannot arrive before its last sample was taken, so of many the least delayed tells the
offset, but for the shortest delay, which no one-way message can.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

# Of so many ns the least delayed batch is kept: some hundred numbers an hour.
SPAN_NS = 10_000_000_000
# The rate is told by at least so many of them: two minutes.
FEWEST = 12


@dataclass
class Clocks:
    """least: by span of the sender's time, its stamp and the offset (ns) of what came soonest."""

    least: dict[int, tuple[int, int]] = field(default_factory=dict)

    def heard(self, stamp_ns: int, arrived_ns: int) -> None:
        """A batch whose last sample has this stamp arrived at this time of the machine."""
        span, offset = stamp_ns // SPAN_NS, arrived_ns - stamp_ns
        if span not in self.least or offset < self.least[span][1]:
            self.least[span] = (stamp_ns, offset)

    @property
    def offset_s(self) -> float | None:
        """By how much this machine's clock is ahead, shortest delay included; None before any."""
        return min(o for _, o in self.least.values()) / 1e9 if self.least else None

    @property
    def ppm(self) -> tuple[float, float] | None:
        """How much faster the sender's clock goes, 1e-6, and its sigma; None in short sessions."""
        if len(self.least) < FEWEST:
            return None
        stamps, offsets = np.array(sorted(self.least.values()), dtype=np.float64).T
        t = (stamps - stamps.mean()) / 1e9
        y = (offsets - offsets.mean()) / 1e9
        slope = float(t @ y / (t @ t))
        left = y - slope * t
        sigma = float(np.sqrt(left @ left / (len(t) - 2) / (t @ t)))
        return -1e6 * slope, 1e6 * sigma

    @property
    def sentence(self) -> str:
        """What is said at the end; empty where nothing arrived."""
        offset = self.offset_s
        if offset is None:
            return ""
        way = "behind" if offset >= 0 else "ahead of"
        text = (
            f"The sender's clock was {abs(offset):.2f} s {way} this machine's (delivery included)"
        )
        if self.ppm is not None:
            rate, sigma = self.ppm
            text += f" and ran {abs(rate):.0f} +- {sigma:.0f} ppm {'fast' if rate > 0 else 'slow'}"
        return f"{text}; all stamps are the sender's."

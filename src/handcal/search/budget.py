"""How long a search may go on, and what it left untried when it had to end."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

# What follows a search (the last fit, what was not seen, the next motions) takes so many times
# what the baseline took; from long and short recordings, 2 to 4.
AFTERWARDS = 3.0


@dataclass(frozen=True)
class Budget:
    """until: when nothing new is begun any more (``time.monotonic``, s); untried: what was left
    out for that reason, in words, in the order in which it would have come."""

    until: float = math.inf
    untried: list[str] = field(default_factory=list)

    def spent(self, what: str) -> bool:
        """Whether there is no time for this any more; then it is noted."""
        if time.monotonic() < self.until:
            return False
        if what not in self.untried:
            self.untried.append(what)
        return True


def after(began: float, seconds: float | None) -> Budget:
    """What is left for the search of so many seconds since then, the baseline being fitted."""
    if seconds is None:
        return Budget()
    now = time.monotonic()
    return Budget(max(now, began + seconds - AFTERWARDS * (now - began)))

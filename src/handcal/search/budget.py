"""How long a search may go on, and what it left untried when it had to end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from handcal.estimate.model import Model

# Called with the share that is done, and the present model.
Report = Callable[[float, Model], None]
# What follows a search (the last fit, what was not seen, the next motions) takes so many times
# what the baseline took; from long and short recordings, 2 to 4.
AFTERWARDS = 3.0

# Between what is being done and what a search has found, where both are told.
SO_FAR = "; so far "


def _never() -> bool:
    return False


@dataclass
class Budget:
    """until: when nothing new is begun any more (``time.monotonic``, s); stop: asked each time
    whether somebody wants what there is; untried: what was left out for either reason, in words, in
    the order in which it would have come."""

    until: float = math.inf
    stop: Callable[[], bool] = _never
    untried: list[str] = field(default_factory=list)

    def spent(self, what: str) -> bool:
        """Whether there is no time for this any more; then it is noted."""
        if not self._over():
            return False
        self.note(what)
        return True

    def note(self, what: str) -> None:
        """That this was left out, or a part of it."""
        if what not in self.untried:
            self.untried.append(what)

    def _over(self) -> bool:
        return self.stop() or time.monotonic() >= self.until


def after(began: float, seconds: float | None, stop: Callable[[], bool] | None = None) -> Budget:
    """What is left for the search of so many seconds since then, the baseline being fitted."""
    until = math.inf
    if seconds is not None:
        now = time.monotonic()
        until = max(now, began + seconds - AFTERWARDS * (now - began))
    return Budget(until, stop or _never)


def part_of(report: Report, start: float, share: float, f: float, model: Model) -> None:
    """Report share ``f`` of a part of the whole that begins at ``start`` and has size ``share``."""
    report(start + share * f, model)

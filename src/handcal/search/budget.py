"""How long a search may go on, and what it left untried when it had to end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

T = TypeVar("T")
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
    the order in which it would have come; cut: whether something was left out within a step."""

    until: float = math.inf
    stop: Callable[[], bool] = _never
    untried: list[str] = field(default_factory=list)
    cut: bool = False

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

    def each(self, ways: Iterable[T]) -> Iterator[T]:
        """Those of a step's ways that may be begun in time."""
        for way in ways:
            if self.cuts():
                return
            yield way

    def cuts(self) -> bool:
        """Whether a step has to end with what it has."""
        self.cut = self.cut or self._over()
        return self.cut

    def _over(self) -> bool:
        return self.stop() or time.monotonic() >= self.until


def after(began: float, seconds: float | None, stop: Callable[[], bool] | None = None) -> Budget:
    """What is left for the search of so many seconds since then, the baseline being fitted."""
    until = math.inf
    if seconds is not None:
        now = time.monotonic()
        until = max(now, began + seconds - AFTERWARDS * (now - began))
    return Budget(until, stop or _never)

"""What may go wrong, said in a sentence."""

from __future__ import annotations

from collections.abc import Iterable


class SimulationError(ValueError):
    """A sentence for the user: what is wrong with a request."""


class UnknownWord(SimulationError):
    """A word that is none of those there are. what: what it would be, such as scenario."""

    def __init__(self, what: str, word: str, known: Iterable[str]) -> None:
        self.word, self.known = word, tuple(known)
        super().__init__(f"no {what} {word!r}; there are {', '.join(self.known)}")

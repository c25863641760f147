"""Ctrl-C as a question before it is an end."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# What is said when it is pressed during a search.
ENDING = "ending with the best model so far (Ctrl-C again: leave with nothing)"


@contextmanager
def asked(told: Callable[[str], None]) -> Iterator[Callable[[], bool]]:
    """What says whether Ctrl-C was pressed: the first one asks for an end, and is told so; the next
    one ends the program as ever. (Unless the parent process ignores it.) In the main thread."""
    pressed = False
    before = signal.getsignal(signal.SIGINT)

    def first(_number: int, _frame: object) -> None:
        nonlocal pressed
        pressed = True
        signal.signal(signal.SIGINT, before)
        told(ENDING)

    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, first)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)

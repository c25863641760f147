"""What ends the program from outside, and with which status."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

INTERRUPTED = 130
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C. (After a plain KeyboardInterrupt in an exec() Python ends by the signal itself,
    whatever status is asked for.)"""


class Ended:
    """A handler that raises, so that what is half written is taken away; ``status`` says what
    came, as a callback (of numba's compiler) may swallow the exception."""

    def __init__(self) -> None:
        self.status: int | None = None

    def __call__(self, number: int, _frame: object) -> NoReturn:
        """Leave by an exception."""
        self.status = 128 + number
        sys.unraisablehook = lambda _: None  # (it would be shown where it is swallowed)
        if number == signal.SIGINT:
            raise Interrupted
        sys.exit(self.status)


def at_once(number: int, _frame: object) -> NoReturn:
    """A handler for the time in which nothing is half written; imports may swallow exceptions."""
    if number == signal.SIGINT:
        os.write(2, b"handcal: interrupted\n")
    os._exit(128 + number)


def listen(handler: Callable[[int, object], NoReturn]) -> None:
    """Let this handler hear what ends the program, unless the parent process ignores it (nohup)."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def over() -> None:
    """All is done, and the status known: while Python takes itself down, what ends the program
    would only give it another status (a signal's own, as it has no handler any more)."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)

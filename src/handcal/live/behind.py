"""A process that works behind a session, and ends with it, however the session ends."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context

from handcal.workers import ONE_THREAD

# Between looks at whether the session's process is still there, s.
LOOK_S = 0.5
# Readings are to be taken and shown at once; an estimate may come later.
NICE = 5


def worker() -> Executor:
    """One process of one thread, which gives way to the session's."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    return ProcessPoolExecutor(1, get_context("spawn"), _tied, (os.getpid(),))


def _tied(parent: int) -> None:
    """In the new process: an interrupt is for the parent, and it ends when the parent is gone
    (killed, it cannot say so)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(1)

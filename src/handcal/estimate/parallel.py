"""Compiled code that writes into arrays of its caller, on two cores.

(Whatever has more Python in it gains little from threads, of which one at a time may run that; it
is given to ``forked.in_parallel``.)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from functools import partial
from itertools import islice
from typing import TypeVar

T = TypeVar("T")
# (of more than two the memory they work in is the limit)
AT_ONCE = 2
# Whether the other core has work already.
BUSY: ContextVar[bool] = ContextVar("busy", default=False)


def two_cores() -> bool:
    """Whether this process may use two."""
    allowed = getattr(os, "sched_getaffinity", None)
    cores = os.cpu_count() or 1
    return (cores if allowed is None else min(cores, len(allowed(0)))) >= AT_ONCE


def in_threads(calls: Iterable[Callable[[], T]]) -> Iterator[T]:
    """What the calls return, in their order; one or two run at a time.

    Threads, since compiled code lets others go on; in the context of the caller, who may have a
    catalogue of his own. Whoever stops asking leaves those that have
    not begun undone.
    """
    if BUSY.get() or not two_cores():
        yield from (call() for call in calls)
        return
    # (a context can be entered by one thread at a time: each call has a copy of its own)
    waiting = (partial(copy_context().run, call) for call in calls)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        running: list[Future[T]] = [pool.submit(call) for call in islice(waiting, AT_ONCE)]
        try:
            while running:
                result = running.pop(0).result()
                running += [pool.submit(call) for call in islice(waiting, 1)]
                yield result
        finally:
            for future in running:
                future.cancel()

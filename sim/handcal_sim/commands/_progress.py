"""Progress of long trials, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from handcal.commands._registry import say

EVERY_S = 30.0  # between two lines in a log


@contextmanager
def progress(total: int, doing: str, done: str) -> Iterator[Callable[[int], None]]:
    """How far it is and the time left: a bar, or a line now and then in a log. doing, done: what
    the bar and the line call it. What is yielded is told of each so many that are finished."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeElapsedColumn as Elapsed
    from rich.progress import TimeRemainingColumn as Remaining

    started = said = time.monotonic()
    finished = 0
    columns = (TextColumn(doing), BarColumn(), MofNCompleteColumn(), Elapsed(),
               TextColumn("left"), Remaining())  # fmt: skip
    terminal = sys.stderr.isatty()
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not terminal) as bar:
        task = bar.add_task("", total=total)

        def advance(count: int = 1) -> None:
            nonlocal finished, said
            finished += count
            bar.advance(task, count)
            now = time.monotonic()
            if not terminal and now - said > EVERY_S:
                left = (now - started) / finished * (total - finished)
                say(f"{finished} of {total} {done}; about {left / 60:.0f} min left")
                said = now

        yield advance

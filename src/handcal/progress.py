"""A progress bar on stderr, for terminals, once something has taken two seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

PATIENCE_S = 2.0


class Bar:
    """Shows how far something has come: ``bar(fraction)``, or ``bar()`` to say it is alive."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.started = time.monotonic()
        self.visible = sys.stderr.isatty()
        self.shown: Progress | None = None

    def __call__(self, fraction: float | None = None) -> None:
        if self.shown is None and self.visible and time.monotonic() - self.started > PATIENCE_S:
            self._show()
        if self.shown is not None and fraction is not None:
            self.shown.update(self.shown.task_ids[0], completed=fraction, total=1.0)

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        self.shown = Progress(*columns, console=Console(stderr=True), transient=True)
        self.shown.add_task(self.text, total=None)
        self.shown.start()


@contextmanager
def progress(text: str) -> Iterator[Bar]:
    """Call what this yields with the fraction done, as often as you like."""
    bar = Bar(text)
    try:
        yield bar
    finally:
        if bar.shown is not None:
            bar.shown.stop()

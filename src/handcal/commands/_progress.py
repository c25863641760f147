"""A progress bar on stderr once something has taken two seconds; where that is no terminal, a line
for each stage."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from handcal.commands._registry import say

if TYPE_CHECKING:
    from rich.progress import Progress

PATIENCE_S = 2.0


class Bar:
    """Shows how far something has come: ``bar(fraction)``, ``bar(fraction, stage)``; ``bar()`` says
    that it is alive."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.started = time.monotonic()
        self.visible = sys.stderr.isatty()
        self.shown: Progress | None = None
        self.stage = ""

    def __call__(self, fraction: float | None = None, stage: str = "") -> None:
        if stage and stage != self.stage:
            self.stage = stage
            self._begin(stage)
        if self.shown is None and self.visible and time.monotonic() - self.started > PATIENCE_S:
            self._show()
        if self.shown is not None and fraction is not None:
            self.shown.update(self.shown.task_ids[0], completed=fraction, total=1.0)

    def _begin(self, stage: str) -> None:
        """Say which stage begins."""
        if self.visible:
            if self.shown is not None:
                self.shown.update(self.shown.task_ids[0], description=f"{self.text}: {stage}")
        elif time.monotonic() - self.started > PATIENCE_S:
            say(f"{self.text}: {stage}")

    def _show(self) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        from handcal.show.console import Terminal

        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
        self.shown = Progress(*columns, console=Terminal(stderr=True), transient=True)
        named = f"{self.text}: {self.stage}" if self.stage else self.text
        self.shown.add_task(named, total=None)
        self.shown.start()

    def describe(self, text: str) -> None:
        """Say something else beside the bar."""
        self.text = text
        self()
        if self.shown is not None:
            self.shown.update(self.shown.task_ids[0], description=text)


@contextmanager
def progress(text: str) -> Iterator[Bar]:
    """Call what this yields with the fraction done, as often as you like."""
    bar = Bar(text)
    try:
        with _compiling(bar) if bar.visible else nullcontext():
            yield bar
    finally:
        if bar.shown is not None:
            bar.shown.stop()


@contextmanager
def _compiling(bar: Bar) -> Iterator[None]:
    """Say so while numba compiles: that takes long, and only the first time."""
    from numba.core import event

    text = bar.text

    class Told(event.Listener):
        depth = 0

        def on_start(self, event: Any) -> None:  # noqa: ARG002
            self.depth += 1
            bar.describe(f"{text}: compiling, only this once")

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            self.depth -= 1
            if self.depth == 0:
                bar.describe(text)

    with event.install_listener("numba:compile", Told()):
        yield

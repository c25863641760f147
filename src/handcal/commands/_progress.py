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
BAR = 16  # letters wide


class Bar:
    """Shows how far something has come: ``bar(fraction)``, ``bar(fraction, stage)``; ``bar()`` says
    that it is alive."""

    def __init__(self, text: str, patience: float | None = None) -> None:
        self.text = text
        self.patience = patience
        self.started = time.monotonic()
        self.visible = sys.stderr.isatty()
        self.shown: Progress | None = None
        self.stage = ""

    def __call__(self, fraction: float | None = None, stage: str = "") -> None:
        if stage and stage != self.stage:
            self.stage = stage
            self._begin()
        if self.shown is None and self.visible and self._waited():
            self._show()
        if self.shown is not None and fraction is not None:
            self.shown.update(self.shown.task_ids[0], completed=fraction, total=1.0)

    def _begin(self) -> None:
        """Say which stage begins."""
        if self.visible:
            self._redraw()
        elif self._waited():
            say(self._named())

    def _waited(self) -> bool:
        patience = PATIENCE_S if self.patience is None else self.patience
        return time.monotonic() - self.started >= patience

    def _named(self) -> str:
        return f"{self.text}: {self.stage}" if self.stage else self.text

    def _redraw(self) -> None:
        if self.shown is not None:
            from handcal.search.budget import SO_FAR  # (nothing else of a search is needed here)

            # (what has been found so far is a line of its own)
            text = SO_FAR.replace("; ", "\n").join(self._named().rsplit(SO_FAR, 1))
            self.shown.update(self.shown.task_ids[0], description=text)

    def _show(self) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Column

        from handcal.show.console import Terminal

        wide = Column(ratio=1, no_wrap=True, overflow="ellipsis")
        said = TextColumn("{task.description}", markup=False, table_column=wide)
        columns = TimeElapsedColumn(), BarColumn(BAR), said
        self.shown = Progress(*columns, console=Terminal(stderr=True), transient=True, expand=True)
        self.shown.add_task("", total=None)
        self._redraw()
        self.shown.start()

    def hide(self) -> None:
        """Make room for what is to be printed; the next call shows the bar again."""
        if self.shown is not None:
            self.shown.stop()
            self.shown = None

    def announce(self, text: str) -> None:
        """A line of its own."""
        if self.shown is None:
            say(text)
        else:
            self.shown.console.print(f"handcal: {text}", markup=False, highlight=False)

    def describe(self, text: str) -> None:
        """Say something else beside the bar."""
        self.text = text
        self()
        self._redraw()


@contextmanager
def progress(text: str, patience: float | None = None) -> Iterator[Bar]:
    """Call what this yields with the fraction done, as often as you like. patience: s before
    anything is shown, ``PATIENCE_S`` if not given."""
    bar = Bar(text, patience)
    try:
        with _compiling(bar) if bar.visible else nullcontext():
            yield bar
    finally:
        bar.hide()


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

"""Laboratory methods: a known input, the gravity norm, the size effect, temperature; the papers."""

from __future__ import annotations

from functools import cached_property
from importlib.metadata import EntryPoint

import typer

from handcal.commands._registry import Commands, folder


class Methods(Commands):
    """One file in this folder is one command."""

    @cached_property
    def plugins(self) -> dict[str, EntryPoint]:
        """By name; nothing is imported."""
        return folder(__name__)


commands = typer.Typer(
    cls=Methods, add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


@commands.callback()
def _root() -> None:
    """Calibrate with a turntable, a cube or only a table, and repeat what the papers say."""

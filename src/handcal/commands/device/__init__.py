"""Keep what is known of one physical device over time, as the next session's prior."""

from __future__ import annotations

from functools import cached_property
from importlib.metadata import EntryPoint

import typer

from handcal.commands._registry import Commands, folder


class Steps(Commands):
    """One file in this folder is one command."""

    @cached_property
    def plugins(self) -> dict[str, EntryPoint]:
        """By name; nothing is imported."""
        return folder(__name__)


commands = typer.Typer(
    cls=Steps, add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


@commands.callback()
def _root() -> None:
    """Keep what is known of one device over time, for `calibrate --device`, `explain --device`."""

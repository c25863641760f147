"""Keep what is known of one physical device over time, as the next session's prior."""

from __future__ import annotations

from handcal.commands._registry import group

commands = group(__name__)


@commands.callback()
def _root() -> None:
    """Keep what is known of one device over time, for `calibrate --device`, `explain --device`."""

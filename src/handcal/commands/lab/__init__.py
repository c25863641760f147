"""Laboratory methods: a known input, the gravity norm, the size effect, temperature; the papers."""

from __future__ import annotations

from handcal.commands._registry import group

commands = group(__name__)


@commands.callback()
def _root() -> None:
    """Calibrate with a turntable, a cube or a plain table; reproduce the figures of the papers."""

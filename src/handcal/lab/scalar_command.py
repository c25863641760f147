"""The command ``lab scalar``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def scalar(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording with rests in many attitudes.")
    ],
) -> None:
    """Calibrate against the size of gravity alone: rests in many attitudes, and turns between."""
    raise typer.Exit(1)

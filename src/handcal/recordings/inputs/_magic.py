"""Formats that are known by their first bytes."""

from __future__ import annotations

from pathlib import Path


def begins_with(path: Path, magic: bytes) -> bool:
    """Whether this is a file that begins with these bytes. Raises OSError."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(magic)) == magic

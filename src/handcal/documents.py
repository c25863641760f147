"""JSON and TOML of the user's, read; what cannot be is said in one sentence."""

from __future__ import annotations

import contextlib
import hashlib
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from handcal.types import InputError


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Where a file is read: what the system refuses becomes an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error


def read_json(path: Path) -> Any:
    """What a JSON file holds, of whatever type. Errors: InputError."""
    with reading(path):
        data = path.read_bytes()
    try:
        return json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not JSON.") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Errors: InputError."""
    with reading(path):
        data = path.read_bytes()
    return toml_of(path, data)


def toml_of(path: Path, data: bytes) -> dict[str, Any]:
    """The same of a file that was read already. Errors: InputError."""
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not TOML ({str(error)[:80]}).") from None


def own_toml(
    path: Path, schema: str, what: str, made: str, most: int
) -> tuple[dict[str, Any], str]:
    """The tables of a TOML file that handcal wrote, and its sha256; what: the file's name among
    people, made: how one is made, most: bytes. Errors: InputError."""
    with reading(path):
        data = path.read_bytes()
    if len(data) > most:
        raise InputError(f"{path} is no {what}: it is too large.")
    document = toml_of(path, data)
    if document.get("schema") != schema:
        raise InputError(f"{path} is no {what}; {made} makes one.")
    return document, hashlib.sha256(data).hexdigest()

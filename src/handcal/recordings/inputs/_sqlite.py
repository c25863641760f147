"""SQLite databases of strangers: opened to be read only, within bounds, and nothing in it runs."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from handcal.recordings.inputs._magic import begins_with
from handcal.types import InputError

MAGIC = b"SQLite format 3\0"
LARGEST_VALUE = 16 * 2**20
MOST_STEPS = 4_000  # of a hundred thousand instructions each


def is_database(path: Path) -> bool:
    """By the first bytes."""
    return begins_with(path, MAGIC)


def tables(path: Path) -> set[str]:
    """Names of its tables, without views; empty where it is damaged."""
    try:
        with opened(path) as database:
            rows = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            return {str(name) for (name,) in rows.fetchmany(1000)}
    except InputError:
        return set()


@contextmanager
def opened(path: Path, largest: int = LARGEST_VALUE) -> Iterator[sqlite3.Connection]:
    """The database; largest: bytes of a value. Errors: InputError for whatever SQLite says while
    it is read."""
    steps = iter(range(MOST_STEPS))
    try:
        uri = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, largest)
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA cell_size_check = ON")
            database.set_progress_handler(lambda: next(steps, None) is None, 100_000)
            yield database
    except (sqlite3.Error, sqlite3.Warning, OverflowError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is a damaged database, or none of its kind: {error}.") from error

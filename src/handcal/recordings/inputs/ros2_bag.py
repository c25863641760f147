"""ROS 2 bags: a folder with .db3 or .mcap files and metadata.yaml, or a .db3 file alone.

The messages, units and signs are those of mcap.py, decoded by the same code: rad/s, m/s^2 with +g
on the axis up at rest (REP 103, REP 145), tesla, metres. Of several that hold a pose a PoseStamped
comes first, then Odometry and TransformStamped. What the database says of itself is not believed:
its tables have to be tables, nothing in it is executed, and it is opened to be read only.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import zstandard

from handcal.recordings.inputs import mcap
from handcal.recordings.inputs._messages import Part, Topic, schema_key
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._sqlite import is_database, opened, tables
from handcal.recordings.inputs._topics import parts_of, readable, recording_from_topics
from handcal.types import InputError, IntArray, Recording

UNDERSTOOD = "a ROS 2 bag (a folder with .db3 or .mcap, or .db3)"
UNITS = mcap.UNITS
STREAMS_READ = "all that MCAP has, also from Odometry and TransformStamped"
TRIED = "bags written by the package rosbags, SQLite and MCAP"
ENDINGS = (".db3",)
MARK = "it is no SQLite database with the tables topics and messages"
MEMBERS = ("metadata.yaml",)
LARGEST_MESSAGE = 2**20
_AT_ONCE = 5000
_ZSTD = b"\x28\xb5\x2f\xfd"


def can_read(path: Path) -> bool:
    """By the tables of the database, or as a folder of such files or of MCAP."""
    if path.is_dir():
        return bool(_files(path)) or bool(_packed(path))
    return is_database(path) and {"topics", "messages"} <= tables(path)


def _files(path: Path) -> list[Path]:
    """The bag's files in the order of their recording; none of a folder that is no bag."""
    databases = [p for p in _numbered(path, ".db3") if is_database(p)]
    if (path / "metadata.yaml").is_file():
        return databases or _numbered(path, ".mcap")
    return databases if len(databases) == 1 else []


def _numbered(path: Path, ending: str) -> list[Path]:
    found = [p for p in path.iterdir() if p.suffix == ending and p.is_file()]
    return sorted(found, key=lambda p: (len(p.name), p.name))  # (bag_10 follows bag_9)


def _packed(path: Path) -> list[Path]:
    return [p for p in path.iterdir() if p.name.endswith((".db3.zstd", ".mcap.zstd"))]


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    files = _files(path) if path.is_dir() else [path]
    if not files:
        raise InputError(
            f"{path} is compressed as a whole ({_packed(path)[0].name}): unpack it first (zstd -d)."
        )
    topics: list[Topic] = []
    said: list[str] = []
    about: dict[str, dict[str, str]] = {}
    base = 0
    for file in files:
        if file.suffix == ".mcap":
            walk = mcap.walked(file, options, base)
            found, warnings = mcap.topics_of(walk), mcap.warnings_of(walk)
            about |= walk.about
        else:
            found, warnings = _of_database(file, options, base)
        topics += found
        said += warnings
        base += 2 * file.stat().st_size + 1
    return mcap.with_notes(recording_from_topics(path, topics, options, tuple(said)), about)


def _of_database(path: Path, options: Options, base: int) -> tuple[list[Topic], tuple[str, ...]]:
    """Topics of one .db3, and warnings. Errors: InputError."""
    left = path.with_name(path.name + "-wal")
    said: tuple[str, ...] = ()
    if left.is_file() and left.stat().st_size:
        said = (f"{path.name} was not closed: what is in {left.name} is not read.",)
    parts: dict[int, list[Part]] = {}
    with opened(path) as database:
        topics = _topics(path, database)
        known = [id for id, topic in topics.items() if readable(topic)]
        for id, datas, log_ns in _messages(path, database, known):
            lengths = np.array([len(data) for data in datas], dtype=np.int64)
            starts = np.cumsum(lengths) - lengths
            buffer = np.frombuffer(b"".join(datas), dtype=np.uint8)
            parts.setdefault(id, []).extend(
                parts_of(buffer, starts, lengths, log_ns, base, topics[id])
            )
            base += len(buffer)
    options.progress(1.0)
    return [
        Topic(t.name, t.schema, t.encoding, tuple(parts.get(id, ()))) for id, t in topics.items()
    ], said


def _topics(path: Path, database: sqlite3.Connection) -> dict[int, Topic]:
    found = {}
    for id, name, kind, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics LIMIT 10000"
    ):
        if not isinstance(id, int) or not all(isinstance(x, str) for x in (name, kind, encoding)):
            raise InputError(f"{path} is damaged: a topic of it is illegible.")
        found[id] = Topic(name, schema_key(kind), encoding, ())
    return found


def _messages(
    path: Path, database: sqlite3.Connection, known: list[int]
) -> Iterator[tuple[int, list[bytes], IntArray]]:
    """Messages of some topics, a topic and some thousand at a time. Errors: InputError."""
    for id in known:
        rows = database.execute("SELECT timestamp, data FROM messages WHERE topic_id = ?", (id,))
        while batch := rows.fetchmany(_AT_ONCE):
            if not all(isinstance(t, int) and isinstance(d, bytes) for t, d in batch):
                raise InputError(f"{path} is damaged: a message of it is illegible.")
            yield (
                id,
                [_unpacked(path, data) for _, data in batch],
                np.array([t for t, _ in batch], dtype=np.int64),
            )


def _unpacked(path: Path, data: bytes) -> bytes:
    """A message, decompressed where it is by itself. Errors: InputError."""
    if not data.startswith(_ZSTD):
        return data
    try:
        if zstandard.get_frame_parameters(data).content_size > LARGEST_MESSAGE:
            raise InputError(f"{path} has a message that would unpack to too much.")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_MESSAGE)
    except zstandard.ZstdError as error:
        raise InputError(f"{path} is damaged: a message cannot be decompressed.") from error

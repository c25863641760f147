"""ROS 2 bags: a folder with .db3 or .mcap files and metadata.yaml, or a .db3 file alone.

The messages, units and signs are those of mcap.py, decoded by the same code: rad/s, m/s^2 with +g
on the axis up at rest (REP 103, REP 145), tesla, metres. Of several that hold a pose a PoseStamped
comes first, then Odometry and TransformStamped. What the database says of itself is not believed:
its tables have to be tables, nothing in it is executed, and it is opened to be read only.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import zstandard
from mcap.records import Channel, Schema
from mcap.records import Message as Record

from handcal.recordings.inputs import mcap
from handcal.recordings.inputs._messages import Part, Topic, schema_key
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._sqlite import is_database, opened, tables
from handcal.recordings.inputs._topics import parts_of, readable, recording_from_topics
from handcal.recordings.streams import message_of
from handcal.types import InputError, IntArray, Recording

UNDERSTOOD = "a ROS 2 bag (a folder with .db3 or .mcap, or .db3)"
UNITS = mcap.UNITS
STREAMS_READ = "all that MCAP has, also from Odometry and TransformStamped"
TRIED = "bags written by the package rosbags, SQLite and MCAP"
ENDINGS = (".db3",)
MARK = "it is no SQLite database with the tables topics and messages"
MEMBERS = ("metadata.yaml",)
LARGEST_MESSAGE, LARGEST_COPIED = 2**20, 2**28  # bytes: of an IMU, and of a camera
_AT_ONCE = 5000
# What a channel of an MCAP says of a topic, and the column of the database.
_DESCRIBED = {"offered_qos_profiles": "offered_qos_profiles",
              "topic_type_hash": "type_description_hash"}  # fmt: skip
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
    files = files_of(path)
    if not files:
        raise InputError(
            f"{path} is compressed as a whole ({_packed(path)[0].name}): unpack it first (zstd -d)."
        )
    topics, said, about = topics_in(files, options)
    return mcap.with_notes(recording_from_topics(path, topics, options, said), about)


def files_of(path: Path) -> list[Path]:
    """The files of a bag, in the order of their recording: of a folder, or the file itself."""
    return _files(path) if path.is_dir() else [path]


def topics_in(
    files: Sequence[Path], options: Options
) -> tuple[list[Topic], tuple[str, ...], dict[str, dict[str, str]]]:
    """The topics of the files of a bag, warnings, and metadata records by name. Errors:
    InputError."""
    topics: list[Topic] = []
    said: list[str] = []
    about: dict[str, dict[str, str]] = {}
    base = 0
    for file in files:
        if is_database(file):
            found, warnings = _of_database(file, options, base)
        else:
            walk = mcap.walked(file, options, base)
            found, warnings = mcap.topics_of(walk), mcap.warnings_of(walk)
            about |= walk.about
        topics += found
        said += warnings
        base += mcap.LARGEST_RATIO * file.stat().st_size + 1
    return topics, tuple(said), about


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
        for id, datas, log_ns, row in _messages(path, database, known):
            lengths = np.array([len(data) for data in datas], dtype=np.int64)
            starts = np.cumsum(lengths) - lengths
            buffer = np.frombuffer(b"".join(datas), dtype=np.uint8)
            parts.setdefault(id, []).extend(
                parts_of(buffer, starts, lengths, log_ns, base + row, topics[id])
            )
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
) -> Iterator[tuple[int, list[bytes], IntArray, IntArray]]:
    """Messages of some topics, a topic and some thousand at a time, with their times and rows.
    Errors: InputError."""
    for id in known:
        rows = database.execute(
            "SELECT timestamp, data, rowid FROM messages WHERE topic_id = ? ORDER BY rowid", (id,)
        )
        while batch := rows.fetchmany(_AT_ONCE):
            if not all(isinstance(t, int) and isinstance(d, bytes) for t, d, _ in batch):
                raise InputError(f"{path} is damaged: a message of it is illegible.")
            log_ns, row = np.array([(t, n) for t, _, n in batch], dtype=np.int64).T
            yield id, [unpacked(path, data) for _, data, _ in batch], log_ns, row


def unpacked(path: Path, data: bytes, largest: int = LARGEST_MESSAGE) -> bytes:
    """A message, decompressed where it is by itself. Errors: InputError."""
    if not data.startswith(_ZSTD):
        return data
    try:
        if zstandard.get_frame_parameters(data).content_size > largest:
            raise InputError(f"{path} has a message that would unpack to too much.")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=largest)
    except zstandard.ZstdError as error:
        raise InputError(f"{path} is damaged: a message cannot be decompressed.") from error


def records(path: Path) -> Iterator[Schema | Channel | Record]:
    """Everything in a .db3 as MCAP has it: schemas, channels and messages, which have no number.
    Errors: InputError."""
    with opened(path, LARGEST_COPIED) as database:
        texts = {}
        if "message_definitions" in tables(path):
            rows = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            texts = {str(kind): (str(encoding), str(text)) for kind, encoding, text in rows}
        names = [row[1] for row in database.execute("PRAGMA table_info(topics)")]
        for schema, id in enumerate(_topics(path, database), 1):
            row = database.execute("SELECT * FROM topics WHERE id = ?", (id,)).fetchone()
            of = dict(zip(names, row, strict=True))
            kind, known = of["type"], message_of(of["type"])
            own = ("ros2msg", known.definition) if known else ("", "")
            encoding, text = texts.get(kind, own)
            yield Schema(schema, text.encode(), encoding, kind)
            said = {name: str(of[key]) for name, key in _DESCRIBED.items() if of.get(key)}
            yield Channel(id, of["name"], of["serialization_format"], said, schema)
        for id, ns, data in database.execute(
            "SELECT topic_id, timestamp, data FROM messages ORDER BY rowid"
        ):
            if not isinstance(ns, int) or ns < 0 or not isinstance(data, bytes):
                raise InputError(f"{path} is damaged: a message of it is illegible.")
            yield Record(id, ns, unpacked(path, data, LARGEST_COPIED), ns, 0)

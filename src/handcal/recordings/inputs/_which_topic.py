"""Which topic of a file is which stream: by schema, by usual name, or as the user says.

Gyro and accelerometer may have a topic each, both of ``sensor_msgs/msg/Imu`` with one half zero or
marked as none (RealSense's driver does so): together they are the IMU.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from handcal.recordings.inputs._messages import POSE_LIKE, Topic, read_as
from handcal.recordings.inputs._options import HALVES, Options
from handcal.recordings.streams import STREAMS, TWINS, Stream
from handcal.types import InputError

# Of a name that says so: before a driver took anything off.
_RAW = re.compile(r"(^|[/_.-])raw($|[/_.-])")


def chosen_topics(
    path: Path, topics: Sequence[Topic], options: Options
) -> tuple[Mapping[str, str], list[str]]:
    """Topic by stream, and where there was a choice, what was taken. Errors: InputError if there
    is no IMU, or several that fit."""
    said: list[str] = []
    chosen = {s: name for s, name in options.topics.items() if name}
    if "imu" in chosen and set(HALVES) & set(chosen):
        raise InputError("--topic imu and --topic gyro, accel say the same: give one of them.")
    by_schema = _names(topics, chosen)
    for stream, name in chosen.items():
        schema = STREAMS["imu" if stream in HALVES else stream].message.schema
        if name not in by_schema.get(schema, ()):
            raise InputError(f"--topic {stream}={name}: {_no_such(path, name, schema, topics)}")
    # What models say was read, beside what was read, is taken only where it is chosen.
    apart = tuple(f"{begin}/" for begin in TWINS)
    # Those with a name first: what is left of their schema is then more easily the other.
    for row in sorted(STREAMS.values(), key=lambda row: not row.named):
        if row.name in options.topics:
            continue
        free = [n for n in by_schema.get(row.message.schema, ()) if n not in chosen.values()]
        free = [n for n in free if not n.startswith(apart)]
        if row.name == "imu":
            halves = _halves(path, {n: _holds(n, topics) for n in free}, options.topics)
            chosen |= halves
            said += _joined(halves, topics)
            if imu_topics(chosen):
                continue
            free = [n for n in free if all(_holds(n, topics))] or free
        fitting = _fitting(free, row, path)
        if fitting is not None:
            chosen[row.name] = fitting
            said += _choice(row, fitting, free, topics)
    _check_imu(path, topics, chosen, options)
    return chosen, said


def _no_such(path: Path, name: str, schema: str, topics: Sequence[Topic]) -> str:
    """Why a topic cannot be a stream whose messages are of this schema."""
    types = " or ".join([schema, *(other for other in POSE_LIKE if read_as(other) == schema)])
    own = [topic for topic in topics if topic.name == name]
    if not own:
        return f"{path} has no such topic; {types} is needed, and {_listing(topics)}."
    if all(read_as(topic.schema) != schema for topic in own):
        held = own[0].schema or "no schema"
        return f"its messages are {held}; {types} is needed, and {_listing(topics)}."
    return f"it holds no messages in cdr or json; {_listing(topics)}."


def _names(topics: Sequence[Topic], chosen: Mapping[str, str]) -> dict[str, list[str]]:
    """Names of the topics that hold messages, by the schema of the stream that they could be."""
    by_schema: dict[str, list[str]] = {}
    exact = {topic.schema for topic in topics if topic.parts}
    for topic in topics:
        schema = read_as(topic.schema)
        # What only holds a pose is one where there is no better, or where it is chosen.
        if schema != topic.schema and schema in exact and topic.name not in chosen.values():
            continue
        names = by_schema.setdefault(schema, [])
        if topic.parts and topic.name not in names:
            names.append(topic.name)
    return by_schema


def _check_imu(
    path: Path, topics: Sequence[Topic], chosen: Mapping[str, str], options: Options
) -> None:
    """Errors: InputError where there is no IMU, or the user named the topic of one sensor alone."""
    own = [s for s in HALVES if s in chosen]
    other = next(s for s in HALVES if s not in own[:1])
    if len(own) == 1 and own[0] in options.topics and other in options.needs:
        raise InputError(
            f"--topic {own[0]}={chosen[own[0]]} is one sensor of two: name the other's topic too, "
            f"--topic {other}=TOPIC, or, for both from one topic, --topic imu={chosen[own[0]]}."
        )
    if not imu_topics(chosen):
        raise InputError(
            f"{path} has no IMU: no messages of sensor_msgs/msg/Imu in cdr or json; "
            f"{_listing(topics)}."
        )


def _holds(name: str, topics: Sequence[Topic]) -> tuple[bool, bool]:
    """Whether any message of a topic holds a rate, and a force. Drivers that have the two apart
    leave the other zero, or say that it is none."""
    own = [part.decoded for topic in topics if topic.name == name for part in topic.parts]
    rate, force = (
        any(bool((d.value[:, at] != 0.0)[~d.lacking[:, k]].any()) for d in own)
        for k, at in enumerate((slice(3), slice(3, 6)))
    )
    return rate, force


def _halves(
    path: Path, held: Mapping[str, tuple[bool, bool]], chosen: Mapping[str, str]
) -> dict[str, str]:
    """The topics of gyro and accelerometer that the user has not chosen, where no topic of ``held``
    has both. Errors: InputError where there are several for one."""
    apart = {"gyro": [n for n, has in held.items() if has == (True, False)],
             "accel": [n for n, has in held.items() if has == (False, True)]}  # fmt: skip
    if not set(HALVES) & set(chosen) and sum(map(len, apart.values())) < len(held):
        return {}
    found = {s: sorted(apart[s]) for s in HALVES if s not in chosen}
    if any(len(names) > 1 for names in found.values()):
        options = {s: [chosen[s]] if chosen.get(s) else found.get(s, []) for s in HALVES}
        likely = _likely(*options.values())
        listed = "; ".join(f"{s} in {', '.join(names)}" for s, names in options.items() if names)
        raise InputError(
            f"{path} has gyroscope and accelerometer in topics of their own, and several: "
            f"{listed}. Choose with {' '.join(f'--topic {s}={n}' for s, n in likely.items())}."
        )
    return {s: names[0] for s, names in found.items() if names}


def _likely(gyros: Sequence[str], accels: Sequence[str]) -> dict[str, str]:
    """The first gyro and the accelerometer whose name begins as its for the longest; one where
    there is no other."""
    if not (gyros and accels):
        return {s: names[0] for s, names in zip(HALVES, (gyros, accels), strict=True) if names}
    return {"gyro": gyros[0], "accel": max(accels, key=lambda name: _alike(gyros[0], name))}


def _alike(a: str, b: str) -> int:
    """How many letters two names have in common before the first that differs."""
    return next((k for k in range(min(len(a), len(b))) if a[k] != b[k]), min(len(a), len(b)))


def _joined(halves: Mapping[str, str], topics: Sequence[Topic]) -> list[str]:
    """That the IMU is made of two topics."""
    if len(halves) < 2:
        return []
    gyro, accel = (_sized(halves[sensor], topics) for sensor in HALVES)
    return [f"The gyroscope of {gyro} and the accelerometer of {accel} were joined."]


def _sized(name: str, topics: Sequence[Topic]) -> str:
    parts = [part for topic in topics if topic.name == name for part in topic.parts]
    return f"{name} ({sum(len(part.order) for part in parts)} messages)"


def _choice(row: Stream, taken: str, free: list[str], topics: Sequence[Topic]) -> list[str]:
    """Which of several topics was taken for a stream, and why."""
    if row.named or len(free) < 2:
        return []

    why = "its usual name" if taken.endswith(row.topic) else "the raw one"
    others = sorted(name for name in free if name != taken)
    listed = ", ".join(_sized(name, topics) for name in others)
    return [
        f"{row.title}: of {len(free)} topics {_sized(taken, topics)} was taken, {why}; there "
        f"{'are' if len(others) > 1 else 'is'} also {listed}; choose with "
        f"--topic {row.name}={others[0]}."
    ]


def _fitting(free: list[str], row: Stream, path: Path) -> str | None:
    """The one topic for a stream; by its usual name where several have the schema, else raw."""
    usual, spare = row.topic, row.named and row.inertial  # (there must be one for the IMU)
    for named in ([n for n in free if n == usual], [n for n in free if n.endswith(usual)]):
        if len(named) == 1 and (len(free) > 1 or not spare):
            return named[0]
    if row.named or not free:
        return None
    raw = [n for n in free if _RAW.search(n)]
    if len(free) == 1 or len(raw) == 1:
        return (raw or free)[0]
    raise InputError(
        f"{path} has several topics that could be {row.name}: {', '.join(sorted(free))}; "
        f"choose one with --topic {row.name}={sorted(free)[0]}."
    )


def _listing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "it holds no topics"
    held = sorted({f"{t.name} ({t.schema or 'no schema'}, {t.encoding})" for t in topics})
    more = f" and {len(held) - 12} more" if len(held) > 12 else ""
    return f"it holds {', '.join(held[:12])}{more}"


def imu_topics(chosen: Mapping[str, str]) -> tuple[str, ...]:
    """The topics of the IMU: one, or one for each of its sensors."""
    return tuple(chosen[name] for name in ("imu", *HALVES) if name in chosen)


def by_stream(chosen: Mapping[str, str], topics: Sequence[Topic]) -> dict[str, list[Topic]]:
    """The channels of each stream. Of a topic that is one sensor of the IMU the messages hold no
    reading of the other."""
    held: dict[str, list[Topic]] = {}
    for stream, name in chosen.items():
        own = [topic for topic in topics if topic.name == name and topic.parts]
        if stream in HALVES:
            own = [_of_one(topic, HALVES.index(stream)) for topic in own]
        held.setdefault("imu" if stream in HALVES else stream, []).extend(own)
    return held


def _of_one(topic: Topic, sensor: int) -> Topic:
    """A topic whose messages say that they hold no reading but that of one sensor."""
    parts = []
    for part in topic.parts:
        lacking = part.decoded.lacking.copy()
        lacking[:, 1 - sensor] = True
        parts.append(replace(part, decoded=replace(part.decoded, lacking=lacking)))
    return replace(topic, parts=tuple(parts))

"""Of a session that lasted for hours, the part that is explained: no machine explains a day.

The file is walked chunk by chunk, so that its end takes no more memory than its middle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from handcal.live.session import recording_of
from handcal.recordings import append
from handcal.recordings.export import Pieces, write_pieces
from handcal.types import Array, IntArray, Recording

# A quarter of an hour: what a minute or two of turns do not show hardly comes in more of it, and
# explaining it takes minutes and a gigabyte or two.
EXPLAINED_S = 900.0
# How much it was turned is summed up by the minute, ns.
MINUTE_NS = 60 * 1_000_000_000
# Axes and signs are told by the first minutes, ns.
FIRST_NS = 5 * MINUTE_NS
NAME = "part.mcap"
Change = Callable[[Pieces], Pieces]


def beginning(path: Path) -> Recording | None:
    """The first minutes of what was recorded; None below two samples."""
    first = next((int(ns[0]) for ns, _ in _imu(path)), 0)
    return between(path, first, first + FIRST_NS, lambda pieces: pieces)


def rewritten(path: Path, change: Change) -> None:
    """The recording in its place with this made of each batch, and with an end. Errors: OSError
    where it cannot be written; it then stays as it was."""
    write_pieces((change(held.streams) for held in append.each(path)), path)


def most_turned(path: Path) -> tuple[int, int]:
    """From where to where (ns) it was turned most within EXPLAINED_S, by whole minutes."""
    turned: dict[int, float] = {}
    begin, last = 0, None
    for ns, value in _imu(path):
        begin = begin if last is not None else int(ns[0])
        step = np.diff(ns, prepend=ns[0] if last is None else last) / 1e9
        last = ns[-1]
        rate = np.linalg.norm(value[:, :3], axis=1) * np.minimum(step, 1.0)
        minutes = (ns - begin) // MINUTE_NS
        for k in np.unique(minutes):
            turned[int(k)] = turned.get(int(k), 0.0) + float(rate[minutes == k].sum())
    count = round(EXPLAINED_S * 1e9 / MINUTE_NS)
    sums = np.array([turned.get(k, 0.0) for k in range(max(turned, default=0) + 1)])
    whole = np.convolve(sums, np.ones(count), mode="valid") if len(sums) > count else sums[:1]
    k = int(np.argmax(whole))
    return begin + k * MINUTE_NS, begin + (k + count) * MINUTE_NS


def between(path: Path, begin: int, end: int, change: Change) -> Recording | None:
    """What was recorded from begin to end (ns), with this made of each batch; None below two
    samples."""
    parts: dict[str, list[tuple[IntArray, Array]]] = {"imu": []}
    for held in append.each(path):
        for name, (ns, value) in change(held.streams).items():
            own = (ns >= begin) & (ns < end)
            if own.any():
                parts.setdefault(name, []).append((ns[own], value[own]))
        if "imu" in held.streams and held.streams["imu"][0][0] >= end:
            break
    if not parts["imu"]:
        return None
    streams: Mapping[str, tuple[IntArray, Array]] = {
        name: (np.concatenate([ns for ns, _ in some]), np.concatenate([v for _, v in some]))
        for name, some in parts.items()
    }
    return recording_of(path, streams)


def _imu(path: Path) -> Iterator[tuple[IntArray, Array]]:
    for held in append.each(path):
        ns, value = held.streams.get("imu", (np.zeros(0, dtype=np.int64), np.zeros((0, 6))))
        if len(ns):
            yield ns, value

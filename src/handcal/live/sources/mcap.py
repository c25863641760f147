"""A ROS 2 topic through the MCAP file that a recorder is writing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from handcal.live.session import Batch, Session
from handcal.live.sources.pairing import Pairing
from handcal.recordings.follow import Followed, News
from handcal.recordings.inputs import Options
from handcal.types import Array, IntArray

# A batch has no more samples of the IMU: what was written before we came is taken in pieces.
MOST = 4000


@dataclass
class Growing:
    """A recorder's file."""

    followed: Followed
    pairing: Pairing = field(default_factory=Pairing)

    def pull(self, into: Session) -> bool:
        """Record what is new; False once the recorder has ended the file. Errors: InputError for
        what is no such file; Refused."""
        record(self.followed.news(), self.pairing, into, "recorder")
        return not self.followed.complete


def record(news: Mapping[str, News], pairing: Pairing, into: Session, client: str) -> None:
    """Record messages that have arrived, in batches of a size that fits. Errors: Refused."""
    others = {name: one for name, one in news.items() if name != "imu"}
    if "imu" in news:
        imu = news["imu"]
        finite = np.isfinite(imu.value).all(axis=1)
        rate, force = (~imu.lacking[:, i] & finite for i in range(2))
        pairing.add((imu.ns[rate], imu.value[rate, :3]), (imu.ns[force], imu.value[force, 3:]))
    ns, rates, forces = pairing.ready()
    parts = max(1, -(-len(ns) // MOST))
    ends = [int(ns[min((k + 1) * MOST, len(ns)) - 1]) for k in range(parts)] if len(ns) else [0]
    ends[-1] = 2**62
    begin = -(2**62)
    for end in ends:
        own = (ns > begin) & (ns <= end)
        pieces = {name: _between(one, begin, end) for name, one in others.items()}
        further = {name: piece for name, piece in pieces.items() if len(piece[0])}
        if own.any() or further:
            into.take(Batch(client, into.next, ns[own], rates[own], forces[own], further))
        begin = end


def _between(one: News, begin: int, end: int) -> tuple[IntArray, Array]:
    own = (one.ns > begin) & (one.ns <= end) & ~one.lacking.any(axis=1)
    own &= np.isfinite(one.value).all(axis=1)
    return one.ns[own], one.value[own]


def growing(path: Path, options: Options) -> Growing:
    """The file, from its beginning: what the session has already is not recorded twice."""
    return Growing(Followed(path, options))

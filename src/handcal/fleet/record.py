"""What travels: one recording to be explained, with what options, and what came of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

RECORD_SCHEMA = "handcal/fleet-recording/1"
DONE, FAILED, TIMED_OUT, OUT_OF_MEMORY, KILLED, CRASHED, UNREACHABLE = (
    "done", "failed", "timed_out", "out_of_memory", "killed", "crashed", "unreachable",
)  # fmt: skip
# What another run may do better: it is tried again by the same command.
PASSING = (TIMED_OUT, OUT_OF_MEMORY, KILLED, UNREACHABLE)
WORK = "handcal.fleet.work:explained"
Document = dict[str, Any]


@dataclass(frozen=True)
class Source:
    """One recording: path on this machine, or address; model and device ("" if not known),
    started (ISO, or ""), what else the manifest says of it, and of an address what stands for its
    bytes (``remote.Found.identity``)."""

    place: str
    model: str = ""
    device: str = ""
    started: str = ""
    others: Mapping[str, str] = field(default_factory=dict)
    identity: str = ""

    @property
    def shown(self) -> str:
        """Where it is, without what may be secret in an address."""
        return shown(self.place)


@dataclass(frozen=True)
class Options:
    """What a result depends on, and its limits: budget s of explain (None: none), the sha256 of the
    file of priors and the model taken of it, ("" without), and the work itself (``module:name``).
    deadline s and memory bytes decide only whether there is a result."""

    deadline: float
    memory: int
    budget: float | None = None
    priors: str = ""
    work: str = WORK


def shown(place: str) -> str:
    """A path as it is, an address without name and password and what follows a ``?``."""
    if "://" not in place:
        return place
    parts = urlsplit(place)
    return urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))


def digest(path: Path) -> str:
    """sha256 of a recording: of its bytes, of a folder of its files with their names. Errors:
    OSError."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    whole = hashlib.sha256()
    for one in sorted(p for p in path.rglob("*") if p.is_file()):
        with one.open("rb") as file:
            own = hashlib.file_digest(file, "sha256").hexdigest()
        whole.update(f"{one.relative_to(path).as_posix()}\0{own}\n".encode())
    return whole.hexdigest()


def key(sha256: str, version: str, options: Options, prior: Mapping[str, Any] | None) -> str:
    """Under which a result is kept: 32 hexadecimal digits of the recording's bytes, the program's
    version, the options that change results, and the prior that it was made with."""
    own = {"budget": options.budget, "work": options.work}
    text = json.dumps([sha256, version, own, prior], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]

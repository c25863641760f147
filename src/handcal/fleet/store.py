"""What is kept of a fleet: DIR/recordings/KEY.json, one record each, and beside it
DIR/explanations/KEY.json. A record is written last and whole, so what is there is finished."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from handcal import output
from handcal.fleet import remote
from handcal.fleet.record import (
    OUT_OF_MEMORY,
    PASSING,
    RECORD_SCHEMA,
    TIMED_OUT,
    Document,
    Options,
    digest,
    shown,
)
from handcal.types import HandcalError, InputError

RECORDS, EXPLANATIONS, DIGESTS = "recordings", "explanations", "digests.jsonl"


@dataclass(frozen=True)
class Store:
    """A folder, and the digests of recordings that were read before, by path, size and time; where
    results go to an address, that folder and the names of the records in it."""

    folder: Path
    digests: dict[tuple[str, int, int], str] = field(default_factory=dict)
    upstream: remote.Folder | None = None
    there: frozenset[str] = frozenset()

    @property
    def shown(self) -> str:
        """Where results are, as people are told."""
        return str(self.folder) if self.upstream is None else shown(self.upstream.address)

    def record(self, key: str) -> Document | None:
        """What is kept under a key; None where nothing is, or something damaged. Errors:
        Unreachable."""
        name = f"{RECORDS}/{key}.json"
        if self.upstream and f"{key}.json" in self.there and not (self.folder / name).exists():
            self.upstream.fetch(name, self.folder / name)
        try:
            document = json.loads((self.folder / RECORDS / f"{key}.json").read_text("utf-8"))
        except (OSError, ValueError):
            return None
        own = isinstance(document, dict) and document.get("schema") == RECORD_SCHEMA
        return document if own else None

    def keep(self, key: str, record: str, explanation: str) -> None:
        """Keep both, as JSON ("": none), the record last. Errors: HandcalError."""
        for kind, text in ((EXPLANATIONS, explanation), (RECORDS, record)):
            if text:
                # (what was left there is taken away when the store is opened)
                output.write_text(self.folder / kind / f"{key}.json", text + "\n", tidy=False)
                self.send(f"{kind}/{key}.json")

    def send(self, name: str) -> None:
        """A file, or all in a folder, to the address to which results go, if they do. Errors:
        Unreachable."""
        if self.upstream is not None:
            self.upstream.send(self.folder, name)

    def digest(self, path: Path) -> str:
        """sha256 of a recording, read only if it has changed. Errors: OSError."""
        if not path.is_file():
            return digest(path)
        about = path.stat()
        known = (str(path), about.st_size, about.st_mtime_ns)
        if known not in self.digests:
            self.digests[known] = digest(path)
            line = json.dumps([*known, self.digests[known]]) + "\n"
            with (self.folder / DIGESTS).open("a", encoding="utf-8") as file:
                file.write(line)
        return self.digests[known]

    def all(self) -> Iterator[tuple[str, Document]]:
        """Every record that is kept, of whatever options."""
        for path in sorted((self.folder / RECORDS).glob("*.json")):
            record = self.record(path.stem)
            if record is not None:
                yield path.stem, record


def opened(folder: Path) -> Store:
    """The store of a folder, made where there is none. Errors: InputError where the folder holds
    something else; HandcalError where it cannot be made."""
    mine = (folder / RECORDS).is_dir()
    if folder.exists() and not mine and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--out {folder} holds something else than a fleet; name a new folder.")
    try:
        for name in (RECORDS, EXPLANATIONS):
            (folder / name).mkdir(parents=True, exist_ok=True)
            output.take_away_left(folder / name)
    except OSError as error:
        raise HandcalError(f"{folder} could not be made: {error.strerror or error}.") from error
    return Store(folder, _digests(folder / DIGESTS))


@contextmanager
def opened_at(place: str) -> Iterator[Store]:
    """The store of a folder of this machine, or of one at an address: of that what is kept is sent
    there at once, and what is there is fetched when it is asked for. Errors: as of ``opened``;
    Unreachable."""
    if not remote.is_address(place):
        yield opened(Path(place))
        return
    upstream = remote.folder(place)
    if (names := upstream.names()) and RECORDS not in names:
        raise InputError(
            f"--out {shown(place)} holds something else than a fleet; name a new folder."
        )
    with tempfile.TemporaryDirectory(prefix="handcal-fleet-") as folder:
        there = upstream.names(RECORDS)
        yield replace(opened(Path(folder)), upstream=upstream, there=there)


def _digests(path: Path) -> dict[tuple[str, int, int], str]:
    out = {}
    if path.exists():
        for line in path.read_text("utf-8", errors="replace").splitlines():
            with suppress(ValueError, TypeError):  # (a line that was cut off)
                name, size, when, sha256 = json.loads(line)
                out[str(name), int(size), int(when)] = str(sha256)
        if os.path.getsize(path) and not path.read_bytes().endswith(b"\n"):
            with path.open("a", encoding="utf-8") as file:
                file.write("\n")
    return out


def told_files(folder: Path) -> tuple[Path, Path, Path]:
    """What is told of a fleet: as JSON, as priors, as a page."""
    return folder / "fleet.json", folder / "priors.toml", folder / "fleet.html"


def stands(record: Document | None, options: Options) -> bool:
    """Whether a record need not be made again: not where it was killed, nor where it came to a
    limit that is further now."""
    if record is None:
        return False
    if record["status"] not in PASSING:
        return True
    if record["status"] == TIMED_OUT:
        return bool(record["deadline"] >= options.deadline)
    return record["status"] == OUT_OF_MEMORY and bool(record["memory"] >= options.memory)

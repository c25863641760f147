"""Recordings and results at addresses (``s3://``, ``gs://``, ``https://``, ``sftp://``), by fsspec.

The process that asks for a fleet only lists addresses; the worker that explains a recording
fetches it, in parts, holds it while it is explained, and lets it go.
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any, TypeVar
from urllib.parse import urlsplit

from handcal.fleet.record import UNREACHABLE, shown
from handcal.types import HandcalError, InputError

T = TypeVar("T")
# Of a recording at a time: as large as S3 asks parts of an upload to be at the least.
PART = 5 << 20
# By what a storage tells one content from the next, the surest first; fsspec hands on the names
# that each protocol has.
MARKS = (
    "ETag",
    "etag",
    "md5Hash",
    "generation",
    "sha256",
    "LastModified",
    "Last-Modified",
    "mtime",
)
# Errors of clients that are no OSError, by the module that has them.
FOREIGN = (
    ("botocore.exceptions", "BotoCoreError"),
    ("botocore.exceptions", "ClientError"),
    ("aiohttp", "ClientError"),
    ("paramiko", "SSHException"),
    ("gcsfs.retry", "HttpError"),
    ("google.auth.exceptions", "GoogleAuthError"),
)


class Unreachable(HandcalError):
    """An address that could not be read now; another run may find it there."""

    status = UNREACHABLE


@dataclass(frozen=True)
class Found:
    """A file at an address; mark: what changes with its content ("" where the storage says nothing
    of that), size: bytes, or -1."""

    address: str
    mark: str
    size: int

    @property
    def identity(self) -> str:
        """What stands for the bytes, without having read them: 64 hexadecimal digits."""
        text = f"{shown(self.address)}\0{self.mark}\0{self.size}"
        return hashlib.sha256(text.encode()).hexdigest()


def is_address(text: str) -> bool:
    """Whether it is a protocol and a place, not a file of this machine."""
    return "://" in text


def found(address: str) -> list[Found]:
    """The file at an address, all below it, or what fits a pattern with ``*``. Errors: InputError
    where there is nothing; Unreachable."""
    storage, path = opened(address)
    if "*" in path or "?" in PurePosixPath(path).name:
        there = _asked(address, lambda: storage.glob(path, detail=True))
        files = [i for i in there.values() if i["type"] == "file"]
    else:
        about = _asked(address, lambda: storage.info(path))
        if about["type"] == "file" and not path.endswith("/"):  # (a web server's page of links)
            return [_of(storage, address, about)]
        below = _asked(address, lambda: storage.find(path, detail=True))
        files = list(below.values())
    if not files:
        raise InputError(f"{shown(address)}: there is no file.")
    return [_of(storage, str(storage.unstrip_protocol(i["name"])), i) for i in files]


def _of(storage: Any, address: str, about: dict[str, Any]) -> Found:
    if about.get("size") is None:  # (a page of links says no more than names)
        about = _asked(address, lambda: storage.info(about["name"]))
    size = about.get("size")
    mark = next((str(about[m]) for m in MARKS if about.get(m) is not None), "")
    return Found(address, mark, -1 if size is None else int(size))


@contextmanager
def fetched(place: str) -> Iterator[tuple[Path, str | None]]:
    """A recording as a file of this machine, and the sha256 of what was fetched (None: it is a file
    of this machine already); what was fetched goes with the context. Errors: Unreachable."""
    if not is_address(place):
        yield Path(place), None
        return
    storage, path = opened(place)
    with tempfile.TemporaryDirectory(prefix="handcal-") as folder:
        name = PurePosixPath(urlsplit(place).path).name or "recording"
        here, digest = Path(folder) / name, hashlib.sha256()

        def copied() -> None:
            with storage.open(path, "rb", block_size=PART) as source, here.open("wb") as to:
                while some := source.read(PART):
                    digest.update(some)
                    to.write(some)

        _asked(place, copied, Unreachable)  # (it was there when it was listed)
        yield here, digest.hexdigest()


def opened(address: str) -> tuple[Any, str]:
    """The storage (an fsspec file system) and the path in it. Errors: InputError for a protocol
    that there is not, or whose library is not installed; Unreachable."""
    core = _fsspec()
    try:
        storage, path = _asked(address, lambda: core.url_to_fs(address))
    except InputError:
        raise
    except ImportError as error:
        raise InputError(f"{shown(address)}: {error}") from None
    except ValueError as error:
        raise InputError(f"{shown(address)}: {error}.") from None
    return storage, str(path)


def _fsspec() -> ModuleType:
    try:
        import fsspec.core
    except ImportError:
        raise InputError(
            "Addresses are read by fsspec, which is not installed: pip install fsspec, and s3fs, "
            "gcsfs, paramiko or aiohttp for s3://, gs://, sftp:// or https://."
        ) from None
    core: ModuleType = fsspec.core
    return core


def _asked(address: str, ask: Callable[[], T], missing: type[HandcalError] = InputError) -> T:
    """What a storage answers. Errors: ``missing`` where nothing is there; Unreachable."""
    try:
        return ask()
    except FileNotFoundError:
        raise missing(f"{shown(address)}: there is nothing.") from None
    except _errors() as error:
        said = str(error).replace(address, shown(address)).strip() or type(error).__name__
        raise Unreachable(f"{shown(address)} could not be read: {said}") from None


def _errors() -> tuple[type[Exception], ...]:
    """Of the system, and of those clients that are loaded."""
    loaded = ((sys.modules.get(module), name) for module, name in FOREIGN)
    own = (getattr(m, name) for m, name in loaded if m is not None and hasattr(m, name))
    return (OSError, *own)


@dataclass(frozen=True)
class Folder:
    """A folder at an address, to which results go."""

    address: str
    storage: Any
    path: str

    def names(self, below: str = "") -> frozenset[str]:
        """Of what lies in it, or in a folder of it; none where there is no such folder. Errors:
        Unreachable."""
        where = f"{self.path}/{below}".rstrip("/")
        try:
            there = _asked(self.address, lambda: self.storage.ls(where, detail=False))
        except InputError:
            return frozenset()
        return frozenset(PurePosixPath(n).name for n in there if n.rstrip("/") != where)

    def fetch(self, name: str, to: Path) -> None:
        """A file of it. Errors: InputError, Unreachable."""
        _asked(self.address, lambda: self.storage.get_file(f"{self.path}/{name}", str(to)))

    def send(self, folder: Path, name: str) -> None:
        """A file of a folder of this machine under the same name, or all of one below it, which
        then has nothing else. Errors: Unreachable."""
        here, sent = folder / name, set[str]()
        for file in [p for p in here.rglob("*") if p.is_file()] if here.is_dir() else [here]:
            to = f"{self.path}/{file.relative_to(folder).as_posix()}"
            _asked(self.address, partial(self._send, file, to))
            sent.add(to)
        if here.is_dir():
            there = _asked(self.address, lambda: self.storage.find(f"{self.path}/{name}"))
            for old in set(there) - sent:
                _asked(self.address, partial(self.storage.rm_file, old))

    def _send(self, file: Path, to: str) -> None:
        self.storage.makedirs(to.rpartition("/")[0], exist_ok=True)
        self.storage.put_file(str(file), to)


def folder(address: str) -> Folder:
    """A folder at an address, there or not. Errors: InputError, Unreachable."""
    storage, path = opened(address)
    return Folder(address.rstrip("/"), storage, path.rstrip("/"))

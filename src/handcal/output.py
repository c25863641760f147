"""What is written for the user: whole or not at all, and never over what was read.

A file is written beside its place and takes it when it is complete, so a full disk or a killed
process leaves the old one. Pipes and devices are written to as they are.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from handcal.types import HandcalError, InputError, Recording

if sys.platform != "win32":
    import fcntl

STANDARD_OUTPUT = "-"
# s; a part without a lock was left by a process that was killed, or was begun just now.
LEFT_AFTER_S = 60.0
# What is read besides, within ``not_over``.
_READ: ContextVar[tuple[Path, ...]] = ContextVar("read", default=())


@contextlib.contextmanager
def not_over(paths: Iterable[Path]) -> Iterator[None]:
    """Inside, no output may be one of these files either, whichever command asks."""
    token = _READ.set((*_READ.get(), *paths))
    try:
        yield
    finally:
        _READ.reset(token)


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """A sentence, before any work is done, where an output has no folder to go to, would replace
    what is read, or would be written twice.

    Files are the same if they are one on the disk, by whatever link. Errors: InputError.
    """
    read = [path for path in (*inputs, *_READ.get()) if path is not None]
    written: list[Path] = []
    for path in outputs:
        if path is None or str(path) == STANDARD_OUTPUT:
            continue
        if not path.absolute().parent.is_dir():
            raise InputError(f"{path} cannot be written: there is no folder {path.parent}.")
        for source in read:
            if _same(path, source) or _within(path, source):
                raise InputError(
                    f"{path} is what is read ({source}); give the output another name."
                )
        if any(path.absolute() == other.absolute() or _same(path, other) for other in written):
            raise InputError(f"{path} is asked for twice; give each output a name of its own.")
        written.append(path)


def _same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:  # (one of them is not there)
        return False


def _within(path: Path, folder: Path) -> bool:
    """Whether a file that is there already lies in a folder that is read as a recording."""
    return folder.is_dir() and path.exists() and folder.resolve() in path.resolve().parents


def beside(path: Path, recordings: Sequence[Recording]) -> list[Path]:
    """The output of each recording: of one the path, of several with the recording's name added,
    and where two have the same name, with their number."""
    if len(recordings) == 1:
        return [path]
    stems = [Path(r.path).stem for r in recordings]
    often = Counter(stems)
    return [
        path.with_stem(f"{path.stem}-{s}" + (f"-{k}" if often[s] > 1 else ""))
        for k, s in enumerate(stems, 1)
    ]


@contextlib.contextmanager
def whole(path: str | Path, tidy: bool = True) -> Iterator[Path]:
    """Where to write what shall become ``path``, which it does at the end of the block. tidy: look
    through the folder for parts of it that were left, which takes time where many files are.

    Errors: HandcalError if it cannot be written; then what was there before still is.
    """
    place = Path(path)
    if place.exists() and not place.is_file():  # a pipe, a device
        with _said(place):
            yield place
        return
    place = place.resolve()  # (what a link leads to is replaced, not the link)
    with _said(Path(path)):
        if tidy:
            take_away_left(place.parent, f".{place.name}.")
        with _part(place) as part:
            yield part
            part.chmod(place.stat().st_mode & 0o777 if place.exists() else 0o666 & ~_umask())
            part.replace(place)


@contextlib.contextmanager
def _part(place: Path) -> Iterator[Path]:
    """A file beside a place, which is held for as long as it is being written."""
    handle, name = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name}.", suffix=".part")
    part = Path(name)
    try:
        if sys.platform == "win32" or not _held(handle):
            os.close(handle)
            handle = -1
        yield part
    finally:
        if handle >= 0:
            os.close(handle)
        part.unlink(missing_ok=True)


def _held(handle: int) -> bool:
    """Lock a file, so that no cleaning up removes it; False where the disk knows no locks, or
    another process has locked it."""
    if sys.platform == "win32":
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def take_away_left(folder: Path, begins: str = ".") -> None:
    """Remove the parts in a folder that processes left which were killed while they wrote. What
    another process is writing stays, and so does all where the system has no locks."""
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):  # (then whatever is to be written there will say it)
        for entry in list(os.scandir(folder)):
            if entry.name.startswith(begins) and entry.name.endswith(".part"):
                _take_away(entry.path)


def _take_away(part: str) -> None:
    with contextlib.suppress(OSError):  # (somebody else was faster, or may not)
        if time.time() - os.stat(part).st_mtime < LEFT_AFTER_S:
            return
        handle = os.open(part, os.O_RDWR)
        try:
            if _held(handle):
                os.unlink(part)
        finally:
            os.close(handle)


@contextlib.contextmanager
def _said(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        reason = error.strerror or error
        raise HandcalError(f"{path} could not be written: {reason}.") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_text(path: str | Path, text: str, tidy: bool = True) -> None:
    """Write a text for the user; tidy: as of ``whole``. Errors: HandcalError if it cannot be
    written."""
    with whole(path, tidy) as place:
        place.write_text(text, encoding="utf-8")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a picture or the like. Errors: HandcalError if it cannot be written."""
    with whole(path) as place:
        place.write_bytes(data)

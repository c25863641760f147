"""Zip files and folders as sets of small files, read within bounds.

Nothing is ever written, so a member's path is only its name; one that climbs out of its folder
is refused all the same, for no app exports one. What a zip says of itself is checked before
memory or time is spent on it: sizes, how far it would unpack, compression, encryption. A zip
inside a zip is not looked into.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePosixPath

from handcal.recordings.inputs._options import Options
from handcal.types import InputError

LARGEST = 512 * 2**20
# Tables of numbers shrink to a fifth, or, where a sensor says the same throughout, a fiftieth.
LARGEST_RATIO, RATIO_FROM = 200, 4 * 2**20
MOST_MEMBERS = 20_000
DEEPEST = 2
MOST_BEGUN = 100  # (to know a format by)
# What was listed within ``listed_once``, by path; None outside.
_LISTED: ContextVar[dict[Path, list[str] | None] | None] = ContextVar("listed", default=None)
# (IndexError: of a file without any name zipfile asks for the last letter)
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError, RuntimeError,
            IndexError)  # fmt: skip


def names_within(path: Path) -> set[str] | None:
    """Names of the files in a folder or zip, without what is before them, in small letters; None
    for anything else, damaged zips too."""
    listed = listing(path)
    return None if listed is None else {PurePosixPath(n).name.lower() for n in listed}


@contextmanager
def listed_once() -> Iterator[None]:
    """Inside, each folder or zip is listed once, however many formats ask what it holds."""
    token = _LISTED.set({})
    try:
        yield
    finally:
        _LISTED.reset(token)


def listing(path: Path) -> list[str] | None:
    """Paths inside a folder (two levels deep) or zip; None for anything else, damaged too."""
    listed = _LISTED.get()
    if listed is None:
        return _listing(path)
    if path not in listed:
        listed[path] = _listing(path)
    return listed[path]


def _listing(path: Path) -> list[str] | None:
    if path.is_dir():
        found = [f for depth in range(1, DEEPEST + 1) for f in path.glob("/".join("*" * depth))]
        return [f.relative_to(path).as_posix() for f in sorted(found) if f.is_file()]
    if not zipfile.is_zipfile(path):
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            return [m.filename.replace("\\", "/") for m in archive.infolist() if not m.is_dir()]
    except _DAMAGED:
        return None


def check_crowd(path: Path) -> None:
    """Errors: InputError for a zip of more files than are looked through once for each format."""
    if path.is_file() and zipfile.is_zipfile(path):
        _check_crowd(path, len(listing(path) or ()))


def _check_crowd(path: Path, size: int) -> None:
    if size > MOST_MEMBERS:
        raise InputError(f"{path} holds {size} files; it was not read.")


def beginnings(path: Path, wanted: Callable[[str], bool], size: int = 4096) -> Mapping[str, bytes]:
    """The first bytes of the first hundred such files of a folder or zip; none of a damaged one."""
    chosen = [name for name in listing(path) or () if wanted(name)][:MOST_BEGUN]
    if not chosen or not path.is_dir():
        return _beginnings_in_zip(path, chosen, size) if chosen else {}
    out = {}
    for name in chosen:
        with (path / name).open("rb") as file:
            out[name] = file.read(size)
    return out


def _beginnings_in_zip(path: Path, chosen: list[str], size: int) -> Mapping[str, bytes]:
    out = dict.fromkeys(chosen, b"")
    try:
        with zipfile.ZipFile(path) as archive:
            members = {m.filename.replace("\\", "/"): m for m in archive.infolist()}
            for name in chosen:
                out[name] = _begin(archive, members[name], size)
    except _DAMAGED:
        pass
    return out


def _begin(archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> bytes:
    try:
        with archive.open(member) as packed:
            return packed.read(size)
    except _DAMAGED:
        return b""


def contents(
    path: Path, wanted: Callable[[str], bool], options: Options | None = None
) -> Mapping[str, bytes]:
    """The files of a folder or zip whose path inside it is wanted, by that path.

    Errors: InputError for what is too much, encrypted, damaged, or climbs out of its folder.
    """
    if path.is_dir():
        return _of_folder(path, wanted, options)
    try:
        with zipfile.ZipFile(path) as archive:
            return _of_zip(path, archive, wanted, options)
    except _DAMAGED as error:
        raise InputError(f"{path} is a damaged zip file: {error}.") from error


def by_name(files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Files by their last name in small letters; of two alike the one that lies higher."""
    deepest_first = sorted(files, key=lambda name: (-name.count("/"), name))
    return {PurePosixPath(name).name.lower(): files[name] for name in deepest_first}


def whole(path: Path) -> bytes:
    """All of a file. Errors: InputError where it is too large to be read at once."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} is too large to be read at once.")
    return path.read_bytes()


def stated(program: str, options: Options) -> tuple[str, ...]:
    """The warning to somebody who gives units of a format that states its own."""
    return (f"{program} states its units: --units was ignored.",) if options.units else ()


def _of_folder(
    path: Path, wanted: Callable[[str], bool], options: Options | None
) -> Mapping[str, bytes]:
    names = [name for name in listing(path) or () if wanted(name)]
    if sum((path / name).stat().st_size for name in names) > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB to be read at once.")
    out = {}
    for k, name in enumerate(names):
        out[name] = (path / name).read_bytes()
        if options is not None:
            options.progress((k + 0.5) / len(names))
    return out


def _of_zip(
    path: Path,
    archive: zipfile.ZipFile,
    wanted: Callable[[str], bool],
    options: Options | None,
) -> Mapping[str, bytes]:
    every = archive.infolist()
    _check_crowd(path, len(every))
    for m in every:
        if ".." in m.filename.replace("\\", "/").split("/"):
            raise InputError(
                f"{path} has a path that leads out of it ({m.filename[:60]!r}): no app writes such "
                "a zip, so it was not read."
            )
    chosen = {m.filename.replace("\\", "/"): m for m in every if not m.is_dir()}
    chosen = {name: m for name, m in chosen.items() if wanted(name)}
    for m in chosen.values():
        _check(path, m)
    if sum(m.file_size for m in chosen.values()) > LARGEST:
        raise InputError(f"{path} would unpack to too much; it was not read.")
    out = {}
    for k, (name, m) in enumerate(chosen.items()):
        with archive.open(m) as file:
            out[name] = file.read(m.file_size + 1)
        if options is not None:
            options.progress((k + 0.5) / len(chosen))
    return out


def _check(path: Path, member: zipfile.ZipInfo) -> None:
    """Errors: InputError for a member that must not be unpacked."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{path}: the compression of {member.filename[:60]} is unknown.")
    if member.flag_bits & 1:
        raise InputError(f"{path} is encrypted.")
    if member.file_size > max(RATIO_FROM, LARGEST_RATIO * member.compress_size):
        raise InputError(
            f"{path} would unpack to too much ({member.filename[:60]}: {member.compress_size} "
            f"bytes to {member.file_size / 2**20:.0f} MiB); it was not read."
        )

"""Which recordings: files, folders, globs, and what a manifest says of them; checked beforehand."""

from __future__ import annotations

import csv
import glob
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path

from handcal.documents import reading
from handcal.fleet import remote
from handcal.fleet.record import Source
from handcal.types import InputError

COLUMNS = ("path", "device", "model", "started")


def found(sources: Sequence[str], own: str | None = None) -> tuple[list[Source], list[str]]:
    """Recordings in the order in which they were named, each once, and files of folders that are of
    no kind that handcal reads, by their endings. own: a folder (or address) that is passed over.
    Errors: InputError where there is nothing; Unreachable."""
    away = own if own is not None and remote.is_address(own) else None
    skipped = None if own is None or away else Path(own).resolve()
    recordings: dict[str, Source] = {}
    others: list[str] = []
    for source in sources:
        if remote.is_address(source):
            for file in remote.found(source):
                if away and file.address.startswith(f"{away.rstrip('/')}/"):
                    continue
                if file.address == source or _is_known(file.address):
                    recordings.setdefault(file.address, remote_source(file))
                else:
                    others.append(file.address)
            continue
        before = len(recordings)
        for path in _named(source):
            for one, known in _within(path):
                if skipped is not None and skipped in one.resolve().parents:
                    continue
                if known:
                    place = str(one.resolve())
                    recordings.setdefault(place, Source(place))
                else:
                    others.append(str(one))
        if len(recordings) == before and not any(_named(source)):
            raise InputError(f"{source}: there is no such file, folder or pattern.")
    return list(recordings.values()), others


def remote_source(file: remote.Found) -> Source:
    """A recording at an address."""
    return Source(file.address, identity=file.identity)


def _is_known(name: str) -> bool:
    return name.lower().endswith(_endings())


def _named(source: str) -> list[Path]:
    if Path(source).exists():
        return [Path(source)]
    return [Path(p) for p in sorted(glob.glob(source, recursive=True))]


@cache
def _endings() -> tuple[str, ...]:
    """Of the names of files that some format reads."""
    from handcal.recordings.inputs import formats

    own = {e for f in formats() for e in getattr(f, "ENDINGS", ())}
    return tuple(sorted(own | {".zip", ".csv"}))


def _within(path: Path) -> Iterator[tuple[Path, bool]]:
    """A recording itself, or what lies in a folder, and whether it is to be read."""
    if path.is_file():
        yield path, True
        return
    if _is_recording(path):
        yield path, True
        return
    for one in sorted(path.iterdir()):
        if one.name.startswith("."):
            continue
        if one.is_dir():
            yield from _within(one)
        else:
            yield one, _is_known(one.name)


def _is_recording(folder: Path) -> bool:
    """Whether a folder is one recording (of EuRoC, of an app) and not many."""
    from handcal.recordings.inputs import format_of

    try:
        format_of(folder)
    except InputError:
        return False
    return not _holds_several(folder)


def _holds_several(folder: Path) -> bool:
    """Whether it is a folder of recordings, one of them a folder (which formats find in it, since
    that is how recordings lie in zip files)."""
    inside = [one for one in folder.iterdir() if not one.name.startswith(".")]
    whole = sum(one.is_dir() and _is_recording(one) for one in inside)
    return whole > 1 or (whole == 1 and any(o.is_file() and _is_known(o.name) for o in inside))


def listed(manifest: Path) -> list[Source]:
    """The rows of a manifest: a CSV with ``path`` (from its own folder), and where known
    ``device``, ``model``, ``started`` (ISO 8601) and whatever else recordings may be grouped by.

    Errors: InputError with the number of the line.
    """
    with reading(manifest):
        try:
            text = manifest.read_text("utf-8-sig")
        except UnicodeDecodeError:
            raise InputError(f"{manifest} is no CSV in UTF-8.") from None
    rows = csv.DictReader(text.splitlines())
    names = rows.fieldnames or ()
    if "path" not in names:
        raise InputError(f"{manifest}: expected a first line with path, device, model, started.")
    out: dict[str, Source] = {}
    for number, row in enumerate(rows, 2):
        source = _row(manifest, number, row)
        if source.place in out:
            raise InputError(f"{manifest}, line {number}: {row['path']} is listed twice.")
        out[source.place] = source
    if not out:
        raise InputError(f"{manifest} lists no recording.")
    models: dict[str, str] = {}
    for s in out.values():
        if s.device and models.setdefault(s.device, s.model) != s.model:
            raise InputError(
                f"{manifest}: device '{s.device}' is of model '{models[s.device]}' and of model "
                f"'{s.model}'."
            )
    return list(out.values())


def _row(manifest: Path, number: int, row: dict[str, str]) -> Source:
    if None in row or None in row.values():
        raise InputError(f"{manifest}, line {number}: another number of fields than of columns.")
    source = _placed(manifest, number, row["path"].strip())
    started = row.get("started", "").strip()
    try:
        _ = started and datetime.fromisoformat(started)
    except ValueError:
        raise InputError(
            f"{manifest}, line {number}: started is '{started}'; expected 2026-05-01T12:00:00Z."
        ) from None
    others = {k: v.strip() for k, v in row.items() if k not in COLUMNS}
    text = {k: row.get(k, "").strip() for k in ("model", "device")}
    return replace(source, **text, started=started, others=others)


def _placed(manifest: Path, number: int, named: str) -> Source:
    """A recording by what its row calls it."""
    if remote.is_address(named):
        found = remote.found(named)
        if [f.address for f in found] != [named]:
            raise InputError(f"{manifest}, line {number}: {named} is no single file.")
        return remote_source(found[0])
    try:
        path = (manifest.parent / named).resolve()
        there = path.exists()
    except (OSError, ValueError):  # (too long, a link to itself, a zero byte: no name of a file)
        there = False
    if not there:
        raise InputError(f"{manifest}, line {number}: {named[:200]} does not exist.")
    return Source(str(path))


def joined(recordings: Sequence[Source], rows: Sequence[Source], group_by: str) -> list[Source]:
    """Recordings with what the manifest says of each: all of it without any recording. group_by:
    the column that is taken for the model. Errors: InputError where it does not say all."""
    by_place = {s.place: s for s in rows}
    if rows and group_by not in ("model", "device", *rows[0].others):
        raise InputError(f"--group-by {group_by}: the manifest has no such column.")
    if not rows and group_by != "model":
        raise InputError(f"--group-by {group_by} needs a --manifest with such a column.")
    missing = [s.shown for s in recordings if rows and s.place not in by_place]
    if missing:
        raise InputError(
            f"{missing[0]} is not in the manifest ({len(missing)} of {len(recordings)} recordings)."
        )
    chosen = [by_place.get(s.place, s) for s in recordings] if recordings else list(rows)
    if group_by == "model":
        return chosen
    return [replace(s, model=s.device if group_by == "device" else s.others[group_by])
            for s in chosen]  # fmt: skip

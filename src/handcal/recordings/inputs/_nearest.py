"""A file that no format reads: which formats there are, which came nearest, and what it lacks."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from handcal.recordings.inputs._zip import names_within

MOST_NAMED = 4
# Where in a file of its own handcal says what it is.
BEGINNING = 4096
_OWN = re.compile(rb'"?schema"?\s*[:=]\s*"handcal/([a-z-]+)/')
_KINDS = {
    "calibration": "the result of a calibration",
    "explanation": "the result of handcal explain",
    "allan": "the result of handcal allan",
    "info": "the result of handcal info",
    "device": "a device file",
}


def of_no_format(path: Path, formats: Sequence[ModuleType]) -> str:
    """The sentence for somebody whose file or folder fits none."""
    if own := _of_handcal(path) or _of_folder(path, formats):
        return own
    if names_within(path) == set():
        return f"{path} holds no recording: it is empty."
    read = "; ".join(str(module.UNDERSTOOD) for module in formats)
    return f"{path} is of no known format. {_nearest(path, formats)}Understood are: {read}."


def _nearest(path: Path, formats: Sequence[ModuleType]) -> str:
    """Which format came nearest and why it is not that; "" where none came near."""
    names = names_within(path)
    if names is not None:
        found = max(formats, key=lambda m: len(_members(m) & names), default=None)
        if found is None or not _members(found) & names:
            held = ", ".join(sorted(names)[:MOST_NAMED])
            return f"It holds {held}, which are no files of any of them. "
        lacks = ", ".join([n for n in found.MEMBERS if n.lower() not in names][:MOST_NAMED])
        return f"Nearest is {found.UNDERSTOOD}: it lacks {lacks}. "
    same = [m for m in formats if path.suffix.lower() in getattr(m, "ENDINGS", ())]
    marked = [f"{m.UNDERSTOOD}, but {m.MARK}" for m in same if getattr(m, "MARK", "")]
    return f"By its name it could be {' or '.join(marked)}. " if marked else ""


def _of_handcal(path: Path) -> str:
    """What to do with a file that handcal wrote; "" where it did not."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        found = _OWN.search(file.read(BEGINNING))
    if found is None:
        return ""
    kind = found[1].decode()
    said = f"{path} is {_KINDS.get(kind, 'a result of handcal')} and no recording"
    if kind in ("calibration", "explanation"):
        return f"{said}: handcal apply RECORDING --from {path} takes what it says off one."
    return f"{said}: name the recording that it was made of."


def _of_folder(path: Path, formats: Sequence[ModuleType]) -> str:
    """What to do with a file that is a part of a recording; "" where it is none."""
    if not path.is_file():
        return ""
    name, folder = path.name.lower(), path.parent
    found = next((m for m in formats if name in _members(m) and m.can_read(folder)), None)
    if found is None:
        return ""
    return (
        f"{path} is a part of {found.UNDERSTOOD}, which is read by its folder: handcal info "
        f"{shlex.quote(str(folder))}."
    )


def _members(module: ModuleType) -> set[str]:
    return {name.lower() for name in getattr(module, "MEMBERS", ())}

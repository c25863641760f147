"""A file that no format reads: which formats there are, which came nearest, and what it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from handcal.recordings.inputs._zip import names_within

MOST_NAMED = 4


def of_no_format(path: Path, formats: Sequence[ModuleType]) -> str:
    """The sentence for somebody whose file or folder fits none."""
    read = "; ".join(str(module.UNDERSTOOD) for module in formats)
    return f"{path} is of no known format. {_nearest(path, formats)}Understood are: {read}."


def _nearest(path: Path, formats: Sequence[ModuleType]) -> str:
    """Which format came nearest and why it is not that; "" where none came near."""
    names = names_within(path)
    if names is not None:
        found = max(formats, key=lambda m: len(_members(m) & names), default=None)
        if found is None or not _members(found) & names:
            held = ", ".join(sorted(names)[:MOST_NAMED]) or "nothing"
            return f"It holds {held}, which are no files of any of them. "
        lacks = ", ".join([n for n in found.MEMBERS if n.lower() not in names][:MOST_NAMED])
        return f"Nearest is {found.UNDERSTOOD}: it lacks {lacks}. "
    same = [m for m in formats if path.suffix.lower() in getattr(m, "ENDINGS", ())]
    marked = [f"{m.UNDERSTOOD}, but {m.MARK}" for m in same if getattr(m, "MARK", "")]
    return f"By its name it could be {' or '.join(marked)}. " if marked else ""


def _members(module: ModuleType) -> set[str]:
    return {name.lower() for name in getattr(module, "MEMBERS", ())}

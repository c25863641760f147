"""What the logs of PX4 and ArduPilot have in common: axes, stamps, messages of fixed layout, and
parameters of the calibration that readings went through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handcal.recordings.inputs._repair import Columns, columns
from handcal.types import Array, InputError

TURNED = np.array([1.0, -1.0, -1.0])  # forward, right, down to forward, left, up
Fields = Mapping[str, Array]
_AT_ONCE = 50_000


@dataclass
class Parameters:
    """Parameters by name, and those whose value changed: they are not known of all readings."""

    values: dict[str, float] = field(default_factory=dict)
    changed: set[str] = field(default_factory=set)

    def add(self, name: str, value: float) -> None:
        """One as the log has it next."""
        if name not in self.changed and self.values.setdefault(name, value) != value:
            del self.values[name]
            self.changed.add(name)

    def changes(self, program: str) -> list[str]:
        """A sentence about those that changed, if any did."""
        names = ", ".join(sorted(self.changed))
        return [f"{program}'s calibration changed during the log: {names}."] if names else []


def cut(messages: int) -> str:
    """Of a log of which not all could be read."""
    return f"The log ends early or is damaged: {messages} messages were recovered."


def rows(data: bytes, starts: Sequence[int], layout: np.dtype[np.void]) -> dict[str, Array]:
    """Fields (n,) of messages that begin at these places and lie within the data."""
    buffer, parts = np.frombuffer(data, dtype=np.uint8), []
    for k in range(0, len(starts), _AT_ONCE):  # (what places of bytes take is eightfold)
        places = np.array(starts[k : k + _AT_ONCE])[:, None] + np.arange(layout.itemsize)
        parts.append(buffer[places].view(layout)[:, 0])
    whole = np.concatenate(parts)
    return {one: whole[one] for one in layout.names or ()}


def vector(fields: Fields, names: Sequence[str], stamp: str, factor: float = 1.0) -> Columns:
    """A vector (n, 3) in forward, left, up. Errors: KeyError for a field that there is not,
    InputError for one that is no number."""
    value = np.column_stack([floats(fields[name]) for name in names])
    return columns(nanoseconds(fields[stamp]), factor * TURNED * value)


def floats(field: Array) -> Array:
    """Errors: InputError."""
    if field.dtype.kind not in "fiu":
        raise InputError("A reading of the log is declared as something else than a number.")
    return np.asarray(field, dtype=np.float64)


def nanoseconds(us: Array) -> Any:
    """Stamps (n,) in us since boot, in ns. Errors: InputError."""
    if us.dtype.kind not in "iu" or np.any(us > 9 * 10**15):
        raise InputError("A time stamp of the log is no number of microseconds since boot.")
    return us.astype(np.int64) * 1000

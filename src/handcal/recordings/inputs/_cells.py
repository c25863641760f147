"""A table as its file holds it, before anything is known of its columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from handcal.recordings.inputs._stamps import Clock
from handcal.types import Array


@dataclass(frozen=True)
class Table:
    """names: of the columns, () without a header; width: how many there are. numbers: of places,
    to columns (n, k), NaN for empty cells; clock: of the place of a time, to stamps as they stand.
    units: of a second header, () without; rate_hz: stated beside the table."""

    path: Path
    names: tuple[str, ...]
    width: int
    numbers: Callable[[Sequence[int]], Array]
    clock: Callable[[int], Clock]
    units: tuple[str, ...] = ()
    rate_hz: float | None = None

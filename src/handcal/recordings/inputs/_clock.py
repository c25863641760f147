"""Times as text: of the clock, with a date or without, and ISO 8601."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from handcal.types import InputError, IntArray

_DAY_NS = 86_400 * 10**9
_DATE = r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})|(\d{1,2})([./-])(\d{1,2})[./-](\d{4})"
_TIME = r"(\d{1,2}):(\d{2})(?::(\d{2}))?(?:[.,:](\d+))?\s*([ap]m)?"
_ZONE = r"\s*(?:z|utc|gmt|([+-])(\d{2}):?(\d{2}))?"
_MOMENT = re.compile(rf"(?:(?:{_DATE})(?:t|,?\s+))?{_TIME}{_ZONE}", re.IGNORECASE)
_EPOCH = date(1970, 1, 1).toordinal()


def is_clock(cell: str) -> bool:
    """Whether a cell is such a time."""
    return _MOMENT.fullmatch(cell.strip()) is not None


def is_date(cell: str) -> bool:
    """Whether a cell is a date alone."""
    return re.fullmatch(_DATE, cell.strip()) is not None


def of_clock(cells: Sequence[str], where: str) -> IntArray:
    """Stamps (n,) in ns of such times, on past midnight where there is no date; without a zone they
    are taken for UTC. Errors: InputError."""
    matches = [_MOMENT.fullmatch(cell.strip()) for cell in cells]
    for cell, match in zip(cells, matches, strict=True):
        if match is None:
            raise InputError(f"{where}: {cell[:40]!r} is no time of the clock as the others are.")
    found = [match for match in matches if match is not None]
    # (06/07/2024 may be either: of a day beyond 12 the order is known, of dots it is usual)
    day_first = any(m[4] and (m[5] == "." or int(m[4]) > 12) for m in found)
    try:
        ns = np.array([_day(m, day_first) + _of_day(m) for m in found], dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: a date is none of the calendar: {error}.") from error
    if found and found[0][1] is None and found[0][4] is None:
        ns += _DAY_NS * np.cumsum(np.diff(ns, prepend=ns[:1]) < -_DAY_NS // 2)
    return ns


def _day(match: re.Match[str], day_first: bool) -> int:
    """The day that begins, in ns since 1970; 0 without a date."""
    if match[1]:
        year, month, day = match[1], match[2], match[3]
    elif match[4]:
        year, month, day = match[7], match[4], match[6]
        month, day = (day, month) if day_first else (month, day)
    else:
        return 0
    return (date(int(year), int(month), int(day)).toordinal() - _EPOCH) * _DAY_NS


def _of_day(match: re.Match[str]) -> int:
    """Time since midnight in ns, UTC."""
    hour, minute, second, fraction, half = match[8], match[9], match[10], match[11], match[12]
    ns = int((fraction or "0")[:9].ljust(9, "0"))
    if second is None and fraction is not None:  # (minutes and seconds)
        return (int(hour) * 60 + int(minute)) * 10**9 + ns
    hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
    ns += ((hours * 60 + int(minute)) * 60 + int(second or 0)) * 10**9
    if match[13]:
        zone = (int(match[14]) * 60 + int(match[15])) * 60 * 10**9
        ns -= zone if match[13] == "+" else -zone
    return ns

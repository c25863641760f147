"""What the C library does with memory that was freed."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

# glibc's numbers for the size from which memory freed at the top of the heap is given back, for how
# many arrays may be mapped each for itself, and for how many heaps threads have.
_TRIM, _MAPS, _HEAPS = -1, -4, -8
_NEVER, _USUAL = 1 << 30, 1 << 16


def kept() -> None:
    """Keep freed memory for the next array, all threads theirs in one heap.

    A pass makes and frees arrays of megabytes by the hundred; that the system takes each back and
    hands it out anew, page by page and cleared, takes a twentieth of the time, and of a pass that
    keeps 90 MB of states three quarters. Only glibc is asked.
    """
    tell = _glibc("mallopt")
    if tell is not None:
        tell(_MAPS, 0)
        tell(_TRIM, _NEVER)
        tell(_HEAPS, 1)


def emptied() -> None:
    """Give back what was freed, once: before a copy of the process is made. Shared pages are copied
    one by one on the first write, which takes longer than new memory. Only glibc is asked."""
    trim = _glibc("malloc_trim")
    if trim is not None:
        trim(0)


def returned() -> None:
    """Give back what was freed and is kept, and from now on what is large at once: where little is
    made and freed beside what stays, and that is much. Only glibc is asked."""
    tell = _glibc("mallopt")
    if tell is not None:
        tell(_MAPS, _USUAL)
    emptied()


def _glibc(name: str) -> Any:
    """A function of the system's library; None where there is none of the name, or no Linux."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None

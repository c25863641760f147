"""What the C library does with memory that was freed."""

from __future__ import annotations

import ctypes
import sys

# glibc's numbers for the sizes from which memory is given back: freed at the top of the heap, and
# mapped for one array alone (its limit for that is 32 MB); and for how many heaps threads have.
_TRIM, _MAPPED, _HEAPS = -1, -3, -8
_NEVER, _LARGEST = 1 << 30, 1 << 25


def kept() -> None:
    """Keep freed memory for the next array, all threads theirs in one heap.

    A pass makes and frees arrays of megabytes by the hundred; that the system takes each back and
    hands it out anew, page by page and cleared, takes a twentieth of the time. Only glibc is asked.
    """
    if not sys.platform.startswith("linux"):
        return
    tell = getattr(ctypes.CDLL(None), "mallopt", None)
    if tell is not None:
        tell(_MAPPED, _LARGEST)
        tell(_TRIM, _NEVER)
        tell(_HEAPS, 1)


def returned() -> None:
    """Give back what was freed and is kept: where little is made and freed beside what stays, and
    that is much. Only glibc is asked."""
    if not sys.platform.startswith("linux"):
        return
    tell = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if tell is not None:
        tell(0)

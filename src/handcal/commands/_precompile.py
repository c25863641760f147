"""A second process that compiles while a first run does."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Where nothing is compiled yet, another process compiles what a fit needs last.

    It needs a core of its own. It prints nothing, its failure is ignored, and it ends with the
    block.
    """
    helper = _begun() if _cores() > 1 and _first_run() else None
    try:
        yield
    finally:
        if helper is not None:
            helper.terminate()
            helper.wait()


def _cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _first_run() -> bool:
    from handcal.compiled.disk_cache import nothing_kept
    from handcal.estimate import smoother

    # (what every fit ends with, and the other process begins with)
    return nothing_kept(smoother._forward)


def _begun() -> subprocess.Popen[bytes] | None:
    # -P: not what happens to lie where the command is run
    command = [sys.executable, "-P", "-m", "handcal.estimate.precompile"]
    none = subprocess.DEVNULL
    try:
        return subprocess.Popen(command, stdin=none, stdout=none, stderr=none)
    except OSError:
        return None

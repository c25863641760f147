"""How a peer answers ``handcal bench``: one measurement for every line it is sent.

It prints ``ready NAME VERSION`` once it has imported and prepared everything, or ``missing
PACKAGE`` where what it measures is not installed. For each line on its standard input it runs
its work once and prints the steps done, the CPU time and the wall time they took, in seconds.
It ends when its standard input does.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable


def missing(package: str) -> None:
    """Say which package is not installed, and end."""
    print("missing", package, flush=True)
    sys.exit(0)


def serve(name: str, work: Callable[[], int]) -> None:
    """work: does what is measured, once, and returns the number of its steps."""
    work()
    print("ready", name, flush=True)
    for _ in sys.stdin:
        cpu, wall = time.process_time(), time.perf_counter()
        steps = work()
        print(steps, time.process_time() - cpu, time.perf_counter() - wall, flush=True)

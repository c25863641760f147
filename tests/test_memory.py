"""Freed memory, of which the command line keeps what it has had."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from handcal.estimate.parallel import two_cores

# Pages that the system hands out while arrays of 1 MB are made and freed, after the first few.
FAULTS = """
import resource
import sys

import numpy as np

if sys.argv[1] == "kept":
    from handcal.compiled import memory

    memory.kept()
for n in range(20):
    if n == 5:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    x = [np.ones(125_000) for _ in range(40)]
    del x
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def _faults(how: str) -> int:
    command = [sys.executable, "-c", FAULTS, how]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="asks glibc alone")
def test_the_next_array_gets_the_memory_of_the_last() -> None:
    assert _faults("kept") < 0.05 * _faults("given back")


# Megabytes that a copy of the process begins with, beyond those before the arrays were made.
COPIED = """
import os
from functools import partial

import numpy as np

from handcal.compiled import memory
from handcal.estimate.forked import in_parallel


def resident(k):
    with open("/proc/self/statm") as told:
        return os.getpid(), int(told.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


memory.kept()
before = resident(0)[1]
x = [np.ones(125_000) for _ in range(200)]
del x
calls = [partial(resident, k) for k in range(4)]
print(max(mb for who, mb in in_parallel(calls) if who != os.getpid()) - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="asks glibc alone")
@pytest.mark.skipif(not two_cores(), reason="copies are made for a second core")
def test_a_copy_does_not_share_what_was_freed() -> None:
    command = [sys.executable, "-c", COPIED]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert float(told) < 50.0

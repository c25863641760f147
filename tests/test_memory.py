"""Freed memory, of which the command line keeps what it has had."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

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

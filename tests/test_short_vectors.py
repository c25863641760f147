"""What LLVM is told of the processor, beside what it finds itself."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from numba.core.codegen import get_host_cpu_features

ASK = "import handcal.compiled.jit, numba; print(numba.config.CPU_FEATURES)"
WIDE = "+avx512f" in get_host_cpu_features().split(",")


def told(**machine: str) -> str:
    """The features that a new process compiles for; "None": those that LLVM finds."""
    bare = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU_")}
    done = subprocess.run(
        [sys.executable, "-P", "-c", ASK], env=bare | machine, check=True, capture_output=True,
        text=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_loops_have_256_bits_where_the_processor_has_512():
    expected = f"{get_host_cpu_features()},+prefer-256-bit" if WIDE else "None"
    assert told() == expected


@pytest.mark.parametrize(
    ("machine", "expected"),
    [({"NUMBA_CPU_NAME": "x86-64-v3"}, "None"), ({"NUMBA_CPU_FEATURES": "+avx2"}, "+avx2")],
)
def test_who_names_a_processor_is_obeyed(machine, expected):
    assert told(**machine) == expected

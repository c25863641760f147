"""Machine code that comes with the package, for what most machines can do.

Made by ``scripts/compile.py --ship`` (`make dist`) and kept in ``shipped/`` beside this file, in
the same form as what is compiled on the spot. It is used where the source, numba and Python are the
same and the processor can run it; where anything differs, all is compiled as without it.
"""
# mypy: disallow-untyped-calls=False

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from llvmlite import binding

PACKAGE = Path(__file__).resolve().parents[1]
FOLDER = Path(__file__).resolve().parent / "shipped"


@dataclass(frozen=True)
class Target:
    """A processor as LLVM knows it, and what a machine must be able to do to run its code."""

    name: str
    needs: frozenset[str]


# The levels of the psABI of x86-64 (Intel's processors since 2013, AMD's since 2015), and any ARM
# of 64 bits.
V3 = Target("x86-64-v3", frozenset({
    "sse3", "ssse3", "sse4.1", "sse4.2", "popcnt", "cx16", "sahf",
    "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave",
}))  # fmt: skip
ARM = Target("generic", frozenset())
TARGETS = {"x86_64": V3, "amd64": V3, "aarch64": ARM, "arm64": ARM}


def target() -> Target | None:
    """That of this machine; None where there is none for it."""
    return TARGETS.get(platform.machine().lower())


@cache
def runs_here() -> bool:
    """Whether anything was shipped and this machine's processor can run it."""
    own = target()
    if own is None or not FOLDER.is_dir():
        return False
    can = binding.get_host_cpu_features()
    return all(can.get(feature) for feature in own.needs)


def folder_of(source: str) -> Path | None:
    """Where the machine code of a source file's functions is shipped; None of a file that is not
    the package's."""
    try:
        inside = Path(source).resolve().relative_to(PACKAGE)
    except ValueError:
        return None
    return FOLDER / inside.parent


def key_of(key: Any) -> Any:
    """The key of numba's cache (signature, machine, hashes), as it is for the shipped machine."""
    own = target()
    assert own is not None
    signature, (triple, _, _), digests = key
    return signature, (triple, own.name, ""), digests

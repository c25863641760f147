"""Numba with types: compiled functions that the type checker still understands."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import codegen
from numba.core.ccallback import CFunc
from numba.core.compiler import Compiler
from numba.extending import typeof_impl

from handcal.compiled.by_address import POINTER, called
from handcal.compiled.disk_cache import kept
from handcal.compiled.linking import LINKED, Inside, Outside
from handcal.types import Array, IntArray

F = TypeVar("F", bound=Callable[..., Any])

# Numba's default, 3, takes a third longer to compile, and the filter comes out slower; what is
# compiled is kept on disk for later processes, so the level must be the same for all.
if "NUMBA_OPT" not in os.environ:
    numba.config.OPT = type(numba.config.OPT)(2)  # type: ignore[attr-defined]


def _short_vectors() -> None:
    """Have loops that LLVM vectorises use 256 bits where the processor has 512.

    They are short (3 to 15 numbers), and most of a wide vector would be remainder. LLVM does so
    by itself for Intel's processors, not for AMD's: there the filter takes a sixth less. What is
    written in blocks of eight keeps 512 bits. Settings of the environment stand.
    """
    if "NUMBA_CPU_NAME" in os.environ or "NUMBA_CPU_FEATURES" in os.environ:
        return
    features: str = codegen.get_host_cpu_features()  # type: ignore[no-untyped-call]
    if "+avx512f" in features.split(","):
        numba.config.CPU_FEATURES = f"{features},+prefer-256-bit"  # type: ignore[attr-defined]


_short_vectors()

# (numba's own is partly typed, and not for this)
_njit: Any = numba.njit
_SIGNATURE = types.int64(POINTER, POINTER, POINTER, POINTER)


# What is written for the machine itself, or the same in plain loops.
WRITTEN: Any = importlib.import_module(f"handcal.compiled.{'generated' if LINKED else 'loops'}")
# Small work space of a compiled function, float64, its size known beforehand: on the stack, where
# it costs nothing (np.empty asks the heap). It is not set to zero, and must not be returned.
local_vector: Callable[[int], Array] = WRITTEN.local_vector
local_matrix: Callable[[int, int], Array] = WRITTEN.local_matrix


def _compiled(function: F, python: bool = True, **more: Any) -> F:
    # nothing calls these by address, so numba need not make a C entry for each of them
    options: dict[str, Any] = {
        "error_model": "numpy", "no_cfunc_wrapper": True, "nogil": True, **more,
    }  # fmt: skip
    if not LINKED:
        # (plain loops ask for work space, which numba must be let count)
        options.pop("_nrt", None)
        options.pop("forceinline", None)
        plain: Any = _njit(**options)(function)
        plain._cache = kept(function)
        return cast(F, plain)
    part: Any = _njit(pipeline_class=Inside, no_cpython_wrapper=True, **options)(function)
    part._cache = kept(function, part=True)
    if not python:
        return cast(F, part)
    dispatcher: Any = _njit(pipeline_class=Outside, **options)(function)
    dispatcher._cache = kept(function)
    # what numba asks for when another function calls this one
    dispatcher.get_call_template, dispatcher.get_overload = (
        part.get_call_template,
        part.get_overload,
    )
    return cast(F, dispatcher)


def njit(function: F) -> F:
    """Compile when first called and keep the machine code on disk."""
    return _compiled(function)


def lean(function: F) -> F:
    """As ``njit``, for what makes no arrays, so that numba need not count references to them.

    (Those counts are atomic, several for each tuple of arrays that is passed on and each row
    that is looked at: they took more time than the filter's arithmetic.) Work space is handed
    in, or comes from ``local_vector`` and ``local_matrix``.
    """
    return _compiled(function, _nrt=False)


def inner(function: F) -> F:
    """As ``lean``, for what only compiled functions call: without an entry from Python."""
    return _compiled(function, python=False, _nrt=False)


def inlined(function: F) -> F:
    """As ``lean``, and becomes part of its callers: for what is handed many arrays, each of
    them seven to nine numbers that a call would copy. It is compiled again in each caller."""
    return _compiled(function, _nrt=False, forceinline=True)


@inner
def copy1(x: Array, out: Array) -> None:
    """out[:] = x without numba's broadcasting, which takes long to compile."""
    for i in range(len(x)):
        out[i] = x[i]


@inner
def copy2(x: Array, out: Array) -> None:
    """out[:, :] = x (see ``copy1``)."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            out[i, j] = x[i, j]


@inner
def zero1(out: Array) -> None:
    """out[:] = 0 (see ``copy1``)."""
    for i in range(len(out)):
        out[i] = 0.0


@inner
def zero2(out: Array) -> None:
    """out[:, :] = 0 (see ``copy1``)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = 0.0


class _Address:
    """Where a compiled function lies, found out when it is first asked for as a number."""

    def __init__(self, function: Callable[..., int], kept: bool) -> None:
        self._function = function
        self._kept = kept
        self._compiled: Any = None

    def __index__(self) -> int:
        if self._compiled is None:
            signature = _SIGNATURE.args, _SIGNATURE.return_type
            made: Any = CFunc(
                self._function,
                signature,
                {},
                {"error_model": "numpy"},
                pipeline_class=Outside if LINKED else Compiler,
            )
            if self._kept:
                made._cache = kept(self._function)
            made.compile()
            self._compiled = made
        return int(cast(int, self._compiled.address))

    __int__ = __index__

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> IntArray:
        return np.array(int(self), dtype=dtype or np.int64)


@typeof_impl.register(_Address)
def _typeof(value: _Address, context: Any) -> Any:  # noqa: ARG001
    """To a compiled function it is an integer: numba asks for it by ``__int__``."""
    return types.intp


def residual_function(function: Callable[..., int], *, kept: bool = True) -> int:
    """Address of ``function(nav, theta, z, out) -> status`` compiled to a C function.

    The filter's kernel calls observations and effects through such addresses, so that
    it is compiled once and a new file in ``observations/`` or ``effects/`` needs no
    other file. The four arguments are pointers to float64; they can be indexed, have
    no length and no bounds check. The compiled object stays alive with its module.

    What is returned becomes the address when it is put into an integer array, or by
    ``int``: only what a recording needs is compiled, not the whole catalogue. kept: on disk,
    for the next time.
    """
    return cast(int, _Address(function, kept))


@lean
def call_residual(address: int, nav: Any, theta: Any, z: Any, out: Any) -> int:
    """Call a ``residual_function`` by its address; all arrays float64, C-contiguous."""
    status: int = called(address, nav.ctypes, theta.ctypes, z.ctypes, out.ctypes)
    return status


@njit
def call_residuals(address: int, nav: Array, theta: Array, z: Array, out: Array) -> None:
    """``call_residual`` for each row of nav (m, 21), theta (m, k), z (m, zdim) and out (m, dim)."""
    for i in range(len(nav)):
        call_residual(address, nav[i], theta[i], z[i], out[i])

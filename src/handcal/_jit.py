"""Numba with types: compiled functions that the type checker still understands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

_POINTER: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
_SIGNATURE = types.int64(_POINTER, _POINTER, _POINTER, _POINTER)


def njit(function: F) -> F:
    """Compile when first called and keep the machine code on disk."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def residual_function(function: Callable[..., int]) -> int:
    """Address of ``function(nav, theta, z, out) -> status`` compiled to a C function.

    The filter's kernel calls observations and effects through such addresses, so that
    it is compiled once and a new file in ``observations/`` or ``effects/`` needs no
    other file. The four arguments are pointers to float64; they can be indexed, have
    no length and no bounds check. The compiled object stays alive with its module.
    """
    compiled = numba.cfunc(_SIGNATURE, cache=True, error_model="numpy")(function)
    _KEEP.append(compiled)
    return int(cast(int, compiled.address))


_KEEP: list[Any] = []


def _call(typingctx: Any, address: Any, nav: Any, theta: Any, z: Any, out: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.IntType(64), [pointer] * 4)
        # numba wraps a cfunc in the plain C calling convention, so a bare call is enough
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), list(args[1:]))

    return types.int64(types.intp, _POINTER, _POINTER, _POINTER, _POINTER), codegen


_called: Any = intrinsic(_call)


@njit
def call_residual(address: int, nav: Any, theta: Any, z: Any, out: Any) -> int:
    """Call a ``residual_function`` by its address; all arrays float64, C-contiguous."""
    status: int = _called(address, nav.ctypes, theta.ctypes, z.ctypes, out.ctypes)
    return status

"""Calls of compiled functions by their address: numba has no way to write them."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

POINTER: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
_typed: Any = intrinsic


def _call(typingctx: Any, address: Any, nav: Any, theta: Any, z: Any, out: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.IntType(64), [pointer] * 4)
        # numba wraps a cfunc in the plain C calling convention, so a bare call is enough
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), list(args[1:]))

    return types.int64(types.intp, POINTER, POINTER, POINTER, POINTER), codegen


# status = called(address, a, b, c, d), the four pointers to float64
called: Any = _typed(_call)

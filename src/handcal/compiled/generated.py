"""What numba cannot be told in Python, written as LLVM IR through its private interface.

Products in blocks of eight numbers, and work space on the stack. Each has its like in ``loops``,
in plain Python, which takes its place where numba is a release on which this has not been tried, or
HANDCAL_PLAIN is set (``inside.LINKED``). All arrays are float64, C-contiguous; a row may be scaled
in its own place, else an output is none of the inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as _cgutils
from numba.extending import intrinsic as _intrinsic

from handcal.types import Array, IntArray

# (numba's own are partly typed, and not for this)
intrinsic: Any = _intrinsic
cgutils: Any = _cgutils
_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
BLOCK = 8
# Sums that are kept in registers at once: three rows of eight.
_ROWS, _COLUMNS = (3, 1), (BLOCK, 1)
# Of products two blocks of each: a number of the left is then read once for both.
_TWO = (2 * BLOCK, BLOCK, 1)
# And of one row, four times eight: as many as it takes until the first can be added to again.
_WIDE = (4 * BLOCK, BLOCK, 1)


class _Matrix:
    """A C-contiguous array inside generated code, read and written in blocks."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:
        if kind.layout != "C":
            raise TypeError(f"{kind} is not C-contiguous")
        array = context.make_array(kind)(context, builder, value)
        self.builder, self.data = builder, array.data
        self.shape = cgutils.unpack_tuple(builder, array.shape)

    def _place(self, row: Any, column: Any, kind: Any) -> Any:
        at = self.builder.add(self.builder.mul(row, self.shape[-1]), column)
        return self.builder.bitcast(self.builder.gep(self.data, [at]), kind.as_pointer())

    def load(self, row: Any, column: Any, kind: Any = _DOUBLE) -> Any:
        return self.builder.load(self._place(row, column, kind), align=8)

    def store(self, value: Any, row: Any, column: Any) -> None:
        self.builder.store(value, self._place(row, column, value.type), align=8)


def _blocks(builder: Any, n: Any, widths: tuple[int, ...]) -> Iterator[tuple[Any, int]]:
    """Loops over n, in the widest blocks first: the first index of each, and its width."""
    begin: Any = ir.Constant(_WORD, 0)
    for width in widths:
        step = ir.Constant(_WORD, width)
        end = builder.add(begin, builder.mul(builder.udiv(builder.sub(n, begin), step), step))
        with cgutils.for_range_slice(builder, begin, end, step, intp=_WORD) as (at, _):
            yield at, width
        begin = end


def _vector(width: int) -> Any:
    return _DOUBLE if width == 1 else ir.VectorType(_DOUBLE, width)


def _spread(builder: Any, scalar: Any, kind: Any) -> Any:
    """The scalar in all places of a block."""
    if kind == _DOUBLE:
        return scalar
    vector = builder.insert_element(ir.Constant(kind, ir.Undefined), scalar, ir.Constant(_WORD, 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    return builder.shuffle_vector(vector, vector, mask)


def _plus_times(builder: Any, total: Any, a: Any, x: Any) -> Any:
    """total + a x, in one rounding where the processor has an instruction for it."""
    kind = x.type
    name = "f64" if kind == _DOUBLE else f"v{kind.count}f64"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind] * 3), f"llvm.fmuladd.{name}"
    )
    return builder.call(function, [_spread(builder, a, kind), x, total])


def _product(add: bool) -> Any:
    def typed(typingctx: Any, A: Any, X: Any, count: Any, out: Any) -> Any:  # noqa: ARG001
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            A, X, out = (_Matrix(context, builder, signature.args[k], args[k]) for k in (0, 1, 3))
            for i, rows in _blocks(builder, A.shape[0], _ROWS):
                here = [builder.add(i, ir.Constant(_WORD, r)) for r in range(rows)]
                for j, columns in _blocks(builder, out.shape[1], _TWO):
                    kind = _vector(columns)
                    totals = [cgutils.alloca_once(builder, kind) for _ in range(rows)]
                    for row, total in zip(here, totals, strict=True):
                        begin = out.load(row, j, kind) if add else ir.Constant(kind, None)
                        builder.store(begin, total)
                    with cgutils.for_range(builder, args[2], intp=_WORD) as loop:
                        x = X.load(loop.index, j, kind)
                        for row, total in zip(here, totals, strict=True):
                            a = A.load(row, loop.index)
                            builder.store(_plus_times(builder, builder.load(total), a, x), total)
                    for row, total in zip(here, totals, strict=True):
                        out.store(builder.load(total), row, j)
            return context.get_dummy_value()

        return types.void(A, X, types.int64, out), codegen

    return typed


def _row(add: bool) -> Any:
    def typed(typingctx: Any, a: Any, X: Any, row: Any, out: Any) -> Any:  # noqa: ARG001
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            X, out = (_Matrix(context, builder, signature.args[k], args[k]) for k in (1, 3))
            zero = ir.Constant(_WORD, 0)
            for j, columns in _blocks(builder, out.shape[0], _TWO):
                kind = _vector(columns)
                term = builder.fmul(_spread(builder, args[0], kind), X.load(args[2], j, kind))
                term = builder.fadd(out.load(zero, j, kind), term) if add else term
                out.store(term, zero, j)
            return context.get_dummy_value()

        return types.void(types.float64, X, types.int64, out), codegen

    return typed


def _listed(add: bool) -> Any:
    def typed(typingctx: Any, at: Any, value: Any, begin: Any, end: Any, X: Any, out: Any) -> Any:
        del typingctx, begin, end

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kinds = signature.args
            value, X, out = (_Matrix(context, builder, kinds[k], args[k]) for k in (1, 4, 5))
            rows = context.make_array(kinds[0])(context, builder, args[0]).data
            zero, one = ir.Constant(_WORD, 0), ir.Constant(_WORD, 1)
            for j, columns in _blocks(builder, out.shape[0], _WIDE):
                parts = range(max(1, columns // BLOCK))
                kind = _vector(min(columns, BLOCK))
                here = [builder.add(j, ir.Constant(_WORD, BLOCK * n)) for n in parts]
                totals = [cgutils.alloca_once(builder, kind) for _ in parts]
                for place, total in zip(here, totals, strict=True):
                    first = out.load(zero, place, kind) if add else ir.Constant(kind, None)
                    builder.store(first, total)
                with cgutils.for_range_slice(builder, args[2], args[3], one, intp=_WORD) as (k, _):
                    row = builder.load(builder.gep(rows, [k]))
                    a = value.load(zero, k)
                    for place, total in zip(here, totals, strict=True):
                        x = X.load(row, place, kind)
                        builder.store(_plus_times(builder, builder.load(total), a, x), total)
                for place, total in zip(here, totals, strict=True):
                    out.store(builder.load(total), zero, place)
            return context.get_dummy_value()

        return types.void(at, value, types.int64, types.int64, X, out), codegen

    return typed


def _nonzero(typingctx: Any, x: Any, at: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x = _Matrix(context, builder, signature.args[0], args[0])
        places = context.make_array(signature.args[1])(context, builder, args[1]).data
        zero, one = ir.Constant(_WORD, 0), ir.Constant(_WORD, 1)
        count = cgutils.alloca_once_value(builder, zero)
        for j, columns in _blocks(builder, x.shape[0], _COLUMNS):
            kind = _vector(columns)
            found = builder.fcmp_unordered("!=", x.load(zero, j, kind), ir.Constant(kind, None))
            bits = builder.zext(builder.bitcast(found, ir.IntType(columns)), _WORD)
            left = cgutils.alloca_once_value(builder, bits)
            with cgutils.for_range(builder, builder.ctpop(bits), intp=_WORD):
                bits, n = builder.load(left), builder.load(count)
                place = builder.add(j, builder.cttz(bits, ir.Constant(ir.IntType(1), 1)))
                builder.store(place, builder.gep(places, [n]))
                builder.store(builder.add(n, one), count)
                builder.store(builder.and_(bits, builder.sub(bits, one)), left)
        return builder.load(count)

    return types.int64(x, at), codegen


def _add_gram(typingctx: Any, X: Any, first: Any, count: Any, out: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        X, out = (_Matrix(context, builder, signature.args[k], args[k]) for k in (0, 3))
        zero, block, kind = ir.Constant(_WORD, 0), ir.Constant(_WORD, BLOCK), _vector(BLOCK)

        def added(i: Any, j: Any) -> None:
            rows = [builder.add(i, ir.Constant(_WORD, r)) for r in range(BLOCK)]
            totals = [cgutils.alloca_once(builder, kind) for _ in rows]
            for row, total in zip(rows, totals, strict=True):
                builder.store(out.load(row, j, kind), total)
            with cgutils.for_range(builder, args[2], intp=_WORD) as loop:
                x = X.load(loop.index, j, kind)
                for row, total in zip(rows, totals, strict=True):
                    a = X.load(loop.index, row)
                    builder.store(_plus_times(builder, builder.load(total), a, x), total)
            for row, total in zip(rows, totals, strict=True):
                out.store(builder.load(total), row, j)

        with cgutils.for_range_slice(builder, args[1], out.shape[0], block, intp=_WORD) as (i, _):
            end = builder.add(i, block)
            with cgutils.for_range_slice(builder, zero, end, block, intp=_WORD) as (j, _):
                added(i, j)
        return context.get_dummy_value()

    return types.void(X, types.int64, types.int64, out), codegen


def _squares(typingctx: Any, x: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        x, zero = _Matrix(context, builder, signature.args[0], args[0]), ir.Constant(_WORD, 0)
        whole = cgutils.alloca_once_value(builder, ir.Constant(_DOUBLE, 0.0))
        for j, columns in _blocks(builder, x.shape[0], _COLUMNS):
            y = x.load(zero, j, _vector(columns))
            y = builder.fmul(y, y)
            # (halves are added until one number is left)
            while columns > 1:
                columns //= 2
                some = [
                    ir.Constant(ir.VectorType(ir.IntType(32), columns), list(range(n, n + columns)))
                    for n in (0, columns)
                ]
                y = builder.fadd(*(builder.shuffle_vector(y, y, half) for half in some))
            if y.type != _DOUBLE:
                y = builder.extract_element(y, zero)
            builder.store(builder.fadd(builder.load(whole), y), whole)
        return builder.load(whole)

    return types.float64(x), codegen


def _add_outer(typingctx: Any, a: Any, x: Any, b: Any, y: Any, out: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a, x, b, y, out = (_Matrix(context, builder, signature.args[k], args[k]) for k in range(5))
        zero = ir.Constant(_WORD, 0)
        for j, columns in _blocks(builder, out.shape[1], _TWO):
            kind = _vector(columns)
            x_j, y_j = x.load(zero, j, kind), y.load(zero, j, kind)
            with cgutils.for_range(builder, out.shape[0], intp=_WORD) as loop:
                total = out.load(loop.index, j, kind)
                for left, right in ((a, x_j), (b, y_j)):
                    total = _plus_times(builder, total, left.load(zero, loop.index), right)
                out.store(total, loop.index, j)
        return context.get_dummy_value()

    return types.void(a, x, b, y, out), codegen


def _turned(builder: Any, rows: list[Any]) -> list[Any]:
    """The columns of a block of eight by eight, given as its rows."""
    mask = ir.VectorType(ir.IntType(32), BLOCK)
    for step in (1, 2, 4):
        # numbers of rows that are ``step`` apart change places across the diagonal
        lower = [k if not k & step else BLOCK + k - step for k in range(BLOCK)]
        upper = [k + step if not k & step else BLOCK + k for k in range(BLOCK)]
        new = list(rows)
        for k in range(BLOCK):
            if not k & step:
                a, b = rows[k], rows[k + step]
                new[k] = builder.shuffle_vector(a, b, ir.Constant(mask, lower))
                new[k + step] = builder.shuffle_vector(a, b, ir.Constant(mask, upper))
        rows = new
    return rows


def _mean_of_both(typingctx: Any, P: Any) -> Any:  # noqa: ARG001
    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        P = _Matrix(context, builder, signature.args[0], args[0])
        kind, step = _vector(BLOCK), ir.Constant(_WORD, BLOCK)
        zero, half = ir.Constant(_WORD, 0), ir.Constant(_DOUBLE, 0.5)
        n = P.shape[0]
        whole = builder.sub(n, builder.urem(n, step))

        def block(i: Any, j: Any) -> tuple[list[Any], list[Any]]:
            rows = [builder.add(i, ir.Constant(_WORD, r)) for r in range(BLOCK)]
            return rows, [P.load(row, j, kind) for row in rows]

        def mean(a: Any, b: Any) -> Any:
            return builder.fmul(_spread(builder, half, a.type), builder.fadd(a, b))

        with cgutils.for_range_slice(builder, zero, whole, step, intp=_WORD) as (i, _):
            with cgutils.for_range_slice(builder, zero, i, step, intp=_WORD) as (j, _):
                (below, lower), (above, upper) = block(i, j), block(j, i)
                means = [mean(a, b) for a, b in zip(lower, _turned(builder, upper), strict=True)]
                for row, value in zip(below, means, strict=True):
                    P.store(value, row, j)
                for row, value in zip(above, _turned(builder, means), strict=True):
                    P.store(value, row, i)
            rows, here = block(i, i)
            for row, a, b in zip(rows, here, _turned(builder, here), strict=True):
                P.store(mean(a, b), row, i)
        one = ir.Constant(_WORD, 1)
        left = cgutils.for_range_slice(builder, whole, n, one, intp=_WORD)
        with left as (i, _), cgutils.for_range_slice(builder, zero, i, one, intp=_WORD) as (j, _):
            value = mean(P.load(i, j), P.load(j, i))
            P.store(value, i, j)
            P.store(value, j, i)
        return context.get_dummy_value()

    return types.void(P), codegen


# out (m, n) = A (m, k) X for the first count <= k columns of A and rows of X: (A, X, count, out)
set_product: Callable[[Array, Array, int, Array], None] = intrinsic(_product(add=False))
add_product: Callable[[Array, Array, int, Array], None] = intrinsic(_product(add=True))
# out (n,) = a X[row], or that added to out; a vector is a matrix of one row, number 0
set_row: Callable[[float, Array, int, Array], None] = intrinsic(_row(add=False))
add_row: Callable[[float, Array, int, Array], None] = intrinsic(_row(add=True))
# out (m, n) += a x' + b y': add_outer(a, x, b, y, out)
add_outer: Callable[[Array, Array, Array, Array, Array], None] = intrinsic(_add_outer)
# out (n,) = sum of value[k] X[at[k]] for k from begin to end, or that added to out
set_listed: Callable[[IntArray, Array, int, int, Array, Array], None] = intrinsic(_listed(False))
add_listed: Callable[[IntArray, Array, int, int, Array, Array], None] = intrinsic(_listed(True))
# out (n, n) += X' X over the first count rows of X (k, n): (X, first, count, out). Only its rows
# from ``first`` on are made, n and first multiples of eight, of these the lower half, and what lies
# in a block of eight with it
add_gram: Callable[[Array, int, int, Array], None] = intrinsic(_add_gram)
# where x (n,) is not zero, into at (n,), and in how many places: nonzero(x, at)
nonzero: Callable[[Array, IntArray], int] = intrinsic(_nonzero)
# P = (P + P') / 2 of the first m rows and columns of P (m, p): symmetrise(P)
symmetrise: Callable[[Array], None] = intrinsic(_mean_of_both)
# the sum of the squares of x (n,)
squares: Callable[[Array], float] = intrinsic(_squares)


def _stack(typingctx: Any, *sizes: Any) -> Any:  # noqa: ARG001
    lengths = [size.literal_value for size in sizes]
    kind = types.Array(types.float64, len(lengths), "C")

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ARG001
        count = math.prod(lengths)
        data = cgutils.alloca_once(builder, _DOUBLE, size=ir.Constant(_WORD, count))
        strides = [8 * math.prod(lengths[k + 1 :]) for k in range(len(lengths))]
        array = context.make_array(kind)(context, builder)
        context.populate_array(
            array, data=data, itemsize=ir.Constant(_WORD, 8), meminfo=None,
            shape=[ir.Constant(_WORD, n) for n in lengths],
            strides=[ir.Constant(_WORD, n) for n in strides],
        )  # fmt: skip
        return array._getvalue()

    return kind(*sizes), codegen


def _stack_vector(typingctx: Any, n: Any) -> Any:
    return _stack(typingctx, n)


def _stack_matrix(typingctx: Any, m: Any, n: Any) -> Any:
    return _stack(typingctx, m, n)


# Small work space of a compiled function, float64, its size known beforehand: on the stack, where
# it costs nothing (np.empty asks the heap). It is not set to zero, and must not be returned.
local_vector: Callable[[int], Array] = intrinsic(prefer_literal=True)(_stack_vector)
local_matrix: Callable[[int, int], Array] = intrinsic(prefer_literal=True)(_stack_matrix)

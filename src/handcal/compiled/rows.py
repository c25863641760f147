"""Products of small matrices for compiled functions, eight numbers at a time.

The compiler does not do this by itself: it cannot know that matrices do not overlap, and
loops over 15 states are too short for the ones it makes. Rows whose length is a multiple of
eight have no remainder; that is why the filter pads its covariance. All arrays are float64,
C-contiguous; a row may be scaled in its own place, else an output is none of the inputs.

They are written for the machine (``generated``), or as plain loops (``loops``), with which whole
commands took this much more processor time: 5 % (calibrate, a turn of 30 s), 47 % (calibrate, 42 s
with poses), 24 % (explain, 84 s).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from handcal.compiled.jit import WRITTEN, inlined
from handcal.types import Array, IntArray

# How many numbers the processor is given at a time.
BLOCK = 8


def padded(n: int) -> int:
    """The next multiple of eight."""
    return -(-n // BLOCK) * BLOCK


def blank(*shape: int) -> Array:
    """Zeros whose rows begin where a cache line does, if they are padded: blocks of eight that
    lie across two lines cost half as much again, and where numpy puts an array is chance."""
    count = math.prod(shape)
    room = np.zeros(count + BLOCK)
    skip = -room.ctypes.data % (8 * BLOCK) // 8
    return room[skip : skip + count].reshape(shape)


_Product = Callable[[Array, Array, int, Array], None]
_set_product: _Product = WRITTEN.set_product
_add_product: _Product = WRITTEN.add_product
# out (n,) = a X[row], or that added to out; a vector is a matrix of one row, number 0
set_row: Callable[[float, Array, int, Array], None] = WRITTEN.set_row
add_row: Callable[[float, Array, int, Array], None] = WRITTEN.add_row
# out (m, n) += a x' + b y': add_outer(a, x, b, y, out)
add_outer: Callable[[Array, Array, Array, Array, Array], None] = WRITTEN.add_outer
# out (n,) = sum of value[k] X[at[k]] for k from begin to end, or that added to out:
# set_listed(at, value, begin, end, X, out)
set_listed: Callable[[IntArray, Array, int, int, Array, Array], None] = WRITTEN.set_listed
add_listed: Callable[[IntArray, Array, int, int, Array, Array], None] = WRITTEN.add_listed
# the lower half of out (n, n) += X' X over the first count rows of X (k, n), its rows from first
# on, multiples of eight: add_gram(X, first, count, out); above it out is not to be read
add_gram: Callable[[Array, int, int, Array], None] = WRITTEN.add_gram
# where x (n,) is not zero, into at (n,), and in how many places: nonzero(x, at)
nonzero: Callable[[Array, IntArray], int] = WRITTEN.nonzero
# P = (P + P') / 2 in place; P (m, p), of which the first m columns count: symmetrise(P)
symmetrise: Callable[[Array], None] = WRITTEN.symmetrise
# the sum of the squares of x (n,)
squares: Callable[[Array], float] = WRITTEN.squares


@inlined
def product(A: Array, X: Array, count: int, out: Array) -> None:
    """out (m, n) = A (m, k) X for the first ``count`` <= k columns of A and rows of X."""
    _set_product(A, X, count, out)


@inlined
def add_product(A: Array, X: Array, count: int, out: Array) -> None:
    """``product``, added to out."""
    _add_product(A, X, count, out)

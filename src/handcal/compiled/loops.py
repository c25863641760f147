"""What ``generated`` has, as plain loops under plain numba: slower, and the same to round-off."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

from handcal.types import Array, IntArray

F = TypeVar("F", bound=Callable[..., Any])
# (numba's own is partly typed, and not for this)
_njit: Any = numba.njit
_plain: Callable[[F], F] = _njit(error_model="numpy")


@_plain
def set_product(A: Array, X: Array, count: int, out: Array) -> None:
    """out (m, n) = A (m, k) X for the first ``count`` <= k columns of A and rows of X; rows of out
    below the m-th stay."""
    out[: A.shape[0]] = 0.0
    add_product(A, X, count, out)


@_plain
def add_product(A: Array, X: Array, count: int, out: Array) -> None:
    """``set_product``, added to out."""
    for i in range(A.shape[0]):
        for k in range(count):
            for j in range(out.shape[1]):
                out[i, j] += A[i, k] * X[k, j]


@_plain
def set_row(a: float, X: Array, row: int, out: Array) -> None:
    """out (n,) = a X[row]; a vector is a matrix of one row, number 0. out may be the row itself."""
    if X.ndim == 1:
        for j in range(len(out)):
            out[j] = a * X[j]
    else:
        for j in range(len(out)):
            out[j] = a * X[row, j]


@_plain
def add_row(a: float, X: Array, row: int, out: Array) -> None:
    """``set_row``, added to out."""
    if X.ndim == 1:
        for j in range(len(out)):
            out[j] += a * X[j]
    else:
        for j in range(len(out)):
            out[j] += a * X[row, j]


@_plain
def add_outer(a: Array, x: Array, b: Array, y: Array, out: Array) -> None:
    """out (m, n) += a x' + b y'."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = out[i, j] + a[i] * x[j] + b[i] * y[j]


@_plain
def set_listed(at: IntArray, value: Array, begin: int, end: int, X: Array, out: Array) -> None:
    """out (n,) = sum of value[k] X[at[k]] for k from begin to end."""
    for j in range(len(out)):
        out[j] = 0.0
    add_listed(at, value, begin, end, X, out)


@_plain
def add_listed(at: IntArray, value: Array, begin: int, end: int, X: Array, out: Array) -> None:
    """``set_listed``, added to out."""
    for k in range(begin, end):
        for j in range(len(out)):
            out[j] += value[k] * X[at[k], j]


@_plain
def add_gram(X: Array, first: int, count: int, out: Array) -> None:
    """Lower half of out (n, n) += X' X over the first count rows of X (k, n), its rows from
    ``first`` on."""
    for q in range(count):
        for i in range(first, X.shape[1]):
            for j in range(i + 1):
                out[i, j] += X[q, i] * X[q, j]


@_plain
def nonzero(x: Array, at: IntArray) -> int:
    """Where x (n,) is not zero, into at (n,), and in how many places."""
    count = 0
    for j in range(len(x)):
        if x[j] != 0.0:
            at[count] = j
            count += 1
    return count


@_plain
def symmetrise(P: Array) -> None:
    """P = (P + P') / 2 in place; P (m, p), of which the first m columns count."""
    for i in range(len(P)):
        for j in range(i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s


@_plain
def squares(x: Array) -> float:
    """The sum of the squares of x (n,)."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i]
    return total


@_plain
def local_vector(n: int) -> Array:
    """Work space (n,), not set to zero."""
    return np.empty(n)


@_plain
def local_matrix(m: int, n: int) -> Array:
    """Work space (m, n), not set to zero."""
    return np.empty((m, n))

"""Compiled: the transition of the moving states as the list of its numbers that are not zero.

Most of a transition is zeros and ones: position follows velocity, Markov states forget each on its
own. Of the 441 numbers for 21 moving states some seventy are something else.
"""

from __future__ import annotations

import numpy as np

from handcal.compiled.jit import inner
from handcal.compiled.rows import set_listed
from handcal.types import Array, IntArray

# First of the entries of each row (m + 1,), and of each its column (n,) and number (n,),
# n >= m * m.
Entries = tuple[IntArray, IntArray, Array]


def no_entries(m: int, terms: int = 0) -> Entries:
    """Room for the transition of m states, or for a sum of so many rows."""
    size = max(m * m, terms)
    return np.zeros(m + 1, dtype=np.int64), np.zeros(size, dtype=np.int64), np.zeros(size)


@inner
def list_entries(Phi: Array, B: Array, Phi_e: Array, Phi_psi: Array, out: Entries) -> None:
    """List the transition of the moving states (m, m): Phi (v, n), of which v columns count, B
    (v, e) or (v, 0), Phi_psi (e, 3), Phi_e (e, e); see ``covariance.times_transition``. v: 9, or 0
    where nothing is navigated."""
    first, at, value = out
    n, v = 0, Phi.shape[0]
    for i in range(v):
        first[i] = n
        for k in range(v):
            if Phi[i, k] != 0.0:
                at[n], value[n] = k, Phi[i, k]
                n += 1
        for k in range(B.shape[1]):
            if B[i, k] != 0.0:
                at[n], value[n] = v + k, B[i, k]
                n += 1
    for i in range(Phi_e.shape[0]):
        first[v + i] = n
        for k in range(3 if v > 0 else 0):
            if Phi_psi[i, k] != 0.0:
                at[n], value[n] = 6 + k, Phi_psi[i, k]
                n += 1
        for k in range(Phi_e.shape[1]):
            if Phi_e[i, k] != 0.0:
                at[n], value[n] = v + k, Phi_e[i, k]
                n += 1
    first[v + Phi_e.shape[0]] = n


@inner
def turn_over(entries: Entries, m: int, out: Entries) -> None:
    """List the transpose of a transition of m states that is listed."""
    first, at, value = entries
    begin, column, number = out
    for i in range(m + 1):
        begin[i] = 0
    for n in range(first[m]):
        begin[at[n] + 1] += 1
    for i in range(m):
        begin[i + 1] += begin[i]
    for i in range(m):
        for n in range(first[i], first[i + 1]):
            to = begin[at[n]]
            column[to], number[to] = i, value[n]
            begin[at[n]] += 1
    for i in range(m, 0, -1):
        begin[i] = begin[i - 1]
    begin[0] = 0


@inner
def times_entries(entries: Entries, X: Array, out: Array) -> None:
    """out (m, w) = F X for the transition F that is listed."""
    first, at, value = entries
    for i in range(len(X)):
        set_listed(at, value, first[i], first[i + 1], X, out[i])

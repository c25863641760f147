"""Compiled: from the first epoch of a window to a later one, and readings carried back to the first
(see ``folded`` and ``gathered``)."""

from __future__ import annotations

import numpy as np

from handcal.compiled.jit import copy1, copy2, inner, njit, zero2
from handcal.compiled.rows import BLOCK, product
from handcal.types import Array, IntArray

# Work space of ``stepped``.
Work = tuple[Array, Array, Array]


@njit
def across(width: int) -> tuple[Array, Array, Work]:
    """What leads from the first epoch of a window to a later one: the transition T (9, p) of a
    state of this width, what is added on the way in its last column; and the noise on the way
    (3, 9, p'). Both wider than need be, to a multiple of eight; and work space for them."""
    p, square = (width // BLOCK + 1) * BLOCK, 2 * BLOCK
    work = np.zeros((9, p)), np.zeros((9, square)), np.zeros((9, square))
    return np.zeros((9, p)), np.zeros((3, 9, square)), work


@inner
def at_first(T: Array, noise: Array) -> None:
    """T and noise (see ``across``) at the first epoch of a window."""
    zero2(T)
    for s in range(3):
        zero2(noise[s])
    for a in range(9):
        T[a, a] = 1.0


@inner
def stepped(
    dynamics: tuple[Array, Array, tuple[Array, Array, Array]],
    j: int,
    sources: int,
    T: Array,
    noise: Array,
    work: Work,
) -> None:
    """T and noise (see ``across``) one epoch later, at epoch j."""
    Phi, d, Q = dynamics
    new, half, turned = work
    last = T.shape[1] - 1
    product(Phi[j], T, 9, new)
    copy2(new, T)
    for a in range(9):
        T[a, last] += d[j, a]
        for c in range(9, Phi.shape[2]):
            T[a, c] += Phi[j, a, c]
    for s in range(sources):
        product(Phi[j], noise[s], 9, half)
        for a in range(9):
            for b in range(9):
                turned[b, a] = half[a, b]
        product(Phi[j], turned, 9, noise[s])
        for a in range(9):
            for b in range(9):
                noise[s, a, b] += Q[s][j, a, b]


@inner
def arrived(T: Array, noise: Array, w: int, carried: tuple[Array, Array, Array]) -> None:
    """T and noise (see ``across``) where window w begins, as its Phi, d and Q."""
    for a in range(9):
        carried[1][w, a] = T[a, T.shape[1] - 1]
        for c in range(carried[0].shape[2]):
            carried[0][w, a, c] = T[a, c]
        for s in range(3):
            for c in range(9):
                carried[2][s, w, a, c] = noise[s, a, c]


@inner
def brought_back(
    r: float, H: Array, begins: bool, T: Array, width: int, walks: IntArray, line: Array
) -> float:
    """Residual and row ``line`` (N,) of a reading, seen from where its window begins; width: of
    the state that T (see ``across``) is a transition of."""
    copy1(H, line)
    if begins:
        return r
    for b in range(9):
        line[b] = 0.0
    for b in range(9):
        h = H[b]
        if h != 0.0:
            r -= h * T[b, T.shape[1] - 1]
            for c in range(width):
                line[c] += h * T[b, c]
    for n in range(len(walks)):
        for k in range(3):
            line[walks[n, 0] + k] = line[walks[n, 1] + k]
    return r


@inner
def anything(Q: Array) -> bool:
    """Whether any number of Q (k, 9, 9) is not zero."""
    for j in range(len(Q)):
        for a in range(9):
            for b in range(9):
                if Q[j, a, b] != 0.0:
                    return True
    return False

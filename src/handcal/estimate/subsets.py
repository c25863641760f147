"""The evidence of sets of effects from one quadratic, thousands of them, in compiled code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.compiled.jit import njit
from handcal.effects import Effect
from handcal.estimate.heavy_tails import NEAR, has_tails, is_sparse, tailed_at
from handcal.estimate.quadratic import Quadratic
from handcal.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Subsets:
    """Effects by number, their parameters one effect's after another's.

    a, b (p,), G (p, p): the quadratic of these. begin (e + 1,): where the parameters of each effect
    begin. tails, sparse (e,): of its prior (see ``heavy_tails``). positive (p,): parameters that
    cannot be negative, of which half of a symmetric prior counts, twice as dense. roots (p, p):
    square roots of priors that are not the identity, and of which effects (numbers) beside which
    others, or beside whatever there is.
    """

    a: float
    b: Array
    G: Array
    begin: IntArray
    tails: BoolArray
    sparse: BoolArray
    positive: BoolArray
    roots: Array
    together: Mapping[int, frozenset[int]]

    def log_evidence(self, chosen: Sequence[int]) -> float:
        """Log-evidence of the effects of these numbers, as ``heavy_tails.log_evidence``."""
        rooted = [n in self.together and self._acts(n, chosen) for n in chosen]
        return self.a + _of_set(
            self.b, self.G, self.roots, self.begin, self.tails, self.sparse, self.positive,
            np.array(chosen, dtype=np.int64), np.array(rooted, dtype=np.bool_),
        )  # fmt: skip

    def _acts(self, n: int, chosen: Sequence[int]) -> bool:
        beside = self.together[n]
        return not beside or not beside.isdisjoint(chosen)


def subsets(q: Quadratic, effects: Sequence[Effect], where: Mapping[str, IntArray]) -> Subsets:
    """Of these effects, whose parameters are at these places (k,) of the quadratic."""
    number = {e.id: n for n, e in enumerate(effects)}
    order: IntArray = np.concatenate([np.zeros(0, dtype=np.int64), *(where[e.id] for e in effects)])
    begin = np.cumsum([0, *(len(where[e.id]) for e in effects)])
    roots = np.eye(len(order))
    together = {}
    for n, e in enumerate(effects):
        if e.together is not None:
            own = slice(begin[n], begin[n + 1])
            roots[own, own] = e.together
            # (those that are exclusive of others that are no candidates are never beside them)
            beside = frozenset(number.get(i, -1) for i in e.exclusive)
            together[n] = beside
    return Subsets(
        q.a, q.b[order], q.G[np.ix_(order, order)], begin,
        np.array([has_tails(e.id) for e in effects], dtype=np.bool_),
        np.array([is_sparse(e.id) for e in effects], dtype=np.bool_),
        np.array([p.positive for e in effects for p in e.parameters], dtype=np.bool_),
        roots, together,
    )  # fmt: skip


@njit
def _of_set(
    b: Array,
    G: Array,
    roots: Array,
    begin: IntArray,
    tails: BoolArray,
    sparse: BoolArray,
    positive: BoolArray,
    chosen: IntArray,
    rooted: BoolArray,
) -> float:
    """``heavy_tails.tailed_at`` of the parameters of the chosen effects (c,), those that are
    ``rooted`` (c,) with their own square root of a prior."""
    at = np.empty(len(b), dtype=np.int64)
    start = np.zeros(len(chosen) + 1, dtype=np.int64)
    m, any_root = 0, False
    own_tails, own_sparse = np.empty(len(chosen), np.bool_), np.empty(len(chosen), np.bool_)
    for c in range(len(chosen)):
        e = chosen[c]
        own_tails[c], own_sparse[c] = tails[e], sparse[e]
        any_root = any_root or rooted[c]
        for i in range(begin[e], begin[e + 1]):
            at[m] = i
            m += 1
        start[c + 1] = m
    if m == 0:
        return 0.0
    some_b, some_G, half = np.empty(m), np.empty((m, m)), np.empty(m, np.bool_)
    for i in range(m):
        some_b[i], half[i] = b[at[i]], positive[at[i]]
        for j in range(m):
            some_G[i, j] = G[at[i], at[j]]
    R = np.zeros((m, m)) if any_root else np.zeros((0, 0))
    rank = np.zeros(len(chosen))
    for c in range(len(chosen)):
        for i in range(start[c], start[c + 1]):
            if not rooted[c]:
                rank[c] += 1.0
                if any_root:
                    R[i, i] = 1.0
                continue
            # (of a projection the rank is the trace)
            rank[c] += roots[at[i], at[i]]
            for j in range(start[c], start[c + 1]):
                R[i, j] = roots[at[i], at[j]]
        rank[c] = np.round(rank[c])
    mean, covariance = np.empty(m), np.empty((m, m))
    value: float = tailed_at(
        some_b, some_G, R, start, rank, own_tails, own_sparse, half, NEAR, False, mean, covariance
    )
    return value

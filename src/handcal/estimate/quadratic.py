"""Evidence of every subset of effects from one pass of the filter.

Linearised about a trajectory, the log-likelihood is a quadratic form of all constants,
whether or not a model has them. Biases and other things of one recording alone are
integrated out; what is left can be added over recordings, and the evidence of any subset
of effects is a small Cholesky factorisation instead of another run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.estimate.evidence import OfConstants
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Quadratic:
    """log p(z | u) = a + b'u - u'G u / 2 for the parameters u (k,) in units of their priors.

    names (k,): (effect, parameter). Everything else is integrated out. worth: power of the
    likelihood that b and G include already; 1 is the full likelihood.
    """

    names: tuple[tuple[str, str], ...]
    a: float
    b: Array
    G: Array
    worth: float = 1.0


@dataclass(frozen=True)
class Local:
    """One recording's quadratic, and its own unknowns conditional on the shared parameters u (k,).

    The own unknowns have mean base + by_shared (u - here) and this covariance, as deviations from
    the nominal in prior units. own, shared: places of either among all constants.
    """

    quadratic: Quadratic
    own: IntArray
    shared: IntArray
    here: Array
    base: Array
    by_shared: Array
    covariance: Array

    def deviations(self, u: Array) -> Array:
        """Deviations w (nc,) of all constants from the nominal, given the shared u (k,)."""
        w = np.zeros(len(self.own) + len(self.shared))
        w[self.own] = self.base + self.by_shared @ (u - self.here)
        w[self.shared] = u - self.here
        return w


def local(done: OfConstants, shared_owners: frozenset[str]) -> Local:
    """The quadratic of one recording in the constants of ``shared_owners``, all others integrated
    out."""
    problem = done.reduction.linear.problem
    keep = np.array([s.owner in shared_owners for s in problem.slots], dtype=bool)
    is_shared = np.r_[np.zeros(6, dtype=bool), keep]
    own: IntArray = np.flatnonzero(~is_shared)
    shared: IntArray = np.flatnonzero(is_shared)
    a, b, G = done.log_likelihood
    w0 = done.reduction.w0
    A = G[np.ix_(own, own)] + np.eye(len(own))
    root = np.linalg.cholesky(A)
    c = b[own] + w0[own]
    half = np.linalg.solve(root, np.column_stack([c, G[np.ix_(own, shared)], np.eye(len(own))]))
    y, Y = half[:, 0], half[:, 1 : 1 + len(shared)]
    solved = np.linalg.solve(root.T, half)
    # in deviations from the nominal ...
    a_w = a - 0.5 * float(w0[own] @ w0[own]) + 0.5 * float(y @ y) - np.log(np.diag(root)).sum()
    with np.errstate(over="ignore", invalid="ignore"):  # (a diverging effect may overflow)
        b_w, G_w = b[shared] - Y.T @ y, G[np.ix_(shared, shared)] - Y.T @ Y
    # ... and in the parameters themselves, whose prior mean is zero
    here = -w0[shared]
    names = tuple((s.owner, s.name) for s, k in zip(problem.slots, keep, strict=True) if k)
    value = float(a_w - b_w @ here - 0.5 * here @ G_w @ here)
    return Local(
        Quadratic(names, value, b_w + G_w @ here, G_w),
        own,
        shared,
        here,
        solved[:, 0],
        -solved[:, 1 : 1 + len(shared)],
        solved[:, 1 + len(shared) :],
    )


def total(parts: Sequence[Quadratic]) -> Quadratic:
    """Sum over recordings. A recording without a parameter adds nothing to it."""
    names = tuple(dict.fromkeys(n for p in parts for n in p.names))
    at = {n: i for i, n in enumerate(names)}
    b, G = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for p in parts:
        index = np.array([at[n] for n in p.names], dtype=np.int64)
        b[index] += p.b
        G[np.ix_(index, index)] += p.G
    worth = min((p.worth for p in parts), default=1.0)
    return Quadratic(names, sum(p.a for p in parts), b, G, worth)


def given(whole: Quadratic, part: Quadratic, u: Array) -> Array:
    """The values u (k,) of the whole's parameters in the order of a part's."""
    at = {n: i for i, n in enumerate(whole.names)}
    return u[[at[n] for n in part.names]]


@dataclass(frozen=True)
class Posterior:
    """log_evidence; mean u (k,) and covariance (k, k) in units of the priors."""

    log_evidence: float
    mean: Array
    covariance: Array


def posterior(q: Quadratic, index: IntArray, root: Array | None = None) -> Posterior:
    """Evidence and posterior of the subset ``index`` (m,) of parameters; all others are zero.

    root (m, m'): square root of the subset's prior covariance (None: the identity).
    """
    b, G = q.b[index], q.G[np.ix_(index, index)]
    R = np.eye(len(index)) if root is None else root
    A = np.eye(R.shape[1]) + R.T @ G @ R
    L = np.linalg.cholesky(0.5 * (A + A.T))
    y = np.linalg.solve(L, R.T @ b)
    half = np.linalg.solve(L, R.T)
    return Posterior(float(q.a + 0.5 * y @ y - np.log(np.diag(L)).sum()), half.T @ y, half.T @ half)


def log_evidence(q: Quadratic, index: IntArray, root: Array | None = None) -> float:
    """As ``posterior``, only the evidence: what a search over subsets needs."""
    b, G = q.b[index], q.G[np.ix_(index, index)]
    if root is not None:
        b, G = root.T @ b, root.T @ G @ root
    A = G + np.eye(len(b))
    L = np.linalg.cholesky(0.5 * (A + A.T))
    y = np.linalg.solve(L, b)
    return float(q.a + 0.5 * y @ y - np.log(np.diag(L)).sum())

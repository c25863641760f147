"""How far the sigmas can be trusted: the scores' own scatter against what the model says of it.

A hand is not quite the process that the filter takes it for. Where it is not, what the
innovations say of a parameter comes in runs, and the sum of the scores over a few seconds
scatters more than the information matrix has it. Source: the sandwich of Huber (1967), with
sums over blocks of time instead of single observations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from handcal.compiled.jit import njit
from handcal.effects import Effect
from handcal.estimate.evidence import Likelihood, reduced_pass
from handcal.estimate.pieces import reduced
from handcal.types import Array, IntArray

if TYPE_CHECKING:
    from handcal.estimate.model import Fitted, Model

# Scores are summed over so long, s: many times the correlation time of a sway.
BLOCK_S = 4.0
# As many blocks' worth of belief in the model itself.
BELIEF = 6.0
# Information beside other effects, as a part of that alone, below which it is rounding.
EXACT = 1e-10
# Times that information is discounted for the scatter of scores, at the most.
MOST = 25.0


def inflation(model: Model) -> dict[str, float]:
    """Factor on the variance of each effect's parameters, 1 where the model is right."""
    scatter: dict[str, float] = {}
    freedom: dict[str, float] = {}
    for f in model.parts:
        for effect, ratio, weight in _ratios(f):
            scatter[effect] = scatter.get(effect, 0.0) + ratio * weight
            freedom[effect] = freedom.get(effect, 0.0) + weight
    return {
        e: float(np.clip((scatter[e] + BELIEF) / (freedom[e] + BELIEF), 1.0, MOST)) for e in scatter
    }


def excess(done: Likelihood, active: frozenset[str]) -> float:
    """How much more the scores of absent effects scatter than the model of these effects says:
    the median over effects, at least 1. By so much less the innovations are worth."""
    n = done.nu.shape[1] - 1
    owners = _owners(done)
    present = np.array([o == "" or o in active for o in owners])
    at_nominal = np.zeros(n)
    found = [
        (ratio * blocks + BELIEF) / (blocks + BELIEF)
        for _, ratio, blocks in _scattered(done, at_nominal, np.flatnonzero(present))
    ]
    return float(np.clip(np.median(found), 1.0, MOST)) if found else 1.0


def _owners(done: Likelihood) -> list[str]:
    """Effect of each constant, empty for biases and what belongs to an observation."""
    problem = done.reduction.linear.problem
    effects = {e.id for e in problem.effects}
    return [*[""] * 6, *(s.owner if s.owner in effects else "" for s in problem.slots)]


def _ratios(f: Fitted) -> list[tuple[str, float, float]]:
    """(effect, mean ratio of scatter to information, blocks) of one recording."""
    done = reduced_pass(reduced(f.about), f.levels)
    return _scattered(done, done.w, None)


def _scattered(
    done: Likelihood, w: Array, present: IntArray | None
) -> list[tuple[str, float, float]]:
    """(effect, mean ratio of scatter to information, blocks), each effect beside all that are
    present (None: all others)."""
    linear, G = done.reduction.linear, done.log_likelihood[2]
    n = len(w)
    owners = np.array(_owners(done))
    nu = done.nu
    weight = (nu[:, 0] + nu[:, 1:] @ w if w.any() else nu[:, 0]) / done.S
    t = np.repeat(linear.t, np.diff(done.reduction.first))
    block = ((t - t[0]) / BLOCK_S).astype(np.int64) if len(t) else np.zeros(0, dtype=np.int64)
    sums = np.zeros((int(block.max()) + 1 if len(block) else 0, n))
    _add_by_block(nu, weight, block, sums)
    out = []
    for ids, mine, rest in _apart(linear.problem.effects, owners, present, n):
        both, whole = G[np.ix_(rest, mine)], np.diag(G)[mine]
        told = np.linalg.solve(G[np.ix_(rest, rest)] + np.eye(len(rest)), both)
        left = 2.0 * both - G[np.ix_(rest, rest)] @ told
        information = whole - np.einsum("rk,rk->k", told, left)
        scatter = ((sums[:, mine] - sums[:, rest] @ told) ** 2).sum(axis=0)
        for e in ids:
            seen = (owners[mine] == e) & (information > 1e-9 + EXACT * whole)
            if seen.any():
                ratio = float(np.mean(scatter[seen] / information[seen]))
                out.append((e, ratio, float(len(sums))))
    return out


def _apart(
    effects: Sequence[Effect], owners: NDArray[np.str_], present: IntArray | None, n: int
) -> Iterator[tuple[list[str], IntArray, IntArray]]:
    """Effects, their constants, and the constants that stay beside them: those that are absent go
    together, since what stays is the same."""
    ids = [e.id for e in effects if e.id in owners]
    stays = np.arange(n) if present is None else present
    alone = [e for e in ids if np.isin(np.flatnonzero(owners == e), stays).any()]
    absent = [e for e in ids if e not in alone]
    for group in [*([e] for e in alone), *([absent] if absent else [])]:
        mine = np.flatnonzero(np.isin(owners, group))
        yield group, mine, np.setdiff1d(stays, mine)


@njit
def _add_by_block(nu: Array, weight: Array, block: IntArray, out: Array) -> None:
    """Sums of the rows nu (s, 1 + k), but for their first number, times weight (s,), over each
    block (s,): added to out (blocks, k)."""
    for q in range(len(nu)):
        row = out[block[q]]
        for c in range(len(row)):
            row[c] += weight[q] * nu[q, 1 + c]

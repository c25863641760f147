"""How far the sigmas can be trusted: the scores' own scatter against what the model says of it.

A hand is not quite the process that the filter takes it for. Where it is not, what the
innovations say of a parameter comes in runs, and the sum of the scores over a few seconds
scatters more than the information matrix has it. Source: the sandwich of Huber (1967), with
sums over blocks of time instead of single observations.
"""

from __future__ import annotations

import numpy as np

from handcal.evidence import reduce, reduced_pass
from handcal.explain.fit import Fitted, Model
from handcal.types import Array, IntArray

BLOCK_S = 4.0
# As many blocks' worth of belief in the model itself.
BELIEF = 6.0
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


def _ratios(f: Fitted) -> list[tuple[str, float, float]]:
    """(effect, mean ratio of scatter to information, blocks) of one recording."""
    done = reduced_pass(reduce(f.linear), f.levels)
    slots, G = f.linear.problem.slots, done.log_likelihood[2]
    n = len(done.w)
    owners = np.array(["", *[""] * 5, *(s.owner for s in slots)])
    nu = done.nu[:, 0] + done.nu[:, 1:] @ done.w
    t = np.repeat(f.linear.t, np.diff(done.reduction.first))
    block: IntArray = (
        ((t - t[0]) / BLOCK_S).astype(np.int64) if len(t) else np.zeros(0, dtype=np.int64)
    )
    out = []
    for e in f.linear.problem.effects:
        mine = np.flatnonzero(owners == e.id)
        if not len(mine):
            continue
        rest = np.setdiff1d(np.arange(n), mine)
        A = G[np.ix_(rest, rest)] + np.eye(len(rest))
        by_rest = np.linalg.solve(A, G[np.ix_(rest, mine)])
        own = done.nu[:, 1 + mine] - done.nu[:, 1 + rest] @ by_rest
        scores = own * (nu / done.S)[:, None]
        information = (own**2 / done.S[:, None]).sum(axis=0)
        sums = _by_block(scores, block)
        seen = information > 1e-9
        if seen.any():
            ratio = float(np.mean((sums[:, seen] ** 2).sum(axis=0) / information[seen]))
            out.append((e.id, ratio, float(len(sums))))
    return out


def _by_block(x: Array, block: IntArray) -> Array:
    out = np.zeros((int(block.max()) + 1 if len(block) else 0, x.shape[1]))
    for i in range(x.shape[1]):
        out[:, i] = np.bincount(block, x[:, i], len(out))
    return out

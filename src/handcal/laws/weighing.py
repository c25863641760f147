"""What a scan says of parameters that a model does not have, and the nats that they gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.effects import Effect
from handcal.estimate.prior_root import prior_root
from handcal.estimate.quadratic import Quadratic
from handcal.laws import shapes
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Beside:
    """What a scan says of parameters that are not in the model, those of the model integrated
    out: b (m,), G (m, m), and the place of each effect's."""

    b: Array
    G: Array
    at: dict[str, IntArray]

    def gains(self, index: IntArray) -> Array:
        """Nats (f,) that each of several sets of parameters (f, k) gains under their priors."""
        return gains(self.b[index], self.G[index[:, :, None], index[:, None]])


def gains(b: Array, G: Array, root: Array | None = None) -> Array:
    """Nats (f,) that parameters of such quadratics, b (f, k) and G (f, k, k), gain; root
    (f, k, k): of their priors (None: the identity). Where a number of a quadratic is none, what
    acts so is no candidate: -inf."""
    if root is not None:
        back = root.transpose(0, 2, 1)
        b, G = (back @ b[:, :, None])[:, :, 0], back @ G @ root
    told = np.isfinite(b).all(axis=1) & np.isfinite(G).all(axis=(1, 2))
    if not told.all():
        out = np.full(len(b), -np.inf)
        out[told] = _gains(b[told], G[told])
        return out
    return _gains(b, G)


def _gains(b: Array, G: Array) -> Array:
    """Of numbers that are all finite, under priors of one."""
    if b.shape[1] == 1:
        wide = 1.0 + np.maximum(G[:, 0, 0], 0.0)
        return np.asarray(0.5 * b[:, 0] ** 2 / wide - 0.5 * np.log(wide))
    G = 0.5 * (G + G.transpose(0, 2, 1))
    A = np.eye(b.shape[1]) + G
    sign, volume = np.linalg.slogdet(A)
    if (sign > 0.0).all():
        along = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        return np.asarray(0.5 * (b * along).sum(axis=1) - 0.5 * volume)
    # (what is left beside large numbers is positive but for rounding)
    size, axes = np.linalg.eigh(G)
    wide = 1.0 + np.maximum(size, 0.0)
    along = (b[:, None] @ axes)[:, 0]
    return np.asarray(0.5 * (along**2 / wide).sum(axis=1) - 0.5 * np.log(wide).sum(axis=1))


def beside(q: Quadratic, known: Sequence[Effect], absent: Sequence[Effect]) -> Beside:
    """The quadratic of the parameters of absent effects beside those of known ones."""
    where: dict[str, list[int]] = {e.id: [] for e in (*known, *absent)}
    for i, (owner, _) in enumerate(q.names):
        if owner in where:
            where[owner].append(i)
    index: IntArray = np.array([i for e in known for i in where[e.id]], dtype=np.int64)
    mine: IntArray = np.array([i for e in absent for i in where[e.id]], dtype=np.int64)
    b, G = shapes.integrated(q, mine, index, wide_root(q, known, index))
    at, first = {}, 0
    for e in absent:
        at[e.id] = np.arange(first, first + len(where[e.id]), dtype=np.int64)
        first += len(where[e.id])
    return Beside(b, G, at)


def wide_root(q: Quadratic, known: Sequence[Effect], index: IntArray) -> Array:
    """Square root of the prior covariance of what is in the model, as wide as it is large: what
    stands out of its prior may not be relieved by something else."""
    root = prior_root(q, known, index)
    if not len(index):
        return np.zeros((0, 0))
    root = np.eye(len(index)) if root is None else root
    b, G = q.b[index], q.G[np.ix_(index, index)]
    u = np.linalg.lstsq(G + 1e-6 * np.eye(len(b)), b, rcond=None)[0]
    return np.asarray(np.maximum(1.0, np.abs(u))[:, None] * root)

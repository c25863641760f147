"""Of equally good sets of poses, the one that a person can make most easily."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np

from handcal.design.poses import PLAIN
from handcal.types import Array

MOST_AXES = 300


def unit(x: Array) -> Array:
    """Vectors (..., 3) made of length one."""
    return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True))


def regular_solids() -> list[Array]:
    """Corners of the regular solids: where such a set is as good as any, it is the easiest."""
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    corners = [d for d in PLAIN if abs(d).min() > 0.0]
    third = [np.roll([0.0, a, b * golden], i) for i in range(3) for a in (-1, 1) for b in (-1, 1)]
    sets = ([d for d in corners if d.prod() > 0.0], [d for d in PLAIN if abs(d).max() > 0.9],
            corners, third)  # fmt: skip
    return [unit(np.array(s)) for s in sets]


def plainness(up: Array) -> Any:
    """How many axes of sets up (..., n, 3) lie level, and somewhat more for each upright."""
    level = (np.abs(up) < 1e-4).sum(axis=(-2, -1))
    return level + 0.01 * (np.abs(up) > 1.0 - 1e-7).sum(axis=(-2, -1))


def plainest(up: Array) -> Array:
    """The same set (n, 3) turned so that as many axes as can be lie level in its poses."""
    best, axes = up, _axes_of(up)
    for z in axes:
        across = axes - np.outer(axes @ z, z)
        across = unit(across[np.linalg.norm(across, axis=1) > 1e-3])
        frames = np.stack([across, np.cross(z, across), np.broadcast_to(z, across.shape)], axis=1)
        turned = np.einsum("fij,nj->fni", frames, up)
        one = turned[int(np.argmax(plainness(turned)))]
        if plainness(one) > plainness(best):
            best = one
    return best


def _axes_of(up: Array) -> Array:
    """Axes (a, 3) about which a set may be alike: its poses, and sums, differences and
    perpendiculars of two."""
    pairs = [up[[i, j]] for i, j in combinations(range(min(len(up), 16)), 2)]
    more = [v for a, b in pairs for v in (a + b, a - b, np.cross(a, b))]
    axes = np.vstack([up, *(np.reshape(v, (1, 3)) for v in more)])
    return unit(axes[np.linalg.norm(axes, axis=1) > 1e-3])[:MOST_AXES]


def in_order(up: Array) -> Array:
    """Poses (n, 3) one after the other with little turning between: from z up to the nearest."""
    left = list(range(len(up)))
    order: list[int] = []
    here = np.array([0.0, 0.0, 1.0])
    while left:
        nearest = max(left, key=lambda i: (round(float(up[i] @ here), 9), -i))
        left.remove(nearest)
        order.append(nearest)
        here = up[nearest]
    return up[order]

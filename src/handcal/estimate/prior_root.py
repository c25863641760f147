"""The prior of a quadratic's parameters, where they are not independent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from handcal.effects import Effect
from handcal.estimate.quadratic import Quadratic
from handcal.types import Array, IntArray


def prior_root(
    q: Quadratic, effects: Sequence[Effect], index: IntArray | None = None
) -> Array | None:
    """Square root of the prior covariance of a quadratic's parameters (``index`` of them), or
    None for the identity: effects that are exclusive of another keep what that one lacks, and
    those with a gauge do without it."""
    return root_of(q.names if index is None else [q.names[i] for i in index], effects)


def root_of(names: Sequence[tuple[str, str]], effects: Sequence[Effect]) -> Array | None:
    """The same of parameters by their names."""
    ids = {e.id for e in effects}
    root = None
    for e in effects:
        if e.together is not None and (not e.exclusive or ids & set(e.exclusive)):
            mine = [i for i, n in enumerate(names) if n[0] == e.id]
            root = np.eye(len(names)) if root is None else root
            root[np.ix_(mine, mine)] = e.together
    return root

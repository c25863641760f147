"""Biases that are known only as long as something else is not there."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.model import Fitted
from handcal.estimate.transfer import moved_to
from handcal.types import Array
from handcal.units import DEG, MG

# A bias leans on the absence of an effect that would make it so many times less certain.
MUCH = 3.0
# Names, and rad/s and m/s^2 as people read them.
GYRO = ("gyro", DEG, "deg/s")
ACCEL = ("accelerometer", MG, "mg")


def leaning(f: Fitted, effects: Sequence[Effect], hardly_shown: Collection[str]) -> list[str]:
    """A sentence for each sensor whose biases would be far less certain with one of these effects.

    effects: of the model; hardly_shown: ids of effects of the catalogue that the recording could
    not show if they had their usual size, so that their absence is assumed, not seen. From the
    information matrix, each of them alone beside the model.
    """
    have = {e.id for e in effects}
    others = [
        e
        for i, e in catalogue().items()
        if i in hardly_shown and i not in have and e.moments is None and applicable(f.case, e)
    ]
    others = [e for e in others if e.process is None and not e.outliers]
    if not others:
        return []
    wide = moved_to(f, [*effects, *others])
    done = reduced_pass(reduce(wide.linear), wide.levels)
    owner = [s.owner for s in wide.problem.slots]
    information = done.log_likelihood[2] + np.eye(6 + len(owner))
    absent = {e.id for e in others}
    kept = [*range(6), *(6 + i for i, o in enumerate(owner) if o not in absent)]
    scale = done.reduction.scale[:6]
    alone = scale * _sigmas(information, kept)
    worst, causes = alone.copy(), dict[int, list[str]]()
    for e in others:
        with_it = [*kept, *(6 + i for i, o in enumerate(owner) if o == e.id)]
        sigma = scale * _sigmas(information, with_it)
        for k in np.flatnonzero(sigma > MUCH * alone):
            causes.setdefault(int(k), []).append(e.title.lower())
            worst[k] = max(worst[k], sigma[k])
    return _sentences(alone, worst, causes)


def _sentences(alone: Array, worst: Array, causes: Mapping[int, Sequence[str]]) -> list[str]:
    """One for each sensor: how well its biases are known, and how well with a cause."""
    out = []
    for first, (sensor, factor, unit) in ((0, GYRO), (3, ACCEL)):
        mine = [k for k in sorted(causes) if first <= k < first + 3]
        if mine:
            axes = ", ".join("xyz"[k - first] for k in mine)
            known, then = (", ".join(f"{factor * x[k]:.2g}" for k in mine) for x in (alone, worst))
            titles = ", ".join(dict.fromkeys(title for k in mine for title in causes[k]))
            out.append(
                f"The {sensor}'s bias ({axes}: {known} {unit}) is known that well only if nothing "
                "is there that this motion could hardly show; with as much as is usual of one of "
                f"these: {then} {unit} ({titles})."
            )
    return out


def _sigmas(information: Array, those: Sequence[int]) -> Array:
    """Of the first six of those parameters, (6,), in units of their priors."""
    root = np.linalg.cholesky(information[np.ix_(those, those)])
    return np.asarray(np.linalg.norm(np.linalg.solve(root, np.eye(len(those))[:, :6]), axis=0))

"""Numbers that are known only as long as something else is not there."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import applicable
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.model import Fitted
from handcal.estimate.prior_root import root_of
from handcal.estimate.problem import Slot
from handcal.estimate.transfer import moved_to
from handcal.explanation import is_curve
from handcal.types import Array
from handcal.units import plain, shown

# A number leans on the absence of an effect that would make it so many times less certain.
MUCH = 3.0


@dataclass(frozen=True)
class _Numbers:
    """What one sentence is about: columns of the information matrix, and their axes or names."""

    title: str
    unit: str
    columns: Mapping[int, str]


def leaning(
    f: Fitted,
    effects: Sequence[Effect],
    not_seen: Collection[str],
    unnamed: Collection[str],
    excess: Mapping[str, float],
) -> list[str]:
    """A sentence for the biases of each sensor, and for each effect of the model, whose numbers
    would be far less certain with an effect that is not in it.

    effects: of the model; not_seen: ids of effects of the catalogue whose absence is assumed, not
    seen: of their usual size the recording could not show them, or it rather has them than not;
    unnamed: ids of effects of the model of which nothing is said; excess: by which the scores of
    each effect scatter beyond the information matrix, as in the sigmas of ``parameters``.
    From the information matrix, each of them alone beside the model.
    """
    have = {e.id for e in effects}
    others = [
        e
        for i, e in catalogue().items()
        if i in not_seen and i not in have and e.moments is None and applicable(f.case, e)
    ]
    others = [e for e in others if e.process is None and not e.outliers]
    if not others:
        return []
    wide = moved_to(f, [*effects, *others])
    done = reduced_pass(reduce(wide.linear), wide.levels)
    slots, information = wide.problem.slots, done.log_likelihood[2]
    names = [*(("", axis) for axis in "xyzxyz"), *((s.owner, s.name) for s in slots)]
    absent = {e.id for e in others}
    kept = [i for i, (owner, _) in enumerate(names) if owner not in absent]
    beyond = np.sqrt([1.0] * 6 + [excess.get(s.owner, 1.0) for s in slots])
    scale = done.reduction.scale * beyond
    alone = scale * _sigmas(information, root_of(names, effects), kept)
    worst, causes = alone.copy(), dict[int, list[str]]()
    for e in others:
        with_it = [i for i, (owner, _) in enumerate(names) if owner not in absent - {e.id}]
        sigma = scale * _sigmas(information, root_of(names, [*effects, e]), with_it)
        for k in np.intersect1d(kept, np.flatnonzero(sigma > MUCH * alone)):
            causes.setdefault(int(k), []).append(e.title.lower())
            worst[k] = max(worst[k], sigma[k])
    told = [
        _sentence(n, alone, worst, causes)
        for n in _numbers(slots, [e for e in effects if e.id not in unnamed])
    ]
    return [sentence for sentence in told if sentence]


def _numbers(slots: Sequence[Slot], effects: Sequence[Effect]) -> list[_Numbers]:
    """The biases of both sensors, and the constants of each effect, those of one unit together."""
    out = [
        _Numbers("The gyro's bias", "rad/s", dict(enumerate("xyz"))),
        _Numbers("The accelerometer's bias", "m/s^2", dict(enumerate("xyz", start=3))),
    ]
    # (a coefficient of a curve is no number that anybody reads)
    for e in (e for e in effects if not is_curve(e.id)):
        mine = [(k, s) for k, s in enumerate(slots, start=6) if s.owner == e.id]
        for unit in dict.fromkeys(s.unit for _, s in mine):
            out.append(_Numbers(e.title, unit, {k: s.name for k, s in mine if s.unit == unit}))
    return out


def _sentence(n: _Numbers, alone: Array, worst: Array, causes: Mapping[int, Sequence[str]]) -> str:
    """How well these numbers are known, and how well with what may be there; "" where that is
    alike."""
    at = [k for k in n.columns if k in causes]
    if not at:
        return ""
    unit = shown(n.unit, worst[at])
    known, then = (", ".join(plain(unit.factor * x[k], 2) for k in at) for x in (alone, worst))
    titles = ", ".join(dict.fromkeys(title for k in at for title in causes[k]))
    return (
        f"{n.title} ({', '.join(n.columns[k] for k in at)}: {known} {unit.unit}) is known that "
        "well only without effects that this motion could hardly show; with one of usual size "
        f"({titles}): {then} {unit.unit}."
    )


def _sigmas(information: Array, prior: Array | None, those: Sequence[int]) -> Array:
    """Of all parameters, those of them alone in a model, in units of their priors, of which
    ``prior`` is the square root of the covariance (None: the identity); of the others, infinity."""
    own = np.eye(len(those)) if prior is None else prior[np.ix_(those, those)]
    root = np.linalg.cholesky(own.T @ information[np.ix_(those, those)] @ own + np.eye(len(those)))
    out = np.full(len(information), np.inf)
    out[list(those)] = np.linalg.norm(np.linalg.solve(root, own.T), axis=0)
    return out

"""What any method could find: the evidence that the information matrix promises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.baseline import always, started
from handcal.estimate.case import Case, applicable, case_of, frozen_at
from handcal.estimate.fit import fitted
from handcal.estimate.scan import scan
from handcal.estimate.transfer import moved_to
from handcal.laws import shapes
from handcal.model_score import OCCAM_LEVEL
from handcal.search.space import expected_gain as expected_nats
from handcal.search.space import space
from handcal.types import Array, HandcalError, InputError, Recording


def expected_gain(recording: Recording, effect_id: str, values: Sequence[float]) -> float:
    """Nats of evidence, Occam's factor included, that an effect of this size would gain.

    values: in the order of the effect's parameters, SI. The mean over the noise, from the
    information matrix of the recording's own motion and noise; of a bias that walks, the mean
    over its walks too. Infinite for other effects that are noise, which no such matrix
    describes. Raises InputError for an unknown effect, HandcalError where the recording cannot
    show it.
    """
    effect = catalogue().get(effect_id)
    if effect is None or len(values) != len(effect.parameters):
        raise InputError(f"'{effect_id}' with {len(values)} values is no effect of the catalogue.")
    if effect.outliers or (effect.process is not None and not effect.walks):
        return math.inf
    case = case_of(recording)
    if effect.walks:
        return _walk_gain(case, effect, float(values[0]))
    if not applicable(case, effect):
        raise HandcalError(f"This recording cannot show the effect '{effect_id}'.")
    size = np.asarray(values, dtype=float)
    if effect.moments is not None:
        moment = np.zeros(len(size))
        column = int(np.flatnonzero(effect.moments(recording.imu.t)[0])[0])
        moment[column] = size[column]
        effect, size = frozen_at(effect, moment), np.delete(size, column)
    known = always([case])
    base = fitted([started(case, known)], known)
    candidates = [effect, *(e for e in known if e.id != effect.id)]
    where = space(scan(base, [effect]), candidates, {})
    have = frozenset(e.id for e in known)
    return expected_nats(where, effect.id, have, size / effect.prior_sigma)


def _walk_gain(case: Case, effect: Effect, density: float) -> float:
    """Nats that a walking bias of this density would gain, less what its level costs.

    Most of a walk shows as one slow course of size z (standard normal), which gains
    (lambda z^2 - log(1 + lambda)) / 2. So the mean is made by a few far walks: where it is 25
    nats, a third of all walks gain next to nothing.
    """
    # with the noise that is left when the walk is known, as if there had been none
    known = always([case])
    whole = fitted([started(case, known)], [*known, effect])
    parts = tuple(moved_to(f, known) for f in whole.parts)
    rest = replace(whole, effects=known, parts=parts)
    first = 0 if effect.walks == "gyro" else 3
    bases = [shapes.imu_basis(first + i, case.recording.duration_s) for i in range(3)]
    q = scan(rest, [b.effect for b in bases])
    K = np.zeros((len(q.names), len(q.names)))
    for b in bases:
        mine = [i for i, n in enumerate(q.names) if n[0] == b.effect.id]
        walk = density**2 * np.minimum(b.grid[:, None], b.grid)
        size = b.effect.prior_sigma
        K[np.ix_(mine, mine)] = (b.through @ walk @ b.through.T) / np.outer(size, size)
    return mean_gain(q.G / q.worth, K) - OCCAM_LEVEL


def mean_gain(G: Array, K: Array) -> float:
    """Mean log-evidence gained by unknowns of covariance K (k, k), where they are there, over
    none: readings tell them with the information G (k, k)."""
    values, vectors = np.linalg.eigh(0.5 * (G + G.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    seen = root.T @ K @ root
    return 0.5 * float(np.trace(seen) - np.linalg.slogdet(np.eye(len(seen)) + seen)[1])

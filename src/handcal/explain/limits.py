"""What any method could find: the evidence that the information matrix promises."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from handcal.effects import catalogue
from handcal.explain.case import applicable, case_of, frozen_at
from handcal.explain.fit import fitted, scan, started
from handcal.explain.search import expected_gain as expected_nats
from handcal.explain.search import space
from handcal.types import HandcalError, InputError, Recording


def expected_gain(recording: Recording, effect_id: str, values: Sequence[float]) -> float:
    """Nats of evidence, Occam's factor included, that an effect of this size would gain.

    values: in the order of the effect's parameters, SI. The mean over the noise, from the
    information matrix of the recording's own motion and noise; infinite for effects that
    are noise themselves, which no such matrix describes. Raises InputError for an unknown
    effect, HandcalError where the recording cannot show it.
    """
    effect = catalogue().get(effect_id)
    if effect is None or len(values) != len(effect.parameters):
        raise InputError(f"'{effect_id}' with {len(values)} values is no effect of the catalogue.")
    if effect.process is not None or effect.outliers:
        return math.inf
    case = case_of(recording)
    if not applicable(case, effect):
        raise HandcalError(f"This recording cannot show the effect '{effect_id}'.")
    size = np.asarray(values, dtype=float)
    if effect.moments is not None:
        moment = np.zeros(len(size))
        column = int(np.flatnonzero(effect.moments(recording.imu.t)[0])[0])
        moment[column] = size[column]
        effect, size = frozen_at(effect, moment), np.delete(size, column)
    base = fitted([started(case)], ())
    where = space(scan(base, [effect]), [effect], {})
    return expected_nats(where, effect.id, frozenset(), size / effect.prior_sigma)

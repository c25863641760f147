"""Which common effects are found: those with evidence and a parameter that stands out."""

from __future__ import annotations

import numpy as np
import pytest

from handcal.effects import select
from handcal.estimate.quadratic import Quadratic
from handcal.search.common_found import shown
from handcal.search.space import space


def of(effect_id, z, information=4.0):
    """What a recording says that sees each parameter alike, at so many sigmas (k,) each."""
    (effect,) = select([effect_id])
    k = len(effect.parameters)
    names = tuple((effect.id, p.name) for p in effect.parameters)
    # mean = b / (1 + G), sigma = 1 / sqrt(1 + G), in usual sizes
    b = np.broadcast_to(z, k) * np.sqrt(1.0 + information)
    q = Quadratic(names, 0.0, b, information * np.eye(k))
    return shown(space(q, [effect], {}), frozenset([effect.id]))


@pytest.mark.parametrize(("z", "found"), [(1.9, False), (2.6, True)])
def test_evidence_that_no_parameter_has_alone_names_nothing(z, found):
    """Issue 75: an effect at 99.8 %, none of its nine values above two sigma."""
    assert bool(of("gyro_g_sensitivity", z)) == found


def test_one_parameter_that_stands_out_is_enough():
    assert of("gyro_scale", [0.0, 0.0, 6.0])
    assert not of("gyro_scale", [0.0, 0.0, 0.5])

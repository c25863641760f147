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


@pytest.mark.parametrize(("information", "found"), [(2.0, False), (4.0, True)])
def test_what_no_parameter_is_shown_of_is_not_found(information, found):
    """A sigma of each below half the usual size (1 / sqrt(1 + 3)) is shown; evidence that nine
    parameters share is no matter of one."""
    assert bool(of("gyro_g_sensitivity", 2.4, information)) == found


def test_one_parameter_that_stands_out_is_enough():
    assert of("gyro_scale", [0.0, 0.0, 6.0])
    assert not of("gyro_scale", [0.0, 0.0, 0.5])

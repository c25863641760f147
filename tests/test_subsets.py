"""The evidence of sets of effects in compiled code, against that of each set by itself."""

from __future__ import annotations

import numpy as np
import pytest

from handcal.effects import catalogue
from handcal.estimate.heavy_tails import log_evidence
from handcal.estimate.prior_root import prior_root
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.subsets import subsets

# Plain ones, one with a positive parameter, one whose prior has a gauge, one that is exclusive.
NAMES = ("accel_scale", "gyro_bandwidth", "gyro_scale", "lever_arm", "mag_soft_iron", "size_effect")


def _drawn(seed):
    """A quadratic of these effects, some of them large, whose parameters are in another order."""
    rng = np.random.default_rng(seed)
    effects = [catalogue()[i] for i in NAMES]
    listed = [effects[n] for n in rng.permutation(len(effects))]
    names = tuple((e.id, p.name) for e in listed for p in e.parameters)
    rows = rng.normal(size=(3 * len(names), len(names))) * 10.0 ** rng.uniform(-1, 1, len(names))
    true = rng.normal(size=len(names)) * 10.0 ** rng.uniform(-1, 1, len(names))
    return Quadratic(names, -3.0, rows.T @ (rows @ true), rows.T @ rows), effects


@pytest.mark.parametrize("seed", range(5))
def test_sets_have_the_evidence_that_each_has_by_itself(seed):
    q, effects = _drawn(seed)
    rng = np.random.default_rng([seed, 1])
    where = {
        e.id: np.array([k for k, n in enumerate(q.names) if n[0] == e.id], dtype=np.int64)
        for e in effects
    }
    found = subsets(q, effects, where)
    assert found.together  # (some prior is not the identity)
    for _ in range(20):
        chosen = np.flatnonzero(rng.random(len(effects)) < 0.5)
        some = [effects[n] for n in chosen]
        index = np.concatenate([np.zeros(0, dtype=np.int64), *(where[e.id] for e in some)])
        positive = np.array([p.positive for e in some for p in e.parameters], dtype=bool)
        alone = log_evidence(q, index, prior_root(q, some, index), positive) if some else q.a
        assert found.log_evidence([int(n) for n in chosen]) == pytest.approx(alone, abs=1e-9)

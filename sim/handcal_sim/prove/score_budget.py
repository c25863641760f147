"""The suite `budget`: is the gyro better afterwards, and is what is said of its errors honest?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from handcal_sim.effects import EFFECTS
from handcal_sim.prove.trial import Trial, matched, named, share, together

MEDIAN, WORST = 0.05, 0.20
# Gravity is the gauge of a scale error, which is always there.
REPORTED = frozenset(EFFECTS) - {"gravity"}


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """Shares of the gyro's error that are left in recordings not seen; names; coverage."""
    told = [t for t in trials if "error" not in t.document]
    left = [t.further["share_left"] for t in told]
    found = sum(len(matched(t.answer.effects, named(t.document))) for t in told)
    there = sum(len(t.answer.effects) for t in told)
    whole = len(left) == len(trials) > 0
    return {
        "left": {
            "n": len(left),
            "median": float(np.median(left)) if left else None,
            "worst": max(left, default=None),
            "asked": {"median": MEDIAN, "worst": WORST},
            "met": whole and bool(np.median(left) <= MEDIAN and max(left) <= WORST),
        },
        "names": share(found, there),
        "parameters": together(trials, REPORTED),
    }

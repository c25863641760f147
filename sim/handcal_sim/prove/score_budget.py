"""The suite `budget`: is the gyro better afterwards, and is what is said of its errors honest?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from handcal_sim.effects import EFFECTS
from handcal_sim.prove.trial import Trial, matched, named, share, together

MEDIAN, WORST = 0.05, 0.20
# Or so many times what `calibrate` leaves that is told all names.
BESIDE_TOLD = 1.1
# Gravity is the gauge of a scale error, which is always there.
REPORTED = frozenset(EFFECTS) - {"gravity"}


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """Shares of the gyro's error that are left in recordings not seen; names; coverage."""
    told = [t for t in trials if "error" not in t.document]
    left = [t.further["share_left"] for t in told]
    # (it is not asked where less is left than has to be)
    least = [
        t.further.get("told", x if x <= MEDIAN else 0.0) for t, x in zip(told, left, strict=True)
    ]
    found = sum(len(matched(t.answer.effects, named(t.document))) for t in told)
    there = sum(len(t.answer.effects) for t in told)
    beyond = sum(not _near(x, y, WORST) for x, y in zip(left, least, strict=True))
    whole = len(left) == len(trials) > 0
    return {
        "left": {
            "n": len(left),
            "median": float(np.median(left)) if left else None,
            "worst": max(left, default=None),
            "told": {
                "median": float(np.median(least)) if least else None,
                "worst": max(least, default=None),
            },
            "beyond": beyond,
            "asked": {"median": MEDIAN, "worst": WORST, "beside_told": BESIDE_TOLD},
            "met": whole
            and beyond == 0
            and _near(float(np.median(left)), float(np.median(least)), MEDIAN),
        },
        "names": share(found, there),
        "parameters": together(trials, REPORTED),
    }


def _near(left: float, told: float, asked: float) -> bool:
    """Whether no more is left than asked, or hardly more than could be avoided."""
    return left <= max(asked, BESIDE_TOLD * told)

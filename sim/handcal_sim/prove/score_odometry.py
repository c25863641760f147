"""The suite `odometry`: is a perfect tracker left in peace, and are a real one's values honest?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from handcal_sim.prove.trial import Trial, named, share, together

REPORTED = frozenset({"pose_scale", "pose_delay", "lever_arm", "gyro_bias", "accel_bias"})


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """How many perfect trackers are said to drift, how many others are found to; coverage."""
    return {
        "perfect_said_to_drift": _drifting([t for t in trials if _perfect(t)]),
        "drift_found": _drifting([t for t in trials if not _perfect(t)]),
        "parameters": together(trials, REPORTED),
    }


def _perfect(trial: Trial) -> bool:
    return "pose_drift" not in trial.answer.effects


def _drifting(trials: Sequence[Trial]) -> dict[str, Any]:
    told = [t for t in trials if "error" not in t.document]
    return share(sum(any("pose_drift" in s for s in named(t.document)) for t in told), len(told))

"""The suite `phone`: are all reported values honest, and is none of them impossible?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from handcal_sim.prove.trial import Trial, met, share, together

ASKED = 0.95
REPORTED = frozenset({
    "mag_hard_iron", "mag_soft_iron", "heading_delay", "gyro_scale", "gyro_misalignment",
    "lever_arm", "gyro_bias",
})  # fmt: skip
# No phone that is sold is so far off.
IMPOSSIBLE = {"gyro_scale": 0.05, "accel_scale": 0.05, "gyro_misalignment": math.radians(5.0),
              "accel_misalignment": math.radians(5.0)}  # fmt: skip


def impossible(trial: Trial) -> bool:
    """Whether something is named with a value that no phone has."""
    return any(
        abs(p["value"]) > IMPOSSIBLE.get(missing["effect"], math.inf)
        for missing in trial.document.get("missing", [])
        for p in missing["parameters"]
    )


def score(trials: Sequence[Trial]) -> dict[str, Any]:
    """Coverage of the reported parameters against ASKED; how many recordings claim too much."""
    parameters = together(trials, REPORTED)
    return {
        "parameters": parameters,
        "asked": {"target": ASKED, "met": met(parameters["all"]["within_3_sigma"], ASKED)},
        "impossible": share(sum(impossible(trial) for trial in trials), len(trials)),
    }

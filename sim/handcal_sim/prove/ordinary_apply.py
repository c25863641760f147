"""How much of a device's errors is left in another recording, corrected by what was learnt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.prove.draw_ordinary import Case, recorded
from handcal_sim.prove.trial import Trial, share

SENSORS = ("gyro", "accel")


def left(case: Case, corrected: Path) -> dict[str, float]:
    """Mean squares of what gyro and accelerometer read too much in the second recording, before and
    after the correction: of all of it, and of what is not constant (`gyro_before_varying`).

    White noise, which no correction takes off, is taken out by a twin of the recording without it.
    """
    import handcal

    read, silent = recorded(case, again=True), recorded(case, again=True, silent=True)
    truth = np.hstack([read.truth.omega, read.truth.f])
    imu = handcal.load(corrected).imu
    t = imu.t - imu.t[0] + read.imu.stamps[0]
    noise, true, before = (
        _at(t, read.imu.stamps, x)
        for x in (read.imu.values - silent.imu.values, truth, silent.imu.values - truth)
    )
    after = np.hstack([imu.gyro, imu.accel]) - true - noise
    found = {}
    for when, error in (("before", before), ("after", after)):
        for k, sensor in enumerate(SENSORS):
            own = error[:, 3 * k : 3 * k + 3]
            found[f"{sensor}_{when}"] = float(np.mean(own**2))
            found[f"{sensor}_{when}_varying"] = float(np.mean((own - own.mean(axis=0)) ** 2))
    return found


def _at(t: Array, stamps: Array, values: Array) -> Array:
    return np.stack([np.interp(t, stamps, column) for column in values.T], axis=1)


def score(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """By sensor, of all errors and of what varies: root mean squares before and after (of all
    recordings), the median share of a mean square that is left, and how many were made worse."""
    rows = []
    told = [t.further for t in trials if "gyro_before" in t.further]
    for sensor in SENSORS:
        for what in ("", "_varying"):
            pairs = [(f[f"{sensor}_before{what}"], f[f"{sensor}_after{what}"]) for f in told]
            if pairs:
                before, after = (math.sqrt(sum(x) / len(x)) for x in zip(*pairs, strict=True))
                rows.append({
                    "sensor": sensor, "what": "what varies" if what else "all",
                    "before": before, "after": after,
                    "median_left": float(np.median([b / max(a, 1e-30) for a, b in pairs])),
                    "worse": share(sum(b > a for a, b in pairs), len(pairs)),
                })  # fmt: skip
    return rows

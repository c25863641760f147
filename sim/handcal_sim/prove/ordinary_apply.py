"""How much of a device's errors is left in another recording, corrected by what was learnt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim.prove.draw_ordinary import Case, recorded
from handcal_sim.prove.trial import Trial, share
from handcal_sim.scenario import World
from handcal_sim.strangers import scene_of

SENSORS = ("gyro", "accel")
# By less than this nothing is made worse (readings are written with so many digits).
SAME = 1.0 + 1e-6


def left(case: Case, corrected: Path) -> dict[str, float]:
    """Mean squares of what gyro and accelerometer read too much in the second recording, which has
    no white noise, before and after the correction: of all but the bias at its mean temperature,
    which a correction leaves, and of what is not constant (`gyro_before_varying`)."""
    import handcal

    world = another(case)
    imu, warm = handcal.load(corrected).imu, float(scene_of(world).warm.mean())
    t = imu.t - imu.t[0] + world.imu.stamps[0]
    rows = np.hstack([world.truth.omega, world.truth.f, world.imu.values])
    true, read = np.split(
        np.stack([np.interp(t, world.imu.stamps, row) for row in rows.T], axis=1), 2, axis=1
    )
    found = {}
    for when, values in (("before", read), ("after", np.hstack([imu.gyro, imu.accel]))):
        for sensor, own in zip(SENSORS, np.split(values - true, 2, axis=1), strict=True):
            apart = own - np.add(
                case.device.effects[f"{sensor}_bias"],
                warm * np.array(case.device.effects[f"{sensor}_temperature"]),
            )
            found[f"{sensor}_{when}"] = float(np.mean(apart**2))
            found[f"{sensor}_{when}_varying"] = float(np.mean((own - own.mean(axis=0)) ** 2))
    return found


def another(case: Case) -> World:
    """Another recording of the device, without white noise, which no correction takes off."""
    return recorded(case, again=True, silent=True)


def rows(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Of each recording what is left, the worst of the gyro first."""
    told = [t for t in trials if "gyro_before" in t.further]
    told.sort(key=lambda t: -t.further["gyro_after"])
    known = ("kind", "motion", "stream", "rare")
    return [{"recording": t.name, **{k: t.answer.circumstances[k] for k in known},
             "law": t.answer.stranger.get("kind", ""), **t.further} for t in told]  # fmt: skip


def score(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """By sensor, of all errors but the bias and of what varies: root mean squares before and after,
    the median share of a mean square that is left, and how many recordings were made worse; of the
    first also how much is left over what the posteriors expect, in the mean, and how many
    recordings they expect to be made worse."""
    rows = []
    told = [t.further for t in trials if "gyro_before" in t.further]
    for sensor in SENSORS:
        for what in ("", "_varying"):
            pairs = [(f[f"{sensor}_before{what}"], f[f"{sensor}_after{what}"]) for f in told]
            if pairs:
                before, after = (math.sqrt(sum(x) / len(x)) for x in zip(*pairs, strict=True))
                row = {
                    "sensor": sensor, "what": "what varies" if what else "all but the bias",
                    "before": before, "after": after,
                    "median_left": float(np.median([b / max(a, 1e-30) for a, b in pairs])),
                    "worse": share(sum(b > SAME * a for a, b in pairs), len(pairs)),
                }  # fmt: skip
                foreseen = [f for f in told if f"{sensor}_expected" in f]
                if foreseen and not what:
                    over = [f[f"{sensor}_after"] / f[f"{sensor}_expected"] for f in foreseen]
                    row["left_over_expected"] = float(np.mean(over))
                    row["median_over_expected"] = float(np.median(over))
                    row["worse_expected"] = float(
                        np.mean([f[f"{sensor}_expected_worse"] for f in foreseen])
                    )
                rows.append(row)
    return rows

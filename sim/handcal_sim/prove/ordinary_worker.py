"""The process that calibrates recordings for `ordinary`, each told by its path alone.

`priors.toml` in a recording's folder is what is known of its class. Where `again` holds another
recording of the same name, what was learnt is taken off it, and `corrected` holds what comes of it,
with what the posterior expects of that.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal_sim.prove.ordinary_devices import COMMON, shows
from handcal_sim.prove.workers import serve

if TYPE_CHECKING:
    from handcal.types import Recording

# All that every device has, as far as a recording's streams can show it.
ALL_COMMON = "common"
PRIORS, AGAIN, CORRECTED = "priors.toml", "again", "corrected"
DRAWS = 64


def calibrated(effects: str, path: str) -> Mapping[str, Any]:
    """What `handcal calibrate FILE --effects EFFECTS --json` says of a recording."""
    from handcal.commands.calibrate import calibrate

    file = Path(path)
    priors, again = file.with_name(PRIORS), file.parent / AGAIN / file.name
    out = file.with_suffix(".json")
    if effects == ALL_COMMON:
        effects = ",".join(_common(file))
    calibrate([file], effects=effects, json=out, priors=priors if priors.exists() else None)
    if again.exists():
        _corrected(again, out, file.parent / CORRECTED / file.name)
    document: Mapping[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return document


def _common(file: Path) -> list[str]:
    import handcal

    there = frozenset(handcal.load(file).streams)
    cold = "temperature" not in there
    return [n for n in COMMON if shows(n, there) and not (cold and n.endswith("_temperature"))]


def _corrected(again: Path, learnt: Path, out: Path) -> None:
    from handcal.commands.apply import apply
    from handcal.types import HandcalError

    out.parent.mkdir(exist_ok=True)
    try:
        apply(again, learnt_from=learnt, out=out)
    except HandcalError as error:
        # (nothing that could be taken off: it stays as it is)
        out.with_suffix(".txt").write_text(str(error), encoding="utf-8")
    else:
        foreseen = expected(again, learnt)
        out.with_suffix(".json").write_text(json.dumps(foreseen), encoding="utf-8")


def expected(again: Path, learnt: Path) -> dict[str, float]:
    """What the posterior expects of a correction, by devices drawn from it: the mean square of
    each sensor that is left, what is not shown and not taken off included, and the share of devices
    of which more is left than there was."""
    import handcal
    from handcal.device.apply import apply, read
    from handcal.effects import catalogue

    document = json.loads(learnt.read_text(encoding="utf-8"))
    names = [(p["effect"], p["name"]) for p in document["parameters"]]
    mean = np.array([p["value"] for p in document["parameters"]])
    covariance, known, raw = np.array(document["covariance"]), read(learnt), handcal.load(again)
    ids = dict.fromkeys(e for e, _ in names if e in catalogue())
    errors = [e for e in ids if catalogue()[e].imu_error and not catalogue()[e].baseline]
    own = {e: [names.index((e, n)) for f, n in names if f == e] for e in errors}
    draws = np.random.default_rng(0).multivariate_normal(mean, covariance, DRAWS, method="eigh")

    def readings(recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.stack([recording.imu.gyro, recording.imu.accel])

    uncorrected, corrected = readings(raw), readings(apply(raw, known).recording)
    left, before = [], []
    for x in draws:
        device = replace(known, values={e: x[at] for e, at in own.items()})
        true = readings(apply(raw, device).recording)
        left.append(np.mean((corrected - true) ** 2, axis=(1, 2)))
        before.append(np.mean((uncorrected - true) ** 2, axis=(1, 2)))
    worse = np.mean(np.array(left) > np.array(before), axis=0)
    return {
        f"{sensor}_{what}": float(value)
        for k, sensor in enumerate(("gyro", "accel"))
        for what, value in (("expected", np.mean(left, axis=0)[k]), ("expected_worse", worse[k]))
    }


if __name__ == "__main__":
    serve(partial(calibrated, sys.argv[1] if sys.argv[1:] else ""))

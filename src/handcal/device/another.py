"""Whether a recording is evidently another than a result was made of: of another device, or its
readings corrected before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.device.apply import BIASES, Learnt
from handcal.estimate.white import white_levels
from handcal.recordings.overview import rate_at_rest
from handcal.recordings.segment import each_rest
from handcal.types import HandcalError, Imu, Recording
from handcal.units import DEG

# Times that rate and noise of one device may differ from recording to recording; noise that is
# read holds a little of the motion.
OTHER_RATE, OTHER_NOISE = 1.3, 5.0
# What a gyro's bias may change, rad/s: three times what is usual of a device.
OTHER_BIAS = 3.0 / DEG
_NAMES = {"gyro_noise": "gyro", "accel_noise": "accelerometer"}


def read_noise(recording: Recording) -> dict[str, float]:
    """Noise densities that the readings show of what was recorded, SI; empty of too few."""
    if len(recording.imu.t) < 100:
        return {}
    shown = white_levels(recording)
    return {f"{s}_noise": shown[f"{s}_noise"] for s in recording.sensors}


def rest_noise(recording: Recording) -> dict[str, float]:
    """The same of the longest rest; empty where there is none of 100 readings."""
    imu = recording.imu
    rest = max(each_rest(recording), key=lambda r: r.seconds, default=None)
    if rest is None:
        return {}
    k = (imu.t >= rest.start) & (imu.t <= rest.end)
    still = Imu(imu.t[k], imu.gyro[k], imu.accel[k], imu.valid[k])
    return read_noise(replace(recording, imu=still, streams={}))


def unlike(recording: Recording, learnt: Learnt) -> list[str]:
    """Sentences about both, where there is anything to say."""
    said = another(recording, learnt), corrected_otherwise(recording, learnt)
    return [sentence for sentence in said if sentence]


def another(recording: Recording, learnt: Learnt) -> str:
    """A sentence where the recording seems to be of another device; empty where it does not."""
    # (of several recordings of the device one that is alike is enough)
    signs = min((list(_signs(recording, made)) for made in learnt.made), key=len, default=[])
    signs += _bias(recording, learnt)
    if not signs:
        return ""
    return (
        f"{Path(recording.path).name} seems to be of another device than {learnt.path}: "
        f"{'; '.join(signs)}. What is right for one device makes the readings of another worse."
    )


def corrected_otherwise(recording: Recording, learnt: Learnt) -> str:
    """A sentence where a recording's readings were corrected before and those of the result were
    not, or the other way round; empty where a result is of readings like these."""
    here, name = recording.corrected, Path(recording.path).name
    said = [m.get("corrected") for m in learnt.made] or [None]
    made = [dict(s) if isinstance(s, Mapping) else {} for s in said]
    if learnt.sha256 in here:
        return f"{name} was corrected by {here[learnt.sha256]} already, which is this result."
    if any(here.keys() == own.keys() for own in made):
        return ""
    before = [here[k] for k in here if all(k not in own for own in made)]
    if before:
        return (
            f"{name} was corrected by {', '.join(before)} already, and {learnt.path} is of "
            "readings that were not: errors would be taken off twice. What is left in it "
            f"`handcal explain {name}` finds."
        )
    first = ", ".join(str(v) for k, v in made[0].items() if k not in here)
    return (
        f"{learnt.path} is what {first} had left in its readings, and {name} was not corrected by "
        f"that: apply {first} first."
    )


def check_corrected(recording: Recording, learnt: Learnt, anyway: bool) -> None:
    """Errors: HandcalError where errors would be taken off twice, or the rest of them without what
    comes first, unless that is wanted anyway."""
    why = corrected_otherwise(recording, learnt)
    if why and not anyway:
        raise HandcalError(f"{why} With --anyway it is done all the same.")


def _signs(recording: Recording, made: Mapping[str, Any]) -> Iterator[str]:
    """In what it differs from a recording that the result was made of."""
    for what in ("device", "model"):
        here, there = getattr(recording, what), str(made.get(what) or "")
        if here and there and here != there:
            yield f"its {what} is {here}, not {there}"
    rate, learnt_at = recording.rate_hz, made.get("imu_rate_hz")
    if learnt_at and _apart(rate, float(learnt_at)) > OTHER_RATE:
        yield f"it has {rate:.0f} readings in a second, not {float(learnt_at):.0f}"
    known = made.get("read_noise") or {}
    for name, level in read_noise(recording).items():
        if known.get(name) and _apart(level, float(known[name])) > OTHER_NOISE:
            times = level / float(known[name])
            yield f"the noise of its {_NAMES[name]} is {times:.2g} times as large"


def _apart(a: float, b: float) -> float:
    return max(a / b, b / a)


def _bias(recording: Recording, learnt: Learnt) -> list[str]:
    """That the gyro at rest reads what is far from each bias that was shown."""
    rests = each_rest(recording)
    if not rests or not learnt.biases:
        return []
    away = []
    for of, bias in learnt.biases:
        hidden = learnt.hidden.get(of, {}).get(BIASES[0], "")
        off = np.abs(rate_at_rest(rests) - bias[:3])
        away.append(max((x for x, a in zip(off, "xyz", strict=True) if a not in hidden), default=0))
    if min(away) < OTHER_BIAS:
        return []
    return [f"at rest its gyro is {min(away) * DEG:.2g} deg/s away from the bias that was learnt"]

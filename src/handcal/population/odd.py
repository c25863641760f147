"""Devices and recordings that the population does not expect, with the reason."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from handcal.device.file import Name
from handcal.population.deconvolved import (
    FAR,
    LEAST,
    Population,
    chance,
    core,
    foretold,
    population,
)
from handcal.population.grouped import devices as as_devices
from handcal.types import Array

# Expected by chance less often than this in all devices and parameters of the model: worth a line.
RARE = 1.0
# Expected so rarely, it is none of its population, which is then told without it.
SURELY = 1e-3
# Of a model's devices as many are none of it at the most: of more, they are a population too.
FEW = 0.25
# Of so many devices a few odd ones do not move the median of how far recordings are off.
MANY = 10
# What an accelerometer reads at most and least where it stands or is turned by hand, m/s^2.
GRAVITY = (7.0, 13.0)


@dataclass(frozen=True)
class Odd:
    """who: a device or a recording; by_chance: how many so far off are expected in the model by
    chance; effect and name of the parameter that stands out most ("" for others), its value and
    sigma, and what was expected of it (mean and deviation), SI; kind: "device", "recording" (unlike
    the device's others), "gravity", "refused" (hardly one of its recordings could be used, and
    ``said`` why); like: another device that it rather is ("" where none); left_out: populations are
    told without it."""

    who: str
    kind: Literal["device", "recording", "gravity", "refused"]
    by_chance: float
    effect: str
    name: str
    value: float
    sigma: float
    mean: float
    deviation: float
    like: str = ""
    left_out: bool = False
    said: str = ""


def devices(
    names: Sequence[str], told: Mapping[Name, tuple[Population, Array, Array]]
) -> list[Odd]:
    """The odd ones of d devices, the oddest first. told: of each parameter the population, values
    (d,) and sigmas (d,), nan where a device was not told.

    Each is judged by a population of the others, since one that is far off widens its own. Several
    that are far off would hide each other: so it begins with those that are near the middle, and
    further ones come in as long as those that are in already let expect them.
    """
    if not told:
        return []
    keys, many = list(told), len(told) * len(names)
    off = np.nanmax([_off(*told[k][1:]) for k in keys], axis=0, initial=0.0)
    gone = np.flatnonzero(off > FAR).tolist() if np.sum(off <= FAR) > LEAST else []
    while True:
        p = np.stack([_chances(*told[k], gone) for k in keys])
        least = p.min(axis=0) * many
        back = [d for d in gone if least[d] > SURELY]
        if not back and len(gone) > FEW * len(names):
            back = [max(gone, key=lambda d: float(least[d]))]
        if not back:
            break
        gone = [d for d in gone if d not in back]
    worst = p.argmin(axis=0)
    out = []
    for d, name in enumerate(names):
        if least[d] < RARE:
            effect, parameter = keys[worst[d]]
            _, x, s = told[keys[worst[d]]]
            mean, deviation = _others(x, s, d, gone)
            out.append(Odd(name, "device", float(least[d]), effect, parameter, float(x[d]),
                           float(s[d]), mean, deviation, left_out=d in gone))  # fmt: skip
    return sorted(out, key=lambda o: o.by_chance)


def _chances(p: Population, x: Array, sigma: Array, gone: Sequence[int]) -> Array:
    """Probability (d,) of each device to be so far off, by the others that are not gone; 1 where
    it was not told. Of those that are near, by the population of all."""
    there = np.isfinite(x) & np.isfinite(sigma)
    out = np.where(there, chance(p, np.where(there, x, 0.0), np.where(there, sigma, 1.0)), 1.0)
    kept = [i for i in np.flatnonzero(there).tolist() if i not in gone]
    if len(kept) <= LEAST:
        return out
    off = _off(x, sigma)
    for d in np.flatnonzero(there & (off > FAR)).tolist():
        rest = [i for i in kept if i != d]
        out[d] = foretold(x[rest], sigma[rest], float(x[d]), float(sigma[d]))
    return out


def _off(x: Array, sigma: Array) -> Array:
    """By how many deviations (d,) each is away from the middle, by the scatter of the middle half;
    0 where it was not told."""
    there = np.isfinite(x) & np.isfinite(sigma)
    if not there.any():
        return np.zeros(len(x))
    own = as_devices(x[there], sigma[there], np.arange(int(there.sum()), dtype=np.int64))
    away = np.abs(x - np.median(x[there])) / np.sqrt(sigma**2 + core(own) ** 2)
    return np.asarray(np.where(there, away, 0.0))


def _others(x: Array, sigma: Array, d: int, gone: Sequence[int]) -> tuple[float, float]:
    """Mean and deviation that the others let expect of a device."""
    rest = [i for i in range(len(x)) if i != d and i not in gone and np.isfinite(x[i])]
    if len(rest) < LEAST:
        return math.nan, math.nan
    p = population(x[rest], sigma[rest], np.arange(len(rest), dtype=np.int64))
    return p.mean, p.deviation


def recordings(
    labels: Sequence[str], owner: Sequence[str], told: Mapping[Name, tuple[Array, Array]]
) -> list[Odd]:
    """Recordings unlike the others of their device. told: of each parameter that stays with a
    device the values (n,) and sigmas (n,), nan where not told; owner: names of the devices."""
    by_owner: dict[str, list[int]] = {}
    for i, o in enumerate(owner):
        by_owner.setdefault(o, []).append(i)
    others = [[j for j in by_owner[o] if j != i] for i, o in enumerate(owner)]
    judged = [i for i in range(len(labels)) if others[i] and told]
    if not judged:
        return []
    z = {k: np.array([_away(x, s, i, others[i])[0] for i in judged]) for k, (x, s) in told.items()}
    if len({owner[i] for i in judged}) >= MANY:
        # (where the sigmas of all are too small, no single recording is odd)
        z = {k: v / max(1.0, 1.4826 * float(np.median(np.abs(v)))) for k, v in z.items()}
    out, expected = [], {}
    for n, i in enumerate(judged):
        worst = max(z, key=lambda k: abs(z[k][n]))
        expected[i] = math.erfc(abs(z[worst][n]) / math.sqrt(2.0)) * len(z) * len(labels)
        if expected[i] < RARE:
            x, s = told[worst]
            _, mean, deviation = _away(x, s, i, others[i])
            like = _likeness(i, others[i], by_owner, told)
            one = Odd(labels[i], "recording", expected[i], *worst, float(x[i]), float(s[i]), mean,
                      deviation, like)  # fmt: skip
            out.append((one, i))
    alone = Counter(owner[i] for i in judged if expected[i] < SURELY)
    return sorted(
        (replace(o, left_out=_is_alone(o, alone[owner[i]], len(others[i]))) for o, i in out),
        key=lambda o: o.by_chance,
    )


def _is_alone(o: Odd, so_odd: int, others: int) -> bool:
    """Whether a recording is none of its device's: it is another's, or it is the only one that the
    rest, which agree, do not expect."""
    return o.by_chance < SURELY and (bool(o.like) or (so_odd == 1 and others >= LEAST))


def _away(x: Array, s: Array, i: int, others: Sequence[int]) -> tuple[float, float, float]:
    """By how many sigma a recording differs from others, their mean, and its sigma."""
    mine = [j for j in others if not math.isnan(x[j])]
    if not mine or math.isnan(x[i]):
        return 0.0, math.nan, math.nan
    w = 1.0 / s[mine] ** 2
    mean, deviation = float((w * x[mine]).sum() / w.sum()), float(w.sum() ** -0.5)
    return (float(x[i]) - mean) / math.hypot(float(s[i]), deviation), mean, deviation


def _likeness(
    i: int, others: Sequence[int], by_owner: Mapping[str, Sequence[int]],
    told: Mapping[Name, tuple[Array, Array]],
) -> str:  # fmt: skip
    """Another device that agrees with a recording in everything, as its own does not; or ""."""
    score = {}
    for name, members in by_owner.items():
        away = [_away(x, s, i, members)[0] for x, s in told.values()] if i not in members else []
        if away:
            score[name] = max(map(abs, away))
    best = min(score, key=lambda k: score[k], default="")
    own = max(abs(_away(x, s, i, others)[0]) for x, s in told.values())
    # (of a hundred numbers the largest is within 3.5 sigma by chance in 19 of 20)
    return best if best and score[best] < 3.5 < 0.5 * own else ""


def unlike_gravity(labels: Sequence[str], gravity: Sequence[float]) -> list[Odd]:
    """Recordings whose accelerometer does not read gravity: of another unit, or none."""
    low, high = GRAVITY
    return [Odd(label, "gravity", 0.0, "", "", g, 0.0, 9.81, 0.0)
            for label, g in zip(labels, gravity, strict=True) if not low < g < high]  # fmt: skip


def refused(recordings: Mapping[str, Sequence[str]]) -> list[Odd]:
    """Devices most of whose recordings were refused; recordings: of each device why each of its
    recordings was ("" where it was not)."""
    out = []
    for name, reasons in recordings.items():
        said = [r for r in reasons if r]
        if len(said) > 1 and len(said) > 0.5 * len(reasons):
            out.append(Odd(name, "refused", 0.0, "", "", len(said), 0.0, 0.0, 0.0, said=said[0]))
    return out

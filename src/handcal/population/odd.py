"""Devices and recordings that the population does not expect, with the reason."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.device.file import Name
from handcal.population.deconvolved import Population, chance
from handcal.types import Array

# Expected by chance less often than this in all devices and parameters of the model: worth a line.
RARE = 1.0
# What an accelerometer reads at most and least where it stands or is turned by hand, m/s^2.
GRAVITY = (7.0, 13.0)


@dataclass(frozen=True)
class Odd:
    """who: a device or a recording; by_chance: how many so far off are expected in the model by
    chance; effect and name of the parameter that stands out most ("" for others), its value and
    sigma, and what was expected of it (mean and deviation), SI; kind: "device", "recording" (unlike
    the device's others), "gravity"; like: another device that it rather is ("" where none)."""

    who: str
    kind: str
    by_chance: float
    effect: str
    name: str
    value: float
    sigma: float
    mean: float
    deviation: float
    like: str = ""


def devices(
    names: Sequence[str], told: Mapping[Name, tuple[Population, Array, Array]]
) -> list[Odd]:
    """The odd ones of d devices, the oddest first. told: of each parameter the population, values
    (d,) and sigmas (d,), nan where a device was not told."""
    if not told:
        return []
    keys = list(told)
    p = np.stack([_chance(*told[k]) for k in keys])
    worst = p.argmin(axis=0)
    out = []
    for d, name in enumerate(names):
        pop, x, s = told[keys[worst[d]]]
        expected = float(p[worst[d], d]) * len(keys) * len(names)
        if expected < RARE:
            effect, parameter = keys[worst[d]]
            out.append(Odd(name, "device", expected, effect, parameter, float(x[d]), float(s[d]),
                           pop.mean, pop.deviation))  # fmt: skip
    return sorted(out, key=lambda o: o.by_chance)


def _chance(p: Population, x: Array, sigma: Array) -> Array:
    """``chance`` (d,), 1 where a device was not told."""
    there = ~np.isnan(x)
    return np.where(there, chance(p, np.where(there, x, 0.0), np.where(there, sigma, 1.0)), 1.0)


def recordings(
    labels: Sequence[str], owner: Sequence[str], told: Mapping[Name, tuple[Array, Array]]
) -> list[Odd]:
    """Recordings unlike the others of their device. told: of each parameter that stays with a
    device the values (n,) and sigmas (n,), nan where not told; owner: names of the devices."""
    out = []
    by_owner: dict[str, list[int]] = {}
    for i, o in enumerate(owner):
        by_owner.setdefault(o, []).append(i)
    for i, label in enumerate(labels):
        others = [j for j in by_owner[owner[i]] if j != i]
        if not others or not told:
            continue
        off = {k: _away(x, s, i, others) for k, (x, s) in told.items()}
        worst = max(off, key=lambda k: abs(off[k][0]))
        z, mean, deviation = off[worst]
        expected = math.erfc(abs(z) / math.sqrt(2.0)) * len(off) * len(labels)
        if expected < RARE:
            x, s = told[worst]
            like = _likeness(i, others, by_owner, told)
            out.append(Odd(label, "recording", expected, worst[0], worst[1], float(x[i]),
                           float(s[i]), mean, deviation, like))  # fmt: skip
    return sorted(out, key=lambda o: o.by_chance)


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

"""A device with a strange law: how large the law is there, and what is told of it afterwards."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal_sim.aiding import wrapped
from handcal_sim.profiles import Array
from handcal_sim.scenario import World
from handcal_sim.strange import accel, compass, fourth, gyro, more, third
from handcal_sim.strange.known import remainder, seen
from handcal_sim.strange.law import Law, Strange, drawn, rms
from handcal_sim.strangers import Scene, scene_of, with_error

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        *gyro.LAWS,
        *accel.LAWS,
        *compass.LAWS,
        *more.LAWS,
        *third.LAWS,
        *fourth.LAWS,
    )
}
# Those that came last, by a helper who knew neither grammar nor drivers of that day.
LATEST = tuple(law.name for law in fourth.LAWS)
# Least and largest root mean square that is left beyond the catalogue, over a third of a second,
# in SI: from a few tens of nats in 84 s to degrees of attitude in a turn.
SIZES = {"gyro": (1.5e-3, 0.02), "accel": (0.015, 0.15), "heading": (0.02, 0.2)}
# The whole of it, what the catalogue could take included: a tenth of what a hand's turning makes
# a sensor read (0.85 rad/s and 5.7 m/s^2 an axis), and of the half circle of a heading.
MOST = {"gyro": 0.1, "accel": 0.6, "heading": 0.3}
# Less than this (of a response of order one) is nothing.
LEAST = 1e-3
# Of an error that several axes share by one law.
SHARED = 0.2


@dataclass(frozen=True)
class Added:
    """A law in a world: what it is, its size k and what it added (n,) to its channel."""

    strange: Strange
    k: float
    error: Array


def own_scene(scene: Scene, channel: str) -> Scene:
    """The scene at the instants of the sensor to which a channel belongs."""
    if channel != "heading":
        return scene
    assert scene.at_heading is not None
    return scene.at_heading


def given(law: Law, world: World, rng: np.random.Generator) -> list[Added]:
    """The law on an axis drawn at random, at times on all of its sensor's with one size."""
    first = int(rng.integers(3))
    seed, sign = int(rng.integers(2**62)), float(rng.choice([-1.0, 1.0]))
    everywhere = law.turns_with_axes and rng.random() < SHARED
    axes = [(first + n) % 3 for n in range(3 if everywhere else 1)]
    low, high = SIZES[law.sensor]
    asked = math.exp(rng.uniform(math.log(low), math.log(high)))
    scene = scene_of(world)
    found = [drawn(law, axis, seed) for axis in axes]
    while not all(_acts(strange, scene) for strange in found):
        seed += 1  # (with these numbers it errs by nothing but an offset in this motion)
        found = [drawn(law, axis, seed) for axis in axes]
    k = sign * min(size(strange, scene, asked) for strange in found)
    return [Added(s, k, k * s.error_of(own_scene(scene, s.channel))) for s in found]


def _acts(strange: Strange, scene: Scene) -> bool:
    return rms(strange.error_of(own_scene(scene, strange.channel))) > LEAST


def size(strange: Strange, scene: Scene, asked: float) -> float:
    """The k that leaves `asked` beyond the catalogue, or the largest that makes sense."""
    at = own_scene(scene, strange.channel)
    error = strange.error_of(at)
    left = math.sqrt(float(np.mean(seen(at, strange.channel, error) ** 2)))
    most = MOST[strange.channel.partition("_")[0]]
    return min(asked / max(left, 1e-12), most / max(rms(error), 1e-12))


def with_laws(world: World, added: list[Added]) -> World:
    """The world with these errors in its readings."""
    for one in added:
        world = with_error(world, one.strange.channel, one.error)
    return world


def said_of(added: list[Added], scene: Scene) -> dict[str, Any]:
    """For the answers, of one law on all of its channels. left: root mean square that the
    catalogue cannot take; formula: of the first channel."""
    first = added[0]
    channels = [one.strange.channel for one in added]
    left = [rms(remainder(own_scene(scene, c), c, a.error))
            for c, a in zip(channels, added, strict=True)]  # fmt: skip
    return {
        "law": first.strange.law, "why": LAWS[first.strange.law].why, "channels": channels,
        "drivers": [list(one.strange.drivers) for one in added], "formula": first.strange.formula,
        "k": first.k, "rms": [rms(one.error) for one in added], "left": left,
    }  # fmt: skip


def off(channel: str, error: Array) -> Array:
    """An error less its mean, and of a heading the short way round."""
    if channel == "heading":
        error = wrapped(error - math.atan2(np.mean(np.sin(error)), np.mean(np.cos(error))))
    return np.asarray(error - error.mean())

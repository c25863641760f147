"""How much of a strange law an explanation leaves: named and unnamed parts against the truth.

The law's error and that of known effects, both as injected, less the effects as estimated and
less the curves of what has no name: at the true motion, without noise, each less its mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from handcal_sim import sensors
from handcal_sim.aiding import wrapped
from handcal_sim.effects import EFFECTS, Setup, apply
from handcal_sim.phone import HeadingErrors, Phone
from handcal_sim.profiles import Array
from handcal_sim.scenario import World
from handcal_sim.strange.device import Added, off, own_scene
from handcal_sim.strange.formulas import since_a_turn, value_of
from handcal_sim.strange.law import signal
from handcal_sim.strange.words import of_channel, said
from handcal_sim.strangers import AXES, Scene, scene_of

Values = Mapping[str, Mapping[str, float]]
# Directions in which north is sought.
NORTHS = 72
# What has no course that numbers of a document would tell, or no place on these channels.
_WITHOUT = ("_walk", "_noise", "_outliers", "mag_", "pose_", "clock_rate", "earth_rate")


def left_share(added: Sequence[Added], world: World, document: Mapping[str, Any]) -> float | None:
    """Root mean square of what is left over that of the law, over its channels; None where a
    curve is over something that is not known here."""
    unnamed = document["unnamed"]
    return left_of(added, world, document["parameters"], lambda one, at: curves(
        unnamed, one.strange.channel, at))  # fmt: skip


def left_of(
    added: Sequence[Added], world: World, parameters: Sequence[Mapping[str, Any]],
    told: Callable[[Added, Scene], Array | None],
) -> float | None:  # fmt: skip
    """The same of these parameters of known effects, and what is told of a law on its channel."""
    scene = scene_of(world)
    true, found = _values(world.parameters["effects"]), _listed(parameters)
    before = after = 0.0
    for one in added:
        channel, at = one.strange.channel, own_scene(scene, one.strange.channel)
        there = one.error + _known(true, channel, at)
        if told(one, at) is None:
            return None
        rest = partial(_rest, there, one, at, found, told)
        before += float(np.mean(off(channel, one.error) ** 2))
        after += _least(rest) if channel == "heading" or _by_north(one) else rest(0.0)
    return math.sqrt(after / before)


def _by_north(one: Added) -> bool:
    """Whether a law depends on where north is."""
    return any("heading" in d or "north" in d for d in one.strange.drivers)


def _rest(
    there: Array, one: Added, at: Scene, found: Values,
    told: Callable[[Added, Scene], Array | None], north: float,
) -> float:  # fmt: skip
    """Mean square of what is left, where an explanation has north so far off."""
    channel, turned = one.strange.channel, replace(at, heading=wrapped(at.heading + north))
    law = told(one, turned)
    assert law is not None
    return float(np.mean(off(channel, there - _known(found, channel, turned) - law) ** 2))


def _least(rest: Callable[[float], float]) -> float:
    """The least over where an explanation has north: where a heading reads zero is convention."""
    grid = np.linspace(-math.pi, math.pi, NORTHS, endpoint=False)
    best, step = grid[np.argmin([rest(x) for x in grid])], grid[1] - grid[0]
    return float(minimize_scalar(rest, bounds=(best - step, best + step), method="bounded").fun)


def curves(unnamed: Sequence[Mapping[str, Any]], channel: str, at: Scene) -> Array | None:
    """What the curves of a channel add up to (n,); None where one cannot be told."""
    total = np.zeros(len(at.t))
    for entry in unnamed:
        if channel not in entry["channels"]:
            continue
        try:
            total += (
                value_of(entry, channel, at) if entry["constants"] else _drawn(entry, channel, at)
            )
        except (AttributeError, KeyError, NameError, SyntaxError, TypeError, ValueError):
            return None
    return total


def _drawn(entry: Mapping[str, Any], channel: str, at: Scene) -> Array:
    """What a curve without a formula adds (n,): over its driver, times what it is a gain of."""
    curve, text = entry["curve"], entry["formula"].partition(" += ")[2]
    if len(entry["channels"]) > 1 and ("_i(" in text or text.startswith("e(")):
        raise KeyError(text)  # (drawn is that of one axis alone)
    if text.startswith("e("):
        return np.asarray(np.interp(at.t - at.t[0], curve["x"], curve["y"]))
    drivers = [_driver(of_channel(name, channel), at) for name in entry["drivers"]]
    if "|" in text and text.partition("|")[2][:1] != "o" and len(drivers) == 1:
        drivers = [np.abs(drivers[0])]
    if text.startswith("g("):
        return np.asarray(np.interp(np.prod(drivers, axis=0), curve["x"], curve["y"]))
    *felt, x = drivers
    return np.asarray(np.interp(x, curve["x"], curve["y"]) * np.prod(felt, axis=0))


def _driver(name: str, at: Scene) -> Array:
    """In the units of a curve: K above 25 degC, and the angle of pitch."""
    if name == "time since a turn":
        return since_a_turn(at)
    values = signal(at, said(name))
    if name.startswith("pitch of "):
        return np.asarray(np.arcsin(np.clip(values, -1.0, 1.0)))
    return values


def _values(effects: Mapping[str, Sequence[Mapping[str, Any]]]) -> Values:
    return {effect: {p["name"]: p["value"] for p in given} for effect, given in effects.items()}


def _listed(parameters: Sequence[Mapping[str, Any]]) -> Values:
    found: dict[str, dict[str, float]] = {}
    for p in parameters:
        found.setdefault(p["effect"], {})[p["name"]] = float(p["value"])
    return found


def _known(values: Values, channel: str, at: Scene) -> Array:
    """What catalogued effects of these values add to a channel, delays to the first order."""
    told = {
        effect: [named.get(p.name, 0.0) for p in EFFECTS[effect]]
        for effect, named in values.items()
        if effect in EFFECTS and not any(part in effect for part in _WITHOUT)
    }
    if "gyro_bandwidth" in told:
        told["gyro_bandwidth"] = [max(told["gyro_bandwidth"][0], 0.0)]
    setup = apply(Setup(Phone(), sensors.ASSUMED), told)
    sensor, _, axis = channel.partition("_")
    if sensor == "heading":
        return _heading(setup.phone.heading_errors, at)
    i, truth = AXES.index(axis), sensors.Truth(at.f, at.f, at.f, at.omega, at.alpha, at.f)
    if sensor == "gyro":
        lag = setup.phone.gyro.lag_s * at.alpha
        return np.asarray((sensors.gyro_error(setup.phone.gyro, truth, at.warm, at.t) - lag)[:, i])
    late = setup.phone.accel.delay_s * at.jerk
    place = sensors.rigid(at.omega, at.alpha, setup.phone.lever_arm)
    more = setup.earth.gravity_error * at.up + place - late
    return np.asarray((sensors.accel_error(setup.phone.accel, truth, at.warm) + more)[:, i])


def _heading(errors: HeadingErrors, at: Scene) -> Array:
    iron, soft = errors.hard_iron, errors.soft_iron
    h, turn = at.heading, signal(at, "turn")
    return np.asarray(
        iron[0] * np.sin(h) + iron[1] * np.cos(h) + soft[0] * np.sin(2.0 * h)
        + soft[1] * np.cos(2.0 * h) + errors.drift * at.t - errors.delay_s * turn
    )  # fmt: skip

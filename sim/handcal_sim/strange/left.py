"""How much of a strange law an explanation leaves: named and unnamed parts against the truth.

The law's error and that of known effects, both as injected, less the effects as estimated and
less the curves of what has no name: at the true motion, without noise, each less its mean.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from handcal_sim import sensors
from handcal_sim.effects import EFFECTS, Setup, apply
from handcal_sim.phone import HeadingErrors, Phone
from handcal_sim.profiles import Array
from handcal_sim.scenario import World
from handcal_sim.strange.device import Added, off, own_scene
from handcal_sim.strange.law import signal
from handcal_sim.strange.memory import followed, lagged
from handcal_sim.strange.words import of_channel, said
from handcal_sim.strangers import AXES, Scene, scene_of

# Slower than this (rad/s) a device is not being turned, to whoever speaks of the last turn.
TURNING = 0.2
# Temperature above which drivers have it, degC.
ROOM = 25.0
# What else somebody may make of a signal's past, and a curve of how much of a signal is felt.
_ELSE = re.compile(r"(?<![a-z])(?!memory|play|exp|sin|cos|tanh|abs|max|clip|round|g|e|g_i)[a-z_]+\("
                   r"|(?:omega|f)_[ijkxyz] \* (?:g|g_i)\(|\)\^2")  # fmt: skip
Values = Mapping[str, Mapping[str, float]]
# What has no course that numbers of a document would tell, or no place on these channels.
_WITHOUT = ("_walk", "_noise", "_outliers", "mag_", "pose_", "clock_rate", "earth_rate")


def left_share(added: Sequence[Added], world: World, document: Mapping[str, Any]) -> float | None:
    """Root mean square of what is left over that of the law, over its channels; None where a
    curve is over something that is not known here."""
    scene = scene_of(world)
    true = _values(world.parameters["effects"])
    found = _listed(document["parameters"])
    before = after = 0.0
    for one in added:
        channel, at = one.strange.channel, own_scene(scene, one.strange.channel)
        told = curves(document["unnamed"], channel, at)
        if told is None:
            return None
        known = _known(true, channel, at) - _known(found, channel, at)
        before += float(np.mean(off(channel, one.error) ** 2))
        after += float(np.mean(off(channel, one.error + known - told) ** 2))
    return math.sqrt(after / before)


def curves(unnamed: Sequence[Mapping[str, Any]], channel: str, at: Scene) -> Array | None:
    """What the curves of a channel add up to (n,); None where one cannot be told."""
    total = np.zeros(len(at.t))
    for entry in unnamed:
        if channel not in entry["channels"]:
            continue
        curve = entry.get("curve") or {}
        if not curve.get("x") or not entry["drivers"] or _of_one_axis(entry):
            return None
        try:
            driver = _course(entry, channel, at)
        except (AttributeError, KeyError):
            return None
        total += np.interp(driver, curve["x"], curve["y"])
    return total


def _of_one_axis(entry: Mapping[str, Any]) -> bool:
    """Whether a curve is of one axis alone, where each has constants of its own."""
    return len(entry["channels"]) > 1 and re.search(r"\b[gk]\d?_i\b", entry["formula"]) is not None


def _course(entry: Mapping[str, Any], channel: str, at: Scene) -> Array:
    """What the curve is drawn over (n,): the product of the drivers, or what is left of them."""
    x, formula = np.ones(len(at.t)), entry["formula"]
    if _ELSE.search(formula):
        raise KeyError(formula)
    if formula.partition(" += ")[2].startswith("e("):
        if len(entry["channels"]) > 1:
            raise KeyError(formula)
        return np.asarray(at.t - at.t[0])
    if "time since a turn" in entry["drivers"]:
        turned = signal(at, "|omega|") > TURNING
        return np.asarray(at.t - np.maximum.accumulate(np.where(turned, at.t, at.t[0])))
    for name in entry["drivers"]:
        x = x * _within(_driver(of_channel(name, channel), at), name, formula)
    if entry["curve"].get("x_unit") == "s^2":
        x = x * x
    if entry["curve"].get("x_unit") == "degC":
        x = x + ROOM
    if found := re.search(r"\bmemory\(([^ ]+) s\)", formula):
        past = lagged(at.t, x, float(found[1]))
        return past - x if re.search(r"\bmemory\([^ ]+ s\) of (.+) - \1\)", formula) else past
    if found := re.search(r"\bplay\(([^ ]+) ", formula):
        return followed(x, float(found[1])) - x
    return x


def _within(x: Array, name: str, formula: str) -> Array:
    """A driver as its formula has it: its size, or its smooth sign."""
    if f"|{name}|" in formula:
        return np.abs(x)
    found = re.search(rf"tanh\({re.escape(name)} / ([^)]+)\)", formula)
    return np.tanh(x / float(found[1])) if found and f"* {found[0]}" in formula else x


def _driver(name: str, at: Scene) -> Array:
    """In the units of a curve: K above 25 degC, and the angle of pitch."""
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

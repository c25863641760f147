"""How much of a gyro's error is left, at true motion, once estimated errors are taken off.

Noise-free: white noise and the walk of a bias, which no other recording repeats, stay out of it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from handcal_sim.effects import EFFECTS, Setup, apply
from handcal_sim.motion import Motion
from handcal_sim.phone import Gyro, Phone
from handcal_sim.profiles import Array
from handcal_sim.sensors import ASSUMED, gyro_error, lagged_rate, temperature, truth_at


def estimated(true: Phone, parameters: Iterable[Mapping[str, Any]]) -> Phone:
    """The device with no errors of the gyro but those: {effect, name, value} each, SI."""
    found: dict[str, dict[str, float]] = defaultdict(dict)
    for p in parameters:
        if str(p["effect"]).startswith("gyro_") and p["effect"] in EFFECTS:
            found[p["effect"]][p["name"]] = float(p["value"])
    values = {
        effect: [named.get(p.name, 0.0) for p in EFFECTS[effect]] for effect, named in found.items()
    }
    for effect in {"gyro_bandwidth", "gyro_bias_walk"} & set(values):
        values[effect] = [max(value, 0.0) for value in values[effect]]
    return apply(Setup(replace(true, gyro=Gyro()), ASSUMED), values).phone


def gyro_error_left(true: Phone, found: Phone, motion: Motion, t: Array) -> tuple[float, float]:
    """Root mean square (rad/s, all axes) of the true error and of what is left of it, each less
    its mean on each axis, at the instants t (n,)."""
    before = _error(true, true, motion, t)
    after = before - _error(found, true, motion, t)
    return _spread(before), _spread(after)


def _error(phone: Phone, true: Phone, motion: Motion, t: Array) -> Array:
    """What this device's gyro reads in addition (n, 3) where the true one is."""
    at = truth_at(motion, ASSUMED, true.lever_arm, t)
    warm = temperature(true.thermometer, t) - 25.0
    error = gyro_error(phone.gyro, at, warm, t)
    if phone.gyro.lag_s > 0.0:
        error = error + lagged_rate(motion, ASSUMED, phone.gyro.lag_s, t) - at.omega
    return error


def _spread(error: Array) -> float:
    return math.sqrt(float(np.mean((error - error.mean(axis=0)) ** 2)))

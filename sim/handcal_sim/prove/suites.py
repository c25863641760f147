"""What a blind trial draws from, suite by suite, and the form of its answers.

Nothing here is shared with the program on trial: sizes are those of consumers' devices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from handcal_sim import strangers
from handcal_sim.sensors import EARTH_RATE

# One standard deviation of what consumers' devices have, by effect; its parameters alike.
SIZES: dict[str, tuple[float, ...]] = {
    "gyro_scale": (0.01,),
    "accel_scale": (0.01,),
    "gyro_misalignment": (0.01,),
    "accel_misalignment": (0.01,),
    "gyro_g_sensitivity": (1.8e-4,),
    "gyro_quadratic": (0.005,),
    "gyro_cross_products": (0.005,),
    "accel_cross_products": (4e-4,),
    "accel_asymmetry": (0.01,),
    "lever_arm": (0.1,),
    "size_effect": (0.02,),
    "gyro_temperature": (9e-4,),
    "accel_temperature": (0.01,),
    "accel_delay": (0.02,),
    "gyro_bandwidth": (0.02,),
    "gyro_bias_walk": (1e-3,),
    "accel_bias_walk": (1e-3,),
    "gyro_bias_step": (0.01,),
    "heading_hard_iron": (0.2,),
    "heading_soft_iron": (0.15,),
    "mag_hard_iron": (1e-4,),
    "mag_soft_iron": (0.1,),
    "mag_gradient": (2e-5,),
    "mag_step": (2e-5,),
    "heading_delay": (0.15,),
    "pose_delay": (0.02,),
    "pose_scale": (0.02,),
    "pose_drift": (0.005, 5e-4),
    "heading_drift": (0.005,),
    "heading_correlated_noise": (0.15, 3.0),
    "heading_outliers": (0.1,),
    "gravity": (0.02,),
    "earth_rate": (EARTH_RATE,),
    "clock_rate": (100.0,),
}
POSITIVE = {"tau", "density", "sigma", "fraction", "position", "attitude"}
# Least and largest of what early, analogue and badly assembled devices have; delays of compasses
# and cameras.
LARGE: dict[str, tuple[float, float]] = {
    "gyro_scale": (0.03, 0.20),
    "accel_scale": (0.03, 0.20),
    "gyro_misalignment": (0.02, math.radians(5.0)),
    "accel_misalignment": (0.02, math.radians(5.0)),
    "heading_delay": (0.05, 0.30),
    "pose_delay": (0.05, 0.30),
    "accel_delay": (0.05, 0.30),
}
# The streams that a recording must have for an effect to show.
NEEDS: dict[str, frozenset[str]] = {
    **{name: frozenset({"heading"}) for name in SIZES if name.startswith("heading_")},
    "gyro_temperature": frozenset({"temperature"}),
    "accel_temperature": frozenset({"temperature"}),
    **{name: frozenset({"mag"}) for name in SIZES if name.startswith("mag_")},
    "pose_delay": frozenset({"pose"}),
    "pose_scale": frozenset({"pose"}),
    "pose_drift": frozenset({"pose"}),
    "clock_rate": frozenset({"pose"}),
}
# Effects of which a device may have a part alone: one axis, one pair of axes.
IN_PART = (
    "gyro_scale",
    "accel_scale",
    "gyro_misalignment",
    "accel_misalignment",
    "gyro_g_sensitivity",
    "gyro_quadratic",
    "gyro_cross_products",
    "accel_cross_products",
    "accel_asymmetry",
    "lever_arm",
    "gyro_temperature",
    "accel_temperature",
)
# Noise that wanders: alone, a law outside the catalogue could stand in for it.
WALKS = ("gyro_bias_walk", "accel_bias_walk", "heading_correlated_noise")
# What shows only beside another: the field changes with place where the device goes about an arm.
BESIDE = {"mag_gradient": "lever_arm"}
# Never drawn together: no motion tells the two apart, so that there is no right answer.
GAUGES = (frozenset({"gravity", "accel_scale"}),)

# Both sensors feel these, so that nothing shows beside a second IMU.
OF_THE_WORLD = frozenset({"gravity", "earth_rate"})

EARTH_GROUP = "the Earth's rate"
FAINT_NATS = (10.0, 25.0)


@dataclass(frozen=True)
class Suite:
    """full: its usual number of recordings; right: outcomes that count as such, of which
    `target` is the least share; title: what is drawn."""

    title: str
    full: int
    right: tuple[str, ...]
    target: float | None


SUITES: dict[str, Suite] = {
    "nothing": Suite("nothing missing", 200, ("exact",), 0.99),
    "one": Suite("one effect, 84 s about three axes", 4 * len(SIZES), ("exact",), 0.98),
    "mixed": Suite("0 to 3 effects, any motion", 100, ("exact", "right_set"), 0.90),
    "unknown": Suite("physics outside the catalogue", 4 * len(strangers.KINDS), ("exact",), 0.90),
    "turn": Suite("one effect, 30 s turn", 2 * len(SIZES), ("exact", "right_set", "missed"), 0.98),
    "faint": Suite("one effect near the limit", 40, ("exact", "right_set"), None),
    "reference": Suite("0 to 2 effects beside a trusted IMU", 60, ("exact", "right_set"), 0.90),
    "large": Suite(
        "1 to 3 of: 3 to 20 %, 1 to 5 deg, 50 to 300 ms", 100, ("exact", "right_set"), 0.95
    ),
    "phone": Suite("phones with a raw magnetometer", 100, ("exact", "right_set"), None),
    "odometry": Suite("a camera's poses, half of them perfect", 100, ("exact", "right_set"), 0.90),
    "people": Suite("sound sensors while people do things", 100, ("exact",), 0.99),
    "budget": Suite("8 to 12 errors at once, two recordings", 60, ("exact", "right_set"), None),
    "wild": Suite("0 to 3 effects, wild motion", 100, ("exact", "right_set"), 0.95),
    "strange": Suite("one or two laws outside the catalogue", 150, ("exact",), 0.90),
    "axis": Suite(
        "one effect on one axis, 84 s about three", 4 * len(IN_PART), ("exact", "right_set"), 0.98
    ),
    "walks": Suite("a walk or correlated noise alone, 84 s", 60, ("exact",), 0.95),
    "latest": Suite("the laws of `strange` that came last", 30, ("exact",), 0.90),
    "ordinary": Suite("devices with all that is usual, short motions", 180, ("exact",), None),
}


@dataclass(frozen=True)
class Answer:
    """What is right. effects: injected values, SI, by effect and parameter; stranger: what is
    outside the catalogue (kind, channel, formula, signals, rms; or kind and laws) or empty;
    baseline: true biases; circumstances: all else that was drawn. comparable: effects whose
    values an estimate can only give in another frame than the injected ones, in that frame: a
    constant heading offset, which no recording shows, turns the directions that iron refers to."""

    suite: str
    group: str
    effects: Mapping[str, Mapping[str, float]]
    stranger: Mapping[str, Any] = field(default_factory=dict)
    baseline: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    circumstances: Mapping[str, Any] = field(default_factory=dict)
    comparable: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def truth(self, effect: str) -> Mapping[str, float] | None:
        """What an estimate of this effect should give; None if it was not there."""
        return self.comparable.get(effect, self.effects.get(effect))

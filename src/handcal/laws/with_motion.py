"""Errors that go with the motion, and of which no law was found: noise that a reading has while
the device turns, or that changes as it turns.

A bias that walks does so whether the device turns or lies. What a sensor does wrong for a reason
that nobody wrote down goes with the motion: beside such an error, a walk is no explanation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np

from handcal.compiled.kernel import BASE
from handcal.effects import Effect, Param, catalogue
from handcal.estimate import smoother
from handcal.estimate.model import Fitted
from handcal.explanation import Curve
from handcal.types import Array, Level

# How the size of the error goes with the motion: as the rate, with a memory in time; or not at
# all, and what is forgotten is forgotten over the angle turned.
KINDS = {"turning": "e(t) * |omega|", "attitude": "e(attitude)"}
DRIVERS = {"turning": ("|omega|",), "attitude": ("attitude",)}
STORIES = {
    "turning": "While it turns it errs, by something that no law on trial describes.",
    "attitude": "It errs by something that changes as the device is turned and stays while it is "
    "not, and that no law on trial describes.",
}
SENSORS = ("gyro", "accel", "heading")
# First guess, least and largest size, of errors in proportion to the rate (SI units a rad/s) and of
# those that are not (SI units).
SIZES = {
    ("turning", "gyro"): ("1", 0.01, 1e-5, 1.0),
    ("turning", "accel"): ("(m/s^2)/(rad/s)", 0.03, 1e-4, 10.0),
    ("turning", "heading"): ("rad/(rad/s)", 0.03, 1e-4, 3.0),
    ("attitude", "gyro"): ("rad/s", 0.003, 1e-5, 1.0),
    ("attitude", "accel"): ("m/s^2", 0.03, 1e-4, 10.0),
    ("attitude", "heading"): ("rad", 0.05, 1e-4, 3.0),
}
# The same of what it remembers: a time, s, or an angle, rad.
MEMORIES = {"turning": ("s", 0.5, 0.03, 30.0), "attitude": ("rad", 0.5, 0.03, 10.0)}
AXES = "xyz"
# Points of a course over time.
POINTS = 200


class WithMotion:
    """Independent states, one an axis (zero on those that have none), that forget over time while
    their size is that of the rate, or that forget over the angle turned."""

    vectors = 0

    def __init__(self, kind: str, size: str, memory: str, axes: tuple[int, ...], dim: int) -> None:
        self.kind, self.levels, self.size = kind, (size, memory), dim
        self.mask = np.diag([float(axis in axes) for axis in range(dim)])

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Phi and Q (n, dim, dim)."""
        size, memory = (levels[name] for name in self.levels)
        passed = dt / memory if self.kind == "turning" else dt * rate / memory
        size_now = size * rate if self.kind == "turning" else np.full(len(dt), size)
        Q = -np.expm1(-2.0 * passed) * size_now**2
        Phi = np.exp(-passed)[:, None, None] * np.eye(self.size)
        return Phi, Q[:, None, None] * self.mask

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Covariance (dim, dim) at the start."""
        size = levels[self.levels[0]] * (rate if self.kind == "turning" else 1.0)
        return np.asarray(size**2 * self.mask)


def effects() -> Iterator[Effect]:
    """One for each sensor, on all its axes, and each way of going with the motion."""
    for sensor in SENSORS:
        for kind in KINDS:
            yield effect(sensor, (0,) if sensor == "heading" else (0, 1, 2), kind)


def on_axes(of: Effect, axes: tuple[int, ...]) -> Effect:
    """The same on these axes."""
    sensor, _, kind = _parts(of.id)
    return effect(sensor, axes, kind)


@cache
def effect(sensor: str, axes: tuple[int, ...], kind: str) -> Effect:
    """The error of a sensor's axes that goes with the motion in this way."""
    channel = sensor if sensor == "heading" else f"{sensor}_{''.join(AXES[a] for a in axes)}"
    unit, *sizes = SIZES[kind, sensor]
    span, *memories = MEMORIES[kind]
    size, memory = (f"{channel}_{kind}_{name}" for name in ("size", "memory"))
    heading = catalogue()["heading_correlated_noise"].observation_error
    observed = heading if sensor == "heading" else {}
    return Effect(
        id=f"{channel} += {KINDS[kind]}",
        title=f"{channel} errs with the motion",
        parameters=(
            Param("size", unit, sizes[0], positive=True),
            Param("memory", span, memories[0], positive=True),
        ),
        story=STORIES[kind],
        source="first-order Gauss-Markov process whose size is the rate, or whose clock is the "
        "angle turned",
        motion="Any motion with rests in it.",
        validated="laws outside the catalogue",
        observation_error=observed,
        process=WithMotion(kind, size, memory, axes, 1 if observed else 3),
        levels=(Level(size, unit, *sizes), Level(memory, span, *memories)),
        walks="" if observed else sensor,
        passing=True,
    )


def again(effect_id: str) -> Effect:
    """The effect of this id. Raises KeyError if there is none."""
    return effect(*_parts(effect_id))


def of_level(name: str) -> tuple[str, str] | None:
    """The id of the error that has a noise level, and which of its two that is; None where it is no
    such level."""
    channel, kind, which = ["", "", *name.rsplit("_", 2)][-3:]
    return (f"{channel} += {KINDS[kind]}", which) if kind in KINDS else None


def is_with_motion(effect_id: str) -> bool:
    """Whether this is the id of such an error."""
    return effect_id.partition(" += ")[2] in KINDS.values()


def _parts(effect_id: str) -> tuple[str, tuple[int, ...], str]:
    """Sensor, axes and kind of such an error. Raises KeyError for what is none."""
    channel, _, how = effect_id.partition(" += ")
    sensor, _, axes = channel.partition("_")
    kinds = [kind for kind, said in KINDS.items() if said == how]
    if sensor not in SENSORS or not kinds:
        raise KeyError(effect_id)
    return sensor, tuple(AXES.index(a) for a in axes) or (0,), kinds[0]


def channels(of: Effect) -> tuple[str, ...]:
    """To which it adds."""
    sensor, axes, _ = _parts(of.id)
    return (sensor,) if sensor == "heading" else tuple(f"{sensor}_{AXES[a]}" for a in axes)


def drivers(of: Effect) -> tuple[str, ...]:
    """With what it goes."""
    return DRIVERS[_parts(of.id)[2]]


def course(f: Fitted, of: Effect) -> tuple[Curve, float]:
    """What it adds over time to the channel to which it adds most, and the root mean square of what
    it adds to all its channels, SI, given the whole recording."""
    problem, linear = f.linear.problem, f.linear
    sensor, axes, _ = _parts(of.id)
    own = problem.states_of(of.process)[list(axes)]
    rows = np.unique(np.linspace(0, len(linear.t) - 1, POINTS).astype(np.int64))
    x, P = smoother.smooth(linear, f.levels, smoother.forward(linear, f.levels, rows=rows), rows)
    columns = BASE + problem.constants + own
    y = linear.trajectory.markov[rows][:, own] + x[:, columns]
    one = int(np.argmax(np.mean(y**2, axis=0)))
    sigma = np.sqrt(np.maximum(P[:, columns[one], columns[one]], 0.0))
    unit = {"gyro": "rad/s", "accel": "m/s^2", "heading": "rad"}[sensor]
    t = linear.t[rows] - linear.t[0]
    return Curve(t, y[:, one], sigma, "s", unit), math.sqrt(float(np.mean(y**2)))

"""What an unnamed term adds to a channel, drawn over what drives it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.device.twin import sensor_residuals
from handcal.effects import ROOM, TIME, WARMTH, Z_DIM, Effect, Signals, observed_error
from handcal.estimate.model import Fitted
from handcal.estimate.trajectory import path
from handcal.explanation import Curve, is_curve
from handcal.laws.law_effect import CHANNELS, UNITS, Law, channel_of, law_of
from handcal.laws.over_drivers import signals_of
from handcal.types import Array

# Points of a curve, at the most.
POINTS = 60
_SIGNALS = (r"(?:omega|f|alpha|jerk|north)_[ijkxyz]", "pitch of [xy]", "tilt", "yaw rate", "yaw",
            "time since a turn", "t", "T")  # fmt: skip
_DRIVERS = re.compile(rf"(\|(?:omega|f|alpha|jerk)\||\b(?:{'|'.join(_SIGNALS)})\b)")
_AXES = "xyz"
# Drivers that are a sine or a cosine of what they are drawn over.
_ANGLES = {"sin(pitch of x)": np.arcsin, "sin(pitch of y)": np.arcsin, "cos(tilt)": np.arccos}


def drivers_of(formula: str) -> tuple[str, ...]:
    """The measured signals in a term, each once."""
    return tuple(dict.fromkeys(_DRIVERS.findall(formula.split(" += ", 1)[1])))


@dataclass(frozen=True)
class Drawn:
    """A curve, and the root mean square of all that is added, with its sigma (SI)."""

    curve: Curve
    size: float
    sigma: float


def drawn(f: Fitted, effect: Effect, values: Array, C: Array) -> Drawn:
    """What something without a name, of these constants (k,) and their covariance C (k, k), SI,
    adds in a recording, over its driver, or how much more of another signal is felt; of axes with
    constants of their own, the one to which it adds most. A curve's mean is left to the bias."""
    signals = signals_of(f)
    law = law_of(effect)
    if law is None:
        pieces, x_unit, y_unit = _of_term(f, effect, signals)
    else:
        pieces, x_unit, y_unit = _of_law(law, signals), law.driver.unit, law.unit
        if law.driver.name in _ANGLES:
            angle, x_unit = _ANGLES[law.driver.name], "rad"
            pieces = [(angle(np.clip(x, -1.0, 1.0)), B, scale) for x, B, scale in pieces]
    rows, size, known = [], [], []
    for x, B, scale in pieces:
        gain = law is not None and law.driver.factor is not None
        B = B - B.mean(axis=0) if is_curve(effect.id) and not gain else B
        spread = np.maximum(np.einsum("ni,ij,nj->n", B, C, B), 0.0)
        rows.append((x, B @ values, np.sqrt(spread), scale))
        size.append(float(np.mean((scale * (B @ values)) ** 2)))
        known.append(float(np.mean(scale**2 * spread)))
    one = int(np.argmax(size))
    x, y, sigma = _binned(*rows[one][:3])
    whole, within = (math.sqrt(float(np.mean(v))) for v in (size, known))
    channels = [channel_of(effect.id)]
    if law is not None:
        channels = list(law.channels[one : one + 1] if law.each else law.channels)
    behind = _behind(f, signals.t, channels, *rows[one][:2], rows[one][3])
    return Drawn(Curve(x, y, sigma, x_unit, y_unit, behind), whole, within)


def _behind(
    f: Fitted, t: Array, channels: Sequence[str], x: Array, y: Array, scale: Array
) -> Array:
    """Means (m, 2) of a driver x, and of what was read beyond the fit without the term, y times
    scale, for a scale of one; all at the times t of the IMU, for one channel after the other."""
    left = sensor_residuals(f.linear)
    parts = []
    for n, channel in enumerate(channels):
        own = slice(n * len(t), (n + 1) * len(t))
        at, residual = left.get(channel, (np.zeros(0), np.zeros(0)))
        felt = np.interp(at, t, scale[own])
        error = np.interp(at, t, y[own]) * felt + residual
        parts.append((np.interp(at, t, x[own]), error * felt, felt**2))
    driver, error, felt = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    if len(driver) >= POINTS:
        driver, error, felt = _binned(driver, error, felt)
    some = felt > 0.0
    return np.stack([driver[some], error[some] / felt[some]], axis=1)


def _of_law(law: Law, signals: Signals) -> list[tuple[Array, Array, Array]]:
    """A law's driver (n,), what a unit of each of its constants adds (n, k), and by what that is
    multiplied (n,): of each axis, or of all together where they have the same constants."""
    one = law.form.constants
    x = [law.driver.course(signals, axis) for axis in law.axes]
    scale = [law.driver.scale(signals, axis) for axis in law.axes]
    if not law.each:
        together = np.concatenate(x)
        return [(together, law.form.values(together), np.concatenate(scale))]
    out = []
    for n, own in enumerate(x):
        B = np.zeros((len(own), one * len(x)))
        B[:, n * one : (n + 1) * one] = law.form.values(own)
        out.append((own, B, scale[n]))
    return out


def _of_term(
    f: Fitted, effect: Effect, signals: Signals
) -> tuple[list[tuple[Array, Array, Array]], str, str]:
    """The same of a course, or of a term of the heading; and the units."""
    way = path(f.linear.problem, f.linear.trajectory)
    C_nb = way.C[np.searchsorted(f.linear.problem.nodes.t, signals.t)]
    channel, drivers = channel_of(effect.id), drivers_of(effect.id)
    k = np.eye(len(effect.parameters))
    B = np.stack([_added(effect, channel, row, signals, C_nb) for row in k], axis=1)
    y_unit = UNITS[channel.startswith("accel")] if channel != "heading" else "rad"
    if len(drivers) == 1:
        x, x_unit = _driver(drivers[0], signals, C_nb)
    else:
        x, x_unit = B[:, 0], effect.parameters[0].unit.partition("/(")[2].rstrip(")")
    return [(x, B, np.ones(len(x)))], x_unit, y_unit


def _added(effect: Effect, channel: str, k: Array, signals: Signals, C: Array) -> Array:
    if effect.imu_error is not None:
        return np.asarray(effect.imu_error(k, signals)[:, CHANNELS.index(channel)])
    n = len(signals.t)
    nav, z = np.zeros((n, 21)), np.zeros((n, Z_DIM))
    nav[:, 6:15], nav[:, 15:18], nav[:, 18:] = C.reshape(n, 9), signals.gyro, signals.accel
    z[:, TIME] = signals.t - signals.t[0]
    if signals.temperature is not None:
        z[:, WARMTH] = signals.temperature - ROOM
    return observed_error(effect, "heading", k, nav, z, 1)[:, 0]


def _driver(name: str, signals: Signals, C: Array) -> tuple[Array, str]:
    """A signal (n,) and its unit."""
    if name == "yaw":
        return so3.yaw_of(C), "rad"
    if name.startswith("pitch"):
        return np.arcsin(np.clip(C[:, 2, _AXES.index(name[-1])], -1.0, 1.0)), "rad"
    if name == "tilt":
        return np.arccos(np.clip(C[:, 2, 2], -1.0, 1.0)), "rad"
    if name == "t":
        return signals.t - signals.t[0], "s"
    if name == "T" and signals.temperature is not None:
        return signals.temperature, "degC"
    if name == "|omega|":
        return np.linalg.norm(signals.gyro, axis=1), "rad/s"
    assert name == "yaw rate", name
    return np.einsum("ni,ni->n", C[:, 2], signals.gyro), "rad/s"


def _binned(x: Array, y: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Means over ranges of x that hold as many samples each, in the order of x."""
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, min(POINTS, len(order)))
    means = np.array([(x[p].mean(), y[p].mean(), sigma[p].mean()) for p in parts])
    return means[:, 0], means[:, 1], means[:, 2]

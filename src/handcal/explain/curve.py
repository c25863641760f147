"""What an unnamed term adds to a channel, drawn over what drives it."""

from __future__ import annotations

import re

import numpy as np

from handcal import so3
from handcal.effects import TIME, Z_DIM, Effect, Signals, observed_error
from handcal.estimate.fit import Fitted
from handcal.explain.explanation import Curve
from handcal.explain.laws import UNITS, Law
from handcal.explain.unnamed import signals_of
from handcal.linear import path
from handcal.types import Array

# Points of a curve, at the most.
POINTS = 60
_DRIVERS = re.compile(
    r"(\|omega\||\|f\||\b(?:(?:omega|f|alpha|jerk)_[ijkxyz]|yaw|pitch of [xy]|tilt|time since a turn|t|T)\b)"
)
_UNITS = {"omega": "rad/s", "f": "m/s^2", "alpha": "rad/s^2", "t": "s", "T": "degC"}
_AXES = "xyz"


def channel_of(formula: str) -> str:
    """The channel that a term adds to."""
    return formula.split(" += ", 1)[0]


def drivers_of(formula: str) -> tuple[str, ...]:
    """The measured signals in a term, each once."""
    return tuple(dict.fromkeys(_DRIVERS.findall(formula.split(" += ", 1)[1])))


def curve_of(f: Fitted, effect: Effect, value: float, sigma: float) -> Curve:
    """What a term of this size (SI) and sigma adds in a recording, over its driver; over the
    product, where it has several."""
    channel, drivers = channel_of(effect.id), drivers_of(effect.id)
    signals = signals_of(f)
    nominal = f.linear.trajectory
    way = path(f.linear.problem, nominal)
    C = way.C[np.searchsorted(f.linear.problem.nodes.t, signals.t)]
    added = _added(effect, channel, value, signals, C)
    of_imu = channel != "heading"
    y_unit = UNITS[channel.startswith("accel")] if of_imu else "rad"
    if len(drivers) == 1:
        x, x_unit = _driver(drivers[0], signals, C)
    else:
        x, x_unit = added / value, effect.parameters[0].unit.partition("/(")[2].rstrip(")")
    x, y = _binned(x, added)
    return Curve(x, y, np.abs(y) * abs(sigma / value), x_unit, y_unit)


def law_curve(f: Fitted, law: Law, values: Array, C: Array) -> tuple[Curve, float, float]:
    """A law with these constants (SI) and their covariance C, over its driver in a recording; the
    root mean square of what it adds there, and its sigma. Of axes with constants of their own, the
    one of which it adds most."""
    signals, one = signals_of(f), law.form.constants
    n = len(law.axes) if law.each else 1
    axes = [[axis] for axis in law.axes] if law.each else [list(law.axes)]
    drawn = []
    for k in range(n):
        own = slice(k * one, (k + 1) * one)
        x = np.sort(np.concatenate([law.driver.of(signals, axis) for axis in axes[k]]))
        B = law.form.values(x)
        y, spread = B @ values[own], np.einsum("ni,ij,nj->n", B, C[own, own], B)
        drawn.append((x, y, np.sqrt(np.maximum(spread, 0.0))))
    size = [float(np.sqrt(np.mean(y**2))) for _, y, _ in drawn]
    x, y, sigma = drawn[int(np.argmax(size))]
    parts = np.array_split(np.arange(len(x)), min(POINTS, len(x)))
    binned = [np.array([v[p].mean() for p in parts]) for v in (x, y, sigma)]
    whole = float(np.sqrt(np.mean(np.square(size))))
    known = np.mean([np.mean(s**2) for _, _, s in drawn])
    return Curve(*binned, law.driver.unit, UNITS[law.sensor]), whole, float(np.sqrt(known))


def _added(effect: Effect, channel: str, value: float, signals: Signals, C: Array) -> Array:
    k = np.array([value])
    if effect.imu_error is not None:
        error = effect.imu_error(k, signals)
        column = 3 * channel.startswith("accel") + _AXES.index(channel[-1])
        return np.asarray(error[:, column])
    n = len(signals.t)
    nav, z = np.zeros((n, 21)), np.zeros((n, Z_DIM))
    nav[:, 6:15], z[:, TIME] = C.reshape(n, 9), signals.t - signals.t[0]
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
        return signals.t - signals.t[0], _UNITS["t"]
    if name == "T":
        warm = signals.temperature
        return np.zeros_like(signals.t) if warm is None else warm, _UNITS["T"]
    kind, _, axis = name.rpartition("_")
    i = _AXES.index(axis)
    if kind == "alpha":
        return np.gradient(signals.gyro[:, i], signals.t), _UNITS[kind]
    return (signals.gyro if kind == "omega" else signals.accel)[:, i], _UNITS[kind]


def _binned(x: Array, y: Array) -> tuple[Array, Array]:
    """Means over ranges of x that hold as many samples each, in the order of x."""
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, min(POINTS, len(order)))
    means = np.array([(x[p].mean(), y[p].mean()) for p in parts])
    return means[:, 0], means[:, 1]

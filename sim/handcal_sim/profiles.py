"""Smooth functions of time together with their first two derivatives.

A profile takes instants t (n,) in s and returns a jet: value, first and second
derivative, each (n, d). Everything is at least four times continuously differentiable
and defined before 0 and after the end, so that delays and filters need no edge cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]
Jet = tuple[Array, Array, Array]
Profile = Callable[[Array], Jet]

# The step of degree 9: 0 below 0, 1 above 1, four derivatives vanish at both ends.
_STEP = np.array([0.0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
_STEP_BY_ORDER = {
    -1: polynomial.polyint(_STEP),
    0: _STEP,
    1: polynomial.polyder(_STEP),
    2: polynomial.polyder(_STEP, 2),
}


def _step(x: Array, order: int) -> Array:
    """The order-th derivative of the step; order -1 is its integral from 0."""
    inside: Array = polynomial.polyval(np.clip(x, 0.0, 1.0), _STEP_BY_ORDER[order])
    return inside + np.maximum(x - 1.0, 0.0) if order == -1 else inside


def _trapezoid(t: Array, start: float, end: float, ramp: float, order: int) -> Array:
    """Rises from 0 to 1 within `ramp` s after start, falls back within `ramp` s before end."""
    up, down = (t - start) / ramp, (t - end + ramp) / ramp
    return (_step(up, order) - _step(down, order)) * ramp**-order


def _column(t: Array, start: float, end: float, ramp: float, first: int, factor: float) -> Jet:
    value, rate, second = (
        factor * _trapezoid(t, start, end, ramp, first + k)[:, None] for k in range(3)
    )
    return value, rate, second


def gate(windows: Sequence[tuple[float, float]], ramp: float) -> Profile:
    """1 within the windows (start, end) but for their ramps, 0 outside. d = 1."""

    def profile(t: Array) -> Jet:
        zero = np.zeros((len(t), 1))
        return _sum([(zero, zero, zero), *(_column(t, a, b, ramp, 0, 1.0) for a, b in windows)])

    return profile


def turn(start: float, end: float, angle: float) -> Profile:
    """From 0 to `angle` rad between start and end, at constant rate but for its ends. d = 1."""
    ramp = 0.15 * (end - start)
    return lambda t: _column(t, start, end, ramp, -1, angle / (end - start - ramp))


def turn_rate(start: float, end: float, angle: float) -> Profile:
    """The magnitude of the rate of `turn`, rad/s. d = 1."""
    ramp = 0.15 * (end - start)
    return lambda t: _column(t, start, end, ramp, 0, abs(angle) / (end - start - ramp))


def constant(value: Sequence[float]) -> Profile:
    """The same value always. d is its length."""
    level = np.asarray(value, dtype=float)

    def profile(t: Array) -> Jet:
        shape = (len(t), len(level))
        return np.broadcast_to(level, shape), np.zeros(shape), np.zeros(shape)

    return profile


def sinusoids(omega: Array, sin: Array, cos: Array) -> Profile:
    """Sum of sin (K, d) sin(omega t) + cos (K, d) cos(omega t), omega (K,) in rad/s."""
    weights = np.vstack([sin, cos])
    first = np.vstack([-omega[:, None] * cos, omega[:, None] * sin])
    second = -(np.concatenate([omega, omega]) ** 2)[:, None] * weights

    def profile(t: Array) -> Jet:
        phase = t[:, None] * omega
        basis = np.hstack([np.sin(phase), np.cos(phase)])
        return basis @ weights, basis @ first, basis @ second

    return profile


def add(*profiles: Profile) -> Profile:
    """The sum of profiles of the same d."""
    return lambda t: _sum([profile(t) for profile in profiles])


def multiply(scalar: Profile, profile: Profile) -> Profile:
    """A profile with d = 1 times another one."""

    def product(t: Array) -> Jet:
        (u, du, ddu), (v, dv, ddv) = scalar(t), profile(t)
        return u * v, du * v + u * dv, ddu * v + 2.0 * du * dv + u * ddv

    return product


def along(axis: Sequence[float] | Array, profile: Profile) -> Profile:
    """A profile with d = 1 along a constant direction."""
    direction = np.asarray(axis, dtype=float)[None, :]

    def directed(t: Array) -> Jet:
        value, rate, second = profile(t)
        return value * direction, rate * direction, second * direction

    return directed


def circle(angle: Profile, radius: float, phase: float) -> Profile:
    """A level way (d = 3) on a circle, to where an angle (d = 1, rad) leads; zero at angle zero."""

    def profile(t: Array) -> Jet:
        a, da, dda = angle(t)
        out = radius * np.hstack([np.cos(a + phase), np.sin(a + phase), np.zeros_like(a)])
        on = radius * np.hstack([-np.sin(a + phase), np.cos(a + phase), np.zeros_like(a)])
        first = radius * np.array([math.cos(phase), math.sin(phase), 0.0])
        return out - first, da * on, dda * on - da**2 * out

    return profile


def _sum(jets: Sequence[Jet]) -> Jet:
    value, rate, second = jets[0]
    for jet in jets[1:]:
        value, rate, second = value + jet[0], rate + jet[1], second + jet[2]
    return value, rate, second

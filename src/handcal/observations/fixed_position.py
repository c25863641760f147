"""The held point stays where it is, but for the sway of the hand.

Sway is a displacement of that point: a critically damped second-order Markov process
(position and velocity both continuous, as a hand's are), larger while turning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from handcal.compiled.jit import njit, residual_function
from handcal.observations import Observation, Rows, Scene, pseudo_times
from handcal.types import Array, Level, Recording

# Up to so many states what is stationary less what is left is exact enough over the shortest
# intervals; of more, it is not below so many times of the process (the difference is as x^5).
EXACT_ORDER, SHORT = 2, 0.3
# Points of a quadrature that is exact to 1e-7 over such a while.
POINTS = 4


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] = z[i] - nav[i]
    return 0


def _swayed(nav: Any, sway: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] += sway[i]
    return 0


def _crept(nav: Any, sway: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] += sway[i] + sway[6 + i]
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    for i in range(3):
        H[15 * i + i] = 1.0
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    t = pseudo_times(recording, scene.rate, origin=scene.origin)
    return Rows(t, np.zeros((len(t), 3)))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["position_noise"] ** 2)


@dataclass(frozen=True)
class Part:
    """One part of how a hand sways, a critically damped Markov process: the levels of its size at
    rest, of what it has in addition for each rad/s of turning ("": nothing), and of its time; and
    how many states each axis has (displacement, m; velocity; acceleration), each the slope of the
    last and all but the last continuous, as a hand's are."""

    size: str
    per_rate: str
    time: str
    order: int


class Sway:
    """States of each part, one after the other: displacement (3,) m, velocity (3,) m/s, and so
    on."""

    def __init__(self, *parts: Part) -> None:
        self.parts = parts
        self.vectors = sum(part.order for part in parts)
        self.size = 3 * self.vectors

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Exact transition of each part, driven by white noise."""
        Phi, Q = np.zeros((2, len(dt), self.size, self.size))
        at = 0
        for part in self.parts:
            b = 1.0 / levels[part.time]
            unit, variance = np.power(b, np.arange(part.order)), _variance_of(part, levels, rate)
            _fill(b * dt, np.asarray(unit), variance, _shape(part.order), at, (Phi, Q))
            at += 3 * part.order
        return Phi, Q

    def weighed(
        self,
        many: Sequence[Mapping[str, float]],
        dt: Array,
        rate: Array,
        by_Phi: Array,
        by_Q: Array,
    ) -> Array:
        """Phi and Q at each of these levels, every entry times what it weighs, summed (m,)."""
        out, at = np.zeros(len(many)), 0
        for part in self.parts:
            n = np.arange(part.order)
            # (its size only scales Q: of one time there is one course)
            for time in {levels[part.time] for levels in many}:
                course = np.empty(len(dt))
                shape = np.power(1.0 / time, n), _shape(part.order)
                by_phi = _weighed(dt / time, *shape, at, (by_Phi, by_Q), course)
                for i in (i for i, levels in enumerate(many) if levels[part.time] == time):
                    out[i] += by_phi + course @ _variance_of(part, many[i], rate)
            at += 3 * part.order
        return out

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Stationary covariance at the turning rate of the start."""
        out, at = np.zeros((self.size, self.size)), 0
        for part in self.parts:
            unit, end = (1.0 / levels[part.time]) ** np.arange(part.order), at + 3 * part.order
            P = _stationary(part.order) * np.multiply.outer(unit, unit)
            for k in range(at, at + 3):
                out[k:end:3, k:end:3] = P * _variance_of(part, levels, np.array([rate]))
            at = end
        return out


def _dynamics(order: int) -> Array:
    """Matrix (k, k) of a process with all its poles at one place and time 1."""
    out = np.eye(order, k=1)
    out[-1] = [-math.comb(order, i) for i in range(order)]
    return out


@cache
def _stationary(order: int) -> Array:
    """Covariance (k, k) of such a process that has always been going on, of size 1."""
    white = np.zeros((order, order))
    white[-1, -1] = 1.0
    P = solve_continuous_lyapunov(_dynamics(order), -white)
    return np.asarray(P / P[0, 0])


# Of a process of size and time 1: see ``_fill``.
Shape = tuple[Array, Array, Array, Array, float]


@cache
def _shape(order: int) -> Shape:
    """What its transition is made of; less its pole, its dynamics are nilpotent, so that the series
    ends."""
    N, P = np.eye(order) + _dynamics(order), _stationary(order)
    series = [np.linalg.matrix_power(N, i) / math.factorial(i) for i in range(order)]
    at, weight = np.polynomial.legendre.leggauss(POINTS)
    power = -2.0 * (_dynamics(order) @ P)[-1, -1]
    short = 0.0 if order <= EXACT_ORDER else SHORT
    return np.array(series), P, 0.5 + 0.5 * at, 0.5 * power * weight, short


@njit
def _fill(
    x: Array, unit: Array, variance: Array, shape: Shape, at: int, out: tuple[Array, Array]
) -> None:
    """Write Phi and Q (k, n, n) of a process, from state ``at`` on of three axes that do not mix,
    over x (k,) of its times: what is stationary (o, o) less what is left of it; over a short
    while, where these are nearly the same, by quadrature (points and weights).

    unit (o,): what a unit of each state is; variance (k,): its size; shape: terms (o, o, o) of its
    series, the covariance P, points, weights, and below what x a while is short.
    """
    o = len(unit)
    phi, then, q = np.empty((o, o)), np.empty((o, o)), np.empty((o, o))
    for j in range(len(x)):
        _step(x[j], shape, then, phi, q)
        for a in range(o):
            for c in range(o):
                for axis in range(3):
                    i, k = at + 3 * a + axis, at + 3 * c + axis
                    out[0][j, i, k] = phi[a, c] * unit[a] / unit[c]
                    out[1][j, i, k] = q[a, c] * unit[a] * unit[c] * variance[j]


@njit
def _weighed(
    x: Array, unit: Array, shape: Shape, at: int, by: tuple[Array, Array], course: Array
) -> float:
    """The sum of what ``_fill`` would write to Phi, each entry times its weight in by[0] (k, n, n;
    or empty); course (k,) receives that of Q and by[1] in each interval, of size 1."""
    o = len(unit)
    phi, then, q = np.empty((o, o)), np.empty((o, o)), np.empty((o, o))
    out, moves = 0.0, len(by[0]) > 0
    for j in range(len(x)):
        _step(x[j], shape, then, phi, q)
        course[j] = 0.0
        for a in range(o):
            for c in range(o):
                for axis in range(3):
                    i, k = at + 3 * a + axis, at + 3 * c + axis
                    course[j] += by[1][j, i, k] * q[a, c] * unit[a] * unit[c]
                    if moves:
                        out += by[0][j, i, k] * phi[a, c] * unit[a] / unit[c]
    return out


@njit
def _step(x: float, shape: Shape, then: Array, phi: Array, q: Array) -> None:
    """Transition and what is new (o, o) over x of its times, of size and time 1; then: work
    space."""
    series, P, points, weights, short = shape
    o = len(phi)
    _damp(x, series, phi)
    if x < short:
        for a in range(o):
            for c in range(o):
                q[a, c] = 0.0
        for n in range(len(points)):
            _damp(points[n] * x, series, then)
            for a in range(o):
                for c in range(o):
                    q[a, c] += weights[n] * x * then[a, o - 1] * then[c, o - 1]
    else:
        for a in range(o):
            for c in range(o):
                left = 0.0
                for k in range(o):
                    for i in range(o):
                        left += phi[a, k] * P[k, i] * phi[c, i]
                q[a, c] = P[a, c] - left


@njit
def _damp(x: float, series: Array, out: Array) -> None:
    """Transition (o, o) of such a process over x of its times."""
    scale = math.exp(-x)
    for a in range(len(out)):
        for c in range(len(out)):
            total, power = 0.0, 1.0
            for i in range(len(out)):
                total += power * series[i, a, c]
                power *= x
            out[a, c] = total * scale


def _variance_of(part: Part, levels: Mapping[str, float], rate: Array) -> Array:
    more = levels[part.per_rate] * rate if part.per_rate else np.zeros_like(rate)
    return np.asarray(levels[part.size] ** 2 + more**2)


SWAY = Part("sway", "sway_per_rate", "sway_time", 2)
CREEP = Part("creep", "", "creep_time", 3)

OBSERVATION = Observation(
    kind="fixed_position",
    title="the held point stays in place",
    dim=3,
    channels=("position_x", "position_y", "position_z"),
    unit="m",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(
        Level("position_noise", "m", 3e-4, 2e-5, 0.05),
        Level("sway", "m", 0.004, 1e-4, 3.0),
        Level("sway_per_rate", "m/(rad/s)", 0.004, 1e-4, 1.0, shared="sway"),
        Level("sway_time", "s", 0.5, 0.05, 10.0),
    ),
    variance=_variance,
    markov=Sway(SWAY),
    isotropic=True,
    places=True,
    wandering=(3,),
    markov_residual=residual_function(_swayed),
)

# The same of somebody who moves: besides, the point drifts smoothly, by centimetres within many
# seconds where an arm tires, by half a metre where a chair turns. (Its acceleration is continuous:
# else what a swaying body lacks of the fast, white noise would be taken from what is slow.)
CREEPING = replace(
    OBSERVATION,
    levels=(
        *OBSERVATION.levels,
        Level("creep", "m", 0.05, 1e-3, 10.0),
        Level("creep_time", "s", 1.0, 0.2, 60.0),
    ),
    markov=Sway(SWAY, CREEP),
    wandering=(3, 9),
    markov_residual=residual_function(_crept),
)

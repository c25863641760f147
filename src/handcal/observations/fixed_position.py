"""The held point stays where it is, but for the sway of the hand.

Sway is a displacement of that point: a critically damped second-order Markov process
(position and velocity both continuous, as a hand's are), larger while turning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from handcal._jit import residual_function
from handcal.observations import Observation, Rows, Scene, pseudo_times
from handcal.types import Array, Level, Recording


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
    t = pseudo_times(recording, scene.rate)
    return Rows(t, np.zeros((len(t), 3)))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["position_noise"] ** 2)


class Sway:
    """States of each part: displacement (3,) m, then its velocity (3,) m/s.

    parts: for each the levels of its size at rest, of what it has in addition for each rad/s of
    turning ("": nothing), and of its time.
    """

    def __init__(self, *parts: tuple[str, str, str]) -> None:
        self.parts = parts
        self.size, self.vectors = 6 * len(parts), 2 * len(parts)

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Exact transition of x'' = -2 b x' - b^2 x + w; Q = P - Phi P Phi' (P stationary)."""
        Phi, Q = np.zeros((2, len(dt), self.size, self.size))
        for at, part in zip(range(0, self.size, 6), self.parts, strict=True):
            b = 1.0 / levels[part[2]]
            e = np.exp(-b * dt)
            phi = np.empty((len(dt), 2, 2))
            phi[:, 0, 0] = e * (1 + b * dt)
            phi[:, 0, 1] = e * dt
            phi[:, 1, 0] = -e * b * b * dt
            phi[:, 1, 1] = e * (1 - b * dt)
            P = np.array([1.0, b * b])
            q = np.empty((len(dt), 2, 2))
            q[:, 0, 0] = P[0] - phi[:, 0] ** 2 @ P
            q[:, 1, 1] = P[1] - phi[:, 1] ** 2 @ P
            q[:, 0, 1] = q[:, 1, 0] = -(phi[:, 0] * phi[:, 1]) @ P
            q *= _variance_of(part, levels, rate)[:, None, None]
            for k in range(at, at + 3):
                # (axes do not mix)
                Phi[:, k : at + 6 : 3, k : at + 6 : 3] = phi
                Q[:, k : at + 6 : 3, k : at + 6 : 3] = q
        return Phi, Q

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Stationary covariance at the turning rate of the start."""
        units = []
        for part in self.parts:
            b = 1.0 / levels[part[2]]
            units.append(np.repeat([1.0, b * b], 3) * _variance_of(part, levels, np.array([rate])))
        return np.diag(np.concatenate(units))


def _variance_of(part: tuple[str, str, str], levels: Mapping[str, float], rate: Array) -> Array:
    more = levels[part[1]] * rate if part[1] else np.zeros_like(rate)
    return np.asarray(levels[part[0]] ** 2 + more**2)


SWAY = ("sway", "sway_per_rate", "sway_time")
CREEP = ("creep", "", "creep_time")

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
        Level("sway_per_rate", "m/(rad/s)", 0.004, 1e-4, 1.0),
        Level("sway_time", "s", 0.5, 0.05, 10.0),
    ),
    variance=_variance,
    markov=Sway(SWAY),
    isotropic=True,
    places=True,
    wandering=3,
    markov_residual=residual_function(_swayed),
)

# The same of an arm that tires: the point drifts by centimetres within many seconds besides.
CREEPING = replace(
    OBSERVATION,
    levels=(
        *OBSERVATION.levels,
        Level("creep", "m", 0.02, 1e-3, 1.0),
        Level("creep_time", "s", 5.0, 2.0, 60.0),
    ),
    markov=Sway(SWAY, CREEP),
    markov_residual=residual_function(_crept),
)

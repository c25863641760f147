"""The held point stays where it is, but for the sway of the hand.

Sway is a displacement of that point: a critically damped second-order Markov process
(position and velocity both continuous, as a hand's are), larger while turning.
"""

from __future__ import annotations

from collections.abc import Mapping
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


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:  # noqa: ARG001
    for i in range(3):
        H[15 * i + i] = 1.0
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    t = pseudo_times(recording, scene.rate)
    return Rows(t, np.zeros((len(t), 3)))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["position_noise"] ** 2)


def _each_axis(block: Array) -> Array:
    """(n, 6, 6) of three axes that do not mix, from (n, 2, 2) of one (np.kron is slow here)."""
    out = np.zeros((len(block), 6, 6))
    for k in range(3):
        out[:, k::3, k::3] = block
    return out


class Sway:
    """States: displacement (3,) m, then its velocity (3,) m/s."""

    size = 6
    vectors = 2

    def transition(
        self, levels: Mapping[str, float], dt: Array, rate: Array
    ) -> tuple[Array, Array]:
        """Exact transition of x'' = -2 b x' - b^2 x + w; Q = P - Phi P Phi' (P stationary)."""
        b = 1.0 / levels["sway_time"]
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
        q *= self._variance(levels, rate)[:, None, None]
        return _each_axis(phi), _each_axis(q)

    def start(self, levels: Mapping[str, float], rate: float) -> Array:
        """Stationary covariance at the turning rate of the start."""
        b = 1.0 / levels["sway_time"]
        unit = np.kron(np.diag([1.0, b * b]), np.eye(3))
        return np.asarray(unit * self._variance(levels, np.array([rate])))

    @staticmethod
    def _variance(levels: Mapping[str, float], rate: Array) -> Array:
        return np.asarray(levels["sway"] ** 2 + (levels["sway_per_rate"] * rate) ** 2)


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
    markov=Sway(),
    isotropic=True,
    wandering=3,
    markov_residual=residual_function(_swayed),
)

"""What else measures a device: compass, magnetometer, thermometer, tracker, a trusted IMU.

SI units, angles in rad; everything defaults to perfect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from handcal_sim.profiles import Array


def _three() -> Array:
    return np.zeros(3)


def _matrix() -> Array:
    return np.zeros((3, 3))


@dataclass(frozen=True)
class Clocking:
    """When a slow sensor samples: k / rate + phase; rate 0 means together with the IMU."""

    rate_hz: float = 0.0
    phase_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Passing:
    """Iron that comes by: what a sensor reads in addition, at its peak (d,) at at_s, and how that
    comes and goes (standard deviation of a Gaussian shape), s."""

    at_s: float
    width_s: float
    peak: Array

    def __call__(self, t: Array) -> Array:
        """In addition at the instants t (n,): (n, d)."""
        addition: Array = np.exp(-0.5 * ((t[:, None] - self.at_s) / self.width_s) ** 2) * self.peak
        return addition


@dataclass(frozen=True, eq=False)
class Heading:
    """sigma: white noise, rad; passing: iron, by which angle (1,) it misleads, rad."""

    sigma: float = 0.0
    clocking: Clocking = Clocking()
    passing: Passing | None = None


@dataclass(frozen=True, eq=False)
class Magnetometer:
    """Tesla. The field: its strength, dip and declination (east of north), rad.

    soft_iron (3, 3): symmetric, what is above the diagonal counts; the field in body axes times it
    is read in addition. gradient (3, 3): how the field changes with place, tesla/m, in axes of the
    field (its horizontal part is y, z is up): symmetric and without trace, what is above the
    diagonal counts, and the last of the diagonal follows; step (3,): added from step_at_s on.
    passing: iron, what it adds to the field (3,) in navigation axes.
    """

    strength: float = 48e-6
    dip: float = math.radians(65.0)
    declination: float = 0.0
    hard_iron: Array = field(default_factory=_three)
    soft_iron: Array = field(default_factory=_matrix)
    gradient: Array = field(default_factory=_matrix)
    step: Array = field(default_factory=_three)
    step_at_s: float = 0.0
    sigma: float = 0.0
    clocking: Clocking = Clocking()
    passing: Passing | None = None


@dataclass(frozen=True)
class Thermometer:
    """degC: from `start` by `rise` with time constant tau_s, or through knots (s, degC), straight
    in between; sigma of one reading."""

    start: float = 25.0
    rise: float = 8.0
    tau_s: float = 25.0
    sigma: float = 0.0
    reported: bool = False
    knots: tuple[tuple[float, float], ...] = ()
    clocking: Clocking = Clocking(5.0)


@dataclass(frozen=True, eq=False)
class Pose:
    """Measured poses of a marker that sits at the reference point, on the true clock.

    C_wn (3, 3): navigation axes to the pose's world; C_bm: marker axes to the IMU's axes.
    scale: ways are longer by that share; position_walk (m/sqrt(s)), attitude_walk (rad/sqrt(s)):
    densities of the random walks by which the world wanders, from where it was at the start.
    by_way: position wanders with the way made, not with time, on average at that density.
    Tracking is lost at lost_at_s for lost_for_s: no poses; then it is off by `jump` (3,), m.
    """

    sigma_m: float = 0.0
    sigma_rad: float = 0.0
    delay_s: float = 0.0
    scale: float = 0.0
    position_walk: float = 0.0
    attitude_walk: float = 0.0
    by_way: bool = False
    lost_at_s: float = 0.0
    lost_for_s: float = 0.0
    jump: Array = field(default_factory=_three)
    C_wn: Array = field(default_factory=lambda: np.eye(3))
    C_bm: Array = field(default_factory=lambda: np.eye(3))
    clocking: Clocking = Clocking(100.0)


@dataclass(frozen=True, eq=False)
class Reference:
    """A trusted IMU at the reference point, on the true clock. C_br: its axes to the IMU's."""

    gyro_noise: float = 0.0
    accel_noise: float = 0.0
    C_br: Array = field(default_factory=lambda: np.eye(3))
    clocking: Clocking = Clocking(100.0)

"""What the IMU itself feels and reads: truth at a place on the body, then its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from handcal_sim.companions import Thermometer
from handcal_sim.motion import Motion, evaluate, into, out_of
from handcal_sim.phone import STANDARD_GRAVITY, Accel, Gyro, Phone
from handcal_sim.profiles import Array

EARTH_RATE = 7.292115e-5
_PAIRS = ([0, 1, 0], [1, 2, 2])


@dataclass(frozen=True)
class Earth:
    """gravity m/s^2 and Earth rate rad/s in navigation axes, the part that a user would assume.

    gravity_error and rate_error (north, up) come on top: what that user does not know.
    """

    gravity: float = STANDARD_GRAVITY
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity_error: float = 0.0
    rate_error: tuple[float, float] = (0.0, 0.0)

    @property
    def true_gravity(self) -> float:
        return self.gravity + self.gravity_error

    @property
    def true_rate(self) -> Array:
        rate: Array = np.array(self.rate) + np.array([0.0, *self.rate_error])
        return rate


ASSUMED = Earth()


def earth_at(latitude_rad: float, height_m: float = 0.0) -> Earth:
    """Normal gravity of WGS84 (Somigliana, second-order height formula) and the Earth's turning."""
    s2 = math.sin(latitude_rad) ** 2
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / math.sqrt(1.0 - 0.00669437999013 * s2)
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    h = height_m / a
    gravity = surface * (1.0 - 2.0 * (1.0 + f + m - 2.0 * f * s2) * h + 3.0 * h**2)
    rate = (0.0, EARTH_RATE * math.cos(latitude_rad), EARTH_RATE * math.sin(latitude_rad))
    return Earth(gravity, rate)


@dataclass(frozen=True)
class Truth:
    """At a place on the body: position, velocity (n, 3) in navigation axes, C_nb (n, 3, 3);
    omega_ib_b, its derivative alpha, specific force f_b (n, 3) in body axes."""

    position: Array
    velocity: Array
    C_nb: Array
    omega: Array
    alpha: Array
    f: Array


def truth_at(motion: Motion, earth: Earth, place_b: Array, t: Array) -> Truth:
    """Truth at the instants t for a point at place_b (3,) from the held point."""
    k = evaluate(motion, t)
    spin = earth.true_rate
    spin_b = into(k.C_nb, spin)
    omega = k.omega_nb_b + spin_b
    alpha = k.alpha_nb_b - np.cross(k.omega_nb_b, spin_b)
    pushed = k.acceleration + 2.0 * np.cross(spin, k.velocity)
    f = into(k.C_nb, pushed + np.array([0.0, 0.0, earth.true_gravity]))
    return Truth(
        k.position + out_of(k.C_nb, place_b),
        k.velocity + out_of(k.C_nb, np.cross(k.omega_nb_b, place_b)),
        k.C_nb, omega, alpha, f + rigid(omega, alpha, place_b),
    )  # fmt: skip


def rigid(omega: Array, alpha: Array, place_b: Array) -> Array:
    """Specific force at place_b beyond that at the origin: alpha x r + omega x (omega x r)."""
    force: Array = np.cross(alpha, place_b) + np.cross(omega, np.cross(omega, place_b))
    return force


def temperature(device: Thermometer, t: Array) -> Array:
    """degC (n,): the device warms up from the start on, or as the chamber does."""
    if device.knots:
        when, warm = np.array(device.knots).T
        return np.asarray(np.interp(t, when, warm))
    return device.start - device.rise * np.expm1(-np.maximum(t, 0.0) / device.tau_s)


def gyro_error(gyro: Gyro, at: Truth, warm: Array, t: Array) -> Array:
    """Systematic errors (n, 3); warm: K above 25 degC (n,); t: s since the start."""
    first, second = _PAIRS
    return (
        gyro.bias
        + at.omega @ gyro.response.T
        + at.f @ gyro.g_sensitivity.T
        + gyro.quadratic * at.omega**2
        + (at.omega[:, first] * at.omega[:, second]) @ gyro.cross_products.T
        + warm[:, None] * gyro.temperature
        + np.where(t[:, None] >= gyro.step_at_s, gyro.step, 0.0)
    )


def accel_error(accel: Accel, at: Truth, warm: Array) -> Array:
    """Systematic errors (n, 3) but for the delay; warm: K above 25 degC (n,)."""
    first, second = _PAIRS
    error = (
        accel.bias
        + at.f @ accel.response.T
        + accel.asymmetry * np.abs(at.f)
        + (at.f[:, first] * at.f[:, second]) @ accel.cross_products.T
        + warm[:, None] * accel.temperature
    )
    for axis, place in enumerate(accel.places):
        if np.any(place):
            error[:, axis] += rigid(at.omega, at.alpha, place)[:, axis]
    return error


def lagged_rate(motion: Motion, earth: Earth, lag_s: float, t: Array) -> Array:
    """True rate through a first-order low pass, at the instants t (n, 3).

    The rate is taken at 1 kHz and held to be linear between, which the filter then treats
    exactly, whatever its time constant.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import lfilter

    step = 1e-3
    before = min(20.0 * lag_s, 20.0)
    grid = np.arange(t[0] - before, t[-1] + 4.0 * step, step)
    rate = truth_at(motion, earth, np.zeros(3), grid).omega
    decay = math.exp(-step / lag_s)
    share = (1.0 - decay) * lag_s / step
    b = [1.0 - share, share - decay]
    state = (rate[0] - b[0] * rate[0])[None, :]
    smooth, _ = lfilter(b, [1.0, -decay], rate, axis=0, zi=state)
    result: Array = CubicSpline(grid, smooth)(t)
    return result


def random_walk(rng: np.random.Generator, density: float, t: Array) -> Array:
    """(n, 3), zero at the first instant."""
    steps = rng.standard_normal((len(t), 3)) * np.sqrt(np.diff(t, prepend=t[0]))[:, None]
    return density * np.cumsum(steps, axis=0)


def converted(reading: Array, quantum: float, full_scale: float) -> Array:
    """What the converter makes of it: saturated, rounded to its steps."""
    clipped = np.clip(reading, -full_scale, full_scale)
    return quantum * np.round(clipped / quantum) if quantum > 0.0 else clipped


@dataclass(frozen=True)
class ImuReadings:
    """gyro, accel (n, 3) as read; the walks of their biases (n, 3)."""

    gyro: Array
    accel: Array
    gyro_walk: Array
    accel_walk: Array


def read_imu(
    phone: Phone,
    motion: Motion,
    earth: Earth,
    t: Array,
    truth: Truth,
    rngs: dict[str, np.random.Generator],
) -> ImuReadings:
    """What the IMU reads at the instants t, where the truth at its place is `truth`."""
    gyro, accel = phone.gyro, phone.accel
    warm = temperature(phone.thermometer, t) - 25.0
    felt = truth
    if accel.delay_s != 0.0:
        felt = truth_at(motion, earth, phone.lever_arm, t - accel.delay_s)
    rate = lagged_rate(motion, earth, gyro.lag_s, t) if gyro.lag_s > 0.0 else truth.omega
    gyro_walk = random_walk(rngs["gyro_walk"], gyro.walk, t)
    accel_walk = random_walk(rngs["accel_walk"], accel.walk, t)
    root = math.sqrt(phone.rate_hz)
    hiss = rngs["gyro"].standard_normal(rate.shape), rngs["accel"].standard_normal(rate.shape)
    w = rate + gyro_error(gyro, truth, warm, t) + gyro_walk + gyro.noise * root * hiss[0]
    f = felt.f + accel_error(accel, felt, warm) + accel_walk + accel.noise * root * hiss[1]
    return ImuReadings(
        converted(w, gyro.quantum, gyro.full_scale),
        converted(f, accel.quantum, accel.full_scale),
        gyro_walk,
        accel_walk,
    )

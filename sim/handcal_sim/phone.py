"""A device: what is wrong with its sensors, in physical form.

A sensor reads truth plus error; the errors are those of true rate and specific force,
on the sensor's own axes. Everything defaults to perfect. SI units, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from handcal_sim.companions import Clocking, Heading, Magnetometer, Pose, Reference, Thermometer
from handcal_sim.errors import SimulationError, UnknownWord
from handcal_sim.profiles import Array

STANDARD_GRAVITY = 9.80665
DEG = math.radians(1.0)
DEG_PER_HOUR = DEG / 3600.0
MG = 1e-3 * STANDARD_GRAVITY


def _two() -> Array:
    return np.zeros(2)


def _three() -> Array:
    return np.zeros(3)


def _matrix() -> Array:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Gyro:
    """Errors of the gyro triad, rad/s unless said otherwise.

    response (3, 3): added per true rate (scale errors on the diagonal, misalignment off it);
    g_sensitivity (3, 3): per true specific force; quadratic (3,): per squared own rate;
    cross_products (3, 3): rows are axes, columns the products xy, yz, xz of rates;
    temperature (3,): per K above 25 degC; lag_s: time constant of a first-order low pass;
    walk: density of the bias's random walk, (rad/s)/sqrt(s), from 0 at the start;
    step (3,): jump of the bias at step_at_s; noise: white, (rad/s)/sqrt(Hz), so that one
    sample has noise * sqrt(rate); quantum and full_scale: of the converter, 0 and inf: none.
    """

    bias: Array = field(default_factory=_three)
    response: Array = field(default_factory=_matrix)
    g_sensitivity: Array = field(default_factory=_matrix)
    quadratic: Array = field(default_factory=_three)
    cross_products: Array = field(default_factory=_matrix)
    temperature: Array = field(default_factory=_three)
    lag_s: float = 0.0
    walk: float = 0.0
    step: Array = field(default_factory=_three)
    step_at_s: float = 0.0
    noise: float = 0.0
    quantum: float = 0.0
    full_scale: float = math.inf


@dataclass(frozen=True, eq=False)
class Accel:
    """Errors of the accelerometer triad, m/s^2; as for the gyro, and:

    asymmetry (3,): per magnitude of the own specific force; places (3, 3): row i is where
    accelerometer i sits, m in body axes from the IMU's place; delay_s: the reading at
    t belongs to t - delay.
    """

    bias: Array = field(default_factory=_three)
    response: Array = field(default_factory=_matrix)
    cross_products: Array = field(default_factory=_matrix)
    asymmetry: Array = field(default_factory=_three)
    places: Array = field(default_factory=_matrix)
    temperature: Array = field(default_factory=_three)
    delay_s: float = 0.0
    walk: float = 0.0
    noise: float = 0.0
    quantum: float = 0.0
    full_scale: float = math.inf


@dataclass(frozen=True, eq=False)
class HeadingErrors:
    """Errors of heading, rad: of the heading sensor, or of the magnetometer where that is all.

    hard_iron (2,): sin and cos of yaw (a magnetometer has its own instead); soft_iron (2,):
    sin and cos of 2 yaw; drift: rad/s since the start; correlated: rms of Gauss-Markov
    noise with time constant correlated_tau_s; outliers: share of uniform readings.
    """

    offset: float = 0.0
    hard_iron: Array = field(default_factory=_two)
    soft_iron: Array = field(default_factory=_two)
    delay_s: float = 0.0
    drift: float = 0.0
    correlated: float = 0.0
    correlated_tau_s: float = 1.0
    outliers: float = 0.0


@dataclass(frozen=True, eq=False)
class Phone:
    """A device and what else measures it; None: there is no such sensor.

    lever_arm (3,): place of the IMU in body axes, m, from the reference point, which is
    where the reference IMU or the marker sits and which the hand holds. interval_jitter_s:
    rms of irregular but rightly stamped instants; stamp_jitter_s: rms of wrong stamps.
    clock_ppm: the device's clock runs fast by that.
    """

    name: str = "perfect"
    rate_hz: float = 100.0
    gyro: Gyro = field(default_factory=Gyro)
    accel: Accel = field(default_factory=Accel)
    lever_arm: Array = field(default_factory=_three)
    interval_jitter_s: float = 0.0
    stamp_jitter_s: float = 0.0
    clock_ppm: float = 0.0
    heading: Heading | None = field(default_factory=Heading)
    heading_errors: HeadingErrors = field(default_factory=HeadingErrors)
    mag: Magnetometer | None = None
    thermometer: Thermometer = field(default_factory=Thermometer)
    pose: Pose | None = None
    reference: Reference | None = None


def perfect_phone() -> Phone:
    """Reads the truth, rounded to nothing but the stamps' nanoseconds."""
    return Phone()


def paper_phone() -> Phone:
    """The device of paper 002, tables 2 to 9, as far as it can be inferred from them."""
    gyro = Gyro(bias=np.array([1000.0, 1200.0, 1500.0]) * DEG_PER_HOUR, noise=0.01 * DEG)
    accel = Accel(
        bias=np.array([40.0, 50.0, 60.0]) * MG,
        response=np.diag([0.0, 0.0, -7750e-6]),
        noise=0.25 * MG,
    )
    return Phone("paper", gyro=gyro, accel=accel, heading=Heading(5.0 * DEG))


def consumer_phone(rng: np.random.Generator) -> Phone:
    """A phone as sold: biases, noise, converters and clocks, but none of the other effects."""
    gyro = Gyro(
        bias=rng.normal(0.0, 0.6 * DEG, 3),
        noise=float(rng.uniform(0.005, 0.015)) * DEG,
        quantum=2000.0 / 32768.0 * DEG,
        full_scale=2000.0 * DEG,
    )
    accel = Accel(
        bias=rng.normal(0.0, 0.3, 3),
        noise=float(rng.uniform(0.12, 0.35)) * MG,
        quantum=8000.0 / 32768.0 * MG,
        full_scale=8000.0 * MG,
    )
    return Phone(
        "consumer", gyro=gyro, accel=accel,
        interval_jitter_s=1e-4, stamp_jitter_s=2e-5,
        heading=Heading(5.0 * DEG, Clocking(50.0, float(rng.uniform(0.0, 0.02)))),
        heading_errors=HeadingErrors(offset=float(rng.normal(0.0, 6.0 * DEG))),
        thermometer=Thermometer(
            float(rng.uniform(20.0, 30.0)), float(rng.uniform(6.0, 12.0)),
            float(rng.uniform(15.0, 40.0)), sigma=0.03,
        ),
    )  # fmt: skip


def consumer_magnetometer(rng: np.random.Generator) -> Magnetometer:
    """The field somewhere in middle latitudes; a magnetometer whose hard iron is calibrated."""
    strength, dip = rng.uniform([44e-6, 55.0 * DEG], [52e-6, 70.0 * DEG])
    return Magnetometer(
        float(strength), float(dip), float(rng.normal(0.0, 3.0 * DEG)), sigma=0.4e-6,
        clocking=Clocking(50.0, float(rng.uniform(0.0, 0.02))),
    )  # fmt: skip


def capture_pose(rng: np.random.Generator) -> Pose:
    """Motion capture: any yaw of its world, a degree of tilt, a marker stuck on by eye."""
    return Pose(
        0.5e-3, 0.15 * DEG,
        C_wn=_near(rng, [1.0 * DEG, 1.0 * DEG, math.pi]), C_bm=_near(rng, [2.0 * DEG] * 3),
        clocking=Clocking(100.0, float(rng.uniform(0.0, 0.01))),
    )  # fmt: skip


def trusted_reference(rng: np.random.Generator) -> Reference:
    """A second IMU without systematic errors, mounted by eye."""
    return Reference(0.003 * DEG, 0.06 * MG, _near(rng, [2.0 * DEG] * 3))


def _near(rng: np.random.Generator, sigmas: list[float]) -> Array:
    """A rotation with random x, y, z angles of these rms."""
    from handcal_sim.motion import euler_matrix

    return euler_matrix(*(np.asarray(x) for x in rng.normal(0.0, sigmas)))


DEVICES = ("consumer", "paper", "perfect")


def make_phone(name: str, rng: np.random.Generator) -> Phone:
    """The device of that name; the random ones draw from rng."""
    if name == "consumer":
        return consumer_phone(rng)
    if name == "paper":
        return paper_phone()
    if name == "perfect":
        return perfect_phone()
    raise UnknownWord("device", name, DEVICES)


def with_rate(phone: Phone, rate_hz: float) -> Phone:
    """The same device, its IMU sampling at this rate."""
    if not 10.0 <= rate_hz <= 2000.0:
        raise SimulationError(f"a rate of {rate_hz:g} Hz is not between 10 and 2000 Hz")
    return replace(phone, rate_hz=rate_hz)

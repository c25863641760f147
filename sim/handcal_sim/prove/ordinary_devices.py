"""Ordinary devices of three classes: every error that a data sheet states, each from a density.

The spreads are the author's reading of data sheets and of published calibrations, one standard
deviation of each parameter over devices of a class. What a data sheet calls typical is taken for
one, what it calls a tolerance or a limit for two to three standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim.companions import Clocking, Heading
from handcal_sim.effects import EFFECTS
from handcal_sim.phone import (
    DEG,
    MG,
    Accel,
    Gyro,
    HeadingErrors,
    Phone,
    capture_pose,
    consumer_magnetometer,
)
from handcal_sim.profiles import Array
from handcal_sim.prove.given import log_uniform

PHONE, HOBBY, INDUSTRIAL = "phone", "hobby board", "industrial"
KINDS = (PHONE, HOBBY, INDUSTRIAL)
# Biases and how each goes with the temperature.
SLOPES = {"gyro_bias": "gyro_temperature", "accel_bias": "accel_temperature"}
_G = 9.80665

# By effect: phone (BMI160, BMI270, LSM6DSO, ICM-42688, as calibrated in the factory of the phone),
# hobby board (MPU-6050, MPU-9150, MPU-9250, ICM-20948 on a breakout), industrial (ADIS16448,
# ADIS16470, Xsens MTi, each calibrated by its maker).
SPREADS: dict[str, tuple[float, float, float]] = {
    # Data sheets, zero-rate offset: LSM6DSO 1, BMI160 3, ICM-20948 and MPU-9250 5, MPU-6050 20
    # deg/s at the most; ADIS16470 and MTi 0.2 deg/s.
    "gyro_bias": (0.5 * DEG, 1.5 * DEG, 0.12 * DEG),
    # Data sheets, zero-g offset: BMI270 20, BMI160 and LSM6DS 40, MPU 50 to 80, ADIS16448 20, MTi
    # 2 to 5 mg.
    "accel_bias": (20.0 * MG, 35.0 * MG, 4.0 * MG),
    # Data sheets, sensitivity tolerance: ICM-42688 0.5, LSM6DSO 1, BMI270 2, BMI160 and MPU 3 %;
    # MTi 0.05 to 0.1, ADIS16448 1 % at the most. Published calibrations of MPU find 0.3 to 1.5 %.
    "gyro_scale": (0.006, 0.010, 0.0015),
    # Data sheets: BMI270 0.4, ICM-42688 0.5, LSM6DS and BMI160 1, MPU 3 %; MTi 0.05, ADIS 0.3 %.
    # Published calibrations (six positions, IMU-TK) find 0.3 to 1.5 % for MPU and LSM.
    "accel_scale": (0.005, 0.010, 0.0010),
    # Data sheets, cross-axis sensitivity: ICM-42688 1.25, BMI160 and MPU 2 % at the most; ADIS16448
    # and ADIS16470 0.05 deg axis to axis, MTi 0.05 deg. Published calibrations find 0.3 to 0.8 deg.
    "gyro_misalignment": (0.006, 0.008, 0.0012),
    "accel_misalignment": (0.005, 0.008, 0.0010),
    # Data sheets, (deg/s)/g: MPU-6050 and BMI160 0.1 typical; ADIS16448 0.015, ADIS16470 0.009.
    "gyro_g_sensitivity": (0.08 * DEG / _G, 0.10 * DEG / _G, 0.012 * DEG / _G),
    # Data sheets, (deg/s)/K: ICM-42688 0.005, LSM6DSO 0.01, BMI270 0.02, BMI160 and ICM-20948 0.05,
    # MPU 0.16 to 0.24 from the span over temperature; ADIS16448 0.005, ADIS16470 0.002.
    "gyro_temperature": (0.015 * DEG, 0.03 * DEG, 0.003 * DEG),
    # Data sheets, mg/K: LSM6DS 0.1, ICM-42688 0.15, BMI270 0.25, MPU 0.5 to 1.5, BMI160 1; ADIS and
    # MTi 0.03 to 0.15.
    "accel_temperature": (0.3 * MG, 0.7 * MG, 0.06 * MG),
    # How people hold things: the middle of a turn lies within a palm's breadth of the sensor; a
    # hobby board is smaller, an industrial IMU sits on a plate or a tool.
    "lever_arm": (0.05, 0.04, 0.08),
    # Group delays of digital filters in data sheets (MPU: 1.9 to 20 ms, nearly alike for both
    # sensors); published calibrations of phones find some ms between the two.
    "accel_delay": (0.003, 0.004, 0.0005),
    # Published comparisons of fused compass headings and of magnetometers at 10 to 100 Hz with
    # gyros: tens of ms.
    "heading_delay": (0.04, 0.04, 0.01),
    # Published calibrations of VIO and of motion capture against an IMU (Kalibr, VINS): 1 to 30 ms.
    "pose_delay": (0.010, 0.012, 0.004),
    # Errors of heading that are left after a figure of eight: 3 to 5 deg in phones, 1 deg in MTi
    # (data sheet).
    "heading_hard_iron": (0.06, 0.08, 0.02),
    "heading_soft_iron": (0.03, 0.04, 0.01),
    # Published calibrations of raw magnetometers (AK8963, AK8975, HMC5883L, BMM150).
    "mag_hard_iron": (35e-6, 30e-6, 5e-6),
    "mag_soft_iron": (0.04, 0.05, 0.01),
}  # fmt: skip
# Tails are those of normal densities but for what ages and is shocked on its way to the user:
# Student's t with so many degrees of freedom, of the same standard deviation.
TAILS = {"gyro_bias": 8.0, "accel_bias": 8.0, "mag_hard_iron": 8.0}
# The streams that errors are of; all others are of the IMU itself.
OF_STREAM: Mapping[str, frozenset[str]] = {
    "heading_delay": frozenset({"heading", "mag"}),
    "pose_delay": frozenset({"pose"}),
    "heading_hard_iron": frozenset({"heading"}),
    "heading_soft_iron": frozenset({"heading"}),
    "mag_hard_iron": frozenset({"mag"}),
    "mag_soft_iron": frozenset({"mag"}),
}
COMMON = tuple(name for name in SPREADS if name not in SLOPES)
# Least and largest white noise, (deg/s)/sqrt(Hz) and mg/sqrt(Hz) (data sheets), and steps of the
# converters, deg/s and mg.
NOISE = {PHONE: ((0.004, 0.012), (0.10, 0.25)), HOBBY: ((0.005, 0.02), (0.2, 0.5)),
         INDUSTRIAL: ((0.003, 0.014), (0.06, 0.23))}  # fmt: skip
STEPS = {PHONE: (0.061, 0.244), HOBBY: (0.061, 0.244), INDUSTRIAL: (0.01, 0.1)}


@dataclass(frozen=True)
class Device:
    """kind: its class; phone: the sensors without their errors; effects: those that every device
    has and that show in its streams, biases at 25 degC, in the order of each one's parameters."""

    kind: str
    phone: Phone
    effects: Mapping[str, list[float]]


def spread(kind: str, effect: str) -> float:
    """Standard deviation of each parameter of an effect over the devices of a class, SI."""
    return SPREADS[effect][KINDS.index(kind)]


def shows(effect: str, streams: frozenset[str]) -> bool:
    """Whether an error is of the IMU itself or of a stream that is there."""
    return effect not in OF_STREAM or bool(OF_STREAM[effect] & streams)


def device(kind: str, streams: frozenset[str], rng: np.random.Generator) -> Device:
    """A device of a class with these streams beside its IMU: heading, mag, pose."""
    values = {name: _values(kind, name, rng) for name in SPREADS}
    effects = {name: v.tolist() for name, v in values.items() if shows(name, streams)}
    return Device(kind, _sensors(kind, streams, rng), effects)


def _values(kind: str, name: str, rng: np.random.Generator) -> Array:
    count, size = len(EFFECTS[name]), spread(kind, name)
    if name in TAILS:
        dof = TAILS[name]
        return np.asarray(size * math.sqrt((dof - 2.0) / dof) * rng.standard_t(dof, count))
    values = size * rng.standard_normal(count)
    if name == "mag_soft_iron":
        # A mean of the diagonal is a stronger field, which no magnetometer can tell.
        values[:3] = math.sqrt(1.5) * (values[:3] - values[:3].mean())
    return np.asarray(values)


def _sensors(kind: str, streams: frozenset[str], rng: np.random.Generator) -> Phone:
    (gyro, accel), (fine, coarse) = NOISE[kind], STEPS[kind]
    heading, mag, pose = (
        Heading(log_uniform(rng, 1.0, 5.0) * DEG, _clocking(rng)),
        replace(consumer_magnetometer(rng), clocking=_clocking(rng)),
        replace(capture_pose(rng), clocking=Clocking(30.0, float(rng.uniform(0.0, 0.03)))),
    )
    return Phone(
        kind, round(log_uniform(rng, 50.0, 200.0)),
        Gyro(noise=log_uniform(rng, *gyro) * DEG, quantum=fine * DEG, full_scale=2000.0 * DEG),
        Accel(noise=log_uniform(rng, *accel) * MG, quantum=coarse * MG, full_scale=8000.0 * MG),
        interval_jitter_s=1e-4, stamp_jitter_s=2e-5,
        heading=heading if "heading" in streams else None,
        mag=mag if "mag" in streams else None,
        pose=pose if "pose" in streams else None,
        heading_errors=HeadingErrors(offset=float(rng.normal(0.0, 6.0 * DEG))),
    )  # fmt: skip


def _clocking(rng: np.random.Generator) -> Clocking:
    rate = round(log_uniform(rng, 10.0, 100.0))
    return Clocking(float(rate), float(rng.random()) / rate)

"""A small world of rests and turns, on a table or in a hand, for tests of where a device rests.

A list of stages: ``Table(s)``, ``Held(s, tremor, sway)``, ``Turn(s, angle)``. Rates are integrated
exactly from sample to sample, gravity is carried along, and what a sensor adds comes last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handcal.types import Imu, Recording

G = 9.80665


@dataclass(frozen=True)
class Table:
    """Nothing moves for so many seconds."""

    seconds: float


@dataclass(frozen=True)
class Held:
    """tremor_deg: rms rate on each axis at 8 to 12 Hz, deg/s; shake: rms force on each axis there,
    m/s^2; sway_deg: rms angle on each axis at 0.2 to 0.8 Hz."""

    seconds: float
    tremor_deg: float = 0.3
    shake: float = 0.1
    sway_deg: float = 0.3


@dataclass(frozen=True)
class Turn:
    """A smooth turn by angle (3,), deg, in body axes, jostled by ``jolt`` m/s^2."""

    seconds: float
    angle_deg: tuple[float, float, float]
    jolt: float = 0.5


@dataclass(frozen=True)
class Sensor:
    """White noise of a sample, converter's steps, and the gyro's offset."""

    gyro: float = 2e-3
    accel: float = 0.02
    gyro_step: float = 0.0
    accel_step: float = 0.0
    offset: tuple[float, float, float] = (0.01, -0.006, 0.008)


def band(rng, t, low, high, lines=12):
    """Noise (n, 3) of unit variance between two frequencies, Hz."""
    f = rng.uniform(low, high, (lines, 3))
    phase = rng.uniform(0.0, 2.0 * math.pi, (lines, 3))
    return np.sqrt(2.0 / lines) * np.sin(2.0 * math.pi * f * t[:, None, None] + phase).sum(axis=1)


def _moves(stage, t, rng):
    """Rate (n, 3) rad/s and force beyond gravity (n, 3) m/s^2 at times t into a stage, s."""
    n, s = len(t), stage.seconds
    if isinstance(stage, Table):
        return np.zeros((n, 3)), np.zeros((n, 3))
    if isinstance(stage, Held):
        tremor, shake = (band(rng, t, 8.0, 12.0) for _ in range(2))
        f = rng.uniform(0.2, 0.8, (12, 3))
        phase = rng.uniform(0.0, 2.0 * math.pi, (12, 3))
        w = 2.0 * math.pi * f
        swaying = (w * np.cos(w * t[:, None, None] + phase)).sum(axis=1) * math.sqrt(2.0 / 12.0)
        rate = np.radians(stage.tremor_deg) * tremor + np.radians(stage.sway_deg) * swaying
        return rate, stage.shake * shake
    ramp = math.pi / (2.0 * s) * np.sin(math.pi * t / s)
    jolt = stage.jolt * np.sin(math.pi * t / s)[:, None] * band(rng, t, 2.0, 15.0)
    return ramp[:, None] * np.radians(stage.angle_deg), jolt


def record(stages, seed=0, rate_hz=100.0, sensor=None):
    """The recording of these stages, and their spans (k, 2), s."""
    sensor, rng = sensor or Sensor(), np.random.default_rng(seed)
    edges = np.concatenate([[0.0], np.cumsum([s.seconds for s in stages])])
    t = np.arange(int(edges[-1] * rate_hz)) / rate_hz
    rate, push = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for stage, a, b in zip(stages, edges[:-1], edges[1:], strict=True):
        own = (t >= a) & (t < b)
        rate[own], push[own] = _moves(stage, t[own] - a, rng)
    force, C = np.empty((len(t), 3)), Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    for i, step in enumerate(Rotation.from_rotvec(rate / rate_hz).as_matrix()):
        force[i] = G * C[2]
        C = C @ step
    gyro = rate + sensor.offset + sensor.gyro * rng.standard_normal(rate.shape)
    accel = force + push + sensor.accel * rng.standard_normal(rate.shape)
    gyro, accel = _steps(gyro, sensor.gyro_step), _steps(accel, sensor.accel_step)
    spans = np.stack([edges[:-1], edges[1:]], axis=1)
    return Recording("stages", Imu(t, gyro, accel, np.ones(len(t), dtype=bool))), spans


def _steps(x, step):
    return np.round(x / step) * step if step else x


def turns(n, seed=0, seconds=1.5):
    """n turns of 60 to 150 deg about axes of all directions."""
    rng = np.random.default_rng(1000 + seed)
    u = rng.standard_normal((n, 3))
    u *= (rng.uniform(60.0, 150.0, n) / np.linalg.norm(u, axis=1))[:, None]
    return [Turn(seconds, tuple(float(x) for x in v)) for v in u]


def alternating(rests, between):
    """rest, turn, rest, ... rest."""
    out = [rests[0]]
    for turn, rest in zip(between, rests[1:], strict=True):
        out += [turn, rest]
    return out

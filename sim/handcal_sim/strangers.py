"""Physics that no catalogue names: what an unexpected device might add to its readings.

Each kind is a function of what was true (a `Scene`) and a generator. It returns the error of
one channel over time in a natural shape, and the formula in measured signals by which it
might be described: omega_x rad/s, f_x m/s^2, T degC, t s, heading rad. `estrange` scales the
error until it is plainly visible and adds it to a world's readings.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal_sim import sensors
from handcal_sim.aiding import wrapped
from handcal_sim.companions import Thermometer
from handcal_sim.phone import STANDARD_GRAVITY
from handcal_sim.profiles import Array
from handcal_sim.scenario import Stream, World

AXES = "xyz"
# Root mean squares that hundreds of standard readings show: a per cent of a turn or of gravity.
_RMS = {"gyro": 0.02, "accel": 0.15, "heading": 0.15}


@dataclass(frozen=True)
class Scene:
    """What was true at the instants t (n,): omega rad/s, alpha rad/s^2, f m/s^2 (n, 3),
    temperature above 25 degC (n,), heading rad (n,); up, north (n, 3): what points there, in body
    axes; at_heading: the same at the instants of the heading sensor, or None."""

    t: Array
    omega: Array
    alpha: Array
    f: Array
    warm: Array
    heading: Array
    up: Array
    north: Array
    at_heading: Scene | None = None

    @property
    def jerk(self) -> Array:
        """How fast the force changes (n, 3), m/s^3."""
        return np.asarray(np.gradient(self.f, self.t, axis=0))


@dataclass(frozen=True)
class Strange:
    """An error (n,) of a channel such as gyro_x; signals: what a formula for it must contain."""

    channel: str
    error: Array
    formula: str
    signals: tuple[str, ...]


Kind = Callable[[Scene, np.random.Generator], Strange]


def estrange(kind: str, world: World, rng: np.random.Generator) -> tuple[World, Strange]:
    """The world with this error in its readings, and the error as it was added."""
    strange = KINDS[kind](scene_of(world), rng)
    size = _size(kind, strange) * rng.uniform(0.7, 1.5)
    return _scaled(world, strange, size, _rms_of(strange))


def of_one_device(kind: str, worlds: Sequence[World], seed: int) -> list[tuple[World, Strange]]:
    """Several worlds with one law, as large in all as it has to be to show in the first."""
    found = [KINDS[kind](scene_of(world), np.random.default_rng(seed)) for world in worlds]
    size, rms = _size(kind, found[0]), _rms_of(found[0])
    return [_scaled(world, one, size, rms) for world, one in zip(worlds, found, strict=True)]


def _size(kind: str, strange: Strange) -> float:
    """Root mean square at which a kind of error shows."""
    return _RMS[strange.channel.split("_")[0]] * _LARGER.get(kind, 1.0)


def _rms_of(strange: Strange) -> float:
    return math.sqrt(float(np.mean(strange.error**2)))


def _scaled(world: World, strange: Strange, size: float, of: float) -> tuple[World, Strange]:
    error = strange.error * size / of
    return with_error(world, strange.channel, error), dataclasses.replace(strange, error=error)


def with_error(world: World, channel: str, error: Array) -> World:
    """The world with this error (n,) in the readings of a channel such as gyro_x or heading."""
    if channel == "heading":
        stream = world.streams["heading"]
        read = Stream(stream.stamps, wrapped(stream.values + error[:, None]))
        return dataclasses.replace(world, streams={**world.streams, "heading": read})
    values = world.imu.values.copy()
    values[:, column_of(channel)] += error
    return dataclasses.replace(world, imu=Stream(world.imu.stamps, values))


def column_of(channel: str) -> int:
    """The place of an IMU's channel such as accel_y among its readings."""
    sensor, axis = channel.split("_")
    return AXES.index(axis) + (3 if sensor == "accel" else 0)


def scene_of(world: World) -> Scene:
    """What was true at the IMU's instants and at those of heading."""
    fast = 1.0 + 1e-6 * world.parameters["phone"]["clock_ppm"]
    warm = {k: v for k, v in world.parameters["phone"]["thermometer"].items() if k != "clocking"}
    thermometer = Thermometer(**warm)
    heading = world.streams.get("heading")
    beside = None if heading is None else _scene(world, thermometer, heading.stamps / fast)
    return dataclasses.replace(_scene(world, thermometer, world.t), at_heading=beside)


def _scene(world: World, thermometer: Thermometer, t: Array) -> Scene:
    def at(values: Array) -> Array:
        columns = [np.interp(t, world.t, column) for column in values.T]
        return np.stack(columns, axis=1)

    true = world.truth
    x, north, up = (at(rows) for rows in (true.C_nb[:, :2, 0], true.C_nb[:, 1], true.C_nb[:, 2]))
    warm = sensors.temperature(thermometer, t) - 25.0
    heading: Array = np.arctan2(x[:, 1], x[:, 0])
    return Scene(t, at(true.omega), at(true.alpha), at(true.f), warm, heading, up, north)


def _one(rng: np.random.Generator) -> tuple[int, str]:
    i = int(rng.integers(3))
    return i, AXES[i]


def _two(rng: np.random.Generator) -> tuple[tuple[int, str], tuple[int, str]]:
    """Two different axes."""
    i, j = (int(axis) for axis in rng.choice(3, 2, replace=False))
    return (i, AXES[i]), (j, AXES[j])


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _term(channel: str, error: Array, signals: str) -> Strange:
    """An error that is a product of measured signals, separated by spaces."""
    words = signals.split()
    return Strange(channel, error, f"{channel} += k * {' * '.join(words)}", tuple(set(words)))


def _other(channel: str, error: Array, formula: str, *signals: str) -> Strange:
    return Strange(channel, error, f"{channel} += {formula}", signals)


def accel_rate_temperature(s: Scene, rng: np.random.Generator) -> Strange:
    """The accelerometer feels turning, the more the warmer it is."""
    (_, x), (j, y) = _two(rng)
    error = _sign(rng) * s.omega[:, j] * s.warm
    return _other(f"accel_{x}", error, f"k * omega_{y} * (T - 25)", f"omega_{y}", "T")


def accel_scale_temperature(s: Scene, rng: np.random.Generator) -> Strange:
    """The accelerometer's scale changes with temperature."""
    i, x = _one(rng)
    error = _sign(rng) * s.f[:, i] * s.warm
    return _other(f"accel_{x}", error, f"k * f_{x} * (T - 25)", f"f_{x}", "T")


def accel_rate(s: Scene, rng: np.random.Generator) -> Strange:
    """The accelerometer feels the rate itself."""
    (_, x), (j, y) = _two(rng)
    return _term(f"accel_{x}", _sign(rng) * s.omega[:, j], f"omega_{y}")


def accel_quadratic(s: Scene, rng: np.random.Generator) -> Strange:
    """The accelerometer bends with the square of its own force."""
    i, x = _one(rng)
    return _term(f"accel_{x}", _sign(rng) * s.f[:, i] ** 2, f"f_{x} f_{x}")


def accel_hysteresis(s: Scene, rng: np.random.Generator) -> Strange:
    """Backlash: the reading follows only once the force has moved by half the play."""
    i, x = _one(rng)
    half = rng.uniform(0.2, 0.4)
    read, follow = float(s.f[0, i]), np.empty(len(s.t))
    for k, f in enumerate(s.f[:, i].tolist()):
        follow[k] = read = min(max(read, f - half), f + half)
    return _other(f"accel_{x}", follow - s.f[:, i], f"play({half:.2f} m/s^2) of f_{x} - f_{x}")


def accel_warm_up(s: Scene, rng: np.random.Generator) -> Strange:
    """After switching on, the bias settles within seconds."""
    _, x = _one(rng)
    tau = rng.uniform(5.0, 12.0)
    error = _sign(rng) * np.exp(-s.t / tau)
    return _other(f"accel_{x}", error, f"k * exp(-t / {tau:.1f} s)", "t")


def gyro_cubic(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro bends with the cube of its rate."""
    i, x = _one(rng)
    return _term(f"gyro_{x}", _sign(rng) * s.omega[:, i] ** 3, f"omega_{x} omega_{x} omega_{x}")


def gyro_compression(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro gives way towards its full scale."""
    i, x = _one(rng)
    full = rng.uniform(2.0, 3.5)
    error = full * np.tanh(s.omega[:, i] / full) - s.omega[:, i]
    formula = f"k * ({full:.1f} tanh(omega_{x} / {full:.1f}) - omega_{x})"
    return _other(f"gyro_{x}", error, formula, f"omega_{x}")


def gyro_rectification(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro's scale differs between one sense of turning and the other."""
    i, x = _one(rng)
    error = _sign(rng) * np.abs(s.omega[:, i])
    return _other(f"gyro_{x}", error, f"k * |omega_{x}|", f"omega_{x}")


def gyro_scale_drift(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro's scale changes while time goes by."""
    i, x = _one(rng)
    return _term(f"gyro_{x}", _sign(rng) * s.omega[:, i] * s.t, f"omega_{x} t")


def gyro_bias_oscillation(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro's bias swings with a period of 10 to 40 s."""
    _, x = _one(rng)
    period, phase = rng.uniform(10.0, 40.0), rng.uniform(0.0, 2.0 * math.pi)
    error = np.sin(2.0 * math.pi * s.t / period + phase)
    return _other(f"gyro_{x}", error, f"k * sin(2 pi t / {period:.1f} s + {phase:.2f})", "t")


def gyro_acceleration(s: Scene, rng: np.random.Generator) -> Strange:
    """One gyro feels angular acceleration about another axis."""
    (_, x), (j, y) = _two(rng)
    return _term(f"gyro_{x}", _sign(rng) * s.alpha[:, j], f"alpha_{y}")


def gyro_rate_force(s: Scene, rng: np.random.Generator) -> Strange:
    """The gyro's scale depends on the force that acts on it."""
    (i, x), (j, y) = _two(rng)
    return _term(f"gyro_{x}", _sign(rng) * s.omega[:, i] * s.f[:, j], f"omega_{x} f_{y}")


def _headings(s: Scene) -> Scene:
    assert s.at_heading is not None
    return s.at_heading


def heading_tilt(s: Scene, rng: np.random.Generator) -> Strange:
    """Heading goes wrong with the tilt of the device."""
    at = _headings(s)
    j, y = (1, "y") if rng.random() < 0.5 else (0, "x")
    return _term("heading", _sign(rng) * at.f[:, j] / STANDARD_GRAVITY, f"f_{y}")


def heading_third_harmonic(s: Scene, rng: np.random.Generator) -> Strange:
    """An error of three periods a turn."""
    phase = rng.uniform(0.0, 2.0 * math.pi)
    error = np.sin(3.0 * _headings(s).heading + phase)
    return _other("heading", error, f"k * sin(3 heading + {phase:.2f})", "heading")


def heading_direction(s: Scene, rng: np.random.Generator) -> Strange:
    """Iron that is felt in one narrow direction only."""
    where = rng.uniform(-math.pi, math.pi)
    error = _sign(rng) * np.exp(6.0 * (np.cos(_headings(s).heading - where) - 1.0))
    return _other("heading", error, f"k * exp(6 cos(heading - {where:.2f}) - 6)", "heading")


def heading_disturbance(s: Scene, rng: np.random.Generator) -> Strange:
    """Something magnetic passes by within seconds."""
    at = _headings(s)
    when, width = rng.uniform(0.25, 0.75) * at.t[-1], rng.uniform(2.0, 5.0)
    error = _sign(rng) * np.exp(-0.5 * ((at.t - when) / width) ** 2)
    formula = f"k * exp(-((t - {when:.0f} s) / {width:.1f} s)^2 / 2)"
    return _other("heading", error, formula, "t")


KINDS: dict[str, Kind] = {
    kind.__name__: kind
    for kind in (
        accel_rate_temperature, accel_scale_temperature, accel_rate, accel_quadratic,
        accel_hysteresis, accel_warm_up, gyro_cubic, gyro_compression, gyro_rectification,
        gyro_scale_drift, gyro_bias_oscillation, gyro_acceleration, gyro_rate_force,
        heading_tilt, heading_third_harmonic, heading_direction, heading_disturbance,
    )
}  # fmt: skip
# Kinds whose nearest catalogue effect takes most of the error: what is left must show too.
_LARGER = {
    "accel_quadratic": 3.0, "accel_scale_temperature": 3.0, "gyro_rectification": 2.0,
    "gyro_cubic": 2.0, "gyro_compression": 2.0, "heading_disturbance": 1.5,
}  # fmt: skip
NEEDS_TEMPERATURE = frozenset({"accel_rate_temperature", "accel_scale_temperature"})


def said_of(strange: Strange) -> dict[str, Any]:
    """For the answers: what was added, in words and size."""
    return {"channel": strange.channel, "formula": strange.formula, "rms": _rms_of(strange),
            "signals": sorted(strange.signals)}  # fmt: skip

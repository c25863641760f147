"""Hand motions that one might make next, as recordings without noise.

Each motion is a chain of smooth turns (minimum jerk) of a device whose IMU stays in place,
beginning level, screen up, body x to the east. What such a recording would tell is asked of
the information matrix (``explain.next_motion``), never of a table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.recordings.streams import STREAMS
from handcal.types import Array, Imu, Recording, Series

IMU_RATE = STREAMS["imu"].planned_hz
ROOM_TEMPERATURE = 25.0
# Horizontal and upward, tesla, in middle latitudes of the north.
EARTH_FIELD = (2e-5, -4.5e-5)
REST = 2.0

Turn = tuple[tuple[float, float, float], float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Motion:
    """What to do, as a sentence, and the turns it is: each an axis of the body, an angle
    (deg; 0: a rest) and how long it takes, s. warming: K, evenly over the whole."""

    sentence: str
    turns: tuple[Turn, ...]
    warming: float = 0.0

    @property
    def duration_s(self) -> float:
        return sum(seconds for _, _, seconds in self.turns)


def _rested(*turns: Turn) -> tuple[Turn, ...]:
    """A rest before the first turn and after the last."""
    return ((Z, 0.0, REST), *turns, (Z, 0.0, REST))


def _each_way(seconds: float, back: float, *axes: tuple[float, float, float]) -> tuple[Turn, ...]:
    pairs = [((a, 360.0, seconds), (a, -360.0, back)) for a in axes]
    return _rested(*(turn for pair in pairs for turn in pair))


def _tumbling() -> tuple[Turn, ...]:
    axes = [(1, 1, 0), (0, 1, 1), (1, 0, 1), (1, -1, 0), (0, 1, -1), (1, 0, -1)]
    turns = [((x, y, z), 150.0, 2.5) for x, y, z in axes]
    return _rested(*turns, *((a, 130.0, s) for a, _, s in reversed(turns)))


def _shaking() -> tuple[Turn, ...]:
    turns: list[Turn] = []
    for axis in (X, Y, Z, (1.0, 1.0, 0.0), (0.0, 1.0, 1.0), (1.0, 0.0, 1.0)):
        turns += [(axis, 30.0, 0.3), *[(axis, s * 60.0, 0.5) for s in (-1, 1) * 3]]
        turns += [(axis, -30.0, 0.3)]
    return _rested(*turns)


def _faces(rest: float) -> tuple[Turn, ...]:
    """Screen up, on one end, screen down, on the other end, on either side; short turns between."""
    turns: list[Turn] = [(Z, 0.0, rest)]
    for axis, angle in ((X, 90.0), (X, 90.0), (X, 90.0), (Z, 90.0), (Z, 180.0)):
        turns += [(axis, angle, 1.5 * angle / 90.0), (Z, 0.0, rest)]
    return tuple(turns)


MOTIONS = (
    Motion(
        "Hold it screen up and turn it once about the vertical and back, ten seconds each way.",
        _each_way(10.0, 10.0, Z),
    ),
    Motion(
        "Begin with the screen up and turn it once about its x axis (to the right) and back, "
        "ten seconds each way.",
        _each_way(10.0, 10.0, X),
    ),
    Motion(
        "Begin with the screen up and turn it once about its y axis (to the top) and back, "
        "ten seconds each way.",
        _each_way(10.0, 10.0, Y),
    ),
    Motion(
        "Turn it once about each of its axes z, x and y and back, five seconds each way.",
        _each_way(5.0, 5.0, Z, X, Y),
    ),
    Motion(
        "Turn it once about each of its axes z, x and y, eight seconds there and three back.",
        _each_way(8.0, 3.0, Z, X, Y),
    ),
    Motion("Tumble it slowly through all attitudes for 30 seconds.", _tumbling()),
    Motion("Let it rest on each of its six faces for three seconds.", _faces(3.0)),
    Motion("Shake it with fast turns to and fro about all axes for 20 seconds.", _shaking()),
    Motion("Let it lie still for a minute.", ((Z, 0.0, 60.0),)),
    Motion(
        "Warm it by ten degrees while it lies on its back, then on its long side.",
        ((Z, 0.0, 28.0), (Y, 90.0, 2.0), (Z, 0.0, 28.0)),
        warming=10.0,
    ),
)


# By which devices are compared.
MINUTE = Motion(
    "Turn it by hand about all axes for a minute, as one does.",
    2 * tuple(turn for turn in _tumbling() if turn[1]),
)


def attitude(motion: Motion, t: Array) -> tuple[Array, Array]:
    """C_nb (n, 3, 3) and the rate omega_ib_b (n, 3) rad/s at times t (n,), s since the start."""
    C, omega = np.empty((len(t), 3, 3)), np.zeros((len(t), 3))
    now, begin = np.eye(3), 0.0
    C[:] = now
    for direction, degrees, seconds in motion.turns:
        axis = np.asarray(direction) / np.linalg.norm(direction)
        angle = math.radians(degrees)
        inside = t >= begin
        s = np.clip((t[inside] - begin) / seconds, 0.0, 1.0)
        turned = angle * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        C[inside] = now @ so3.rotations(turned[:, None] * axis)
        omega[inside] = (30.0 * angle / seconds * s**2 * (1.0 - s) ** 2)[:, None] * axis
        now, begin = now @ so3.matrix_exp(angle * axis), begin + seconds
    return C, omega


def rate_of(series: Series) -> float:
    """Mean rate of a stream, Hz."""
    return (len(series.t) - 1) / max(float(series.t[-1] - series.t[0]), 1e-6)


def recording_of(
    motion: Motion, like: Recording, g_n: Array, field: tuple[float, float] = EARTH_FIELD
) -> Recording:
    """The motion as a recording without errors, with the streams that ``like`` has.

    g_n (3,) m/s^2; field: horizontal and upward strength of the magnetic field, tesla.
    """

    def times(rate: float) -> Array:
        n = max(2, math.floor(motion.duration_s * rate + 1e-6) + 1)
        return np.asarray(np.arange(n) / rate)

    def read(t: Array) -> Array:
        C, omega = attitude(motion, t)
        return np.hstack([omega, -np.einsum("nji,j->ni", C, g_n)])

    values: dict[str, Callable[[Array], Array]] = {
        "heading": lambda t: so3.yaw_of(attitude(motion, t)[0])[:, None],
        "mag": lambda t: np.einsum("nji,j->ni", attitude(motion, t)[0], np.r_[0.0, field]),
        "temperature": lambda t: _temperature(motion, like, t),
        "pose": lambda t: np.hstack(
            [np.zeros((len(t), 3)), so3.quaternion_of(attitude(motion, t)[0])]
        ),
        "reference": read,
    }
    t = times(min(IMU_RATE, like.rate_hz))
    streams = {}
    for name, series in like.streams.items():
        own = times(min(rate_of(series), STREAMS[name].planned_hz))
        # (of what no motion changes, the last reading)
        value = values.get(name, lambda t, last=series.value[-1]: np.tile(last, (len(t), 1)))
        streams[name] = Series(own, value(own))
    imu = read(t)
    valid = np.ones(len(t), dtype=np.bool_)
    gyro, accel = np.ascontiguousarray(imu[:, :3]), np.ascontiguousarray(imu[:, 3:])
    own_imu = Imu(t, gyro, accel, valid)
    return Recording(motion.sentence, own_imu, streams, bias_temperature=like.bias_temperature)


def _temperature(motion: Motion, like: Recording, t: Array) -> Array:
    """The temperature at which ``like`` ended, and what the motion adds, degC."""
    last = like.streams["temperature"].value[-1, 0]
    first = float(last) if math.isfinite(last) else ROOM_TEMPERATURE
    return np.asarray((first + motion.warming * t / motion.duration_s)[:, None])

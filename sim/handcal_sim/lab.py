"""Laboratory set-ups: a table that stops in poses, a rate table, a dividing head, a chamber.

What the equipment believes that it does is the known input (`Motion.commanded`, which the
reference reads); what the body does differs by errors of position, new in every pose of every
axis, and by a tilt of the base.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim import profiles
from handcal_sim.errors import SimulationError
from handcal_sim.motion import DAY_S, Motion, Start, euler_matrix
from handcal_sim.profiles import Array, Profile

ARCSEC, ARCMIN = math.radians(1.0 / 3600.0), math.radians(1.0 / 60.0)
_STILL = profiles.constant([0.0, 0.0, 0.0])
_NONE = profiles.constant([0.0])
# A step from one pose to the next, s.
REST, MOVE = 5.0, 2.0
RAMP_AND_HOLD = 8.0
SOAKS = (5.0, 15.0, 25.0, 35.0, 45.0)
CHANGE = 40.0


@dataclass(frozen=True)
class Equipment:
    """angle: rms error of an axis in a pose, rad; tilt: rms of the base about east and about
    north, rad; spin: rate of a rate table, rad/s."""

    angle: float = 0.0
    tilt: float = 0.0
    spin: float = math.radians(100.0)


@dataclass(frozen=True)
class Setup:
    """angles (n, 3) of roll, pitch and yaw in each pose, rad; spins: whether it turns in each
    about the vertical; fixture (n, 3): how the body is clamped, without error."""

    angles: Array
    fixture: Array
    spins: bool = False
    temperatures: tuple[float, ...] = ()

    @property
    def usual_s(self) -> float:
        """Its length at the usual pace, s."""
        if self.spins:
            return len(self.angles) * (REST + MOVE + 2 * RAMP_AND_HOLD)
        once = len(self.angles) * (REST + MOVE)
        return once if not self.temperatures else len(self.temperatures) * (once + CHANGE) - CHANGE


def _lying(up: Sequence[Sequence[float]]) -> Array:
    """Roll, pitch and yaw (n, 3) with these directions (n, 3) of the body up, yaw 0."""
    u = np.asarray(up, dtype=float)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    pitch = -np.arcsin(np.clip(u[:, 0], -1.0, 1.0))
    level = np.hypot(u[:, 1], u[:, 2]) < 1e-12
    roll = np.where(level, 0.0, np.arctan2(u[:, 1], u[:, 2]))
    return np.stack([roll, pitch, np.zeros(len(u))], axis=1)


_FACES = ((0, 0, 1), (0, 1, 0), (0, 0, -1), (0, -1, 0), (1, 0, 0), (-1, 0, 0))
_EDGES = ((0, 1, 1), (1, 0, 1), (1, 1, 0), (0, -1, 1), (-1, 0, 1), (-1, 1, 0),
          (0, 1, -1), (1, 0, -1), (1, -1, 0), (0, -1, -1), (-1, 0, -1), (-1, -1, 0))  # fmt: skip


def _table() -> Setup:
    """Every face and every edge up; yaw goes on, so that it is turned about all axes."""
    angles = _lying([*_FACES, *_EDGES])
    angles[:, 2] = np.radians(70.0 * np.arange(len(angles)))
    return Setup(angles, np.zeros_like(angles))


def _spins() -> Setup:
    """Each axis up and each diagonal of a face: both ways at a constant rate, and a rest."""
    angles = _lying([_FACES[i] for i in (4, 1, 0)] + [_EDGES[i] for i in range(6)])
    return Setup(angles, np.zeros_like(angles), spins=True)


def _head() -> Setup:
    """About the body's x, y and z, each level in its turn, in steps of 30 degrees."""
    step = np.radians(30.0 * np.arange(12))
    angles, fixture = np.zeros((36, 3)), np.zeros((36, 3))
    for axis in range(3):
        angles[12 * axis : 12 * axis + 12, axis] = step
    fixture[24:, 0] = math.pi / 2
    return Setup(angles, fixture)


def _soak() -> Setup:
    """Six faces up at each of several temperatures, which change in between."""
    angles = _lying(_FACES)
    return Setup(angles, np.zeros_like(angles), temperatures=SOAKS)


SETUPS: dict[str, Callable[[], Setup]] = {
    "table-poses": _table,
    "steady-spins": _spins,
    "dividing-head": _head,
    "soak": _soak,
}


def build(
    name: str,
    duration_s: float | None,
    start: Start,
    equipment: Equipment,
    rng: np.random.Generator,
) -> Motion:
    """The set-up of that name, at any pace; heading of the base as `start` has it."""
    setup = SETUPS[name]()
    usual = setup.usual_s
    duration = usual if duration_s is None else duration_s
    if not 0.2 * usual <= duration <= DAY_S:
        raise SimulationError(
            f"{name} takes {usual:g} s; a duration of {duration:g} s is too short or too long"
        )
    pace = duration / usual
    base = euler_matrix(*(np.asarray(a) for a in (0.0, 0.0, start.heading)))
    tilt = equipment.tilt * rng.standard_normal(2)
    error = equipment.angle * rng.standard_normal((len(setup.angles), 3))
    if name == "dividing-head":
        error = np.where(np.arange(3) == np.arange(36)[:, None] // 12, error, 0.0)
    commanded = _motion(name, setup, setup.angles, base, equipment, pace)
    tilted = euler_matrix(*(np.asarray(a) for a in (*tilt, 0.0))) @ base
    true = _motion(name, setup, setup.angles + error, tilted, equipment, pace)
    return replace(true, commanded=commanded)


def _motion(
    name: str, setup: Setup, angles: Array, base: Array, equipment: Equipment, pace: float
) -> Motion:
    rest, move = REST * pace, MOVE * pace
    once = np.arange(len(angles)) * (rest + move)
    turning, knots, end = _NONE, [], float(once[-1] + rest + move)
    stages: list[Profile] = []
    starts = once
    if setup.spins:
        turn = 2.0 * RAMP_AND_HOLD * pace
        starts = np.arange(len(angles)) * (rest + move + turn)
        end = float(starts[-1] + rest + move + turn)
        spin, turning = _spinning(np.asarray(starts + rest), RAMP_AND_HOLD * pace, equipment.spin)
        stages.append(spin)
    elif setup.temperatures:
        block = end + CHANGE * pace
        begin = block * np.arange(len(setup.temperatures))
        starts = (begin[:, None] + once).ravel()
        angles = np.tile(angles, (len(begin), 1))
        for a, T in zip(begin, setup.temperatures, strict=True):
            knots += [(float(a), T), (float(a) + end, T)]
        end = float(begin[-1]) + end
    fixture = np.resize(setup.fixture, angles.shape)
    held = (rest + 2.0 * RAMP_AND_HOLD * pace) if setup.spins else rest
    for each in (fixture, angles) if np.any(fixture) else (angles,):
        stages.append(_stepping(each, np.asarray(starts + held), move))
    between = [(float(a), float(a) + rest) for a in starts]
    return Motion(
        name, end, base, tuple(stages), _STILL, _NONE, turning, tuple(between),
        knots=tuple(knots),
    )  # fmt: skip


def _stepping(angles: Array, leave: Array, move: float) -> Profile:
    """From each row of angles to the next, leaving at these times (n,); d = 3."""
    parts = [profiles.constant(angles[0].tolist())]
    for k, at in enumerate(leave[:-1]):
        step = angles[k + 1] - angles[k]
        if np.any(step):
            parts.append(profiles.along(step.tolist(), profiles.turn(at, at + move, 1.0)))
    return profiles.add(*parts)


def _spinning(begin: Array, seconds: float, rate: float) -> tuple[Profile, Profile]:
    """There and back about the vertical at a constant rate but for the ramps, and its size."""
    angle = rate * 0.85 * seconds
    turns = [(float(a) + k * seconds, s * angle) for a in begin for k, s in ((0, 1.0), (1, -1.0))]
    spin = [profiles.along([0.0, 0.0, 1.0], profiles.turn(a, a + seconds, x)) for a, x in turns]
    size = [profiles.turn_rate(a, a + seconds, x) for a, x in turns]
    return profiles.add(*spin), profiles.add(*size)

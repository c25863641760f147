"""Truth as smooth functions of time: the attitude of the body and the held point.

Attitude is a product C_nb = C_start S_1(t) S_2(t) ...; a stage S is a rotation
Rz(c) Ry(b) Rx(a) whose angles (a, b, c) are a profile with d = 3. Rates and angular
accelerations follow analytically.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim import profiles
from handcal_sim.errors import SimulationError, UnknownWord
from handcal_sim.profiles import Array, Jet, Profile


@dataclass(frozen=True)
class Motion:
    """What the hand means to do.

    stages: angles in rad; path: of the held point, m, in navigation axes (d = 3).
    held: 1 in the hand, 0 on a table; activity: how fast it turns, rad/s (both d = 1).
    wander: what the hand adds unasked, d = 6: displacement in m and a last stage in rad.
    rests: (start, end) in s where neither attitude nor path changes but for the wander.
    commanded: what a table believes that it does; knots: (s, degC), the temperature around it.
    """

    name: str
    duration_s: float
    C_start: Array
    stages: tuple[Profile, ...]
    path: Profile
    held: Profile
    activity: Profile
    rests: tuple[tuple[float, float], ...]
    wander: Profile | None = None
    commanded: Motion | None = None
    knots: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Kinematics:
    """The held point and the body against the navigation frame.

    position, velocity, acceleration: (n, 3) in navigation axes; C_nb: (n, 3, 3);
    omega_nb_b rad/s and its derivative alpha_nb_b: (n, 3) in body axes.
    """

    position: Array
    velocity: Array
    acceleration: Array
    C_nb: Array
    omega_nb_b: Array
    alpha_nb_b: Array


def evaluate(motion: Motion, t: Array) -> Kinematics:
    """The motion at the instants t (n,) in s, exactly."""
    position, velocity, acceleration = motion.path(t)
    stages = [stage(t) for stage in motion.stages]
    if motion.wander is not None:
        jet = motion.wander(t)
        position = position + jet[0][:, :3]
        velocity = velocity + jet[1][:, :3]
        acceleration = acceleration + jet[2][:, :3]
        stages.append((jet[0][:, 3:], jet[1][:, 3:], jet[2][:, 3:]))
    C = np.broadcast_to(motion.C_start, (len(t), 3, 3))
    omega, alpha = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for stage in stages:
        S, w, dw = _stage(stage)
        C = C @ S
        carried = into(S, omega)
        alpha = into(S, alpha) + dw - np.cross(w, carried)
        omega = carried + w
    return Kinematics(position, velocity, acceleration, C, omega, alpha)


def into(C: Array, vector: Array) -> Array:
    """C^T v for stacks: C (n, 3, 3) or (3, 3), v (n, 3) or (3,)."""
    rotated: Array = np.einsum("...ji,...j->...i", C, vector)
    return rotated


def out_of(C: Array, vector: Array) -> Array:
    """C v for stacks."""
    rotated: Array = np.einsum("...ij,...j->...i", C, vector)
    return rotated


def euler_matrix(a: Array, b: Array, c: Array) -> Array:
    """Rz(c) Ry(b) Rx(a), (n, 3, 3), from angles (n,) in rad."""
    sa, ca, sb, cb, sc, cc = np.sin(a), np.cos(a), np.sin(b), np.cos(b), np.sin(c), np.cos(c)
    S = np.empty((*np.shape(a), 3, 3))
    S[..., 0, 0], S[..., 0, 1], S[..., 0, 2] = (
        cc * cb,
        cc * sb * sa - sc * ca,
        cc * sb * ca + sc * sa,
    )
    S[..., 1, 0], S[..., 1, 1], S[..., 1, 2] = (
        sc * cb,
        sc * sb * sa + cc * ca,
        sc * sb * ca - cc * sa,
    )
    S[..., 2, 0], S[..., 2, 1], S[..., 2, 2] = -sb, cb * sa, cb * ca
    return S


def _stage(jet: Jet) -> tuple[Array, Array, Array]:
    """The stage's rotation, its body rate and the derivative of that."""
    (a, b, c), (da, db, dc), (dda, ddb, ddc) = (part.T for part in jet)
    sa, ca, sb, cb = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
    rate = np.stack([da - dc * sb, db * ca + dc * cb * sa, dc * cb * ca - db * sa], axis=1)
    turning = np.stack(
        [
            dda - ddc * sb - dc * cb * db,
            ddb * ca - db * sa * da + ddc * cb * sa + dc * (cb * ca * da - sb * sa * db),
            ddc * cb * ca - dc * (sb * ca * db + cb * sa * da) - ddb * sa - db * ca * da,
        ],
        axis=1,
    )
    return euler_matrix(a, b, c), rate, turning


@dataclass(frozen=True)
class Start:
    """How the body lies at t = 0: yaw, pitch and roll in rad; direction +1 or -1 of turns."""

    heading: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    direction: int = 1


def random_start(rng: np.random.Generator) -> Start:
    """Any heading, a few degrees of tilt, turning either way."""
    pitch, roll = rng.normal(0.0, math.radians(3.0), 2)
    heading = rng.uniform(-math.pi, math.pi)
    return Start(float(heading), float(pitch), float(roll), int(rng.choice([-1, 1])))


DAY_S = 86400.0
STILL = profiles.constant([0.0, 0.0, 0.0])
ONE = profiles.constant([1.0])
NONE = profiles.constant([0.0])


def z_turn(duration: float, start: Start, _rng: np.random.Generator) -> Motion:
    """Paper 002, table 1: a third static, a third turning 360 deg about z, a third static.

    The axis is the vertical, which is the body's z where the start is level: a turn about
    a tilted z would show the vertical gyro bias to the accelerometer.
    """
    level = replace(start, heading=0.0, pitch=0.0, roll=0.0)
    turned = _turns("z-turn", duration, level, [(2, duration / 3, 2 * duration / 3)])
    held = profiles.constant([start.roll, start.pitch, start.heading])
    return replace(turned, stages=(*turned.stages, held))


def three_turns(duration: float, start: Start, _rng: np.random.Generator) -> Motion:
    """One turn each about x, y and z, with short rests before, between and after."""
    s = duration / 30.0
    return _turns(
        "three-turns", duration, start, [(i, (2 + 9 * i) * s, (10 + 9 * i) * s) for i in range(3)]
    )


def _turns(
    name: str, duration: float, start: Start, when: list[tuple[int, float, float]]
) -> Motion:
    """Whole turns one after another, each (axis, from, to) about one of the body's axes."""
    angle = 2.0 * math.pi * start.direction
    angles = [profiles.along(np.eye(3)[axis], profiles.turn(a, b, angle)) for axis, a, b in when]
    activity = profiles.add(*(profiles.turn_rate(a, b, angle) for _, a, b in when))
    windows = [(a, b) for _, a, b in when]
    return Motion(
        name, duration, start_matrix(start), (profiles.add(*angles),), STILL, ONE, activity,
        between(windows, duration),
    )  # fmt: skip


def static(duration: float, start: Start, _rng: np.random.Generator) -> Motion:
    """On a table."""
    return Motion(
        "static", duration, start_matrix(start), (), STILL, NONE, NONE, ((0.0, duration),)
    )  # fmt: skip


def free_hand(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """Turned about all axes at will in front of the chest, resting in the hand at both ends."""
    rest = min(4.0, duration / 8.0)
    windows = [(rest, duration - rest)]
    return _free("free-hand", duration, start, rng, windows, reach=0.0)


def travel(duration: float, start: Start, rng: np.random.Generator) -> Motion:
    """Free motion in which the hand travels too; rests on a table before, between and after."""
    rest = duration / 13.0
    third = (duration - 4.0 * rest) / 3.0
    windows = [(rest + k * (third + rest), rest + k * (third + rest) + third) for k in range(3)]
    return _free("travel", duration, start, rng, windows, reach=float(rng.uniform(0.5, 0.8)))


def _free(
    name: str,
    duration: float,
    start: Start,
    rng: np.random.Generator,
    windows: list[tuple[float, float]],
    reach: float,
) -> Motion:
    ramp = min(2.0, 0.2 * (windows[0][1] - windows[0][0]))
    moving = profiles.gate(windows, ramp)
    # A flat spectrum of rates: slow turns go far. Euler rates add up to 1.5 rad/s rms.
    omega, sin, cos = random_sinusoids(rng, 12, 0.06, 0.5, 3)
    sin, cos = sin / omega[:, None], cos / omega[:, None]
    power = 0.5 * np.sum((omega[:, None] ** 2) * (sin**2 + cos**2))
    size = 1.5 / math.sqrt(power)
    angles = profiles.multiply(moving, profiles.sinusoids(omega, size * sin, size * cos))
    path, held = STILL, ONE
    if reach > 0.0:
        path = profiles.multiply(moving, roaming(rng, duration, reach))
        held = moving
    activity = profiles.along([1.5], moving)
    rests = between(windows, duration)
    return Motion(name, duration, start_matrix(start), (angles,), path, held, activity, rests)


def roaming(rng: np.random.Generator, duration: float, reach: float) -> Profile:
    """A path whose largest distance from its start is `reach` m."""
    omega, sin, cos = random_sinusoids(rng, 8, 0.08, 0.45, 3)
    sin, cos = sin / omega[:, None], cos / omega[:, None]
    value = profiles.sinusoids(omega, sin, cos)(np.arange(0.0, duration, 0.1))[0]
    size = reach / np.max(np.linalg.norm(value, axis=1))
    return profiles.sinusoids(omega, size * sin, size * cos)


def random_sinusoids(
    rng: np.random.Generator, count: int, low_hz: float, high_hz: float, width: int
) -> tuple[Array, Array, Array]:
    """Frequencies spread over the band (rad/s), standard normal amplitudes."""
    edges = np.linspace(low_hz, high_hz, count + 1)
    omega = 2.0 * math.pi * rng.uniform(edges[:-1], edges[1:])
    return omega, rng.standard_normal((count, width)), rng.standard_normal((count, width))


def between(windows: list[tuple[float, float]], duration: float) -> tuple[tuple[float, float], ...]:
    """What lies between windows (start, end), s, from 0 to the duration."""
    edges = [0.0, *(edge for window in windows for edge in window), duration]
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def start_matrix(start: Start) -> Array:
    """C_nb (3, 3) of the attitude at the start."""
    return euler_matrix(*(np.asarray(x) for x in (start.roll, start.pitch, start.heading)))


Scenario = Callable[[float, Start, np.random.Generator], Motion]
SCENARIOS: dict[str, tuple[Scenario, float]] = {
    "z-turn": (z_turn, 30.0),
    "three-turns": (three_turns, 30.0),
    "free-hand": (free_hand, 84.0),
    "travel": (travel, 65.0),
    "static": (static, 30.0),
}


def build(name: str, duration_s: float | None, start: Start, rng: np.random.Generator) -> Motion:
    """The scenario of that name; SimulationError says which there are."""
    if name not in SCENARIOS:
        raise UnknownWord("scenario", name, SCENARIOS)
    make, usual = SCENARIOS[name]
    duration = usual if duration_s is None else duration_s
    if not (math.isfinite(duration) and 1.0 <= duration <= DAY_S):
        raise SimulationError(f"a duration of {duration:g} s is not between 1 s and a day")
    return make(duration, start, rng)

"""Which errors a recording can show, without a fit, and in well under a second.

The rows of a linear problem are put down and only its covariance is asked for. Known is that at
rest the specific force has the size of gravity and the rate is zero; that from rest to rest the
gyro must carry the direction up to where the accelerometer finds it next (and, with a compass,
the heading), and the attitude from pose to pose; that a held point stays where it is but for its
sway, so that over seconds the force, carried along by the gyro, is gravity's, and by which the
lever arm is told; and that the magnetic field has one size. Each at a usual noise, the
unknowns with the priors of the catalogue. A parameter counts as shown where its sigma is below
half its prior, as in ``calibrate --json``. ``calibrate`` uses every reading and so often tells
more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from handcal.compiled import so3
from handcal.design.poses import NOISE
from handcal.earth import STANDARD_GRAVITY
from handcal.effects import Effect, select
from handcal.effects.mag_hard_iron import sphere
from handcal.estimate.regression import columns, unknowns
from handcal.recordings.overview import Overview, rate_at_rest
from handcal.recordings.segment import Rest
from handcal.signals import of_arrays
from handcal.types import Array, Parameter

INERTIAL = (
    "gyro_bias", "accel_bias", "gyro_scale", "accel_scale", "gyro_misalignment",
    "accel_misalignment",
)  # fmt: skip
# Attitude is followed at this rate and no further than so many steps.
FOLLOWED_HZ, MOST_STEPS = 50.0, 20_000
# What a direction or heading from the other sensors is good to, rad: an accelerometer at rest, a
# compass indoors, a measured pose.
UP_SIGMA, COMPASS_SIGMA, POSE_SIGMA = 1.5e-3, math.radians(3.0), math.radians(0.3)
POSE_STEP_S = 5.0
# A gyro's angle wanders by so much in a turn of a second, rad.
WANDER = math.radians(0.02)
# A zero rate is that of a hand, unless the rest is still, rad/s.
HELD_RATE = math.radians(0.5)
# The hand's own acceleration, m/s^2, and for how long it stays alike, s.
SWAY, SWAY_TIME = 0.3, 0.15
# Over so long the force is gravity's where a point is held, which sways by so much, s and m.
HELD_S, HELD_M = 2.0, 0.01
# How far a room bends the field, tesla, and of the sphere of directions what counts as one.
BENT, CELL = 2e-6, math.radians(15.0)
EARTH_FIELD_SIGMA = 1.2e-5


@dataclass(frozen=True)
class Seen:
    """One effect and how well its parameters could be told: their sigmas beside their priors."""

    effect: Effect
    parameters: tuple[Parameter, ...]

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the parameters that could be told."""
        return tuple(p.name for p in self.parameters if p.shown)


def seen(found: Overview) -> tuple[Seen, ...]:
    """What could be told, effect by effect; those of streams that are not there are left out."""
    effects = select(INERTIAL)
    rows = [row for row in _inertial_rows(found, effects) if len(row)]
    return (
        *_told(effects, np.vstack(rows) if rows else np.zeros((0, _size(effects)))),
        *_told(select(("lever_arm",)), _arm_rows(found)),
        *_iron(found),
    )


def _size(effects: Sequence[Effect]) -> int:
    return sum(len(e.parameters) for e in effects)


def _told(effects: Sequence[Effect], rows: Array) -> Iterator[Seen]:
    """Sigmas by rows (m, k) of unit variance and the priors; of k nuisances at the end as well."""
    of = unknowns(effects)
    prior = np.array([u.param.prior_sigma for u in of])
    more = rows.shape[1] - len(of)
    scaled = rows * np.r_[prior, np.ones(more)]
    R = np.linalg.qr(np.vstack([scaled, np.eye(scaled.shape[1])]), mode="r")
    sigma = np.linalg.norm(np.linalg.solve(R, np.eye(len(R))), axis=1)[: len(prior)] * prior
    for e in effects:
        own = [i for i, u in enumerate(of) if u.effect == e.id]
        yield Seen(e, tuple(
            Parameter(e.id, of[i].param.name, 0.0, float(sigma[i]), of[i].param.unit,
                      float(prior[i]), None)
            for i in own
        ))  # fmt: skip


def _inertial_rows(found: Overview, effects: Sequence[Effect]) -> Iterator[Array]:
    """Rows (m, k) of what rests say by themselves, then from each rest to the next."""
    none = np.zeros(_size(effects))
    turn = _Turning.of(found, effects)
    yield from _between_poses(found, turn)
    yield from _while_held(found, effects, turn)
    force = np.array([r.force for r in found.rests]).reshape(-1, 3)
    if not len(force):
        return
    still = of_arrays(np.arange(float(len(force))), np.zeros_like(force), force)
    at_rest = columns(effects, none, still)
    for J, rest, f in zip(at_rest, found.rests, force, strict=True):
        yield (f / np.linalg.norm(f) @ J[3:])[None] / NOISE[1]
        yield J[:3] / (NOISE[0] if rest.still else HELD_RATE)
    for (a, b), J_a, J_b in zip(pairwise(found.rests), at_rest[:-1], at_rest[1:], strict=True):
        yield from _between_rests(found, turn, (a, b), (J_a, J_b))


@dataclass(frozen=True)
class _Turning:
    """Attitude C (n, 3, 3) at times t (n,), and the error in it that each parameter has made since
    the beginning, in the axes of the beginning: grown (n, 3, k)."""

    t: Array
    C: Array
    grown: Array

    @staticmethod
    def of(found: Overview, effects: Sequence[Effect]) -> _Turning:
        t, rate, C = _followed(found)
        none = np.zeros(_size(effects))
        J = columns(effects, none, of_arrays(t, rate, np.zeros_like(rate)))[:, :3]
        step = np.diff(t, append=t[-1])[:, None]
        middle = C @ so3.rotations(0.5 * rate * step)
        grown = np.cumsum(np.einsum("nij,njk->nik", middle, J) * step[:, :, None], axis=0)
        return _Turning(t, C, grown)


def _between_rests(
    found: Overview, turn: _Turning, rests: tuple[Rest, Rest], J: tuple[Array, Array]
) -> Iterator[Array]:
    """The direction up as the gyro carries it from a rest to the next, and the heading; J: how
    errors change what is read in them, (6, k) each."""
    a, b = rests
    i, j = np.searchsorted(turn.t, [a.end, b.start]).clip(0, len(turn.t) - 1)
    turned, up = turn.grown[j] - turn.grown[i], turn.C[i] @ (a.force / np.linalg.norm(a.force))
    across = np.eye(3) - np.outer(up, up)
    tilt = across @ (turn.C[j] @ J[1][3:] - turn.C[i] @ J[0][3:]) / STANDARD_GRAVITY
    wander = WANDER * math.sqrt(max(b.start - a.end, 0.1))
    yield (tilt - so3.skew(up) @ turned) / math.hypot(UP_SIGMA, wander)
    if {"heading", "mag"} & set(found.recording.streams):
        yield (up @ turned)[None] / math.hypot(COMPASS_SIGMA, wander)


def _while_held(found: Overview, effects: Sequence[Effect], turn: _Turning) -> Iterator[Array]:
    """That the mean force in axes that do not turn is the same from one while to the next, and the
    heading with a compass."""
    t, C = turn.t, turn.C
    count = max(1, round(HELD_S / float(np.median(np.diff(t))))) if len(t) > 1 else 1
    if len(t) < 2 * count:
        return
    rate, force = _mean_readings(found, len(t))
    # (in the middle of each step, where its mean readings are)
    step = np.diff(t, append=t[-1])
    C = C @ so3.rotations(0.5 * rate * step[:, None])
    grown = turn.grown - 0.5 * np.diff(turn.grown, axis=0, prepend=0.0)
    J = columns(effects, np.zeros(_size(effects)), of_arrays(t, rate, force))
    felt = np.einsum("nij,nj->ni", C, force)
    moved = np.einsum("nij,njk->nik", C, J[:, 3:]) - so3.skew(felt) @ grown
    whole = len(t) // count * count
    means = moved[:whole].reshape(-1, count, *moved.shape[1:]).mean(axis=1)
    sigma = math.hypot(2.0 * HELD_M / HELD_S**2, STANDARD_GRAVITY * WANDER * math.sqrt(HELD_S))
    yield (np.diff(means, axis=0) / (math.sqrt(2.0) * sigma)).reshape(-1, J.shape[2])
    if {"heading", "mag"} & set(found.recording.streams):
        up = felt.mean(axis=0) / np.linalg.norm(felt.mean(axis=0))
        grown = grown[:whole].reshape(-1, count, *grown.shape[1:]).mean(axis=1)
        wander = math.hypot(math.sqrt(2.0) * COMPASS_SIGMA, WANDER * math.sqrt(HELD_S))
        yield up @ np.diff(grown, axis=0) / wander


def _between_poses(found: Overview, turn: _Turning) -> Iterator[Array]:
    """The turn between poses some seconds apart, about all axes."""
    pose = found.recording.streams.get("pose")
    if pose is None or len(pose.t) < 2:
        return
    times = np.arange(pose.t[0], pose.t[-1], POSE_STEP_S)
    at = np.searchsorted(turn.t, times).clip(0, len(turn.t) - 1)
    wander = math.hypot(POSE_SIGMA, WANDER * math.sqrt(POSE_STEP_S))
    yield np.diff(turn.grown[at], axis=0).reshape(-1, turn.grown.shape[2]) / wander


def _followed(found: Overview) -> tuple[Array, Array, Array]:
    """Times (n,), mean rates (n, 3) less what is read at rest, and attitudes (n, 3, 3)."""
    imu, width = found.recording.imu, _width(found)
    n = len(imu.t) // width
    rate = _mean_readings(found, n)[0]
    t = imu.t[: n * width : width]
    steps = so3.rotations(rate * np.diff(t, append=t[-1])[:, None])
    C, now = np.empty((n, 3, 3)), np.eye(3)
    for k, step in enumerate(steps):
        C[k] = now
        now = now @ step
    return t, rate, C


def _width(found: Overview) -> int:
    """Samples in each step in which the attitude is followed."""
    n, rate = len(found.recording.imu.t), found.recording.rate_hz
    return max(1, round(rate / FOLLOWED_HZ), -(-n // MOST_STEPS))


def _mean_readings(found: Overview, n: int) -> tuple[Array, Array]:
    """Rate less what is read at rest, and force, (n, 3) each: means over the steps."""
    imu, width = found.recording.imu, _width(found)
    rate, force = (x[: n * width].reshape(n, width, 3).mean(axis=1) for x in (imu.gyro, imu.accel))
    return rate - rate_at_rest(found.rests), force


def _arm_rows(found: Overview) -> Array:
    """Rows (m, 3) by which a held point tells the arm: what swings about it feels."""
    t, rate, _ = _followed(found)
    step = np.gradient(t) if len(t) > 1 else np.ones(len(t))
    alpha = np.gradient(rate, axis=0) / step[:, None]
    W, A = so3.skew(rate), so3.skew(alpha)
    weight = np.sqrt(np.minimum(step / SWAY_TIME, 1.0)) / SWAY
    return np.asarray(((A + W @ W) * weight[:, None, None]).reshape(-1, 3))


def _iron(found: Overview) -> Iterator[Seen]:
    """Hard and soft iron by the directions of the field in which readings were taken."""
    mag = found.recording.streams.get("mag")
    if mag is None or len(mag.t) < 2:
        return
    effects = select(("mag_hard_iron", "mag_soft_iron"))
    centre, _ = sphere(found.recording)
    field = mag.value - centre
    strength = float(np.median(np.linalg.norm(field, axis=1)))
    cells = np.unique(np.round(field / max(strength, 1e-9) / CELL), axis=0)
    cells = cells[np.linalg.norm(cells, axis=1) > 0]
    u = cells / np.linalg.norm(cells, axis=1, keepdims=True)
    x, y, z = u.T
    soft = strength * np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)
    rows = np.hstack([u, soft, np.full((len(u), 1), EARTH_FIELD_SIGMA)]) / BENT
    yield from _told(effects, rows)

"""Puts recording, effects and observations together to a problem for the filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.compiled.kernel import MOST_HELD, Nodes, Tables
from handcal.effects import DELAY, TIME, WARMTH, Z_DIM, Effect
from handcal.estimate.derivatives import relinearised
from handcal.estimate.problem import Problem, Slot, slots_of
from handcal.estimate.sampling import at_nodes, knocked, smoothness
from handcal.observations import Observation, Rows, nearest
from handcal.signals import warmth_at
from handcal.types import Array, IntArray, Markov, Recording

# Moments closer than this are one, s.
SNAP_S = 1e-7


@dataclass(frozen=True)
class Piece:
    """What a piece of a recording has to know of the whole: where that began, from which effects
    count, and a moment that is to be a node, since a filter stands there; both s."""

    origin: float
    stands: float


def build(
    recording: Recording,
    effects: Sequence[Effect],
    observed: Sequence[tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]],
    g_n: Array,
    omega_ie_n: Array,
    *,
    rests: Array | None = None,
    linearised: bool = True,
    piece: Piece | None = None,
) -> Problem:
    """Assemble a Problem. ``observed``: each kind with its rows and its constants.

    linearised: about zero; not needed where a trajectory to linearise about is at hand. piece: the
    recording is but one of a longer one.
    """
    acting = [e for e in effects if e.imu_error is not None]
    effects = (*acting, *(e for e in effects if e.imu_error is None))
    slots = slots_of(effects)
    slots += [Slot(o.kind, *constant) for o, _, constants in observed for constant in constants]
    imu_constants = sum(len(e.parameters) for e in acting)
    kinds = tuple(o for o, _, _ in observed)
    added = _processes(kinds, effects)
    step = np.r_[[1e-3 * s.prior_sigma for s in slots], np.full(added.size, 1e-5)]
    smooth = smoothness(recording.imu)
    rows = [r for _, r, _ in observed]
    nodes, rate, dropped = _nodes(recording, smooth, rows, imu_constants, piece)
    tables = _tables(kinds, [len(c) for _, _, c in observed], effects, slots, added, step)
    problem = Problem(
        recording,
        effects,
        kinds,
        tuple(slots),
        imu_constants,
        added.markovs,
        added.walks,
        added.wandering,
        nodes,
        tables,
        np.zeros(len(slots)),
        g_n,
        omega_ie_n,
        rate,
        dropped,
        smooth,
        next((r.alpha for _, r, _ in observed if r.alpha is not None), None),
        rests=np.zeros((0, 2)) if rests is None else rests,
    )
    zero = np.zeros(3)
    return relinearised(problem, problem.ref, zero, zero) if linearised else problem


@dataclass(frozen=True)
class _Processes:
    """The Markov processes of a problem, the first state of each owner's among theirs, and which
    of them add to the readings (see ``Problem``)."""

    markovs: tuple[Markov, ...]
    first: dict[str, int]
    walks: tuple[tuple[int, int], ...]
    wandering: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        return sum(m.size for m in self.markovs)


def _processes(kinds: Sequence[Observation], effects: Sequence[Effect]) -> _Processes:
    """Those of the observations, then those of the effects."""
    markovs: list[Markov] = []
    first: dict[str, int] = {}
    walks, wandering, size = [], [], 0
    processes = [(o.kind, o.markov, "", False) for o in kinds]
    processes += [(e.id, e.process, e.walks, e.passing) for e in effects if e.imu_error is None]
    for owner, markov, walked, passing in processes:
        if markov is None:
            continue
        markovs.append(markov)
        if walked:
            walks.append((size, 0 if walked == "gyro" else 3))
        if walked and not passing:
            wandering.append(walks[-1])
        first[owner] = size
        size += markov.size
    return _Processes(tuple(markovs), first, tuple(walks), tuple(wandering))


def _tables(
    kinds: Sequence[Observation],
    constants: Sequence[int],
    effects: Sequence[Effect],
    slots: Sequence[Slot],
    added: _Processes,
    step: Array,
) -> Tables:
    """What the kernel calls for each kind, and of which states: its own residual, that of its
    process, then the effects on it. constants: how many each kind has."""
    at = {s.owner: i for i, s in reversed(list(enumerate(slots)))}
    markov_at = {owner: len(slots) + first for owner, first in added.first.items()}
    shape = len(kinds), 2 + len(effects)
    start, count, whole, late = (np.zeros(shape, dtype=np.int64) for _ in range(4))
    held = np.full((*shape, MOST_HELD), np.nan)
    for k, kind in enumerate(kinds):
        parts = [(at.get(kind.kind, 0), constants[k])]
        if kind.markov is not None:
            parts.append((markov_at[kind.kind], kind.markov.size))
        acting = _acting(kind, effects)
        for j, e in enumerate(acting, len(parts)):
            whole[k, j] = len(e.held)
            held[k, j, : len(e.held)] = e.held
            late[k, j] = kind.kind in e.lateness
        parts += [
            (at[e.id], len(e.parameters))
            if e.process is None
            else (markov_at[e.id], e.process.size)
            for e in acting
        ]
        for j, part in enumerate(parts):
            start[k, j], count[k, j] = part
    dim = np.array([k.dim for k in kinds], dtype=np.int64)
    jacobian, function = addresses(kinds, effects)
    return Tables(dim, jacobian, function, start, count, step, whole, held, late)


def addresses(kinds: Sequence[Observation], effects: Sequence[Effect]) -> tuple[IntArray, IntArray]:
    """Where in this process the compiled functions lie that the kernel calls for each kind (see
    ``Tables``): jacobian (K,), function (K, F)."""
    function = np.zeros((len(kinds), 2 + len(effects)), dtype=np.int64)
    for k, kind in enumerate(kinds):
        own = [kind.residual, *([] if kind.markov is None else [kind.markov_residual])]
        acting = _acting(kind, effects)
        own += [e.lateness.get(kind.kind) or e.observation_error[kind.kind] for e in acting]
        for j, address in enumerate(own):
            function[k, j] = address
    return np.array([k.jacobian for k in kinds], dtype=np.int64), function


def _acting(kind: Observation, effects: Sequence[Effect]) -> list[Effect]:
    """Effects on what the kernel sees of this kind, in their order."""
    return [e for e in effects if kind.kind in e.acts_now_on]


def _nodes(
    recording: Recording, smooth: Array, rows: Sequence[Rows], imu_constants: int,
    piece: Piece | None,
) -> tuple[Nodes, Array, int]:  # fmt: skip
    """Insert the observation times between the IMU's stamps, readings interpolated there."""
    imu = recording.imu
    ot = np.concatenate([r.t - r.delay for r in rows]) if rows else np.zeros(0)
    kind = (
        np.concatenate([np.full(len(r.t), k) for k, r in enumerate(rows)]) if rows else np.zeros(0)
    )
    width = max([Z_DIM, *(r.z.shape[1] for r in rows)])
    z, moved = np.zeros((len(ot), width)), np.zeros(len(ot))
    i = 0
    for r in rows:
        own = slice(i, i + len(r.t))
        z[own, : r.z.shape[1]] = r.z
        z[own, DELAY] = r.delay
        moved[own] = 0.0 if r.moved is None else r.moved
        i = own.stop
    origin = imu.t[0] if piece is None else piece.origin
    z[:, TIME], z[:, WARMTH] = ot - origin, warmth_at(recording, ot)
    keep = (ot >= imu.t[0]) & (ot <= imu.t[-1])
    ot, kind, z, moved = ot[keep], kind[keep].astype(np.int64), z[keep], moved[keep]
    near = nearest(imu.t, ot)
    ot = np.where(np.abs(imu.t[near] - ot) < SNAP_S, imu.t[near], ot)
    order = np.lexsort((kind, ot))
    ot, kind, z, moved = ot[order], kind[order], z[order], moved[order]
    t = np.union1d(imu.t, ot if piece is None else np.r_[ot, piece.stands])
    node = np.searchsorted(t, ot)
    first = np.searchsorted(node, np.arange(len(t) + 1)).astype(np.int64)
    gyro, accel, bend = at_nodes(imu, smooth, np.hstack([imu.gyro, imu.accel]), t)
    rate = _smoothed_rate(recording, t, piece is not None)
    extra = _extra(recording, t)
    np.add.at(extra[:, 2], node, moved**2)
    J = np.zeros((len(t), 6, imu_constants))
    nodes = Nodes(t, gyro, accel, bend, J, extra, first, kind, z)
    return nodes, rate, int((~keep).sum())


def _smoothed_rate(recording: Recording, t: Array, goes_on: bool) -> Array:
    """Turning rate (n,) at times t (n,), rad/s, over a third of a second. goes_on: what lies
    beyond the ends is as what is there, else nothing is."""
    imu = recording.imu
    bias = np.median(imu.gyro, axis=0) if len(imu.t) < 10 else np.zeros(3)
    speed = np.linalg.norm(imu.gyro - bias, axis=1)
    width = max(1, round(0.3 * recording.rate_hz))
    mean = np.convolve(speed, np.ones(width) / width, mode="same")
    if goes_on:
        mean /= np.convolve(np.ones(len(speed)), np.ones(width) / width, mode="same")
    return np.asarray(np.interp(t, imu.t, mean))


def _extra(recording: Recording, t: Array) -> Array:
    """Variance (n, 3) added to angle, velocity and position: of the first two over intervals that
    hold no measurement, or a knock."""
    imu = recording.imu
    dt_imu = np.diff(imu.t)
    gap = dt_imu > 4.0 * np.median(dt_imu)
    masked = ~(imu.valid[1:] & imu.valid[:-1])
    at = np.clip(np.searchsorted(imu.t, t[1:], side="left") - 1, 0, len(dt_imu) - 1)
    dt = np.diff(t)
    out = np.zeros((len(t), 3))
    turning = 1.0 + float(np.sqrt((imu.gyro**2).mean()))
    shaking = 2.0 + float(imu.accel.std())
    out[1:, 0] += (
        np.where(gap[at], turning * dt, 0.0) ** 2 + np.where(masked[at], 10.0 * dt, 0.0) ** 2
    )
    out[1:, 1] += (
        np.where(gap[at], shaking * dt, 0.0) ** 2 + np.where(masked[at], 30.0 * dt, 0.0) ** 2
    )
    # (of what is missed about one sample, each part of its interval has its share)
    out[1:, :2] += knocked(imu)[at + 1] ** 2 * (dt_imu[at] * dt)[:, None]
    return out

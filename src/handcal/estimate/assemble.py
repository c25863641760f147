"""Puts recording, effects and observations together to a problem for the filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handcal.compiled.kernel import MOST_HELD, Nodes, Tables
from handcal.effects import DELAY, TIME, Z_DIM, Effect
from handcal.estimate.derivatives import relinearised
from handcal.estimate.problem import Problem, Slot, slots_of
from handcal.observations import Observation, Rows, nearest
from handcal.types import Array, Markov, Recording

# Moments closer than this are one, s.
SNAP_S = 1e-7


def build(
    recording: Recording,
    effects: Sequence[Effect],
    observed: Sequence[tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]],
    g_n: Array,
    omega_ie_n: Array,
    *,
    linearised: bool = True,
) -> Problem:
    """Assemble a Problem. ``observed``: each kind with its rows and its constants.

    linearised: about zero; not needed where a trajectory to linearise about is at hand.
    """
    acting = [e for e in effects if e.imu_error is not None]
    others = [e for e in effects if e.imu_error is None]
    slots = slots_of(effects)
    imu_constants = sum(len(e.parameters) for e in acting)
    at: dict[str, int] = {}
    for i, s in enumerate(slots):
        at.setdefault(s.owner, i)
    for observation, _, constants in observed:
        at[observation.kind] = len(slots)
        slots += [Slot(observation.kind, name, unit, sigma) for name, unit, sigma in constants]
    markovs: list[Markov] = []
    walks, size = [], 0
    markov_at: dict[str, int] = {}
    processes = [(o.kind, o.markov, "", False) for o, _, _ in observed]
    processes += [(e.id, e.process, e.walks, e.passing) for e in others]
    wandering = []
    for owner, markov, walked, passing in processes:
        if markov is not None:
            markovs.append(markov)
            if walked:
                walks.append((size, 0 if walked == "gyro" else 3))
            if walked and not passing:
                wandering.append(walks[-1])
            markov_at[owner] = len(slots) + size
            size += markov.size
    kinds = tuple(o for o, _, _ in observed)
    step = np.r_[[1e-3 * s.prior_sigma for s in slots], np.full(size, 1e-5)]
    nodes, rate, dropped = _nodes(recording, [r for _, r, _ in observed], imu_constants)
    problem = Problem(
        recording,
        (*acting, *others),
        kinds,
        tuple(slots),
        imu_constants,
        tuple(markovs),
        tuple(walks),
        tuple(wandering),
        nodes,
        _tables(kinds, [c for _, _, c in observed], (*acting, *others), at, markov_at, step),
        np.zeros(len(slots)),
        g_n,
        omega_ie_n,
        rate,
        dropped,
        next((r.alpha for _, r, _ in observed if r.alpha is not None), None),
    )
    if not linearised:
        return problem
    return relinearised(problem, np.zeros(len(slots)), np.zeros(3), np.zeros(3))


def _tables(
    kinds: Sequence[Observation],
    constants: Sequence[Sequence[tuple[str, str, float]]],
    effects: Sequence[Effect],
    at: Mapping[str, int],
    markov_at: Mapping[str, int],
    step: Array,
) -> Tables:
    width = 2 + len(effects)
    function = np.zeros((len(kinds), width), dtype=np.int64)
    start = np.zeros((len(kinds), width), dtype=np.int64)
    count = np.zeros((len(kinds), width), dtype=np.int64)
    whole = np.zeros((len(kinds), width), dtype=np.int64)
    held = np.full((len(kinds), width, MOST_HELD), np.nan)
    for k, kind in enumerate(kinds):
        function[k, 0] = kind.residual
        parts = [(kind.residual, at[kind.kind], len(constants[k]))]
        if kind.markov is not None:
            parts.append((kind.markov_residual, markov_at[kind.kind], kind.markov.size))
        acting = [e for e in effects if kind.kind in e.observation_error]
        for j, e in enumerate(acting, len(parts)):
            whole[k, j] = len(e.held)
            held[k, j, : len(e.held)] = e.held
        parts += [
            (e.observation_error[kind.kind], at[e.id], len(e.parameters))
            if e.process is None
            else (e.observation_error[kind.kind], markov_at[e.id], e.process.size)
            for e in acting
        ]
        for j, part in enumerate(parts):
            function[k, j], start[k, j], count[k, j] = part
    return Tables(
        np.array([k.dim for k in kinds], dtype=np.int64),
        np.array([k.jacobian for k in kinds], dtype=np.int64),
        function,
        start,
        count,
        step,
        whole,
        held,
    )


def _nodes(
    recording: Recording, rows: Sequence[Rows], imu_constants: int
) -> tuple[Nodes, Array, int]:
    """Insert the observation times between the IMU's stamps, readings interpolated there."""
    imu = recording.imu
    ot = np.concatenate([r.t - r.delay for r in rows]) if rows else np.zeros(0)
    kind = (
        np.concatenate([np.full(len(r.t), k) for k, r in enumerate(rows)]) if rows else np.zeros(0)
    )
    z, moved = np.zeros((len(ot), Z_DIM)), np.zeros(len(ot))
    i = 0
    for r in rows:
        own = slice(i, i + len(r.t))
        z[own, : r.z.shape[1]] = r.z
        z[own, DELAY] = r.delay
        moved[own] = 0.0 if r.moved is None else r.moved
        i = own.stop
    z[:, TIME] = ot - imu.t[0]
    keep = (ot >= imu.t[0]) & (ot <= imu.t[-1])
    ot, kind, z, moved = ot[keep], kind[keep].astype(np.int64), z[keep], moved[keep]
    near = nearest(imu.t, ot)
    ot = np.where(np.abs(imu.t[near] - ot) < SNAP_S, imu.t[near], ot)
    order = np.lexsort((kind, ot))
    ot, kind, z, moved = ot[order], kind[order], z[order], moved[order]
    t = np.union1d(imu.t, ot)
    node = np.searchsorted(t, ot)
    first = np.searchsorted(node, np.arange(len(t) + 1)).astype(np.int64)
    gyro = np.stack([np.interp(t, imu.t, imu.gyro[:, k]) for k in range(3)], axis=1)
    accel = np.stack([np.interp(t, imu.t, imu.accel[:, k]) for k in range(3)], axis=1)
    rate = _smoothed_rate(recording, t)
    extra = _extra(recording, t)
    np.add.at(extra[:, 2], node, moved**2)
    nodes = Nodes(t, gyro, accel, np.zeros((len(t), 6, imu_constants)), extra, first, kind, z)
    return nodes, rate, int((~keep).sum())


def _smoothed_rate(recording: Recording, t: Array) -> Array:
    imu = recording.imu
    bias = np.median(imu.gyro, axis=0) if len(imu.t) < 10 else np.zeros(3)
    speed = np.linalg.norm(imu.gyro - bias, axis=1)
    width = max(1, round(0.3 * recording.rate_hz))
    mean = np.convolve(speed, np.ones(width) / width, mode="same")
    return np.asarray(np.interp(t, imu.t, mean))


def _extra(recording: Recording, t: Array) -> Array:
    """Variance (n, 3) added to angle, velocity and position: of the first two over intervals that
    hold no measurement."""
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
    return out

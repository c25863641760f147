"""Noise levels by maximum evidence: what the recording itself says of its noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from handcal.batch import Linear, forward
from handcal.model import Problem
from handcal.types import Array, Recording


def white_levels(recording: Recording) -> dict[str, float]:
    """White noise densities of gyro and accelerometer, a first guess from the readings.

    Second differences hardly see the motion of a hand (at 100 Hz, 10 Hz tremor counts
    2 %), and the quietest tenth of half-second windows hardly holds any.
    """
    imu, fs = recording.imu, recording.rate_hz
    out = {}
    for name, x in (("gyro_noise", imu.gyro), ("accel_noise", imu.accel)):
        d2 = np.diff(x, n=2, axis=0)
        width = max(10, round(0.5 * fs))
        m = len(d2) // width
        if m == 0:
            variance = d2.var(axis=0).mean()
        else:
            windows = (d2[: m * width].reshape(m, width, 3) ** 2).mean(axis=(1, 2))
            variance = float(np.quantile(windows, 0.1))
        quantum = 1e-9
        out[name] = math.sqrt(max(variance / 6.0, quantum**2) / fs)
    return out


def initial_levels(problem: Problem) -> dict[str, float]:
    """First guess of every level: the sensors' from the readings, the others' own."""
    levels = {lv.name: lv.initial for lv in problem.levels}
    levels.update(white_levels(problem.recording))
    for k, observation in enumerate(problem.observations):
        if observation.guess is not None:
            mine = problem.nodes.kind == k
            levels.update(observation.guess(problem.nodes.z[mine]))
    return levels


def until(linear: Linear, t: float) -> Linear:
    """The part of a linearised problem up to time t, s."""
    k = max(2, int(np.searchsorted(linear.t, t, side="right")))
    if k >= len(linear.t):
        return linear
    q = linear.first[k]
    return replace(
        linear,
        Phi=linear.Phi[:k],
        d=linear.d[:k],
        Q_gyro=linear.Q_gyro[:k],
        Q_accel=linear.Q_accel[:k],
        Q_extra=linear.Q_extra[:k],
        t=linear.t[:k],
        rate=linear.rate[:k],
        first=linear.first[: k + 1],
        kind=linear.kind[:q],
        r=linear.r[:q],
        H=linear.H[:q],
        used=linear.used[:q],
    )


def estimate(
    linear: Linear,
    levels: Mapping[str, float],
    names: Sequence[str],
    progress: Callable[[], None] | None = None,
    tolerance: float = 0.5,
) -> dict[str, float]:
    """Levels that maximise the evidence of a linearised problem, starting from ``levels``.

    names: those to estimate; the others stay. The search runs over logarithms, within
    each level's range, with a log-normal prior around its first guess (its width on either
    side is the level's own), so that a level the recording cannot see stays where it was.
    """
    own = {lv.name: lv for lv in linear.problem.levels}
    guess = initial_levels(linear.problem)
    centre = np.array([math.log(guess[n]) for n in names])
    below, above = (np.array([getattr(own[n], side) for n in names]) for side in ("below", "above"))
    bounds = {lv.name: (math.log(lv.lower), math.log(lv.upper)) for lv in linear.problem.levels}
    start = np.array([math.log(levels[n]) for n in names])
    low = np.array([bounds[n][0] for n in names])
    high = np.array([bounds[n][1] for n in names])

    def cost(x: Array) -> float:
        trial = dict(levels) | {n: math.exp(v) for n, v in zip(names, x, strict=True)}
        value = -forward(linear, trial, keep=False).log_evidence
        if progress is not None:
            progress()
        away = x - centre
        return value + 0.5 * float(((away / np.where(away < 0, below, above)) ** 2).sum())

    def gradient(x: Array) -> Array:
        # one-sided, so a level may end half a step, half a percent, off: far below its sigma
        step = 0.01
        here = cost(x)
        return np.array([(cost(x + step * e) - here) / step for e in np.eye(len(x))])

    found = minimize(
        cost,
        np.clip(start, low, high),
        jac=gradient,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 30, "ftol": tolerance / max(1.0, abs(cost(start)))},
    )
    return dict(levels) | {n: math.exp(v) for n, v in zip(names, found.x, strict=True)}

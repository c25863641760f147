"""Which of the motions that may be asked for is next: the information matrix decides.

What each motion would tell adds to what has been recorded, so of a plan only how often it holds
each motion counts. Of all plans that fit the time, the shortest that makes everything known well
enough is taken, else the one that leaves least; and of its motions the one that helps most now.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import combinations_with_replacement

import numpy as np

from handcal.design.motion import information
from handcal.effects import select
from handcal.estimate.case import case_of
from handcal.live.goals import wanted
from handcal.live.turns import CHOICE, Asked, Proposal
from handcal.motions import Motion, Z
from handcal.types import Array, HandcalError, IntArray, Parameter, Recording, Result

# Motions of a plan: as many as fit into a minute.
MOST = 5
# The worst counts, but the others a little, so that of equals the better is taken.
POWER = 8.0
BIASES = ("gyro_bias", "accel_bias")
# One that is twice as uncertain as wanted counts as much more than one at its goal; below a tenth
# of the goal nothing is gained any more.
LEAST = 0.1


def proposed(
    result: Result, recording: Recording, until: Mapping[str, float],
    choice: Sequence[Asked] = CHOICE, horizon_s: float = 60.0,
) -> Proposal | None:  # fmt: skip
    """What to ask for after a calibration; None where no motion would tell anything."""
    told = informations(result, recording, choice)
    if not told:
        return None
    goal = wanted(result.parameters, until)
    scale = np.array([p.prior_sigma for p in result.parameters])
    known = result.covariance / np.outer(scale, scale)
    at = np.flatnonzero(np.isfinite(goal))
    return best(told, known, (scale / goal)[at], at, horizon_s)


def informations(
    result: Result, recording: Recording, choice: Sequence[Asked]
) -> Mapping[Asked, Array]:
    """What each motion would tell (k, k) of the result's parameters, in units of their priors."""
    kept = {n: s for n, s in recording.streams.items() if n in ("heading", "mag", "temperature")}
    like = Recording(recording.path, recording.imu, kept)
    case = case_of(like, "fixed-point", None, 0.0)
    constant = [e for e in select(_extra(result.parameters)) if e.process is None]
    levels = {n.name: n.value for n in result.noise}
    out = {}
    for asked in choice:
        try:
            G, parameters = information(asked.motion, case, levels, constant)
        except HandcalError:
            continue
        out[asked] = _ordered(G, parameters, result.parameters)
    return out


def _extra(parameters: Sequence[Parameter]) -> list[str]:
    return list(dict.fromkeys(p.effect for p in parameters if p.effect not in BIASES))


def _ordered(G: Array, own: Sequence[Parameter], wanted: Sequence[Parameter]) -> Array:
    """G with the rows of the wanted parameters; zero for what it says nothing of."""
    names = {(p.effect, p.name): i for i, p in enumerate(own)}
    at = [names.get((p.effect, p.name), -1) for p in wanted]
    there = np.array([i >= 0 for i in at])
    index = np.array([max(i, 0) for i in at])
    return np.asarray(np.where(np.outer(there, there), G[np.ix_(index, index)], 0.0))


def best_plan(
    told: Mapping[Asked, Array], known: Array, per_goal: Array, horizon_s: float, pause_s: float
) -> tuple[str, ...]:
    """Of all plans that fit the time the one that leaves least; pause_s: before each turn of it.
    Arguments as of ``best``, for all parameters."""
    slower = {
        Asked(a.name, Motion(a.name, (*a.motion.turns, (Z, 0.0, pause_s * _turns(a))))): G
        for a, G in told.items()
    }
    at = np.arange(len(known))
    return best(slower, known, per_goal, at, horizon_s).planned


def _turns(asked: Asked) -> int:
    return sum(degrees != 0.0 for _, degrees, _ in asked.motion.turns)


def best(
    told: Mapping[Asked, Array], known: Array, per_goal: Array, at: IntArray, horizon_s: float
) -> Proposal:
    """The next of the best plan. known (k, k): covariance now; per_goal (m,): what takes the
    sigmas of the parameters ``at`` (m,) to how many times as uncertain as wanted they are."""
    asked = list(told)
    seconds = np.array([a.motion.duration_s for a in asked])
    counts = _plans(len(asked))
    fits = counts @ seconds <= max(horizon_s, float(seconds.min()))
    counts = counts[fits]
    size = len(known)
    now = np.asarray(np.linalg.inv(known + 1e-15 * np.eye(size)), dtype=np.float64)
    G = np.array([told[a] for a in asked])
    added = np.einsum("pn,nij->pij", counts, G)
    ratio = _ratios(now + added, per_goal, at)
    worst = ratio.max(axis=1)
    score = (np.maximum(ratio, LEAST) ** POWER).sum(axis=1) ** (1.0 / POWER)
    good = worst <= 1.0
    if good.any():
        length = np.where(good, counts @ seconds, np.inf)
        chosen = int(np.lexsort((score, length))[0])
    else:
        chosen = int(np.argmin(np.round(score, 9)))
    mine = np.flatnonzero(counts[chosen])
    after = _ratios(now + G[mine], per_goal, at)
    first = int(np.argmin((np.maximum(after, LEAST) ** POWER).sum(axis=1)))
    planned = tuple(asked[i].name for i in mine for _ in range(int(counts[chosen, i])))
    before = float(_ratios(now[None], per_goal, at).max())
    return Proposal(
        asked[mine[first]].name, (before, float(after[first].max()), float(worst[chosen])), planned
    )


def _ratios(information: Array, per_goal: Array, at: IntArray) -> Array:
    """How many times as uncertain as wanted (n, m), by information (n, k, k)."""
    variance = np.einsum("nii->ni", np.linalg.inv(information))[:, at]
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) * per_goal)


@cache
def _plans(n: int) -> Array:
    """How often each plan holds each of n motions, (p, n)."""
    rows = [c for k in range(1, MOST + 1) for c in combinations_with_replacement(range(n), k)]
    out = np.zeros((len(rows), n))
    for row, plan in zip(out, rows, strict=True):
        np.add.at(row, list(plan), 1.0)
    return out

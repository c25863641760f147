"""The fit of ``scalar``: parameters and directions together, and the noise beyond the readings'."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handcal.estimate import regression
from handcal.lab.norm_rows import KINDS, Problem, Rows, across, rows_of, unit
from handcal.lab.stretches import extra_variance
from handcal.lab.telling import Unseen, refuse_unseen
from handcal.types import Array, HandcalError

ROUNDS, LEVELS = 40, 12
# Steps this small, in usual sizes of the parameters, are none; while levels are sought, larger.
LAST_STEP, STEP = 1e-13, 1e-6
# So small a part of a sigma is not worth another round.
UNSEEN = 1e-3
HINT = (
    "Let the device lie still on more sides and edges, turn it about all axes between the rests, "
    "or leave effects out (--effects)."
)


@dataclass(frozen=True)
class Solution:
    """x (k,), its covariance P (k, k), directions d (r, 3), the extra noise by kind, and the rows
    shown (m, k) about x alone, of unit variance."""

    x: Array
    P: Array
    d: Array
    extra: dict[str, float]
    shown: Array


def enough(problem: Problem, spare: int = 0) -> None:
    """Errors: HandcalError without a rest; Unseen where there are fewer than unknowns and these
    to spare."""
    r = len(problem.rests)
    if r == 0:
        raise HandcalError(
            "No rest was found in this recording: let the device lie still for a few seconds in "
            "each of a dozen attitudes."
        )
    wanted = sum(u.effect.startswith("accel") for u in problem.unknowns)
    if r < wanted + spare:
        raise Unseen(
            f"{r} rests are too few for {wanted} unknowns of the accelerometer: each says "
            "one number. Let the device lie still in a dozen attitudes, on all sides and edges."
        )


def solved(problem: Problem, known: Mapping[str, float] | None) -> Solution:
    """The estimate, and the extra noise unless it is known."""
    extra = dict.fromkeys(KINDS, 0.0) if known is None else dict(known)
    x = np.zeros(len(problem.unknowns))
    d = unit(problem.rests.reading[:, 3:])
    rows = rows_of(problem, x, d)
    refuse_unseen(rows.reduced(rows.variance), problem.unknowns, noise=True, hint=HINT)
    for _ in range(LEVELS if known is None else 0):
        x, d, rows = _gauss_newton(problem, x, d, rows, extra, STEP)
        before, extra = extra, _extra(rows, extra)
        if _settled(before, extra):
            break
    x, d, rows = _gauss_newton(problem, x, d, rows, extra, LAST_STEP)
    variance = rows.total(extra)
    P = _fit(rows, variance).P[2 * len(d) :, 2 * len(d) :]
    drift = np.array([extra["gyro"] if u.effect == "gyro_bias" else 0.0 for u in problem.unknowns])
    return Solution(x, P + np.diag(drift**2), d, extra, rows.reduced(variance))


def _fit(rows: Rows, variance: Array) -> regression.Estimate:
    root = np.sqrt(variance)
    return regression.least_squares(rows.both / root[:, None], rows.y / root)


def _settled(before: Mapping[str, float], extra: Mapping[str, float]) -> bool:
    return all(abs(extra[k] - before[k]) <= 1e-3 * max(extra[k], before[k]) for k in KINDS)


def _extra(rows: Rows, extra: Mapping[str, float]) -> dict[str, float]:
    """Extra noise by kind of row with which the residuals of the estimate with that noise are as
    large as they should be, about where the rows are linearised."""
    out = dict(extra)
    for _ in range(LEVELS):
        root = np.sqrt(rows.total(out))
        fit = _fit(rows, root**2)
        left, free, before = root * fit.residual, 1.0 - fit.leverage, dict(out)
        for i, kind in enumerate(KINDS):
            m = (rows.kind == i) & (rows.unit > 0.0)
            own = rows.unit[m]
            v = extra_variance(left[m] / own, rows.variance[m] / own**2, float(free[m].sum()))
            out[kind] = float(np.sqrt(v))
        if _settled(before, out):
            break
    return out


def _gauss_newton(
    problem: Problem, x: Array, d: Array, rows: Rows, extra: Mapping[str, float], least: float
) -> tuple[Array, Array, Rows]:
    """The estimate from x and d on, at which the rows are linearised, and the rows there."""
    at = 2 * len(d)
    usual = regression.priors(problem.unknowns)
    last = np.inf
    for _ in range(ROUNDS):
        fit = _fit(rows, rows.total(extra))
        step = fit.x
        size = max(float(np.abs(step[at:] / usual).max()), float(np.abs(step[:at]).max()))
        if not np.isfinite(size) or size > 100.0:
            break
        x = x + step[at:]
        d = unit(d + np.einsum("nij,nj->ni", across(d), step[:at].reshape(-1, 2)))
        rows = rows_of(problem, x, d)
        # near the end steps are rounding, which no further round makes smaller
        done = size < least or (size < 1e-9 and size >= last)
        if done or bool(np.all(np.abs(step) < UNSEEN * fit.sigma)):
            return x, d, rows
        last = size
    raise HandcalError(
        "The readings do not fit any values of these parameters: are the units right "
        "(--units accel=g), and is this the specific force at rest?"
    )

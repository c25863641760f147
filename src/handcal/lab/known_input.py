"""Calibration against a known input: a turntable, a dividing head, a trusted IMU.

In every test (``bench``) the true rate and force are known in the axes of the table. The
readings are the truth, turned into the IMU's axes, plus the effects of the catalogue; their
parameters follow by least squares, repeated about the last estimate until nothing changes,
and by a Kalman filter over the same rows. Before that the design is asked whether it has
full rank (Kronecker and Capelli; papers 000 and 004).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from handcal.compiled.so3 import matrix_exp, matrix_log, skew
from handcal.effects import Effect, Param, Signals
from handcal.estimate import regression
from handcal.estimate.regression import BIASES, Unknown
from handcal.lab.choice import chosen
from handcal.lab.remedy import Fits, of_misfit
from handcal.lab.sound import APART, doubts, refuse_incredible
from handcal.lab.steady_tests import Bench, design, expected
from handcal.lab.stretches import extra_variance
from handcal.lab.telling import refuse_unseen
from handcal.observations.known_input import axes_between
from handcal.types import Array, HandcalError, InputError, IntArray, Parameter

DEFAULT = ("accel_scale", "accel_misalignment", "gyro_scale", "gyro_misalignment")
MOUNTING = "mounting"
ROUNDS, LEVELS = 40, 12
# Steps this small, in usual sizes of the parameters, are none; while levels are sought, larger.
LAST_STEP, STEP = 1e-13, 1e-6
# Columns of which some are no longer independent in what a number holds.
LOST = 1e15
# Columns of length one that are farther from independent than this magnify noise too much.
BAD_CONDITION = 100.0
# With fewer readings beyond the unknowns nothing is left to judge a fit by.
SPARE = 3
SENSORS = ("gyro", "accel")
HINT = "Add tests with other rates or attitudes, or leave effects out (--effects)."


def _upper(m: Array, signals: Signals) -> Array:
    out = np.zeros((len(signals.t), 6))
    f = signals.accel
    out[:, 3] = m[0] * f[:, 1] + m[1] * f[:, 2]
    out[:, 4] = m[2] * f[:, 2]
    return out


# In the table's axes, not its own, an accelerometer triad has these misalignments too.
UPPER = Effect(
    id="accel_misalignment",
    title="Accelerometer misalignment",
    parameters=tuple(Param(n, "rad", 0.01) for n in ("xy", "xz", "yz")),
    story="The accelerometer's x axis is not the table's.",
    source="paper 000, equation 1",
    motion="Gravity along each axis and between them.",
    validated="",
    imu_error=_upper,
)


@dataclass(frozen=True)
class KnownInput:
    """What the tests say.

    axes: "imu": the accelerometer's x is body x, and how the table's axes are turned into the
    IMU's, R (3, 3), is estimated (``mounting``); "table": the table's axes are the body's (so
    they are for a gyro alone, whose misalignments then say everything).
    parameters and covariance (k, k). A (m, k): the design in rows of unit variance; condition
    of it. residual (n, 6, 2): mean reading less expectation, before and after. kalman: largest
    difference of the Kalman filter's estimate, in usual sizes of the parameters. extra: standard
    deviation of the tests beyond the noise of the readings, by sensor, SI.
    """

    bench: Bench
    effects: tuple[Effect, ...]
    axes: str
    R: Array
    parameters: tuple[Parameter, ...]
    covariance: Array
    A: Array
    condition: float
    residual: Array
    kalman: float
    extra: Mapping[str, float]
    warnings: tuple[str, ...]

    @property
    def x(self) -> Array:
        """Values (k,) of the parameters."""
        return np.array([p.value for p in self.parameters])


@dataclass(frozen=True)
class _State:
    """Parameters of the effects x (k - 3,) or (k,), and R (3, 3)."""

    x: Array
    R: Array


def known_input(
    bench: Bench,
    effects: Sequence[str] = DEFAULT,
    axes: Literal["imu", "table"] = "imu",
    extra: Mapping[str, float] | None = None,
) -> KnownInput:
    """Calibrate from tests of which the input is known.

    effects: ids; biases of the sensors that were read are always estimated. extra: as in
    ``KnownInput``, where it is known already ({"gyro": 0.0, "accel": 0.0}: the variances are
    right as they are).

    Errors: InputError for effects that cannot be estimated; HandcalError where the tests do not
    tell the parameters apart, naming what they cannot see, or nothing fits.
    """
    _check_finite(bench)
    fit = _fit(bench, effects, axes, extra)
    names, state, y = fit.names, fit.state, fit.y
    root = np.sqrt(fit.variance)
    W, own = fit.A[fit.rows] / root[:, None], y[fit.rows] / root
    said: list[str] = []
    if extra is None:
        said = _misfit(bench, effects, axes, fit)
    found = regression.least_squares(W, own)
    by_filter, _ = regression.kalman(W, own)
    usual = regression.priors(names)
    values = np.r_[matrix_log(state.R), state.x] if fit.mounted else state.x
    parameters = regression.parameters(names, values, found.sigma)
    if extra is None:  # (papers have readings in units of their own)
        refuse_incredible((p.effect, p.name, p.value) for p in parameters)
    start = replace(state, x=np.zeros_like(state.x))
    before = _rows(bench, fit.acting, start, fit.mounted)[1]
    result = KnownInput(
        bench, fit.acting, "imu" if fit.mounted else "table", state.R, parameters, found.P, W,
        regression.condition(W),
        np.stack([before, y], axis=1).reshape(len(bench), 6, 2),
        float(np.abs((by_filter - found.x) / usual).max()), fit.levels, (),
    )  # fmt: skip
    return replace(result, warnings=(*_warnings(result), *said))


@dataclass(frozen=True)
class _Fit:
    """The estimate of some effects, with the rows A, y (all 6 n) about it; rows: those used, of
    variance; levels: the extra noise by sensor."""

    acting: tuple[Effect, ...]
    mounted: bool
    names: tuple[Unknown, ...]
    state: _State
    levels: Mapping[str, float]
    A: Array
    y: Array
    rows: IntArray
    variance: Array


def _fit(
    bench: Bench, ids: Sequence[str], axes: str, extra: Mapping[str, float] | None
) -> _Fit:  # fmt: skip
    """Errors: HandcalError where the tests alone, free of noise, do not tell the parameters
    apart, or nothing fits."""
    acting, mounted = _acting(bench, ids, axes)
    names = _unknowns(acting, mounted)
    rows = np.flatnonzero(np.tile(bench.used, len(bench))).astype(np.int64)
    if len(rows) < len(names):
        raise HandcalError(
            f"{len(bench)} tests give {len(rows)} readings, too few for {len(names)} unknowns. "
            + HINT
        )
    state = _start(bench, acting, mounted)
    A, _ = _rows(bench, acting, state, mounted)
    refuse_unseen(A[rows], names, hint=HINT)
    state, levels, A, y, variance = _solved(bench, acting, state, mounted, rows, extra, names)
    return _Fit(acting, mounted, names, state, levels, A, y, rows, variance)


def _misfit(bench: Bench, ids: Sequence[str], axes: str, fit: _Fit) -> list[str]:
    """What would leave less, where the fit leaves much. Errors: HandcalError where what it leaves,
    or the noise, hides parameters."""
    own = bench.variance.ravel()[fit.rows]
    by_noise, by_all = (
        regression.unseen(fit.A[fit.rows] / np.sqrt(v)[:, None], regression.priors(fit.names), True)
        for v in (own, fit.variance)
    )
    if by_noise:
        refuse_unseen(fit.A[fit.rows] / np.sqrt(own)[:, None], fit.names, noise=True, hint=HINT)
    if not by_all and all(fit.levels[s] <= APART[s] for s in SENSORS):
        return []
    sensors = tuple(s for s, used in zip(SENSORS, bench.used[::3], strict=True) if used)

    def leaves(some: Sequence[str]) -> Mapping[str, float] | None:
        try:
            other = _fit(bench, some, axes, None)
        except HandcalError:
            return None
        root = np.sqrt(other.variance)[:, None]
        spare = len(other.rows) - len(other.names) >= SPARE
        hides = regression.unseen(
            other.A[other.rows] / root, regression.priors(other.names), noise=True
        )
        return other.levels if spare and not hides else None

    def beside(some: Sequence[str]) -> float:
        return _beside(bench, some, axes, fit)

    temperature = bench.truth.temperature is not None
    said = of_misfit(Fits(leaves, beside, tuple(ids), sensors, temperature), fit.levels)
    if by_all:
        raise HandcalError(said)
    return [said]


def _beside(bench: Bench, ids: Sequence[str], axes: str, fit: _Fit) -> float:
    """What is left to first order with more effects about the estimate of a fit, weighted as it."""
    acting, mounted = _acting(bench, ids, axes)
    known = dict(zip([n.title for n in regression.unknowns(fit.acting)], fit.state.x, strict=True))
    x = np.array([known.get(n.title, 0.0) for n in regression.unknowns(acting)])
    A, y = _rows(bench, acting, _State(x, fit.state.R), mounted)
    root = np.sqrt(fit.variance)
    W, own = A[fit.rows] / root[:, None], y[fit.rows] / root
    return float(np.sum((own - W @ np.linalg.lstsq(W, own)[0]) ** 2))


def _check_finite(bench: Bench) -> None:
    if not (np.isfinite(bench.reading).all() and np.isfinite(bench.truth.accel).all()
            and np.isfinite(bench.truth.gyro).all()):  # fmt: skip
        raise InputError("The readings or the known inputs hold numbers that are not finite.")


def _acting(bench: Bench, ids: Sequence[str], axes: str) -> tuple[tuple[Effect, ...], bool]:
    """Effects with biases first, and whether the mounting is unknown."""
    T = bench.truth.temperature
    effects = chosen(ids, temperature=T is not None)
    gyro, accel = bool(bench.used[:3].any()), bool(bench.used[3:].any())
    acting = (*(b for b, there in zip(BIASES, (gyro, accel), strict=True) if there), *effects)
    if axes == "table":
        more = (UPPER,) if accel and "accel_misalignment" in ids else ()
        return (*acting, *more), False
    return acting, accel or "gyro_misalignment" not in ids


def _unknowns(acting: Sequence[Effect], mounted: bool) -> tuple[Unknown, ...]:
    turn = tuple(Unknown(MOUNTING, Param(a, "rad", 0.1)) for a in "xyz") if mounted else ()
    return (*turn, *regression.unknowns(acting))


def _start(bench: Bench, acting: Sequence[Effect], mounted: bool) -> _State:
    R = np.eye(3)
    if mounted and len(bench) > 1:
        known = bench.mean(np.hstack([bench.truth.gyro, bench.truth.accel]))
        R = axes_between(np.where(bench.used, bench.reading, 0.0), np.where(bench.used, known, 0.0))
    return _State(np.zeros(sum(len(e.parameters) for e in acting)), R)


def turned(truth: Signals, R: Array) -> Signals:
    """The truth in axes into which R (3, 3) turns it."""
    return replace(truth, gyro=truth.gyro @ R.T, accel=truth.accel @ R.T)


def _rows(
    bench: Bench, acting: Sequence[Effect], state: _State, mounted: bool
) -> tuple[Array, Array]:
    """Derivatives A (6 n, k) of the mean readings, and what is left of these, y (6 n,)."""
    truth = turned(bench.truth, state.R)
    y = bench.reading - expected(bench, acting, state.x, truth)
    J = design(bench, acting, state.x, truth)
    if mounted:
        by = regression.by_truth(acting, state.x, truth)
        turn = by @ -np.concatenate([skew(truth.gyro), skew(truth.accel)], axis=1)
        J = np.concatenate([bench.mean(turn), J], axis=2)
    return J.reshape(-1, J.shape[2]), y.ravel()


def _solved(
    bench: Bench, acting: Sequence[Effect], state: _State, mounted: bool, rows: IntArray,
    known: Mapping[str, float] | None, names: Sequence[Unknown],
) -> tuple[_State, dict[str, float], Array, Array, Array]:  # fmt: skip
    """The estimate, the extra noise, the rows about it (A, y) and variances of those used."""
    extra = dict.fromkeys(SENSORS, 0.0) if known is None else dict(known)
    own = bench.variance.ravel()[rows]
    of_accel = rows % 6 >= 3

    def about(least: float) -> tuple[Array, _State, Array, Array]:
        variance = own + np.where(of_accel, extra["accel"], extra["gyro"]) ** 2
        root = np.sqrt(variance)
        return variance, *_gauss_newton(bench, acting, state, mounted, rows, root, names, least)

    for _ in range(LEVELS if known is None else 0):
        variance, state, A, y = about(STEP)
        root = np.sqrt(variance)
        free = 1.0 - regression.least_squares(A[rows] / root[:, None], y[rows] / root).leverage
        before = extra
        extra = {
            s: float(np.sqrt(extra_variance(y[rows][m], own[m], float(free[m].sum()))))
            for s, m in zip(SENSORS, (~of_accel, of_accel), strict=True)
        }
        if all(abs(extra[s] - before[s]) <= 1e-3 * max(extra[s], before[s]) for s in SENSORS):
            break
    variance, state, A, y = about(LAST_STEP)
    return state, extra, A, y, variance


def _gauss_newton(
    bench: Bench, acting: Sequence[Effect], state: _State, mounted: bool, rows: IntArray,
    root: Array, names: Sequence[Unknown], least: float,
) -> tuple[_State, Array, Array]:  # fmt: skip
    usual = regression.priors(names)
    at = 3 if mounted else 0
    last = np.inf
    for _ in range(ROUNDS):
        A, y = _rows(bench, acting, state, mounted)
        W = A[rows] / root[:, None]
        if regression.condition(W) > LOST:  # (the way there is no further)
            break
        step = regression.least_squares(W, y[rows] / root).x
        size = float(np.abs(step / usual).max())
        R = matrix_exp(step[:3]) @ state.R if mounted else state.R
        state = _State(state.x + step[at:], R)
        if size < least or (size < 1e-6 and size >= 0.5 * last):
            return state, *_rows(bench, acting, state, mounted)
        if not np.isfinite(size):
            break
        last = size
    raise HandcalError(
        "The readings do not fit any values of these parameters: are the units right, and are "
        "the known inputs in the same order as the readings?"
    )


def _warnings(result: KnownInput) -> tuple[str, ...]:
    said = []
    if result.condition > BAD_CONDITION:
        said.append(
            f"The design is badly conditioned (condition number {result.condition:.3g} of columns "
            "of equal length): noise of the readings is magnified in some parameters."
        )
    m, k = result.A.shape
    if m - k < SPARE:
        said.append(
            f"{m} readings for {k} unknowns: nothing is left to judge the fit by, and sigmas count "
            "little but the noise within the tests."
        )
    return (*result.bench.warnings, *doubts(result.extra), *said)

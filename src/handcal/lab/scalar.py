"""Calibration against the size of gravity: no equipment but rests in many attitudes.

In each rest the accelerometer feels gravity, of which the size is known and the direction is
not; between two rests the gyro says how the direction turned. Parameters and directions are
estimated together (Gauss-Newton, repeated until nothing changes, so that no error of a
linearisation is left). A rest alone says one number of the accelerometer, as in paper 001's
scalar calibration; the turns give the gyro's scale and misalignment (Tedaldi, Pretto and
Menegatti, ICRA 2014).

Weights: the noise of the readings, as it shows within the rests, and on top of it for each
kind of row as much as its residuals show. That of the gyro in the rests is its drift, which
more rests do not average out; that of a turn is in proportion to what its samples miss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.estimate import regression
from handcal.estimate.regression import BIASES, Unknown
from handcal.lab.choice import chosen
from handcal.lab.norm_rows import KINDS, Problem, Rows, across, carried_by_gyro, rows_of, unit
from handcal.lab.sound import refuse_dead, refuse_incredible
from handcal.lab.stretches import PERFECT, Means, extra_variance, means
from handcal.lab.telling import refuse_unseen
from handcal.lab.turns import Turns, no_turns, turns
from handcal.recordings import segment
from handcal.signals import of_arrays
from handcal.types import Array, BoolArray, HandcalError, InputError, Parameter, Recording

DEFAULT = ("accel_scale", "accel_misalignment", "gyro_scale", "gyro_misalignment")
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
class Scalar:
    """What the rests of a recording say.

    parameters and covariance (k, k); gravity m/s^2; rests; norm (r, 2): error of the size of
    the measured force, m/s^2, of the readings as they are and of the calibrated ones; turns
    (q), and closure (q, 2): angle between gravity as the gyro carried it and as the
    accelerometer found it, rad, before and after. extra: standard deviation beyond the noise
    of the readings, by kind of row: accel m/s^2, gyro rad/s, turn (times what its samples miss).
    """

    recording: Recording
    effects: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    covariance: Array
    gravity: float
    rests: Means
    norm: Array
    turns: Turns
    closure: Array
    extra: Mapping[str, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Solution:
    """x (k,), its covariance P (k, k), directions d (r, 3) and the extra noise by kind."""

    x: Array
    P: Array
    d: Array
    extra: dict[str, float]


def scalar(
    recording: Recording,
    effects: Sequence[str] | None = None,
    gravity: float = STANDARD_GRAVITY,
    only: BoolArray | None = None,
    extra: Mapping[str, float] | None = None,
) -> Scalar:
    """Calibrate from the rests of a recording.

    effects: ids, else ``DEFAULT``; constant biases are always estimated. Of an accelerometer alone
    its own. gravity: m/s^2. only (r,): which of the rests that are found to use. extra: as in
    ``Scalar``, where it is known already.

    Errors: InputError for effects that rests cannot show; HandcalError where there are too
    few rests, or they do not tell the parameters apart, or nothing fits.
    """
    biases = tuple(e for e in BIASES if _of(e.id, recording.sensors))
    ids = [e for e in DEFAULT if _of(e, recording.sensors)] if effects is None else effects
    acting = (*biases, *chosen(ids, "temperature" in recording.streams))
    for e in acting:
        if not _of(e.id, recording.sensors):
            raise InputError(f"{e.id}: {recording.path} holds the accelerometer alone.")
    refuse_dead(recording)
    rests = means(recording, segment.with_pauses(recording))
    between = turns(recording, rests) if "gyro" in recording.sensors else no_turns()
    if only is not None:
        rests, between = rests.only(only), between.only(only)
    problem = Problem(acting, regression.unknowns(acting), rests, between, gravity)
    _enough(problem)
    found = _solved(problem, extra)
    sigma = np.sqrt(np.diag(found.P))
    parameters = regression.parameters(problem.unknowns, found.x, sigma)
    refuse_incredible((p.effect, p.name, p.value) for p in parameters)
    before_after = np.zeros_like(found.x), found.x
    return Scalar(
        recording, tuple(e.id for e in acting[len(biases):]), parameters, found.P, gravity, rests,
        np.stack([np.linalg.norm(_felt(problem, x), axis=1) - gravity for x in before_after], 1),
        between, np.stack([_closures(problem, x) for x in before_after], 1), found.extra,
        _warnings(problem),
    )  # fmt: skip


def _of(effect: str, sensors: Sequence[str]) -> bool:
    """Whether an effect is one of these sensors."""
    return "gyro" in sensors or not effect.startswith("gyro")


def from_poses(
    reading: Array, effects: Sequence[str] = DEFAULT[:2], gravity: float = STANDARD_GRAVITY,
    sigma: float = PERFECT,
) -> tuple[tuple[Unknown, ...], Array, Array]:  # fmt: skip
    """Parameters of the accelerometer from its mean readings (r, 3) in poses that nobody measured.

    sigma: of a mean reading, m/s^2. Returns what the parameters are, their values x (k,), the
    biases first, and covariance (k, k). Errors: as ``scalar``.
    """
    if not np.isfinite(reading).all():
        raise InputError("The readings hold numbers that are not finite.")
    acting = (BIASES[1], *chosen(effects, temperature=False))
    r = len(reading)
    variance = np.tile(np.repeat([PERFECT, sigma], 3) ** 2, (r, 1))
    rests = Means(
        np.zeros((r, 2)), np.arange(r), np.arange(r), np.ones(r),
        np.hstack([np.zeros((r, 3)), reading]), variance, None, np.zeros(6),
    )  # fmt: skip
    problem = Problem(acting, regression.unknowns(acting), rests, no_turns(), gravity)
    _enough(problem)
    found = _solved(problem, dict.fromkeys(KINDS, 0.0))
    return problem.unknowns, found.x, found.P


def halves(result: Scalar) -> tuple[Scalar, Scalar]:
    """The same calibration from the first half of the rests alone, and from the second, at the
    noise that all show together. Errors: HandcalError where a half cannot tell the parameters."""
    first = np.arange(len(result.rests)) < len(result.rests) // 2
    a, b = (
        scalar(result.recording, result.effects, result.gravity, only, result.extra)
        for only in (first, ~first)
    )
    return a, b


def halves_or_none(result: Scalar) -> tuple[Scalar, ...]:
    """``halves``, or nothing where half of the rests are too few."""
    try:
        return halves(result)
    except HandcalError:
        return ()


def _enough(problem: Problem) -> None:
    r = len(problem.rests)
    if r == 0:
        raise HandcalError(
            "No rest was found in this recording: let the device lie still for a few seconds in "
            "each of a dozen attitudes."
        )
    wanted = sum(u.effect.startswith("accel") for u in problem.unknowns)
    if r < wanted:
        raise HandcalError(
            f"{r} rests are too few for {wanted} unknowns of the accelerometer: each says "
            "one number. Let the device lie still in a dozen attitudes, on all sides and edges."
        )


def _solved(problem: Problem, known: Mapping[str, float] | None) -> _Solution:
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
    refuse_unseen(rows.reduced(variance), problem.unknowns, noise=True, hint=HINT)
    P = _fit(rows, variance).P[2 * len(d) :, 2 * len(d) :]
    drift = np.array([extra["gyro"] if u.effect == "gyro_bias" else 0.0 for u in problem.unknowns])
    return _Solution(x, P + np.diag(drift**2), d, extra)


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


def _felt(problem: Problem, x: Array) -> Array:
    """Specific forces (r, 3) of the mean readings less the errors."""
    rests = problem.rests
    read = of_arrays(
        rests.span.mean(axis=1), rests.reading[:, :3], rests.reading[:, 3:], rests.temperature
    )
    return regression.truth_of(problem.effects, x, read)[0].accel


def _closures(problem: Problem, x: Array) -> Array:
    """Angles (q,) rad by which gravity as the gyro carried it misses where it is."""
    d = unit(_felt(problem, x))
    C, _ = carried_by_gyro(problem, x, d)
    carried = np.einsum("nji,nj->ni", C, d[problem.turns.before])
    there = d[problem.turns.after]
    apart = np.linalg.norm(np.cross(carried, there), axis=1)
    return np.asarray(np.arctan2(apart, np.einsum("ni,ni->n", carried, there)))


def _warnings(problem: Problem) -> tuple[str, ...]:
    said = []
    if problem.turns.lost:
        said.append(
            f"{problem.turns.lost} of the turns between rests could not be used: readings of "
            "the gyro are saturated or missing there."
        )
    spare = len(problem.rests) - sum(u.effect.startswith("accel") for u in problem.unknowns)
    if spare < 3:
        said.append(
            f"There are {spare} rests more than unknowns of the accelerometer: the fit can hardly "
            "be checked by itself, and sigmas count little but the noise within the rests."
        )
    return tuple(said)

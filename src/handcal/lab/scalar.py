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
from dataclasses import dataclass, replace

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.estimate import regression
from handcal.estimate.regression import BIASES, Unknown
from handcal.lab.choice import chosen
from handcal.lab.few_rests import that_would, with_remedy
from handcal.lab.norm_fit import HINT, Solution, enough, solved
from handcal.lab.norm_rows import KINDS, Problem, carried_by_gyro, unit
from handcal.lab.sound import refuse_dead, refuse_incredible
from handcal.lab.stretches import PERFECT, Means, means
from handcal.lab.telling import Unseen, refuse_unseen
from handcal.lab.turns import Turns, no_turns, turns
from handcal.recordings import segment
from handcal.signals import of_arrays
from handcal.types import Array, BoolArray, HandcalError, InputError, Parameter, Recording

# So many rests may be too few.
FEW = (6, 15)
DEFAULT = ("accel_scale", "accel_misalignment", "gyro_scale", "gyro_misalignment")


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
    problem = _problem(recording, effects, gravity)
    if only is not None:
        problem = replace(problem, rests=problem.rests.only(only), turns=problem.turns.only(only))
    try:
        found = _found(problem, extra)
    except Unseen as refused:
        if only is not None:  # (a part of the rests, of which nothing is asked)
            raise
        raise HandcalError(with_remedy(refused, problem, recording.sensors)) from None
    sigma = np.sqrt(np.diag(found.P))
    parameters = regression.parameters(problem.unknowns, found.x, sigma)
    refuse_incredible((p.effect, p.name, p.value) for p in parameters)
    before_after = np.zeros_like(found.x), found.x
    return Scalar(
        recording, tuple(e.id for e in problem.effects if e not in BIASES), parameters, found.P,
        gravity, problem.rests,
        np.stack([np.linalg.norm(_felt(problem, x), axis=1) - gravity for x in before_after], 1),
        problem.turns, np.stack([_closures(problem, x) for x in before_after], 1), found.extra,
        _warnings(problem),
    )  # fmt: skip


def _problem(recording: Recording, effects: Sequence[str] | None, gravity: float) -> Problem:
    """The rests and turns of a recording, and what is asked of them. Errors: InputError."""
    biases = tuple(e for e in BIASES if _of(e.id, recording.sensors))
    ids = [e for e in DEFAULT if _of(e, recording.sensors)] if effects is None else effects
    acting = (*biases, *chosen(ids, "temperature" in recording.streams))
    for e in acting:
        if not _of(e.id, recording.sensors):
            raise InputError(f"{e.id}: {recording.path} holds the accelerometer alone.")
    refuse_dead(recording)
    rests = means(recording, segment.with_pauses(recording))
    between = turns(recording, rests) if "gyro" in recording.sensors else no_turns()
    return Problem(acting, regression.unknowns(acting), rests, between, gravity)


def _found(problem: Problem, extra: Mapping[str, float] | None) -> Solution:
    """Errors: Unseen where the rests do not show all that is asked; HandcalError."""
    enough(problem)
    found = solved(problem, extra)
    refuse_unseen(found.shown, problem.unknowns, noise=True, hint=HINT)
    return found


def of_few_rests(recording: Recording) -> str:
    """What ``scalar`` makes of so few rests that they may be too few, in a sentence; "" where
    there are more, or too few for anything."""
    if not FEW[0] <= len(segment.each_rest(recording)) <= FEW[1]:
        return ""
    try:
        problem = _problem(recording, None, STANDARD_GRAVITY)
        _found(problem, None)
    except Unseen:
        would = that_would(problem, recording.sensors)
        return f"They are few for all of handcal lab scalar. {would}".strip()
    except HandcalError:  # (which says more than their number)
        return ""
    return "They show all that handcal lab scalar asks of them."


def _of(effect: str, sensors: Sequence[str]) -> bool:
    """Whether an effect is one of these sensors."""
    return "gyro" in sensors or not effect.startswith("gyro")


def from_poses(
    reading: Array, effects: Sequence[str] = DEFAULT[:2], gravity: float = STANDARD_GRAVITY,
    sigma: float = PERFECT,
) -> tuple[tuple[Unknown, ...], Array, Array]:  # fmt: skip
    """Parameters of the accelerometer from its mean readings (r, 3) in unmeasured poses.

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
    found = _found(problem, dict.fromkeys(KINDS, 0.0))
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

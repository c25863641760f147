"""Which turn in the hand, made next, would reduce the uncertainty of chosen parameters most.

Each motion of ``design`` (and some more) is linearised about the truth, observed as the recording
before it was; the information that its readings add to what is known already gives the sigmas
afterwards. Biases are those of one session: the motion is taken to follow at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.effects import Effect, select
from handcal.estimate.baseline import always
from handcal.estimate.calibration import calibrate
from handcal.estimate.case import Case, applicable, case_of
from handcal.explain.next_motion import motion_pass
from handcal.motions import MOTIONS, REST, Motion, Turn, X, Y, Z
from handcal.types import Array, HandcalError, Imu, InputError, Parameter, Recording, Result, Series

BIASES = ("gyro_bias", "accel_bias")
# A device of which nothing is known yet: its rates, and how long it is looked at, s.
IMU_HZ, HEADING_HZ, GLANCE = 100.0, 50.0, 5.0
DOWN = 3.0
Progress = Callable[[float], None]


def _rested(*turns: Turn) -> tuple[Turn, ...]:
    return ((Z, 0.0, REST), *turns, (Z, 0.0, REST))


def _there_and_back(axis: tuple[float, float, float], seconds: float) -> tuple[Turn, ...]:
    return ((axis, 360.0, seconds), (axis, -360.0, seconds))


WHEEL = _rested((X, 90.0, DOWN), *_there_and_back(Z, 10.0), (X, -90.0, DOWN))
MORE = (
    Motion(
        "Hold it upright, screen towards you, and turn it once like a steering wheel and back, "
        "ten seconds each way.",
        WHEEL,
    ),
    Motion(
        "Turn it once about its x axis (to the right) and back, once about its y axis (to the "
        "top) and back, then upright once like a steering wheel and back, five seconds each way.",
        _rested(
            *_there_and_back(X, 5.0), *_there_and_back(Y, 5.0), (X, 90.0, DOWN),
            *_there_and_back(Z, 5.0), (X, -90.0, DOWN),
        ),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Prospect:
    """A motion, and the sigmas (w,) of the wanted parameters after it, in their own units;
    times: by how much they shrink, the geometric mean."""

    motion: Motion
    sigma: Array
    times: float


@dataclass(frozen=True)
class Plan:
    """What to do next.

    wanted: the parameters as they are known before, w of them (value 0 where nothing has been
    recorded). prospects: motions, the best first. result: the calibration before, or None.
    """

    wanted: tuple[Parameter, ...]
    prospects: tuple[Prospect, ...]
    result: Result | None
    kinds: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def best(self) -> Prospect:
        """The first of the prospects."""
        return self.prospects[0]


def plan(
    wanted: Sequence[str],
    recording: Recording | None = None,
    *,
    beside: Sequence[str] = (),
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    progress: Progress | None = None,
) -> Plan:
    """The motions in the order of what they do for the wanted effects (ids, biases too).

    recording: what has been recorded already; beside: ids of effects that are unknown too.
    heading_sigma: rad; without a recording it says that there is a heading.

    Errors: InputError for effects that are no constants, or that the recording's streams
    cannot show; HandcalError where no motion would tell anything.
    """
    report = progress or (lambda _: None)
    effects = _effects(wanted, beside)
    result, levels = None, {}
    before = np.zeros(0)
    if recording is None:
        case = case_of(_nothing(heading_sigma), "fixed-point", latitude, height)
        levels = {} if heading_sigma is None else {"heading_noise": heading_sigma}
    else:
        result = calibrate(
            recording, [e.id for e in effects], assume=assume, heading_sigma=heading_sigma,
            latitude=latitude, height=height, only=True, progress=lambda f: report(0.8 * f),
        )  # fmt: skip
        levels = {n.name: n.value for n in result.noise}
        before = result.covariance
        case = case_of(recording, result.assume, latitude, height)
    _check(case, effects)
    # (those of every fit, of a magnetometer its iron, are unknown after the motion as well)
    own = {e.id for e in effects}
    effects = (*(e for e in always([case]) if e.id not in own), *effects)
    informations, parameters = _informations(case, levels, effects, lambda f: report(0.8 + 0.2 * f))
    if result is not None:
        have = [(p.effect, p.name) for p in result.parameters]
        at = [have.index((p.effect, p.name)) for p in parameters]
        parameters, before = tuple(result.parameters[i] for i in at), before[np.ix_(at, at)]
    scale = np.array([p.prior_sigma for p in parameters])
    known = np.eye(len(scale)) if result is None else before / np.outer(scale, scale)
    index = [i for w in dict.fromkeys(wanted) for i, p in enumerate(parameters) if p.effect == w]
    return Plan(
        tuple(parameters[i] for i in index), _prospects(informations, known, scale, index),
        result, case.kinds, () if result is None else result.warnings,
    )  # fmt: skip


def _informations(
    case: Case, levels: Mapping[str, float], effects: Sequence[Effect], report: Progress
) -> tuple[dict[Motion, Array], tuple[Parameter, ...]]:
    """What each motion that these streams allow would tell, and the parameters that it is of."""
    motions = [m for m in (*MOTIONS, *MORE)
               if not m.warming or "temperature" in case.recording.streams]  # fmt: skip
    informations: dict[Motion, Array] = {}
    parameters: tuple[Parameter, ...] = ()
    for i, motion in enumerate(motions):
        try:
            G, parameters = information(motion, case, levels, effects)
        except HandcalError:
            continue
        informations[motion] = G
        report((i + 1) / len(motions))
    if not informations:
        raise HandcalError("None of the motions can be made sense of with these streams.")
    return informations, parameters


def _prospects(
    informations: Mapping[Motion, Array], known: Array, scale: Array, index: Sequence[int]
) -> tuple[Prospect, ...]:
    """What each motion would leave of the parameters ``index``, the best first; known (m, m): their
    covariance before, in units of the priors' ``scale`` (m,)."""
    at = list(index)
    first = np.sqrt(np.diag(known))[at]
    prospects = []
    for motion, G in informations.items():
        sigma = np.sqrt(np.diag(updated(known, G)))[at]
        times = math.exp(float(np.log(first / sigma).mean()))
        prospects.append(Prospect(motion, sigma * scale[at], times))
    prospects.sort(key=lambda p: (-round(p.times, 6), p.motion.duration_s))
    return tuple(prospects)


def _effects(wanted: Sequence[str], beside: Sequence[str]) -> tuple[Effect, ...]:
    if not wanted:
        raise InputError("No parameters are named that are to become more certain.")
    effects = select([i for i in (*wanted, *beside) if i not in BIASES])
    for e in effects:
        if e.process is not None or e.outliers or e.moments is not None:
            raise InputError(f"{e.id} is no constant that a motion could tell better.")
    return effects


def _check(case: Case, effects: Sequence[Effect]) -> None:
    for e in effects:
        if not applicable(case, e):
            raise InputError(
                f"{e.id} cannot be told here: the recording has {', '.join(case.kinds)}."
                if case.recording.streams
                else f"{e.id} cannot be told by an IMU alone (--after FILE with its streams)."
            )


def _nothing(heading_sigma: float | None) -> Recording:
    """A device that lies level for a moment."""
    t = np.arange(0.0, GLANCE, 1.0 / IMU_HZ)
    accel = np.tile([0.0, 0.0, STANDARD_GRAVITY], (len(t), 1))
    imu = Imu(t, np.zeros_like(accel), accel, np.ones(len(t), dtype=np.bool_))
    streams = {}
    if heading_sigma is not None:
        own = np.arange(0.0, GLANCE, 1.0 / HEADING_HZ)
        streams["heading"] = Series(own, np.zeros((len(own), 1)))
    return Recording("nothing recorded yet", imu, streams)


def information(
    motion: Motion, case: Case, levels: Mapping[str, float], effects: Sequence[Effect]
) -> tuple[Array, tuple[Parameter, ...]]:
    """G (k, k) of biases and effects in units of their priors, everything else integrated out,
    and the parameters as they are before anything is known."""
    done = motion_pass(motion, case, levels, effects)
    problem, G = done.reduction.linear.problem, done.log_likelihood[2]
    ids = {e.id for e in effects}
    slots = [(6 + i, s) for i, s in enumerate(problem.slots) if s.owner in ids]
    mine = [*range(6), *(i for i, _ in slots)]
    rest = [i for i in range(len(G)) if i not in mine]
    cross = G[np.ix_(mine, rest)]
    inner = G[np.ix_(rest, rest)] + np.eye(len(rest))
    told = G[np.ix_(mine, mine)] - cross @ np.linalg.solve(inner, cross.T)
    names = [(b, a, u) for b, u in zip(BIASES, ("rad/s", "m/s^2"), strict=True) for a in "xyz"]
    names += [(s.owner, s.name, s.unit) for _, s in slots]
    sigma = done.reduction.scale[mine]
    return told, tuple(
        Parameter(e, n, 0.0, float(s), u, float(s), None)
        for (e, n, u), s in zip(names, sigma, strict=True)
    )


def updated(P: Array, G: Array) -> Array:
    """Covariance (k, k) once information G (k, k) is added: (P^-1 + G)^-1 without P^-1."""
    L = np.linalg.cholesky(0.5 * (P + P.T) + 1e-15 * np.eye(len(P)))
    inner = np.eye(len(P)) + L.T @ G @ L
    half = np.linalg.solve(np.linalg.cholesky(0.5 * (inner + inner.T)), L.T)
    return np.asarray(half.T @ half)

"""A fit as a ``Result``: parameters, histories, innovations, and what to say about them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import BASE
from handcal.estimate import noise_levels, smoother
from handcal.estimate.case import no_fit
from handcal.estimate.linear import About, Linear, linearise_about
from handcal.estimate.model import Fitted, Model
from handcal.estimate.parameters import Known, Moment, known, likelihood
from handcal.estimate.pieces import is_long, known_reduced, reduced, starts
from handcal.estimate.problem import Problem, constants_of
from handcal.estimate.rest_only import DOUBTED, doubt
from handcal.estimate.robust import inflation
from handcal.estimate.sampling import interpolated
from handcal.estimate.standing import known_as, standing_of
from handcal.estimate.trajectory import Trajectory, path
from handcal.observations import magnetometer
from handcal.types import (
    Array,
    HandcalError,
    History,
    Innovations,
    IntArray,
    NoiseLevel,
    Parameter,
    Prior,
    Result,
    Standing,
)

MOVED = (
    "The estimate still moved after ten rounds of relinearisation; the motion may be "
    "too poor for all that was asked, so trust the sigmas less."
)
# Rows of a history: as many a second, and no more numbers in all its covariances.
HISTORY_RATE, HISTORY_NUMBERS = 25.0, 4_000_000
# Gravity that strays less than this from its mean stays along one axis.
STEADY_GRAVITY = math.radians(20.0)


def results(model: Model, moments: Mapping[str, Moment]) -> tuple[Result, ...]:
    """What a settled fit says of each of its recordings.

    moments: of effects that are held at one, by id. Raises HandcalError for a fit that diverged.
    """
    if not math.isfinite(model.log_evidence):
        raise no_fit([part.case.recording for part in model.parts])
    model = replace(
        model, parts=tuple(replace(f, about=known_reduced(f.about)) for f in model.parts)
    )
    excess = inflation(model)
    return tuple(
        replace(
            _result(model, k, known(model, k, excess, moments)),
            likelihood=likelihood(model, k, excess),
        )
        for k in range(len(model.parts))
    )


def _result(model: Model, k: int, found: Known) -> Result:
    f = model.parts[k]
    dense, rows, forward, smooth = _passes(f)
    problem = dense.problem
    _check_covariances(forward.P, dense.t[rows])
    history = _history(dense, rows, found, forward.x, forward.P)
    # (the covariances are the largest thing here: of the filter's, the last is left)
    forward = replace(forward, x=forward.x[-1:].copy(), P=forward.P[-1:].copy())
    standing = _standing(dense, forward, found)
    smoothed = _history(dense, rows, found, *smooth(forward))
    innovations = _innovations(dense, forward)
    parameters, covariance = _walked(problem, found, smoothed)
    recording = f.case.read or f.case.recording
    return Result(
        recording=recording,
        assume=f.case.assume,
        parameters=tuple(
            replace(p, converged_at_s=_converged(history, i, p)) for i, p in enumerate(parameters)
        ),
        covariance=covariance,
        noise=noise(f),
        history=history,
        smoothed=smoothed,
        innovations=innovations,
        log_evidence=model.log_evidence,
        rests=f.case.rests,
        warnings=tuple(dict.fromkeys(_warnings(f, problem, model.settled, innovations))),
        observed_heading=_observed_heading(dense),
        settled=model.settled,
        before=f.case.before,
        doubts=tuple(_doubts(f)),
        standing=standing,
        marker=found.marker,
    )


# What the smoother says at the rows that are shown, once the filter's last state is known.
Smooth = Callable[[smoother.Pass], tuple[Array, Array]]


def _passes(f: Fitted) -> tuple[Linear, IntArray, smoother.Pass, Smooth]:
    """The fit linearised for showing, the epochs that are shown (k,), the filter's pass, and what
    the smoother makes of it; of a long recording piece by piece, where windows begin."""
    if not is_long(f.problem, f.trajectory):
        dense = _known_before(_dense(f), f.case.before)
        rows = _shown(dense)
        forward = smoother.forward(dense, f.levels, rows=rows)
        return dense, rows, forward, partial(_smoothed, dense, f.levels, rows)
    about, before = f.about, f.case.before
    if before is not None:
        about = replace(about, problem=_with_known(f.problem, before))
    t, begin = f.t, starts(about.problem, f.trajectory)
    step = math.ceil(len(begin) / _row_count(about.problem))
    last = len(t) - 1
    some = np.arange(0, len(begin), step)[: None if begin[-1] < last else -1]
    rows = np.r_[begin[some], last]
    forward, dense = smoother.forward_by_pieces(about, f.levels, rows)
    return dense, rows, forward, partial(_smoothed_by_pieces, about, f.levels, some)


def _smoothed(
    dense: Linear, levels: Mapping[str, float], rows: IntArray, forward: smoother.Pass
) -> tuple[Array, Array]:
    return smoother.smooth(dense, levels, forward, rows)


def _smoothed_by_pieces(
    about: About, levels: Mapping[str, float], some: IntArray, forward: smoother.Pass
) -> tuple[Array, Array]:
    """Errors and covariances at the windows ``some``, and at the last epoch the filter's own."""
    x, P = smoother.smooth_reduced(reduced(about), levels, some)
    return np.vstack([x, forward.x[-1:]]), np.concatenate([P, forward.P[-1:]])


def _standing(dense: Linear, forward: smoother.Pass, found: Known) -> Standing:
    """The last epoch, its parameters as well known as the fit knows them."""
    t = float(dense.t[-1])
    own = standing_of(dense.problem, t, dense.trajectory, forward.x[-1], forward.P[-1])
    names = [(p.effect, p.name) for p in found.parameters]
    mean = np.array([p.value for p in found.parameters])
    return known_as(own, names, mean, found.covariance)


def _check_covariances(P: Array, t: Array) -> None:
    for own, at in zip(P, t, strict=True):
        check_covariance(own, float(at))


def check_covariance(P: Array, t: float) -> None:
    """Errors: HandcalError where a variance of P (n, n) is negative or none at t (s): float64 has
    16 digits, and beside a velocity unknown by 1e8 m/s what is known of a bias is round-off."""
    if not np.all(np.diag(P) >= 0.0):
        raise HandcalError(
            f"The filter lost its covariance at {t:.1f} s: the readings fit no motion so far that "
            "the numbers no longer hold what is known; check units, axes and stamps."
        )


def _warnings(
    f: Fitted, problem: Problem, settled: bool, innovations: Mapping[str, Innovations]
) -> Iterator[str]:
    """What there is to doubt about a recording's results, in sentences."""
    yield from f.case.warnings
    if not settled:
        yield MOVED
    if problem.dropped:
        yield f"{problem.dropped} observations lie outside the IMU's time and were left out."
    for kind, i in innovations.items():
        if i.skipped:
            yield f"{i.skipped} observations of {kind} were skipped (body x near the vertical)."
    yield from _gravity_stays(f.trajectory.C, f.case.assume == "rest-only")
    yield from _contradicting_heading(problem, f.levels)


def _doubts(f: Fitted) -> Iterator[str]:
    """Why the hand may be another than was assumed."""
    yield from (w for w in f.case.warnings if w.startswith(DOUBTED))
    if said := doubt(f):
        yield said


def noise(f: Fitted) -> tuple[NoiseLevel, ...]:
    """The noise levels of one recording."""
    return tuple(
        NoiseLevel(lv.name, f.levels[lv.name], lv.unit, lv.name not in f.case.fixed)
        for lv in f.problem.levels
    )


def _dense(f: Fitted) -> Linear:
    """The fit linearised at more moments than those at which something is observed, for showing:
    between two looks at a held point a device turns far.
    """
    linear = f.linear
    t, node = linear.problem.nodes.t, linear.trajectory.node
    rows = _row_count(linear.problem)
    if rows < 2 * len(node) or not linear.problem.navigated:
        return linear
    wanted = np.searchsorted(t, np.linspace(t[0], t[-1], rows))
    more = np.unique(np.r_[node, wanted.clip(max=len(t) - 1)])
    old, new = t[node], t[more]
    nominal = linear.trajectory
    way = path(linear.problem, nominal)
    dense: Trajectory = replace(
        nominal, node=more, p=way.p[more], v=way.v[more], C=way.C[more],
        markov=interpolated(new, old, nominal.markov),
    )  # fmt: skip
    out = linearise_about(linear.problem, linear.start, dense)
    x, _ = smoother.smoothed_mean(out, f.levels)
    return linearise_about(linear.problem, linear.start, smoother.moved(out.trajectory, x))


def _known_before(linear: Linear, before: Prior | None) -> Linear:
    """The problem with what was known of each of its constants, for histories."""
    return replace(linear, problem=_with_known(linear.problem, before))


def _with_known(problem: Problem, before: Prior | None) -> Problem:
    if before is None:
        return problem
    at = {n: k for k, n in enumerate(before.names)}
    slots = tuple(
        replace(s, prior_mean=float(before.mean[k]), prior_sigma=math.sqrt(before.covariance[k, k]))
        if (k := at.get((s.owner, s.name), -1)) >= 0
        else s
        for s in problem.slots
    )
    return replace(problem, slots=slots)


def _walked(
    problem: Problem, found: Known, smoothed: History
) -> tuple[tuple[Parameter, ...], Array]:
    """The parameters, of a walking bias its mean over the recording, with the mean of its sigmas
    (at most that is the sigma of the mean); and their covariance."""
    if not problem.wandering:
        return found.parameters, found.covariance
    parameters = list(found.parameters)
    scale = np.ones(len(parameters))
    for i in (column + i for _, column in problem.wandering for i in range(3)):
        p = parameters[i]
        sigma = float(smoothed.parameter_sigma[:, i].mean())
        value = float(smoothed.parameters[:, i].mean())
        scale[i] = sigma / p.sigma
        parameters[i] = replace(p, value=value, sigma=sigma)
    return tuple(parameters), found.covariance * np.outer(scale, scale)


def _variances(problem: Problem, P: Array) -> Array:
    """Variances (k, N) of covariances P (k, N, N), of the biases as they are at each moment, walks
    included."""
    out = np.einsum("kii->ki", P).copy()
    walks = [(BASE + problem.constants + state, 9 + column) for state, column in problem.wandering]
    for column in {column for _, column in walks}:
        for i in range(3):
            own = np.array([column + i, *(state + i for state, at in walks if at == column)])
            out[:, column + i] = P[:, own[:, None], own].sum(axis=(1, 2))
    return np.asarray(out)


def _row_count(problem: Problem) -> int:
    """How many rows a history has: as many a second, and no more than memory holds."""
    span = float(problem.nodes.t[-1] - problem.nodes.t[0])
    return max(1, int(min(HISTORY_RATE * span, HISTORY_NUMBERS / problem.size**2)))


def _shown(linear: Linear) -> IntArray:
    """Epochs that are enough to look at, the last one among them."""
    step = max(1, round(len(linear.t) / _row_count(linear.problem)))
    last = len(linear.t) - 1
    return np.unique(np.r_[np.arange(0, last + 1, step), last]).astype(np.int64)


def _history(linear: Linear, rows: IntArray, found: Known, x: Array, P: Array) -> History:
    """The nominal trajectory at the epochs ``rows`` (k,) plus the estimated errors x (k, N)."""
    nominal, problem = linear.trajectory, linear.problem
    C = so3.rotations(x[:, 6:9]) @ nominal.C[rows]
    whole = np.r_[nominal.bg, nominal.ba, nominal.constants]
    at = 9 + np.array(found.column)
    variance = _variances(problem, P)
    parameters = whole[at - 9] + x[:, at]
    sigma = np.sqrt(np.maximum(variance[:, at], 0.0))
    for i, k in enumerate(found.column):
        if k < 0:
            parameters[:, i], sigma[:, i] = found.parameters[i].value, found.parameters[i].sigma
    for state, column in problem.wandering:
        own = BASE + problem.constants + state
        walk = nominal.markov[rows, state : state + 3] + x[:, own : own + 3]
        parameters[:, column : column + 3] += walk
    return History(
        t=linear.t[rows],
        p_n=nominal.p[rows] + x[:, 0:3],
        v_n=nominal.v[rows] + x[:, 3:6],
        q_nb=so3.quaternion_of(C),
        yaw=so3.yaw_of(C),
        nav_sigma=np.sqrt(np.maximum(variance[:, :9], 0.0)),
        parameters=parameters,
        parameter_sigma=sigma,
    )


def _converged(history: History, i: int, p: Parameter) -> float | None:
    """Time, s, from which the estimate stays within three of its final sigmas, and observable.

    None where the final sigma is not below half the prior. A walking bias never stays: all that
    can converge is how well it is known.
    """
    value, sigma, t = history.parameters[:, i], history.parameter_sigma[:, i], history.t
    if not (p.shown and sigma[-1] < 0.5 * p.prior_sigma):
        return None
    away = (np.abs(value - value[-1]) > 3.0 * sigma[-1]) | (sigma >= 0.5 * p.prior_sigma)
    last = np.flatnonzero(away)
    return float(t[0] if not len(last) else t[min(last[-1] + 1, len(t) - 1)])


def _innovations(linear: Linear, forward: smoother.Pass) -> dict[str, Innovations]:
    t = np.repeat(linear.t, np.diff(linear.first))
    out = {}
    for k, observation in enumerate(linear.problem.observations):
        mine = linear.kind == k
        used = mine & linear.used
        d = observation.dim
        out[observation.kind] = Innovations(
            t=t[used],
            residual=forward.residual[used, :d],
            sigma=forward.sigma[used, :d],
            nis=forward.nis[used],
            skipped=int((mine & ~linear.used).sum()),
            unit=observation.unit,
            channels=observation.channels,
        )
    return out


def _observed_heading(linear: Linear) -> Array | None:
    """What was measured of the heading, (k, 2): t and rad."""
    t = np.repeat(linear.t, np.diff(linear.first))
    at = np.repeat(np.arange(len(linear.t)), np.diff(linear.first))
    for k, observation in enumerate(linear.problem.observations):
        mine = (linear.kind == k) & linear.used
        C_nb = linear.trajectory.C[at[mine]]
        if observation.channels == ("heading",):
            off = linear.r[mine, 0]
        elif observation.kind == "magnetometer":
            theta = constants_of(linear.problem, linear.trajectory.constants, observation.kind)
            north = linear.problem.nodes.z[mine, magnetometer.HORIZONTAL] + theta[0]
            off = magnetometer.heading_off(C_nb, linear.r[mine, :3], north)
        else:
            continue
        return np.stack([t[mine], so3.wrap(so3.yaw_of(C_nb) + off)], axis=1)
    return None


def _contradicting_heading(problem: Problem, levels: Mapping[str, float]) -> list[str]:
    """A warning where headings agree among themselves, but not with the gyro."""
    shown = noise_levels.initial_levels(problem).get("heading_noise")
    found = levels.get("heading_noise")
    if shown is None or found is None or found < 3.0 * shown:
        return []
    return [
        f"The headings scatter by {math.degrees(found):.0f} deg about the gyro's, but only by "
        f"{math.degrees(shown):.1f} deg from one to the next: is it a bearing that counts "
        "clockwise, or do the accelerometer's signs point down instead of up?"
    ]


def _gravity_stays(C_nb: Array, rests: bool) -> list[str]:
    """A warning where gravity never leaves one body axis: bias and scale are one there. rests:
    they alone are looked at."""
    up = C_nb[:, 2]
    mean = up.mean(axis=0)
    mean /= np.linalg.norm(mean)
    axis = int(np.argmax(np.abs(mean)))
    if np.min(up @ mean) < math.cos(STEADY_GRAVITY) or abs(mean[axis]) < 0.9:
        return []
    return [
        f"Gravity stays along body {'xyz'[axis]} {'in the rests' if rests else 'throughout'}: the "
        "accelerometer's bias on that axis holds its scale error and any error of the local "
        "gravity too. Turn the device over to tell them apart."
    ]

"""``calibrate``: from a recording to what is known of its sensors.

1. segment the recording, choose observations and the assumption about the hand,
2. filter once as a live filter would (``filter``),
3. smooth, relinearise and find the noise levels by evidence (``batch``, ``noise``),
4. filter once more about the settled trajectory; that pass is the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal import batch, segment, so3
from handcal import noise as noise_levels
from handcal.earth import local_earth
from handcal.effects import Effect, mag_hard_iron, select
from handcal.filter import ENGINES, State, empty_track, initial_state
from handcal.kernel import BASE
from handcal.linear import Linear, Trajectory, epochs, linearise_about, trajectory_of
from handcal.model import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Problem, build, noise_arrays
from handcal.observations import Observation, Rows, Scene, catalogue
from handcal.start import Start, from_pose, from_rest, levelled
from handcal.sway import TRAVEL_NATS, beyond_a_hand, sway_of
from handcal.types import (
    Array,
    HandcalError,
    History,
    Innovations,
    InputError,
    NoiseLevel,
    Parameter,
    Recording,
    Result,
)

Progress = Callable[[float], None]
Observed = tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]
ASSUMPTIONS = ("auto", "fixed-point", "rest-only")
LOST_NATS = 10.0
MIN_READINGS = 20
HISTORY_RATE = 25.0
PSEUDO_RATE = 10.0
STEADY_GRAVITY = math.radians(20.0)
UNKNOWN_YAW = math.radians(100.0)
FIXED_YAW = 1e-6


@dataclass(frozen=True)
class Solution:
    """A settled fit: the linearised problem, its last forward pass and its noise levels."""

    linear: Linear
    forward: batch.Pass
    levels: Mapping[str, float]
    estimated: tuple[str, ...]
    settled: bool


@dataclass(frozen=True)
class Choice:
    """What is assumed of the hand, the kinds of observation to use, what was left out or found,
    in words; and noise levels seen on the way, where a search may begin."""

    assume: str
    kinds: list[str]
    warnings: list[str]
    levels: Mapping[str, float]


def calibrate(
    recording: Recording,
    effects: Sequence[str] = (),
    observations: Sequence[str] | None = None,
    *,
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    noise: Mapping[str, float] | None = None,
    noise_until: float | None = None,
    start: Start | None = None,
    engine: str = "compiled",
    ignore: Sequence[str] = (),
    progress: Progress | None = None,
) -> Result:
    """Estimate biases, and the parameters of the effects asked for, from one recording.

    effects: ids of the catalogue. observations: kinds to use instead of those that
    ``assume`` ("auto", "fixed-point", "rest-only") and the streams suggest. heading_sigma:
    rad, if known. latitude (rad) and height (m) switch on the Earth's rate and true
    gravity. noise: levels to keep fixed, SI, by name; all others are estimated, from the
    part before ``noise_until`` (s) if given. start: a prior of the first state instead of
    levelling. ignore: streams to leave out. progress: called with the fraction done.

    Raises InputError for unknown names or options, HandcalError where no result could be
    made. Source: paper 002 for the pseudo-observations, equations 7-12.
    """
    report = progress or (lambda _: None)
    _check(engine, observations)
    check_options(recording, assume, heading_sigma, ignore)
    recording = replace(
        recording, streams={k: v for k, v in recording.streams.items() if k not in ignore}
    )
    chosen = select(effects)
    _check_calibrates(chosen)
    fixed = dict(noise or {})
    if heading_sigma is not None:
        fixed["heading_noise"] = heading_sigma
    rests = segment.rests(recording)
    earth = local_earth(latitude, height)
    warnings = list(recording.warnings)
    if observations is None:
        choice = choose(recording, chosen, assume, rests, earth, fixed, report)
    else:
        kinds = list(observations)
        choice = Choice("rest-only" if "zero_rate" in kinds else "fixed-point", kinds, [], {})
    assume, kinds = choice.assume, choice.kinds
    warnings += choice.warnings
    _check_effects(chosen, kinds)
    problem, begin = problem_of(recording, chosen, kinds, rests, earth, start)
    report(0.3)
    solution = solve(
        problem, begin, fixed, noise_until, engine, lambda f: report(0.3 + 0.65 * f), choice.levels
    )
    report(1.0)
    return _result(recording, assume, rests, solution, warnings)


def choose(
    recording: Recording,
    effects: Sequence[Effect],
    assume: str,
    rests: Array,
    earth: tuple[Array, Array],
    fixed: Mapping[str, float],
    report: Progress = lambda _: None,
) -> Choice:
    """What to observe, for one of ASSUMPTIONS; "auto" tries whether the held point stays."""
    warnings: list[str] = []
    levels: Mapping[str, float] = {}
    usable = _usable(recording, effects, warnings)
    if "reference" in usable:
        return Choice("rest-only", ["known_input"], _only_reference(usable), levels)
    travels = False
    if assume == "auto":
        assume, said, levels = _assumption(recording, effects, usable, rests, earth, fixed, report)
        warnings += said
        travels = assume == "rest-only"
    kinds = _kinds(assume, usable, rests)
    if travels and "pose" not in usable:
        # Between the rests the hand is not free either: it stays within an arm's reach,
        # which a wide sway says, and which keeps dead reckoning from running away.
        kinds.append("fixed_position")
    if "fixed_position" in kinds and "zero_rate" not in kinds and segment.at_rest(recording):
        # What lies still turns no more than the Earth does, whatever point is held.
        kinds.append("zero_rate")
    return Choice(assume, kinds, warnings, levels)


def check_options(
    recording: Recording, assume: str, heading_sigma: float | None, ignore: Sequence[str]
) -> None:
    """Raises InputError, with the sentence a user needs, where an option makes no sense."""
    if assume not in ASSUMPTIONS:
        raise InputError(f"Unknown assumption '{assume}'. Known: {', '.join(ASSUMPTIONS)}.")
    if heading_sigma is not None and not 1e-4 <= heading_sigma <= 4.0:
        raise InputError("The heading's sigma must lie between 0.006 and 229 degrees.")
    for name in ignore:
        if name not in recording.streams:
            have = ", ".join(recording.streams) or "none"
            raise InputError(f"There is no stream '{name}' to ignore; the recording has: {have}.")


def _check(engine: str, observations: Sequence[str] | None) -> None:
    if engine not in ENGINES:
        raise InputError(f"Unknown engine '{engine}'. Known: {', '.join(ENGINES)}.")
    for kind in observations or ():
        if kind not in catalogue():
            raise InputError(f"Unknown observation '{kind}'. Known: {', '.join(catalogue())}.")


def _check_calibrates(effects: Sequence[Effect]) -> None:
    for e in effects:
        if e.outliers:
            raise InputError(
                f"The effect '{e.id}' cannot be calibrated: the filter believes every reading. "
                "'explain' can find it; leave it out here."
            )


def _check_effects(effects: Sequence[Effect], kinds: Sequence[str]) -> None:
    for e in effects:
        acts = e.imu_error is not None or e.walks or set(e.observation_error) & set(kinds)
        if not acts:
            raise InputError(
                f"The effect '{e.id}' acts on {' or '.join(sorted(e.observation_error))}, and "
                "nothing like that is observed here: leave it out."
            )


def _usable(recording: Recording, effects: Sequence[Effect], warnings: list[str]) -> set[str]:
    """Streams that are fit to be observed; what is left out is said."""
    usable = set(recording.streams) & {"heading", "mag", "pose", "reference"}
    for name in sorted(usable):
        if len(recording.streams[name].t) < MIN_READINGS:
            usable.discard(name)
            warnings.append(f"The stream '{name}' was left out: it holds fewer than 20 readings.")
    if "pose" in usable:
        try:
            catalogue()["pose"].rows(recording, Scene(np.zeros((0, 2)), has_heading=False))
        except InputError as problem:
            usable.discard("pose")
            warnings.append(f"The pose was left out: {problem}")
    if "mag" in usable:
        size = np.linalg.norm(recording.streams["mag"].value, axis=1)
        low, high = np.quantile(size, [0.05, 0.95])
        if "heading" in usable:
            usable.discard("mag")
        elif any(e.id == "mag_hard_iron" for e in effects):
            pass
        elif high - low > 0.4 * np.median(size) or not 5e-6 < np.median(size) < 1.5e-4:
            usable.discard("mag")
            warnings.append(
                f"The magnetometer was left out: its field of {1e6 * low:.0f} to {1e6 * high:.0f} "
                "microtesla is not the Earth's (25 to 65, and the same in every attitude); "
                "it carries a hard iron."
            )
    return usable


def _only_reference(usable: set[str]) -> list[str]:
    """What the user should know where a reference tells rate and force themselves."""
    others = sorted(usable - {"reference"})
    unused = f" The streams {' and '.join(others)} are not used." if len(others) > 1 else ""
    unused = unused or (f" The stream {others[0]} is not used." if others else "")
    return [
        "The readings are compared with the reference's alone: nothing is assumed of the hand, "
        f"and position, velocity and heading are free to drift.{unused}"
    ]


def _kinds(assume: str, usable: set[str], rests: Array) -> list[str]:
    kinds: list[str] = []
    if assume == "rest-only":
        if not len(rests):
            raise HandcalError(
                "The device never rests in this recording, so --assume rest-only has nothing to "
                "go by; let it lie for a few seconds at the start and the end."
            )
        kinds += ["zero_velocity", "zero_rate"]
    elif "pose" not in usable:
        kinds.append("fixed_position")
    kinds += [k for s, k in (("heading", "heading"), ("mag", "magnetometer")) if s in usable]
    if "pose" in usable:
        kinds.append("pose")
    return kinds


def _assumption(
    recording: Recording,
    effects: Sequence[Effect],
    usable: set[str],
    rests: Array,
    earth: tuple[Array, Array],
    fixed: Mapping[str, float],
    report: Progress,
) -> tuple[str, list[str], Mapping[str, float]]:
    """Does the held point stay? The evidence of the sway that the readings ask for decides.
    Also what to say about it, and the noise levels of a hand that stays."""
    kinds = ["fixed_position"] + (["heading"] if "heading" in usable else [])
    problem, begin = problem_of(recording, effects, kinds, rests, earth, None)
    solution = solve(problem, begin, fixed, None, "compiled", lambda f: report(0.3 * f), rounds=1)
    levels = dict(solution.levels)
    sway, gain = sway_of(problem, levels), beyond_a_hand(solution.linear, levels)
    if gain < TRAVEL_NATS:
        return "fixed-point", [], levels
    said = (
        f"The hand travels: its sway of about {sway:.2g} m is more than a held point's "
        f"(evidence {gain:.0f} nats)"
    )
    if not len(rests):
        return (
            "fixed-point",
            [
                f"{said}, and the device never rests, so the accelerometer is judged against a "
                "wide sway; let it lie for a few seconds at the start and the end."
            ],
            levels,
        )
    between = "the pose is followed" if "pose" in usable else "the hand stays within reach"
    return "rest-only", [f"{said}. Only the rests are taken to be still; in between {between}."], {}


def problem_of(
    recording: Recording,
    effects: Sequence[Effect],
    kinds: Sequence[str],
    rests: Array,
    earth: tuple[Array, Array],
    start: Start | None,
) -> tuple[Problem, Start]:
    """The problem these kinds of observation make of the recording, and where it starts."""
    if "magnetometer" not in kinds or not any(e.id == mag_hard_iron.EFFECT.id for e in effects):
        observed, begin = observed_of(recording, kinds, rests, earth, start)
        return build(recording, effects, observed, *earth), begin
    iron, sigma = mag_hard_iron.sphere(recording)
    observed, begin = observed_of(recording, kinds, rests, earth, start, iron)
    problem = build(recording, effects, observed, *earth)
    told = {axis: (float(s), float(c)) for axis, s, c in zip("xyz", sigma, iron, strict=True)}
    slots = tuple(
        replace(s, prior_sigma=told[s.name][0], prior_mean=told[s.name][1])
        if s.owner == mag_hard_iron.EFFECT.id
        else s
        for s in problem.slots
    )
    return replace(problem, slots=slots), begin


def observed_of(
    recording: Recording,
    kinds: Sequence[str],
    rests: Array,
    earth: tuple[Array, Array],
    start: Start | None,
    iron: Array | None = None,
    rate: float | None = PSEUDO_RATE,
) -> tuple[list[Observed], Start]:
    """Each kind of observation with its rows and constants, and where the filter starts.

    iron (3,): a hard iron about which that of the magnetometer is to be sought, tesla.
    rate: of pseudo-observations, Hz.
    """
    if iron is not None:
        recording = mag_hard_iron.cleaned(recording, iron)
    has_heading = "heading" in kinds or "magnetometer" in kinds
    scene = Scene(rests, has_heading, rate=rate, omega_ie_n=earth[1])
    begin = start or _level(recording, kinds, scene)
    if "pose" in kinds and has_heading:
        scene = replace(scene, align_yaw=float(so3.yaw_of(begin.C_nb)))
    observed: list[Observed] = []
    for kind in kinds:
        observation = catalogue()[kind]
        rows = observation.rows(recording, scene)
        if rows is None or not len(rows.t):
            raise HandcalError(f"The recording holds nothing for the observation '{kind}'.")
        if kind == "magnetometer" and iron is not None:
            rows = replace(rows, z=np.hstack([rows.z, np.tile(iron, (len(rows.t), 1))]))
        constants = tuple((c.name, c.unit, c.prior_sigma) for c in observation.constants(scene))
        observed.append((observation, rows, constants))
        if kind == "pose" and start is None:
            begin = from_pose(rows.t, rows.z)
    return observed, begin


def _level(recording: Recording, kinds: Sequence[str], scene: Scene) -> Start:
    """Start level, with the yaw that the first headings show, or zero where none is observed."""
    begin = from_rest(recording, 0.0, UNKNOWN_YAW if scene.has_heading else FIXED_YAW, scene.rests)
    if not scene.has_heading:
        return begin
    name = "heading" if "heading" in kinds else "mag"
    if name not in recording.streams:
        raise HandcalError(f"The recording has no stream '{name}' to take a heading from.")
    series = recording.streams[name]
    early = series.value[: max(1, int(np.searchsorted(series.t, series.t[0] + 0.5)))]
    if name == "heading":
        yaw = math.atan2(np.sin(early[:, 0]).mean(), np.cos(early[:, 0]).mean())
    else:
        field = begin.C_nb @ early.mean(axis=0)
        yaw = 0.5 * math.pi - math.atan2(field[1], field[0])
    force = begin.force
    assert force is not None
    return replace(begin, C_nb=levelled(force, yaw))


def first_state(problem: Problem, start: Start, levels: Mapping[str, float]) -> State:
    """The filter's state before the first node; about an iron that is already taken off.

    The online pass cannot go back: it has to begin where the iron is, and to stay near.
    """
    state = initial_state(problem, start, dict(levels))
    mine = [i for i, s in enumerate(problem.slots) if s.owner == mag_hard_iron.EFFECT.id]
    seen = [k for k, o in enumerate(problem.observations) if o.kind == "magnetometer"]
    if not mine or not seen:
        return state
    first = problem.nodes.z[int(np.argmax(problem.nodes.kind == seen[0]))]
    iron = first[mag_hard_iron.TAKEN_OFF : mag_hard_iron.TAKEN_OFF + 3]
    if not iron.any():
        return state
    extras, P = state.extras.copy(), state.P.copy()
    for axis, i in enumerate(mine):
        extras[i] = iron[axis]
        P[BASE + i, BASE + i] = mag_hard_iron.STRAY**2
    return replace(state, extras=extras, P=P)


def solve(
    problem: Problem,
    start: Start,
    fixed: Mapping[str, float],
    noise_until: float | None = None,
    engine: str = "compiled",
    progress: Progress | None = None,
    begin: Mapping[str, float] | None = None,
    rounds: int = 2,
) -> Solution:
    """Filter, smooth, relinearise, and find the noise levels that are not ``fixed``.

    begin: levels to begin the search at, where something better than a first guess is known.
    """
    levels = noise_levels.initial_levels(problem)
    levels |= {k: v for k, v in {**(begin or {}), **fixed}.items() if k in levels}
    free = tuple(lv.name for lv in problem.levels if lv.name not in fixed)
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(1.0 - math.exp(-done / 150.0))

    track = empty_track(problem, epochs(problem))
    state = first_state(problem, start, levels)
    state = ENGINES[engine](problem, noise_arrays(problem, levels), state, track)
    nominal = _plausible(problem, trajectory_of(problem, track, state.bg, state.ba, state.extras))
    linear, settled, evidence = batch.relinearise(linearise_about(problem, start, nominal), levels)
    curvature = noise_levels.NO_CURVATURE
    for _ in range(rounds if free else 0):
        part = linear if noise_until is None else noise_levels.until(linear, noise_until)
        new, curvature = noise_levels.estimate(part, levels, free, count, known=curvature)
        change = max(abs(math.log(new[n] / levels[n])) for n in free)
        there = batch.relinearise(linear, new)
        if noise_until is None and there[2] < evidence - LOST_NATS:
            # what the search promised about a trajectory that had not settled was not there
            break
        levels, (linear, settled, evidence) = new, there
        if change < 0.02:
            break
    if not settled:
        linear, settled, _ = batch.relinearise(linear, levels)
    forward = batch.forward(linear, levels)
    if not np.isfinite(forward.log_evidence):
        raise HandcalError(
            "The filter diverged on this recording; check its units and axes, and whether the "
            "device was really held or laid as assumed."
        )
    return Solution(linear, forward, levels, free, settled)


def _plausible(problem: Problem, nominal: Trajectory) -> Trajectory:
    """With constants no further from their prior means than five sigma: an online pass that ran
    away (a wrong noise level, before any is known) is no place to linearise about."""
    mean, reach = problem.prior_mean, 5.0 * np.array([s.prior_sigma for s in problem.slots])
    return replace(nominal, constants=np.clip(nominal.constants, mean - reach, mean + reach))


def _result(
    recording: Recording, assume: str, rests: Array, solution: Solution, warnings: list[str]
) -> Result:
    linear, forward = solution.linear, solution.forward
    history = _history(linear, forward.x, forward.P)
    x, P = batch.smooth(linear, solution.levels, forward)
    if not solution.settled:
        warnings.append(
            "The estimate still moved after sixteen rounds of relinearisation; the motion may be "
            "too poor for all that was asked, so trust the sigmas less."
        )
    if linear.problem.dropped:
        warnings.append(
            f"{linear.problem.dropped} observations lie outside the IMU's time and were left out."
        )
    innovations = _innovations(linear, forward)
    for kind, i in innovations.items():
        if i.skipped:
            warnings.append(
                f"{i.skipped} observations of {kind} were skipped (body x near the vertical)."
            )
    warnings += _gravity_stays(linear.trajectory.C)
    warnings += _contradicting_heading(linear.problem, solution.levels)
    smoothed = _history(linear, x, P)
    parameters = _parameters(linear.problem, history, smoothed)
    return Result(
        recording=recording,
        assume=assume,
        parameters=parameters,
        covariance=_covariance(linear.problem, forward.P[-1], parameters),
        noise=tuple(
            NoiseLevel(lv.name, solution.levels[lv.name], lv.unit, lv.name in solution.estimated)
            for lv in linear.problem.levels
        ),
        history=history,
        smoothed=smoothed,
        innovations=innovations,
        log_evidence=forward.log_evidence,
        rests=rests,
        warnings=tuple(warnings),
        observed_heading=_observed_heading(linear),
        settled=solution.settled,
    )


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


def _gravity_stays(C_nb: Array) -> list[str]:
    """A warning where gravity never leaves one body axis: bias and scale are one there."""
    up = C_nb[:, 2]
    mean = up.mean(axis=0)
    mean /= np.linalg.norm(mean)
    axis = int(np.argmax(np.abs(mean)))
    if np.min(up @ mean) < math.cos(STEADY_GRAVITY) or abs(mean[axis]) < 0.9:
        return []
    return [
        f"Gravity stays along body {'xyz'[axis]} throughout: the accelerometer's bias on that axis "
        "holds its scale error and any error of the local gravity too. Turn the device over to "
        "tell them apart."
    ]


def _effect_constants(problem: Problem) -> int:
    """Number of the effects' constants; those of noise are levels instead."""
    return sum(len(e.parameters) for e in problem.effects if e.process is None and not e.outliers)


def _walking(problem: Problem, P: Array) -> Array:
    """Covariances P (k, N, N) with the biases as they are at each moment, walks included."""
    if not problem.walks:
        return P
    total = np.eye(problem.size)
    for state, column in problem.walks:
        at = BASE + problem.constants + state
        total[9 + column : 12 + column, at : at + 3] = np.eye(3)
    return np.asarray(total @ P @ total.T)


def _covariance(problem: Problem, P: Array, parameters: Sequence[Parameter]) -> Array:
    """Covariance (m, m) of the parameters from the last P (N, N); their own sigmas count."""
    own = _walking(problem, P)[9 : 9 + len(parameters), 9 : 9 + len(parameters)].copy()
    if problem.walks:
        scale = np.array([p.sigma for p in parameters]) / np.sqrt(np.diag(own))
        own *= np.outer(scale, scale)
    return own


def _history(linear: Linear, x: Array, P: Array) -> History:
    """The nominal trajectory plus the estimated errors x (k, N), thinned for display."""
    nominal, m = linear.trajectory, _effect_constants(linear.problem)
    step = max(1, round(len(linear.t) / max(1.0, (linear.t[-1] - linear.t[0]) * HISTORY_RATE)))
    rows = np.unique(np.r_[np.arange(0, len(linear.t), step), len(linear.t) - 1])
    C = np.stack([so3.matrix_exp(x[j, 6:9]) @ nominal.C[j] for j in rows])
    parameters = np.r_[nominal.bg, nominal.ba, nominal.constants[:m]] + x[rows, 9 : BASE + m]
    for state, column in linear.problem.walks:
        at = BASE + linear.problem.constants + state
        walk = nominal.markov[rows, state : state + 3] + x[rows, at : at + 3]
        parameters[:, column : column + 3] += walk
    sigma = np.sqrt(np.maximum(np.einsum("kii->ki", _walking(linear.problem, P[rows])), 0.0))
    return History(
        t=linear.t[rows],
        p_n=nominal.p[rows] + x[rows, 0:3],
        v_n=nominal.v[rows] + x[rows, 3:6],
        q_nb=so3.quaternion_of(C),
        yaw=so3.yaw_of(C),
        nav_sigma=sigma[:, :9],
        parameters=parameters,
        parameter_sigma=sigma[:, 9 : BASE + m],
    )


def _parameters(problem: Problem, history: History, smoothed: History) -> tuple[Parameter, ...]:
    """What was found in the end; of a walking bias its mean over the recording, with the mean
    of its sigmas (at most that is the sigma of the mean)."""
    walking = {column + i for _, column in problem.walks for i in range(3)}
    names = [("gyro_bias", a, "rad/s") for a in "xyz"] + [("accel_bias", a, "m/s^2") for a in "xyz"]
    names += [(s.owner, s.name, s.unit) for s in problem.slots[: _effect_constants(problem)]]
    priors = [float(GYRO_BIAS_PRIOR)] * 3 + [ACCEL_BIAS_PRIOR] * 3
    # (a slot's may be less, where other readings have spoken)
    usual = {(e.id, p.name): p.prior_sigma for e in problem.effects for p in e.parameters}
    priors += [usual[s.owner, s.name] for s in problem.slots[: _effect_constants(problem)]]
    out = []
    for i, (effect, name, unit) in enumerate(names):
        value, sigma = history.parameters[:, i], history.parameter_sigma[:, i]
        found, known = float(value[-1]), float(sigma[-1])
        if i in walking:
            # it never stays: all that can converge is how well it is known
            found = float(smoothed.parameters[:, i].mean())
            known = float(smoothed.parameter_sigma[:, i].mean())
            value = np.full(len(sigma), found)
        converged = _converged(history.t, value, sigma, priors[i])
        out.append(Parameter(effect, name, found, known, unit, priors[i], converged))
    return tuple(out)


def _converged(t: Array, value: Array, sigma: Array, prior: float) -> float | None:
    """Time, s, from which the estimate stays within three of its final sigmas, and observable.

    None where the final sigma is not below half the prior.
    """
    if not sigma[-1] < 0.5 * prior:
        return None
    away = (np.abs(value - value[-1]) > 3.0 * sigma[-1]) | (sigma >= 0.5 * prior)
    last = np.flatnonzero(away)
    return float(t[0] if not len(last) else t[min(last[-1] + 1, len(t) - 1)])


def _innovations(linear: Linear, forward: batch.Pass) -> dict[str, Innovations]:
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
        if observation.channels == ("heading",):
            mine = (linear.kind == k) & linear.used
            yaw = so3.yaw_of(linear.trajectory.C[at[mine]]) + linear.r[mine, 0]
            return np.stack([t[mine], so3.wrap(yaw)], axis=1)
    return None

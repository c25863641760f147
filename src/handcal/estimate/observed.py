"""What is observed of a recording: which kinds of observation, their rows, and where to begin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import BASE
from handcal.effects import Effect, mag_hard_iron
from handcal.estimate.assemble import build
from handcal.estimate.filter import State, initial_state
from handcal.estimate.problem import Problem
from handcal.estimate.start import Start, from_pose, from_rest, levelled
from handcal.observations import Observation, Rows, Scene, catalogue
from handcal.recordings.inputs._health import check_fit
from handcal.recordings.streams import STREAMS
from handcal.types import Array, HandcalError, InputError, Recording, Series

Observed = tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]
ASSUMPTIONS = ("auto", "fixed-point", "rest-only")
BESIDE_HEADING = (
    "The magnetometer is not used beside a heading, which may come from it (--ignore heading uses "
    "it instead)."
)
# Fewer readings than this of a stream are none.
MIN_READINGS = 20
# How a hand sways within less than a third of a second is nobody's model: looked at more often,
# it is its shape at those frequencies that is judged, at the expense of a lever arm.
PSEUDO_RATE = 3.0
# Standard deviation of the first yaw, rad: any at all where a heading tells it, none where nothing
# does (it is zero by definition).
UNKNOWN_YAW = math.radians(100.0)
FIXED_YAW = 1e-6
# A field that may be the Earth's with some iron or a wrong sphere in it, tesla.
EARTHLY = (5e-6, 1.5e-4)


@dataclass(frozen=True)
class Choice:
    """What is assumed of the hand, the kinds of observation to use, and what was left out, in
    words."""

    assume: str
    kinds: tuple[str, ...]
    warnings: tuple[str, ...]


def choose(
    recording: Recording,
    assume: str,
    rests: Array,
    reference_exact: bool = False,
) -> Choice:
    """What to observe under one of ASSUMPTIONS; "auto" begins with a held point."""
    warnings: list[str] = []
    usable = _usable(recording, warnings)
    if "reference" in usable:
        unknown = not (reference_exact or len(rests))
        return Choice("rest-only", ("known_input",), tuple(_only_reference(usable, unknown)))
    assumed = "fixed-point" if assume == "auto" else assume
    return Choice(assumed, tuple(_kinds(assumed, usable, rests)), tuple(warnings))


def check_options(
    recording: Recording, assume: str, heading_sigma: float | None, ignore: Sequence[str]
) -> None:
    """Raises InputError, with the sentence a user needs, where an option makes no sense, and
    HandcalError where the readings are unfit for any calibration."""
    if assume not in ASSUMPTIONS:
        raise InputError(f"Unknown assumption '{assume}'. Known: {', '.join(ASSUMPTIONS)}.")
    if heading_sigma is not None and not 1e-4 <= heading_sigma <= 4.0:
        raise InputError("The heading's sigma must lie between 0.006 and 229 degrees.")
    for name in ignore:
        if name not in recording.streams:
            have = ", ".join(recording.streams) or "none"
            raise InputError(f"There is no stream '{name}' to ignore; the recording has: {have}.")
    check_fit(recording)


def check_apart(recordings: Sequence[Recording], held_out: Sequence[Recording] = ()) -> None:
    """Raises InputError where readings would count twice, or be seen that are held out."""
    for k, one in enumerate(recordings):
        name = Path(one.path).name
        for other in recordings[k + 1 :]:
            if _alike(one, other):
                raise InputError(
                    f"{name} and {Path(other.path).name} hold the same readings, which would count "
                    "twice: leave one of them out."
                )
        for other in held_out:
            if _alike(one, other):
                raise InputError(
                    f"{Path(other.path).name}, to be held out, holds the readings of {name}: name "
                    "another recording of the device."
                )


def _alike(one: Recording, other: Recording) -> bool:
    a, b = one.imu, other.imu
    return np.array_equal(a.gyro, b.gyro) and np.array_equal(a.accel, b.accel)


def _usable(recording: Recording, warnings: list[str]) -> set[str]:
    """Streams that are fit to be observed; what is left out is said."""
    usable = {s.name for s in STREAMS.values() if s.observation} & set(recording.streams)
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
        iron = mag_hard_iron.guess(recording)
        strength = float(np.median(np.linalg.norm(recording.streams["mag"].value - iron, axis=1)))
        if "heading" in usable:
            usable.discard("mag")
            warnings.append(BESIDE_HEADING)
        elif not EARTHLY[0] < strength < EARTHLY[1]:
            usable.discard("mag")
            warnings.append(
                f"The magnetometer was left out: less what its readings lie around, its field of "
                f"{1e6 * strength:.3g} microtesla is not the Earth's (25 to 65)."
            )
    return usable


def _only_reference(usable: set[str], unknown: bool) -> list[str]:
    """What the user should know where a reference tells rate and force themselves; unknown:
    nothing shows its own biases."""
    others = sorted(usable - {"reference"})
    unused = f" The streams {' and '.join(others)} are not used." if len(others) > 1 else ""
    unused = unused or (f" The stream {others[0]} is not used." if others else "")
    said = [
        "The readings are compared with the reference's alone: nothing is assumed of the hand, "
        f"and position, velocity and heading are free to drift.{unused}"
    ]
    if unknown:
        said.append(
            "The reference's own biases are unknown, and without a rest nothing shows them, so the "
            "IMU's are hardly known either (--reference-exact: the reference has none)."
        )
    return said


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
    return kinds + [s.observation for s in STREAMS.values() if s.name in usable]


def problem_of(
    recording: Recording,
    effects: Sequence[Effect],
    kinds: Sequence[str],
    rests: Array,
    earth: tuple[Array, Array],
    start: Start | None,
) -> tuple[Problem, Start]:
    """The problem these kinds of observation make of the recording, and where it starts."""
    observed, begin = observed_of(recording, kinds, rests, earth, start)
    problem = build(recording, effects, observed, *earth, rests=rests)
    if "magnetometer" not in kinds or mag_hard_iron.EFFECT.id not in {e.id for e in effects}:
        return problem, begin
    iron, sigma = mag_hard_iron.sphere(recording)
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
    rate: float | None = None,
    reference_exact: bool = False,
    origin: float | None = None,
) -> tuple[list[Observed], Start]:
    """Each kind of observation with its rows and constants, and where the filter starts.

    iron (3,): a magnetometer's hard iron with which to begin, tesla (None: the likeliest).
    rate: of pseudo-observations, Hz (None: as often as is usual). reference_exact:
    a reference has no bias of its own. origin: as of ``Scene``.
    """
    has_heading = "heading" in kinds or "magnetometer" in kinds
    scene = Scene(
        rests, has_heading, rate=rate or PSEUDO_RATE, omega_ie_n=earth[1],
        gravity=float(np.linalg.norm(earth[0])), reference_exact=reference_exact,
        iron=iron, origin=origin,
    )  # fmt: skip
    begin = start or _level(recording, kinds, scene)
    if "pose" in kinds and has_heading:
        scene = replace(scene, align_yaw=float(so3.yaw_of(begin.C_nb)))
    observed: list[Observed] = []
    for kind in kinds:
        observation = catalogue()[kind]
        rows = observation.rows(recording, scene)
        if rows is None or not len(rows.t):
            raise HandcalError(f"The recording holds nothing for the observation '{kind}'.")
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
    if name == "mag":
        iron = mag_hard_iron.guess(recording) if scene.iron is None else scene.iron
        field = begin.C_nb @ (_early(recording.streams["mag"]).mean(axis=0) - iron)
        yaw = 0.5 * math.pi - math.atan2(field[1], field[0])
    else:
        early = _early(recording.streams[name])
        yaw = math.atan2(np.sin(early[:, 0]).mean(), np.cos(early[:, 0]).mean())
    force = begin.force
    assert force is not None
    return replace(begin, C_nb=levelled(force, yaw))


def _early(series: Series) -> Array:
    """Readings (k, d) of the first half second."""
    return series.value[: max(1, int(np.searchsorted(series.t, series.t[0] + 0.5)))]


def first_state(
    problem: Problem,
    start: Start,
    levels: Mapping[str, float],
    iron: tuple[Array, Array] | None = None,
) -> State:
    """The filter's state before the first node; iron: a magnetometer's hard iron (3,) and its
    sigmas (3,), tesla.

    The online pass cannot go back: it has to begin where the iron is, and to stay near.
    """
    state = initial_state(problem, start, dict(levels))
    mine = [i for i, s in enumerate(problem.slots) if s.owner == mag_hard_iron.EFFECT.id]
    if iron is None or not mine:
        return state
    extras, P = state.extras.copy(), state.P.copy()
    for i, value, sigma in zip(mine, *iron, strict=True):
        extras[i] = value
        P[BASE + i, BASE + i] = sigma**2
    return replace(state, extras=extras, P=P)

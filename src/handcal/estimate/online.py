"""The filter of ``handcal replay`` while readings still arrive: piece by piece, each sample once.

It begins in the first rest, with noise levels as the readings show them there, and is put where a
batch estimate stands as soon as there is one: from there it goes on over what came since. So each
sample counts once, whatever the batch made of those before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled import so3
from handcal.earth import local_earth
from handcal.effects import ATTITUDE, PLACE, Effect, catalogue, select
from handcal.estimate.assemble import Piece, build
from handcal.estimate.derivatives import relinearised
from handcal.estimate.filter import ENGINES, State, empty_track
from handcal.estimate.live import Frame, frame_of
from handcal.estimate.noise_levels import initial_levels
from handcal.estimate.observed import PSEUDO_RATE, Observed, first_state, observed_of
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.result import check_covariance
from handcal.estimate.standing import in_terms_of, kept, known_as, processes
from handcal.estimate.start import BIASES, with_known_biases
from handcal.observations import Rows, Scene
from handcal.observations import catalogue as observations
from handcal.recordings import segment
from handcal.types import (
    Array,
    HandcalError,
    Imu,
    IntArray,
    Prior,
    Recording,
    Series,
    Standing,
)

# What can be observed of a piece alone. Of others (a magnetometer's field strengths, a pose's
# alignment) the rows are made of the whole recording: the next batch has them.
KINDS = ("fixed_position", "heading", "zero_velocity", "zero_rate")
# So much of what came before a piece has to be there, s: rests are told beside it, and rates and
# slopes are averaged over it.
CONTEXT_S = 3.0
# How a hand sways is not known before it has turned for some seconds: of the first of them a batch
# finds anything (a tenth of a millimetre), and what goes on from there is off by up to 27 sigma. So
# long, s, it is taken to sway no less than is usual.
HAND_S = 15.0


@dataclass(frozen=True)
class Online:
    """A filter that runs. standing: where; levels: SI, by name; times are from the recording's
    begin."""

    standing: Standing
    levels: Mapping[str, float]
    engine: str = "compiled"

    @property
    def t(self) -> float:
        """Until when it has come, s."""
        return self.standing.t


def begun_at_rest(
    recording: Recording, effects: Sequence[str], before: Prior | None = None,
    engine: str = "compiled",
) -> tuple[Online, Frame]:  # fmt: skip
    """Begin where a recording begins, and go to its end. effects: ids; before: what is known of
    the device. Errors: HandcalError where it is lost at once, and where there are poses or a
    reference, which no piece can tell by itself."""
    if {"pose", "reference"} & set(recording.streams):
        raise HandcalError("Poses and references are observed of a whole recording.")
    kinds = ["fixed_position", *(["heading"] if _headed(recording) else [])]
    earth = local_earth(None, 0.0)
    rests = segment.rests(recording)
    observed, start = observed_of(recording, kinds, rests, earth, None, origin=0.0)
    some = [e for e in select(effects) if _can(e, recording, kinds)]
    problem = build(recording, some, observed, *earth, piece=Piece(0.0, float(recording.imu.t[0])))
    levels = initial_levels(problem)
    state = first_state(problem, with_known_biases(start, before), levels)
    state = _with_known_constants(problem, state, before)
    return _run(problem, Online(_standing(problem, state), levels, engine), state)


def gone_on(standing: Standing, levels: Mapping[str, float], engine: str = "compiled") -> Online:
    """A filter that goes on from where a batch estimate stands, with its noise levels; of a hand
    that has hardly turned yet, at least the usual ones.

    Errors: HandcalError where nothing is observed that can be so (beside a reference, by poses).
    """
    kinds = [k for k in standing.kinds if k in KINDS]
    if not kinds:
        raise HandcalError("Nothing that is observed here can be observed sample by sample.")
    if "fixed_position" in kinds:  # (that it lies still was so while all of it did)
        kinds = [k for k in kinds if k != "zero_rate"]
        if standing.t < HAND_S:
            usual = observations()["fixed_position"].levels
            # (its time is what it is; how far it goes in it is at least so much)
            levels = dict(levels) | {
                v.name: v.initial if v.unit == "s" else max(v.initial, levels[v.name])
                for v in usual
                if v.name in levels
            }
    known = catalogue()
    effects = [
        known[i] for i in standing.effects if i in known and _acts(known[i], kinds)
    ]  # fmt: skip
    problem = _skeleton(kinds, effects)
    names = [(s.owner, s.name) for s in problem.slots]
    ids = [e.id for e in problem.effects]
    return Online(kept(standing, kinds, ids, names, processes(problem)), levels, engine)


def stepped(online: Online, piece: Recording) -> tuple[Online, Frame | None]:
    """Go on over what is new in a piece of the recording, which begins some while before it
    (CONTEXT_S); None where nothing is. Errors: HandcalError where the covariance is lost."""
    imu, s = piece.imu, online.standing
    if len(imu.t) < 2 or not imu.t[0] <= s.t < imu.t[-1]:
        return online, None
    piece = replace(piece, bias_temperature=s.bias_temperature)
    earth = local_earth(None, 0.0)
    observed = [_since(piece, kind, s) for kind in s.kinds]
    effects = select(s.effects)
    at = Piece(0.0, s.t)
    problem = build(piece, effects, observed, *earth, linearised=False, piece=at)
    constants = s.extras[: problem.constants]
    problem = relinearised(problem, constants, s.bg, s.ba)
    node = int(np.searchsorted(problem.nodes.t, s.t))
    return _run(problem, online, State(node, s.p, s.v, s.C, s.bg, s.ba, s.extras, s.P))


def _run(problem: Problem, online: Online, state: State) -> tuple[Online, Frame]:
    """To the end of the problem, from where the state is."""
    first = int(problem.nodes.first[state.node + 1])
    track = empty_track(problem, np.zeros(0, dtype=np.int64))
    noise = noise_arrays(problem, online.levels)
    state = ENGINES[online.engine](problem, noise, state, track)
    check_covariance(state.P, float(problem.nodes.t[state.node]))
    rows: IntArray = np.arange(first, len(track.nis))
    frame = frame_of(problem, state, track, rows[~np.isnan(track.nis[rows])])
    return replace(online, standing=_standing(problem, state)), frame


def _standing(problem: Problem, state: State) -> Standing:
    t = problem.nodes.t[max(state.node, 0)]
    navigated = state.p, state.v, state.C, state.bg, state.ba
    return in_terms_of(problem, float(t), navigated, state.extras, state.P)


def _since(piece: Recording, kind: str, standing: Standing) -> Observed:
    """A kind of observation with its rows that are newer than where the filter stands."""
    scene = _scene(kind, standing, piece)
    observation = observations()[kind]
    rows = observation.rows(piece, scene)
    if rows is None:
        rows = Rows(np.zeros(0), np.zeros((0, observation.dim)))
    new = (rows.t > standing.t) & (rows.t <= piece.imu.t[-1])
    rows = replace(rows, t=rows.t[new], z=rows.z[new])
    constants = tuple((c.name, c.unit, c.prior_sigma) for c in observation.constants(scene))
    return observation, rows, constants


def _scene(kind: str, standing: Standing, piece: Recording) -> Scene:
    g_n, omega = local_earth(None, 0.0)
    rests = segment.rests(piece) if kind.startswith("zero_") else np.zeros((0, 2))
    return Scene(
        rests, "heading" in standing.kinds, rate=PSEUDO_RATE, omega_ie_n=omega,
        gravity=float(np.linalg.norm(g_n)), origin=0.0,
    )  # fmt: skip


def _skeleton(kinds: Sequence[str], effects: Sequence[Effect]) -> Problem:
    """A problem of these kinds and effects without readings, for the order of its states."""
    t = np.arange(8.0)
    up = np.tile([0.0, 0.0, 9.8], (len(t), 1))
    imu = Imu(t, np.zeros((len(t), 3)), up, np.ones(len(t), dtype=np.bool_))
    recording = Recording("", imu, {"heading": Series(t[:0], np.zeros((0, 1)))})
    scene = Scene(np.zeros((0, 2)), "heading" in kinds, origin=0.0)
    observed: list[Observed] = []
    for kind in kinds:
        observation = observations()[kind]
        constants = tuple((c.name, c.unit, c.prior_sigma) for c in observation.constants(scene))
        observed.append((observation, Rows(t[:0], np.zeros((0, observation.dim))), constants))
    return build(recording, effects, observed, *local_earth(None, 0.0), linearised=False)


def _headed(recording: Recording) -> bool:
    return "heading" in recording.streams and len(recording.streams["heading"].t) > 0


def _acts(effect: Effect, kinds: Sequence[str]) -> bool:
    """Whether an effect does something to what is read or observed here."""
    return (
        effect.imu_error is not None or bool(effect.walks) or bool(effect.acts_now_on & set(kinds))
    )


def _can(effect: Effect, recording: Recording, kinds: Sequence[str]) -> bool:
    """Whether an effect can be estimated from the beginning on: its levels may not be known yet."""
    there = (ATTITUDE, PLACE, *recording.streams)
    return effect.process is None and _acts(effect, kinds) and set(effect.needs) <= set(there)


def _with_known_constants(problem: Problem, state: State, before: Prior | None) -> State:
    """The state with what is known of its constants (those of biases are in the start)."""
    if before is None:
        return state
    mine = [(s.owner, s.name) for s in problem.slots]
    names = [n for n in before.names if n in mine]
    at = [before.names.index(n) for n in names]
    own = known_as(
        _standing(problem, state), names, before.mean[at], before.covariance[np.ix_(at, at)]
    )
    return replace(state, extras=own.extras, P=own.P)


def parameters_of(online: Online, frame: Frame) -> tuple[tuple[str, str, float, float], ...]:
    """Effect, name, value and sigma (SI) of each parameter that the filter has in this frame."""
    names = [*BIASES, *online.standing.names]
    return tuple(
        (*name, float(value), float(sigma))
        for name, value, sigma in zip(names, frame.parameters, frame.sigma, strict=False)
        if not math.isnan(sigma)
    )


def rotation(frame: Frame) -> Array:
    """C_nb (3, 3) of a frame."""
    return np.asarray(so3.matrix_of(frame.q_nb[None])[0])

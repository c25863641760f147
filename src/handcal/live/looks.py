"""What is known on the way: the batch estimate of the last minutes, renewed in another process.

Looks are of a window that begins in a rest. When it becomes long, it is closed: what it told is
what is known before the next one, so that an hour costs no more than two minutes each time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.effects import catalogue
from handcal.live.doubts import Doubt, doubts
from handcal.live.goals import enough
from handcal.live.rounding import less_sure, rounded
from handcal.live.session import Session
from handcal.live.turns import Proposal
from handcal.types import (
    Array,
    HandcalError,
    Innovations,
    Parameter,
    Prior,
    Recording,
    Result,
    Standing,
)

# How far ahead motions are planned, s: a minute is what people have patience for.
HORIZON_S = 60.0
# A look needs so much, s: a rest and the beginning of a turn.
SHORTEST_S = 4.0
# A window is closed in the next rest after so long, s, and anyhow after so long.
CLOSE_S, ANYHOW_S = 120.0, 240.0
# Estimated beside biases unless others are asked for: scale errors, which every sensor has.
USUAL = ("gyro_scale", "accel_scale")
# By so much biases may have moved from one window to the next: what consumer-grade sensors do in
# two minutes of warming up (3 deg/h; 0.2 mg).
MOVED = {"gyro_bias": np.radians(3.0) / 3600.0, "accel_bias": 2e-3}


@dataclass(frozen=True)
class Look:
    """What a look found. from_ns: stamp at which its window begins; seconds: how long it is;
    at_rest: whether it ends in a rest; q_nb (4,): attitude at its end, w x y z; standing: from
    where a filter goes on."""

    from_ns: int
    seconds: float
    parameters: tuple[Parameter, ...]
    covariance: Array
    noise: Mapping[str, float]
    innovations: Mapping[str, Innovations]
    assume: str
    at_rest: bool
    q_nb: Array
    enough: bool
    next: Proposal | None
    doubts: tuple[Doubt, ...]
    standing: Standing | None = None

    @property
    def end_ns(self) -> int:
        """Stamp of the last sample that it knows."""
        return self.from_ns + round(self.seconds * 1e9)

    def sigma(self, effect: str, name: str) -> float | None:
        """How well one parameter is known, SI; None where it was not estimated."""
        own = [p.sigma for p in self.parameters if (p.effect, p.name) == (effect, name)]
        return own[0] if own else None

    @property
    def bias(self) -> Array:
        """Of the gyro, (3,) rad/s."""
        own = {p.name: p.value for p in self.parameters if p.effect == "gyro_bias"}
        return np.array([own.get(axis, 0.0) for axis in "xyz"])


def looked(
    recording: Recording, effects: Sequence[str], before: Prior | None,
    until: Mapping[str, float], horizon_s: float = HORIZON_S,
) -> Look | None:  # fmt: skip
    """Calibrate what there is, and say what to do next; None where nothing can be said yet.

    horizon_s: for how long motions are planned."""
    from handcal.estimate.calibration import calibrate
    from handcal.estimate.standing import known_as
    from handcal.live.planning import proposed

    try:
        result = calibrate(recording, effects, before=before)
    except HandcalError:  # (too little yet; the next look may have more)
        return None
    if rounded(recording):
        parameters, covariance = less_sure(result.parameters, result.covariance)
        standing = result.standing
        if standing is not None:
            names = [(p.effect, p.name) for p in parameters]
            mean = np.array([p.value for p in parameters])
            standing = known_as(standing, names, mean, covariance)
        result = replace(
            result, parameters=parameters, covariance=covariance, standing=standing
        )  # fmt: skip
    try:
        following = proposed(result, recording, until, horizon_s=horizon_s)
    except (HandcalError, np.linalg.LinAlgError):  # (a covariance that cannot be added to)
        following = None
    return _look(recording, result, following, enough(result.parameters, until))


def _look(recording: Recording, result: Result, following: Proposal | None, known: bool) -> Look:
    end = float(recording.imu.t[-1])
    history = result.smoothed or result.history
    resting = len(result.rests) > 0 and float(result.rests[-1][1]) > end - 1.0
    return Look(
        recording.start_ns, end, result.parameters, result.covariance,
        {n.name: n.value for n in result.noise}, result.innovations, result.assume, resting,
        history.q_nb[-1], known, following,
        doubts(recording, result), result.standing,
    )  # fmt: skip


@dataclass
class Looks:
    """Looks of one session. effects: that are estimated; before: what is known before the
    window; taken: the last look; failed: how often the process has died."""

    worker: Executor
    effects: tuple[str, ...] = USUAL
    before: Prior | None = None
    until: Mapping[str, float] = field(default_factory=dict)
    taken: Look | None = None
    running: Future[Look | None] | None = None
    failed: int = 0

    def tick(self, session: Session, recording: Recording | None) -> Look | None:
        """A look that has come to its end, if one has; begins the next. recording: what is in
        memory, its axes put right."""
        if self.running is not None:
            return self._ended(session) if self.running.done() else None
        if recording is None or recording.duration_s < SHORTEST_S or self.failed > 1:
            return None
        try:
            self.running = self.worker.submit(
                looked, recording, self.effects, self.before, self.until
            )  # fmt: skip
        except (BrokenExecutor, RuntimeError):
            self.failed += 1
        return None

    def _ended(self, session: Session) -> Look | None:
        assert self.running is not None
        try:
            look = self.running.result()
        except BrokenExecutor:
            self.failed += 1
            look = None
        self.running = None
        if look is None:
            return None
        self.taken = look
        if look.seconds > ANYHOW_S or (look.seconds > CLOSE_S and look.at_rest):
            self.before = carried(look)
            session.forget(look.end_ns - 2_000_000_000)
        return look


def carried(look: Look) -> Prior:
    """What a window that is closed has told, as what is known before the next."""
    known = catalogue()
    at = [
        i
        for i, p in enumerate(look.parameters)
        if p.effect in known and known[p.effect].process is None
    ]
    names = tuple((look.parameters[i].effect, look.parameters[i].name) for i in at)
    moved = np.array([MOVED.get(effect, 0.0) for effect, _ in names])
    covariance = look.covariance[np.ix_(at, at)] + np.diag(moved**2)
    mean = np.array([look.parameters[i].value for i in at])
    return Prior(names, mean, covariance, {"path": "the session so far"})


def with_effects(looks: Looks, found: Sequence[str]) -> None:
    """Estimate these effects too, from the next look on."""
    new = [e for e in found if e in catalogue() and e not in looks.effects]
    looks.effects = (*looks.effects, *new)

"""The filter of a session: it takes each sample once, as it comes, and is shown.

Its noise levels are the first rest's, until a look (the batch estimate behind) has come to its end:
then it stands where the look does, with the look's levels, and goes on over what came since, which
takes a few hundredths of a second. Where it cannot run (it has lost its covariance, beside a
reference), looks alone are shown, and the gyro carries the attitude between them.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.effects import catalogue
from handcal.estimate.live import Frame, Observed
from handcal.estimate.online import (
    CONTEXT_S,
    Online,
    begun_at_rest,
    gone_on,
    parameters_of,
    rotation,
    stepped,
)
from handcal.live.session import Session
from handcal.observations import catalogue as observations
from handcal.recordings import segment
from handcal.types import (
    Array,
    HandcalError,
    Imu,
    Innovations,
    Parameter,
    Prior,
    Recording,
    Standing,
)

# It begins once it has rested for so long, s (the shortest rest that is told; it tells white noise
# to a tenth), and anyhow after so long, since FIRST asks for four.
RESTED_S, ANYHOW_S = 0.8, 6.0
# An innovation beyond so many of its sigmas is beyond its gate.
GATE = 3.0
# Innovations that are summed up, of each kind: those of the last six seconds.
LATEST = 20
Righted = Callable[[Recording], Recording]


@dataclass(frozen=True)
class Fresh:
    """What the filter says of what came: attitude C_nb (3, 3) and parameters at t_ns, and the
    innovations since the last time, by kind, at times of the session (s)."""

    t_ns: int
    C_nb: Array
    parameters: tuple[Parameter, ...]
    innovations: Mapping[str, Innovations]


@dataclass
class Following:
    """effects, before: with which it begins; origin_ns: stamp of its time zero; turned: by how much
    its yaw is turned to be shown (each window of looks has a yaw of its own), rad; lately: NIS per
    degree of freedom and the largest innovation in sigmas, of the latest updates by kind."""

    effects: tuple[str, ...]
    before: Prior | None = None
    online: Online | None = None
    origin_ns: int = 0
    turned: float = 0.0
    frame: Frame | None = None
    lately: dict[str, deque[tuple[float, float]]] = field(default_factory=dict)
    lost: bool = False
    first_ns: int = 0
    ready: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        """On a first run the filter is compiled, while what comes is only recorded."""
        threading.Thread(target=self._warm, daemon=True).start()

    def _warm(self) -> None:
        try:
            warm(self.effects)
        finally:
            self.ready.set()

    def saw(self, session: Session, righted: Righted) -> Fresh | None:
        """Step over what has come; None while it does not run, or nothing is new."""
        if not self.ready.is_set():
            return None
        self.first_ns = session.recorder.first_ns or 0
        if self.online is None:
            return None if self.lost else self._begin(session, righted)
        piece = session.piece(self._ns(self.online.t - CONTEXT_S), self.origin_ns)
        if piece is None:
            return None
        return self._stepped(righted(piece))

    def stands(
        self, standing: Standing | None, levels: Mapping[str, float], from_ns: int,
        session: Session, righted: Righted,
    ) -> None:  # fmt: skip
        """Stand where a look does, whose window begins at from_ns, and come to where it was."""
        shown = None if self.frame is None else (self._ns(self.frame.t), self._shown(self.frame))
        self.lost, self.online, another = standing is None, None, from_ns != self.origin_ns
        if standing is None:
            return
        try:
            online = gone_on(standing, levels)
        except (HandcalError, ValueError):  # (what it has is not this filter's)
            self.lost = True
            return
        self.origin_ns, self.online = from_ns, online
        if shown is None:
            return
        # (what it has seen already is no news)
        piece = session.piece(self._ns(online.t - CONTEXT_S), from_ns, shown[0])
        if piece is not None:
            self._stepped(righted(piece), told=False)
        if self.frame is not None and another and "heading" not in standing.kinds:
            off = shown[1] @ rotation(self.frame).T
            self.turned = float(np.arctan2(off[1, 0] - off[0, 1], off[0, 0] + off[1, 1]))

    def give_up(self) -> None:
        """What it read was read wrongly (axes, sign): the next look begins it anew."""
        self.online, self.frame, self.lost = None, None, True

    def told(self, first_ns: int) -> dict[str, Any] | None:
        """What the page is told: until when it has come (s since first_ns), how it is held (C_nb
        row by row), and how large innovations are beside their gates."""
        if self.online is None or self.frame is None:
            return None
        kinds = [
            {"name": observations()[kind].title, "times": round(_rms(some), 2), "gate": GATE,
             "largest": round(some[-1][1], 2), "of": len(some),
             "beyond": sum(far > GATE for _, far in some)}
            for kind, some in self.lately.items()
        ]  # fmt: skip
        held = self._shown(self.frame).ravel().round(4).tolist()
        seconds = round((self._ns(self.frame.t) - first_ns) / 1e9, 3)
        return {"seconds": seconds, "held": held, "innovations": kinds}

    def _begin(self, session: Session, righted: Righted) -> Fresh | None:
        seconds = session.recorder.seconds
        first = session.recorder.first_ns
        if seconds < RESTED_S or first is None:
            return None
        if seconds > 2.0 * ANYHOW_S:  # (a session that is gone on with: the next look begins it)
            self.lost = True
            return None
        recording = session.piece(first, first)
        if recording is None:
            return None
        recording = righted(recording)
        rests = segment.rests(recording)
        rested = len(rests) > 0 and rests[0, 1] - rests[0, 0] >= RESTED_S
        if not rested and seconds < ANYHOW_S:
            return None
        self.origin_ns = first
        try:
            self.online, frame = begun_at_rest(recording, self.effects, self.before)
        except (HandcalError, np.linalg.LinAlgError):  # (the next look may know better)
            self.lost = True
            return None
        # (the first innovations are of a place that was not known yet: they say nothing)
        return self._fresh(replace(frame, observed=()))

    def _stepped(self, piece: Recording, told: bool = True) -> Fresh | None:
        assert self.online is not None
        if piece.imu.t[0] > self.online.t:  # (what it has to go on from is forgotten)
            self.give_up()
            return None
        try:
            self.online, frame = stepped(self.online, piece)
        except (HandcalError, np.linalg.LinAlgError):
            self.give_up()
            return None
        if frame is None:
            return None
        if not told:
            self.frame = frame
            return None
        return self._fresh(frame)

    def _fresh(self, frame: Frame) -> Fresh:
        assert self.online is not None
        self.frame = frame
        for one in frame.observed:
            far = float(np.max(np.abs(one.residual) / one.sigma))
            some = self.lately.setdefault(one.kind, deque(maxlen=LATEST))
            some.append((one.nis / len(one.residual), far))
        parameters = tuple(
            _parameter(effect, name, value, sigma)
            for effect, name, value, sigma in parameters_of(self.online, frame)
            if effect in catalogue()
        )
        origin_s = (self.origin_ns - self.first_ns) / 1e9
        innovations = _by_kind(frame.observed, origin_s)
        return Fresh(self._ns(frame.t), self._shown(frame), parameters, innovations)

    def _shown(self, frame: Frame) -> Array:
        turn = so3.matrix_exp(np.array([0.0, 0.0, self.turned]))
        return np.asarray(turn @ rotation(frame))

    def _ns(self, t: float) -> int:
        return self.origin_ns + round(t * 1e9)


def _parameter(effect: str, name: str, value: float, sigma: float) -> Parameter:
    own = next(p for p in catalogue()[effect].parameters if p.name == name)
    return Parameter(effect, name, value, sigma, own.unit, own.prior_sigma, None)


def _rms(some: Sequence[tuple[float, float]]) -> float:
    return float(np.sqrt(np.mean([nis for nis, _ in some])))


def _by_kind(observed: Sequence[Observed], origin_s: float) -> Mapping[str, Innovations]:
    """Updates by kind, their times since the session began."""
    out = {}
    for kind in dict.fromkeys(o.kind for o in observed):
        some = [o for o in observed if o.kind == kind]
        own = observations()[kind]
        out[kind] = Innovations(
            np.array([origin_s + o.t for o in some]), np.array([o.residual for o in some]),
            np.array([o.sigma for o in some]), np.array([o.nis for o in some]), 0, own.unit,
            own.channels,
        )  # fmt: skip
    return out


def warm(effects: Sequence[str]) -> None:
    """What is compiled or loaded when it is first used is so now, not while somebody turns."""
    t = np.arange(400) / 100.0
    still = np.tile([0.0, 0.0, 9.8], (len(t), 1)) + 1e-3 * np.sin(np.outer(t, [70.0, 80.0, 90.0]))
    imu = Imu(t, 1e-4 * np.cos(still), still, np.ones(len(t), dtype=np.bool_))
    recording = Recording("", imu)
    first = replace(imu, t=t[:200], gyro=imu.gyro[:200], accel=still[:200], valid=imu.valid[:200])
    online, _ = begun_at_rest(replace(recording, imu=first), effects)
    stepped(online, recording)

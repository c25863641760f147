"""A session on its way: guidance, looks, what ``explain`` says so far, and who is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from handcal.compiled import so3
from handcal.live.ending import Wanted, with_convention
from handcal.live.goals import wanted as goals_of
from handcal.live.guide import Guide, steps_s
from handcal.live.looks import Look, Looks, with_effects
from handcal.live.session import Session
from handcal.live.sources.browser import Convention, told
from handcal.show import words
from handcal.types import Array, HandcalError, IntArray, Parameter, Prior, Recording

# `explain` runs behind once there is so much, s, and again when there is so many times as much.
EXPLAIN_S, EXPLAIN_AGAIN = 20.0, 1.6
# Its time limit while somebody waits, s; at the end there is none.
BEHIND_S = 20.0
# Letters of a whole bar in the terminal.
BAR = 20


class Board(Protocol):
    """Where a session is drawn as it goes (``show.dashboard.session``)."""

    def readings(self, t: Array, gyro: Array, accel: Array, C_nb: Array | None) -> None:
        """Readings (n, 3) at times t (n,) s of the session, and the attitude at the last."""

    def look(self, t: float, look: Any) -> None:
        """What is known at t (s)."""

    def guidance(self, t: float, told: Mapping[str, Any]) -> None:
        """What is asked for at t (s)."""

    def hypotheses(self, t: float, gains: Mapping[str, float]) -> None:
        """Nats for each leading hypothesis at t (s)."""


@dataclass(frozen=True)
class SoFar:
    """What ``explain`` says of the session so far: effects with probability and nats."""

    seconds: float
    found: tuple[tuple[str, float, float], ...]


def explained_so_far(recording: Recording, before: Prior | None) -> SoFar | None:
    """Run ``explain`` for a while over what there is; None where it cannot say."""
    from handcal.explain import explain

    try:
        found = explain([recording], budget=BEHIND_S, before=before)
    except HandcalError:
        return None
    return SoFar(
        recording.duration_s,
        tuple((m.effect, m.probability, m.log_evidence_gain) for m in found.missing),
    )


@dataclass
class Live:
    """Ticks a few times a second. workers: processes for looks and for ``explain``."""

    session: Session
    wanted: Wanted
    looks: Looks
    explainer: Executor | None = None
    board: Board | None = None
    say: Callable[[str], None] = lambda _: None
    guide: Guide = field(default_factory=Guide)
    convention: Convention | None = None
    so_far: SoFar | None = None
    explaining: Future[SoFar | None] | None = None
    next_explain_s: float = EXPLAIN_S
    attitude: tuple[int, Array] | None = None
    drawn_ns: int = -1
    said: str = ""
    told_brought: str = ""

    def __post_init__(self) -> None:
        """What is loaded when it is first used is loaded now, not while somebody turns."""
        so3.rotations(np.zeros((1, 3)))
        so3.matrix_exp(np.zeros(3))
        so3.quaternion_of(np.eye(3)[None])
        for effect in self.looks.effects:
            words.effect_title(effect)

    def tick(self) -> bool:
        """See what is new. True once all is known as well as was asked for (--until)."""
        ns, value = self._new()
        if len(ns):
            self.guide.saw(ns, value[:, :3])
            self._follow(ns, value)
            self._draw(ns, value)  # (before all that may take a while)
        recording = self._recording() if self.looks.running is None else None
        look = self.looks.tick(self.session, recording)
        if look is not None:
            self._learn(look)
        self._explain()
        self._tell()
        return bool(self.wanted.until) and self.guide.enough

    def _new(self) -> tuple[IntArray, Array]:
        """What came since the last tick, axes put right."""
        ns, value = self.session.since(self.drawn_ns)
        fresh = ns > self.drawn_ns
        return ns[fresh], self._righted(value[fresh])

    def _righted(self, value: Array) -> Array:
        """Readings (n, 6) with the axes and the sign that have been told by now."""
        if self.convention is None:
            return value
        order = [*self.convention.order, 3, 4, 5]
        signs = np.r_[np.ones(3), np.full(3, float(self.convention.sign))]
        return np.asarray(value[:, order] * signs)

    def _recording(self) -> Recording | None:
        """What is in memory, axes put right."""
        recording = self.session.recording()
        if recording is None or not self.wanted.checked:
            return recording
        if self.convention is None:
            imu = recording.imu
            self.convention = told(imu.t, imu.gyro, imu.accel)
        found = self.convention or Convention()
        return with_convention(recording, found)

    def _learn(self, look: Look) -> None:
        self.guide.learned(look)
        self.attitude = (look.end_ns, so3.matrix_of(look.q_nb[None])[0])
        # (from the end of the look to now)
        ns, value = self.session.since(look.end_ns)
        self._follow(ns, self._righted(value))
        goals = goals_of(look.parameters, self.wanted.until)
        self.session.told["parameters"] = [
            _row(p, float(g))
            for p, g in zip(look.parameters, goals, strict=True)
        ]  # fmt: skip
        self.session.told["doubts"] = [d.sentence for d in look.doubts]
        if self.board is not None:
            self.board.look(self._t(look.end_ns), look)

    def _follow(self, ns: IntArray, value: Array) -> None:
        """Carry the attitude along with the gyro, its bias taken off."""
        if self.attitude is None or self.guide.look is None:
            return
        last, C = self.attitude
        own = ns > last
        if not own.any():
            return
        at = ns[own]
        step = steps_s(at, last)[:, None]
        for turn in so3.rotations((value[own, :3] - self.guide.look.bias) * step):
            C = C @ turn
        self.attitude = int(at[-1]), C

    def _explain(self) -> None:
        """Take in what ``explain`` found, and let it run again when there is more."""
        if self.explaining is not None and self.explaining.done():
            try:
                self.so_far = self.explaining.result() or self.so_far
            except BrokenExecutor:
                self.explainer = None
            self.explaining = None
            if self.so_far is not None:
                found = self.so_far.found
                if not self.wanted.effects:
                    with_effects(self.looks, [effect for effect, _, _ in found])
                self.session.told["so_far"] = [
                    f"{words.effect_title(e)}: {p:.0%}, {g:.0f} nats" for e, p, g in found
                ]
                if self.board is not None:
                    t = self.session.recorder.seconds
                    self.board.hypotheses(t, {e: g for e, _, g in found})
        due = self.session.recorder.seconds >= self.next_explain_s
        if self.explainer is None or self.explaining is not None or not due:
            return
        recording = self._recording()
        if recording is None:
            return
        self.next_explain_s = EXPLAIN_AGAIN * self.session.recorder.seconds
        self.explaining = self.explainer.submit(
            explained_so_far, recording, self.looks.before or self.wanted.before
        )

    def _tell(self) -> None:
        told_now = self.guide.told()
        self.session.told |= told_now
        say = told_now["turn"]["say"]
        if say != self.said:
            if told_now["brought"] and told_now["brought"] != self.told_brought:
                self.told_brought = told_now["brought"]
                self.say(self.told_brought)
                for line in bars(self.session.told.get("parameters", [])):
                    self.say(line)
            self.said = say
            self.say(say)

    def _draw(self, ns: IntArray, value: Array) -> None:
        self.drawn_ns = int(ns[-1])
        if self.board is not None:
            C = self.attitude[1] if self.attitude is not None else None
            self.board.readings((ns - self._zero()) / 1e9, value[:, :3], value[:, 3:], C)
            self.board.guidance(self._t(int(ns[-1])), self.guide.told())

    def _zero(self) -> int:
        return self.session.recorder.first_ns or 0

    def _t(self, ns: int) -> float:
        return (ns - self._zero()) / 1e9


def bars(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is left to learn of each parameter, as lines for the terminal."""
    wide = max((len(row["name"]) for row in rows), default=0)
    text = max((len(row["text"]) for row in rows), default=0)
    return [
        f"  {row['name']:<{wide}}  {row['text']:>{text}}  "
        + ("enough" if row["good"] else "█" * max(1, round(BAR * row["left"])))
        for row in rows
    ]


def _row(p: Parameter, goal: float) -> dict[str, Any]:
    """One bar: text, and how far it is from the usual (1) to the goal (0), in logarithms."""
    from handcal.units import shown

    unit = shown(p.unit, [p.value, p.sigma])
    share = 0.0
    if np.isfinite(goal) and p.sigma > goal:
        whole = np.log(max(p.prior_sigma / goal, 2.0))
        share = float(np.clip(np.log(p.sigma / goal) / whole, 0.0, 1.0))
    text = f"{unit.value(p.value, p.sigma, sign=True)} ± {unit.value(p.sigma, p.sigma)} {unit.unit}"
    # (a telephone is narrow)
    title = words.parameter_title(p).replace("Accelerometer", "Accel.")
    return {"name": title, "text": text, "left": round(share, 3), "good": p.sigma <= goal}

"""A session on its way: guidance, looks, the leading explanation, and where they are shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from handcal.compiled import so3
from handcal.live.ending import Wanted, with_convention
from handcal.live.following import Following, Fresh
from handcal.live.goals import wanted as goals_of
from handcal.live.guide import Guide, steps_s
from handcal.live.looks import Look, Looks, with_effects
from handcal.live.session import Session
from handcal.live.sources.browser import Convention, told
from handcal.live.turns import CHOICE, asked_for
from handcal.show import words
from handcal.types import (
    Array,
    HandcalError,
    Innovations,
    IntArray,
    Parameter,
    Prior,
    Recording,
)

if TYPE_CHECKING:
    from handcal.explain.leading import Leading
    from handcal.explanation import Missing

# The leading explanation is looked for once there is so much, s, and again after so much more.
EXPLAIN_S, EXPLAIN_AGAIN_S = 20.0, 4.0
# Its time limit while somebody waits, s.
BEHIND_S = 20.0
# So often, s of recording, the terminal says how far what is asked for is, if nothing else is new.
AGAIN_S = 5.0
# Letters of a whole bar in the terminal.
BAR = 20


class Board(Protocol):
    """Where a session is drawn as it goes (``show.dashboard.session``)."""

    def readings(self, t: Array, gyro: Array, accel: Array, C_nb: Array | None) -> None:
        """Readings (n, 3) at times t (n,) s of the session, and the attitude at the last."""

    def estimates(self, t: float, parameters: Sequence[Parameter]) -> None:
        """What is known at t (s)."""

    def updates(self, innovations: Mapping[str, Innovations]) -> None:
        """Innovations that are new, by kind of observation, at times of the session (s)."""

    def guidance(self, t: float, told: Mapping[str, Any]) -> None:
        """What is asked for at t (s)."""

    def hypotheses(self, t: float, gains: Mapping[str, float]) -> None:
        """Nats for each leading hypothesis at t (s)."""


def explained_so_far(recording: Recording, before: Prior | None) -> Leading | None:
    """The leading explanation of what there is; None where no fit converges."""
    from handcal.explain.leading import leading
    from handcal.search.budget import after

    try:
        budget = after(time.monotonic(), BEHIND_S)
        return leading(recording, before, [asked.motion for asked in CHOICE], budget)
    except HandcalError:
        return None


@dataclass
class Live:
    """Ticks a few times a second. explainer: a process for the leading explanation."""

    session: Session
    wanted: Wanted
    looks: Looks
    explainer: Executor | None = None
    board: Board | None = None
    say: Callable[[str], None] = lambda _: None
    guide: Guide = field(default_factory=Guide)
    convention: Convention | None = None
    so_far: Leading | None = None
    explaining: Future[Leading | None] | None = None
    next_explain_s: float = EXPLAIN_S
    attitude: tuple[int, Array] | None = None
    drawn_ns: int = -1
    said: str = ""
    said_s: float = 0.0
    told_brought: str = ""
    following: Following = field(init=False)
    looked_as: Convention = field(default_factory=Convention)

    def __post_init__(self) -> None:
        """What is loaded when it is first used is loaded now, not while somebody turns."""
        self.following = Following(self.looks.effects, self.looks.before)
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
        recording = None
        if self.looks.running is None:
            recording = self._recording()
            self.looked_as = self._found
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

    @property
    def _found(self) -> Convention:
        """As which readings are taken."""
        return self.convention or Convention()

    def _recording(self) -> Recording | None:
        """What is in memory, axes put right."""
        recording = self.session.recording()
        if recording is None or not self.wanted.checked:
            return recording
        if self.convention is None:
            imu = recording.imu
            self.convention = told(imu.t, imu.gyro, imu.accel)
            if not _alike(self._found, Convention()):
                self.following.give_up()
        return self._put_right(recording)

    def _put_right(self, recording: Recording) -> Recording:
        """A piece of what was recorded, its axes as they have been told by now."""
        return with_convention(recording, self._found) if self.wanted.checked else recording

    def _learn(self, look: Look) -> None:
        self.guide.learned(look)
        if _alike(self.looked_as, self._found):
            standing, levels = look.standing, look.noise
            self.following.stands(
                standing, levels, look.from_ns, self.session, self._put_right
            )  # fmt: skip
        if self.following.online is None:
            self.attitude = (look.end_ns, so3.matrix_of(look.q_nb[None])[0])
        # (from the end of the look to now)
        ns, value = self.session.since(look.end_ns)
        self._follow(ns, self._righted(value))
        self.session.told["doubts"] = [d.sentence for d in look.doubts]
        if self.following.online is None:
            self.session.told.pop("filter", None)
            self._know(self._t(look.end_ns), look.parameters)
            if self.board is not None:
                begin = self._t(look.from_ns)
                self.board.updates(
                    {k: replace(i, t=i.t + begin) for k, i in look.innovations.items()}
                )

    def _know(self, t: float, parameters: Sequence[Parameter]) -> None:
        """Tell what is known at t (s), by the filter or by a look."""
        goals = goals_of(parameters, self.wanted.until)
        rows = zip(parameters, goals, strict=True)
        self.session.told["parameters"] = [_row(p, float(g)) for p, g in rows]
        if self.board is not None:
            self.board.estimates(t, parameters)

    def _filtered(self, fresh: Fresh) -> None:
        """Tell what the filter says."""
        self.attitude = fresh.t_ns, fresh.C_nb
        self._know(self._t(fresh.t_ns), fresh.parameters)
        self.session.told["filter"] = self.following.told(self._zero())
        if self.board is not None and fresh.innovations:
            self.board.updates(fresh.innovations)

    def _follow(self, ns: IntArray, value: Array) -> None:
        """Step the filter over what came; where it does not run, carry the attitude along with the
        gyro, its bias taken off."""
        fresh = self.following.saw(self.session, self._put_right)
        if fresh is not None:
            self._filtered(fresh)
        if self.attitude is None or self.guide.look is None or self.following.online is not None:
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
        """Take in the leading explanation, and look for it again when there is more."""
        if self.explaining is not None and self.explaining.done():
            try:
                self.so_far = self.explaining.result() or self.so_far
            except BrokenExecutor:
                self.explainer = None
            self.explaining = None
            if self.so_far is not None:
                self._lead(self.so_far)
        due = self.session.recorder.seconds >= self.next_explain_s
        if self.explainer is None or self.explaining is not None or not due:
            return
        recording = self._recording()
        if recording is None:
            return
        self.next_explain_s = self.session.recorder.seconds + EXPLAIN_AGAIN_S
        self.explaining = self.explainer.submit(
            explained_so_far, recording, self.looks.before or self.wanted.before
        )

    def _lead(self, so_far: Leading) -> None:
        """Show, estimate and ask for what the leading explanation says."""
        if not self.wanted.effects:
            with_effects(self.looks, [m.effect for m in so_far.missing])
        said = [_leads(m) for m in so_far.missing]
        if said and said != self.session.told.get("so_far"):
            self.say(f"So far best explained by: {'; '.join(said)}.")
        self.session.told["so_far"] = said
        self.guide.wanted = None
        for following in so_far.next[:1]:
            titles = words.listed([words.effect_title(i) for i in following.separates])
            self.guide.wanted = asked_for(following.motion), f"It separates {titles}."
        if self.board is not None:
            gains = {m.effect: m.log_evidence_gain for m in so_far.missing}
            self.board.hypotheses(self.session.recorder.seconds, gains)

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
                for line in checks(self.session.told.get("filter")):
                    self.say(line)
            self.said, self.said_s = say, self.session.recorder.seconds
            self.say(say)
        elif self.session.recorder.seconds - self.said_s >= AGAIN_S:
            self.said_s = self.session.recorder.seconds
            rows = self.session.told.get("parameters", [])
            for line in filter(None, (self.guide.open, least_known(rows))):
                self.say(line)

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


def _leads(m: Missing) -> str:
    """An effect of the leading explanation, with those that could stand in its place."""
    from handcal.show.explanation.words import percent

    names = " or ".join(words.effect_title(i) for i in (m.effect, *m.indistinguishable_from))
    return f"{names}: {percent(m.probability)}, {m.log_evidence_gain:,.0f} nats"


def bars(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is left to learn of each parameter, as lines for the terminal."""
    wide = max((len(row["name"]) for row in rows), default=0)
    text = max((len(row["text"]) for row in rows), default=0)
    return [
        f"  {row['name']:<{wide}}  {row['text']:>{text}}  "
        + ("enough" if row["good"] else "█" * max(1, round(BAR * row["left"])))
        for row in rows
    ]


def least_known(rows: Sequence[Mapping[str, Any]]) -> str:
    """Of which parameter most is left to learn, for the terminal; empty where all is known."""
    row = max(rows, key=lambda row: float(row["left"]), default=None)
    return "" if row is None or row["good"] else f"Least known: {row['name']}, {row['text']}."


def checks(filtered: Mapping[str, Any] | None) -> list[str]:
    """How the filter has it held, and its innovations beside their gates, for the terminal."""
    if filtered is None:
        return []
    C = np.array(filtered["held"]).reshape(3, 3)
    level = np.degrees(np.arcsin(np.clip(C[2, :2], -1.0, 1.0)))
    yaw = np.degrees(np.arctan2(C[1, 0], C[0, 0]))
    way = "up" if C[2, 2] >= 0.0 else "down"
    held = f"  held: screen {way}, right edge {level[0]:+.0f}, top edge {level[1]:+.0f} deg above "
    lines = [f"{held}the horizon, turned to {yaw:+.0f} deg"]
    return lines + [
        f"  {one['name']}: innovations {one['times']:.1f} times as large as expected, "
        f"{one['beyond']} of {one['of']} beyond their gate of {one['gate']:.0f} sigma"
        for one in filtered["innovations"]
    ]


def _alike(a: Convention, b: Convention) -> bool:
    """Whether readings are taken the same way."""
    return (a.order, a.sign) == (b.order, b.sign)


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

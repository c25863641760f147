"""What a hand is asked to do, step by step, and how far it has come, seen from the gyro.

A step is a rest, or a turn about one of the body's axes. Which way round somebody turns first is
left open, but for quarter turns; back is the other way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from handcal.motions import REST, Motion, Turn, X, Y, Z
from handcal.types import Array

# Slower than this, rad/s, somebody holds it still (a hand trembles by 1 to 2 deg/s).
STILL_RAD_S = np.radians(4.0)
# So much of a turn counts as the whole: hands stop early, and slow ends are not worth waiting for.
WHOLE = 0.9
# Of a rest, so much is enough for its mean to tell something.
RESTED = 0.75
# Turned so far about another axis without getting on about the right one, it is said.
ASTRAY_RAD = np.radians(120.0)
# Of smaller turns, deg, the way round matters: how it is to lie comes of them.
WAY_DEG = 180.0
# How fast a turn is asked for, s for 360 deg: what a hand does without haste.
ROUND_S = 5.0
# From lying to standing, s.
TIP_S = 2.0

_AXES = {X: "x", Y: "y", Z: "z"}
_HOW = {
    "x": "about the line from its left edge to its right edge, top over bottom",
    "y": "about the line from its bottom edge to its top edge, as if leafing through a book",
    "z": "flat in its own plane, like a plate on a table",
}
_TIP = {
    ("x", 1): "stand it up on its lower edge, screen towards you",
    ("y", 1): "tip it onto its right edge",
    ("y", -1): "tip it onto its left edge",
}


@dataclass(frozen=True)
class Asked:
    """A motion as it is asked for. name: short, as in a list."""

    name: str
    motion: Motion


@dataclass(frozen=True)
class Proposal:
    """The motion to ask for, by its name; worst: how many times as uncertain as wanted the worst
    parameter is now, after this motion, and after all that is planned; planned: all of it."""

    name: str
    worst: tuple[float, float, float]
    planned: tuple[str, ...]


@dataclass
class Step:
    """One turn of a motion and how far it is. sign: which way it has to go, 0 where that is left
    open; angle about its axis, rad, from where it began;
    low, high: how far to either side; still: s in rest; astray: rad about the other axes."""

    turn: Turn
    back: bool = False
    sign: int = 0
    angle: float = 0.0
    low: float = 0.0
    high: float = 0.0
    still: float = 0.0
    astray: float = 0.0

    @property
    def done(self) -> float:
        """Which share has been done, 0 to 1."""
        (_, degrees, seconds), share = self.turn, 0.0
        if degrees == 0.0:
            return min(1.0, self.still / (RESTED * seconds))
        if self.sign:
            share = self.angle - self.low if self.sign > 0 else self.high - self.angle
        else:
            share = max(self.angle - self.low, self.high - self.angle)
        return float(min(1.0, share / (WHOLE * abs(np.radians(degrees)))))

    def saw(self, rate: Array, step: Array) -> int:
        """Take in rates (n, 3) rad/s over steps (n,) s. How many samples were used: the rest is
        the next step's."""
        axis = np.asarray(self.turn[0])
        for i, (w, dt) in enumerate(zip(rate, step, strict=True)):
            size = float(np.linalg.norm(w))
            self.still = self.still + float(dt) if size < STILL_RAD_S else 0.0
            about = float(w @ axis)
            self.angle += about * float(dt)
            self.low, self.high = min(self.low, self.angle), max(self.high, self.angle)
            self.astray += max(0.0, size - 2.0 * abs(about)) * float(dt)
            if self.done >= 1.0:
                return i + 1
        return len(rate)


@dataclass
class Watched:
    """A motion that somebody is doing."""

    asked: Asked
    at: int = 0
    steps: list[Step] = field(default_factory=list)

    def __post_init__(self) -> None:
        turns = [t for t in self.asked.motion.turns if t[2] > 0.0]
        # (about the same axis as before, the other way)
        backs = [
            any(e[0] == t[0] and e[1] == -t[1] != 0.0 for e in turns[:i])
            for i, t in enumerate(turns)
        ]
        self.steps = [
            Step(t, b, int(np.sign(t[1])) if abs(t[1]) < WAY_DEG else 0)
            for t, b in zip(turns, backs, strict=True)
        ]

    @property
    def over(self) -> bool:
        """Whether all has been done."""
        return self.at >= len(self.steps)

    @property
    def step(self) -> Step:
        """What is to be done now (the last, when all has been done)."""
        return self.steps[min(self.at, len(self.steps) - 1)]

    @property
    def done(self) -> float:
        """Which share of the whole has been done, by the time that it takes."""
        seconds = np.array([s.turn[2] for s in self.steps])
        shares = np.array([1.0 if i < self.at else s.done for i, s in enumerate(self.steps)])
        shares[self.at + 1 :] = 0.0
        return float(seconds @ shares / seconds.sum())

    def saw(self, rate: Array, step: Array) -> None:
        """Take in rates (n, 3) rad/s, less the bias, over steps (n,) s."""
        while len(rate) and not self.over:
            now = self.steps[self.at]
            used = now.saw(rate, step)
            rate, step = rate[used:], step[used:]
            if now.done >= 1.0:
                self.at += 1
                self._turned_back()

    def _turned_back(self) -> None:
        """Where what is next goes back: the other way than it was done."""
        if self.over or self.step.sign or not self.step.back:
            return
        axis, degrees, _ = self.step.turn
        there = next(s for s in self.steps if s.turn[0] == axis and s.turn[1] == -degrees)
        self.step.sign = -1 if there.angle - there.low >= there.high - there.angle else 1

    @property
    def sentence(self) -> str:
        """What to do now."""
        axis, degrees, seconds = self.step.turn
        name = _AXES.get(axis, "")
        if degrees == 0.0:
            return f"Hold it still, or lay it down, for {seconds:.0f} seconds."
        if abs(degrees) < WAY_DEG:
            if self.step.back:
                return "Now back, as it lay before."
            return f"Now {_TIP[name, int(np.sign(degrees))]}, in one place."
        how = _HOW.get(name, "about the line shown")
        if self.step.back:
            return f"And back the other way, in {seconds:.0f} seconds."
        far = "once all the way round" if abs(degrees) >= 360.0 else "half round"
        return f"Turn it {far} {how}, in {seconds:.0f} seconds. Keep it in one place."

    @property
    def hint(self) -> str:
        """What goes wrong, if something does."""
        turning = self.step.turn[1] != 0.0
        if turning and self.step.astray > ASTRAY_RAD and self.step.done < 0.5:
            return "That is about another axis: look at the picture."
        return ""

    @property
    def picture(self) -> dict[str, object]:
        """What the moving picture shows: how it lies, and the turn that is asked for."""
        up = np.eye(3)
        for s in self.steps[: min(self.at, len(self.steps) - 1)]:
            up = up @ _rotation(s.turn)
        axis, degrees, seconds = self.step.turn
        return {"from": up.ravel().round(4).tolist(), "axis": list(axis), "degrees": degrees,
                "seconds": seconds}  # fmt: skip


def _rotation(turn: Turn) -> Array:
    from handcal.compiled import so3

    axis = np.asarray(turn[0], dtype=np.float64)
    return np.asarray(so3.matrix_exp(np.radians(turn[1]) * axis / np.linalg.norm(axis)))


def _asked(name: str, *turns: Turn) -> Asked:
    """With a rest behind it; the one before is the end of what came before."""
    motion = Motion(name, (*turns, (Z, 0.0, REST)))
    return Asked(name, motion)


def _round(axis: tuple[float, float, float], seconds: float = ROUND_S) -> tuple[Turn, Turn]:
    return (axis, 360.0, seconds), (axis, -360.0, seconds)


def _stood(axis: tuple[float, float, float], degrees: float, *turns: Turn) -> tuple[Turn, ...]:
    """Tipped, some turns, and tipped back."""
    return (axis, degrees, TIP_S), *turns, (axis, -degrees, TIP_S)


FIRST = Asked("lie still", Motion(
    "Lay it down on its back, screen up, and leave it there.", ((Z, 0.0, 4.0),)))  # fmt: skip
# What may be asked for; the information matrix says which of them.
CHOICE: Sequence[Asked] = (
    _asked("once about x and back", *_round(X)),
    _asked("once about y and back", *_round(Y)),
    _asked("once about z, lying, and back", *_round(Z)),
    _asked("once about z, standing, and back", *_stood(X, 90.0, *_round(Z))),
    _asked("once about x, on its side, and back", *_stood(Y, 90.0, *_round(X))),
    _asked("once about y, standing, and back", *_stood(X, 90.0, *_round(Y))),
    _asked("half round about x, rest, and back", (X, 180.0, 3.0), (Z, 0.0, REST), (X, -180.0, 3.0)),
    _asked("half round about y, rest, and back", (Y, 180.0, 3.0), (Z, 0.0, REST), (Y, -180.0, 3.0)),
    _asked("stand it up, rest, and back", *_stood(X, 90.0, (Z, 0.0, REST))),
    _asked("on its right edge, rest, and back", *_stood(Y, 90.0, (Z, 0.0, REST))),
    _asked("on its left edge, rest, and back", *_stood(Y, -90.0, (Z, 0.0, REST))),
    _asked("lie still", (Z, 0.0, 8.0)),
)  # fmt: skip


def asked_for(name: str) -> Asked:
    """The motion of this name in ``CHOICE``."""
    return next(asked for asked in CHOICE if asked.name == name)

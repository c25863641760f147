"""Leads a hand: asks for a motion, sees from the data whether it was done, says what it brought."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from handcal.live.looks import Look
from handcal.live.turns import CHOICE, FIRST, Asked, Watched, asked_for
from handcal.show import words
from handcal.types import Array, IntArray, Parameter

WAIT = "Hold it where it is: working out what to do next."
ENOUGH = "That is enough: press Stop, or go on turning to know more."
# A motion that has got no further for this long, s of recording, gives way to the one that is now
# best; and without an estimate for this long, turns are asked for one after the other.
PATIENCE_S = 15.0
# An improvement below a tenth is not worth a word.
BETTER = 0.9
# Of these at most is said what a motion brought.
MOST_TOLD = 3
# A step between two readings is no longer, s: a gap is no turn, over it nothing is known.
LONGEST_STEP_S = 0.1


@dataclass
class Guide:
    """watched: the motion that is asked for; why: what it separates; wanted: a motion to ask for
    next that separates explanations, and a sentence that says which; before: the look when it was
    asked for; brought: what the last one did; over_ns: when the last motion was over, None while
    one is being done; most, since_ns: how far this one has come, and when it last got further."""

    watched: Watched = field(default_factory=lambda: Watched(FIRST))
    why: str = ""
    wanted: tuple[Asked, str] | None = None
    look: Look | None = None
    before: Look | None = None
    brought: str = ""
    asked: list[str] = field(default_factory=list)
    over_ns: int | None = None
    most: float = 0.0
    since_ns: int | None = None
    last_ns: int | None = None
    enough: bool = False

    def saw(self, ns: IntArray, gyro: Array) -> None:
        """Take in what was read since the last time: stamps (n,) ns, rates (n, 3) rad/s."""
        fresh = ns > (-1 if self.last_ns is None else self.last_ns)
        ns, gyro = ns[fresh], gyro[fresh]
        if not len(ns):
            return
        step = steps_s(ns, int(ns[0]) if self.last_ns is None else self.last_ns)
        self.last_ns = int(ns[-1])
        if self.over_ns is None:
            bias = self.look.bias if self.look is not None else 0.0
            self.watched.saw(gyro - bias, step)
            if self.watched.done > self.most or self.since_ns is None:
                self.most, self.since_ns = self.watched.done, self.last_ns
            if self.watched.over:
                self.over_ns = self.last_ns
            elif self.last_ns - self.since_ns > PATIENCE_S * 1e9:
                self._ask(*self._best)
        elif self.last_ns - self.over_ns > PATIENCE_S * 1e9:
            self._ask(CHOICE[len(self.asked) % len(CHOICE)])

    @property
    def _best(self) -> tuple[Asked, str]:
        """What separates explanations; else by the last look; without one they follow one
        another."""
        if self.wanted is not None:
            return self.wanted
        if self.look is not None and self.look.next is not None:
            return asked_for(self.look.next.name), ""
        return CHOICE[len(self.asked) % len(CHOICE)], ""

    def learned(self, look: Look) -> None:
        """A new look: it says what the last motion brought, and which is next."""
        self.look, self.enough = look, look.enough
        if self.over_ns is None or look.end_ns < self.over_ns:
            return
        if self.before is not None:
            self.brought = brought(self.before, look, self.watched.asked.name)
        if look.next is not None and not look.enough:
            self._ask(*self._best)

    def _ask(self, asked: Asked, why: str = "") -> None:
        self.watched, self.before, self.over_ns = Watched(asked), self.look, None
        self.why, self.wanted = why, None
        self.most, self.since_ns = 0.0, None
        self.asked.append(asked.name)

    @property
    def open(self) -> str:
        """How far the motion is that is asked for; empty between two."""
        if self.over_ns is not None or self.enough:
            return ""
        far = f"“{self.watched.asked.name}” is {100 * self.watched.done:.0f} % done"
        return f"{far}. {self.watched.hint}" if self.watched.hint else f"{far}."

    def told(self) -> dict[str, Any]:
        """What the page, the terminal and the dashboard are told."""
        out: dict[str, Any] = {"brought": self.brought}
        if self.enough:
            return out | {"turn": {"say": ENOUGH, "done": 1.0}}
        if self.over_ns is not None:
            return out | {"turn": {"say": WAIT, "done": 1.0}}
        now = self.watched
        say = now.asked.motion.sentence if now.asked is FIRST else now.sentence
        turn = {"say": say, "hint": now.hint or self.why, "done": round(now.done, 3),
                "step": now.at + 1, "steps": len(now.steps), "name": now.asked.name,
                "picture": now.picture}  # fmt: skip
        return out | {"turn": turn}


def steps_s(ns: IntArray, last: int) -> Array:
    """Seconds (n,) from each stamp to the one before it; last: that before the first, ns."""
    return np.clip(np.diff(ns, prepend=last) / 1e9, 0.0, LONGEST_STEP_S)


def brought(before: Look, after: Look, name: str) -> str:
    """What a motion did: the parameters that became known best, the most improved first."""
    improved: list[tuple[float, Parameter, float]] = []
    for p in after.parameters:
        old = before.sigma(p.effect, p.name)
        if old is not None and p.sigma < BETTER * old:
            improved.append((p.sigma / old, p, old))
    if not improved:
        return f"“{name}” told little that was new."
    improved.sort(key=lambda entry: entry[0])
    told = []
    for _, p, old in improved[:MOST_TOLD]:
        unit = words.shown_group([p])
        title = words.parameter_title(p)
        told.append(
            f"{title[0].lower()}{title[1:]} from ± {unit.value(old, old)} to ± "
            f"{unit.value(p.sigma, p.sigma)} {unit.unit}"
        )
    return f"That brought {words.listed(told)}."

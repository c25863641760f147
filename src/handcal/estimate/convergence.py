"""How the evidence of a fit goes from round to round: whether it rests, swings or runs away."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from handcal.types import Array

# At the most.
ROUNDS = 10
# Shortest step of a fit whose evidence goes up and down, of the way to where it points.
SHORTEST = 0.2
# Rounds in a row of which each is worse, to so many nats below the first: no fit comes of that.
FALLS, FALLEN = 3, 1000.0
# Rounds in a row of which each is worse, below what would be of use: none comes of that either.
# (One is enough where that is ``FALLEN`` nats below.)
SINKING = 2
# Steps of the constants count as one way where they are that far along it (cosine), and are not
# taken further than so many steps at once.
ALONG, FURTHEST = 0.95, 5.0


@dataclass
class Rounds:
    """The evidence so far, and the share of the way that the next round goes to where it points;
    tolerance: nats within which it rests."""

    tolerance: float
    step: float = 1.0
    evidence: float = -math.inf
    before: float = -math.inf
    first: float = math.nan
    falls: int = 0
    reach: float = 1.0
    aim: Array | None = None
    last: deque[float] = field(default_factory=lambda: deque(maxlen=ROUNDS // 2))

    def rests(self, now: float) -> bool:
        """Whether another round changes nothing."""
        return abs(now - self.evidence) < self.tolerance * min(self.reach, 1.0)

    def swings(self, now: float) -> bool:
        """Whether it goes to and fro between two trajectories, and this is the better."""
        return abs(now - self.before) < self.tolerance and now > self.evidence

    def went_on(self, now: float) -> None:
        """A round more, after which the evidence is this."""
        turns = (now - self.evidence) * (self.evidence - self.before) < 0.0
        self.step = max(0.5 * self.step, SHORTEST) if turns else min(1.5 * self.step, 1.0)
        self.falls = self.falls + 1 if now < self.evidence else 0
        self.before, self.evidence = self.evidence, now
        self.first = now if math.isnan(self.first) else self.first
        self.last.append(float(now))

    def aims(self, aim: Array, information: Array) -> None:
        """Where this round points: the step (n,) of the constants, of which this (n, n) is known.

        Where it lies along the one before, as far as both tell all such steps together are taken at
        once, or the part of this one that does not overshoot (Aitken's extrapolation): derivatives
        that leave out what noise excites find their way in many small steps, priors of several
        scales in steps that are too large.
        """
        before, gone = self.aim, self.reach
        self.aim, self.reach = aim, self.step
        if before is None or len(before) != len(aim):
            return
        squared, along = float(before @ information @ before), float(aim @ information @ before)
        length = math.sqrt(max(squared * float(aim @ information @ aim), 0.0))
        if abs(along) > ALONG * length > 0.0:
            brings = (1.0 - along / squared) / gone  # (a whole step, of what is missing)
            self.reach = max(1.0 / max(brings, 1.0 / FURTHEST), SHORTEST)

    @property
    def runs_away(self) -> bool:
        """Whether each of the last rounds was worse, and it is hopelessly far down."""
        return self.falls >= FALLS and self.evidence < self.first - FALLEN

    def sinks(self, least: float) -> bool:
        """Whether the last rounds were worse each, and the evidence is less than this; or the last
        one alone, and it is hopelessly less."""
        enough = least if self.falls >= SINKING else least - FALLEN
        return self.falls > 0 and self.evidence < enough

    @property
    def swing(self) -> float:
        """Nats between the best and the worst of the last rounds."""
        return max(self.last) - min(self.last)

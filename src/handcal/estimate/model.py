"""What a fit is: of one recording, and of all recordings of a device together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.effects import Effect
from handcal.estimate import noise_levels
from handcal.estimate.case import Case
from handcal.estimate.evidence import Reduction
from handcal.estimate.linear import About, Linear
from handcal.estimate.problem import Problem
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.trajectory import Trajectory
from handcal.types import Array

# Standard deviations below zero within which something that cannot be negative may come out.
BELOW_ZERO = 3.0


@dataclass(frozen=True)
class Fitted:
    """One recording with its trajectory under the model and its noise levels; linearised about it
    when that is asked for."""

    case: Case
    about: About
    levels: Mapping[str, float]
    curvature: noise_levels.Curvature = noise_levels.NO_CURVATURE

    @property
    def problem(self) -> Problem:
        """The problem before it is linearised; afterwards (``linear.problem``) its readings are
        corrected, while slots, kinds and levels are the same."""
        return self.about.problem

    @property
    def trajectory(self) -> Trajectory:
        return self.about.trajectory

    @property
    def t(self) -> Array:
        """Times (k,) of the epochs, s."""
        return self.problem.nodes.t[self.trajectory.node]

    @property
    def linear(self) -> Linear:
        return self.about.linear

    @property
    def bare(self) -> Fitted:
        """The same without what it was linearised to, which is made again if it is asked for."""
        return replace(self, about=self.about.bare)


@dataclass(frozen=True)
class Known:
    """What other recordings said of the parameters ``names``: mean (k,) and a square root of
    the covariance (k, k), in units of the priors."""

    names: tuple[tuple[str, str], ...]
    mean: Array
    root: Array


@dataclass(frozen=True)
class Model:
    """A settled fit of some effects to all recordings.

    u, covariance: the effects' parameters in units of their priors, in the order of
    ``quadratic.names``; log_evidence: of all recordings together, noise prior not counted;
    known: what was known of them before; swing: nats between the best and the worst of its last
    rounds, where it does not settle.
    """

    effects: tuple[Effect, ...]
    parts: tuple[Fitted, ...]
    quadratic: Quadratic
    u: Array
    covariance: Array
    log_evidence: float
    settled: bool
    known: Known | None = None
    swing: float = 0.0

    @property
    def bare(self) -> Model:
        """The same without what its parts were linearised to."""
        return replace(self, parts=tuple(f.bare for f in self.parts))

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(e.id for e in self.effects)

    @property
    def chosen(self) -> frozenset[str]:
        """Ids of the effects that a scan weighs: all but those that are noise."""
        return frozenset(e.id for e in self.effects if e.process is None)

    @property
    def one_sided(self) -> bool:
        """Whether nothing came out clearly negative that cannot be."""
        positive = {(e.id, p.name) for e in self.effects for p in e.parameters if p.positive}
        mine = np.array([n in positive for n in self.quadratic.names], dtype=np.bool_)
        sigma = np.sqrt(np.diag(self.covariance))
        return bool(np.all(self.u[mine] > -BELOW_ZERO * sigma[mine]))


@dataclass(frozen=True)
class Rested:
    """A fit on its way: its parts, whether they rest, their evidence, within how many nats; wide:
    with all scales of the priors; swing: nats between the best and the worst of its last rounds,
    where it does not rest; step: nats that its last round changed. Where the parts rest: what all
    recordings say, and the parts' own reductions (empty elsewhere), which other noise levels do not
    change: whoever goes on from them empties the list, since they are large. sank: whether it was
    given up below what would have been of use."""

    parts: list[Fitted]
    settled: bool
    evidence: float
    rest: float
    wide: bool = False
    whole: Quadratic | None = None
    reductions: list[Reduction] = field(default_factory=list)
    swing: float = 0.0
    step: float = math.inf
    sank: bool = False

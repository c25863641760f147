"""Types of a fit: of one recording, and of all recordings of a device together."""

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

# Standard deviations below zero that an estimate of a positive parameter may have.
BELOW_ZERO = 3.0


@dataclass(frozen=True)
class Fitted:
    """One recording with its trajectory and noise levels under a model. It is linearised on
    demand."""

    case: Case
    about: About
    levels: Mapping[str, float]
    curvature: noise_levels.Curvature = noise_levels.NO_CURVATURE

    @property
    def problem(self) -> Problem:
        """The problem before linearisation. ``linear.problem`` has the same slots, kinds and levels
        and corrected readings."""
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
        """The same without its linearisation, which is made again on demand."""
        return replace(self, about=self.about.bare)


@dataclass(frozen=True)
class Known:
    """A prior of the parameters ``names`` from other recordings: mean (k,) and a square root of
    the covariance (k, k), in units of the usual priors."""

    names: tuple[tuple[str, str], ...]
    mean: Array
    root: Array


@dataclass(frozen=True)
class Model:
    """A settled fit of some effects to all recordings.

    u (k,), covariance (k, k): the effects' parameters in units of their priors, in the order of
    ``quadratic.names``. log_evidence: of all recordings together, without the prior of noise
    levels. known: prior from other recordings. swing: range of the evidence over the last rounds,
    nats, if it does not settle.
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
        """The same without the linearisations of its parts."""
        return replace(self, parts=tuple(f.bare for f in self.parts))

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(e.id for e in self.effects)

    @property
    def chosen(self) -> frozenset[str]:
        """Ids of the effects that a scan evaluates: all except noise."""
        return frozenset(e.id for e in self.effects if e.process is None)

    @property
    def one_sided(self) -> bool:
        """Whether no positive parameter came out clearly negative."""
        positive = {(e.id, p.name) for e in self.effects for p in e.parameters if p.positive}
        mine = np.array([n in positive for n in self.quadratic.names], dtype=np.bool_)
        sigma = np.sqrt(np.diag(self.covariance))
        return bool(np.all(self.u[mine] > -BELOW_ZERO * sigma[mine]))


@dataclass(frozen=True)
class Rested:
    """A fit at fixed noise levels, where its rounds ended.

    settled: whether the evidence rests, within ``rest`` nats. wide: with all scales of the priors.
    whole, reductions: if settled, the summed quadratic and the reductions of the parts. These hold
    at other noise levels too; the next fit empties the list, to free memory. swing: range of the
    evidence over the last rounds, nats, if it does not rest. step: change in the last round, nats.
    sank: whether the fit was given up below the evidence of use.
    """

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

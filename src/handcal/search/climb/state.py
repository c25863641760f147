"""The state that the steps of a climb share, and the test of whether a model is likelier."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from handcal.estimate.case import name_of
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.laws.best_law import Survey, Term
from handcal.laws.first_look import Vocabulary
from handcal.model_score import PRIOR, better, log_prior, score
from handcal.search.budget import Budget
from handcal.search.space import Space

T = TypeVar("T")
W = TypeVar("W")
# Called with the share that is done, and the present model.
Report = Callable[[float, Model], None]
# Gain below which an effect may only compensate another's wrong name, nats.
WEAK = 100.0
# Loss in a scan from which a fit is not tried, nats: of 76 rivals with a scanned loss of 60 or
# more, none lost less than 36 in a fit. Effects that are equal to first order are exempt.
HOPELESS = 100.0
# Largest count of candidates in one step.
FEW = 3
# Change of the model's score, as a share of the nats by which a trial failed, after which the trial
# is repeated.
SINCE = 0.5
# Difference of evidence below which two fits of the same effects count as the same, nats.
SAME_FIT = 1.0


@dataclass(frozen=True)
class Barred:
    """A failed search for a law of one sensor.

    own: effects that a law of it could replace or change. held: nats that the doubted ones held.
    short: nats by which the best law failed.
    """

    own: frozenset[str]
    held: float
    short: float


@dataclass(frozen=True)
class Vain:
    """A failed trial: the log-evidence and log prior odds of the model, and the nats by which the
    trial scored below it."""

    evidence: float
    prior: float
    short: float


@dataclass
class Climb:
    """The present model of a climb, and the record of what was tried.

    needed: terms that the first scan must choose. kept: ids of the first model, which nothing takes
    the place of. unnamed: terms so far. where: the last scan. alone: gains of the catalogue's
    effects in the first scan. noise: gain of each noise effect of the model, nats; stale: those out
    of date. swaps: (effect, rival) to the nats lost with the rival fitted instead. dropped: names
    that were removed, or made a fit fail; beyond: names that came out implausibly large beside the
    present effects. everything: whether all effects were fitted at once. survey: of laws, beside
    the last model that needed one; vocabulary: courses of drivers, filled on demand. barred: failed
    searches for laws, by sensor. named: the model before this climb's search for laws; rival: that
    of another climb. vain: failed trials. fruitless: steps of law search that failed, with the ids
    of the model, to its log-evidence; shared by all climbs.

    Tried already: visited, refused: sets of effects. ordered: (filter, ids of the model). bared,
    travelled, unmasked: ids of models, in the search for laws, instead of travel, and of moments.
    shaped, whole, adjusted: laws, in ``reshape``, ``narrow`` and ``adjust``. taken_in: (name, law).
    """

    model: Model
    needed: Sequence[Term]
    budget: Budget = field(default_factory=Budget)
    where: Space = field(init=False)
    alone: dict[str, float] = field(init=False)
    noise: dict[str, float] = field(default_factory=dict)
    stale: set[str] = field(default_factory=set)
    swaps: dict[tuple[str, str], float] = field(default_factory=dict)
    dropped: set[str] = field(default_factory=set)
    beyond: set[str] = field(default_factory=set)
    everything: bool = False
    visited: set[frozenset[str]] = field(default_factory=set)
    refused: set[frozenset[str]] = field(default_factory=set)
    ordered: set[tuple[str, frozenset[str]]] = field(default_factory=set)
    shaped: set[str] = field(default_factory=set)
    bared: set[frozenset[str]] = field(default_factory=set)
    barred: dict[str, Barred] = field(default_factory=dict)
    travelled: set[frozenset[str]] = field(default_factory=set)
    unmasked: set[frozenset[str]] = field(default_factory=set)
    whole: set[str] = field(default_factory=set)
    adjusted: set[str] = field(default_factory=set)
    taken_in: set[tuple[str, str]] = field(default_factory=set)
    survey: Survey | None = None
    vocabulary: Vocabulary = field(default_factory=Vocabulary)
    rival: Model | None = None
    named: Model | None = None
    vain: dict[tuple[str, ...], Vain] = field(default_factory=dict)
    fruitless: dict[tuple[str, frozenset[str]], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.kept = frozenset(self.model.ids)
        self.unnamed = list(self.needed)

    @property
    def worth(self) -> float:
        """Power of the likelihood at the last scan."""
        return self.where.quadratic.worth


def part_of(report: Report, start: float, share: float, f: float, model: Model) -> None:
    """Report share ``f`` of a part of the whole that begins at ``start`` and has size ``share``."""
    report(start + share * f, model)


def in_time(c: Climb, calls: Iterable[Callable[[], T]], ways: Iterable[W]) -> Iterator[tuple[T, W]]:
    """Results of these calls, each with its item of ``ways``, two at a time, as far as the budget
    allows."""
    return zip(in_parallel(c.budget.each(calls)), ways, strict=False)


def beaten(c: Climb) -> bool:
    """Whether another climb started its search for laws from a much better model, or from the same
    effects, so that this climb need not search for laws."""
    if c.rival is None or c.named is None:
        return False
    ahead = better(c.named, c.rival, c.worth)
    return ahead < (-PRIOR if set(c.named.ids) == set(c.rival.ids) else -HOPELESS)


def likelier(c: Climb, tried: Model, than: Model | None = None) -> bool:
    """Whether a model has plausible parameters and a higher score than ``than`` (None: the climb's
    model). A fit that does not settle must gain more than its evidence swings by."""
    gain = better(tried, c.model if than is None else than, c.worth)
    return sensible(tried) and gain > c.worth * tried.swing


def best_of(c: Climb, ends: Iterable[tuple[Model, W]]) -> tuple[Model, W] | None:
    """The fit, with its item, of the highest score among those that beat the climb's model; None if
    none does."""
    able = [end for end in ends if likelier(c, end[0])]
    return max(able, key=lambda end: score(end[0], c.worth), default=None)


def sensible(model: Model) -> bool:
    """Whether all parameters have plausible sizes and signs."""
    return model.one_sided and not too_large(model)


def too_large(model: Model) -> set[str]:
    """Names of the effects with an implausibly large parameter."""
    known = {(e.id, p.name): p for e in model.effects for p in e.parameters}
    return {
        name_of(n[0])
        for n, u in zip(model.quadratic.names, model.u, strict=True)
        if abs(u) * known[n].prior_sigma > known[n].most
    }


def forget(c: Climb, model: Model) -> None:
    """Discard results that were measured beside effects that the new model lacks."""
    c.noise = {i: v for i, v in c.noise.items() if i in model.ids}
    c.visited.clear()
    beside_others(c, model)
    c.stale |= set(c.noise)


def fell_short(c: Climb, what: tuple[str, ...], short: float) -> None:
    """Record a failed trial beside the climb's model, and by how many nats it failed. (An infinite
    loss, of a fit that diverged or has an implausible sign, is recorded as ``HOPELESS``.)"""
    short = short if math.isfinite(short) else HOPELESS
    c.vain[what] = Vain(c.model.log_evidence, _odds(c.model), short)


def in_vain(c: Climb, what: tuple[str, ...], model: Model | None = None) -> bool:
    """Whether a failed trial would fail again beside this model (None: the climb's model): the
    model's score has changed by much less since than the trial failed by."""
    last, model = c.vain.get(what), c.model if model is None else model
    if last is None:
        return False
    since = c.worth * (model.log_evidence - last.evidence) + _odds(model) - last.prior
    return abs(since) < SINCE * last.short


def beside_others(c: Climb, model: Model) -> None:
    """Discard results of exchanges that may differ beside the new model."""
    there = set(model.ids)
    c.swaps = {
        pair: worse
        for pair, worse in c.swaps.items()
        if len(there & set(pair)) == 1 and in_vain(c, tuple(sorted(pair)), model)
    }


def _odds(model: Model) -> float:
    return log_prior(model.effects, [f.case for f in model.parts])

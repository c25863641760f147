"""What the steps of a climb hand on to each other, and when a model counts as likelier."""

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
# Called with the share that is done, and the model there is.
Report = Callable[[float, Model], None]
# Nats below which an effect may be there for the sake of another's wrong name only.
WEAK = 100.0
# Nats less, by a scan, for each name that goes, with which no fit is the better one (but of what is
# the same to the first order): of 76 rivals that promised to lose 60 or more, none lost under 36.
HOPELESS = 100.0
# How many of the weakest are fitted without.
FEW = 3
# Share of the nats by which something fell short, below which what a model's score has changed by
# since cannot have made it the better one.
SINCE = 0.5
# Nats to which two climbs that end with the same effects end with the same fit.
SAME_FIT = 1.0


@dataclass(frozen=True)
class Barred:
    """Effects of one sensor in whose place no law was likelier: all that a law of it has to do
    with, the nats that the doubted ones of them held, and by how many the best law fell short."""

    own: frozenset[str]
    held: float
    short: float


@dataclass(frozen=True)
class Vain:
    """What fell short by so many nats, beside a model of this log-evidence and log prior odds."""

    evidence: float
    prior: float
    short: float


@dataclass
class Climb:
    """A model on its way up, and what was tried.

    needed: terms without which the climb is of no use. where: the last scan; alone: what the
    catalogue's effects gained in the first one; noise: log-evidence gained by each noise effect in
    the model, and stale: those for which that is out of date; swaps: (effect, rival) to the nats by
    which the rival, fitted in its place, does worse. dropped: names of what was not missed, or with
    which no fit holds; beyond: of what came out larger than makes sense beside the same others.
    everything: all were fitted at once; survey: of what has no name, beside the last model that was
    asked; vocabulary: blocks of laws of the recordings, as far as they were asked for. barred: by
    sensor, what came of laws in the place of its doubted effects. rival: the model with which
    another climb, from another start, began to look for laws; named: that of this one. vain: what
    was fitted in vain; fruitless: steps that led nowhere, each with the effects of the model, and
    its log-evidence, in whichever climb of a search.
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
        """What evidence counts for, at the last scan."""
        return self.where.quadratic.worth


def part_of(report: Report, start: float, share: float, f: float, model: Model) -> None:
    """Report a part of a whole that begins at this share of it and is so large."""
    report(start + share * f, model)


def in_time(c: Climb, calls: Iterable[Callable[[], T]], ways: Iterable[W]) -> Iterator[tuple[T, W]]:
    """What these calls return, two at a time, each with what it is of; those for which there is
    time."""
    return zip(in_parallel(c.budget.each(calls)), ways, strict=False)


def beaten(c: Climb) -> bool:
    """Whether another climb was much further when it began to look for laws, or had come to the
    same: what laws there are it has found."""
    if c.rival is None or c.named is None:
        return False
    ahead = better(c.named, c.rival, c.worth)
    return ahead < (-PRIOR if set(c.named.ids) == set(c.rival.ids) else -HOPELESS)


def likelier(c: Climb, tried: Model, than: Model | None = None) -> bool:
    """Whether a model's score is above that of the one there is, or of another; what no device has
    is no fit. (Of a fit that does not settle, evidence may be that of the best of its rounds by
    chance.)"""
    gain = better(tried, c.model if than is None else than, c.worth)
    return sensible(tried) and gain > c.worth * tried.swing


def best_of(c: Climb, ends: Iterable[tuple[Model, W]]) -> tuple[Model, W] | None:
    """Of fits, each with what it is of, the best of those that are likelier than the model there
    is; None where none is."""
    able = [end for end in ends if likelier(c, end[0])]
    return max(able, key=lambda end: score(end[0], c.worth), default=None)


def sensible(model: Model) -> bool:
    """Whether no parameter is larger than makes sense, or negative where that makes none."""
    return model.one_sided and not too_large(model)


def too_large(model: Model) -> set[str]:
    """Names of the effects of which a parameter is larger than makes sense."""
    known = {(e.id, p.name): p for e in model.effects for p in e.parameters}
    return {
        name_of(n[0])
        for n, u in zip(model.quadratic.names, model.u, strict=True)
        if abs(u) * known[n].prior_sigma > known[n].most
    }


def forget(c: Climb, model: Model) -> None:
    """Let what was weighed beside effects that are gone be weighed anew."""
    c.noise = {i: v for i, v in c.noise.items() if i in model.ids}
    c.visited.clear()
    beside_others(c, model)
    c.stale |= set(c.noise)


def fell_short(c: Climb, what: tuple[str, ...], short: float) -> None:
    """Note that something was fitted in vain beside the model there is. (By how much, is not known
    of what diverged or came out where it cannot be.)"""
    short = short if math.isfinite(short) else HOPELESS
    c.vain[what] = Vain(c.model.log_evidence, _odds(c.model), short)


def in_vain(c: Climb, what: tuple[str, ...], model: Model | None = None) -> bool:
    """Whether something fell short by so much that it is no better beside this model, or the one
    there is: whatever has changed since has changed the score by less."""
    last, model = c.vain.get(what), c.model if model is None else model
    if last is None:
        return False
    since = c.worth * (model.log_evidence - last.evidence) + _odds(model) - last.prior
    return abs(since) < SINCE * last.short


def beside_others(c: Climb, model: Model) -> None:
    """Let go what holds beside the same others only, now that the model is another: the exchanges
    that were near enough for that."""
    there = set(model.ids)
    c.swaps = {
        pair: worse
        for pair, worse in c.swaps.items()
        if len(there & set(pair)) == 1 and in_vain(c, tuple(sorted(pair)), model)
    }


def _odds(model: Model) -> float:
    return log_prior(model.effects, [f.case for f in model.parts])

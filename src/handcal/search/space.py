"""Search over subsets of effects on the quadratic, and their posterior probabilities."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from handcal.effects import Effect
from handcal.estimate.case import name_of
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.subsets import Subsets, subsets
from handcal.model_score import PRIOR
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Space:
    """The candidate effects and their quadratic.

    prior: log prior odds by effect id. where: places of each effect's parameters in the quadratic.
    scores: kept scores of subsets. Of one effect held at several moments, a subset may have one.
    """

    quadratic: Quadratic
    effects: Mapping[str, Effect]
    prior: Mapping[str, float]
    where: Mapping[str, IntArray]
    scores: dict[frozenset[str], float]

    @cached_property
    def numbers(self) -> Mapping[str, int]:
        """The index of each effect in alphabetical order."""
        return {i: n for n, i in enumerate(sorted(self.effects))}

    @cached_property
    def subsets(self) -> Subsets:
        """The candidates by these numbers."""
        return subsets(self.quadratic, [self.effects[i] for i in self.numbers], self.where)

    @cached_property
    def plain(self) -> Mapping[str, str]:
        """The catalogue's id of each effect, without its moment."""
        return {i: name_of(i) for i in self.effects}

    def score(self, chosen: Iterable[str]) -> float:
        """Log-evidence of this set plus its log prior odds."""
        key = frozenset(chosen)
        if key not in self.scores:
            self.scores[key] = self._score(key)
        return self.scores[key]

    def _score(self, key: frozenset[str]) -> float:
        names = sorted(key)
        if len({self.plain[i] for i in names}) < len(names):
            return -math.inf
        odds = sum(self.prior[i] for i in names)
        return self.subsets.log_evidence([self.numbers[i] for i in names]) + odds


def space(quadratic: Quadratic, effects: Sequence[Effect], prior: Mapping[str, float]) -> Space:
    """Candidates with their places in the quadratic; prior: log odds that are not the usual."""
    where: dict[str, list[int]] = {e.id: [] for e in effects}
    for i, (owner, _) in enumerate(quadratic.names):
        if owner in where:
            where[owner].append(i)
    return Space(
        quadratic,
        {e.id: e for e in effects},
        {e.id: prior.get(e.id, PRIOR) for e in effects},
        {k: np.array(v, dtype=np.int64) for k, v in where.items()},
        {},
    )


def best_set(where: Space, start: Iterable[str] = ()) -> frozenset[str]:
    """Climb by adding, dropping and exchanging effects until nothing raises the score."""
    chosen = frozenset(start)
    value = where.score(chosen)
    while True:
        # (additions and removals first, since exchanges are a hundred times as many)
        option = _best(where, _more_or_less(where, chosen), value)
        if option is None:
            option = _best(where, _exchanged(where, chosen), value)
        if option is None:
            option = _pair(where, chosen, value)
        if option is None:
            return chosen
        chosen, value = option, where.score(option)


def _best(where: Space, options: Iterable[frozenset[str]], above: float) -> frozenset[str] | None:
    """The option with the highest score, if that exceeds ``above``."""
    best = max(options, key=where.score, default=None)
    return best if best is not None and where.score(best) > above else None


def _neighbours(where: Space, chosen: frozenset[str]) -> Iterable[frozenset[str]]:
    yield from _more_or_less(where, chosen)
    yield from _exchanged(where, chosen)


def _more_or_less(where: Space, chosen: frozenset[str]) -> Iterable[frozenset[str]]:
    for i in where.effects:
        if i not in chosen:
            yield chosen | {i}
    for j in sorted(chosen):
        yield chosen - {j}


def _exchanged(where: Space, chosen: frozenset[str]) -> Iterable[frozenset[str]]:
    others = [i for i in where.effects if i not in chosen]
    for j in sorted(chosen):
        for i in others:
            yield (chosen - {j}) | {i}


def _pair(where: Space, chosen: frozenset[str], value: float) -> frozenset[str] | None:
    """The best move of two effects: add two, drop two, two for one, or one for two. New effects are
    the eight that score highest alone."""
    others = [i for i in where.effects if i not in chosen]
    near = sorted(others, key=lambda i: -where.score(chosen | {i}))[:8]
    best, found = value + 1e-9, None
    options: list[frozenset[str]] = []
    members = sorted(chosen)
    for n, a in enumerate(near):
        for b in near[n + 1 :]:
            options.append(chosen | {a, b})
            options += [(chosen - {j}) | {a, b} for j in members]
    for n, j in enumerate(members):
        for k in members[n + 1 :]:
            options += [(chosen - {j, k}) | {a} for a in near]
            options.append(chosen - {j, k})
    for option in options:
        score = where.score(option)
        if score > best:
            best, found = score, option
    return found


def probabilities(where: Space, chosen: frozenset[str], most: float = math.inf) -> dict[str, float]:
    """Posterior probability of each effect, over the sets near the best.

    most: score beyond which a set is left out. (A climb ends if no fit beats the model. Sets with a
    higher score in the scan were fitted and failed, so they support none of their effects.)
    """
    # (a fixed order keeps sums reproducible)
    scores = {s: where.score(s) for s in (chosen, *_neighbours(where, chosen))}
    scores = {s: v for s, v in scores.items() if v <= most}
    top = max(scores.values())
    weight = {s: math.exp(v - top) for s, v in scores.items()}
    norm = sum(weight.values())
    return {i: sum(w for s, w in weight.items() if i in s) / norm for i in where.effects}


def rivals(where: Space, chosen: frozenset[str], member: str) -> dict[str, float]:
    """Log score of each effect in the member's place, against the member: 0 for itself."""
    rest = chosen - {member}
    own = where.score(chosen)
    out = {member: 0.0}
    for i in where.effects:
        if i not in chosen:
            out[i] = where.score(rest | {i}) - own
    return out


def gains(where: Space, chosen: frozenset[str]) -> dict[str, float]:
    """Gain of each effect, nats, without prior odds: of a chosen one over the set without it, of
    another one when added to the set."""
    value = where.score(chosen)
    out = {}
    for i in where.effects:
        if i in chosen:
            out[i] = value - where.score(chosen - {i}) - where.prior[i]
        else:
            score = where.score(chosen | {i})
            out[i] = score - value - where.prior[i]
    return out


def expected_gain(where: Space, effect: str, chosen: frozenset[str], size: Array) -> float:
    """Expected gain of an effect of this size (k,), in units of its priors, nats.

    The mean over the noise of its log-evidence gain, Occam factor included, from the information
    matrix.
    """
    rest = sorted(chosen - {effect})
    parts = [where.where[i] for i in rest]
    known = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
    mine = where.where[effect]
    G = where.quadratic.G
    A = G[np.ix_(known, known)] + np.eye(len(known))
    own = G[np.ix_(mine, mine)] - G[np.ix_(mine, known)] @ np.linalg.solve(
        A, G[np.ix_(known, mine)]
    )
    own = 0.5 * (own + own.T)
    # b ~ N(own size, own): E b'(I + own)^-1 b / 2 - log|I + own| / 2
    inner = np.eye(len(mine)) + own
    signal = own @ size
    fit = float(signal @ np.linalg.solve(inner, signal)) + float(
        np.trace(np.linalg.solve(inner, own))
    )
    return 0.5 * fit - 0.5 * float(np.linalg.slogdet(inner)[1])

"""The numbers of a course over time (moments, widths, a period), adjusted about a fit.

A course is found on a grid of seconds, which does not tell when it began, or how fast it swings,
nearer than that. Here courses with other numbers are weighed by what they add to the readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from handcal.effects import Effect, Signals
from handcal.effects._linear import added
from handcal.estimate.model import Model
from handcal.estimate.scan import grounds
from handcal.laws import shapes
from handcal.laws.courses import OVER_TIME, Family, Values
from handcal.laws.drivers import HEADING
from handcal.laws.law_effect import CHANNELS, SENSORS
from handcal.laws.over_drivers import About, signals_of
from handcal.types import Array

# Shares of a course, root mean square, that a step of one of its numbers changes, one after the
# other; steps of one share at the most.
SHARES, TURNS = (0.3, 0.15, 0.075, 0.04, 0.02, 0.01), 12
# Numbers of which up to so many are tried together (of a switch, what its start does its length may
# undo; of a spell, one edge has nothing to do with the other).
FEW = 3
# As another course counts what is changed by more than this share: half of its power.
FAR = 0.7
# Nats that a step has to gain.
NEARLY = 0.1
# Halvings in which a step of that share is found, at so many moments a second.
HALVINGS, EACH_SECOND = 20, 20.0


def adjusted(model: Model, effect: Effect) -> Effect | None:
    """The course over time that an effect of the model is, with the numbers that the recordings
    ask for; None where it is none, or where they are as good as they get."""
    if shapes.course_of(effect) is None:
        return None
    signals = signals_of(model.parts[0])
    known = [e for e in model.effects if e.process is None and e.id != effect.id]
    near, nats = nearer(About(model, grounds(model), known, signals, 1.0), effect, SHARES)
    return near if nats > NEARLY else None


def nearer(about_: About, effect: Effect, shares: Sequence[float]) -> tuple[Effect, float]:
    """A course over time with other numbers, and the nats that it gains more than it did; itself
    where it is none or none gain more. shares: of the steps that are tried, in turn."""
    found = shapes.course_of(effect)
    if found is None or found[1] not in OVER_TIME or not _in_turn(*found[1:]):
        return effect, 0.0
    basis, family, numbers = found
    t = about_.signals.t - about_.signals.t[0]
    t = t[:: max(1, round(len(t) / (EACH_SECOND * max(float(t[-1]), 1.0))))]
    begun = family.values(numbers, t)
    if not begun.any():  # (on a grid of seconds one may begin after the end)
        return effect, 0.0

    def gained(options: Sequence[Array]) -> Array:
        # (one of them at least: the first is what there is)
        near = [
            k for k, n in enumerate(options)
            if _in_turn(family, n) and _changed(family.values, begun, n, t) < FAR
        ]  # fmt: skip
        some = [
            replace(_as_seen(effect, basis.channel, family.values, options[k]), id=f"basis: {k}")
            for k in near
        ]
        nats = np.full(len(options), -np.inf)
        seen = about_.seen(some)
        nats[near] = seen.gains(np.array([seen.at[e.id] for e in some]))
        return nats

    at = numbers
    for share in shares:
        steps = np.array([_step(family.values, at, i, t, share) for i in range(len(at))])
        for _ in range(TURNS):
            better = _next(gained, at, steps)
            if better is None:
                break
            at = better
    if at is numbers:
        return effect, 0.0
    now, then = gained([numbers, at])
    return shapes.term_of(basis, family, at), float(then - now)


def _in_turn(family: Family, numbers: Array) -> bool:
    """Whether spells are one after the other, and none of them ends before it begins."""
    if family.moment != 2:
        return True
    spells = numbers.reshape(-1, 2)
    return bool((np.diff(spells[np.argsort(spells[:, 0])].ravel()) > 0.0).all())


def _as_seen(effect: Effect, channel: str, values: Values, numbers: Array) -> Effect:
    """A course with other numbers, as a column of what it adds."""

    def course(signals: Signals) -> Array:
        return values(numbers, signals.t - signals.t[0])[:, None]

    if channel == SENSORS[HEADING]:
        # (compiled, as a heading's own is, each would take longer than all scans)
        return replace(effect, observation_error={}, seen={channel: course})
    place = CHANNELS.index(channel), 0

    def features(signals: Signals) -> list[tuple[int, int, Array]]:
        return [(*place, course(signals))]

    return replace(effect, imu_error=added(features), features=features)


def _next(gained: Callable[[Sequence[Array]], Array], at: Array, steps: Array) -> Array | None:
    """Better numbers: a step off in each in which that gains, or in what gains most."""
    signs = np.concatenate([np.eye(len(at)), -np.eye(len(at))])
    if len(at) <= FEW:
        signs = np.array(list(product((-1.0, 0.0, 1.0), repeat=len(at))))
    moves = np.unique(signs * steps, axis=0)
    moves = moves[np.any(moves != 0.0, axis=1)]
    nats = gained([at, *(at + move for move in moves)])
    if not np.isfinite(nats[0]) or not nats.max() > nats[0] + NEARLY:
        return None
    gains = nats[1:] - nats[0]
    best = moves[int(np.argmax(gains))]
    single = [k for k in np.argsort(gains) if gains[k] > 0.0 and np.count_nonzero(moves[k]) == 1]
    each = {int(np.flatnonzero(moves[k])[0]): moves[k] for k in single}
    together = at + sum(each.values(), np.zeros(len(at)))
    now, all_ = gained([at, together])
    return together if all_ - now > gains.max() else at + best


def _step(values: Values, numbers: Array, i: int, t: Array, share: float) -> float:
    """By how much a number changes a course at the moments t (n,) by that share; 0.0 where nothing
    would."""
    low, high, course = 0.0, float(t[-1]), values(numbers, t)
    for _ in range(HALVINGS):
        step = 0.5 * (low + high)
        changed = _changed(values, course, numbers + step * (np.arange(len(numbers)) == i), t)
        low, high = (low, step) if not changed < share else (step, high)
    return high if high < t[-1] else 0.0


def _changed(values: Values, course: Array, others: Array, t: Array) -> float:
    """The share of a course (n,), root mean square, by which it is another with other numbers."""
    with np.errstate(all="ignore"):  # (of a width beyond nothing that is no number)
        off = np.mean((values(others, t) - course) ** 2)
        return float(np.sqrt(off / np.mean(course**2)))

"""Readings without what the effects add to them, found by substitution."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import solve_banded

from handcal.effects import Effect, Signals
from handcal.estimate.problem import Problem
from handcal.estimate.sampling import at_nodes
from handcal.signals import of_recording, reading, units
from handcal.types import Array

# Rounds of substitution at the most, and the share of the largest reading by which the last one
# may move any: a scale error of a fifth takes eight (after three it would be known to 1 %), an
# error that changes by three quarters of what is measured fifty-six.
SUBSTITUTIONS, SUBSTITUTED = 60, 1e-7
# A round that moves hardly less than the one before leads nowhere: where what is added grows faster
# than what is measured (a lost step does, within its width; from sample to sample an error by
# angular acceleration does that is as large as the rate changes in some samples), whole steps lead
# ever further to and fro. Then steps are Newton's, so many at the most, until in two of them hardly
# fewer samples are left without an answer, and they are not half as far off in the mean square;
# with new derivatives where more than such a share was left with the old ones; which are of this
# share of the readings.
SHRINKS, STEPS, CLOSER, STALE, SMALL = 0.9, 30, 0.5, 0.5, 1e-6


@dataclass(frozen=True)
class Corrected:
    """A problem whose readings have been corrected, its derivatives still as they were: raw, the
    readings less the biases, and the effects' error in them (n, 6)."""

    problem: Problem
    read: Signals
    raw: Array
    error: Array


def corrected_readings(
    problem: Problem,
    ref: Array,
    bg: Array,
    ba: Array,
    C_nb: Array | None = None,
    sway: Array | None = None,
) -> Corrected:
    """The problem with the effects at constants ``ref`` (c,) taken off the readings; C_nb
    (n, 3, 3); sway: see ``substituted``.

    What an effect adds depends on the true rate and force, which are the readings less
    all errors, found by substitution.
    """
    imu, nodes = problem.recording.imu, problem.nodes
    raw = np.hstack([imu.gyro - bg, imu.accel - ba])
    acting = [e for e in problem.effects if e.imu_error is not None]
    read = of_recording(problem.recording, acting, read=raw, C_nb=C_nb, alpha=problem.alpha)
    error = substituted(acting, ref, read, problem.error, sway=sway)
    clean = np.hstack([imu.gyro, imu.accel]) - error
    gyro, accel, bend = at_nodes(imu, problem.smooth, clean, nodes.t)
    nodes = nodes._replace(gyro=gyro, accel=accel, bend=bend)
    return Corrected(replace(problem, ref=ref, nodes=nodes, error=error), read, raw, error)


def proportional_apart(
    acting: Sequence[Effect], ref: Array
) -> tuple[Array, list[tuple[Effect, Array]]]:
    """What those effects add together that are proportional to the truth, to one of rows (6, 6) of
    it; and the others with their parameters, of ``ref`` (c,). Without those that add nothing."""
    whole, left, i = np.zeros((6, 6)), [], 0
    for e in acting:
        at = ref[i : i + len(e.parameters)]
        i += len(e.parameters)
        if at.any() and e.proportional and e.imu_error is not None:
            whole += e.imu_error(at, units())
        elif at.any():
            left.append((e, at))
    return whole, left


# (numbers that run away are no fit, which is seen later)
@np.errstate(over="ignore", invalid="ignore")
def substituted(
    acting: Sequence[Effect],
    ref: Array,
    readings: Signals,
    begin: Array | None = None,
    enough: float = SUBSTITUTED,
    sway: Array | None = None,
) -> Array:
    """What all effects add to these readings, (n, 6), by rounds of substitution: first what is
    done to the whole reading is undone, then the others follow from the truth, what is
    proportional to it at once.

    begin (n, 6): about what they add, if that is known; enough: the change in a round, as a part
    of the largest reading, after which there is no other; sway (n, 3): what of the force only
    those effects feel that move the whole reading. Effects whose parameters are zero add nothing
    and are left out.
    """

    def felt(own: Array) -> Signals:
        truth = reading(readings, own)
        return truth if sway is None else replace(truth, accel=truth.accel - sway)

    raw = np.hstack([readings.gyro, readings.accel])
    scale = float(np.abs(raw).max(initial=0.0))
    whole, present = proportional_apart(acting, ref)
    given, present = _undone(present, readings, raw)
    unmixed = _unmixing(whole)
    given = unmixed(given if sway is None else given + sway @ whole[3:])
    errors = [np.zeros_like(raw) for _ in present]
    if begin is not None and all(e.imu_inverse is None for e, _ in present):
        truth = felt(raw - begin)
        errors = [e.imu_error(at, truth) for e, at in present if e.imu_error is not None]
    total = unmixed(np.sum(errors, axis=0)) if present else np.zeros_like(raw)
    begun, moved = total.copy(), math.inf
    for done in range(SUBSTITUTIONS if present else 0):
        before, moved = moved, 0.0
        for k, (e, at) in enumerate(present):
            old = errors[k]
            errors[k] = _error(e, at, given - total, old, readings, felt)
            step = unmixed(errors[k] - old)
            total += step
            moved = max(moved, float(step.max()), -float(step.min()))
        # (each round moves by as much less as this one did)
        following = moved * min(1.0, moved / before) if math.isfinite(before) else moved
        if following < enough * scale:
            break
        if done > 1 and not moved < SHRINKS * before:
            if not math.isfinite(moved):
                break
            last = _Last(present, errors, given, readings, felt, unmixed)
            return raw - _without(last.added, given, given - begun, enough * scale, SMALL * scale)
    return raw - given + total


@dataclass(frozen=True)
class _Last:
    """What effects with their parameters were last taken to add, each (n, 6), to readings that are
    ``given`` (n, 6); felt, unmixed: as in ``substituted``."""

    present: Sequence[tuple[Effect, Array]]
    errors: list[Array]
    given: Array
    readings: Signals
    felt: Callable[[Array], Signals]
    unmixed: Callable[[Array], Array]

    def added(self, own: Array, whole: bool = True) -> Array:
        """What all add, (n, 6), where these are the readings without; not whole: those that move
        the reading as a whole as much as last."""
        truth = self.felt(own)
        new = [
            old if e.imu_inverse is not None or e.imu_error is None else e.imu_error(at, truth)
            for (e, at), old in zip(self.present, self.errors, strict=True)
        ]
        total = self.unmixed(np.sum(new, axis=0))
        if whole:
            # (of what is read without the others: from the readings without all errors, a delay of
            # several samples would be taken from one step to the next, and grow)
            for k, (e, at) in enumerate(self.present):
                if e.imu_inverse is not None:
                    old = new[k]
                    new[k] = _error(e, at, self.given - total, old, self.readings, self.felt)
                    total = total + self.unmixed(new[k] - old)
            self.errors[:] = new
        return total


def _undone(
    present: Sequence[tuple[Effect, Array]], readings: Signals, raw: Array
) -> tuple[Array, list[tuple[Effect, Array]]]:
    """The readings (n, 6) without what comes last of all, which is undone at once, and the effects
    that are left."""
    left = []
    for e, at in present:
        if e.imu_inverse is not None and e.last:
            raw = e.imu_inverse(at, reading(readings, raw))
        else:
            left.append((e, at))
    return raw, left


def _unmixing(whole: Array) -> Callable[[Array], Array]:
    """Rows (n, 6) of the truth of which, with what is proportional to it (6, 6), others are
    made."""
    if not whole.any():
        return lambda rows: rows
    mixed = np.eye(6) + whole
    if not np.isfinite(mixed).all() or not np.isfinite(np.linalg.cond(mixed)):
        return lambda rows: np.full_like(rows, math.nan)
    back = np.linalg.solve(mixed, np.eye(6))
    return lambda rows: np.asarray(rows @ back)


def _error(
    e: Effect, at: Array, own: Array, old: Array, readings: Signals,
    felt: Callable[[Array], Signals],
) -> Array:  # fmt: skip
    """What an effect adds, (n, 6), to these readings without any error; old: what it was taken to
    add."""
    if e.imu_inverse is not None:
        return own + old - e.imu_inverse(at, reading(readings, own + old))
    return old if e.imu_error is None else e.imu_error(at, felt(own))


def _without(
    added: Callable[..., Array], raw: Array, own: Array, least: float, small: float
) -> Array:
    """The readings (n, 6) to which as much is added as is missing in raw, to ``least``, or, of
    each, the nearest that was found (where what is added jumps, some have none): from ``own`` on,
    by Newton's steps with what each channel's sample and its neighbours do to it, by differences
    of ``small``."""
    nearest, nearest_by, bands = own, np.full_like(own, math.inf), None
    farthest = math.inf
    left: list[tuple[int, float]] = []
    for _ in range(STEPS):
        here = added(own)
        rest = own + here - raw
        by = np.abs(rest)
        far = float(by.max())
        if far < least:
            return own
        # (what is further off by a step may have come nearer with its neighbours, so long as
        # whatever is furthest off does)
        nearer = (by < nearest_by) | (far < farthest)
        farthest = min(farthest, far)
        nearest, nearest_by = np.where(nearer, own, nearest), np.where(nearer, by, nearest_by)
        left.append((int(np.count_nonzero(~(nearest_by < least))), float((nearest_by**2).sum())))
        if len(left) > 2 and not (
            left[-1][0] < SHRINKS * left[-3][0] or left[-1][1] < CLOSER * left[-3][1]
        ):
            break
        if bands is None or left[-1][0] > STALE * left[-2][0]:
            bands = _bands(partial(added, whole=False), own, here, small)
        rest[~np.isfinite(rest)] = 0.0
        try:
            step = [solve_banded((1, 1), bands[c], rest[:, c]) for c in range(6)]
        except np.linalg.LinAlgError:  # (of a law that undoes what it acts on)
            break
        # (each sample for itself: too far, half as far; not a number any more, back)
        own = np.where(nearer, own - np.stack(step, axis=1), 0.5 * (own + nearest))
        own = np.where(np.isfinite(own), own, nearest)
    return nearest


def _bands(added: Callable[[Array], Array], own: Array, here: Array, small: float) -> Array:
    """Derivatives (6, 3, n) of readings with what is added, by those without: of each channel by
    its next sample, itself and the one before, as ``solve_banded`` has them; here: what is added
    to these."""
    out = np.zeros((6, 3, len(own)))
    # (where nothing is added to a sensor, nothing of it changes that)
    sensors = [s for s in (slice(0, 3), slice(3, 6)) if here[:, s].any()]
    for sensor in sensors:
        for first in range(3):
            moved = own.copy()
            moved[first::3, sensor] += small
            change = (added(moved) - here)[:, sensor].T / small
            for row, shift in enumerate((-1, 0, 1)):
                # (of a reading that is moved, what it does to the one before, itself, the next)
                to = np.arange(first, len(own), 3) + shift
                inside = (to >= 0) & (to < len(own))
                out[sensor, row, to[inside] - shift] = change[:, to[inside]]
    out[~np.isfinite(out)] = 0.0
    out[:, 1] += 1.0
    return out

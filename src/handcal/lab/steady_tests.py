"""Known inputs and what was read: from a recording with a reference, from a table of poses.

A test is a stretch in which the input is steady: a rest, or a turn at a constant rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from handcal import signals
from handcal.effects import Effect, Signals
from handcal.effects._derivative import reach
from handcal.estimate.regression import columns, errors
from handcal.lab.sound import refuse_dead
from handcal.lab.stretches import PERFECT, white_variance
from handcal.recordings import segment
from handcal.types import Array, BoolArray, HandcalError, InputError, IntArray, Recording

# A test that is one line of a table is held for so many samples, so that nothing changes in it.
HELD = 5
# Where the known input is missing for longer, it is not known, s.
GAP_S = 0.1


@dataclass(frozen=True)
class Bench:
    """n tests.

    truth: known rate and specific force, of all tests one after the other, start (n + 1,) where
    each begins, weight (m,) of the samples in their test's mean (0 beside a joint, where a rate
    of change would be wrong). reading (n, 6): mean gyro rad/s and accelerometer m/s^2;
    variance (n, 6) of that; used (6,): which channels there are; span (n, 2) s, or None.
    """

    truth: Signals
    start: IntArray
    weight: Array
    reading: Array
    variance: Array
    used: BoolArray
    span: Array | None = None
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.reading)

    def mean(self, x: Array) -> Array:
        """Means (n, ...) over the tests of what is given at every sample, (m, ...)."""
        w = self.weight.reshape(-1, *[1] * (x.ndim - 1))
        return np.asarray(np.add.reduceat(w * x, self.start[:-1], axis=0))

    def only(self, chosen: BoolArray) -> Bench:
        """Some of the tests (n,)."""
        rows = np.repeat(chosen, np.diff(self.start))
        return Bench(
            signals.some(self.truth, rows),
            np.r_[0, np.cumsum(np.diff(self.start)[chosen])], self.weight[rows],
            self.reading[chosen], self.variance[chosen], self.used,
            None if self.span is None else self.span[chosen], self.warnings,
        )  # fmt: skip


def of_arrays(
    gyro: Array | None,
    accel: Array | None,
    gyro_reading: Array | None,
    accel_reading: Array | None,
    sigma: tuple[float, float] = (1.0, 1.0),
    temperature: Array | None = None,
) -> Bench:
    """Tests of known rate gyro and force accel (n, 3), in any unit, and what was read.

    sigma: standard deviation of a reading of gyro and accelerometer. What is None was not
    known (taken as zero) or not read.
    """
    n = len(next(a for a in (gyro_reading, accel_reading) if a is not None))
    known = [np.zeros((n, 3)) if a is None else np.asarray(a, float) for a in (gyro, accel)]
    read = [np.zeros((n, 3)) if a is None else np.asarray(a, float)
            for a in (gyro_reading, accel_reading)]  # fmt: skip
    used = np.repeat([gyro_reading is not None, accel_reading is not None], 3)
    held = [np.repeat(a, HELD, axis=0) for a in known]
    T = None if temperature is None else np.repeat(temperature, HELD)
    middle = np.tile(np.arange(HELD) == HELD // 2, n).astype(float)
    return Bench(
        signals.of_arrays(np.arange(float(n * HELD)), held[0], held[1], T),
        HELD * np.arange(n + 1), middle,
        np.hstack(read), np.tile(np.repeat(np.square(sigma), 3), (n, 1)), used,
    )  # fmt: skip


def of_recording(recording: Recording) -> Bench:
    """The rests and steady turns of a recording, the input as its ``reference`` says.

    Errors: InputError without a reference; HandcalError where nothing is ever steady.
    """
    refuse_dead(recording)
    reference = recording.streams.get("reference")
    if reference is None:
        raise InputError(
            f"{recording.path} has no known input: a stream /reference with the readings of a "
            "turntable or of a trusted IMU on the same body. Without one, see `handcal lab scalar`."
        )
    spans = segment.steady(recording)
    spans = spans[[_known(reference.t, a, b) for a, b in spans]]
    if not len(spans):
        raise HandcalError(
            "No rest and no steady turn was found: let the table stand still, or turn at a "
            "constant rate, for some seconds each."
        )
    imu = recording.imu
    ends = np.searchsorted(imu.t, spans[:, 0]), np.searchsorted(imu.t, spans[:, 1], side="right")
    rows = [np.arange(a, b) for a, b in zip(*ends, strict=True)]
    at = np.concatenate(rows)
    t = imu.t[at]
    known = CubicSpline(reference.t, reference.value)(t)
    truth = signals.reading(signals.some(signals.of_recording(recording), at), known)
    start = np.r_[0, np.cumsum([len(r) for r in rows])]
    edge = reach(imu.t)
    weight = np.concatenate([_inner(imu.valid[r], edge) for r in rows])
    read = np.hstack([imu.gyro, imu.accel])[at]
    off = [(read - known)[a:b][weight[a:b] > 0.0] for a, b in pairwise(start)]
    # what a turn or a scale error changes slowly within a test is no noise
    power = np.median([white_variance(x) for x in off], axis=0)
    count = np.array([float(len(x)) for x in off])
    bench = Bench(truth, start, weight, read[start[:-1]], power / count[:, None] + PERFECT**2,
                  np.ones(6, dtype=np.bool_), spans, recording.warnings)  # fmt: skip
    return replace(bench, reading=bench.mean(read))


def _known(t: Array, start: float, end: float) -> bool:
    """Whether the input is known throughout a stretch, t (m,) being when it is."""
    own = t[max(np.searchsorted(t, start, side="right") - 1, 0) :]
    own = own[: np.searchsorted(own, end) + 1]
    return bool(len(own) and own[0] <= start and own[-1] >= end and np.diff(own).max() < GAP_S)


def _inner(valid: BoolArray, edge: int) -> Array:
    """Weights of a test's samples that add up to one: none beside its ends."""
    w = valid.astype(float)
    if w[edge:-edge].sum() > 0.0:
        w[:edge] = w[len(w) - edge :] = 0.0
    return np.asarray(w / w.sum())


def expected(bench: Bench, effects: Sequence[Effect], x: Array, truth: Signals) -> Array:
    """Mean readings (n, 6) that effects with parameters x make of a truth at every sample."""
    return bench.mean(np.hstack([truth.gyro, truth.accel]) + errors(effects, x, truth))


def design(bench: Bench, effects: Sequence[Effect], x: Array, truth: Signals) -> Array:
    """Derivatives (n, 6, k) of the mean readings by the parameters."""
    return bench.mean(columns(effects, x, truth))

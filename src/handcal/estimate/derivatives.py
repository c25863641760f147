"""How corrected readings depend on the effects' constants, and what effects add on the biases.

What excites an effect is the true motion, so noise is taken off or averaged out first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.compiled.jit import njit
from handcal.effects import Effect, Signals, correction_slopes
from handcal.estimate.corrected import Corrected, corrected_readings, proportional_apart
from handcal.estimate.problem import Problem, Slopes
from handcal.recordings.streams import STREAMS
from handcal.signals import at_times, of_recording, reading
from handcal.types import ACCEL_BIAS_PRIOR, GYRO_BIAS_PRIOR, Array, BoolArray, IntArray, Recording

# What parameters do to the readings is averaged over this long, in motion and at rest.
AVERAGE_S = (0.05, 2.0)
# Steps of the differences by gyro and accelerometer biases: a tenth of their priors.
STEPS = 0.1 * np.repeat([GYRO_BIAS_PRIOR, ACCEL_BIAS_PRIOR], 3)
# Columns that are worked out between samples at a time.
TOGETHER = 32
# Changes that differ by such a share of the largest are the same.
SAME = 1e-6
# The stream of a second IMU on the same body.
REFERENCE = "reference"


def relinearised(
    problem: Problem, ref: Array, bg: Array, ba: Array, C_nb: Array | None = None
) -> Problem:
    """The same problem with its effects linearised about constants ``ref`` (c,) and biases."""
    if problem.imu_constants == 0:
        return replace(problem, ref=ref)
    done = differentiated(corrected_readings(problem, ref, bg, ba, C_nb))
    assert done.slopes is not None
    J = done.slopes.dense(problem.imu_constants)
    return replace(done, nodes=done.nodes._replace(J=J))


def moving(done: Corrected, noise: Array | None, force: Array | None) -> tuple[Array, BoolArray]:
    """What of the corrected readings counts as motion (n, 6), and when the device rests (n,); as
    ``differentiated``. What is averaged over a rest holds nothing of the motion beside it: a delay
    would seem to act in the rest, where the velocity is known."""
    problem = done.problem
    imu = problem.recording.imu
    truth = done.raw - done.error
    if noise is not None:
        truth = truth - noise
    if force is not None:
        truth = np.hstack([truth[:, :3], force])
    quiet = np.zeros(len(imu.t), dtype=np.bool_)
    for a, b in np.searchsorted(imu.t, problem.rests):
        quiet[a:b] = True
    return (truth if noise is None else _stilled(truth, imu.t, quiet)), quiet


def differentiated(
    done: Corrected, noise: Array | None = None, force: Array | None = None
) -> Problem:
    """The problem with the derivatives of its effects where its readings were corrected.

    noise: (n, 6) estimate of the noise in the readings, which is no motion; force (n, 3): the
    specific force that may excite effects, where it is not what is read.
    """
    problem, read = done.problem, done.read
    recording, nodes = problem.recording, problem.nodes
    imu = recording.imu
    truth, quiet = moving(done, noise, force)
    parts = _parts(problem, read, truth)
    C_nb = None if noise is None else read.C_nb
    swinging = _swinging(problem)
    if swinging and C_nb is not None:
        parts = _turned(parts, swinging, C_nb)
    if noise is not None:
        whiles = _windows(recording.rate_hz, quiet)
        parts = [(c, k, _calmed(x[None], whiles)[0]) for c, k, x in parts]
    if swinging and C_nb is not None:
        parts = _turned(parts, swinging, C_nb.transpose(0, 2, 1))
    channels, columns = (np.array([p[k] for p in parts], dtype=np.int64) for k in (0, 1))
    right = np.clip(np.searchsorted(imu.t, nodes.t), 1, len(imu.t) - 1)
    share = (nodes.t - imu.t[right - 1]) / (imu.t[right] - imu.t[right - 1])
    values = np.empty((len(nodes.t), len(parts)))
    for s in range(0, len(parts), TOGETHER):  # (some at a time, gone then: they are large)
        some = np.stack([x for _, _, x in parts[:TOGETHER]])
        del parts[:TOGETHER]
        _at_nodes(some, right, share, values[:, s : s + len(some)])
    return replace(
        problem,
        nodes=nodes._replace(J=np.zeros((len(nodes.t), 6, 0))),
        slopes=Slopes(values, channels, columns),
    )


@njit
def _at_nodes(x: Array, right: IntArray, share: Array, out: Array) -> None:
    """Columns x (k, n) between samples: out (m, k), at a share of the way to the sample ``right``.
    (A few nodes at a time, whose rows stay in the processor's cache.)"""
    for begin in range(0, len(right), 32):
        end = min(begin + 32, len(right))
        for k in range(len(x)):
            for i in range(begin, end):
                r, f = right[i], share[i]
                out[i, k] = x[k, r - 1] * (1.0 - f) + x[k, r] * f


def _parts(problem: Problem, read: Signals, truth: Array) -> list[tuple[int, int, Array]]:
    """Channel, constant and derivative (n,) at the IMU's samples, where the true rate and force are
    ``truth`` (n, 6), in the order of the channels."""
    recording = problem.recording
    compared = problem.compared
    signals = reading(read, truth)
    # (what is known of the angular acceleration has none of the noise that is averaged)
    short, _ = _widths(recording.rate_hz)
    averaged = reading(read, _averaged(truth, short)) if compared else signals
    other = _another_reading(recording) if compared else None
    told = averaged if other is None else reading(read, _foretold(other))
    parts: list[tuple[int, int, Array]] = []
    i = 0
    for e in (e for e in problem.effects if e.imu_error is not None):
        own = slice(i, i + len(e.parameters))
        i = own.stop
        whole = e.imu_inverse is not None
        felt = signals if whole else told if _of_any_shape(e) else averaged
        for channel, k, column in _slopes_of(e, problem.ref[own], felt):
            if compared and whole:
                column = _averaged(column[:, None], short)[:, 0]
            parts.append((channel, own.start + k, column))
    return sorted(parts, key=_place)


def _swinging(problem: Problem) -> set[int]:
    """Constants of effects whose parts on the accelerometer cancel but for a little."""
    acting = [e for e in problem.effects if e.imu_error is not None]
    first = np.cumsum([0, *(len(e.parameters) for e in acting)])
    return {
        k for e, i in zip(acting, first, strict=False) if e.swings
        for k in range(i, i + len(e.parameters))
    }  # fmt: skip


def _turned(
    parts: Sequence[tuple[int, int, Array]], swinging: Set[int], C_nb: Array
) -> list[tuple[int, int, Array]]:
    """The same with what swinging constants do to the accelerometer along axes that do not turn:
    averaged like that, the velocity that they lead to stays what it is. Along the sensor's own
    axes, which turn meanwhile, speeding up and the force towards the centre no longer cancel.
    C_nb transposed turns back."""
    at: dict[int, Array] = {}
    for channel, k, column in parts:
        if k in swinging:
            along = column[:, None] * C_nb[:, :, channel - 3]
            at[k] = at[k] + along if k in at else along
    rest = [part for part in parts if part[1] not in swinging]
    return sorted([*rest, *((3 + i, k, at[k][:, i]) for k in at for i in range(3))], key=_place)


def _place(part: tuple[int, int, Array]) -> tuple[int, int]:
    return part[:2]


def _of_any_shape(effect: Effect) -> bool:
    """Whether this is a law found in a recording, or a course; of the catalogue's effects each has
    an id that is one word."""
    return effect.features is not None and not effect.id.isidentifier()


def _another_reading(recording: Recording) -> Array | None:
    """Rate and force (n, 6) by the reference, if there is one: what a law of any shape is a
    function of may not have in it errors of the very reading that it shall explain."""
    series = recording.streams.get(REFERENCE)
    return None if series is None else at_times(STREAMS[REFERENCE], series, recording.imu.t)


def _slopes_of(effect: Effect, at: Array, truth: Signals) -> Iterator[tuple[int, int, Array]]:
    """Channel, number of the parameter, and derivative (n,), where there is one."""
    if effect.features is not None:
        for channel, first, columns in effect.features(truth):
            yield from ((channel, first + k, columns[:, k]) for k in range(columns.shape[1]))
        return
    for k, slope in enumerate(correction_slopes(effect, at, truth)):
        # (copies: a column that is a part of the whole would keep all of it in memory)
        yield from ((int(c), k, slope[:, c].copy()) for c in np.flatnonzero(_acting(slope)))


@njit
def _acting(x: Array) -> BoolArray:
    """Which columns of x (n, k) are anything but zero."""
    out = np.zeros(x.shape[1], dtype=np.bool_)
    left = x.shape[1]
    for i in range(len(x)):
        for k in range(x.shape[1]):
            if x[i, k] != 0.0 and not out[k]:
                out[k] = True
                left -= 1
        if left == 0:
            break
    return out


def _stilled(truth: Array, t: Array, quiet: BoolArray) -> Array:
    """Rate and force (n, 6) with the mean rate of each quiet while throughout it: what the rate
    does there is the sensor's noise, which would teach a device that never turns its scale."""
    out = truth.copy()
    for a, b in _whiles(quiet):
        if t[b - 1] - t[a] > AVERAGE_S[1]:
            out[a:b, :3] = truth[a:b, :3].mean(axis=0)
    return out


def errors_by_bias(problem: Problem, bg: Array, ba: Array) -> tuple[Array, Array] | None:
    """How what the effects add at problem.ref depends on the biases, with which the readings were
    corrected: (n, 6, 6) at the IMU's samples, by [gyro bias, accel bias]; and how it depends on
    each sample alone, as on a bias that only this one has. None where it does not. Not for effects
    that move the signal as a whole: a constant stays what it is.

    Beside a reference a bias may be known as a difference alone. An effect that is not linear
    then shows what it really is, and if that could not move, a scale error would stand in for it.
    """
    if not problem.ref[: problem.imu_constants].any() or problem.error is None:
        return None
    imu, alpha = problem.recording.imu, problem.alpha
    acting = [e for e in problem.effects if e.imu_error is not None]
    raw = np.hstack([imu.gyro - bg, imu.accel - ba])
    read = of_recording(problem.recording, acting, read=raw, alpha=alpha)
    short, long = _widths(problem.recording.rate_hz)
    truth = np.asfortranarray(_averaged(raw - problem.error, short))
    whole, left = proportional_apart(acting, problem.ref)
    every = np.tile(-whole.T, (len(imu.t), 1, 1))
    alone = every.copy()
    for e, at in left:
        if e.imu_inverse is None:
            added = partial(_added, e, at, read, truth)
            _take_off(added, _of_any_shape(e), long, every, alone)
    return every, alone


def _added(effect: Effect, at: Array, read: Signals, truth: Array, step: Array) -> Array:
    """What an effect with these parameters adds (n, 6) to the truth (n, 6) moved by a step."""
    assert effect.imu_error is not None
    return effect.imu_error(at, reading(read, truth + step))


def _take_off(
    added: Callable[[Array], Array], memory: bool, width: int, every: Array, alone: Array
) -> None:
    """Take off what an effect adds more where the truth is larger, of (n, 6, 6) where all of it is
    and where one sample alone is (a larger bias means a smaller truth). added: as ``_added``;
    memory: whether what it adds to a sample may depend on others.

    If it does: where a half of the samples make a step that have no rhythm, what others do to one
    adds up to half of what all do; what is left is its own, in the mean over ``width`` samples.
    """
    here = added(np.zeros(6))
    signs = _signs(len(here))[:, None]
    some = np.maximum(signs, 0.0)
    for sensor in (slice(0, 3), slice(3, 6)):
        step = np.zeros(6)
        step[sensor] = STEPS[sensor]
        all_ = added(step) - here
        if not all_.any():
            continue
        least = SAME * np.abs(all_).max()
        depends = memory and not np.allclose(
            added(some * step) - here, some * all_, rtol=0.0, atol=least
        )
        for k in range(6)[sensor]:
            one = np.where(np.arange(6) == k, step, 0.0)
            whole = own = added(one) - here
            if depends:
                half = added(some * one) - here
                own = _averaged(signs * (2.0 * half - whole), width)
            every[:, :, k] -= whole / step[k]
            alone[:, :, k] -= own / step[k]


def _signs(n: int) -> Array:
    """The first n signs of Rudin and Shapiro: any two that are so far apart are alike as often as
    not (Rudin, Proceedings of the American Mathematical Society 10 (1959))."""
    k = np.arange(n, dtype=np.uint64)
    return np.where(np.bitwise_count(k & (k >> np.uint64(1))) & 1, -1.0, 1.0)


def _calmed(J: Array, whiles: Sequence[tuple[int, IntArray]]) -> Array:
    """J (k, n) averaged over a short time, and over a longer one within each quiet while; whiles:
    as of ``_windows``.

    Neither reaches beyond its while, and each sample weighs as much as any other: what is averaged
    adds up to what it did before. A delay's derivative is noise that adds up to nothing; where the
    end of a rest weighed more, it told of velocities that no device had.
    """
    out = np.empty_like(J)
    for width, spans in whiles:
        _means_within(J, spans, width, out)
    return out


def _windows(rate: float, quiet: BoolArray) -> list[tuple[int, IntArray]]:
    """Samples over which is averaged, and the whiles (k, 2) in which: in motion, and in rest."""
    moving, resting = _widths(rate)
    return [(moving, _whiles(~quiet)), (resting, _whiles(quiet))]


def _widths(rate: float) -> tuple[int, int]:
    """``AVERAGE_S`` in samples, so many a second."""
    moving, resting = (max(1, round(s * rate)) for s in AVERAGE_S)
    return moving, resting


def _whiles(wanted: BoolArray) -> IntArray:
    """First row and the one after the last (k, 2) of each run of what is wanted."""
    edges = np.flatnonzero(np.diff(np.r_[0, wanted.astype(np.int8), 0]))
    return edges.reshape(-1, 2).astype(np.int64)


def _foretold(x: Array) -> Array:
    """What two samples on either side say of each of x (n, k), by a cubic through them: what is
    compared with a sample has its noise, and a law that takes off that noise (play, say: what is
    read less what follows it) promised thousands of nats."""
    y = np.pad(x, ((2, 2), (0, 0)), mode="edge")
    return (4.0 * (y[1:-3] + y[3:-1]) - y[:-4] - y[4:]) / 6.0


def _averaged(J: Array, width: int) -> Array:
    """Moving mean of J (n, k) over ``width`` samples.

    The same sample's noise is in J and in what J shall explain; correlated like that, it
    would count as information on the parameters (a device at rest would learn its scale
    errors). What an effect adds is still computed from the readings as they are.
    """
    out = np.empty_like(J)
    _running_mean(J, width, out)
    return out


@njit
def _running_mean(x: Array, width: int, out: Array) -> None:
    """Means over ``width`` rows of x (n, k), the first and the last repeated beyond the ends."""
    n, k = x.shape
    total = np.zeros(k)
    for j in range(-(width // 2), width - width // 2):
        for c in range(k):
            total[c] += x[min(max(j, 0), n - 1), c]
    for i in range(n):
        for c in range(k):
            out[i, c] = total[c] / width
        old, new = max(i - width // 2, 0), min(i + width - width // 2, n - 1)
        for c in range(k):
            total[c] += x[new, c] - x[old, c]


@njit
def _means_within(x: Array, spans: IntArray, width: int, out: Array) -> None:
    """Means over ``width`` samples of x (k, n) about each of the spans (m, 2), from the first to
    before the last, which is mirrored at both ends: the matrix of that is symmetric, so that
    columns add up to what they did."""
    for s in range(len(spans)):
        begin, n = spans[s, 0], spans[s, 1] - spans[s, 0]
        reach = min(width // 2, n - 1)
        for c in range(len(x)):
            total = 0.0
            for j in range(-reach, reach + 1):
                total += x[c, begin + _mirrored(j, n)]
            for i in range(n):
                out[c, begin + i] = total / (2 * reach + 1)
                old, new = _mirrored(i - reach, n), _mirrored(i + reach + 1, n)
                total += x[c, begin + new] - x[c, begin + old]


@njit
def _mirrored(i: int, n: int) -> int:
    """Number i of n that are mirrored at both ends, not further away than they are long."""
    return -1 - i if i < 0 else 2 * n - 1 - i if i >= n else i

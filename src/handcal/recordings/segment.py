"""Finds where the device rests, from the readings alone.

A rest is a stretch in which the readings scatter as much at its end as at its beginning, and
the attitude stays: each rest has a noise of its own, a table's or that of a hand that trembles,
and is judged by that. Half-second windows are compared with the quietest of their surroundings
(an F test, for noise as narrow as a tremor); what is louder is looked at again by itself, so a
pose held by hand is found beside a rest on a table.

A pause between two turns may be shorter than any tremor shows itself. It counts where the
readings are what the sensor's own noise makes of a constant, by the generalised likelihood
ratio (Skog, Händel, Nilsson and Rantakokko, IEEE Trans. Biomedical Engineering 57, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, fdtri

from handcal.types import Array, BoolArray, IntArray, Recording

# Scatter is that of windows so long, s; a rest is longer than this, s.
WINDOW_S = 0.5
MIN_REST_S = 0.8
# A device that is held still turns slower than this on the mean of a window, and a tremor is no
# more than this within it: sums over the axes, twice what usual hands do.
MAX_RATE = np.radians(8.0)
MAX_RATE_SPREAD = np.radians(5.0)
MAX_FORCE_SPREAD = 1.5
# No hand scatters less than this (and simulated sensors may have no scatter).
MIN_RATE_SPREAD = np.radians(0.25)
MIN_FORCE_SPREAD = 0.035
# Physiological tremor is a band of 4 Hz: noise of that width has 2 * 4 * 0.5 degrees of freedom
# in a window and on an axis, and differs from its own level by no more than this factor in one
# window of ten thousand.
TREMOR_HZ = 4.0
FALSE_ALARM = 1e-4
_FREEDOM = 3 * 2.0 * TREMOR_HZ * WINDOW_S
RATIO = float(fdtri(_FREEDOM, _FREEDOM, 1.0 - FALSE_ALARM))
# The quietest share of windows shows the noise of the sensor alone.
QUIETEST = 0.1
# Below these a noise is none: of a sum over the axes a window's, of one axis a reading's.
LEAST = MIN_RATE_SPREAD / np.sqrt(3.0 * RATIO), MIN_FORCE_SPREAD / np.sqrt(3.0 * RATIO)
# A hand that sets a device down trembles for a second; what is held is held for longer.
MIN_HOLD_S = 2.5 * WINDOW_S
# A zero-rate offset is less than this, and changes by less within a recording; a held pose stays
# within this angle, whatever the gyro says of it.
MAX_OFFSET = np.radians(20.0)
MAX_DRIFT = np.radians(1.0)
HOLD_ANGLE = np.radians(5.0)
# Flicker beside white noise: real sensors on a table have up to 3.3 times the white noise's
# variance in half-second means; the steadiest of usual hands 17 times.
FLICKER = 4.0
# Chance with which a rest on a table is taken for one in a hand; of so many means at the least.
STILL_ALARM = 1e-3
FEWEST = 3
# Between turns a device on a table may rest as briefly; windows in which that shows.
MIN_PAUSE_S = 0.2
PAUSE_WINDOW_S = 0.1
# A gap is longer than this, s, and than so many usual steps.
GAP_S, GAP = 0.5, 5.0
# A turn at a constant rate ripples by less than this part of it, and by less than this.
MAX_RIPPLE = 0.004
MAX_STEADY_SPREAD = np.radians(2.5)


@dataclass(frozen=True)
class Rest:
    """A stretch at rest: start and end, s; mean rate (3,) rad/s and force (3,) m/s^2 as read.

    gyro_noise, accel_noise: standard deviation of a reading about that mean, rad/s and m/s^2,
    over the axes: the noise this rest has, the hand's included. still: whatever turning there
    is does not show beside the sensor's white noise, so the rate is known to be zero.
    """

    start: float
    end: float
    rate: Array
    force: Array
    gyro_noise: float
    accel_noise: float
    still: bool

    @property
    def seconds(self) -> float:
        return self.end - self.start


def _moving(x: Array, width: int) -> tuple[Array, Array]:
    """Centred moving mean and variance (n, d) of x (n, d) over ``width`` samples."""
    pad = width // 2
    padded = np.pad(x, ((pad, width - 1 - pad), (0, 0)), mode="edge")
    s1 = np.cumsum(np.vstack([np.zeros(x.shape[1]), padded]), axis=0)
    s2 = np.cumsum(np.vstack([np.zeros(x.shape[1]), padded**2]), axis=0)
    mean = (s1[width:] - s1[:-width]) / width
    variance = (s2[width:] - s2[:-width]) / width - mean**2
    return mean, np.maximum(variance, 0.0)


def _width(recording: Recording, seconds: float = WINDOW_S) -> int:
    """Samples in a window."""
    return max(5, round(seconds * recording.rate_hz))


def spreads(recording: Recording) -> tuple[Array, Array]:
    """Standard deviation over half a second of gyro (n,) rad/s and accelerometer (n,) m/s^2."""
    imu, width = recording.imu, _width(recording)
    _, g = _moving(imu.gyro - imu.gyro.mean(0), width)
    _, a = _moving(imu.accel - imu.accel.mean(0), width)
    return np.sqrt(g.sum(1)), np.sqrt(a.sum(1))


def rests(recording: Recording) -> Array:
    """Rests as (r, 2) start and end, s; each at least 0.8 s long."""
    return _spans(each_rest(recording))


def _spans(found: list[Rest]) -> Array:
    return np.array([(r.start, r.end) for r in found]).reshape(-1, 2)


def each_rest(recording: Recording) -> list[Rest]:
    """Rests in order, each at least 0.8 s long and with the noise it has."""
    imu = recording.imu
    gyro, accel = spreads(recording)
    calm = (gyro < MAX_RATE_SPREAD) & (accel < MAX_FORCE_SPREAD) & imu.valid
    runs = _levels(gyro**2, accel**2, imu.t, calm)
    mean, _ = _moving(imu.gyro, _width(recording))
    offset = _offset(mean, runs)
    if offset is None:
        return []
    calm &= np.linalg.norm(mean - offset, axis=1) < MAX_RATE
    parts = [(a + i, a + j) for a, b in runs for i, j in _runs(calm[a:b], imu.t[a:b], MIN_REST_S)]
    # the window reaches into the motion on both sides of a rest
    found = [_rest(recording, *_inner(imu.t, a, b)) for a, b in parts]
    return _told(_joined(recording, [r for r in found if _stays(recording, r, offset)], calm))


def _told(found: list[Rest]) -> list[Rest]:
    """Without what is louder than the quietest rest can be, and too short to tell a pose that is
    held from a hand that sets the device down; none of the louder is still."""
    gyro = min((r.gyro_noise for r in found), default=0.0)
    accel = min((r.accel_noise for r in found), default=0.0)
    limit = [np.sqrt(RATIO) * max(x, least) for x, least in ((gyro, LEAST[0]), (accel, LEAST[1]))]
    out = []
    for r in found:
        if r.gyro_noise < limit[0] and r.accel_noise < limit[1]:
            out.append(r)
        elif r.seconds > MIN_HOLD_S:
            out.append(replace(r, still=False))
    return out


def _joined(recording: Recording, found: list[Rest], calm: BoolArray) -> list[Rest]:
    """Rests in the same attitude with nothing but a hold's motion between them (calm (n,)) are
    one: as loud, both with what is between; else the longer, the other being how it settles.
    Where both are still, what is between is a knock."""
    out: list[Rest] = []
    for rest in found:
        last = out[-1] if out else None
        if last is None or not _one_pose(recording, last, rest, calm):
            out.append(rest)
        elif _alike(last, rest):
            out[-1] = _rest(recording, last.start, rest.end)
        elif rest.seconds > last.seconds:
            out[-1] = rest
    return out


def _one_pose(recording: Recording, a: Rest, b: Rest, calm: BoolArray) -> bool:
    t = recording.imu.t
    between = slice(*np.searchsorted(t, [a.end, b.start]))
    if len(gaps(t[between.start - 1 : between.stop + 1])):
        return False
    brief = b.start - a.end < MIN_REST_S + WINDOW_S
    hand = not (a.still and b.still)
    return hand and brief and _same(a.force, b.force) and bool(calm[between].all())


def _same(a: Array, b: Array) -> bool:
    """Whether two mean forces (3,) are one attitude's, as far as a hand can hold it."""
    return bool(np.linalg.norm(b - a) <= HOLD_ANGLE * np.linalg.norm(a))


def _alike(a: Rest, b: Rest) -> bool:
    """Whether the noise of two rests is one noise's."""
    pairs = (a.gyro_noise, b.gyro_noise), (a.accel_noise, b.accel_noise)
    return all(
        max(p) ** 2 <= RATIO * max(min(p), least) ** 2
        for p, least in zip(pairs, LEAST, strict=True)
    )


def _levels(gyro: Array, accel: Array, t: Array, calm: BoolArray) -> list[tuple[int, int]]:
    """Half-open runs of samples in which the windows' variances (n,) are one noise's.

    Within what is calm the quietest tenth of a run is its level; where windows are louder than
    noise of that level can be, the same is done again.
    """
    least = 3.0 * LEAST[0] ** 2, 3.0 * LEAST[1] ** 2
    todo, done = _runs(calm, t, MIN_REST_S), []
    while todo:
        a, b = todo.pop()
        both = np.maximum(gyro[a:b] / least[0], 1.0) * np.maximum(accel[a:b] / least[1], 1.0)
        lowest = np.argsort(both, kind="stable")[: max(1, round(QUIETEST * (b - a)))]
        level = [max(float(np.median(v[a:b][lowest])), m)
                 for v, m in zip((gyro, accel), least, strict=True)]  # fmt: skip
        alike = (gyro[a:b] < RATIO * level[0]) & (accel[a:b] < RATIO * level[1])
        if not alike.any():
            continue
        done += [(a + i, a + j) for i, j in _runs(alike, t[a:b], MIN_REST_S)]
        todo += [(a + i, a + j) for i, j in _runs(~alike, t[a:b], MIN_REST_S)]
    return sorted(done)


def _offset(mean: Array, runs: list[tuple[int, int]]) -> Array | None:
    """What the gyro reads at rest (3,): of the quiet run with the least rate. A steady turn is
    quiet too, and may be the longest, but it turns faster. None: nothing is that slow."""
    if not runs:
        return None
    least = min((mean[a:b].mean(axis=0) for a, b in runs), key=lambda rate: float(rate @ rate))
    return np.asarray(least) if np.linalg.norm(least) < MAX_OFFSET else None


def _inner(t: Array, a: int, b: int) -> tuple[float, float]:
    """A run of windows without what they reach into the motion beside it, s."""
    margin = 0.25 * WINDOW_S
    start = t[0] if a == 0 else t[a] + margin
    return float(start), float(t[-1] if b == len(t) else t[b - 1] - margin)


def _within(recording: Recording, start: float, end: float) -> tuple[Array, Array]:
    """Sound readings of gyro and accelerometer (k, 3) from start to end, s."""
    imu = recording.imu
    own = slice(*np.searchsorted(imu.t, [start, end + 1e-9]))
    return imu.gyro[own][imu.valid[own]], imu.accel[own][imu.valid[own]]


def _rest(recording: Recording, start: float, end: float) -> Rest:
    gyro, accel = _within(recording, start, end)
    noise = [float(np.sqrt(x.var(axis=0).mean())) for x in (gyro, accel)]
    return Rest(
        start, end, gyro.mean(axis=0), accel.mean(axis=0), noise[0], noise[1],
        _still(gyro, recording.rate_hz),
    )  # fmt: skip


def _still(gyro: Array, rate_hz: float) -> bool:
    """Whether means of neighbouring windows of readings (n, 3) differ no more than white noise does
    (by the Allan variance, to which a drift over minutes adds little); fewer than three windows
    cannot show it."""
    width = max(4, round(WINDOW_S * rate_hz))
    k = len(gyro) // width
    if k < FEWEST:
        return False
    blocks = gyro[: k * width].reshape(k, width, 3)
    own = float(blocks.var(axis=1, ddof=1).mean())
    between = 0.5 * width * float((np.diff(blocks.mean(axis=1), axis=0) ** 2).mean())
    # (neighbouring differences are correlated: two thirds of the degrees of freedom are left)
    most = FLICKER * float(fdtri(2 * (k - 1), 3 * k * (width - 1), 1.0 - STILL_ALARM))
    return between <= most * own


def _stays(recording: Recording, rest: Rest, offset: Array) -> bool:
    """Whether the attitude is the same throughout, as far as a hand can hold it."""
    turned = float(np.linalg.norm(rest.rate - offset))
    part = min(WINDOW_S, 0.5 * rest.seconds)
    ends = [(rest.start, rest.start + part), (rest.end - part, rest.end)]
    first, last = (_within(recording, a, b)[1] for a, b in ends)
    if not (len(first) and len(last)):  # (a gap in the readings: unknown)
        return False
    first, last = first.mean(axis=0), last.mean(axis=0)
    return turned < MAX_DRIFT + HOLD_ANGLE / rest.seconds and _same(first, last)


def with_pauses(recording: Recording) -> Array:
    """Rests as (r, 2) start and end, s, and the pauses between them, of 0.2 s at least, in which
    the readings are the sensor's noise about a constant.

    The noise is that of the rests on either side; without one that is still there are none.
    """
    found, imu = each_rest(recording), recording.imu
    spans = _spans(found)
    still = [r for r in found if r.still]
    if not still:
        return spans
    taken = np.zeros(len(imu.t), dtype=np.bool_)
    for a, b in spans:
        taken[slice(*np.searchsorted(imu.t, [a, b]))] = True
    quiet = taken | (imu.valid & _like(recording, still))
    # (a window is centred on its sample: what it holds is like the rest, half of it besides)
    runs = _runs(quiet, imu.t, MIN_PAUSE_S - PAUSE_WINDOW_S)
    pauses = [(imu.t[a], imu.t[b - 1]) for a, b in runs if not taken[a:b].any()]
    return np.array(sorted([*map(tuple, spans), *pauses])).reshape(-1, 2)


def _like(recording: Recording, still: list[Rest]) -> BoolArray:
    """Whether a window about each sample (n,) is a constant, at the rate and with the noise of
    the rests beside it: minus twice the log of the likelihood ratio is chi-square."""
    imu, width = recording.imu, _width(recording, PAUSE_WINDOW_S)
    middle = np.array([0.5 * (r.start + r.end) for r in still])
    after = np.searchsorted(middle, imu.t)
    beside = np.clip(after - 1, 0, None), np.clip(after, None, len(still) - 1)
    noise = np.array([(r.gyro_noise, r.accel_noise) for r in still])
    own = np.maximum(noise[beside[0]], noise[beside[1]])
    own = np.maximum(own, LEAST)
    rate = np.array([r.rate for r in still])
    rate = np.stack([np.interp(imu.t, middle, axis) for axis in rate.T], axis=1)
    mean, square = _moving(imu.gyro - rate, width)
    _, scatter = _moving(imu.accel - imu.accel.mean(axis=0), width)
    statistic = width * (
        (mean**2 + square).sum(axis=1) / own[:, 0] ** 2 + scatter.sum(axis=1) / own[:, 1] ** 2
    )
    return np.asarray(statistic < chdtri(6 * width - 3, FALSE_ALARM))


def at_rest(recording: Recording) -> bool:
    """Whether the device lies still from the beginning to the end."""
    found = each_rest(recording)
    return (
        len(found) == 1
        and found[0].still
        and found[0].seconds > recording.duration_s - 2.0 * WINDOW_S
    )


def steady(recording: Recording) -> Array:
    """Rests and turns at a constant rate as (s, 2) start and end, s; each at least 0.8 s long.

    The rate of a turn may ripple by a part of itself; the force may be anything, since a turn
    about an axis that is not vertical carries gravity around.
    """
    imu = recording.imu
    spread, _ = spreads(recording)
    mean, _ = _moving(imu.gyro, _width(recording))
    floor = float(np.quantile(spread, QUIETEST))
    limit = np.maximum(np.sqrt(RATIO) * floor, MIN_RATE_SPREAD)
    limit = np.maximum(limit, MAX_RIPPLE * np.linalg.norm(mean, axis=1))
    found = _runs((spread < np.minimum(limit, MAX_STEADY_SPREAD)) & imu.valid, imu.t, MIN_REST_S)
    margin = 0.25 * WINDOW_S
    out = [(imu.t[a] + margin, imu.t[b - 1] - margin) for a, b in found]
    return np.array(out).reshape(-1, 2)


def _runs(mask: BoolArray, t: Array, shortest: float) -> list[tuple[int, int]]:
    """Half-open index runs where mask holds for at least ``shortest`` seconds; none goes across a
    gap."""
    edge = np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0]))
    inside = gaps(t) + 1
    cuts = np.repeat(inside[mask[inside] & mask[inside - 1]], 2)
    pairs = np.sort(np.r_[edge, cuts]).reshape(-1, 2)
    return [(int(a), int(b)) for a, b in pairs if t[b - 1] - t[a] >= shortest]


def gaps(t: Array) -> IntArray:
    """Readings (k,) behind which there is none for long: what was so before need not be so after.
    t (n,) s."""
    step = np.diff(t)
    if not len(step):
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(step > max(GAP_S, GAP * float(np.median(step))))

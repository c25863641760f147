"""Puts recording, effects and observations together for the filter.

This is the only place that knows the layout of the state:
``[position, velocity, psi, gyro bias, accel bias | constants | Markov states]``, each of
the first five (3,). Constants are first those of effects that act on the readings
(``imu constants``), then all others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled.jit import njit
from handcal.compiled.kernel import BASE, MAX_DIM, MOST_HELD, Nodes, Noise, Tables
from handcal.effects import DELAY, TIME, Z_DIM, Effect, Signals, correction_slopes
from handcal.observations import Observation, Rows, nearest
from handcal.recordings.streams import STREAMS
from handcal.signals import at_times, of_recording, reading
from handcal.types import ACCEL_BIAS_PRIOR as ACCEL_BIAS_PRIOR
from handcal.types import GYRO_BIAS_PRIOR as GYRO_BIAS_PRIOR
from handcal.types import Array, BoolArray, IntArray, Level, Markov, Recording

# The readings themselves show the white noise of the sensors to a few percent; there can be
# more than that (whatever the model lacks), hardly less.
IMU_LEVELS = (
    Level("gyro_noise", "rad/s/sqrt(Hz)", 2e-4, 1e-6, 0.1, below=0.15, above=0.3),
    Level("accel_noise", "m/s^2/sqrt(Hz)", 2e-3, 1e-5, 1.0, below=0.15, above=0.3),
)
# Moments closer than this are one, s.
SNAP_S = 1e-7
# What parameters do to the readings is averaged over this long, in motion and at rest.
AVERAGE_S = (0.05, 2.0)
QUIET_RATE = 0.05
# Step of the difference by a bias, of its prior.
BIAS_STEP = 0.1
# The stream of a second IMU on the same body.
REFERENCE = "reference"
# Rounds of substitution at the most, and the share of the largest reading by which the last one
# may move any: a scale error of a fifth takes eight (after three it would be known to 1 %), an
# error that changes by three quarters of what is measured fifty-six.
SUBSTITUTIONS, SUBSTITUTED = 60, 1e-7
# A round that moves hardly less than the one before leads nowhere.
SHRINKS = 0.9


@dataclass(frozen=True)
class Slot:
    """One constant of the state: whose it is, its name, unit and prior (about zero, unless
    something outside the filter says better)."""

    owner: str
    name: str
    unit: str
    prior_sigma: float
    prior_mean: float = 0.0


@dataclass(frozen=True)
class Slopes:
    """How the readings depend on the IMU constants: derivatives (n, s) at the nodes, each of one
    channel (s,) by one constant (s,), in the order of the channels; all others are zero."""

    values: Array
    channel: IntArray
    column: IntArray

    def dense(self, constants: int) -> Array:
        """The same as (n, 6, constants)."""
        out = np.zeros((len(self.values), 6, constants))
        out[:, self.channel, self.column] = self.values
        return out

    def times(self, x: Array) -> Array:
        """By how much the readings (n, 6) change with constants that change by x (c,)."""
        of_channel = np.where(self.channel[:, None] == np.arange(6), x[self.column][:, None], 0.0)
        return np.asarray(self.values @ of_channel)


@dataclass(frozen=True)
class Problem:
    """A recording made ready for the filter.

    ref (c,): values of the constants about which the effects were linearised; g_n,
    omega_ie_n (3,); rate (n,): smoothed turning rate at the nodes, rad/s;
    observations: the kinds in use, numbered as in ``nodes.kind``; dropped: rows outside
    the recording. markovs: the processes whose states follow the constants, in their order;
    walks: (first state of those, column of the readings) of each that adds to these, and
    wandering: of each that is a bias; alpha: known angular acceleration (n, 3) at the IMU's
    samples, rad/s^2. slopes: at ref, of what has been linearised about a trajectory; the online
    filter reads ``nodes.J`` instead.
    """

    recording: Recording
    effects: tuple[Effect, ...]
    observations: tuple[Observation, ...]
    slots: tuple[Slot, ...]
    imu_constants: int
    markovs: tuple[Markov, ...]
    walks: tuple[tuple[int, int], ...]
    wandering: tuple[tuple[int, int], ...]
    nodes: Nodes
    tables: Tables
    ref: Array
    g_n: Array
    omega_ie_n: Array
    rate: Array
    dropped: int
    alpha: Array | None = None
    slopes: Slopes | None = None

    @property
    def constants(self) -> int:
        return len(self.slots)

    @property
    def navigated(self) -> bool:
        """Whether motion is integrated: not beside a reference alone."""
        return any(o.navigates for o in self.observations)

    @property
    def prior_mean(self) -> Array:
        """Prior means (c,) of the constants."""
        return np.array([s.prior_mean for s in self.slots])

    @property
    def markov_size(self) -> int:
        return sum(m.size for m in self.markovs)

    def states_of(self, process: Markov | None) -> IntArray:
        """Places of a process's states among those of all; none where it is not there."""
        at = 0
        for markov in self.markovs:
            if markov is process:
                return np.arange(at, at + markov.size, dtype=np.int64)
            at += markov.size
        return np.zeros(0, dtype=np.int64)

    @property
    def size(self) -> int:
        """Number of states."""
        return BASE + len(self.slots) + self.markov_size

    @property
    def levels(self) -> tuple[Level, ...]:
        """Every noise level that plays a part."""
        found = {lv.name: lv for o in self.observations for lv in o.levels}
        found |= {lv.name: lv for e in self.effects for lv in e.levels}
        return (*IMU_LEVELS, *found.values())


def build(
    recording: Recording,
    effects: Sequence[Effect],
    observed: Sequence[tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]],
    g_n: Array,
    omega_ie_n: Array,
    *,
    linearised: bool = True,
) -> Problem:
    """Assemble a Problem. ``observed``: each kind with its rows and its constants.

    linearised: about zero; not needed where a trajectory to linearise about is at hand.
    """
    acting = [e for e in effects if e.imu_error is not None]
    others = [e for e in effects if e.imu_error is None]
    slots = slots_of(effects)
    imu_constants = sum(len(e.parameters) for e in acting)
    at: dict[str, int] = {}
    for i, s in enumerate(slots):
        at.setdefault(s.owner, i)
    for observation, _, constants in observed:
        at[observation.kind] = len(slots)
        slots += [Slot(observation.kind, name, unit, sigma) for name, unit, sigma in constants]
    markovs: list[Markov] = []
    walks, size = [], 0
    markov_at: dict[str, int] = {}
    processes = [(o.kind, o.markov, "", False) for o, _, _ in observed]
    processes += [(e.id, e.process, e.walks, e.passing) for e in others]
    wandering = []
    for owner, markov, walked, passing in processes:
        if markov is not None:
            markovs.append(markov)
            if walked:
                walks.append((size, 0 if walked == "gyro" else 3))
            if walked and not passing:
                wandering.append(walks[-1])
            markov_at[owner] = len(slots) + size
            size += markov.size
    kinds = tuple(o for o, _, _ in observed)
    step = np.r_[[1e-3 * s.prior_sigma for s in slots], np.full(size, 1e-5)]
    nodes, rate, dropped = _nodes(recording, [r for _, r, _ in observed], imu_constants)
    problem = Problem(
        recording,
        (*acting, *others),
        kinds,
        tuple(slots),
        imu_constants,
        tuple(markovs),
        tuple(walks),
        tuple(wandering),
        nodes,
        _tables(kinds, [c for _, _, c in observed], (*acting, *others), at, markov_at, step),
        np.zeros(len(slots)),
        g_n,
        omega_ie_n,
        rate,
        dropped,
        next((r.alpha for _, r, _ in observed if r.alpha is not None), None),
    )
    if not linearised:
        return problem
    return relinearised(problem, np.zeros(len(slots)), np.zeros(3), np.zeros(3))


def slots_of(effects: Sequence[Effect]) -> list[Slot]:
    """Constants of effects, first of those that act on the readings."""
    acting = [e for e in effects if e.imu_error is not None]
    others = [e for e in effects if e.imu_error is None]
    return [
        Slot(e.id, p.name, p.unit, p.prior_sigma)
        for e in (*acting, *others)
        for p in e.parameters
        if e.process is None and not e.outliers
    ]


def constants_of(problem: Problem, constants: Array, owner: str) -> Array:
    """Those of the problem's constants (c,) that are an observation's or an effect's."""
    return constants[[i for i, s in enumerate(problem.slots) if s.owner == owner]]


def _tables(
    kinds: Sequence[Observation],
    constants: Sequence[Sequence[tuple[str, str, float]]],
    effects: Sequence[Effect],
    at: Mapping[str, int],
    markov_at: Mapping[str, int],
    step: Array,
) -> Tables:
    width = 2 + len(effects)
    function = np.zeros((len(kinds), width), dtype=np.int64)
    start = np.zeros((len(kinds), width), dtype=np.int64)
    count = np.zeros((len(kinds), width), dtype=np.int64)
    whole = np.zeros((len(kinds), width), dtype=np.int64)
    held = np.full((len(kinds), width, MOST_HELD), np.nan)
    for k, kind in enumerate(kinds):
        function[k, 0] = kind.residual
        parts = [(kind.residual, at[kind.kind], len(constants[k]))]
        if kind.markov is not None:
            parts.append((kind.markov_residual, markov_at[kind.kind], kind.markov.size))
        acting = [e for e in effects if kind.kind in e.observation_error]
        for j, e in enumerate(acting, len(parts)):
            whole[k, j] = len(e.held)
            held[k, j, : len(e.held)] = e.held
        parts += [
            (e.observation_error[kind.kind], at[e.id], len(e.parameters))
            if e.process is None
            else (e.observation_error[kind.kind], markov_at[e.id], e.process.size)
            for e in acting
        ]
        for j, part in enumerate(parts):
            function[k, j], start[k, j], count[k, j] = part
    return Tables(
        np.array([k.dim for k in kinds], dtype=np.int64),
        np.array([k.jacobian for k in kinds], dtype=np.int64),
        function,
        start,
        count,
        step,
        whole,
        held,
    )


def _nodes(
    recording: Recording, rows: Sequence[Rows], imu_constants: int
) -> tuple[Nodes, Array, int]:
    """Insert the observation times between the IMU's stamps, readings interpolated there."""
    imu = recording.imu
    ot = np.concatenate([r.t - r.delay for r in rows]) if rows else np.zeros(0)
    kind = (
        np.concatenate([np.full(len(r.t), k) for k, r in enumerate(rows)]) if rows else np.zeros(0)
    )
    z, moved = np.zeros((len(ot), Z_DIM)), np.zeros(len(ot))
    i = 0
    for r in rows:
        own = slice(i, i + len(r.t))
        z[own, : r.z.shape[1]] = r.z
        z[own, DELAY] = r.delay
        moved[own] = 0.0 if r.moved is None else r.moved
        i = own.stop
    z[:, TIME] = ot - imu.t[0]
    keep = (ot >= imu.t[0]) & (ot <= imu.t[-1])
    ot, kind, z, moved = ot[keep], kind[keep].astype(np.int64), z[keep], moved[keep]
    near = nearest(imu.t, ot)
    ot = np.where(np.abs(imu.t[near] - ot) < SNAP_S, imu.t[near], ot)
    order = np.lexsort((kind, ot))
    ot, kind, z, moved = ot[order], kind[order], z[order], moved[order]
    t = np.union1d(imu.t, ot)
    node = np.searchsorted(t, ot)
    first = np.searchsorted(node, np.arange(len(t) + 1)).astype(np.int64)
    gyro = np.stack([np.interp(t, imu.t, imu.gyro[:, k]) for k in range(3)], axis=1)
    accel = np.stack([np.interp(t, imu.t, imu.accel[:, k]) for k in range(3)], axis=1)
    rate = _smoothed_rate(recording, t)
    extra = _extra(recording, t)
    np.add.at(extra[:, 2], node, moved**2)
    nodes = Nodes(t, gyro, accel, np.zeros((len(t), 6, imu_constants)), extra, first, kind, z)
    return nodes, rate, int((~keep).sum())


def _smoothed_rate(recording: Recording, t: Array) -> Array:
    imu = recording.imu
    bias = np.median(imu.gyro, axis=0) if len(imu.t) < 10 else np.zeros(3)
    speed = np.linalg.norm(imu.gyro - bias, axis=1)
    width = max(1, round(0.3 * recording.rate_hz))
    mean = np.convolve(speed, np.ones(width) / width, mode="same")
    return np.asarray(np.interp(t, imu.t, mean))


def _extra(recording: Recording, t: Array) -> Array:
    """Variance (n, 3) added to angle, velocity and position: of the first two over intervals that
    hold no measurement."""
    imu = recording.imu
    dt_imu = np.diff(imu.t)
    gap = dt_imu > 4.0 * np.median(dt_imu)
    masked = ~(imu.valid[1:] & imu.valid[:-1])
    at = np.clip(np.searchsorted(imu.t, t[1:], side="left") - 1, 0, len(dt_imu) - 1)
    dt = np.diff(t)
    out = np.zeros((len(t), 3))
    turning = 1.0 + float(np.sqrt((imu.gyro**2).mean()))
    shaking = 2.0 + float(imu.accel.std())
    out[1:, 0] += (
        np.where(gap[at], turning * dt, 0.0) ** 2 + np.where(masked[at], 10.0 * dt, 0.0) ** 2
    )
    out[1:, 1] += (
        np.where(gap[at], shaking * dt, 0.0) ** 2 + np.where(masked[at], 30.0 * dt, 0.0) ** 2
    )
    return out


@dataclass(frozen=True)
class Corrected:
    """A problem whose readings have been corrected, its derivatives still as they were: raw, the
    readings less the biases, and the effects' error in them (n, 6)."""

    problem: Problem
    read: Signals
    raw: Array
    error: Array


def corrected_readings(
    problem: Problem, ref: Array, bg: Array, ba: Array, C_nb: Array | None = None
) -> Corrected:
    """The problem with the effects at constants ``ref`` (c,) taken off the readings; C_nb
    (n, 3, 3).

    What an effect adds depends on the true rate and force, which are the readings less
    all errors, found by substitution.
    """
    imu, nodes = problem.recording.imu, problem.nodes
    raw = np.hstack([imu.gyro - bg, imu.accel - ba])
    acting = [e for e in problem.effects if e.imu_error is not None]
    read = of_recording(problem.recording, acting, read=raw, C_nb=C_nb, alpha=problem.alpha)
    error = substituted(acting, ref, read)
    clean = np.hstack([imu.gyro, imu.accel]) - error
    at = [np.interp(nodes.t, imu.t, clean[:, k]) for k in range(6)]
    nodes = nodes._replace(gyro=np.stack(at[:3], axis=1), accel=np.stack(at[3:], axis=1))
    return Corrected(replace(problem, ref=ref, nodes=nodes), read, raw, error)


def differentiated(
    done: Corrected, noise: Array | None = None, force: Array | None = None
) -> Problem:
    """The problem with the derivatives of its effects where its readings were corrected.

    noise: (n, 6) estimate of the noise in the readings, which is no motion; force (n, 3): the
    specific force that may excite effects, where it is not what is read.
    """
    problem, read = done.problem, done.read
    recording, nodes, ref = problem.recording, problem.nodes, problem.ref
    imu = recording.imu
    compared = bool(problem.observations) and not problem.navigated
    truth = done.raw - done.error
    if noise is not None:
        truth = truth - noise
    if force is not None:
        truth = np.hstack([truth[:, :3], force])
    quiet = np.interp(imu.t, nodes.t, problem.rate) < QUIET_RATE
    if noise is not None:
        truth = _stilled(truth, imu.t, quiet)
    signals = reading(read, truth)
    # (what is known of the angular acceleration has none of the noise that is averaged)
    short = max(1, round(AVERAGE_S[0] * recording.rate_hz))
    averaged = reading(read, _averaged(truth, short)) if compared else signals
    other = _another_reading(recording) if compared else None
    told = averaged if other is None else reading(read, other)
    right = np.clip(np.searchsorted(imu.t, nodes.t), 1, len(imu.t) - 1)
    share = (nodes.t - imu.t[right - 1]) / (imu.t[right] - imu.t[right - 1])
    parts: list[tuple[int, int, Array]] = []
    i = 0
    for e in (e for e in problem.effects if e.imu_error is not None):
        own = slice(i, i + len(e.parameters))
        i = own.stop
        whole = e.imu_inverse is not None
        felt = signals if whole else told if _of_any_shape(e) else averaged
        for channel, k, column in _slopes_of(e, ref[own], felt):
            if compared and whole:
                column = _averaged(column[:, None], short)[:, 0]
            parts.append((channel, own.start + k, column))
    parts.sort(key=lambda part: part[:2])
    at_imu = np.stack([p[2] for p in parts], axis=1) if parts else np.zeros((len(imu.t), 0))
    if noise is not None:
        at_imu = _calmed(at_imu, recording.rate_hz, quiet)
    values = np.empty((len(nodes.t), len(parts)))
    _onto_nodes(at_imu, right, share, values)
    channels, columns = (np.array([p[k] for p in parts], dtype=np.int64) for k in (0, 1))
    return replace(
        problem,
        nodes=nodes._replace(J=np.zeros((len(nodes.t), 6, 0))),
        slopes=Slopes(values, channels, columns),
    )


def _of_any_shape(effect: Effect) -> bool:
    """Whether this is a law found in a recording, or a course; of the catalogue's effects each has
    an id that is one word."""
    return effect.features is not None and not effect.id.isidentifier()


def _another_reading(recording: Recording) -> Array | None:
    """Rate and force (n, 6) by the reference, if there is one: what a law of any shape is a
    function of may not have in it the noise of the very reading that it shall explain."""
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


@njit
def _onto_nodes(x: Array, right: IntArray, share: Array, out: Array) -> None:
    """Columns (n, s) at the IMU's samples, on straight lines, at the nodes (k, s)."""
    for i in range(len(right)):
        b, u = right[i], share[i]
        for c in range(x.shape[1]):
            out[i, c] = x[b - 1, c] * (1.0 - u) + x[b, c] * u


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


def _stilled(truth: Array, t: Array, quiet: BoolArray) -> Array:
    """Rate and force (n, 6) with the mean rate of each quiet while throughout it: what the rate
    does there is the sensor's noise, which would teach a device that never turns its scale."""
    out = truth.copy()
    edges = np.flatnonzero(np.diff(np.r_[0, quiet.astype(np.int8), 0])).reshape(-1, 2)
    for a, b in edges:
        if t[b - 1] - t[a] > AVERAGE_S[1]:
            out[a:b, :3] = truth[a:b, :3].mean(axis=0)
    return out


def errors_by_bias(problem: Problem, bg: Array, ba: Array) -> Array | None:
    """How what the effects add at problem.ref depends on the biases: (n, 6, 6) at the IMU's
    samples, by [gyro bias, accel bias]; None where it does not. Not for effects that move the
    signal as a whole: a constant stays what it is.

    Beside a reference a bias may be known as a difference alone. An effect that is not linear
    then shows what it really is, and if that could not move, a scale error would stand in for it.
    """
    imu, alpha = problem.recording.imu, problem.alpha
    acting = [e for e in problem.effects if e.imu_error is not None]
    raw = np.hstack([imu.gyro - bg, imu.accel - ba])
    read = of_recording(problem.recording, acting, read=raw, alpha=alpha)
    if not problem.ref[: problem.imu_constants].any():
        return None
    truth = raw - substituted(acting, problem.ref, read)
    truth = _averaged(truth, max(1, round(AVERAGE_S[0] * problem.recording.rate_hz)))
    out, i = np.zeros((len(imu.t), 6, 6)), 0
    for e in acting:
        at = problem.ref[i : i + len(e.parameters)]
        i += len(e.parameters)
        if e.imu_error is None or e.imu_inverse is not None or not at.any():
            continue
        for k, size in enumerate(np.repeat([GYRO_BIAS_PRIOR, ACCEL_BIAS_PRIOR], 3)):
            step = np.zeros(6)
            step[k] = BIAS_STEP * size
            up, down = (e.imu_error(at, reading(read, truth + s)) for s in (step, -step))
            # (a larger bias means a smaller truth)
            out[:, :, k] -= (up - down) / (2.0 * step[k])
    return out


def _calmed(J: Array, rate: float, quiet: BoolArray) -> Array:
    """J (n, k) averaged over a short time, and over a longer one where the device rests."""
    moving, resting = (max(1, round(s * rate)) for s in AVERAGE_S)
    out = np.empty_like(J)
    _running_mean(J, moving, ~quiet, out)
    if quiet.any():
        _running_mean(J, resting, quiet, out)
    return out


def _averaged(J: Array, width: int) -> Array:
    """Moving mean of J (n, k) over ``width`` samples.

    The same sample's noise is in J and in what J shall explain; correlated like that, it
    would count as information on the parameters (a device at rest would learn its scale
    errors). What an effect adds is still computed from the readings as they are.
    """
    out = np.empty_like(J)
    _running_mean(J, width, np.ones(len(J), dtype=np.bool_), out)
    return out


@njit
def _running_mean(x: Array, width: int, wanted: BoolArray, out: Array) -> None:
    """Means over ``width`` rows of x (n, k), the first and the last repeated beyond the ends, into
    the wanted rows of ``out``."""
    n, k = x.shape
    total = np.zeros(k)
    for j in range(-(width // 2), width - width // 2):
        for c in range(k):
            total[c] += x[min(max(j, 0), n - 1), c]
    for i in range(n):
        if wanted[i]:
            for c in range(k):
                out[i, c] = total[c] / width
        old, new = max(i - width // 2, 0), min(i + width - width // 2, n - 1)
        for c in range(k):
            total[c] += x[new, c] - x[old, c]


def substituted(
    acting: Sequence[Effect], ref: Array, readings: Signals, enough: float = SUBSTITUTED
) -> Array:
    """What all effects add to these readings, (n, 6), by rounds of substitution: first what is
    done to the whole reading is undone, then the others follow from the truth.

    enough: the change in a round, as a part of the largest reading, after which there is no other.
    Effects whose parameters are zero add nothing and are left out.
    """
    raw = np.hstack([readings.gyro, readings.accel])
    scale = float(np.abs(raw).max(initial=0.0))
    present, i = [], 0
    total = np.zeros_like(raw)
    for e in acting:
        at = ref[i : i + len(e.parameters)]
        i += len(e.parameters)
        if at.any() and e.imu_inverse is not None and e.last:
            total += raw - total - e.imu_inverse(at, reading(readings, raw - total))
        elif at.any():
            present.append((e, at))
    errors = [np.zeros_like(raw) for _ in present]
    step, moved = np.empty_like(raw), math.inf
    for done in range(SUBSTITUTIONS if present else 0):
        before, moved = moved, 0.0
        for k, (e, at) in enumerate(present):
            own, old = raw - total, errors[k]
            if e.imu_inverse is not None:
                own += old
                errors[k] = own - e.imu_inverse(at, reading(readings, own))
            elif e.imu_error is not None:
                errors[k] = e.imu_error(at, reading(readings, own))
            np.subtract(errors[k], old, out=step)
            total += step
            moved = max(moved, float(step.max()), -float(step.min()))
        # (some are so large that going on would lead away)
        if moved < enough * scale or (done > 1 and not moved < SHRINKS * before):
            break
    return total


def observation_variances(problem: Problem, levels: Mapping[str, float]) -> Array:
    """R (K, MAX_DIM) of each kind at these noise levels."""
    R = np.ones((len(problem.observations), MAX_DIM))
    for k, o in enumerate(problem.observations):
        R[k, : o.dim] = o.variance(levels)
    return R


def markov_transitions(
    problem: Problem, levels: Mapping[str, float], t: Array, rate: Array
) -> tuple[Array, Array]:
    """Phi_e, Q_e (n, e, e) of the intervals that end at t (n,); the first is the identity."""
    e = problem.markov_size
    Phi = np.broadcast_to(np.eye(e), (len(t), e, e)).copy()
    Q = np.zeros((len(t), e, e))
    dt = np.diff(t, prepend=t[0])
    at = 0
    for markov in problem.markovs:
        s = slice(at, at + markov.size)
        Phi[:, s, s], Q[:, s, s] = markov.transition(levels, dt, rate)
        at += markov.size
    return Phi, Q


def noise_arrays(problem: Problem, levels: Mapping[str, float]) -> Noise:
    """Noise levels (SI) turned into what the kernel uses at every node."""
    Phi_e, Q_e = markov_transitions(problem, levels, problem.nodes.t, problem.rate)
    return Noise(
        float(levels["gyro_noise"] ** 2),
        float(levels["accel_noise"] ** 2),
        np.zeros(BASE + problem.constants),
        observation_variances(problem, levels),
        Phi_e,
        Q_e,
    )

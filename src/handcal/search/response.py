"""The one matrix of a fit: what every additive error would do to it, as a quadratic.

Linearised about a fit, an error of a sensor is a combination of columns: the constants of a named
effect, or constants of a channel in short windows of time. A step is a sum of windows; a walk is
all windows under its covariance, of which a few eigenvectors hold nearly all; a law is its means
in the windows. Trajectory and biases are integrated out. So the evidence of any set is a small
Cholesky factor, without another pass of the filter.

Noise whose memory is short against a window is no combination of windows: it stays in the filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handcal.effects import Effect, Signals
from handcal.estimate.case import applicable, name_of
from handcal.estimate.columns import Ground
from handcal.estimate.linear import motion_of
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.robust import excess
from handcal.estimate.scan import grounds, scan
from handcal.estimate.transfer import without
from handcal.laws.drivers import HEADING
from handcal.laws.law_effect import AXES_OF, SENSORS, SIZE
from handcal.laws.over_drivers import signals_of
from handcal.laws.short_windows import MOST_WINDOWS, WINDOW, constants, count_of, halves, windows_of
from handcal.laws.with_motion import channels, is_with_motion
from handcal.search.climb.candidates import candidates
from handcal.search.noise_scan import all_noise
from handcal.types import Array, IntArray

# Nats of evidence of what changes within a window that may be lost; windows that are looked at for
# that.
LOST, LOOKED = 3.0, 40
# Eigenvectors of a process's covariance at the most, and the share of the largest variance below
# which one is left out.
MODES, LEAST = 60, 1e-5
# Steps that are sums of windows, and of which sensor they are.
STEPS = {"gyro_bias_step": 0}


@dataclass(frozen=True, eq=False)
class Windows:
    """Short windows of time: their middles t (n,), s after the first sample, the mean rate of
    turning in each (n,), rad/s, and the places (n,) of their constants in the quadratic, by sensor
    and axis, in units of the sensor's ``SIZE``. told: by sensor, what a window tells of a change
    of sign within it on each axis (a,), in these units."""

    t: Array
    rate: Array
    at: Mapping[tuple[int, int], IntArray]
    told: Mapping[int, Array]

    @property
    def width(self) -> float:
        """How long one is, s."""
        return 2.0 * float(self.t[0])

    @property
    def sensors(self) -> frozenset[int]:
        return frozenset(sensor for sensor, _ in self.at)

    def of(self, sensor: int) -> IntArray:
        """Places of all windows of a sensor, one axis after the other."""
        return np.concatenate([self.at[sensor, axis] for axis in AXES_OF[sensor]])


@dataclass(frozen=True, eq=False)
class Response:
    """What additive errors would do to a fit. quadratic: of the constants of effects and windows,
    at its worth; effects: those with a name; noise: processes on trial that windows can hold;
    levels: of those that the model has; filtered: noise of the model that is in the filter;
    motion: signals as they excite an error, without the sway of a hand."""

    quadratic: Quadratic
    effects: tuple[Effect, ...]
    noise: tuple[Effect, ...]
    levels: Mapping[str, Mapping[str, float]]
    filtered: tuple[Effect, ...]
    windows: Windows
    motion: Signals

    @cached_property
    def named(self) -> IntArray:
        """Places of the constants of effects with a name."""
        own = {e.id for e in self.effects}
        return np.flatnonzero([owner in own for owner, _ in self.quadratic.names])


@dataclass(frozen=True, eq=False)
class Columns:
    """An effect as combinations F (n, r) of the windows of some channels, whose places are ``at``:
    r columns for each channel, one channel's after the other's, in units of their priors. levels:
    of noise. b (m,) and named (m, k): its part of the quadratic, and products with the constants of
    effects."""

    effect: Effect
    at: tuple[IntArray, ...]
    F: Array
    levels: Mapping[str, float]
    b: Array
    named: Array


def response(model: Model, worth: float | None = None) -> Response:
    """The one matrix of a fit to one recording. worth: what evidence counts for, if that is known.

    Raises ValueError for a fit to several recordings.
    """
    if len(model.parts) != 1:
        raise ValueError("The matrix is of one recording: fit each recording alone.")
    (part,) = model.parts
    signals = signals_of(part)
    about = grounds(model)
    worth = 1.0 / excess(about[0].done, frozenset(model.ids)) if worth is None else worth
    named = _named(model, candidates(model.parts, model.effects, about[0].done))
    windows, constant = _windows(signals, part.case.kinds)
    on_windows = [e for e in model.effects if e.process and sensor_of(e) in windows.sensors]
    every = {e.id: {lv.name: part.levels[lv.name] for lv in e.levels} for e in on_windows}
    if every:
        model = without(full := model, every)
        about = grounds(model)
    windows = replace(windows, told=_told(model, about, windows))
    levels = {e.id: every[e.id] for e in on_windows if held(e, every[e.id], windows)}
    if len(levels) < len(every):
        model = without(full, levels)
        about = grounds(model)
    q = scan(model, [*named, *constant], about, 1.0)
    owners = np.array([owner for owner, _ in q.names])
    at = {key: np.flatnonzero(owners == e.id) for key, e in zip(windows.at, constant, strict=True)}
    shown = [e for e in all_noise() if applicable(part.case, e)]
    return Response(
        Quadratic(q.names, q.a, worth * q.b, worth * q.G, worth),
        tuple(named),
        tuple(e for e in shown if sensor_of(e) in windows.sensors),
        levels,
        tuple(e for e in model.effects if e.process is not None),
        replace(windows, at=at),
        motion_of(about[0].excited),
    )


def _named(model: Model, on_trial: Sequence[Effect]) -> list[Effect]:
    """The model's effects and those on trial, but for steps of which windows hold every moment."""
    own = {e.id: e for e in model.effects if e.process is None}
    have = {name_of(i) for i in own}
    new = [e for e in on_trial if name_of(e.id) not in STEPS or name_of(e.id) in have]
    return [*own.values(), *(e for e in new if e.id not in own)]


def _windows(signals: Signals, kinds: Sequence[str]) -> tuple[Windows, list[Effect]]:
    """The windows of a recording, and an effect for each channel; their places are not known
    yet."""
    t = signals.t
    width = max(WINDOW, float(t[-1] - t[0]) / MOST_WINDOWS)
    n = count_of(t, width)
    window = windows_of(t, t, width)
    turned = np.bincount(window, np.linalg.norm(signals.gyro, axis=1), n)
    rate: Array = np.asarray(turned / np.maximum(np.bincount(window, minlength=n), 1))
    sensors = [k for k, name in enumerate(SENSORS) if k != HEADING or name in kinds]
    keys = [(k, axis) for k in sensors for axis in AXES_OF[k]]
    nowhere = np.zeros(0, dtype=np.int64)
    middles: Array = np.asarray((np.arange(n) + 0.5) * width)
    windows = Windows(middles, rate, dict.fromkeys(keys, nowhere), {})
    return windows, [constants(k, axis, n, width) for k, axis in keys]


def _told(model: Model, about: Sequence[Ground], windows: Windows) -> dict[int, Array]:
    """See ``Windows``: by a scan of some windows."""
    n = len(windows.t)
    some = np.unique(np.linspace(0, n - 1, min(n, LOOKED)).astype(np.int64))
    looked = [halves(k, axis, some, windows.width) for k, axis in windows.at]
    q = scan(model, looked, about, 1.0)
    told: dict[int, list[float]] = {}
    for (sensor, _), e in zip(windows.at, looked, strict=True):
        own = [i for i, (owner, _) in enumerate(q.names) if owner == e.id]
        told.setdefault(sensor, []).append(float(np.mean(np.diag(q.G)[own])))
    return {sensor: np.array(values) for sensor, values in told.items()}


def sensor_of(e: Effect) -> int:
    """The sensor to whose readings noise adds; -1 for others (a pose)."""
    if e.walks:
        return SENSORS.index(e.walks)
    return HEADING if SENSORS[HEADING] in e.observation_error else -1


def covariance(e: Effect, levels: Mapping[str, float], windows: Windows) -> Array:
    """Covariance (n, n) of one axis of a noise process at the middles of windows, SI."""
    assert e.process is not None
    dt = np.diff(windows.t, prepend=0.0)
    Phi, Q = e.process.transition(levels, dt, windows.rate)
    axis = int(np.argmax(np.diagonal(Q, axis1=1, axis2=2).sum(axis=0)))
    phi, q = Phi[:, axis, axis], Q[:, axis, axis]
    P = np.empty(len(q))
    last = e.process.start(levels, float(windows.rate[0]))[axis, axis]
    for k in range(len(q)):
        last = phi[k] ** 2 * last + q[k]
        P[k] = last
    way = np.cumsum(np.log(np.maximum(phi, 1e-300)))
    i, j = np.triu_indices(len(q))
    K = np.zeros((len(q), len(q)))
    K[i, j] = P[i] * np.exp(way[j] - way[i])
    K[j, i] = K[i, j]
    return K


def held(e: Effect, levels: Mapping[str, float], windows: Windows) -> bool:
    """Whether windows can hold a noise process: what changes within them is lost among the
    readings, or in what is integrated of them."""
    K, sensor = covariance(e, levels, windows), sensor_of(e)
    # (of a walk, a sixth of what it gains from window to window)
    change = np.diag(K)[1:] + np.diag(K)[:-1] - 2.0 * np.diag(K, 1)
    told = windows.told[sensor][list(axes_of(e))] / 6.0 / SIZE[sensor] ** 2
    return 0.5 * float(np.log1p(np.outer(change, told)).sum()) < LOST


def modes(e: Effect, levels: Mapping[str, float], windows: Windows) -> Array:
    """Columns (n, r) that a noise process is on each axis, in units of the windows' constants."""
    K = covariance(e, levels, windows) / SIZE[sensor_of(e)] ** 2
    variance, vectors = np.linalg.eigh(K)
    keep = variance > LEAST * variance[-1]
    keep[:-MODES] = False
    return np.asarray(vectors[:, keep] * np.sqrt(variance[keep]))


def axes_of(e: Effect) -> tuple[int, ...]:
    """The axes of its sensor to which noise adds."""
    sensor = sensor_of(e)
    if sensor == HEADING or not is_with_motion(e.id):
        return AXES_OF[sensor]
    return tuple("xyz".index(c[-1]) for c in channels(e))


def noise_columns(r: Response, e: Effect, levels: Mapping[str, float]) -> Columns:
    """A noise process at certain levels as columns."""
    at = tuple(r.windows.at[sensor_of(e), axis] for axis in axes_of(e))
    return columns(r, e, at, modes(e, levels, r.windows), levels)


def step_columns(r: Response, e: Effect, edge: int) -> Columns:
    """A step from a window on, on each axis of its sensor."""
    sensor = STEPS[name_of(e.id)]
    F = (np.arange(len(r.windows.t)) >= edge) * (e.prior_sigma[0] / SIZE[sensor])
    at = tuple(r.windows.at[sensor, axis] for axis in AXES_OF[sensor])
    return columns(r, e, at, F[:, None], {})


def columns(
    r: Response, e: Effect, at: tuple[IntArray, ...], F: Array, levels: Mapping[str, float]
) -> Columns:
    """The combinations F (n, r) of the windows at these places (n,) each, with their products."""
    q = r.quadratic
    b = np.concatenate([F.T @ q.b[i] for i in at])
    named = np.vstack([F.T @ q.G[np.ix_(i, r.named)] for i in at])
    return Columns(e, at, F, levels, b, named)


def products(r: Response, x: Columns, y: Columns) -> Array:
    """Their part (m, m') of the matrix."""
    G = r.quadratic.G
    return np.block([[x.F.T @ G[np.ix_(i, j)] @ y.F for j in y.at] for i in x.at])

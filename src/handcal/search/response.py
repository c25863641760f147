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
from scipy.linalg import block_diag

from handcal.effects import Effect, Signals
from handcal.estimate.case import applicable, name_of
from handcal.estimate.columns import Ground, Wider
from handcal.estimate.linear import motion_of
from handcal.estimate.model import Fitted, Model
from handcal.estimate.quadratic import Quadratic, total
from handcal.estimate.robust import excess
from handcal.estimate.scan import grounds, scan, with_new
from handcal.estimate.transfer import without
from handcal.laws import shapes, short_windows, terms
from handcal.laws.drivers import HEADING
from handcal.laws.law_effect import AXES_OF, SENSORS, SIZE
from handcal.laws.short_windows import halves, looked_at, windows_about
from handcal.laws.with_motion import channels, is_with_motion
from handcal.search.candidates import candidates
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
# Levels of a noise process, one mapping a recording.
Levels = Sequence[Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Windows:
    """Short windows of all recordings, one recording's after the other's.

    each: of each recording; motion: its signals as they excite an error, without the sway of a
    hand. at: places (N,) of the windows' constants in the quadratic, by sensor and axis, in units
    of the sensor's ``SIZE``. told: by sensor, the information of a change of sign within a window
    on each axis (a,), in these units.
    """

    each: Sequence[short_windows.Windows]
    motion: Sequence[Signals]
    at: Mapping[tuple[int, int], IntArray]
    told: Mapping[int, Array]

    @property
    def sensors(self) -> frozenset[int]:
        return frozenset(sensor for sensor, _ in self.at)

    @property
    def key(self) -> tuple[bytes, ...]:
        """The same for windows of the same times."""
        return tuple(w.edges.tobytes() for w in self.each)

    @cached_property
    def seldom(self) -> Sequence[tuple[Signals, IntArray]]:
        """Of each recording its signals no oftener than ``RATE``, and the window of each sample."""
        out = []
        for w, signals in zip(self.each, self.motion, strict=True):
            fewer = short_windows.seldom(signals)
            out.append((fewer, w.of(fewer.t)))
        return out

    @cached_property
    def courses(self) -> Sequence[tuple[Array, Array]]:
        """Of each recording the windows' middles, s, and mean rates of turning, rad/s."""
        out = []
        for w, signals in zip(self.each, self.motion, strict=True):
            of, n = w.of(signals.t), w.count
            turned = np.bincount(of, np.linalg.norm(signals.gyro, axis=1), n)
            rate = turned / np.maximum(np.bincount(of, minlength=n), 1)
            out.append((0.5 * (w.edges[:-1] + w.edges[1:]) - w.edges[0], np.asarray(rate)))
        return out

    def of(self, sensor: int) -> IntArray:
        """Places of all windows of a sensor, one axis after the other."""
        return np.concatenate([self.at[sensor, axis] for axis in AXES_OF[sensor]])


@dataclass(frozen=True, eq=False)
class Response:
    """What additive errors would do to a fit.

    model: of the fit, without noise that the windows hold. quadratic: of the constants of effects
    and windows, at the full likelihood. worth: power of the likelihood. effects: those with a name.
    noise: processes on trial on these sensors; levels: of those that the model has and windows
    hold; filtered: noise of the model that is in the filter. heading: terms and curves of a heading
    on trial, under ids of their own, with their forms; bases: of its courses.
    """

    model: Model
    quadratic: Quadratic
    worth: float
    effects: tuple[Effect, ...]
    noise: tuple[Effect, ...]
    levels: Mapping[str, Levels]
    filtered: tuple[Effect, ...]
    windows: Windows
    heading: Mapping[str, Sequence[Effect]]
    bases: Sequence[shapes.Basis]

    @cached_property
    def named(self) -> IntArray:
        """Places of the constants of effects with a name."""
        own = {e.id for e in self.effects}
        return np.flatnonzero([owner in own for owner, _ in self.quadratic.names])


@dataclass(frozen=True, eq=False)
class Columns:
    """An effect as combinations F (n, r) of the windows of some channels, whose places are ``at``:
    r columns for each channel, one channel's after the other's, in units of their priors. levels:
    of noise. b (m,) and along (m, k): its part of the quadratic, and products with all constants
    of the matrix."""

    effect: Effect
    at: tuple[IntArray, ...]
    F: Array
    levels: Levels
    b: Array
    along: Array


def response(model: Model, worth: float | None = None) -> Response:
    """The one matrix of a fit to one or several recordings. worth: power of the likelihood, if it
    is known."""
    about = grounds(model)
    named = _named(model, candidates(model.parts, model.effects, about[0].done))
    noise = [e for e in model.effects if e.process and sensor_of(e) in _sensors(model)]
    every = {
        e.id: [{lv.name: f.levels[lv.name] for lv in e.levels} for f in model.parts] for e in noise
    }
    # (beside what noise explains: without it, that would look like misfit)
    if worth is None:
        worth = min(_worth(f, g, model, named) for f, g in zip(model.parts, about, strict=True))
    if every:
        model = without(full := model, every)
        about = grounds(model)
    windows = _windows(model, about)
    windows = replace(windows, told=_told(model, about, windows))
    levels = {e.id: every[e.id] for e in noise if held(e, every[e.id], windows)}
    if len(levels) < len(every):
        # (epochs may be others beside noise)
        model = without(full, levels)
        about = grounds(model)
        windows = replace(_windows(model, about), told=windows.told)
    heading = _heading(model) if HEADING in windows.sensors else {}
    on_heading = [replace(some[0], id=i) for i, some in heading.items()]
    duration = model.parts[0].case.recording.duration_s
    bases = shapes.heading_bases(duration) if HEADING in windows.sensors else []
    on_heading += [b.effect for b in bases]
    q = _seen(model, [*named, *on_heading], about, windows)
    shown = [e for e in all_noise() if any(applicable(f.case, e) for f in model.parts)]
    return Response(
        model,
        q,
        worth,
        tuple(named),
        tuple(e for e in shown if sensor_of(e) in windows.sensors),
        levels,
        tuple(e for e in model.effects if e.process is not None),
        replace(windows, at=_places(q, windows)),
        heading,
        bases,
    )


def _places(q: Quadratic, windows: Windows) -> dict[tuple[int, int], IntArray]:
    """Places of the windows' constants, by sensor and axis."""
    place = {(owner, name): i for i, (owner, name) in enumerate(q.names)}
    return {
        (sensor, axis): np.array(
            [
                place[f"windows: {sensor} {axis} of {part}", f"w{n}"]
                for part, w in enumerate(windows.each)
                for n in range(w.count)
            ]
        )
        for sensor, axis in windows.at
    }


def _sensors(model: Model) -> list[int]:
    """Sensors of which the recordings have readings."""
    kinds = {kind for f in model.parts for kind in f.case.kinds}
    return [k for k, name in enumerate(SENSORS) if k != HEADING or name in kinds]


def _windows(model: Model, about: Sequence[Ground]) -> Windows:
    """The windows of all recordings; their places in the matrix are not known yet."""
    nowhere = np.zeros(0, dtype=np.int64)
    at = {(k, axis): nowhere for k in _sensors(model) for axis in AXES_OF[k]}
    motion = [motion_of(own.excited) for own in about]
    return Windows([windows_about(own) for own in about], motion, at, {})


def _heading(model: Model) -> dict[str, Sequence[Effect]]:
    """Terms and curves of a heading that the model lacks, each as all its forms."""
    recording, have = model.parts[0].case.recording, {e.id for e in model.effects}
    options = [[e] for e in terms.heading_terms(recording)] + terms.heading_curves()
    some = [o for o in options if o[0].id not in have]
    return {f"basis: heading {n}": o for n, o in enumerate(some)}


def _worth(f: Fitted, about: Ground, model: Model, named: Sequence[Effect]) -> float:
    """Power of the likelihood of one recording, by the scatter of the scores of all these."""
    return 1.0 / excess(_wide(f, about, model, named), frozenset(model.ids))


def _wide(f: Fitted, about: Ground, model: Model, named: Sequence[Effect]) -> Wider:
    """The pass over one recording with those of these effects that its model lacks."""
    return with_new(f, about, [e for e in named if e.id not in model.ids])


def _seen(
    model: Model, named: Sequence[Effect], about: Sequence[Ground], windows: Windows
) -> Quadratic:
    """The quadratic of these effects and of all windows, at the full likelihood."""
    ids = frozenset(e.id for e in named)
    parts = []
    for n, (f, base, w) in enumerate(zip(model.parts, about, windows.each, strict=True)):
        q = looked_at(ids, base, w, sorted(windows.sensors), _wide(f, base, model, named))
        names = tuple(
            (f"{owner} of {n}" if owner.startswith("windows: ") else owner, name)
            for owner, name in q.names
        )
        parts.append(replace(q, names=names))
    return total(parts)


def _named(model: Model, on_trial: Sequence[Effect]) -> list[Effect]:
    """The model's effects and those on trial, but for steps of which windows hold every moment."""
    own = {e.id: e for e in model.effects if e.process is None}
    have = {name_of(i) for i in own}
    new = [e for e in on_trial if name_of(e.id) not in STEPS or name_of(e.id) in have]
    return [*own.values(), *(e for e in new if e.id not in own)]


def _told(model: Model, about: Sequence[Ground], windows: Windows) -> dict[int, Array]:
    """See ``Windows``: by a scan of some windows of the first recording."""
    first, n = replace(model, parts=model.parts[:1]), windows.each[0].count
    some = np.unique(np.linspace(0, n - 1, min(n, LOOKED)).astype(np.int64))
    looked = [halves(k, axis, some, windows.each[0]) for k, axis in windows.at]
    q = scan(first, looked, about[:1], 1.0)
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


def covariance(e: Effect, levels: Mapping[str, float], t: Array, rate: Array) -> Array:
    """Covariance (n, n) of one axis of a noise process, SI, at times t (n,), s, at which the device
    turns at these rates (n,), rad/s."""
    assert e.process is not None
    dt = np.diff(t, prepend=0.0)
    Phi, Q = e.process.transition(levels, dt, rate)
    axis = int(np.argmax(np.diagonal(Q, axis1=1, axis2=2).sum(axis=0)))
    phi, q = Phi[:, axis, axis], Q[:, axis, axis]
    P = np.empty(len(q))
    last = e.process.start(levels, float(rate[0]))[axis, axis]
    for k in range(len(q)):
        last = phi[k] ** 2 * last + q[k]
        P[k] = last
    way = np.cumsum(np.log(np.maximum(phi, 1e-300)))
    i, j = np.triu_indices(len(q))
    K = np.zeros((len(q), len(q)))
    K[i, j] = P[i] * np.exp(way[j] - way[i])
    K[j, i] = K[i, j]
    return K


def held(e: Effect, levels: Levels, windows: Windows) -> bool:
    """Whether windows can hold a noise process: what changes within them is lost among the
    readings, or in what is integrated of them."""
    K, sensor = covariance(e, levels[0], *windows.courses[0]), sensor_of(e)
    # (of a walk, a sixth of what it gains from window to window)
    change = np.diag(K)[1:] + np.diag(K)[:-1] - 2.0 * np.diag(K, 1)
    told = windows.told[sensor][list(axes_of(e))] / 6.0 / SIZE[sensor] ** 2
    return 0.5 * float(np.log1p(np.outer(change, told)).sum()) < LOST


def modes(e: Effect, levels: Levels, windows: Windows) -> Array:
    """Columns (n, r) that a noise process is on each axis, in units of the windows' constants."""
    out = []
    for own, course in zip(levels, windows.courses, strict=True):
        variance, vectors = np.linalg.eigh(covariance(e, own, *course) / SIZE[sensor_of(e)] ** 2)
        keep = variance > LEAST * variance[-1]
        keep[:-MODES] = False
        out.append(vectors[:, keep] * np.sqrt(variance[keep]))
    return np.asarray(block_diag(*out))


def axes_of(e: Effect) -> tuple[int, ...]:
    """The axes of its sensor to which noise adds."""
    sensor = sensor_of(e)
    if sensor == HEADING or not is_with_motion(e.id):
        return AXES_OF[sensor]
    return tuple("xyz".index(c[-1]) for c in channels(e))


def noise_columns(r: Response, e: Effect, levels: Levels) -> Columns:
    """A noise process at certain levels as columns."""
    at = tuple(r.windows.at[sensor_of(e), axis] for axis in axes_of(e))
    return columns(r, e, at, modes(e, levels, r.windows), levels)


def step_columns(r: Response, e: Effect, edge: int) -> Columns:
    """A step from a window on, on each axis of its sensor."""
    sensor = STEPS[name_of(e.id)]
    n = len(r.windows.at[sensor, 0])
    F = (np.arange(n) >= edge) * (e.prior_sigma[0] / SIZE[sensor])
    at = tuple(r.windows.at[sensor, axis] for axis in AXES_OF[sensor])
    return columns(r, e, at, F[:, None], ())


def columns(r: Response, e: Effect, at: tuple[IntArray, ...], F: Array, levels: Levels) -> Columns:
    """The combinations F (n, r) of the windows at these places (n,) each, with their products."""
    q = r.quadratic
    b = np.concatenate([F.T @ q.b[i] for i in at])
    return Columns(e, at, F, levels, b, np.vstack([F.T @ q.G[i] for i in at]))


def products(along: Array, other: Columns) -> Array:
    """Of columns that have these products (m, k) with all constants, those with others (m, m')."""
    return np.hstack([along[:, j] @ other.F for j in other.at])

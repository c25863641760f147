"""Adds sensor errors to a recording, real ones too, so that there is a truth to be found.

Nothing here goes through the estimator's linearised model: what an effect adds is its own physics
(``effects``), delays shift stamps, noise is drawn, and an effect may bring a way of its own: lever
arms move the marker or swing the accelerometer, filters filter. What an error depends on, the true
rate and force, is known as well as the recording tells: its readings, less the biases of a
calibration where they would count as motion, or readings that were corrected by one who knows more
of the device. Of attitude and magnetic north the same calibration tells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from handcal.compiled import so3
from handcal.effects import (
    ATTITUDE,
    TIME,
    WARMTH,
    Z_DIM,
    Effect,
    Signals,
    catalogue,
    known_effect,
    observed_error,
    seen_columns,
)
from handcal.effects._field import NORTH, UP
from handcal.effects._stamps import shifted
from handcal.estimate.calibration import calibrate
from handcal.observations import Observation, magnetometer
from handcal.observations import catalogue as observations
from handcal.recordings.streams import STREAMS, Stream
from handcal.signals import of_recording, probe, reading, warmth_at
from handcal.types import Array, Imu, InputError, Recording, Result, Series

Values = Mapping[str, Array]


def conceal(
    recording: Recording,
    effects: Mapping[str, Sequence[float]],
    rng: np.random.Generator,
    truth: Imu | None = None,
) -> Recording:
    """The recording as a device with these further errors would have made it.

    effects: by id, values in the order of the catalogue's parameters, SI. They come on top
    of whatever the device has of its own. truth: the same readings without the errors that are
    known of the device (``apply``), if something is; a scale error of 1 % would make what is
    added wrong by as much. Readings that are no measurements (saturated) stay
    as they are. Raises InputError for unknown effects, wrong values and streams that are
    absent, HandcalError where the attitude is needed and cannot be found.
    """
    values = {i: _checked(i, v) for i, v in effects.items()}
    acting = [catalogue()[i] for i in values]
    _check_streams(recording, acting)
    known = Truth(recording, tuple(acting), truth)
    out = recording
    for e in acting:
        if e.world and e.conceal is not None:
            out = e.conceal(values[e.id], out, known)
    out = _observed(out, values, known, rng)
    out = replace(out, imu=_imu(out, values, known, rng))
    for e in acting:
        if e.conceal is not None and not e.world and e.imu_inverse is None:
            out = e.conceal(values[e.id], out, known)
    return out


def parse(text: str) -> tuple[str, tuple[float, ...]]:
    """``ID=v,v,...`` as id and values. Raises InputError, which says what is expected."""
    name, equals, numbers = text.partition("=")
    name = name.strip()
    try:
        values = tuple(float(v) for v in numbers.split(","))
    except ValueError:
        values = ()
    if not equals or not values:
        raise InputError(f"--effect {text}: expected {expected(name)}.")
    _checked(name, values)
    return name, values


def expected(name: str) -> str:
    """How the effect is written, with its units. Raises InputError if there is none such."""
    parameters = known_effect(name).parameters
    units = [p.unit for p in parameters]
    of = ", ".join(units[:1] if len(set(units)) == 1 else units)
    unit = "without unit" if of == "1" else f"in {of}"
    return f"{name}={','.join(p.name for p in parameters)} {unit}"


def _checked(name: str, values: Sequence[float]) -> Array:
    """Values that the effect can have. Errors: InputError."""
    says = expected(name)
    effect = catalogue()[name]
    if len(values) != len(effect.parameters):
        raise InputError(
            f"{name} takes {len(effect.parameters)} values, not {len(values)}: {says}."
        )
    if not all(math.isfinite(v) for v in values):
        raise InputError(f"{name} takes finite numbers: {says}.")
    for p, v in zip(effect.parameters, values, strict=True):
        # (a level of noise has a logarithm)
        if p.positive and (v < 0.0 or (v == 0.0 and effect.levels)):
            raise InputError(f"{name}: {p.name} must be above 0.")
        if abs(v) > p.most and p.positive:
            raise InputError(f"{name}: {p.name} must not exceed {p.most:g}.")
        if abs(v) > p.most:
            raise InputError(f"{name}: {p.name} must lie within {p.most:.0f} either way.")
    return np.array(values, dtype=np.float64)


def streams_of(effect: Effect) -> tuple[str, ...]:
    """The streams on which an effect acts, by the observations of them."""
    kinds = {*effect.acts_on, *effect.outliers}
    return tuple(s.name for s in STREAMS.values() if s.observation in kinds)


def _check_streams(recording: Recording, effects: Sequence[Effect]) -> None:
    """Errors: InputError for a stream that an effect acts on or depends on, and is absent."""
    have = ", ".join(recording.streams) or "none"
    for e in effects:
        wanted: list[tuple[str, ...]] = [(need,) for need in e.needs if need in STREAMS]
        if e.imu_error is None and not e.walks and not e.world:
            wanted.append(streams_of(e))
        for some in wanted:
            if not set(some) & set(recording.streams):
                also = f"; see {e.instead}" if e.instead else ""
                stream = " or ".join(some)
                raise InputError(
                    f"{e.id} needs a stream {stream}; {recording.path} has: {have}{also}."
                )


@dataclass(frozen=True)
class Truth:
    """What is known of the truth in a recording; a calibration is made when first asked for.

    effects: those that are to be added; truth: readings less what is known of their errors.
    """

    recording: Recording
    effects: tuple[Effect, ...]
    truth: Imu | None = None
    results: dict[tuple[str, ...], Result] = field(default_factory=dict)

    def result(self, beside: tuple[str, ...] = ()) -> Result:
        """Of the recording as it is, with these effects."""
        if beside not in self.results:
            self.results[beside] = calibrate(self.recording, beside, only=True)
        return self.results[beside]

    def attitude(self, t: Array, beside: tuple[str, ...] = ()) -> Array:
        """C_nb (n, 3, 3) at times t (n,), turning at a constant rate between two known ones."""
        history = self.result(beside).smoothed
        assert history is not None
        return so3.between(history.t, so3.matrix_of(history.q_nb), t)

    def _constant(self, effect: str) -> Array:
        """Estimated x y z (3,) of an effect."""
        return np.array([self.result().parameter(effect, a).value for a in "xyz"])

    @cached_property
    def signals(self) -> Signals:
        """Rate and force as known, or as read, less their biases if that matters."""
        if any(minds_bias(e) for e in self.effects if e.conceal is None):
            return self.unbiased
        return self._signals(self.truth or self.recording.imu)

    @cached_property
    def unbiased(self) -> Signals:
        """Rate and force as known, or as read, less their biases."""
        if self.truth is not None:
            return self._signals(self.truth)
        imu = self.recording.imu
        gyro, accel = self._constant("gyro_bias"), self._constant("accel_bias")
        return self._signals(replace(imu, gyro=imu.gyro - gyro, accel=imu.accel - accel))

    def _signals(self, imu: Imu) -> Signals:
        needed = any(ATTITUDE in e.needs for e in self.effects if e.conceal is None)
        C_nb = self.attitude(imu.t) if needed else None
        read = np.hstack([imu.gyro, imu.accel])
        return of_recording(self.recording, self.effects, read=read, C_nb=C_nb)

    def nav(self, t: Array) -> Array:
        """Position, velocity, attitude, rate and force (m, 21) at times t (m,)."""
        history, imu = self.result().smoothed, self.recording.imu
        assert history is not None
        bias = np.r_[self._constant("gyro_bias"), self._constant("accel_bias")]
        read = np.hstack([imu.gyro, imu.accel]) - bias
        moved = [(history.t, history.p_n), (history.t, history.v_n), (imu.t, read)]
        p, v, felt = (
            np.stack([np.interp(t, own, column) for column in x.T], axis=1) for own, x in moved
        )
        return np.hstack([p, v, self.attitude(t).reshape(-1, 9), felt])


def minds_bias(effect: Effect) -> bool:
    """Whether a bias, taken for motion, would change what an effect adds to the readings by more
    than a bias: it would change an error that is not proportional to rate and force."""
    if effect.imu_error is None or effect.imu_inverse is not None:
        return False
    signals = probe()
    more = reading(signals, np.hstack([signals.gyro, signals.accel]) + 0.1)
    with_bias, without = (effect.imu_error(effect.prior_sigma, s) for s in (more, signals))
    change = np.ptp(with_bias - without, axis=0).max()
    return bool(change > 1e-9 * np.abs(without).max())


# --- the IMU ------------------------------------------------------------------------------------


def _imu(recording: Recording, values: Values, known: Truth, rng: np.random.Generator) -> Imu:
    """First what there is to be measured changes, then how it is measured, then what was made of
    it on the way out of the sensor. Readings that are no measurements stay."""
    imu, old = recording.imu, known.recording.imu
    moved = np.hstack([imu.gyro - old.gyro, imu.accel - old.accel])
    before = truth = known.signals
    if moved.any():
        truth = _added(truth, moved)
    own = [e for e in known.effects if e.imu_error is not None and e.conceal is None]
    for e in own:
        if e.world:
            truth = _added(truth, _error(e, values, truth))
    read = truth
    for e in own:
        if not e.world and e.imu_inverse is None:
            read = _added(read, _error(e, values, truth))
    gyro, accel = old.gyro + (read.gyro - before.gyro), old.accel + (read.accel - before.accel)
    out = replace(recording, imu=replace(imu, gyro=gyro, accel=accel))
    for e in known.effects:
        if e.walks:
            out = replace(out, imu=_walked(out.imu, e, values[e.id], rng))
    there = replace(known, truth=replace(imu, gyro=truth.gyro, accel=truth.accel))
    for e in known.effects:
        if e.imu_inverse is not None and e.conceal is not None:
            out = e.conceal(values[e.id], out, there)
    valid = imu.valid
    for e in known.effects:
        if e.imu_inverse is not None and e.conceal is None:
            now = reading(truth, np.hstack([out.imu.gyro, out.imu.accel]))
            error = _error(e, values, now)
            valid = valid if e.sound is None else e.sound(values[e.id], imu.t, valid)
            gyro, accel = out.imu.gyro + error[:, :3], out.imu.accel + error[:, 3:]
            out = replace(out, imu=replace(imu, gyro=gyro, accel=accel))
    kept = imu.valid[:, None]
    gyro = np.where(kept, out.imu.gyro, old.gyro)
    return Imu(imu.t, gyro, np.where(kept, out.imu.accel, old.accel), valid)


def _error(effect: Effect, values: Values, truth: Signals) -> Array:
    assert effect.imu_error is not None
    return effect.imu_error(values[effect.id], truth)


def _added(signals: Signals, error: Array) -> Signals:
    return replace(signals, gyro=signals.gyro + error[:, :3], accel=signals.accel + error[:, 3:])


def _walked(imu: Imu, effect: Effect, values: Array, rng: np.random.Generator) -> Imu:
    rate = np.linalg.norm(imu.gyro, axis=1)
    read = getattr(imu, effect.walks) + _drawn(effect, values, imu.t, rate, rng)
    return replace(imu, **{effect.walks: read})


def _drawn(effect: Effect, values: Array, t: Array, rate: Array, rng: np.random.Generator) -> Array:
    """A course (n, size) of an effect's states at times t (n,), turning at rate (n,) rad/s."""
    process = effect.process
    assert process is not None
    levels = {
        f"{effect.id}_{p.name}": float(v) for p, v in zip(effect.parameters, values, strict=True)
    }
    Phi, Q = process.transition(levels, np.diff(t, prepend=t[0]), rate)
    root = np.concatenate([_root(process.start(levels, float(rate[0])))[None], _root(Q[1:])])
    fresh = rng.standard_normal((len(t), process.size))
    out: Array = np.einsum("nij,nj->ni", root, fresh)
    for k in range(1, len(t)):
        out[k] += Phi[k] @ out[k - 1]
    return out


def _root(P: Array) -> Array:
    """Square roots of covariances (..., k, k), which may be singular."""
    size, axes = np.linalg.eigh(P)
    return np.asarray(axes * np.sqrt(np.maximum(size, 0.0))[..., None, :])


# --- the other streams --------------------------------------------------------------------------


def observed(
    recording: Recording, effects: Sequence[Effect]
) -> list[tuple[str, Stream, list[Effect]]]:
    """Kinds of observation on which effects act here, their streams, and those effects.

    Where there is a heading, what acts on headings does not act on a magnetometer.
    """
    out = []
    for row in STREAMS.values():
        if not row.observation or row.name not in recording.streams:
            continue
        kind = observations()[row.observation]
        mine = [e for e in effects if kind.kind in (*e.acts_on, *e.outliers)]
        mine = [e for e in mine if e.conceal is None]
        if kind.kind == "magnetometer" and "heading" in recording.streams:
            mine = [e for e in mine if "heading" not in (*e.acts_on, *e.outliers)]
        if mine:
            out.append((kind.kind, row, mine))
    return out


def _observed(
    recording: Recording, values: Values, known: Truth, rng: np.random.Generator
) -> Recording:
    """The recording with the errors of its observations, and then their delays."""
    streams = dict(recording.streams)
    for name, row, effects in observed(recording, known.effects):
        kind, series = observations()[name], streams[row.name]
        late = sum(float(values[e.id][0]) for e in effects if name in e.delays)
        adding = [e for e in effects if name not in e.delays]
        if adding:
            if kind.moved is None:
                raise InputError(f"{adding[0].id} cannot be concealed in {row.topic}.")
            shift = _shift(kind, row, series, adding, values, late, known, rng)
            C_nb = known.attitude(series.t)
            series = kind.moved(known.recording, series, C_nb, shift)
        streams[row.name] = shifted(series, late, recording.imu) if late else series
    return replace(recording, streams=streams)


def _shift(
    kind: Observation, row: Stream, series: Series, effects: Sequence[Effect], values: Values,
    late: float, known: Truth, rng: np.random.Generator,
) -> Array:  # fmt: skip
    """By how much readings (m, dim) err, of times t and read ``late`` seconds after."""
    t, nav = series.t, known.nav(series.t)
    z = np.zeros((len(t), Z_DIM))
    z[:, : series.value.shape[1]] = series.value
    if row.posed:
        C_nb = nav[:, 6:15].reshape(-1, 3, 3)
        z[:, :7] = np.hstack([nav[:, :3], so3.quaternion_of(C_nb)])
    if row.observation == "magnetometer":
        z[:, [NORTH, UP]] = magnetometer.strengths(known.recording)
    z[:, TIME] = t + late - known.recording.imu.t[0]
    z[:, WARMTH] = warmth_at(known.recording, t + late)
    out = np.zeros((len(t), kind.dim))
    rate = np.linalg.norm(nav[:, 15:18], axis=1)
    for e in effects:
        if e.process is not None:
            states = _drawn(e, values[e.id], t, rate, rng)
            out += observed_error(e, kind.kind, states, nav, z, kind.dim)
        elif kind.kind in e.observation_error:
            out += observed_error(e, kind.kind, values[e.id], nav, z, kind.dim)
        if kind.kind in e.seen:
            out[:, 0] += seen_columns(e, kind.kind, known.unbiased, t) @ values[e.id]
    for e in effects:
        if kind.kind in e.outliers:
            stray = rng.random(len(t)) < values[e.id][0]
            width = 0.5 * e.outliers[kind.kind] ** (-1.0 / kind.dim)
            out[stray] = rng.uniform(-width, width, (int(stray.sum()), kind.dim))
    return out

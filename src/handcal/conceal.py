"""Adds sensor errors to a recording, real ones too, so that there is a truth to be found.

Nothing here goes through the estimator's linearised model: delays shift stamps or are
interpolated, lever arms move the marker or swing the accelerometer, filters filter. What an
error depends on, the true rate and force, is known as well as the recording tells: its
readings, less the biases of a calibration where squares of them matter, or readings that
whoever knows more of the device has corrected. Of attitude and magnetic north the same
calibration tells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from handcal import so3
from handcal.calibration import calibrate
from handcal.effects import Signals, catalogue, mag_hard_iron
from handcal.effects._derivative import derivative
from handcal.signals import of_recording
from handcal.types import Array, BoolArray, Imu, InputError, Recording, Result, Series

# Errors of rate or force that are not proportional to it: a bias must not count as motion.
SQUARES = (
    "gyro_quadratic", "gyro_cross_products", "accel_cross_products", "accel_asymmetry",
    "size_effect", "lever_arm",
)  # fmt: skip
# These change what there is to be measured; all other errors are those of measuring it.
WORLD = ("gravity", "earth_rate")
HEADING = (
    "heading_hard_iron", "heading_soft_iron", "heading_drift", "heading_correlated_noise",
    "heading_outliers",
)  # fmt: skip
# Done here by other means than the catalogue's imu_error.
OWN = (
    *HEADING, "lever_arm", "accel_delay", "gyro_bandwidth", "gyro_bias_walk", "accel_bias_walk",
    "mag_hard_iron", "heading_delay", "pose_delay", "clock_rate",
)  # fmt: skip
# Left out, these would turn the marker against the IMU by a degree in real recordings.
TURNS_MARKER = (
    "lever_arm", "gyro_scale", "gyro_misalignment", "accel_scale", "accel_misalignment",
    "accel_delay", "pose_delay",
)  # fmt: skip
DEVICE_CLOCK = ("heading", "mag", "temperature")
MOST_PPM = 1e5
# Rotation vectors of larger turns (rad) are no longer unique.
MOST_TURN = 2.0

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
    _check_streams(recording, values)
    known = _Known(recording, values, truth)
    streams: dict[str, Series] = dict(recording.streams)
    if "lever_arm" in values and _marker_moves(recording):
        streams["pose"] = _moved_marker(recording, values["lever_arm"], known)
    heading = "heading" if "heading" in streams else "mag"
    if any(i in values for i in HEADING):
        late = float(values.get("heading_delay", [0.0])[0])
        error = _heading_error(values, streams[heading].t, late, known, rng)
        turned = _turned_heading if heading == "heading" else _turned_field
        streams[heading] = turned(streams[heading], error, known)
    for effect, stream in (("heading_delay", heading), ("pose_delay", "pose")):
        if effect in values:
            streams[stream] = shifted(streams[stream], float(values[effect][0]), recording.imu)
    if "mag_hard_iron" in values:
        mag = streams["mag"]
        streams["mag"] = replace(mag, value=mag.value + values["mag_hard_iron"])
    imu = _imu(recording, values, known, rng)
    if "clock_rate" in values:
        imu, streams = stretched(imu, streams, 1.0 + 1e-6 * float(values["clock_rate"][0]))
    return replace(recording, imu=imu, streams=streams)


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
    known = catalogue()
    if name not in known:
        raise InputError(f"Unknown effect '{name}'. Known: {', '.join(sorted(known))}.")
    parameters = known[name].parameters
    units = [p.unit for p in parameters]
    of = ", ".join(units[:1] if len(set(units)) == 1 else units)
    unit = "without unit" if of == "1" else f"in {of}"
    return f"{name}={','.join(p.name for p in parameters)} {unit}"


def _checked(name: str, values: Sequence[float]) -> Array:
    """Values that the effect can have. Errors: InputError."""
    says = expected(name)
    effect = catalogue()[name]
    if effect.imu_error is None and name not in OWN:
        raise InputError(f"The effect '{name}' cannot be concealed yet.")
    if len(values) != len(effect.parameters):
        raise InputError(
            f"{name} takes {len(effect.parameters)} values, not {len(values)}: {says}."
        )
    if not all(math.isfinite(v) for v in values):
        raise InputError(f"{name} takes finite numbers: {says}.")
    for p, v in zip(effect.parameters, values, strict=True):
        if p.positive and (v < 0.0 or (v == 0.0 and name == "heading_correlated_noise")):
            raise InputError(f"{name}: {p.name} must be above 0.")
    if name == "heading_outliers" and values[0] > 1.0:
        raise InputError("heading_outliers: fraction must not exceed 1.")
    if name == "clock_rate" and abs(values[0]) > MOST_PPM:
        raise InputError(f"clock_rate: ppm must lie within {MOST_PPM:.0f} either way.")
    return np.array(values, dtype=np.float64)


def _check_streams(recording: Recording, values: Values) -> None:
    """Errors: InputError for a stream that an effect acts on or depends on, and is absent."""
    have = ", ".join(recording.streams) or "none"
    for name in values:
        needed: tuple[str, ...] = ()
        if name == "heading_hard_iron":
            needed = ("heading",)
        elif name.startswith("heading_"):
            needed = ("heading", "mag")
        elif name in ("pose_delay", "mag_hard_iron"):
            needed = (name.split("_")[0],)
        elif "temperature" in catalogue()[name].needs:
            needed = ("temperature",)
        if needed and not set(needed) & set(recording.streams):
            also = "; see mag_hard_iron" if name == "heading_hard_iron" else ""
            raise InputError(
                f"{name} needs a stream {' or '.join(needed)}; {recording.path} has: {have}{also}."
            )


@dataclass(frozen=True)
class _Known:
    """What is known of the truth in a recording; the calibration is made when first asked."""

    recording: Recording
    values: Values
    truth: Imu | None = None

    @cached_property
    def iron(self) -> Array:
        """A magnetometer's hard iron (3,), tesla: what its readings lie around."""
        return mag_hard_iron.guess(self.recording)

    @cached_property
    def result(self) -> Result:
        """Of the recording as it is. A magnetometer's north is that less its hard iron."""
        recording = self.recording
        if "heading" not in recording.streams and any(i in self.values for i in HEADING):
            recording = mag_hard_iron.cleaned(recording, self.iron)
        carries = "lever_arm" in self.values and _marker_moves(recording)
        return calibrate(recording, TURNS_MARKER if carries else ())

    def attitude(self, t: Array) -> Array:
        """C_nb (n, 3, 3) at times t (n,), turning at a constant rate between two known ones."""
        assert self.result.smoothed is not None
        history = self.result.smoothed
        return so3.between(history.t, so3.matrix_of(history.q_nb), t)

    def constant(self, effect: str) -> Array:
        """Estimated x y z (3,) of an effect."""
        return np.array([self.result.parameter(effect, a).value for a in "xyz"])

    @cached_property
    def signals(self) -> Signals:
        """Rate and force as known, or as read, less their biases if that matters; temperature,
        attitude."""
        imu, C_nb = self.recording.imu, None
        gyro, accel = (self.truth or imu).gyro, (self.truth or imu).accel
        if self.truth is None and any(i in SQUARES for i in self.values):
            gyro = gyro - self.constant("gyro_bias")
            accel = accel - self.constant("accel_bias")
        if any("attitude" in catalogue()[i].needs and i not in OWN for i in self.values):
            C_nb = self.attitude(imu.t)
        effects = [catalogue()[i] for i in self.values]
        read = np.hstack([gyro, accel])
        return of_recording(self.recording, effects, read=read, C_nb=C_nb)


# --- the IMU ------------------------------------------------------------------------------------


def _imu(recording: Recording, values: Values, known: _Known, rng: np.random.Generator) -> Imu:
    """First what there is to be measured changes, then how it is measured."""
    imu, t = recording.imu, recording.imu.t
    acting = {i: v for i, v in values.items() if i not in OWN}
    before = truth = known.signals
    if "lever_arm" in values and not _marker_moves(recording):
        truth = replace(truth, accel=truth.accel + _swing(truth, values["lever_arm"]))
    for i in WORLD:
        if i in acting:
            truth = _added(truth, _error(i, acting[i], truth))
    read = truth
    for i, v in acting.items():
        if i not in WORLD:
            read = _added(read, _error(i, v, truth))
    gyro = imu.gyro + (read.gyro - before.gyro)
    accel = imu.accel + (read.accel - before.accel)
    if values.get("gyro_bandwidth", np.zeros(1))[0] > 0.0:
        gyro = gyro + (_low_pass(t, truth.gyro, float(values["gyro_bandwidth"][0])) - truth.gyro)
    if "gyro_bias_walk" in values:
        gyro = gyro + _walk(t, float(values["gyro_bias_walk"][0]), rng)
    if "accel_bias_walk" in values:
        accel = accel + _walk(t, float(values["accel_bias_walk"][0]), rng)
    valid = imu.valid
    if "accel_delay" in values:
        felt = np.clip(t - values["accel_delay"][0], t[0], t[-1])
        accel = CubicSpline(t, accel)(felt)
        valid = valid & measured(imu, felt)
    kept = imu.valid[:, None]
    return Imu(t, np.where(kept, gyro, imu.gyro), np.where(kept, accel, imu.accel), valid)


def measured(imu: Imu, t: Array) -> BoolArray:
    """Which of the times t (m,) lie between readings that are measurements, (m,)."""
    return np.asarray(np.interp(t, imu.t, imu.valid.astype(float)) > 1.0 - 1e-9)


def _error(effect: str, values: Array, truth: Signals) -> Array:
    imu_error = catalogue()[effect].imu_error
    assert imu_error is not None
    return imu_error(values, truth)


def _added(signals: Signals, error: Array) -> Signals:
    return replace(signals, gyro=signals.gyro + error[:, :3], accel=signals.accel + error[:, 3:])


def _swing(truth: Signals, r: Array) -> Array:
    """Specific force (n, 3) at r (3,) beyond that where the IMU sat."""
    w, alpha = truth.gyro, derivative(truth.t, truth.gyro)
    return np.asarray(np.cross(alpha, r) + np.cross(w, np.cross(w, r)))


def _low_pass(t: Array, x: Array, tau: float) -> Array:
    """First-order low pass of x (n, 3), exact for what is linear between the samples."""
    dt = np.diff(t)
    decay = np.exp(-dt / tau)
    share = -np.expm1(-dt / tau) * tau / dt
    fresh = (1.0 - share)[:, None] * x[1:] + (share - decay)[:, None] * x[:-1]
    out = np.empty_like(x)
    out[0] = y = x[0]
    for k, keep in enumerate(decay.tolist()):
        out[k + 1] = y = keep * y + fresh[k]
    return out


def _walk(t: Array, density: float, rng: np.random.Generator) -> Array:
    """(n, 3), zero at the first instant."""
    steps = rng.standard_normal((len(t), 3)) * np.sqrt(np.diff(t, prepend=t[0]))[:, None]
    return np.asarray(density * np.cumsum(steps, axis=0))


# --- the other streams --------------------------------------------------------------------------


def _marker_moves(recording: Recording) -> bool:
    """With a pose alone it is exact to move the marker; else the accelerometer must swing."""
    return "pose" in recording.streams and "reference" not in recording.streams


def _moved_marker(recording: Recording, r: Array, known: _Known) -> Series:
    """The IMU stays, so the marker goes to -r from where it was, in the IMU's axes.

    How the marker is turned against those shows in turns that both made within a second.
    """
    pose = recording.streams["pose"]
    late = known.result.parameter("pose_delay", "delay").value
    step = max(1, round(1.0 / float(np.median(np.diff(pose.t)))))
    turns = [
        so3.matrix_log(C[:-step].transpose(0, 2, 1) @ C[step:])
        for C in (so3.matrix_of(pose.value[:, 3:]), known.attitude(pose.t - late))
    ]
    usable = np.linalg.norm(turns[0], axis=1) < MOST_TURN
    U, _, Vt = np.linalg.svd(turns[1][usable].T @ turns[0][usable])
    R_bm = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    value = pose.value.copy()
    value[:, :3] -= so3.matrix_of(value[:, 3:]) @ (R_bm.T @ r)
    return Series(pose.t, value)


def shifted(series: Series, delay: float, imu: Imu) -> Series:
    """The same values at stamps that come later: nothing needs interpolation."""
    t = series.t + delay
    kept = (t >= imu.t[0]) & (t <= imu.t[-1])
    if not kept.any():
        raise InputError(f"A delay of {delay:g} s leaves no reading within the recording.")
    return Series(t[kept], series.value[kept])


def _heading_error(
    values: Values, t: Array, late: float, known: _Known, rng: np.random.Generator
) -> Array:
    """Error (m,) of a heading at times t (m,), read ``late`` seconds after; rad."""
    yaw = so3.yaw_of(known.attitude(t))
    error = np.zeros(len(t))
    for turns, name in ((1, "heading_hard_iron"), (2, "heading_soft_iron")):
        if name in values:
            error += values[name] @ np.stack([np.sin(turns * yaw), np.cos(turns * yaw)])
    if "heading_drift" in values:
        error += values["heading_drift"][0] * (t + late - known.recording.imu.t[0])
    if "heading_correlated_noise" in values:
        sigma, tau = values["heading_correlated_noise"]
        keep = np.exp(-np.diff(t, prepend=-np.inf) / tau)
        state, fresh = 0.0, np.sqrt(1.0 - keep**2) * rng.standard_normal(len(t))
        for k in range(len(t)):
            state = keep[k] * state + fresh[k]
            error[k] += sigma * state
    if "heading_outliers" in values:
        stray = rng.random(len(t)) < values["heading_outliers"][0]
        error[stray] = rng.uniform(-math.pi, math.pi, int(stray.sum()))
    return error


def _turned_heading(series: Series, error: Array, known: _Known) -> Series:  # noqa: ARG001
    return Series(series.t, so3.wrap(series.value + error[:, None]))


def _turned_field(series: Series, error: Array, known: _Known) -> Series:
    """A heading too large is a field turned the other way about the vertical, but for the
    part that belongs to the device."""
    C_nb, iron = known.attitude(series.t), known.iron
    about = np.zeros((len(error), 3))
    about[:, 2] = -error
    level = np.einsum("kij,kj->ki", C_nb, series.value - iron)
    turned = np.einsum("kij,kj->ki", so3.rotations(about), level)
    return Series(series.t, np.einsum("kji,kj->ki", C_nb, turned) + iron)


def stretched(
    imu: Imu, streams: Mapping[str, Series], fast: float
) -> tuple[Imu, dict[str, Series]]:
    """Stamps of a clock that runs fast; pose and reference have clocks of their own."""
    out = {
        name: replace(series, t=series.t * fast) if name in DEVICE_CLOCK else series
        for name, series in streams.items()
    }
    return replace(imu, t=imu.t * fast), out

"""Takes what ``explain`` or ``calibrate`` learnt of a device off a recording of it.

The reverse of ``conceal``: readings minus error, the error as the catalogue has it and at the
truth that it leaves; late streams at earlier stamps. Only a sensor's errors can be taken off.
Where the sensor sits, how strong gravity is and how large the noise is stay as they are.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.conceal import WORLD, measured, shifted, stretched
from handcal.effects import Effect, Signals, catalogue
from handcal.effects._derivative import reach
from handcal.effects.mag_hard_iron import cleaned
from handcal.explain_summary import EXPLANATION_SCHEMA
from handcal.model import substituted, temperature_of
from handcal.observations import catalogue as observations
from handcal.so3 import wrap
from handcal.summary import CALIBRATION_SCHEMA
from handcal.types import Array, BoolArray, HandcalError, Imu, InputError, Recording, Series

BIASES = ("gyro_bias", "accel_bias")
# These differ from one day to the next, so they are taken off only when asked for.
OF_ONE_DAY = (*BIASES, "gyro_bias_step")
DELAYS = ("pose_delay", "heading_delay")
IRONS = ("heading_hard_iron", "heading_soft_iron")
ROUNDS = 60

NO_SENSOR = "no error of a sensor"
NOT_ASKED = "of one day, taken off with --biases"
NOT_KNOWN = "not known well enough"
NO_STREAM = "no stream here from which it could be taken off"


@dataclass(frozen=True)
class Learnt:
    """What a file says of a device.

    path: of the file. values: of each effect, in the order of the catalogue's parameters, SI.
    biases: (recording, gyro and accelerometer (6,)) of each that the file is about; the
    recording is "" where the file does not say which it was. unnamed: formulas. hidden: axes of
    each bias that were not observable, by recording.
    """

    path: str
    values: Mapping[str, Array]
    biases: tuple[tuple[str, Array], ...]
    unnamed: tuple[str, ...]
    hidden: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Corrected:
    """A corrected recording; taken: ids of what was taken off it; left: other ids, by reason."""

    recording: Recording
    taken: tuple[str, ...]
    left: Mapping[str, tuple[str, ...]]


def apply(recording: Recording, learnt: Learnt, *, biases: bool = False) -> Corrected:
    """The recording without the errors that were learnt.

    biases: take off also what differs from day to day. Readings that are no measurements
    (saturated) stay as they are. Raises InputError where biases are asked for and the file
    has none for this recording, HandcalError where an error cannot be undone.
    """
    known = [*(BIASES if learnt.biases else ()), *learnt.values]
    why = {i: _reason(i, recording, biases) for i in known}
    values = {i: v for i, v in learnt.values.items() if not why[i]}
    bias, hidden = None, dict[str, str]()
    if biases:
        of, bias = _bias_of(recording, learnt)
        hidden = dict(learnt.hidden.get(of, {}))
        bias = np.where([a in hidden.get(i, "") for i in BIASES for a in "xyz"], 0.0, bias)
        why |= {i: NOT_KNOWN for i, axes in hidden.items() if axes == "xyz"}
    streams: dict[str, Series] = dict(recording.streams)
    if "heading" in streams:
        streams["heading"] = _heading(streams["heading"], values, float(recording.imu.t[0]))
    if "mag_hard_iron" in values:
        streams["mag"] = cleaned(recording, values["mag_hard_iron"]).streams["mag"]
    for i in DELAYS:
        if i in values:
            stream = _stream_of(i, recording)
            streams[stream] = shifted(streams[stream], -float(values[i][0]), recording.imu)
    imu = _imu(recording, values, _typical(learnt) if bias is None else bias, bias)
    if "clock_rate" in values:
        imu, streams = stretched(imu, streams, 1.0 / (1.0 + 1e-6 * float(values["clock_rate"][0])))
    left: dict[str, tuple[str, ...]] = {}
    for i, reason in why.items():
        if reason:
            left[reason] = (*left.get(reason, ()), i)
        elif i in hidden:
            left[NOT_KNOWN] = (*left.get(NOT_KNOWN, ()), f"{i} ({' and '.join(hidden[i])})")
    taken = tuple(i for i in known if not why[i])
    return Corrected(replace(recording, imu=imu, streams=streams), taken, left)


def _reason(effect: str, recording: Recording, biases: bool) -> str:
    """Why an effect is left as it is; empty if it can be taken off."""
    if effect in OF_ONE_DAY:
        return "" if biases else NOT_ASKED
    known = catalogue()[effect]
    on_stream = effect in DELAYS or effect.startswith(("heading_", "mag_"))
    of_sensor = known.imu_error is not None or on_stream
    if effect in WORLD or known.process is not None or known.outliers or not of_sensor:
        return NO_SENSOR
    if "temperature" in known.needs and "temperature" not in recording.streams:
        return NO_STREAM
    if on_stream and _stream_of(effect, recording) not in recording.streams:
        return NO_STREAM
    return ""


def _stream_of(effect: str, recording: Recording) -> str:
    """The stream that an effect is on, be it there or not."""
    if effect == "heading_delay" and "heading" not in recording.streams:
        return "mag"
    return effect.split("_")[0]


# --- the readings -------------------------------------------------------------------------------


def _imu(
    recording: Recording, values: Mapping[str, Array], about: Array, bias: Array | None
) -> Imu:
    """about (6,): the likely biases, which must not count as motion; bias: to be taken off."""
    imu = recording.imu
    acting = _acting(values)
    raw = np.hstack([imu.gyro, imu.accel])
    motion = raw - about
    signals = Signals(imu.t, motion[:, :3], motion[:, 3:], temperature_of(recording))
    ref = np.concatenate([values[e.id] for e in acting]) if acting else np.zeros(0)
    clean = raw - substituted(acting, ref, signals) - (0.0 if bias is None else bias)
    clean = np.where(imu.valid[:, None], clean, raw)
    valid = _valid(imu, values)
    return Imu(imu.t, clean[:, :3].copy(), clean[:, 3:].copy(), valid)


def _acting(values: Mapping[str, Array]) -> list[Effect]:
    """Those that act on the readings. A clock that runs fast acts on the stamps."""
    effects = [catalogue()[i] for i in values if i != "clock_rate"]
    return [e for e in effects if e.imu_error is not None]


def _valid(imu: Imu, values: Mapping[str, Array]) -> BoolArray:
    """Measurements of which nothing was made of what is none."""
    valid = imu.valid
    if "accel_delay" in values:
        valid = valid & measured(imu, imu.t + values["accel_delay"][0])
    if {"gyro_bandwidth", "size_effect"} & values.keys():
        width = 2 * reach(imu.t) + 1
        valid = valid & (np.convolve(~imu.valid, np.ones(width), mode="same") < 0.5)
    return valid


def _heading(series: Series, values: Mapping[str, Array], begin: float) -> Series:
    """Headings (m, 1) without drift, then without irons, which depend on the true heading."""
    read = series.value[:, 0]
    if "heading_drift" in values:
        read = read - values["heading_drift"][0] * (series.t - begin)
    irons = [(n, values[i]) for n, i in enumerate(IRONS, 1) if i in values]
    if sum(n * float(np.hypot(*iron)) for n, iron in irons) >= 1.0:
        raise HandcalError(
            "The irons turn the heading back on itself, so that no heading belongs to a reading."
        )
    yaw = read
    for _ in range(ROUNDS if irons else 0):
        yaw = read - sum(iron @ [np.sin(n * yaw), np.cos(n * yaw)] for n, iron in irons)
    return Series(series.t, wrap(yaw)[:, None])


def _typical(learnt: Learnt) -> Array:
    """Likely biases (6,) on any day: the mean of those known."""
    return np.mean([b for _, b in learnt.biases], axis=0) if learnt.biases else np.zeros(6)


def _bias_of(recording: Recording, learnt: Learnt) -> tuple[str, Array]:
    """Biases (6,) of this recording; those of a file that does not say of which it is. Before
    them, the recording as the file calls it."""
    name = Path(recording.path).name
    for path, bias in learnt.biases:
        if Path(path).name == name or (not path and len(learnt.biases) == 1):
            return path, bias
    of = ", ".join(Path(path).name for path, _ in learnt.biases) or "no recording"
    raise InputError(f"--biases: {learnt.path} has the biases of {of}, not of {name}.")


# --- what was learnt ----------------------------------------------------------------------------


def read(path: Path) -> Learnt:
    """What ``explain --json`` or ``calibrate --json`` wrote. Errors: InputError."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not JSON.") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in (EXPLANATION_SCHEMA, CALIBRATION_SCHEMA):
        raise InputError(
            f"{path} is not what `handcal explain --json` or `handcal calibrate --json` writes."
        )
    try:
        return _learnt(path, document)
    except (KeyError, TypeError, AttributeError, OverflowError):
        raise InputError(f"{path} lacks something that a {schema} has, or it is damaged.") from None


def _learnt(path: Path, document: Mapping[str, Any]) -> Learnt:
    recordings = document.get("recordings", [])
    if document["schema"] == CALIBRATION_SCHEMA and recordings:
        raise InputError(
            f"{path} holds {len(recordings)} calibrations, each on its own; "
            "calibrate one recording, or explain several together."
        )
    formulas = tuple(str(u["formula"]) for u in document.get("unnamed", []))
    other = {*observations(), *formulas}
    values = _values(path, document["parameters"], other)
    found, hidden = {"": values}, {"": _hidden(document["parameters"])}
    if recordings:
        found = {r["recording"]["path"]: _values(path, r["parameters"], other) for r in recordings}
        hidden = {r["recording"]["path"]: _hidden(r["parameters"]) for r in recordings}
    elif "recording" in document:
        found = {document["recording"]["path"]: values}
        hidden = {document["recording"]["path"]: hidden[""]}
    biases = [
        (of, np.concatenate([own[i] for i in BIASES]))
        for of, own in found.items()
        if all(i in own for i in BIASES)
    ]
    effects = {i: v for i, v in values.items() if i not in BIASES}
    return Learnt(str(path), effects, tuple(biases), formulas, hidden)


def _hidden(parameters: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Axes of each bias that were not observable, of those that have any."""
    out: dict[str, str] = {}
    for p in parameters:
        if p["effect"] in BIASES and p.get("observable") is False:
            out[p["effect"]] = out.get(p["effect"], "") + p["name"]
    return out


def _values(
    path: Path, parameters: Sequence[Mapping[str, Any]], other: Set[str]
) -> dict[str, Array]:
    """By id; other: what is no effect (formulas, how a marker is turned). Errors: InputError."""
    said: dict[str, dict[str, float]] = {}
    for p in parameters:
        value = p["value"]
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            value = math.nan
        said.setdefault(p["effect"], {})[p["name"]] = value
    out = {}
    for effect, named in said.items():
        if effect in other:
            continue
        if effect not in BIASES and effect not in catalogue():
            raise InputError(f"{path} has the effect '{effect}', of which nothing is known.")
        names = [*"xyz"] if effect in BIASES else [p.name for p in catalogue()[effect].parameters]
        numbers = np.array([named.get(name, math.nan) for name in names], dtype=np.float64)
        if named.keys() != set(names) or not np.isfinite(numbers).all():
            raise InputError(f"{path}: {effect} needs a finite number for {', '.join(names)}.")
        out[effect] = numbers
    return out

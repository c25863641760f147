"""A result as a format is given it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.device.another import unlike
from handcal.documents import read_json
from handcal.effects import catalogue
from handcal.exports import Contents, Format, fitting, formats
from handcal.exports import _correction as correction
from handcal.exports._correction import NOTHING
from handcal.exports._header import header, noise_header, same
from handcal.exports._known import Known, known, recordings_of, warnings_of
from handcal.exports._noise import allan_document, is_allan, noise_lines, noise_of
from handcal.exports._text import one_line
from handcal.exports._vehicle import CORRECTED, RAW, read_parameters, readings_of
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.trust import check
from handcal.types import Array, HandcalError, InputError, Recording

# As a part of it, to which two rates are one.
SAME_RATE = 0.01


def contents(
    path: Path, form: Format, recording: Recording | None = None, allan: Path | None = None,
    topic: str | None = None, axes: str | None = None, parameters: Path | None = None,
    *, readings: str = "", instance: Mapping[str, int] | None = None, anyway: bool = False,
) -> Contents:  # fmt: skip
    """A result as a format is given it; of what ``handcal allan`` wrote, its noise alone.

    recording: where what is left is measured. allan: a JSON of ``handcal allan``, for the noise.
    topic: None for that of the recording. axes: "flu", "frd", or None for "flu". parameters: of
    the vehicle, None for those of the recording. readings: "raw", or "corrected" by the vehicle's
    own calibration, of recordings that do not say it. instance: which of the vehicle's sensors
    "gyro" and "accel" were, where the recording does not say it. anyway: also of a result that is
    not to be trusted. Errors: InputError, HandcalError.
    """
    if is_allan(read_json(path)):
        return _of_noise(path, form, allan, topic)
    found = known(path, recording)
    check(path.name, found.learnt.trust, anyway)
    _check_axes(found.document, form, axes)
    options = {"--parameters": parameters, "--readings": readings, "--instance": instance}
    _check_vehicle(path, found.document, form, options)
    vehicle = _vehicle(found.document, parameters)
    readings = _readings(found.document, readings)
    full = correction.together(list(found.matrices.values()), found.bias)
    kept = full if form.keep is None else form.keep(full)
    has_bias = bool(found.learnt.biases)
    if form.needs_bias and not has_bias:
        raise HandcalError(f"{path} has no biases, and zeros in their place would be wrong.")
    if form.keep is not None and not form.online and same(kept, NOTHING):
        raise HandcalError(_nothing(path, found))
    noise = noise_of(found.document, allan, form)
    rate, read, apart = _of_imu(found, recording)
    lines = [*header(path, found, form, kept, recording), *noise_lines(noise, form), *apart]
    if allan is not None and form.noise:
        lines += _other_rate(allan, rate)
    return Contents(
        one_line(path.name), tuple(map(one_line, (*lines, *form.notes))), kept, found.bias,
        found.bias_sigma, found.hidden, has_bias, noise, rate, _resolved(topic, read),
        axes or "flu", vehicle, readings, instance or {}, _marker(found),
        _parameters(found.document),
    )  # fmt: skip


def _of_noise(path: Path, form: Format, allan: Path | None, topic: str | None) -> Contents:
    """The noise of a device at rest, and nothing that was calibrated. Errors: InputError."""
    if not form.noise:
        known = ", ".join(name for name, one in formats().items() if one.noise)
        raise InputError(
            f"{path} holds noise alone, for which {form.program} has no place. Noise goes to "
            f"{known}."
        )
    if allan is not None:
        raise InputError(f"{path} holds the noise itself; leave --noise away.")
    document, noise = allan_document(path), noise_of({}, path, form)
    lines = [*noise_header(path, document, form), *noise_lines(noise, form), *form.notes]
    return Contents(
        one_line(path.name), tuple(map(one_line, lines)), NOTHING, np.zeros(6), np.full(6, np.nan),
        {}, False, noise, _rate(document), _resolved(topic, _topic(document)), "flu", {}, "", {},
        None, [],
    )  # fmt: skip


def _of_imu(found: Known, recording: Recording | None) -> tuple[float | None, str, list[str]]:
    """Rate and topic, both of one recording: the result's own; and what there is to say of another
    one by which errors were measured."""
    rate, topic = _rate(found.document), _topic(found.document)
    if recording is None:
        return rate, topic, []
    name, own = Path(recording.path).name, recordings_of(found.document)
    here = _rounded(recording.rate_hz), recording.topics.get("imu", "")
    if rate is None or name in [Path(str(r["path"])).name for r in own]:
        return here[0], here[1] or topic, []
    apart = [f"Warning: {sentence}" for sentence in unlike(recording, found.learnt)]
    if not math.isclose(rate, here[0], rel_tol=SAME_RATE) or (topic and here[1] not in (topic, "")):
        apart.append(
            f"Warning: {name} has {here[0]:g} Hz{' on ' + here[1] if here[1] else ''}; rate and "
            f"topic of this file are those of {Path(str(own[0]['path'])).name}"
        )
    return rate, topic, apart


def _other_rate(allan: Path, rate: float | None) -> list[str]:
    """That noise was measured at another rate, if it was."""
    measured = _rate(allan_document(allan))
    if rate is None or measured is None or math.isclose(rate, measured, rel_tol=SAME_RATE):
        return []
    return [
        f"Warning: the noise of {allan.name} was measured at {measured:g} Hz, and the rate here is "
        f"{rate:g} Hz: a sensor that filters otherwise at that rate has another noise density"
    ]


def _resolved(typed: str | None, read: str) -> str:
    """The topic as typed, else as read; one that the recording does not have as ROS resolves it."""
    if not typed:
        return read
    return typed if typed == read or typed.startswith(("/", "~")) else f"/{typed}"


def _rounded(rate: float) -> float:
    """A rate to the digits that clocks are good for."""
    return float(f"{rate:.6g}")


def _nothing(path: Path, found: Known) -> str:
    """Why there is nothing to write."""
    if found.matrices or found.others:
        return f"{path} has nothing that this format can hold; use `handcal apply`."
    shown = " ".join(catalogue()[i].motion for i in ("accel_scale", "gyro_scale"))
    return (
        f"{path}: nothing was calibrated that this format can hold: no bias, scale or misalignment "
        f"was shown. What would show them: {shown}"
    )


def _check_axes(document: Mapping[str, Any], form: Format, axes: str | None) -> None:
    """Errors: InputError where axes make no sense."""
    if axes is None:
        return
    if not form.vehicle:
        known = ", ".join(name for name, one in formats().items() if one.vehicle)
        raise InputError(f"--axes is for {known}; {form.program} has the axes of the recording.")
    if axes == "frd" and any(TURNED_TO_FLU in said for said in warnings_of(document)):
        raise InputError(
            "--axes frd: this result is of a log whose axes were turned to forward, left, up when "
            "it was read; leave --axes away."
        )


def _check_vehicle(
    path: Path, document: Mapping[str, Any], form: Format, options: Mapping[str, object]
) -> None:
    """Errors: InputError for options of a vehicle that make no sense, and for another vehicle's
    log."""
    if options["--readings"] not in ("", RAW, CORRECTED):
        raise InputError(f"--readings {options['--readings']}: expected {RAW} or {CORRECTED}.")
    asked = next((name for name, value in options.items() if value), "")
    if asked and not form.vehicle:
        known = ", ".join(name for name, one in formats().items() if one.vehicle)
        raise InputError(f"{asked} is for {known}; {form.program} has none.")
    names = [*_agreed(document)]
    if form.vehicle and names and not any(name.startswith(form.vehicle) for name in names):
        other = fitting(names)
        raise InputError(
            f"{path.name} is of a log of {formats()[other].program}, whose readings and parameters "
            f"are not {form.program}'s: use --to {other}."
        )


def _agreed(document: Mapping[str, Any]) -> dict[str, float]:
    """What all recordings say of the vehicle."""
    said = [r.get("vehicle", {}) for r in recordings_of(document)] or [{}]
    return {name: v for name, v in said[0].items() if all(r.get(name) == v for r in said)}


def _vehicle(document: Mapping[str, Any], parameters: Path | None) -> Mapping[str, float]:
    """Parameters of the vehicle's own calibration when the recordings were made, in which all of
    them agree. Errors: InputError."""
    agreed = _agreed(document)
    if parameters is None:
        return agreed
    ids = {name: v for name, v in agreed.items() if "." in name}
    return {**ids, **read_parameters(parameters)}


def _readings(document: Mapping[str, Any], asked: str) -> str:
    """What the recordings say of their readings, else what the user says. Errors: InputError."""
    said = {readings_of(r.get("vehicle", {})) for r in recordings_of(document)} or {""}
    logs = said - {""}
    if len(logs) > 1:
        raise InputError(
            "Some of these recordings are raw and some were corrected by the vehicle: calibrate "
            "each kind by itself."
        )
    if asked and logs - {asked}:
        raise InputError(
            f"--readings {asked}: the log says itself that its readings are {logs.pop()}; leave "
            "--readings away."
        )
    return asked if "" in said else logs.pop()


def _topic(document: Mapping[str, Any]) -> str:
    """Where the Imu messages of the first recording were read, if it was a bag."""
    for r in recordings_of(document):
        topic = str(r.get("streams", {}).get("imu", {}).get("topic", ""))
        if re.fullmatch(r"[\w/~][\w/.~-]*", topic):  # (of a file, and on its way into YAML)
            return topic
    return ""


def _marker(found: Known) -> tuple[Array, Array] | None:
    """How the marker of the first pose is turned, and where it sits as seen from the IMU."""
    said = [found.document, *found.document.get("recordings", [])]
    turned = next((d["marker_rotation"] for d in said if d.get("marker_rotation")), None)
    if turned is None:
        return None
    q = np.asarray(turned["quaternion"], dtype=np.float64)
    arm = found.learnt.values.get("lever_arm")
    if arm is None or "lever_arm" in found.learnt.unsure:
        arm = np.full(3, np.nan)
    return so3.matrix_of(q[None])[0].T, -arm


def _parameters(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    rows = [*document["parameters"]]
    for r in document.get("recordings", []):
        name = Path(r["recording"]["path"]).name
        rows += [p | {"recording": name} for p in r["parameters"]]
    return [{k: one_line(v) if isinstance(v, str) else v for k, v in p.items()} for p in rows]


def _rate(document: Mapping[str, Any]) -> float | None:
    rates = [r.get("imu_rate_hz") for r in recordings_of(document)]
    rates += [m.get("imu_rate_hz") for m in [document] if m.get("imu_rate_hz")]
    return next((_rounded(float(r)) for r in rates if r), None)

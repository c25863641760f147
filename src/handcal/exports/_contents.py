"""A result as a format is given it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.effects import catalogue
from handcal.exports import Contents, Format, formats
from handcal.exports import _correction as correction
from handcal.exports._correction import NOTHING
from handcal.exports._header import header, same
from handcal.exports._known import Known, known, recordings_of, warnings_of
from handcal.exports._noise import noise_lines, noise_of
from handcal.exports._text import one_line
from handcal.exports._vehicle import read_parameters
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.trust import check
from handcal.types import Array, HandcalError, InputError, Recording


def contents(
    path: Path, form: Format, recording: Recording | None = None, allan: Path | None = None,
    topic: str | None = None, axes: str | None = None, parameters: Path | None = None,
    *, anyway: bool = False,
) -> Contents:  # fmt: skip
    """A result as a format is given it.

    recording: where what is left is measured. allan: a JSON of ``handcal allan``, for the noise.
    topic: None for that of the recording. axes: "flu", "frd", or None for "flu". parameters: of
    the vehicle, None for those of the recording. anyway: also of a result that is not to be
    trusted. Errors: InputError, HandcalError.
    """
    found = known(path, recording)
    check(path.name, found.learnt.trust, anyway)
    _check_axes(found.document, form, axes)
    vehicle = _vehicle(found.document, form, parameters)
    full = correction.together(list(found.matrices.values()), found.bias)
    kept = full if form.keep is None else form.keep(full)
    has_bias = bool(found.learnt.biases)
    if form.needs_bias and not has_bias:
        raise HandcalError(f"{path} has no biases, and zeros in their place would be wrong.")
    if form.keep is not None and not form.online and same(kept, NOTHING):
        raise HandcalError(_nothing(path, found))
    noise = noise_of(found.document, allan, form)
    lines = [*header(path, found, form, kept, recording), *noise_lines(noise, form)]
    rate = _rate(found.document) if recording is None else recording.rate_hz
    return Contents(
        one_line(path.name), tuple(map(one_line, (*lines, *form.notes))), kept, found.bias,
        found.hidden, has_bias, noise, rate, topic or _topic(found.document), axes or "flu",
        vehicle, _marker(found), _parameters(found.document),
    )  # fmt: skip


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


def _vehicle(
    document: Mapping[str, Any], form: Format, parameters: Path | None
) -> Mapping[str, float]:
    """Parameters of the vehicle's own calibration when the recordings were made, in which all of
    them agree. Errors: InputError for --parameters where they make no sense."""
    said = [r.get("vehicle", {}) for r in recordings_of(document)] or [{}]
    agreed = {name: v for name, v in said[0].items() if all(r.get(name) == v for r in said)}
    if parameters is None:
        return agreed
    if not form.vehicle:
        known = ", ".join(name for name, one in formats().items() if one.vehicle)
        raise InputError(f"--parameters is for {known}; {form.program} has none.")
    ids = {name: v for name, v in agreed.items() if "." in name}
    return {**ids, **read_parameters(parameters)}


def _topic(document: Mapping[str, Any]) -> str:
    """Where the Imu messages of the first recording were read, if it was a bag."""
    for r in recordings_of(document):
        topic = str(r.get("streams", {}).get("imu", {}).get("topic", ""))
        if re.fullmatch(r"/[\w/.~-]+", topic):  # (of a file, and on its way into YAML)
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
    return next((float(r) for r in rates if r), None)

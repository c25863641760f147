"""The header of an export: what it is of, what the format cannot hold, how much that leaves."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import handcal
from handcal.device import apply as device
from handcal.device.apply import BIASES
from handcal.effects import catalogue
from handcal.exports import Format, formats
from handcal.exports import _correction as correction
from handcal.exports._correction import NOTHING, Correction
from handcal.exports._known import Known, recordings_of, warnings_of
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.types import Array, Recording

UNITS = ("rad/s", "m/s^2")
UNKNOWN = "how much is not known"
LEFT = "Not in this file, "
# The fit looks at means over steps, in which knocks and quick turns are smaller.
OF_STEPS = "in the steps of the fit (in single readings more)"
# rad/s and m/s^2: to this all exports equal ``apply``; what is left below it is rounding.
ROUNDING = 1e-9


def same(a: Correction, b: Correction) -> bool:
    return bool(np.allclose(a.numbers, b.numbers, rtol=0.0, atol=1e-15))


def rms(error: Array) -> tuple[float, float]:
    """Root mean square over the three axes of the gyro and of the accelerometer, of (n, 6)."""
    mean = np.sqrt((error**2).mean(axis=0).reshape(2, 3).mean(axis=1))
    return float(mean[0]), float(mean[1])


def sized(size: tuple[float, float] | None) -> str:
    """The root mean squares of gyro and accelerometer in words; None: not known."""
    if size is None:
        return UNKNOWN
    named = zip(("gyro", "accelerometer"), size, UNITS, strict=True)
    parts = [f"{name} {value:.3g} {unit}" for name, value, unit in named if value > ROUNDING]
    return (", ".join(parts) + " RMS") if parts else "nothing in this recording"


def left(found: Known, form: Format, recording: Recording | None) -> list[str]:
    """What the format cannot hold, each with how much it leaves."""
    keep = form.keep
    if keep is None:
        return []
    sizes = {m.get("effect"): m["size"] for m in found.document.get("missing", []) if m.get("size")}
    read = None if recording is None else readings(recording)
    of = "" if recording is None else f" in the readings of {Path(recording.path).name}"
    out = []
    only = correction.together([], found.bias)
    if not same(keep(only), only):
        rest = rms((keep(only).applied(_ZERO) - only.applied(_ZERO))[:1])
        why = " (the program finds them itself)" if form.online else ""
        out.append(f"constant biases{why}: {sized(rest)}")
    for i, part in found.matrices.items():
        alone = correction.together([part], np.zeros(6))
        if same(keep(alone), alone):
            continue
        some = "" if same(keep(alone), NOTHING) else " in part"
        if read is None:
            out.append(f"{i}{some}: {'at most ' if some and i in sizes else ''}{_said(sizes, i)}")
        else:
            out.append(
                f"{i}{some}: {sized(rms(alone.applied(read) - keep(alone).applied(read)))}{of}"
            )
    for i in found.others:
        if i not in found.learnt.values:
            out.append(f"{i}: it has no name, its size stands in {Path(found.learnt.path).name}")
            continue
        size = None if recording is None else _without(found, i, recording)
        if size is None and recording is not None and i not in sizes:
            out.append(f"{i}: no change of these readings that could be measured")
        else:
            out.append(f"{i}: {_said(sizes, i) if size is None else sized(size) + of}")
    return out


_ZERO = np.zeros((1, 6))


def readings(recording: Recording) -> Array:
    """Rate and force (n, 6) of the valid samples."""
    valid = recording.imu.valid
    return np.hstack([recording.imu.gyro, recording.imu.accel])[valid]


def _without(found: Known, effect: str, recording: Recording) -> tuple[float, float] | None:
    """What an effect that is no matrix does to the readings of a recording; None for one that
    needs a stream which is not there, or changes stamps alone."""
    values = found.of_readings()
    with_it = correction.corrected(recording, values, found.bias)
    del values[effect]
    without = correction.corrected(recording, values, found.bias)
    if with_it.shape != without.shape or np.array_equal(with_it, without):
        return None
    return rms((with_it - without)[recording.imu.valid])


def _said(sizes: Mapping[str, Mapping[str, float]], effect: str) -> str:
    if effect not in sizes:
        return sized(None)
    squares = [
        [v**2 for c, v in sizes[effect].items() if c.startswith(s)] for s in ("gyro", "accel")
    ]
    gyro, accel = (math.sqrt(sum(s) / 3.0) for s in squares)
    return f"{sized((gyro, accel))} {OF_STEPS}" if gyro or accel else sized(None)


# --- the header ---------------------------------------------------------------------------------


def header(
    path: Path, found: Known, form: Format, kept: Correction, recording: Recording | None
) -> tuple[str, ...]:
    lines = _origin(path, found.document, form)
    lines += _errors(found, form)
    if not form.vehicle:
        lines.append(_readings(found.document))
    if found.bias_from:
        lines.append(f"{found.bias_from[:1].upper()}{found.bias_from[1:]}")
    for i, axes in found.hidden.items():
        lines.append(f"{i} {' '.join(axes)}: not shown by the recording, taken as zero")
    if unsure := device.not_shown(found.learnt):
        lines.append(unsure)
    alike = any(m.get("indistinguishable_from") for m in found.document.get("missing", ()))
    if found.document.get("verdict") == "cannot_tell" and alike:
        lines.append("Warning: of some of these errors the recording cannot tell which it holds")
    lines += not_calibrated(form, kept, bool(found.bias_from))
    if form.keep is not None:
        lines += _left_lines(found, form, kept, recording)
    unknown = [line for line in lines if line.startswith(LEFT)
               and (line.endswith((UNKNOWN, OF_STEPS)) or not form.online)]  # fmt: skip
    if recording is None and unknown:
        lines.append(_command(path, found.document, form))
    warned = [said for said in warnings_of(found.document) if TURNED_TO_FLU not in said]
    lines += [f"Warning: {said}" for said in warned]
    return tuple(lines)


def _origin(path: Path, document: Mapping[str, Any], form: Format) -> list[str]:
    """What wrote the file, from which result and recordings."""
    version = document.get("version")
    made = f"by handcal {version}" if version else "that does not say what wrote it"
    kind = str(document["schema"]).split("/")[1]
    lines = [
        f"{form.line}, written by handcal {handcal.__version__}",
        f"From {path.name}, {kind} {made}",
    ]
    for r in recordings_of(document):
        digest = f", sha256 {r['sha256']}" if r.get("sha256") else ""
        lines.append(f"Recording: {Path(str(r['path'])).name}{_length(r)}{digest}")
    return lines


def noise_header(path: Path, document: Mapping[str, Any], form: Format) -> list[str]:
    """The header of a file that holds noise alone."""
    lines = _origin(path, document, form)
    if form.keep is not None:
        lines.append(
            "Nothing was calibrated: noise was measured at rest, and the matrices here are the "
            "identity. What calibrates: `handcal explain` of a recording in which the device turns"
        )
    return [*lines, *(f"Warning: {said}" for said in warnings_of(document))]


def _errors(found: Known, form: Format) -> list[str]:
    """Which errors the file takes off, or has as a table, and which of them were found."""
    keep, biases = form.keep, BIASES if found.bias_from else ()
    if keep is None:
        errors = [*biases, *found.matrices, *found.others, *found.elsewhere]
        lines = ["Errors that were shown: " + (", ".join(errors) or "none")]
    else:
        only = correction.together([], found.bias)
        errors = [*biases] if not same(keep(only), NOTHING) else []
        alone = {i: correction.together([E], np.zeros(6)) for i, E in found.matrices.items()}
        errors += [i for i, one in alone.items() if not same(keep(one), NOTHING)]
        lines = ["Errors that this file corrects: " + (", ".join(errors) or "none")]
    named = found.learnt.found
    if named is not None and (others := [i for i in errors if i not in (*BIASES, *named)]):
        among = ", ".join(i for i in errors if i in named) or "none"
        lines.append(
            f"Of these explain found: {among}; estimated beside and shown, but not found: "
            f"{', '.join(others)}"
        )
    return lines


def _readings(document: Mapping[str, Any]) -> str:
    """Of which readings the numbers are: raw ones, or those that a result had corrected."""
    by = [r["corrected"] for r in recordings_of(document) if r.get("corrected")]
    names = ", ".join(dict.fromkeys(str(name) for one in by for name in dict(one).values()))
    if names:
        return f"For readings that {names} had corrected (handcal apply), not for raw ones"
    return "For raw readings, not for a recording that handcal apply wrote"


# What shows the matrix of a sensor.
SHOWN_BY = {"gyro": "gyro_scale", "accel": "accel_scale"}


def not_calibrated(form: Format, kept: Correction, biases: bool) -> list[str]:
    """Of each sensor whose matrix a program reads, and which stays the identity; with the motion
    that would show it. biases: whether these are known."""
    if form.keep is None or form.vehicle:  # (a vehicle's file has a line for each parameter)
        return []
    holds = form.keep(replace(NOTHING, gyro=2.0 * np.eye(3), accel=2.0 * np.eye(3)))
    out = []
    for sensor, name in (("gyro", "gyro"), ("accel", "accelerometer")):
        matrices = [getattr(c, sensor) for c in (holds, kept, NOTHING)]
        if np.array_equal(matrices[1], matrices[2]) and not np.array_equal(matrices[0], np.eye(3)):
            shown = catalogue()[SHOWN_BY[sensor]].motion
            but = " but the bias" if biases else ""
            out.append(
                f"Of the {name} nothing was calibrated{but}: scale and misalignment were not "
                f"shown, and its matrix here is the identity. What would show them: {shown}"
            )
    return out


def _command(path: Path, document: Mapping[str, Any], form: Format) -> str:
    """What would tell how much is left."""
    name = next((n for n, one in formats().items() if one is form), "FORMAT")
    files = [shlex.quote(Path(str(r["path"])).name) for r in recordings_of(document)]
    return (
        f"How much{'' if form.online else ', and whether the biases hold without it'}: "
        f"handcal export {shlex.quote(path.name)} --to {name} "
        f"--recording {(files or ['FILE'])[0]} -o FILE"
    )


def _length(r: Mapping[str, Any]) -> str:
    if not (r.get("duration_s") and r.get("imu_rate_hz")):
        return ""
    return f", {float(r['duration_s']):.1f} s at {float(r['imu_rate_hz']):.0f} Hz"


def _as_large(rest: Array, found: Known, kept: Correction) -> bool:
    """Whether what is left in readings (n, 6) is, on an axis whose bias is in the file, as large as
    that bias's sigma."""
    size = np.sqrt((rest**2).mean(axis=0))
    held = np.concatenate([kept.gyro_bias, kept.accel_bias]) != 0.0
    return bool((held & (size > ROUNDING) & (size >= found.bias_sigma)).any())


def _left_lines(
    found: Known, form: Format, kept: Correction, recording: Recording | None
) -> list[str]:
    lines = [f"{LEFT}{line}" for line in left(found, form, recording)]
    if recording is not None and lines:
        done = correction.corrected(recording, found.of_readings(), found.bias)
        read = np.hstack([recording.imu.gyro, recording.imu.accel])
        if done.shape == read.shape:
            rest = (kept.applied(read) - done)[recording.imu.valid]
            if _as_large(rest, found, kept):
                lines.append(device.TOGETHER.format("what is not in this file"))
            but = " but for what has no name" if found.learnt.unnamed else ""
            lines.append(
                f"All of that together{but}, in {Path(recording.path).name}: {sized(rms(rest))}"
            )
    if found.elsewhere:
        lines.append(f"No errors of gyro or accelerometer: {', '.join(found.elsewhere)}")
    return lines or ["This file holds all of it"]

"""What a result holds, and what of it a format cannot hold."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import handcal
from handcal.device import apply as device
from handcal.device.apply import BIASES, Learnt
from handcal.documents import read_json
from handcal.effects import catalogue
from handcal.exports import Contents, Format, Noise, formats
from handcal.exports import _correction as correction
from handcal.exports._correction import NOTHING, Correction
from handcal.exports._text import one_line
from handcal.recordings.streams import TURNED_TO_FLU
from handcal.trust import check, of_document, said
from handcal.types import Array, HandcalError, InputError, Recording

# Names in a result's ``noise``, and in Allan's ``suggested``, of what ``Noise`` has.
LEVELS = {"gyro_noise": "gyro_noise", "accel_noise": "accel_noise",
          "gyro_bias_walk_density": "gyro_bias_walk",
          "accel_bias_walk_density": "accel_bias_walk"}  # fmt: skip
ALLAN = ("gyro_noise", "accel_noise", "gyro_bias_walk", "accel_bias_walk")
UNITS = ("rad/s", "m/s^2")
UNKNOWN = "how much is not known"
# rad/s and m/s^2: to this all exports equal ``apply``; what is left below it is rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Known:
    """A result, sorted by what matrices can hold.

    matrices: E (6, 6) and c (6,) of each effect that is one; others: ids of errors of gyro and
    accelerometer that are none; elsewhere: ids of what is no error of these two sensors.
    """

    learnt: Learnt
    document: Mapping[str, Any]
    bias: Array
    bias_from: str
    hidden: Mapping[str, str]
    matrices: Mapping[str, tuple[Array, Array]]
    others: tuple[str, ...]
    elsewhere: tuple[str, ...]

    def of_readings(self) -> dict[str, Array]:
        """Values of the effects that are errors of gyro and accelerometer."""
        kept = {*self.matrices, *self.others}
        return {i: v for i, v in self.learnt.values.items() if i in kept}


def known(path: Path, recording: Recording | None) -> Known:
    """What a result file says. Errors: InputError; HandcalError where matrices would be wrong."""
    document = read_json(path)
    learnt = device.of_document(str(path), document)
    said = ", ".join(Path(str(r["path"])).name for r in _recordings(document))
    bias, words, hidden = _bias(learnt, recording, said)
    matrices: dict[str, tuple[Array, Array]] = {}
    others: list[str] = []
    elsewhere: list[str] = []
    for i, values in learnt.values.items():
        effect = catalogue()[i]
        made = correction.as_matrix(effect, values)
        if made is not None:
            matrices[i] = made
        else:
            (others if effect.misreads else elsewhere).append(i)
    held = {i: learnt.values[i] for i in matrices}
    correction.check(correction.together(list(matrices.values()), bias), held, bias)
    return Known(learnt, document, bias, words, hidden, matrices, (*others, *learnt.unnamed),
                 tuple(elsewhere))  # fmt: skip


def _bias(
    learnt: Learnt, recording: Recording | None, said: str
) -> tuple[Array, str, dict[str, str]]:
    """Biases (6,), of which recording in words, and their axes that were not shown.

    said: the recordings, for a result that does not say of which its biases are."""
    found = list(learnt.biases)
    if recording is not None and len(found) > 1:
        own = [b for b in found if Path(b[0]).name == Path(recording.path).name]
        found = own or found
    if not found:
        return np.zeros(6), "", {}
    shown, axes = [], [""] * 2
    for of, bias in found:
        hidden = learnt.hidden.get(of, {})
        seen = [a not in hidden.get(i, "") for i in BIASES for a in "xyz"]
        shown.append(np.where(seen, bias, np.nan))
    table = np.array(shown)
    there = ~np.isnan(table)
    mean = np.where(there, table, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    for k, lost in enumerate(~there.any(axis=0)):
        axes[k // 3] += "xyz"[k % 3] if lost else ""
    names = ", ".join(Path(of).name for of, _ in found if of)
    words = f"biases of {names or said or 'the result'}"
    if len(found) > 1:
        spread = np.abs(table - mean)[there].max()
        words = f"biases: mean of {names}, up to {spread:.2g} away (another day they are others)"
    return mean, words, {i: a for i, a in zip(BIASES, axes, strict=True) if a}


def contents(
    path: Path, form: Format, recording: Recording | None = None, allan: Path | None = None,
    topic: str | None = None, axes: str | None = None, *, anyway: bool = False,
) -> Contents:  # fmt: skip
    """A result as a format is given it.

    recording: where what is left is measured. allan: a JSON of ``handcal allan``, for the noise.
    topic: None for that of the recording. axes: "flu", "frd", or None for "flu". anyway:
    also of a result that is not to be trusted. Errors: InputError, HandcalError.
    """
    found = known(path, recording)
    check(path.name, found.learnt.trust, anyway)
    _check_axes(found.document, form, axes)
    full = correction.together(list(found.matrices.values()), found.bias)
    kept = full if form.keep is None else form.keep(full)
    has_bias = bool(found.learnt.biases)
    if form.needs_bias and not has_bias:
        raise HandcalError(f"{path} has no biases, and zeros in their place would be wrong.")
    if form.keep is not None and not form.online and _same(kept, NOTHING):
        raise HandcalError(f"{path} has nothing that this format can hold; use `handcal apply`.")
    noise = _noise(found.document) if allan is None else _of_allan(allan)
    header = tuple(map(one_line, _header(path, found, form, kept, recording)))
    return Contents(
        one_line(path.name), header, kept, found.bias, found.hidden, has_bias, noise,
        _rate(found.document), topic or _topic(found.document), axes or "flu",
        _parameters(found.document),
    )  # fmt: skip


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


def warnings_of(document: Mapping[str, Any]) -> list[str]:
    """What a result warns of, its doubts first, each once, on one line."""
    trust = of_document("the result", document)
    found = [*said("This result", trust)]
    found += [w for w in document.get("warnings", []) if w not in trust.reasons]
    for r in document.get("recordings", []):
        found += [w for w in r.get("warnings", []) if w not in trust.reasons]
    return list(dict.fromkeys(one_line(" ".join(str(w).split())) for w in found))


def _topic(document: Mapping[str, Any]) -> str:
    """Where the Imu messages of the first recording were read, if it was a bag."""
    for r in _recordings(document):
        topic = str(r.get("streams", {}).get("imu", {}).get("topic", ""))
        if re.fullmatch(r"/[\w/.~-]+", topic):  # (of a file, and on its way into YAML)
            return topic
    return "/imu"


def _parameters(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    rows = [*document["parameters"]]
    for r in document.get("recordings", []):
        name = Path(r["recording"]["path"]).name
        rows += [p | {"recording": name} for p in r["parameters"]]
    return [{k: one_line(v) if isinstance(v, str) else v for k, v in p.items()} for p in rows]


def _recordings(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    several = [r["recording"] for r in document.get("recordings", [])]
    return [r for r in several or [document.get("recording", {})] if r.get("path")]


def _rate(document: Mapping[str, Any]) -> float | None:
    rates = [r.get("imu_rate_hz") for r in _recordings(document)]
    rates += [m.get("imu_rate_hz") for m in [document] if m.get("imu_rate_hz")]
    return next((float(r) for r in rates if r), None)


# --- noise --------------------------------------------------------------------------------------


def _noise(document: Mapping[str, Any]) -> Noise:
    rows = [*document.get("noise", [])]
    for r in document.get("recordings", [])[:1]:
        rows += r.get("noise", [])
    return replace(
        _levels(rows, LEVELS),
        source="as it was while the device moved in the hand; at rest `handcal allan` sees it "
        "better (--noise ALLAN.json)",
    )


def _of_allan(path: Path) -> Noise:
    """Errors: InputError."""
    document = read_json(path)
    if not isinstance(document, dict) or document.get("schema") != "handcal/allan/1":
        raise InputError(f"{path} is not what `handcal allan --json` writes.")
    noise = _levels(document.get("suggested", []), {name: name for name in ALLAN})
    return replace(noise, source=f"at rest, {path.name}")


def _levels(rows: Sequence[Mapping[str, Any]], names: Mapping[str, str]) -> Noise:
    found = {
        names[r["name"]]: float(r["value"])
        for r in rows
        if r.get("name") in names and isinstance(r.get("value"), (int, float)) and r["value"] > 0
    }
    gyro, accel, gyro_walk, accel_walk = (found.get(name) for name in ALLAN)
    return Noise(gyro, accel, gyro_walk, accel_walk)


# --- what is left -------------------------------------------------------------------------------


def _same(a: Correction, b: Correction) -> bool:
    return bool(np.allclose(a.numbers, b.numbers, rtol=0.0, atol=1e-15))


def _rms(error: Array) -> tuple[float, float]:
    """Over the three axes of the gyro and of the accelerometer, of (n, 6)."""
    mean = np.sqrt((error**2).mean(axis=0).reshape(2, 3).mean(axis=1))
    return float(mean[0]), float(mean[1])


def _sized(rms: tuple[float, float] | None) -> str:
    if rms is None:
        return UNKNOWN
    named = zip(("gyro", "accelerometer"), rms, UNITS, strict=True)
    parts = [f"{name} {value:.3g} {unit}" for name, value, unit in named if value > ROUNDING]
    return (", ".join(parts) + " RMS") if parts else "nothing in this recording"


def left(found: Known, form: Format, recording: Recording | None) -> list[str]:
    """What the format cannot hold, each with how much it leaves."""
    keep = form.keep
    if keep is None:
        return []
    sizes = {m.get("effect"): m["size"] for m in found.document.get("missing", []) if m.get("size")}
    read = None if recording is None else _read(recording)
    out = []
    only = correction.together([], found.bias)
    if not _same(keep(only), only):
        rest = _rms((keep(only).applied(_ZERO) - only.applied(_ZERO))[:1])
        why = " (the program finds them itself)" if form.online else ""
        out.append(f"constant biases{why}: {_sized(rest)}")
    for i, part in found.matrices.items():
        alone = correction.together([part], np.zeros(6))
        if _same(keep(alone), alone):
            continue
        some = "" if _same(keep(alone), NOTHING) else " in part"
        if read is None:
            out.append(f"{i}{some}: {'at most ' if some and i in sizes else ''}{_said(sizes, i)}")
        else:
            out.append(
                f"{i}{some}: {_sized(_rms(alone.applied(read) - keep(alone).applied(read)))}"
            )
    for i in found.others:
        if i not in found.learnt.values:
            out.append(f"{i}: it has no name, its size stands in {Path(found.learnt.path).name}")
            continue
        rms = None if recording is None else _without(found, i, recording)
        if rms is None and recording is not None and i not in sizes:
            out.append(f"{i}: no change of these readings that could be measured")
        else:
            out.append(f"{i}: {_said(sizes, i) if rms is None else _sized(rms)}")
    return out


_ZERO = np.zeros((1, 6))


def _read(recording: Recording) -> Array:
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
    return _rms((with_it - without)[recording.imu.valid])


def _said(sizes: Mapping[str, Mapping[str, float]], effect: str) -> str:
    if effect not in sizes:
        return _sized(None)
    squares = [
        [v**2 for c, v in sizes[effect].items() if c.startswith(s)] for s in ("gyro", "accel")
    ]
    gyro, accel = (math.sqrt(sum(s) / 3.0) for s in squares)
    return _sized((gyro, accel)) if gyro or accel else _sized(None)


# --- the header ---------------------------------------------------------------------------------


def _header(
    path: Path, found: Known, form: Format, kept: Correction, recording: Recording | None
) -> tuple[str, ...]:
    version = found.document.get("version")
    made = f"handcal {version}" if version else "an older handcal"
    kind = str(found.document["schema"]).split("/")[1]
    lines = [
        f"{form.line}, written by handcal {handcal.__version__}",
        f"From {path.name}, {kind} by {made}",
    ]
    for r in _recordings(found.document):
        digest = f", sha256 {r['sha256']}" if r.get("sha256") else ""
        lines.append(f"Recording: {Path(str(r['path'])).name}{_length(r)}{digest}")
    lines.append("Errors found: " + (", ".join((*(BIASES if found.bias_from else ()),
                 *found.matrices, *found.others, *found.elsewhere)) or "none"))  # fmt: skip
    if found.bias_from:
        lines.append(f"{found.bias_from[:1].upper()}{found.bias_from[1:]}")
    for i, axes in found.hidden.items():
        lines.append(f"{i} {' '.join(axes)}: not shown by the recording, taken as zero")
    if unsure := device.not_shown(found.learnt):
        lines.append(unsure)
    alike = any(m.get("indistinguishable_from") for m in found.document.get("missing", ()))
    if found.document.get("verdict") == "cannot_tell" and alike:
        lines.append("Warning: of some of these errors the recording cannot tell which it holds")
    if form.keep is not None:
        lines += _left_lines(found, form, kept, recording)
    if any(line.endswith(UNKNOWN) for line in lines):
        lines.append(_command(path, found.document, form))
    warned = [w for w in warnings_of(found.document) if TURNED_TO_FLU not in w]
    lines += [f"Warning: {w}" for w in warned]
    return (*lines, *form.notes)


def _command(path: Path, document: Mapping[str, Any], form: Format) -> str:
    """What would tell how much is left."""
    name = next((n for n, one in formats().items() if one is form), "FORMAT")
    files = [shlex.quote(Path(str(r["path"])).name) for r in _recordings(document)]
    return (
        f"How much: handcal export {shlex.quote(path.name)} --to {name} "
        f"--recording {(files or ['FILE'])[0]} -o FILE"
    )


def _length(r: Mapping[str, Any]) -> str:
    if not (r.get("duration_s") and r.get("imu_rate_hz")):
        return ""
    return f", {float(r['duration_s']):.1f} s at {float(r['imu_rate_hz']):.0f} Hz"


def _left_lines(
    found: Known, form: Format, kept: Correction, recording: Recording | None
) -> list[str]:
    lines = [f"Not in this file, {line}" for line in left(found, form, recording)]
    if found.others and found.bias_from:
        lines.append(device.TOGETHER.format("what is not in this file"))
    if recording is not None and lines:
        done = correction.corrected(recording, found.of_readings(), found.bias)
        read = np.hstack([recording.imu.gyro, recording.imu.accel])
        if done.shape == read.shape:
            rest = (kept.applied(read) - done)[recording.imu.valid]
            but = " but for what has no name" if found.learnt.unnamed else ""
            lines.append(
                f"All of that together{but}, in {Path(recording.path).name}: {_sized(_rms(rest))}"
            )
    if found.elsewhere:
        lines.append(f"No errors of gyro or accelerometer: {', '.join(found.elsewhere)}")
    return lines or ["This file holds all of it"]

"""Takes what ``explain`` or ``calibrate`` learnt of a device off a recording of it.

The reverse of ``conceal``: readings minus error, the error as the catalogue has it and at the
truth that it leaves; late streams at earlier stamps. Only a sensor's errors can be taken off.
Where the sensor sits, how strong gravity is and how large the noise is stay as they are.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from handcal.compiled.so3 import wrap
from handcal.device.conceal import Truth, streams_of
from handcal.documents import read_json
from handcal.effects import (
    ATTITUDE,
    TIME,
    WARMTH,
    Z_DIM,
    Effect,
    catalogue,
    observed_error,
    seen_columns,
)
from handcal.effects._stamps import shifted
from handcal.estimate.corrected import substituted
from handcal.observations import NAV
from handcal.observations import catalogue as observations
from handcal.recordings.streams import STREAMS, Stream, as_corrected, observed_by
from handcal.signals import at_its_temperature, of_recording, warmth_at
from handcal.trust import Trust
from handcal.trust import of_document as of_itself
from handcal.types import (
    CALIBRATION_SCHEMA,
    EXPLANATION_SCHEMA,
    Array,
    HandcalError,
    Imu,
    InputError,
    Recording,
    Series,
)

BIASES = ("gyro_bias", "accel_bias")
# Rounds in which the true heading is found, and what the last may change, rad.
ROUNDS, FOUND = 2000, 1e-14
# What the last round may change of the readings, as a part of the largest.
EXACT = 1e-12

NO_SENSOR = "no error of a sensor"
# (Of an error the constant part is in the bias as well, with the other sign.)
TOGETHER = "The biases were found together with {}, and without it may be worse than none"
NOT_ASKED = "of one day; --biases removes it"
NOT_KNOWN = "not known well enough"
BIASES_TOO = "--biases removes the biases too. They are those of this recording alone."
CLOCK = "other topics of the bag go by the same clock"
NO_STREAM = "the recording has no stream from which to remove it"


@dataclass(frozen=True)
class Learnt:
    """What a file says of a device.

    path: of the file. values: of each effect, in the order of the catalogue's parameters, SI.
    biases: (recording, gyro and accelerometer (6,)) of each that the file is about; the
    recording is "" where the file does not say which it was. unnamed: formulas of what has no name
    and is not in the catalogue (``model_file.laws_of``), as what goes with the motion. hidden: axes
    of each bias that were not shown, by recording; unsure: names of each effect's parameters that
    the recordings did not show. trust: what it says of itself. made: of which recordings it is, as
    its JSON has them. sha256: of what the file holds, however it is spaced. found: of an
    explanation, ids and formulas of what it found (other errors are estimated beside it); None of a
    calibration.
    """

    path: str
    values: Mapping[str, Array]
    biases: tuple[tuple[str, Array], ...]
    unnamed: tuple[str, ...]
    hidden: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    unsure: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    trust: Trust = field(default_factory=Trust)
    made: tuple[Mapping[str, Any], ...] = ()
    sha256: str = ""
    found: frozenset[str] | None = None


@dataclass(frozen=True)
class Corrected:
    """A corrected recording; taken: ids of what was taken off it; left: other ids, by reason."""

    recording: Recording
    taken: tuple[str, ...]
    left: Mapping[str, tuple[str, ...]]


def apply(
    recording: Recording, learnt: Learnt, *, biases: bool = False, in_place: bool = False
) -> Corrected:
    """The recording without the errors that were learnt.

    biases: take off also what differs from day to day; without them, of temperature errors what
    changes within the recording. in_place: every reading is kept, also of a late stream what then
    comes before the IMU's first; and the clock stays, by which other messages go too. Readings
    that are no measurements (saturated) stay as they are. Raises InputError where biases are asked
    for and the file has none for this recording, HandcalError where an error cannot be undone.
    """
    recording = at_its_temperature(recording)
    known = [*(BIASES if learnt.biases else ()), *learnt.values]
    why = {i: _reason(i, recording, biases) for i in known}
    values = {i: v for i, v in learnt.values.items() if not why[i]}
    bias, hidden = None, dict[str, str]()
    if biases:
        of, bias = _bias_of(recording, learnt)
        hidden = dict(learnt.hidden.get(of, {}))
        bias = np.where([a in hidden.get(i, "") for i in BIASES for a in "xyz"], 0.0, bias)
        why |= {i: NOT_KNOWN for i, axes in hidden.items() if axes == "xyz"}
    taking = [catalogue()[i] for i in values]
    out = _streams(recording, taking, values, in_place)
    acting = [e for e in taking if e.imu_error is not None and e.undo is None]
    about = _typical(learnt) if bias is None else bias
    # (what is corrected here is no longer what the vehicle's parameters made of its sensors)
    out = replace(out, imu=_imu(recording, acting, values, about, bias), vehicle={})
    if learnt.sha256:
        by = {**recording.corrected, learnt.sha256: Path(learnt.path).name}
        out = as_corrected(out, by)
    for e in taking:
        if e.undo is not None:
            undone = e.undo(values[e.id], out)
            if in_place and not np.array_equal(undone.imu.t, out.imu.t):
                why[e.id] = CLOCK
            else:
                out = undone
    left: dict[str, tuple[str, ...]] = {}
    for i, reason in why.items():
        if reason:
            left[reason] = (*left.get(reason, ()), i)
        elif i in hidden:
            left[NOT_KNOWN] = (*left.get(NOT_KNOWN, ()), f"{i} ({' and '.join(hidden[i])})")
    taken = tuple(i for i in known if not why[i])
    return Corrected(out, taken, left)


def _streams(
    recording: Recording, taking: Sequence[Effect], values: Mapping[str, Array], in_place: bool
) -> Recording:
    """The recording with what the other streams read too much, and their delays, taken off."""
    out = recording
    for row in STREAMS.values():
        own = [e for e in taking if _read_off(e, row)]
        if own and row.name in out.streams:
            series = _heading(out, row, own, values)
            out = replace(out, streams={**out.streams, row.name: series})
    for e in taking:
        stream = _delayed(e, recording)
        if stream:
            series, delay = out.streams[stream], float(values[e.id][0])
            earlier = replace(series, t=series.t - delay)
            series = earlier if in_place else shifted(series, -delay, recording.imu)
            out = replace(out, streams={**out.streams, stream: series})
    return out


def removable(effect: str, recording: Recording) -> bool:
    """Whether an effect, its parameters known, can be taken off a recording's readings."""
    return not _reason(effect, recording, biases=False)


def _reason(effect: str, recording: Recording, biases: bool) -> str:
    """Why an effect is left as it is; empty if it can be taken off."""
    known = catalogue().get(effect)
    if known is None or (known.of_one_day and not biases):
        return "" if biases else NOT_ASKED
    if known.world or known.process is not None or known.outliers:
        return NO_SENSOR
    if any(need not in recording.streams for need in known.needs if need in STREAMS):
        return NO_STREAM
    if known.imu_error is not None:
        return ""
    on = [s for s in streams_of(known) if s in recording.streams]
    if known.undo is None and not known.delays:
        on = [s for s in on if _read_off(known, STREAMS[s])]
    return "" if on else NO_STREAM


def _delayed(effect: Effect, recording: Recording) -> str:
    """The stream that an effect makes late, empty if none of them is there."""
    rows = [observed_by(kind) for kind in effect.delays]
    return next((row.name for row in rows if row and row.name in recording.streams), "")


def _read_off(effect: Effect, row: Stream) -> bool:
    """Whether the stream itself tells what the effect added to it: it reads what is observed."""
    kind = row.observation
    return row.circular and kind in effect.acts_on and kind not in effect.delays


# --- the readings -------------------------------------------------------------------------------


def _imu(
    recording: Recording, acting: Sequence[Effect], values: Mapping[str, Array], about: Array,
    bias: Array | None,
) -> Imu:  # fmt: skip
    """about (6,): the likely biases, which must not count as motion; bias: to be taken off."""
    imu = recording.imu
    raw = np.hstack([imu.gyro, imu.accel])
    needed = any(ATTITUDE in e.needs for e in acting)
    C_nb = Truth(recording, tuple(acting)).attitude(imu.t) if needed else None
    signals = of_recording(recording, acting, read=raw - about, C_nb=C_nb)
    ref = np.concatenate([np.zeros(0), *(values[e.id] for e in acting)])
    clean = raw - substituted(acting, ref, signals, enough=EXACT) - (0.0 if bias is None else bias)
    clean = np.where(imu.valid[:, None], clean, raw)
    valid = imu.valid
    for e in acting:
        if e.sound is not None:
            valid = valid & e.sound(-values[e.id], imu.t, imu.valid)
    return Imu(imu.t, clean[:, :3].copy(), clean[:, 3:].copy(), valid)


def _heading(
    recording: Recording, row: Stream, effects: Sequence[Effect], values: Mapping[str, Array]
) -> Series:
    """Headings (m, 1) less their errors, which depend on the true heading."""
    series, kind = recording.streams[row.name], observations()[row.observation]
    read, t = series.value[:, 0], series.t
    z = np.zeros((len(t), Z_DIM))
    z[:, TIME], z[:, WARMTH] = t - recording.imu.t[0], warmth_at(recording, t)

    known = Truth(recording, tuple(effects))
    before = [seen_columns(e, kind.kind, known.unbiased, t) @ values[e.id]
              for e in effects if kind.kind in e.seen]  # fmt: skip
    effects = [e for e in effects if kind.kind in e.observation_error]

    def error(yaw: Array, nav: Array) -> Array:
        # (the first of the body's axes, seen from n, points where the heading says)
        across = nav[:, 12].copy()
        level = np.sqrt(1.0 - np.where(np.isnan(across), 0.0, across) ** 2)
        z[:, 0] = yaw
        nav[:, 6], nav[:, 9] = level * np.cos(yaw), level * np.sin(yaw)
        errors = [observed_error(e, kind.kind, values[e.id], nav, z, 1)[:, 0] for e in effects]
        return np.asarray(sum([*before, *errors]))

    # (where the heading itself is all that matters, nothing else need be known)
    nav = np.full((len(t), NAV), np.nan)
    if np.isnan(error(read, nav)).any():
        nav = known.nav(t)
    yaw = read
    for _ in range(ROUNDS):
        last, yaw = yaw, read - error(yaw, nav)
        if np.abs(yaw - last).max() < FOUND:
            return Series(t, wrap(yaw)[:, None])
    raise HandcalError(
        "The irons turn the heading back on itself, so that no heading belongs to a reading."
    )


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
    return of_document(str(path), read_json(path))


def of_document(name: str, document: Any) -> Learnt:
    """The same of what was read already; name: of it, in messages."""
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in (EXPLANATION_SCHEMA, CALIBRATION_SCHEMA):
        raise InputError(
            f"{name} is not what `explain`, `calibrate`, `lab scalar`, `lab known-input` or `lab "
            "size` writes with --json (`export` takes that of `allan` too, for its noise)."
        )
    try:
        return _learnt(name, document)
    except (KeyError, TypeError, AttributeError, OverflowError):
        raise InputError(f"{name} lacks something that a {schema} has, or it is damaged.") from None


def _learnt(name: str, document: Mapping[str, Any]) -> Learnt:
    recordings = document.get("recordings", [])
    if document["schema"] == CALIBRATION_SCHEMA and recordings:
        raise InputError(
            f"{name} holds {len(recordings)} calibrations, each on its own; "
            "calibrate one recording, or explain several together."
        )
    told = [str(u["formula"]) for u in document.get("unnamed", [])]
    laws = [str(p["effect"]) for p in document["parameters"] if " += " in str(p["effect"])]
    formulas = tuple(i for i in dict.fromkeys((*told, *laws)) if i not in catalogue())
    other = {*observations(), *formulas}
    values = _values(name, document["parameters"], other)
    found, hidden = {"": values}, {"": _hidden(document["parameters"])}
    if recordings:
        found = {r["recording"]["path"]: _values(name, r["parameters"], other) for r in recordings}
        hidden = {r["recording"]["path"]: _hidden(r["parameters"]) for r in recordings}
    elif "recording" in document and document["schema"] == CALIBRATION_SCHEMA:
        found = {document["recording"]["path"]: values}
        hidden = {document["recording"]["path"]: hidden[""]}
    biases = [
        (of, np.concatenate([own[i] for i in BIASES]))
        for of, own in found.items()
        if all(i in own for i in BIASES)
    ]
    effects = {i: v for i, v in values.items() if i not in BIASES}
    whole = {*BIASES, *laws}
    unsure = {i: n for i, n in _untold(document["parameters"]).items() if i not in whole}
    made = [r["recording"] for r in recordings or [document] if "recording" in r]
    trust = of_itself(name, document)
    sha256 = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
    found_ids = (str(m["effect"]) for m in document.get("missing", []))
    of = frozenset((*found_ids, *told)) if "missing" in document else None
    return Learnt(
        name, effects, tuple(biases), formulas, hidden, unsure, trust, tuple(made), sha256, of
    )


def _untold(parameters: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, ...]]:
    """Parameters of each effect that were not shown, of those that have any."""
    out: dict[str, tuple[str, ...]] = {}
    for p in parameters:
        if p.get("observable") is False:
            out[p["effect"]] = (*out.get(p["effect"], ()), p["name"])
    return out


def not_shown(learnt: Learnt) -> str:
    """A sentence about errors that were not shown, which are not taken off; empty where
    there are none."""
    parts = [i + (f" ({', '.join(names)})" if i in learnt.values else "")
             for i, names in learnt.unsure.items()
             if catalogue()[i].misreads or i in learnt.values]  # fmt: skip
    return f"Not shown by the recordings, and left as it is: {'; '.join(parts)}." if parts else ""


def _hidden(parameters: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Axes of each bias that were not shown, of those that have any."""
    return {i: "".join(names) for i, names in _untold(parameters).items() if i in BIASES}


def _values(
    name: str, parameters: Sequence[Mapping[str, Any]], other: Set[str]
) -> dict[str, Array]:
    """By id, of effects of which something is shown; what is not shown is zero, but for biases and
    laws, which are found whole. other: what is no effect (formulas, how a marker is turned).
    Errors: InputError."""
    said: dict[str, dict[str, float]] = {}
    whole = {i for i in (str(p["effect"]) for p in parameters) if i in BIASES or "+=" in i}
    shown = {*whole, *(p["effect"] for p in parameters if p.get("shown", True))}
    for p in parameters:
        if p["effect"] not in shown:
            continue
        value = p["value"] if p["effect"] in whole or p.get("shown", True) else 0.0
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            value = math.nan
        said.setdefault(p["effect"], {})[p["name"]] = value
    out = {}
    for effect, named in said.items():
        if effect in other:
            continue
        if effect not in BIASES and effect not in catalogue():
            raise InputError(
                f"{name} has the effect '{effect}', of which nothing is known; if that is a file "
                "of your own, say --effects-from with its folder."
            )
        names = [*"xyz"] if effect in BIASES else [p.name for p in catalogue()[effect].parameters]
        numbers = np.array([named.get(name, math.nan) for name in names], dtype=np.float64)
        if named.keys() != set(names) or not np.isfinite(numbers).all():
            raise InputError(f"{name}: {effect} needs a finite number for {', '.join(names)}.")
        out[effect] = numbers
    return out

"""From the columns of a file to a Recording: one clock, one time base, nothing silent.

Whatever is repaired is said in Recording.warnings; what cannot be is an InputError.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._bursts import in_bursts, moved_along
from handcal.recordings.inputs._checks import (
    check_alive,
    rest_magnitude,
    saturated,
    slow_stamps,
    stuck,
    wrong_field,
)
from handcal.recordings.inputs._heading import check_heading_sense, check_heading_unit
from handcal.recordings.inputs._range import at_range_end
from handcal.recordings.streams import STREAMS
from handcal.types import Array, BoolArray, Imu, InputError, IntArray, Recording, Series

SHORTEST_S, FEWEST = 2.0, 50
LONGEST_GAP_S = 86_400.0  # beyond it a clock was set, or two recordings stand in one file
# Share of stamps that repeat from which they are rounded: a sensor that is read twice has half.
ROUNDED = 0.6
IMPOSSIBLE = 1e7  # in no stream's unit is this a reading
# Smaller extremes than these are no full scale (125 deg/s and 2 g are the smallest made).
SMALLEST_GYRO, SMALLEST_ACCEL = 2.0, 17.0


@dataclass(frozen=True)
class Columns:
    """One sensor as the file gave it, in SI.

    ns: (n,) stamps, ns since 1970 or since any other moment; value: (n, d);
    valid: (n,) False where the file itself says that this is no measurement; row: (n,) which of
    the file's readings each is.
    """

    ns: IntArray
    value: Array
    valid: BoolArray
    row: IntArray

    def rows(self, which: BoolArray | IntArray) -> Columns:
        return Columns(self.ns[which], self.value[which], self.valid[which], self.row[which])


def columns(ns: IntArray, value: Array, valid: BoolArray | None = None) -> Columns:
    """Columns, all of them valid unless told."""
    valid = np.ones(len(ns), dtype=np.bool_) if valid is None else valid
    return Columns(ns, value, valid, np.arange(len(ns)))


def nanoseconds(seconds: Array, factor: float = 1e9) -> IntArray:
    """Stamps as whole ns. Errors: InputError beyond what 64 bits hold."""
    if not np.all(np.abs(seconds) < 9e18 / factor):
        raise InputError(
            "A time stamp is not a number or further away than 280 years: are the stamps in ms, us "
            "or ns (--units time=ns)?"
        )
    return np.rint(seconds * factor).astype(np.int64)


def magnitude_at_rest(raw: Columns) -> float:
    """Of readings (n, 3) in the file's own unit, which gravity then tells; 0 without readings."""
    finite = raw.value[np.all(np.abs(raw.value) < IMPOSSIBLE, axis=1)]
    return rest_magnitude(finite, 100.0) if len(finite) else 0.0


def assemble(
    path: Path,
    gyro: Columns,
    accel: Columns,
    streams: Mapping[str, Columns],
    warnings: tuple[str, ...] = (),
) -> Recording:
    """One Recording on the gyro's stamps, the accelerometer interpolated onto them.

    gyro, accel (n, 3); streams as in types.Series. Errors: InputError.
    """
    said = list(warnings)
    gyro, accel, streams = _as_taken(gyro, accel, streams, said)
    if len(gyro.ns) == len(accel.ns) and np.array_equal(gyro.ns, accel.ns):
        both = columns(gyro.ns, np.hstack([gyro.value, accel.value]), gyro.valid & accel.valid)
        both = _masked(_clean(both, "IMU", said), "IMU", said)
        ns, rates, force, valid = both.ns, both.value[:, :3], both.value[:, 3:], both.valid
        rows = {"gyro": gyro.row[both.row], "accel": accel.row[both.row]}
    else:
        gyro = _masked(_clean(gyro, "gyroscope", said), "gyroscope", said)
        accel = _masked(_clean(accel, "accelerometer", said), "accelerometer", said)
        gyro, force, valid = _on_gyro_stamps(gyro, accel, said)
        ns, rates, rows = gyro.ns, gyro.value, {"gyro": gyro.row}
    t = (ns - ns[0]) / 1e9
    _check_enough(path, t, said)
    doubts, frozen = _doubts(path, t, rates, force)
    said += doubts
    if int((valid & ~frozen).sum()) < min(FEWEST, int(valid.sum())):
        raise InputError(f"{path}: hardly a reading is left to trust. {' '.join(doubts)}")
    valid = valid & ~frozen
    for name, stream in streams.items():
        if STREAMS[name].circular:
            when = (stream.ns - ns[0]) / 1e9
            check_heading_unit(t, rates, when, stream.value[:, 0])
            check_heading_sense(t, rates, force, when, stream.value[:, 0])
    inside = int(ns[0]), int(ns[-1])
    found = {name: _series(name, stream, *inside, said) for name, stream in streams.items()}
    series = {name: one for name, (one, _) in found.items() if one is not None}
    rows |= {name: row for name, (_, row) in found.items() if name in series}
    imu = Imu(t, np.ascontiguousarray(rates), np.ascontiguousarray(force), valid)
    # Stamps before 1973 count from something else than 1970: boot, or the start.
    start_ns = int(ns[0]) if ns[0] > 10**17 else 0
    return Recording(str(path), imu, series, start_ns, tuple(said), rows=rows)


def assemble_alone(
    path: Path,
    sensor: str,
    raw: Columns,
    streams: Mapping[str, Columns],
    warnings: tuple[str, ...] = (),
) -> Recording:
    """A Recording of one sensor (n, 3), "gyro" or "accel", on its stamps. Errors: InputError."""
    said, name = list(warnings), {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
    if (found := in_bursts(raw.ns, raw.value, name)) is not None:
        said.append(found.text)
        raw = replace(raw, ns=found.ns)
    raw = _masked(_clean(raw, name, said), name, said)
    t = (raw.ns - raw.ns[0]) / 1e9
    _check_enough(path, t, said)
    _check_clock(path, t)
    value, none = np.ascontiguousarray(raw.value), np.zeros_like(raw.value)
    said += _gap_warning(t)
    inside = int(raw.ns[0]), int(raw.ns[-1])
    kept = {n: _series(n, stream, *inside, said) for n, stream in streams.items()}
    series = {n: one for n, (one, _) in kept.items() if one is not None}
    both = (value, none) if sensor == "gyro" else (none, value)
    start_ns = inside[0] if inside[0] > 10**17 else 0
    imu = Imu(t, *both, raw.valid)
    return Recording(str(path), imu, series, start_ns, tuple(said), sensors=(sensor,))


def _as_taken(
    gyro: Columns, accel: Columns, streams: Mapping[str, Columns], said: list[str]
) -> tuple[Columns, Columns, Mapping[str, Columns]]:
    """The same at the times at which readings were taken, where they are stamped on arrival."""
    one = np.array_equal(gyro.ns, accel.ns)
    streams, old = dict(streams), gyro.ns
    found = in_bursts(gyro.ns, np.hstack([gyro.value, accel.value]) if one else gyro.value,
                      "IMU" if one else "gyroscope")  # fmt: skip
    if found is not None:
        said.append(found.text)
        gyro = replace(gyro, ns=found.ns)
        accel = replace(accel, ns=found.ns) if one else accel
    other = None if one else in_bursts(accel.ns, accel.value, "accelerometer")
    if other is not None:
        said.append(other.text)
        accel = replace(accel, ns=other.ns)
    for name, stream in streams.items():
        ns = stream.ns if found is None else moved_along(stream.ns, old, found.ns)
        own = None if STREAMS[name].own_clock or ns is not stream.ns else in_bursts(
            ns, stream.value, name
        )  # fmt: skip
        if own is not None:
            said.append(own.text)
        streams[name] = replace(stream, ns=ns if own is None else own.ns)
    return gyro, accel, streams


def _check_enough(path: Path, t: Array, said: list[str]) -> None:
    """Errors: InputError where readings at t (n,), s, are too few or too short."""
    if len(t) >= FEWEST and t[-1] >= SHORTEST_S:
        return
    lost = f" {' '.join(said)}" if said and len(t) < FEWEST else ""
    unit = ""
    if len(t) >= FEWEST:
        unit = " Are the stamps in another unit (--units time=ms, where there are columns)?"
    raise InputError(
        f"{path} holds {len(t)} IMU samples over {t[-1]:.1f} s; at least {FEWEST} over "
        f"{SHORTEST_S:.0f} s are needed.{lost}{unit}"
    )


def _doubts(path: Path, t: Array, gyro: Array, accel: Array) -> tuple[list[str], BoolArray]:
    """Warnings of what is odd about the readings, and which of them (n,) are no measurements.
    Errors: InputError for what cannot be."""
    slow = slow_stamps(t)
    if slow is None:
        _check_clock(path, t)
    elif float(np.diff(t).max()) > LONGEST_GAP_S:
        raise InputError(slow)
    said = check_alive(gyro, accel)
    halts, frozen = stuck(t, gyro, accel)
    ends, clipped = at_range_end(t, gyro, accel)
    return [*said, *halts, *ends, *_gap_warning(t)], frozen | clipped


def _check_clock(path: Path, t: Array) -> None:
    """Errors: InputError where t (n,), s, jumps as no recording pauses."""
    at = int(np.argmax(np.diff(t)))
    jump = float(t[at + 1] - t[at])
    if jump > LONGEST_GAP_S:
        raise InputError(
            f"{path}: time jumps by {jump:.3g} s after {t[at]:.1f} s: the clock was set, or these "
            "are two recordings; cut them apart there."
        )


def _clean(raw: Columns, name: str, said: list[str]) -> Columns:
    """Finite rows with increasing stamps. Errors: InputError if none, or time is a mess."""
    read, finite = raw, np.all(np.abs(raw.value) < IMPOSSIBLE, axis=1)
    bad = len(finite) - int(finite.sum())
    if bad:
        which = f"{name}: {_many(bad, 'row')} with NaN, infinite or impossible values"
        said.append(f"{which} {_were(bad)} dropped.")
        raw = raw.rows(finite)
    if len(raw.ns) == 0:
        raise InputError(f"There is not one {name} reading in this recording.{_never(read, name)}")
    backwards = raw.ns[:-1] - raw.ns[1:]
    count = int((backwards > 0).sum())
    if count:
        at = int(np.argmax(backwards))
        worst, when = float(backwards[at]) / 1e9, float(raw.ns[at] - raw.ns[0]) / 1e9
        if count > max(3, 0.01 * len(raw.ns)) or worst > 0.5:
            raise InputError(
                f"{name}: time runs backwards {_times(count)}, by up to {worst:.3g} s after "
                f"{when:.1f} s: these stamps cannot be put in order. Cut the "
                "recording there, or export it again."
            )
        said.append(
            f"{name}: {_many(count)} came late (up to {worst:.3g} s) and {_were(count)} sorted."
        )
        raw = raw.rows(np.argsort(raw.ns, kind="stable"))
    repeated = np.diff(raw.ns, prepend=raw.ns[0] - 1) == 0
    if repeated.any():
        count = int(repeated.sum())
        coarse = _rounded(raw, repeated)
        said.append(f"{name}: {_many(count)} with a repeated stamp {_were(count)} dropped{coarse}.")
        raw = raw.rows(~repeated)
    return raw


def _never(read: Columns, name: str) -> str:
    """Which columns of what was read hold no number at all, if there are such."""
    lost = np.flatnonzero(~np.any(np.abs(read.value) < IMPOSSIBLE, axis=0))
    if not len(read.ns) or not len(lost):
        return ""
    sensors = ("gyroscope", "accelerometer") if name == "IMU" else (name,)
    names = [f"{s} {a}" for s in sensors for a in "xyz"]
    listed = ", ".join(names[k] for k in lost) if len(names) == read.value.shape[1] else name
    return f" Of its {_many(len(read.ns), 'row')} none has a number for {listed}."


def _rounded(raw: Columns, repeated: BoolArray) -> str:
    """That stamps are too coarse, where many repeat and what was read does not."""
    differs = np.any(np.diff(raw.value, axis=0) != 0.0, axis=1)
    if repeated.mean() < ROUNDED or np.mean(differs[repeated[1:]]) < 0.5:
        return ""
    step = float(np.median(np.diff(raw.ns[~repeated]))) / 1e9 if (~repeated).sum() > 1 else 0.0
    return (
        f": the stamps are rounded (to {step:.3g} s, where there are "
        f"{1.0 / (1.0 - repeated.mean()):.0f} readings), and what was read in between is lost; "
        "export them with more digits"
    )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _masked(raw: Columns, name: str, said: list[str]) -> Columns:
    """Columns with saturated readings marked as not valid. (n, 3), or (n, 6) gyro and accel."""
    clipped = np.zeros(len(raw.ns), dtype=np.bool_)
    if name != "accelerometer":
        clipped |= saturated(raw.value[:, :3], SMALLEST_GYRO)
    if name != "gyroscope":
        clipped |= saturated(raw.value[:, -3:], SMALLEST_ACCEL)
    if clipped.any():
        said.append(
            f"{name}: {int(clipped.sum())} samples sit at the end of the measuring range "
            "(saturated) and are not trusted."
        )
    return replace(raw, valid=raw.valid & ~clipped)


def _on_gyro_stamps(
    gyro: Columns, accel: Columns, said: list[str]
) -> tuple[Columns, Array, BoolArray]:
    """Gyro over the common time, the specific force at its stamps, and which are valid."""
    common = (gyro.ns >= accel.ns[0]) & (gyro.ns <= accel.ns[-1])
    if not common.any():
        raise InputError("Gyroscope and accelerometer have no time in common.")
    lost = len(common) - int(common.sum())
    if lost:
        which = _many(lost, "gyroscope reading")
        said.append(f"{which} outside the accelerometer's time {_were(lost)} dropped.")
    gyro = gyro.rows(common)
    zero = gyro.ns[0]
    t, ta = (gyro.ns - zero) / 1e9, (accel.ns - zero) / 1e9
    force = np.column_stack([np.interp(t, ta, axis) for axis in accel.value.T])
    right = np.searchsorted(accel.ns, gyro.ns, side="left")
    left = np.where(accel.ns[right] == gyro.ns, right, right - 1)
    # A straight line across a gap is not a measurement.
    gap = ta[right] - ta[left] > _gap_limit(ta)
    if gap.any():
        inside = int(gap.sum())
        verb = "is" if inside == 1 else "are"
        said.append(f"accelerometer: {_many(inside)} inside its gaps {verb} not trusted.")
    return gyro, force, gyro.valid & accel.valid[left] & accel.valid[right] & ~gap


def _gap_limit(t: Array) -> float:
    return 5 * float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def _gap_warning(t: Array) -> list[str]:
    steps = np.diff(t)
    count = int((steps > _gap_limit(t)).sum())
    if not count:
        return []
    at = int(np.argmax(steps))
    return [
        f"The IMU has {count} gap{'s' if count > 1 else ''}, the longest of "
        f"{steps[at]:.3g} s at {t[at]:.1f} s."
    ]


def _series(
    name: str, raw: Columns, first_ns: int, last_ns: int, said: list[str]
) -> tuple[Series | None, IntArray]:
    """A further stream over the IMU's time, or None if nothing of it is left; and of which of the
    file's readings."""
    none = None, np.zeros(0, dtype=np.int64)
    raw = raw.rows(raw.valid)
    if not np.all(np.abs(raw.value) < IMPOSSIBLE, axis=1).any():
        said.append(f"{name}: not one usable reading; the stream was left out.")
        return none
    if name == "mag" and (wrong := wrong_field(raw.value)):
        said.append(wrong)
        return none
    raw = _clean(raw, name, said)
    row = STREAMS[name]
    if row.inertial:
        raw = _masked(raw, name, said)
        raw = raw.rows(raw.valid)
    inside = (raw.ns >= first_ns) & (raw.ns <= last_ns)
    if not inside.any():
        said.append(f"{name}: no reading within the IMU's time; the stream was left out.")
        return none
    raw = raw.rows(inside)
    value = raw.value
    if row.circular:
        value = value - 2 * np.pi * np.ceil((value - np.pi) / (2 * np.pi))
    if row.posed:
        raw, value = _unit_quaternions(name, raw, said)
        if not len(value):
            return none
    return Series((raw.ns - first_ns) / 1e9, np.ascontiguousarray(value)), raw.row


def _unit_quaternions(name: str, raw: Columns, said: list[str]) -> tuple[Columns, Array]:
    """Poses (m, 7) with unit quaternions that do not jump to their negative."""
    norm = np.linalg.norm(raw.value[:, 3:], axis=1)
    usable = norm > 0.1
    if not usable.all():
        count = int((~usable).sum())
        said.append(f"{name}: {_many(count, 'row')} without an orientation {_were(count)} dropped.")
        raw, norm = raw.rows(usable), norm[usable]
    q = raw.value[:, 3:].copy()
    # Nothing changes on the second reading: a recording written and read again stays equal.
    off = np.abs(norm - 1) > 1e-9
    q[off] /= norm[off, None]
    flips = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    q[1:] *= np.cumprod(flips)[:, None]
    return raw, np.hstack([raw.value[:, :3], q])


def _many(count: int, noun: str = "reading") -> str:
    """1 reading, 2 readings."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _were(count: int) -> str:
    return "was" if count == 1 else "were"

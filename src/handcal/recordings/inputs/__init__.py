"""Recordings from files: one file per format, found by listing this folder.

A format is a module here with ``can_read(path) -> bool``, which looks at the content,
``read(path, options) -> Recording`` and ``UNDERSTOOD``, half a sentence for the message
to people whose file fits none. It may say more: ``UNITS``, a sentence on units and signs in the
file; ``STREAMS_READ``, what is read of it; ``TRIED``, on which files (docs/formats.md is made of
these); ``MARK``, what a file of another format shows that has one of the ``ENDINGS``;
``ENDINGS`` of its name and ``MEMBERS`` that a folder or zip holds, by which the nearest format is
found for a file that fits none; ``LAST``, where other formats are to be asked first; ``TABLE``,
where the user may name columns and rate. Modules that
begin with an underscore are shared.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from handcal.documents import reading
from handcal.recordings.inputs._cut import said_of_cuts
from handcal.recordings.inputs._health import checked
from handcal.recordings.inputs._nearest import of_no_format
from handcal.recordings.inputs._options import HALVES, Options, checked_options, quantities
from handcal.recordings.inputs._repair import Columns, assemble, columns, nanoseconds
from handcal.recordings.inputs._zip import check_crowd, listed_once
from handcal.types import Array, InputError, Recording

__all__ = ["Options", "format_of", "formats", "load", "of_arrays", "quantities"]


def formats() -> list[ModuleType]:
    """The modules of all formats, in the order in which they are asked."""
    names = sorted(m.name for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))
    modules = [importlib.import_module(f"{__name__}.{name}") for name in names]
    return sorted(modules, key=lambda module: bool(getattr(module, "LAST", False)))


def format_of(path: str | Path) -> ModuleType:
    """The format of a file or folder. Errors: InputError, one sentence, where it is of none."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist.")
    if path.is_file() and path.stat().st_size == 0:
        raise InputError(f"{path} is empty: it holds not a single byte.")
    known = formats()
    with reading(path), listed_once():
        check_crowd(path)
        found = next((module for module in known if module.can_read(path)), None)
        if found is None:
            raise InputError(of_no_format(path, known))
    return found


def load(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    axes: Mapping[str, str] | None = None,
    needs: tuple[str, ...] = HALVES,
) -> Recording:
    """Read a recording of any format that a module of this folder understands.

    topics: which MCAP topic is which stream ({"imu": "/phone/imu"}; "" leaves the stream
    out). units: of a quantity in the file ({"accel": "g", "gyro": "deg/s"}) where it is not
    as the format states, also by a number ("g/16384"). progress: called with the fraction read so
    far, 0 to 1. columns: of a table, in their order ("t", "gx", "-"). rate_hz: of a table without
    times, or whose time counts samples. axes: of a sensor, which of its axes stand for the IMU's
    x, y, z ({"mag": "y,x,-z"}). needs: which of "gyro" and "accel" there have to be; of what is not
    needed there may be none.

    Errors: InputError, one sentence, for whatever is wrong with the file or the options.
    """
    path = Path(path)
    options = checked_options(topics, units, progress, columns, rate_hz, axes)
    options = replace(options, needs=needs)
    module = format_of(path)
    if (columns or rate_hz) and not getattr(module, "TABLE", False):
        raise InputError(
            f"{path} says itself what is in it and when: --columns and --rate are for tables."
        )
    # Absurd numbers become infinite or NaN in conversion, and are dropped and told.
    with reading(path), said_of_cuts() as cut, np.errstate(over="ignore", invalid="ignore"):
        recording: Recording = on_axes(module.read(path, options), options)
    if topics and not recording.topics:
        raise InputError(f"{path} has no topics, of which --topic could choose one.")
    # (a table that holds two sensors is read for both)
    recording = replace(recording, warnings=(*recording.warnings, *dict.fromkeys(cut)))
    stated = [*options.units, *(f"{sensor}'s axes" for sensor in options.axes)]
    return checked(recording, [*stated, *(["time"] if rate_hz else [])])


def on_axes(recording: Recording, options: Options) -> Recording:
    """The recording with gyro, accelerometer and magnetometer on the axes that the user names.
    Errors: InputError for a sensor that it does not have."""
    imu, streams = recording.imu, dict(recording.streams)
    if "mag" in options.axes:
        if "mag" not in streams:
            raise InputError(f"{recording.path} has no magnetometer, for --axes mag=....")
        mag = streams["mag"]
        streams["mag"] = replace(mag, value=options.on_axes("mag", mag.value))
    gyro, accel = options.on_axes("gyro", imu.gyro), options.on_axes("accel", imu.accel)
    return replace(recording, imu=replace(imu, gyro=gyro, accel=accel), streams=streams)


def of_arrays(
    name: str,
    t: Array,
    gyro: Array,
    accel: Array,
    streams: Mapping[str, tuple[tuple[Array, Array], int]],
) -> Recording:
    """A recording of arrays in SI, repaired and checked as a file's columns are.

    t (n,) s; gyro, accel (n, 3); streams: by name, (t (m,), values (m, d)) and d. Errors:
    InputError, one sentence, where shapes do not fit or nothing can be made of the numbers.
    """
    imu = (_columns("gyro", t, gyro, 3), _columns("accel", t, accel, 3))
    further = {n: _pair(n, pair, width) for n, (pair, width) in streams.items()}
    return checked(assemble(Path(name), *imu, further))


def _pair(name: str, pair: tuple[Array, Array], width: int) -> Columns:
    """A stream's readings. Errors: InputError where they are not given with their times."""
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(
            f"{name} takes its times and its values, {name}=(t, values), no {type(pair).__name__}"
            f"{f' of {len(pair)}' if isinstance(pair, tuple | list) else ' alone'}."
        )
    return _columns(name, *pair, width)


def _columns(name: str, t: Array, value: Array, width: int) -> Columns:
    """Readings (n, width) at times t (n,), of anything that numpy can make an array of."""
    if np.iscomplexobj(t) or np.iscomplexobj(value):
        raise InputError(f"{name}: the numbers are complex; real ones are needed.")
    try:
        t, value = np.asarray(t, dtype=np.float64), np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: what is given are no arrays of numbers.") from None
    value = value[:, None] if width == 1 and value.ndim == 1 else value
    if t.ndim != 1 or value.shape != (len(t), width):
        raise InputError(
            f"{name}: times of shape {t.shape} and values of shape {value.shape} do not fit; "
            f"(n,) and (n, {width}) are needed."
        )
    if not np.isfinite(t).all():
        raise InputError(f"{name}: a time is not a number.")
    return columns(nanoseconds(t), value)

"""MATLAB files (.mat, versions 5 to 7) with named arrays: t (n,), gyro (n, 3), accel (n, 3).

Further mag (n, 3), temp and heading (n,); the names are those of plain CSV's columns, one array for
three axes or one for each, lying or standing. MATLAB states no units: they are SI (s, rad/s, m/s^2
with +g on the axis up at rest, tesla, degC, rad) unless `--units` says otherwise, and gravity is
asked whether that can be. Arrays of another length than the longest are not read. Read with
scipy.io, after its sizes have been checked; version 7.3 is HDF5 and is not read.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._zip import LARGEST, LARGEST_RATIO, RATIO_FROM
from handcal.recordings.inputs.plain_csv import of_named
from handcal.types import Array, InputError, Recording

UNDERSTOOD = "a MATLAB file with arrays t, gyro, accel (.mat)"
UNITS = "SI unless --units says otherwise (s, rad/s, m/s^2, tesla); at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "files written by scipy.io"
ENDINGS = (".mat",)
MARK = "it does not begin with MATLAB"
_NUMBERS = {"double", "single", "int8", "int16", "int32", "int64",
            "uint8", "uint16", "uint32", "uint64"}  # fmt: skip
_COMPRESSED = 15
_DAMAGED = (struct.error, ValueError, LookupError, TypeError, AttributeError, AssertionError,
            ArithmeticError, EOFError, NotImplementedError, RecursionError, zlib.error)  # fmt: skip


def can_read(path: Path) -> bool:
    """By its first bytes."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(7) == b"MATLAB "


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    arrays = _arrays(path)
    options.progress(1.0)
    named: dict[str, Array] = {}
    for name, value in arrays.items():
        if 1 in value.shape:
            named[name] = value.ravel()
        elif 3 in value.shape:
            axes = value.T if value.shape[1] == 3 else value
            named |= {f"{name}{axis}": one for axis, one in zip("xyz", axes, strict=True)}
    size = max((len(one) for one in named.values()), default=0)
    return of_named(path, {n: one for n, one in named.items() if len(one) == size}, options)


def _arrays(path: Path) -> dict[str, Array]:
    """Matrices of real numbers by name. Errors: InputError."""
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        if file.read(10) != b"MATLAB 5.0":
            raise InputError(f"{path} is not of MATLAB's versions 5 to 7: save it with '-v7'.")
    _check_sizes(path)
    try:
        held = [row for row in whosmat(path) if row[2] in _NUMBERS and len(row[1]) == 2]
        if sum(8 * int(np.prod(shape, dtype=np.float64)) for _, shape, _ in held) > LARGEST:
            raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB of numbers.")
        found = loadmat(path, variable_names=[name for name, _, _ in held])
    except (MatReadError, *_DAMAGED) as error:
        raise InputError(f"{path} is a damaged MATLAB file: {error}.") from error
    arrays = {n: found[n] for n, _, _ in held if isinstance(found.get(n), np.ndarray)}
    return {n: a for n, a in arrays.items() if a.ndim == 2 and a.dtype.kind in "iuf"}


def _check_sizes(path: Path) -> None:
    """Errors: InputError where an array would unpack to what no recording does."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} is too large to be read at once.")
    data, at = path.read_bytes(), 128
    order = ">" if data[126:128] == b"MI" else "<"
    unpacked = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        if kind == _COMPRESSED:
            most = max(RATIO_FROM, LARGEST_RATIO * length)
            packed = data[at + 8 : at + 8 + length]
            try:
                size = len(zlib.decompressobj().decompress(packed, most + 1))
            except zlib.error as error:
                raise InputError(f"{path} is a damaged MATLAB file: {error}.") from error
            unpacked += size
            if size > most or unpacked > LARGEST:
                raise InputError(f"{path} would unpack to too much; it was not read.")
        at += 8 + length

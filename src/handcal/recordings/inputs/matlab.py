"""MATLAB files (.mat, versions 5 to 7) with named arrays: t (n,), gyro (n, 3), accel (n, 3).

Further mag (n, 3), temp and heading (n,); the names are those of plain CSV's columns, one array for
three axes or one for each, lying or standing. MATLAB states no units: they are SI (s, rad/s, m/s^2
with +g on the axis up at rest, tesla, degC, rad) unless `--units` says otherwise, and gravity is
asked whether that can be. Arrays of another length than the longest are not read. Of one matrix
alone, ``--columns`` names the columns. Version 7.3 is HDF5 and is not read. Parsed here as
MathWorks documents the format, because scipy.io.loadmat ends in a segmentation fault on some
damaged files.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._table import of_arrays, of_matrix
from handcal.recordings.inputs._zip import LARGEST, LARGEST_RATIO, RATIO_FROM, whole
from handcal.types import Array, InputError, Recording

UNDERSTOOD = "a MATLAB file with arrays t, gyro, accel, or one matrix (.mat)"
TABLE = True
UNITS = "SI unless --units says otherwise (s, rad/s, m/s^2, tesla); at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "files written by scipy.io, lying and standing, packed and not"
ENDINGS = (".mat",)
MARK = "it does not begin with MATLAB"
HEADER = 128
_MATRIX, _COMPRESSED, _COMPLEX = 14, 15, 0x0800
_NUMBERS = range(6, 16)  # classes of arrays: double, single, int8 to uint64
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}


def can_read(path: Path) -> bool:
    """By its first bytes."""
    return begins_with(path, b"MATLAB ")


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
    tables = [m for m in arrays.values() if min(m.shape) > 3 and max(m.shape) >= size]
    if options.columns:  # (which of several is meant, their number tells)
        tables = [m for m in tables if min(m.shape) >= len(options.columns)]
    if tables and (options.columns or not named):
        return of_matrix(path, max(tables, key=np.size), options)
    return of_arrays(path, {n: one for n, one in named.items() if len(one) == size}, options)


def _arrays(path: Path) -> dict[str, Array]:
    """Matrices of real numbers by name. Errors: InputError."""
    data = whole(path)
    if not data.startswith(b"MATLAB 5.0"):
        raise InputError(f"{path} is not of MATLAB's versions 5 to 7: save it with '-v7'.")
    order = ">" if data[126:128] == b"MI" else "<"
    found: dict[str, Array] = {}
    left = LARGEST
    for kind, content in _elements(memoryview(data)[HEADER:], order):
        if kind == _COMPRESSED:
            unpacked = _unpacked(path, content, left)
            left -= len(unpacked)
            inner = list(_elements(memoryview(unpacked), order))
        else:
            inner = [(kind, content)]
        for inside, matrix in inner:
            if inside == _MATRIX:
                found |= _matrix(matrix, order)
    return found


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of one element after the other, until one is not whole."""
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        begin, following = at + 8, at + 8 + length
        if kind >> 16:  # (up to four bytes in the tag itself)
            kind, length, begin, following = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        elif kind != _COMPRESSED:
            following += -length % 8
        if begin + length > len(data) or (begin == at + 4 and length > 4):
            return
        yield kind, data[begin : begin + length]
        at = following


def _unpacked(path: Path, packed: memoryview, left: int) -> bytes:
    """A compressed element, within bounds. Errors: InputError."""
    most = min(left, max(RATIO_FROM, LARGEST_RATIO * len(packed)))
    try:
        unpacked = zlib.decompressobj().decompress(packed, most + 1)
    except zlib.error as error:
        raise InputError(f"{path} is a damaged MATLAB file: {error}.") from error
    if len(unpacked) > most:
        raise InputError(f"{path} would unpack to too much; it was not read.")
    return unpacked


def _matrix(content: memoryview, order: str) -> dict[str, Array]:
    """A matrix of real numbers by its name; nothing of any other array."""
    parts = list(islice(_elements(content, order), 4))  # flags, dimensions, name, real part
    if len(parts) < 4 or len(parts[0][1]) < 4 or len(parts[1][1]) != 8:
        return {}
    (flags,) = struct.unpack_from(f"{order}I", parts[0][1])
    shape = struct.unpack(f"{order}2i", parts[1][1])
    kind, numbers = parts[3]
    if flags & 0xFF not in _NUMBERS or flags & _COMPLEX or kind not in _TYPES or min(shape) < 1:
        return {}
    dtype = np.dtype(order + _TYPES[kind])
    if shape[0] * shape[1] * dtype.itemsize != len(numbers):
        return {}
    value = np.frombuffer(numbers, dtype=dtype).reshape(shape, order="F")
    name = bytes(parts[2][1]).decode("ascii", "replace")
    return {name: value.astype(dtype.newbyteorder("="))}

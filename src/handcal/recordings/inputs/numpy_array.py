"""NumPy arrays (.npy): one matrix, whose columns ``--columns`` names, or records with names.

Names and units as those of a table in text. Arrays of Python objects are not read.
"""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError

import numpy as np

from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._table import of_arrays, of_matrix
from handcal.recordings.inputs._zip import LARGEST
from handcal.types import InputError, Recording

UNDERSTOOD = "a NumPy array of columns t, gx, gy, gz, ax, ay, az (.npy)"
UNITS = "SI unless names or --units say otherwise; at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "files written by numpy"
ENDINGS = (".npy",)
MARK = "it does not begin with NUMPY"
TABLE = True
# (numpy reads the header as Python does)
_DAMAGED = (ValueError, EOFError, SyntaxError, OverflowError, TypeError, MemoryError, TokenError,
            RecursionError)  # fmt: skip


def can_read(path: Path) -> bool:
    """By its first bytes."""
    return begins_with(path, b"\x93NUMPY")


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB: cut it into parts.")
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except _DAMAGED as error:
        raise InputError(f"{path} is a damaged NumPy file, or of objects: {error}.") from error
    options.progress(1.0)
    if array.dtype.names and array.ndim == 1:
        named = {name: np.array(array[name]) for name in array.dtype.names}
        if all(one.dtype.kind in "iuf" and one.ndim == 1 for one in named.values()):
            return of_arrays(path, named, options)
    if array.ndim != 2 or array.dtype.kind not in "iuf" or not array.size:
        raise InputError(
            f"{path} holds an array of {array.dtype}, of shape {array.shape}: rows of numbers are "
            "needed, a column each for t, gx, gy, gz, ax, ay, az."
        )
    return of_matrix(path, np.array(array), options)

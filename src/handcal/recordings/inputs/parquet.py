"""Parquet tables, read with pyarrow: columns as those of plain CSV.

Names as in a CSV's header, with a unit in brackets or in SI: t, gx gy gz, ax ay az, mx my mz, temp,
heading; at rest +g on the axis up, and gravity is asked whether the unit can be. A column of
Parquet's own time stamps states its unit. What a file says of its size is checked before a column
is read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handcal.recordings.inputs._magic import begins_with
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._table import of_arrays
from handcal.recordings.inputs._zip import LARGEST
from handcal.types import Array, InputError, Recording

UNDERSTOOD = "a Parquet table with columns t, gx, gy, gz, ax, ay, az (.parquet)"
UNITS = "as the names' brackets say, else SI; at rest +g on the axis up"
STREAMS_READ = "IMU, magnetometer, temperature, heading"
TRIED = "tables written by pyarrow"
ENDINGS = (".parquet",)
MARK = "it does not begin with PAR1"
TABLE = True
MOST_COLUMNS = 1000


def can_read(path: Path) -> bool:
    """By its first bytes."""
    return begins_with(path, b"PAR1")


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
            if len(schema) > MOST_COLUMNS or 8 * file.metadata.num_rows * len(schema) > LARGEST:
                raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB of numbers.")
            wanted = [f.name for f in schema if _is_number(pa, f.type)]
            table = file.read(columns=wanted, use_threads=False)
        named: dict[str, Array] = {}
        for name in dict.fromkeys(wanted):
            column = table.column(name)
            if pa.types.is_timestamp(column.type):
                unit, column = column.type.unit, column.cast(pa.int64())
                name = name if "(" in name else f"{name} ({unit})"
            named[name] = np.asarray(column.to_numpy())
    except (pa.ArrowException, KeyError, OSError, OverflowError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is a damaged Parquet file: {error}.") from error
    options.progress(1.0)
    return of_arrays(path, named, options)


def _is_number(pa: object, kind: object) -> bool:
    """Of integers, floats or time stamps."""
    types = pa.types  # type: ignore[attr-defined]
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_timestamp(kind))

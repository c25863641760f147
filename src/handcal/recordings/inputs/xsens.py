"""Text exports of Xsens and Movella: MT Manager (.txt, .csv) and DOT (.csv).

Columns Acc_X, Gyr_X and so on, behind lines about the device. Acc is in m/s^2 with +g on the axis
up at rest. Gyr is in rad/s in MT Manager's files, in deg/s in DOT's; gravity is asked whether that
can be, and `--units gyro=...` overrules it. SampleTimeFine counts 0.1 ms in an MTi, 1 us in a DOT,
and wraps at 2^32; without it PacketCounter counts the samples of the stated rate, and wraps at
2^16. FreeAcc has no gravity in it and is not read; Mag is in parts of the field where the device
was calibrated, of which no tesla can be made: it is left out, and that is said.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import Rows, numbers, places, plain_name, rows_of
from handcal.recordings.inputs._zip import whole
from handcal.types import Array, InputError, IntArray, Recording

UNDERSTOOD = "a text export of Xsens or Movella, MT Manager or DOT (.txt, .csv)"
UNITS = (
    "m/s^2, at rest +g on the axis up; gyroscope rad/s of MT Manager, deg/s of DOT; SampleTimeFine "
    "0.1 ms of MTi, 1 us of DOT"
)
STREAMS_READ = "IMU, temperature"
TRIED = "files written by the layout of the manuals"
ENDINGS = (".txt",)
MARK = "it has no line with the columns Acc_X and Gyr_X"
_HEAD = 8192
_RATE = re.compile(r"(?:Update Rate|OutputRate|Output Rate)\W*([\d.]+)\s*Hz", re.IGNORECASE)
_DEVICE = re.compile(r"^\W*Device ?(?:Id|Tag)[:,\s]+([^,\s][^,\r\n]{,99})", re.I | re.M)
_FINE, _COUNTER = ("sampletimefine",), ("packetcounter", "counter")


def can_read(path: Path) -> bool:
    """By a line among the first that names the columns."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _header(file.read(_HEAD)) is not None


def _header(start: bytes) -> int | None:
    """Where the line with the names of the columns begins."""
    match = re.search(rb"^[^\n]*\bAcc_X\b[^\n]*$", start, re.MULTILINE)
    return match.start() if match and b"Gyr_X" in match[0] else None


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    content = whole(path)
    at = _header(content[:_HEAD]) or 0
    before = content[:at].decode("utf-8-sig", "replace")
    rows = rows_of(content[at:], str(path))
    options.progress(0.5)
    if not rows.body:
        raise InputError(f"{path} has a header but no rows.")
    dot = not before.lstrip().startswith("//") and bool(re.search(r"DeviceTag|DOT", before))
    ns, said = _clock(rows, before, dot)
    factor = options.factor("gyro", "deg/s" if dot else "rad/s")
    gyro = numbers(rows, places(rows, ("gyr_x", "gyr_y", "gyr_z"))) * factor
    accel = numbers(rows, places(rows, ("acc_x", "acc_y", "acc_z"))) * options.factor("accel")
    plain = [plain_name(name) for name in rows.names]
    streams: dict[str, Columns] = {}
    if "mag_x" in plain:
        said.append("mag: its unit is the field at its calibration, not tesla; it was left out.")
    if "temperature" in plain:
        streams["temperature"] = columns(ns, numbers(rows, places(rows, ("temperature",))))
    options.progress(1.0)
    made = assemble(path, columns(ns, gyro), columns(ns, accel), streams, tuple(said))
    device = _DEVICE.search(before)
    return replace(made, device=device[1].strip() if device else "")


def _clock(rows: Rows, before: str, dot: bool) -> tuple[IntArray, list[str]]:
    """Stamps in ns, and warnings. Errors: InputError where neither clock nor rate is known."""
    plain = [plain_name(name) for name in rows.names]
    match = _RATE.search(before)
    rate = float(match[1]) if match and match[1].count(".") < 2 and match[1] != "." else 0.0
    for names, bits in ((_FINE, 32), (_COUNTER, 16)):
        name = next((n for n in names if n in plain), None)
        if name is None:
            continue
        ticks = _unwrapped(numbers(rows, [plain.index(name)])[:, 0], bits, rows.where)
        if names == _FINE:
            tick = 1_000 if dot else 100_000
            return ticks * tick, _doubts(ticks * tick, rate)
        if 1.0 <= rate <= 10_000.0:
            said = f"Stamps are counted samples at the stated {rate:g} Hz."
            return np.rint(ticks * (1e9 / rate)).astype(np.int64), [said]
    raise InputError(f"{rows.where} has neither SampleTimeFine nor a counter and an update rate.")


def _doubts(ns: IntArray, rate: float) -> list[str]:
    """A warning where the clock's rate is far from the stated one."""
    own = 1e9 / max(1.0, float(np.median(np.diff(ns)))) if len(ns) > 1 else rate
    if rate and not 0.8 < own / rate < 1.25:
        return [f"SampleTimeFine gives {own:.4g} Hz, where {rate:g} Hz is stated."]
    return []


def _unwrapped(counts: Array, bits: int, where: str) -> IntArray:
    """Counts (n,) that go on where the device's begin at 0 again. Errors: InputError."""
    if not np.all((counts >= 0) & (counts < 2**32)):
        raise InputError(f"{where}: a count of time is no whole number below 2^32.")
    whole = counts.astype(np.int64)
    wraps = np.diff(whole, prepend=whole[:1]) < -(2 ** (bits - 1))
    unwrapped: IntArray = whole + np.cumsum(wraps) * 2**bits
    return unwrapped

"""Folders and zips in the ASL format of the EuRoC and TUM VI data sets: mav0/imu0/data.csv.

Stamps in ns, rate in rad/s, specific force in m/s^2 (at rest +g on the axis up), in the IMU's own
axes. The pose is the first of mocap0, vicon0 and state_groundtruth_estimate0: m and a quaternion
w x y z from the body's axes to the instrument's world. The last of them was estimated with this
very IMU's readings, which is said. leica0 holds positions alone and is not a pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import numbers, rows_of, times
from handcal.recordings.inputs._zip import contents, listing, stated
from handcal.types import InputError, Recording

UNDERSTOOD = "a folder or zip in the ASL format of EuRoC and TUM VI (mav0/imu0/data.csv)"
UNITS = "rad/s, m/s^2, m, stamps in ns; at rest +g on the axis up; quaternion w x y z"
STREAMS_READ = "IMU, pose (mocap0, vicon0, state_groundtruth_estimate0)"
TRIED = "files written by the data sets' documented layout"
_IMU = "imu0"
_POSES = ("mocap0", "vicon0", "state_groundtruth_estimate0")
_WANTED = (_IMU, *_POSES, "leica0")


def can_read(path: Path) -> bool:
    """By the place of the IMU's file."""
    return _IMU in {_sensor(name) for name in listing(_root(path)) or ()}


def _root(path: Path) -> Path:
    """The folder that holds the sensors."""
    return path / "mav0" if (path / "mav0").is_dir() else path


def _sensor(name: str) -> str:
    """``mav0/imu0/data.csv`` is imu0."""
    parts = name.split("/")
    return parts[-2] if len(parts) > 1 and parts[-1] == "data.csv" else ""


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    found = contents(_root(path), lambda name: _sensor(name) in _WANTED, options)
    files = {_sensor(name): text for name, text in sorted(found.items(), reverse=True)}
    if not files.get(_IMU, b"").strip():
        raise InputError(f"{path}: {_IMU}/data.csv is empty.")
    imu = _table(path, _IMU, files[_IMU], 6)
    options.progress(1.0)
    said = list(stated("The ASL format", options))
    streams = _pose(path, files, said)
    gyro, accel = columns(imu.ns, imu.value[:, :3]), columns(imu.ns, imu.value[:, 3:])
    return assemble(path, gyro, accel, streams, tuple(said))


def _pose(path: Path, files: Mapping[str, bytes], said: list[str]) -> dict[str, Columns]:
    """The pose of the best instrument there is."""
    there = [name for name in _POSES if files.get(name, b"").strip()]
    if not there:
        if "leica0" in files:
            said.append("leica0 holds positions without attitude: it is left out.")
        return {}
    if there[0] == _POSES[-1]:
        said.append(
            f"pose: {there[0]} was estimated with the readings of this IMU, so it knows less "
            "of their errors than an instrument's would."
        )
    return {"pose": _table(path, there[0], files[there[0]], 7)}


def _table(path: Path, name: str, content: bytes, width: int) -> Columns:
    """Stamps and the columns behind them; the header is a comment, the order is fixed."""
    rows = rows_of(content, f"{path}: {name}/data.csv", header=False, separator=",")
    return columns(times(rows, 0, 1.0), numbers(rows, range(1, width + 1)))

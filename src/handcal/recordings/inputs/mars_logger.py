"""Folders and zips of MARS logger (Android, iOS), or its gyro_accel.csv alone.

gyro_accel.csv: ns since the phone was switched on, rate in rad/s, specific force in m/s^2, of both
systems in Android's signs (at rest the axis up reads +g). On iOS the app makes m/s^2 of g by 9.80,
which is put right; its header is known by the blanks between the columns. On Android the readings
are those that the system has corrected. arcore_poses.csv, where ARCore was switched on: m and a
quaternion x y z w from the camera's axes to a world with y up, which is turned so that z is up, on
the clock of the sensors; only rows that were tracked, and of them those of the world that most are
in. Newer versions for iOS write imu.csv and frames.csv instead: s, g in Apple's sign with gravity
apart, a rate from which iOS has taken its bias, and ARKit's 4x4 matrices, column by column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import Rows, numbers, places, rows_of, texts, times
from handcal.recordings.inputs._zip import LARGEST, beginnings, by_name, contents, listing, stated
from handcal.recordings.inputs.ios_logger import pose_of_matrices, z_up
from handcal.types import BoolArray, InputError, Recording

UNDERSTOOD = "a folder or zip of MARS logger (gyro_accel.csv)"
UNITS = (
    "rad/s, m/s^2, stamps in ns; at rest +g on the axis up; of iOS 9.80 to a g, which is put "
    "right; newer versions for iOS g with Apple's sign; pose m, of the camera in a world with y "
    "up, read into one with z up"
)
_POSE = "pose m, of the camera in a world with y up, read into one with z up"
UNITS_OF = {
    "android": f"rad/s, m/s^2, stamps in ns; at rest +g on the axis up; {_POSE}",
    "ios": f"rad/s, m/s^2 at 9.80 to a g, which is put right; at rest +g on the axis up; {_POSE}",
    "motion": f"rad/s, s, g with Apple's sign; {_POSE}",
}
STREAMS_READ = "IMU, pose (ARCore, ARKit)"
TRIED = "files written by the layout that the app's code has"
MEMBERS = ("gyro_accel.csv", "arcore_poses.csv")
# What the app for iOS takes a g for, m/s^2 (InertialRecorder of its code).
MARS_G = 9.80
_OLD, _NEW = "gyro_accel.csv", "imu.csv"
_POSES, _FRAMES = "arcore_poses.csv", "frames.csv"
_IMU = ("gx", "gy", "gz", "ax", "ay", "az")
_MOTION = tuple(f"{name}_{axis}{unit}" for name, unit in (("rotation_rate", "_rad_s"),
                ("user_acceleration", "_g"), ("gravity", "_g")) for axis in "xyz")  # fmt: skip
_MATRIX = tuple(f"transform_m{row}{column}" for row in range(3) for column in range(4))


def can_read(path: Path) -> bool:
    """By the header of gyro_accel.csv (in nanosec), or of imu.csv."""
    if listing(path) is None:
        with path.open("rb") as file:
            return _old(file.readline(200))
    wanted = (_OLD, _NEW)
    found = by_name(beginnings(path, lambda name: name.rsplit("/", 1)[-1].lower() in wanted))
    return _old(found.get(_OLD, b"")) or b"user_acceleration_x_g" in found.get(_NEW, b"")


def _old(start: bytes) -> bool:
    first = start.lstrip(b"\xef\xbb\xbf").replace(b" ", b"")
    return first.startswith(b"Timestamp[nanosec],gx[rad/s]")


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    files = _files(path, options)
    options.progress(1.0)
    said = list(stated("MARS logger", options))
    gyro, accel = (_of_both if _OLD in files else _of_motion)(path, files, said)
    streams = {}
    if files.get(_POSES, b"").strip():
        streams["pose"] = _arcore(path, files[_POSES])
    elif files.get(_FRAMES, b"").strip():
        streams["pose"] = _arkit(path, files[_FRAMES])
    system = "motion" if _OLD not in files else "ios" if _of_ios(files[_OLD]) else "android"
    made = assemble(path, gyro, accel, streams, tuple(said))
    return replace(made, file_units=UNITS_OF[system])


def _of_ios(table: bytes) -> bool:
    """Whether the app for iOS wrote it: there are blanks between the names."""
    return b", gx" in table[:200]


def _files(path: Path, options: Options) -> dict[str, bytes]:
    """What is read of it, by name. Errors: InputError."""
    wanted = (_OLD, _NEW, _POSES, _FRAMES)
    if listing(path) is not None:
        found = contents(path, lambda name: name.rsplit("/", 1)[-1].lower() in wanted, options)
        return dict(by_name(found))
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path} holds more than {LARGEST // 2**20} MiB to be read at once.")
    return {_OLD: path.read_bytes()}


def _of_both(path: Path, files: dict[str, bytes], said: list[str]) -> tuple[Columns, Columns]:
    """Gyro and specific force of gyro_accel.csv. Errors: InputError."""
    rows = _rows(path, _OLD, files[_OLD])
    apple = _of_ios(files[_OLD])
    at, *others = places(rows, ("timestamp", *_IMU))
    ns, value = times(rows, at, 1.0), numbers(rows, others)
    if not apple:
        said.append(
            "MARS logger records on Android what the system has corrected: it may have taken a "
            "changing bias out of the gyroscope."
        )
    scale = STANDARD_GRAVITY / MARS_G if apple else 1.0
    return columns(ns, value[:, :3]), columns(ns, value[:, 3:] * scale)


def _of_motion(path: Path, files: dict[str, bytes], said: list[str]) -> tuple[Columns, Columns]:
    """Gyro and specific force of imu.csv: iOS's device motion. Errors: InputError."""
    rows = _rows(path, _NEW, files[_NEW])
    at, *others = places(rows, ("motion_timestamp_s", *_MOTION))
    ns, value = times(rows, at, 1e9), numbers(rows, others)
    said.append(
        "This version of MARS logger records what iOS has corrected: it has taken a changing bias "
        "out of the gyroscope."
    )
    force = -STANDARD_GRAVITY * (value[:, 3:6] + value[:, 6:9])
    return columns(ns, value[:, :3]), columns(ns, force)


def _arcore(path: Path, content: bytes) -> Columns:
    """Tracked poses of one world. Errors: InputError."""
    rows = _rows(path, _POSES, content)
    at, world, state, *others = places(
        rows,
        ("timestamp_ns", "world_origin_id", "tracking_state",
         "tx_m", "ty_m", "tz_m", "qw", "qx", "qy", "qz"),
    )  # fmt: skip
    value, worlds = numbers(rows, others), numbers(rows, [world])[:, 0]
    known, times_met = np.unique(worlds, return_counts=True)
    tracked = _where(rows, state, lambda cell: cell == "TRACKING")
    tracked &= worlds == known[np.argmax(times_met)]
    return columns(times(rows, at, 1.0), z_up(value), tracked)


def _arkit(path: Path, content: bytes) -> Columns:
    """Poses where ARKit's tracking was normal. Errors: InputError."""
    rows = _rows(path, _FRAMES, content)
    at, state, *others = places(rows, ("frame_timestamp_s", "tracking_state", *_MATRIX))
    value = z_up(pose_of_matrices(numbers(rows, others).reshape(-1, 3, 4)))
    return columns(times(rows, at, 1e9), value, _where(rows, state, lambda cell: cell == "normal"))


def _where(rows: Rows, column: int, test: Callable[[str], bool]) -> BoolArray:
    """In which rows (n,) the text of a column passes."""
    return np.array([test(cell) for cell in texts(rows, column)], dtype=np.bool_)


def _rows(path: Path, name: str, content: bytes) -> Rows:
    """Errors: InputError where there is not one row of numbers."""
    rows = rows_of(content, f"{path}: {name}", separator=",")
    if not rows.body:
        raise InputError(f"{path}: {name} has a header but no rows.")
    return rows

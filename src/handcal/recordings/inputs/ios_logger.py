"""Folders and zips of ios_logger (iPhone): one text file a stream, without a header.

Rows are seconds since 1970 and numbers, with commas. Accel.txt: g in Apple's sign, in which the
axis up reads -1 at rest, so it is turned; Gyro.txt: rad/s, raw; Magnet.txt: uT, raw. Body axes
are CoreMotion's: x to the right and y to the top of the screen, z out of it. ARposes.txt: m and
a quaternion w x y z from the camera's axes to a world whose y is up; that world is turned about
its x so that z is up, and the camera's axes stay: their constant rotation to the body's is
estimated with everything else. MotARH.txt, MotMagnFull.txt and Motion.txt hold what iOS has
corrected and are not read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import numbers, rows_of, times
from handcal.recordings.inputs._zip import by_name, contents, names_within, stated
from handcal.types import Array, InputError, Recording

UNDERSTOOD = "a folder or zip of ios_logger (Gyro.txt, Accel.txt)"
UNITS = (
    "rad/s, g with Apple's sign: at rest -1 g on the axis up; uT, raw; ARposes m, quaternion "
    "w x y z of the camera in a world with y up, read into one with z up"
)
STREAMS_READ = "IMU, magnetometer, pose (ARKit)"
TRIED = "a real folder of an iPhone, equal to its conversion by other hands"
MEMBERS = ("Gyro.txt", "Accel.txt")
_ALL = {"gyro.txt": 3, "accel.txt": 3, "magnet.txt": 3, "arposes.txt": 7}
_HALF = np.sqrt(0.5)
# The determinant of a rotation is 1 but for rounding; below this a matrix is none.
_LEAST_DETERMINANT = 0.9


def can_read(path: Path) -> bool:
    """By the names of the files in it."""
    names = names_within(path)
    return names is not None and {"gyro.txt", "accel.txt"} <= names


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    files = by_name(contents(path, lambda name: name.rsplit("/", 1)[-1].lower() in _ALL, options))
    held = {name: _stream(path, name, files[name]) for name in _ALL if files.get(name)}
    options.progress(1.0)
    for name in ("gyro.txt", "accel.txt"):
        if name not in held:
            raise InputError(f"{path}: {name} is empty.")
    accel = held["accel.txt"]
    streams = {}
    if "magnet.txt" in held:
        mag = held["magnet.txt"]
        streams["mag"] = columns(mag.ns, mag.value * 1e-6)
    if "arposes.txt" in held:
        pose = held["arposes.txt"]
        streams["pose"] = columns(pose.ns, z_up(pose.value))
    force = columns(accel.ns, -STANDARD_GRAVITY * accel.value)
    return assemble(path, held["gyro.txt"], force, streams, stated("ios_logger", options))


def _stream(path: Path, name: str, content: bytes) -> Columns:
    rows = rows_of(content, f"{path}: {name}", header=False, separator=",")
    return columns(times(rows, 0, 1e9), numbers(rows, range(1, 1 + _ALL[name])))


def z_up(pose: Array) -> Array:
    """Poses (m, 7), x y z qw qx qy qz, in a world with y up, in one with z up: a turn of 90 deg
    about x, so that (x, y, z) becomes (x, -z, y)."""
    x, y, z, qw, qx, qy, qz = pose.T
    turned = (qw - qx, qx + qw, qy - qz, qz + qy)
    return np.column_stack([x, -z, y, *(_HALF * q for q in turned)])


def pose_of_matrices(matrices: Array) -> Array:
    """Poses (m, 7), x y z qw qx qy qz, of matrices (m, 3, 4): rotation, and place in the last
    column. Where the rotation is none (a row of zeros), the quaternion is zero."""
    from handcal.compiled.so3 import quaternion_of  # (compiles nothing, but brings numba along)

    turns = matrices[:, :, :3]
    good = np.isfinite(matrices).all(axis=(1, 2)) & (np.linalg.det(turns) > _LEAST_DETERMINANT)
    q = np.zeros((len(matrices), 4))
    q[good] = quaternion_of(turns[good])
    return np.hstack([matrices[:, :, 3], q])

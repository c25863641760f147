"""Folders and zips of Stray Scanner (iPhone, iPad): imu.csv and ARKit's odometry.csv.

imu.csv: seconds since the device started, acceleration a_x a_y a_z, rate alpha_x alpha_y alpha_z in
rad/s, CoreMotion's axes. The app's documentation says m/s^2, its code writes CoreMotion's g with
Apple's sign (the axis up reads -1 at rest): which it is, the magnitude at rest tells, and it is
said. In both the sign is Apple's and is turned. odometry.csv: m and a quaternion x y z w from the
camera's axes (x right, y down, z forward) to ARKit's world with y up, which is turned so that z is
up; the camera's constant rotation to the body is estimated with everything else.
"""

from __future__ import annotations

from pathlib import Path

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns, magnitude_at_rest
from handcal.recordings.inputs._rows import numbers, places, rows_of, times
from handcal.recordings.inputs._zip import beginnings, by_name, contents, stated
from handcal.recordings.inputs.ios_logger import z_up
from handcal.types import InputError, Recording

UNDERSTOOD = "a folder or zip of Stray Scanner (imu.csv, odometry.csv)"
UNITS = (
    "rad/s; g or m/s^2, as gravity at rest tells, with Apple's sign; pose m, quaternion x y z w of "
    "the camera in a world with y up, read into one with z up"
)
STREAMS_READ = "IMU, pose (ARKit)"
TRIED = "files written by the layout that the app's documentation and code have"
MEMBERS = ("imu.csv", "odometry.csv", "camera_matrix.csv")
_IMU = ("alpha_x", "alpha_y", "alpha_z", "a_x", "a_y", "a_z")
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def can_read(path: Path) -> bool:
    """By the header of imu.csv."""
    found = by_name(beginnings(path, lambda name: name.rsplit("/", 1)[-1] == "imu.csv"))
    first = found.get("imu.csv", b"").partition(b"\n")[0]
    return b"alpha_x" in first and b"a_x" in first


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    wanted = ("imu.csv", "odometry.csv")
    files = by_name(contents(path, lambda name: name.rsplit("/", 1)[-1] in wanted, options))
    imu = _table(path, "imu.csv", files["imu.csv"], _IMU)
    options.progress(1.0)
    said = list(stated("Stray Scanner", options))
    rest = magnitude_at_rest(columns(imu.ns, imu.value[:, 3:]))
    in_g = rest < 3.0
    said.append(
        f"The accelerometer reads {rest:.2f} at rest, taken for {'g' if in_g else 'm/s^2'} "
        "in Apple's sign."
    )
    force = imu.value[:, 3:] * (-STANDARD_GRAVITY if in_g else -1.0)
    streams = {}
    if files.get("odometry.csv", b"").strip():
        pose = _table(path, "odometry.csv", files["odometry.csv"], _POSE)
        streams["pose"] = columns(pose.ns, z_up(pose.value))
    gyro = columns(imu.ns, imu.value[:, :3])
    return assemble(path, gyro, columns(imu.ns, force), streams, tuple(said))


def _table(path: Path, name: str, content: bytes, wanted: tuple[str, ...]) -> Columns:
    """Stamps and the wanted columns. Errors: InputError."""
    rows = rows_of(content, f"{path}: {name}", separator=",")
    if not rows.body:
        raise InputError(f"{path}: {name} has a header but no rows.")
    at, *others = places(rows, ("timestamp", *wanted))
    return columns(times(rows, at, 1e9), numbers(rows, others))

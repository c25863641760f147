"""Folders and zips of the data loggers by P. Kim (Sensors Data Logger of Android,
CoreLocationMotion Data Logger of iOS), with the pose of ARCore or ARKit Data Logger beside them.

Text files without a header but comments, ns since the phone was switched on and numbers, divided
by blanks. gyro_uncalib.txt, else gyro.txt: rad/s; acce_uncalib.txt, else acce.txt: m/s^2, on iOS of
g by 9.81, which is put right, and in Apple's sign (the axis up reads -g at rest), which is turned;
magnet_uncalib.txt, else magnet.txt: uT. ARCore_sensor_pose.txt: quaternion x y z w and m, of the
phone's own axes; ARKit_camera_pose.txt: the rows of a 3x4 matrix, of the camera's. The world of
both has y up and is turned so that z is up. A pose is of use where it is on the IMU's clock; one
that has no time in common with the IMU is left out, and said.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._options import Options
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.recordings.inputs._rows import numbers, rows_of, times
from handcal.recordings.inputs._zip import by_name, contents, names_within, stated
from handcal.recordings.inputs.ios_logger import pose_of_matrices, z_up
from handcal.types import InputError, Recording

UNDERSTOOD = (
    "a folder or zip of Sensors Data Logger or CoreLocationMotion Data Logger (gyro.txt, acce.txt)"
)
UNITS = (
    "rad/s, m/s^2, uT, stamps in ns; on iOS 9.81 to a g and Apple's sign, both put right; pose m, "
    "quaternion x y z w or 3x4 matrix in a world with y up, read into one with z up"
)
_POSE = "pose m, in a world with y up, read into one with z up"
UNITS_OF = {
    True: f"rad/s, uT, m/s^2 at 9.81 to a g and with Apple's sign, both put right; {_POSE}",
    False: f"rad/s, m/s^2, uT; at rest +g on the axis up; {_POSE}",
}
STREAMS_READ = "IMU, magnetometer, pose (ARCore, ARKit)"
TRIED = "files written by the layout that the apps' code has"
MEMBERS = ("acce.txt", "gyro_uncalib.txt")  # (ios_logger has a gyro.txt too)
# What CoreLocationMotion Data Logger takes a g for, m/s^2 (its code).
LOGGER_G = 9.81
_GYROS = ("gyro_uncalib.txt", "gyro.txt")
_ACCELS = ("acce_uncalib.txt", "acce.txt")
_MAGS = ("magnet_uncalib.txt", "magnet.txt")
_ARCORE, _ARKIT = "arcore_sensor_pose.txt", "arkit_camera_pose.txt"
_PLACE_AND_WXYZ = [4, 5, 6, 3, 0, 1, 2]  # of qx qy qz qw x y z
_WIDTHS = dict.fromkeys((*_GYROS, *_ACCELS, *_MAGS), 3) | {_ARCORE: 7, _ARKIT: 12}
# Files that the app for iOS alone writes, and that for Android alone.
_APPLE = frozenset((_ARKIT, "heading.txt", "height.txt", "battery.txt"))
_ANDROID = frozenset((_ARCORE, "rv.txt", "magnetic_rv.txt", "acce_uncalib.txt", "gyro_bias.txt"))


def can_read(path: Path) -> bool:
    """By the names of the files in it."""
    names = names_within(path)
    return names is not None and bool(names & {*_GYROS}) and bool(names & {*_ACCELS})


def read(path: Path, options: Options) -> Recording:
    """Read the recording. Errors: InputError."""
    found = contents(path, lambda name: name.rsplit("/", 1)[-1].lower() in _WIDTHS, options)
    held = {name: _stream(path, name, text) for name, text in by_name(found).items() if _any(text)}
    options.progress(1.0)
    said = list(stated("The data logger", options))
    gyro, accel = (_first(path, held, names, said) for names in (_GYROS, _ACCELS))
    apple = _is_apple(path, said)
    factor = -STANDARD_GRAVITY / LOGGER_G if apple else 1.0
    streams = {}
    mag = next((held[name] for name in _MAGS if name in held), None)
    if mag is not None:
        streams["mag"] = columns(mag.ns, mag.value * 1e-6)
    if _ARCORE in held:
        pose = held[_ARCORE]
        streams["pose"] = columns(pose.ns, z_up(pose.value[:, _PLACE_AND_WXYZ]))
    elif _ARKIT in held:
        pose = held[_ARKIT]
        matrices = pose.value.reshape(-1, 3, 4)
        streams["pose"] = columns(pose.ns, z_up(pose_of_matrices(matrices)))
    force = columns(accel.ns, accel.value * factor)
    made = assemble(path, gyro, force, streams, tuple(said))
    return replace(made, file_units=UNITS_OF[apple])


def _any(content: bytes) -> bool:
    """Whether there is a row beside comments."""
    return any(line.strip() and not line.lstrip().startswith(b"#") for line in content.splitlines())


def _first(
    path: Path, held: Mapping[str, Columns], names: tuple[str, str], said: list[str]
) -> Columns:
    """The raw readings, else those that the phone has corrected, which is said. Errors:
    InputError."""
    raw, corrected = names
    if raw in held:
        return held[raw]
    if corrected not in held:
        raise InputError(f"{path}: {corrected} is empty.")
    if raw == _GYROS[0]:
        said.append(
            f"{raw} is absent or empty: {corrected} is used, from which the phone may have taken "
            "a changing bias."
        )
    return held[corrected]


def _is_apple(path: Path, said: list[str]) -> bool:
    """Whether an iPhone wrote it: the two systems differ in sign, which readings do not show."""
    names = names_within(path) or set()
    if not names & _APPLE and not names & _ANDROID:
        said.append(
            "The files do not say whether they are of Android or iOS, which differ in sign: "
            "Android's is taken (acce.txt reads +g on the axis up at rest)."
        )
    return bool(names & _APPLE) and not names & _ANDROID


def _stream(path: Path, name: str, content: bytes) -> Columns:
    """Stamps and numbers of one file. Errors: InputError."""
    rows = rows_of(content, f"{path}: {name}", header=False, separator=" ")
    return columns(times(rows, 0, 1.0), numbers(rows, range(1, 1 + _WIDTHS[name])))

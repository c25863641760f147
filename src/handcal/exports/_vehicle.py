"""What the parameter files of PX4 and ArduPilot have in common: offsets, and a scale of the
accelerometer, in the vehicle's axes (forward, right, down).

Readings that the vehicle has corrected by its own calibration, ``(raw - offset) * scale``, still
err by what was found: ``(read - bias) * factor`` is right. Both together are one calibration of
``raw``: offset + bias / scale, and scale * factor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handcal.exports import Contents
from handcal.exports._correction import Correction
from handcal.types import Array, HandcalError, InputError

# Forward, left, up to forward, right, down.
TURN = np.array([1.0, -1.0, -1.0])
# A name and its number, in files of QGroundControl, Mission Planner and MAVProxy, and in a table
# of PARM messages (mavlogdump).
_PARAMETER = re.compile(r"(?:^|[\s,])([A-Z][A-Z0-9_]*)[\s,]+([-+\d.eE]+)(?=[\s,]|$)")


@dataclass(frozen=True)
class Own:
    """The vehicle's calibration that readings went through: offset and scale (3,) of a sensor."""

    offset: Array
    scale: Array


# What PX4 has as CAL_ACC0_ROT of a sensor on the board.
INTERNAL = -1.0
# Of readings that the vehicle has not corrected.
NONE = Own(np.zeros(3), np.ones(3))


def keep(correction: Correction) -> Correction:
    """Biases, and of the accelerometer one factor an axis."""
    c = correction
    return Correction(
        c.gyro_bias, c.accel_bias, np.eye(3), np.diag(np.diag(c.accel)), np.zeros((3, 3))
    )


def offsets(contents: Contents, sensor: str, own: Own) -> Array:
    """Offsets (3,) of "gyro" or "accel", vehicle's axes; nan where they were not shown."""
    c = contents.correction
    bias = c.gyro_bias if sensor == "gyro" else c.accel_bias
    lost = contents.hidden.get(f"{sensor}_bias", "")
    turn = TURN if contents.axes == "flu" else np.ones(3)
    found = own.offset + turn * bias / own.scale + 0.0
    return np.where([a in lost for a in "xyz"], np.nan, found)


def scales(contents: Contents, own: Own) -> Array:
    """Factors of the accelerometer (3,), nan where none was found; they do not change with the
    sense of an axis."""
    factor = np.diag(contents.correction.accel)
    return np.where(factor == 1.0, np.nan, own.scale * factor)


def lines(names: str, values: Array, line: str) -> list[str]:
    """A line a parameter, named with X, Y and Z for {}; of one that was not shown a comment."""
    out = []
    for axis, value in zip("XYZ", values, strict=True):
        name = names.format(axis)
        if np.isnan(value):
            out.append(f"# {name}: not shown, left as it is on the vehicle")
        else:
            out.append(line.format(name=name, value=f"{value:.12f}"))
    return out


def own(vehicle: Mapping[str, float], offset: str, scale: str = "") -> Own:
    """Of parameters named with X, Y and Z for {}. Errors: HandcalError where one is missing."""
    wanted = [name.format(a) for name in (offset, scale) if name for a in "XYZ"]
    lost = [name for name in wanted if name not in vehicle]
    if lost:
        raise HandcalError(
            f"These readings went through the vehicle's own calibration, which has to be known: "
            f"{', '.join(lost)} are not in the recording, or changed during it. Give the "
            "vehicle's parameters as they were then with --parameters FILE."
        )
    values = np.array([vehicle[name] for name in wanted])
    return Own(values[:3], values[3:] if scale else np.ones(3))


def refuse_turned(vehicle: Mapping[str, float], names: Sequence[str]) -> None:
    """Errors: HandcalError where the board is turned, and with it the axes of the readings."""
    turned = [n for n in names if vehicle.get(n) and (vehicle[n], n[-3:]) != (INTERNAL, "ROT")]
    if turned:
        said = ", ".join(f"{name} {vehicle[name]:g}" for name in turned)
        raise HandcalError(
            f"The board is turned against the vehicle ({said}), and offsets are in the sensor's "
            "axes: these readings do not tell them."
        )


def read_parameters(path: Path) -> dict[str, float]:
    """Parameters of a vehicle, by name; without those that the file has with two values. Errors:
    InputError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as a list of parameters: {error}.") from None
    found: dict[str, set[float]] = {}
    for line in text.splitlines():
        match = None if line.startswith("#") else _PARAMETER.search(line)
        if match is not None:
            found.setdefault(match[1], set()).add(_finite(path, *match.groups()))
    if not found:
        raise InputError(
            f"{path} has no parameters; what is read are files of QGroundControl, Mission Planner "
            "and MAVProxy, and PARM messages as a table (mavlogdump.py --format csv --types PARM)."
        )
    return {name: values.pop() for name, values in found.items() if len(values) == 1}


def _finite(path: Path, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}: {name} is {text}, and no number.")
    return value


def told(contents: Contents, corrected: bool) -> str:
    """Which axes the recording was taken to have, and whose correction is in the numbers."""
    names = {"flu": "x forward, y left, z up (ROS)", "frd": "x forward, y right, z down"}
    whose = (
        "its own calibration, which had corrected the readings, with what that left"
        if corrected
        else "what was found in readings that it had not corrected"
    )
    return (
        f"# Axes of the recording: {names[contents.axes]}; here x forward, y right, z down\n"
        f"# In place of the vehicle's parameters: {whose}\n"
    )

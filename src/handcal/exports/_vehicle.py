"""What the parameter files of PX4 and ArduPilot have in common: offsets, and a scale of the
accelerometer, in the vehicle's axes (forward, right, down).

Readings that the vehicle has corrected by its own calibration, ``(raw - offset) * scale``, still
err by what was found: ``(read - bias) * factor`` is right. Both together are one calibration of
``raw``: offset + bias / scale, and scale * factor. What is found in raw readings takes the place of
the vehicle's calibration.

A parameter is written where what was found is more than two of its sigmas from what the vehicle
has; nearer, nothing says that the vehicle's is wrong, and it is left.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handcal.exports import Contents
from handcal.exports._correction import Correction
from handcal.types import Array, BoolArray, HandcalError, InputError

# Forward, left, up to forward, right, down.
TURN = np.array([1.0, -1.0, -1.0])
SIGMAS = 2.0
RAW, CORRECTED = "raw", "corrected"
# A name and its number, in files of QGroundControl, Mission Planner and MAVProxy, and in a table
# of PARM messages (mavlogdump).
_PARAMETER = re.compile(r"(?:^|[\s,])([A-Z][A-Z0-9_]*)[\s,]+([-+\d.eE]+)(?=[\s,]|$)")
# Ids that only a log of raw readings has.
_OF_RAW = ("sensor_gyro.", "sensor_accel.")


@dataclass(frozen=True)
class Own:
    """The vehicle's calibration that readings went through: offset and scale (3,) of a sensor."""

    offset: Array
    scale: Array


@dataclass(frozen=True)
class Parameter:
    """A parameter: before, as the vehicle has it, nan where that is not known; now and its sigma,
    as found, nan where it was not shown and where no sigma is known."""

    name: str
    before: float
    now: float
    sigma: float

    @property
    def shown(self) -> bool:
        return not np.isnan(self.now)

    @property
    def written(self) -> bool:
        return self.shown and not abs(self.now - self.before) <= SIGMAS * self.sigma

    @property
    def found(self) -> str:
        """In words, with its sigma."""
        return f"{self.now:.4g} ± " + ("?" if np.isnan(self.sigma) else f"{self.sigma:.2g}")

    @property
    def comment(self) -> str:
        """What is said beside it in a file."""
        if not self.shown:
            return f"# {self.name}: not shown, left as it is on the vehicle"
        before = "not known" if np.isnan(self.before) else f"{self.before:.6g}"
        if self.written:
            return f"# {self.name}: {before} before, {self.found} now"
        return f"# {self.name}: left at {before}, for {self.found} was found"


def keep(correction: Correction) -> Correction:
    """Biases, and of the accelerometer one factor an axis."""
    c = correction
    return Correction(
        c.gyro_bias, c.accel_bias, np.eye(3), np.diag(np.diag(c.accel)), np.zeros((3, 3))
    )


def parameters(contents: Contents, sensor: str, offset: str, scale: str = "") -> list[Parameter]:
    """Those of "gyro" or "accel", named with X, Y and Z for {}. Errors: HandcalError where the
    vehicle's calibration, which they are compared with or added to, is not known."""
    before = known(contents.vehicle, contents.readings, offset, scale)
    base = before if contents.readings == CORRECTED else Own(np.zeros(3), np.ones(3))
    c, turn = contents.correction, TURN if contents.axes == "flu" else np.ones(3)
    bias = c.gyro_bias if sensor == "gyro" else c.accel_bias
    hidden = contents.hidden.get(f"{sensor}_bias", "")
    seen = np.where([a in hidden for a in "xyz"], np.nan, 1.0)
    sigma = contents.bias_sigma[:3] if sensor == "gyro" else contents.bias_sigma[3:]
    out = _named(offset, before.offset, (base.offset + turn * bias / base.scale) * seen + 0.0,
                 sigma / np.abs(base.scale))  # fmt: skip
    if not scale:
        return out
    (shown, sigma), factor = _scale_errors(contents), np.diag(c.accel)
    found = np.where((factor == 1.0) & ~shown, np.nan, base.scale * factor)
    return out + _named(scale, before.scale, found, np.abs(base.scale) * factor**2 * sigma)


def _named(names: str, before: Array, now: Array, sigma: Array) -> list[Parameter]:
    rows = zip("XYZ", before.tolist(), now.tolist(), sigma.tolist(), strict=True)
    return [Parameter(names.format(axis), *numbers) for axis, *numbers in rows]


def _scale_errors(contents: Contents) -> tuple[BoolArray, Array]:
    """Which of the accelerometer's scale errors were shown (3,), and their sigmas (3,)."""
    rows = {p["name"]: p for p in contents.parameters
            if p["effect"] == "accel_scale" and p.get("shown", True)}  # fmt: skip
    sigma = [rows.get(axis, {}).get("sigma") or np.nan for axis in "xyz"]
    return np.array([axis in rows for axis in "xyz"]), np.array(sigma, dtype=np.float64)


def lines(contents: Contents, found: Sequence[Parameter], line: str) -> str:
    """Of each parameter what is said of it, and its line where it is written. Errors: HandcalError
    where none is."""
    if not any(p.written for p in found):
        raise HandcalError(f"{contents.name}: nothing to write. {'. '.join(left(found))}.")
    out = []
    for p in found:
        out.append(p.comment)
        if p.written:
            out.append(line.format(name=p.name, value=f"{p.now:.12f}"))
    return "\n".join(out) + "\n"


def left(found: Sequence[Parameter]) -> list[str]:
    """Sentences about the parameters that are not written."""
    near = [f"{p.name} ({p.before:.4g}; found {p.found})" for p in found
            if p.shown and not p.written]  # fmt: skip
    lost = [p.name for p in found if not p.shown]
    out = [f"Left as the vehicle has them, for what was found is within two of its sigmas of them: "
           f"{', '.join(near)}"] if near else []  # fmt: skip
    return out + ([f"Left as the vehicle has them, for they were not shown: {', '.join(lost)}"]
                  if lost else [])  # fmt: skip


def readings_of(said: Mapping[str, float]) -> str:
    """Whether readings are raw or corrected, by what a log says of the vehicle; "" for no log."""
    if any(name.startswith(_OF_RAW) for name in said):
        return RAW
    return CORRECTED if said else ""


def known(vehicle: Mapping[str, float], readings: str, offset: str, scale: str = "") -> Own:
    """The vehicle's calibration by parameters named with X, Y and Z for {}; of raw readings, which
    did not go through it, nan for those that changed. Errors: HandcalError."""
    wanted = [name.format(a) for name in (offset, scale) if name for a in "XYZ"]
    lost = [name for name in wanted if name not in vehicle]
    if not readings:
        raise HandcalError(
            "Nothing says whether these readings are raw, or were corrected by the vehicle's own "
            "calibration: add --readings raw, or --readings corrected, and the vehicle's "
            "parameters as they were then with --parameters FILE."
        )
    if lost and (readings == CORRECTED or len(lost) == len(wanted)):
        raise HandcalError(
            f"The vehicle's own calibration has to be known, which these readings "
            f"{'went through' if readings == CORRECTED else 'are compared with'}: "
            f"{', '.join(lost)} are not in the recording, or changed during it. Give the "
            "vehicle's parameters as they were then with --parameters FILE."
        )
    values = np.array([vehicle.get(name, np.nan) for name in wanted])
    return Own(values[:3], values[3:] if scale else np.ones(3))


def refuse_turned(vehicle: Mapping[str, float], names: Sequence[str], remedy: str) -> None:
    """Errors: HandcalError where the sensor is turned, and with it the axes of the readings."""
    if turned := [name for name in names if vehicle.get(name)]:
        said = ", ".join(f"{name} {vehicle[name]:g}" for name in turned)
        raise HandcalError(
            f"These readings were turned ({said}) after the vehicle took its offsets off, which "
            f"are in the sensor's axes. {remedy}"
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


def told(contents: Contents) -> str:
    """Which axes the recording was taken to have, and whose correction is in the numbers."""
    names = {"flu": "x forward, y left, z up (ROS)", "frd": "x forward, y right, z down"}
    whose = (
        "its own calibration, which had corrected the readings, with what that left"
        if contents.readings == CORRECTED
        else "what was found in readings that it had not corrected"
    )
    return (
        f"# Axes of the recording: {names[contents.axes]}; here x forward, y right, z down\n"
        f"# In place of the vehicle's parameters: {whose}\n"
    )

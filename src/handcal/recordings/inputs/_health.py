"""What is wrong with a recording before any physics: the size of gravity, the gyro's factor and
axes against gravity's turning, the magnetometer's axes, temperatures.

What an option puts right is refused with that option. What makes a calibration senseless is kept in
``Recording.unfit``: the recording can be looked at, and nothing is estimated from it. What the user
stated is used, with a warning at most.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._checks import rest_magnitude, slow_stamps
from handcal.recordings.inputs._field import with_axes_of_imu
from handcal.recordings.inputs._turning import CLEARLY, Turning, named, turning
from handcal.recordings.streams import DEGREE
from handcal.types import Array, HandcalError, InputError, Recording

# Gravity is missed by so much, rad, before anything is said: less is a hand's own acceleration.
MISSED = 0.1
# A factor is another one beyond this; a usual one within this; known if its sigma is less.
OTHER, USUAL, KNOWN = 0.1, 0.03, 0.03
FULL_SCALES = tuple(2.0**k for k in range(-5, 6) if k)
FASTEST_GYRO = 40.0  # rad/s; beyond the full scale of nearly every consumer gyro
# An accelerometer at rest, m/s^2: as it should read, and so far off that gravity is not what is
# read; how far a full scale's factor may be off by biases.
RIGHT, GRAVITY, BIASED = (8.8, 10.8), (5.0, 18.0), 0.08
ACCEL_UNITS = {1 / STANDARD_GRAVITY: "g", 1000 / STANDARD_GRAVITY: "mg"}
GYRO_UNITS = {DEGREE: "deg/s", 1 / DEGREE: "rad/s", DEGREE * 1e-3: "mdeg/s"}
POSSIBLE_DEGC = (-60.0, 150.0)


@dataclass(frozen=True)
class Finding:
    """A sentence. quantity: what the user may have stated himself, by which it is a warning;
    refused: an option puts it right; unfit: a calibration with it makes no sense."""

    text: str
    quantity: str = ""
    refused: bool = False
    unfit: bool = False


def checked(recording: Recording, stated: Collection[str] = ()) -> Recording:
    """The recording with what is wrong in its warnings, and in ``unfit``; a magnetometer on other
    axes turned to the IMU's.

    stated: quantities whose unit the user named, and sensors whose axes ("mag's axes"). Errors:
    InputError, all at once, where options put it right.
    """
    imu = recording.imu
    gravity = rest_magnitude(imu.accel, recording.rate_hz)
    both = len(recording.sensors) == 2 and gravity > 0.0
    motion = turning(imu, gravity, MISSED) if both else None
    found = _accel(gravity) if "accel" in recording.sensors else []
    found += [*_gyro(recording, motion), *_temperature(recording)]
    refused = [f.text for f in found if f.refused and f.quantity not in stated]
    if refused:
        raise InputError(" ".join(refused))
    unfit = " ".join(f.text for f in found if f.unfit and f.quantity not in stated)
    said = [_as_stated(f) if f.quantity in stated else f.text for f in found]
    recording = replace(recording, warnings=(*recording.warnings, *said), unfit=unfit)
    if not both or (motion is not None and another(motion)):
        return recording

    def gyro_told() -> bool:
        motion = turning(imu, gravity)
        return motion is not None and motion.tells

    return with_axes_of_imu(recording, "mag's axes" in stated, gyro_told)


def check_fit(recording: Recording) -> None:
    """Errors: HandcalError where a calibration with these readings makes no sense."""
    if recording.unfit:
        raise HandcalError(recording.unfit)


def _as_stated(finding: Finding) -> str:
    return f"{finding.text} (What was stated of the {finding.quantity} is used.)"


def another(motion: Turning) -> bool:
    """Whether another factor or other axes explain far better how gravity turns."""
    other = abs(np.log(motion.factor)) > OTHER or not np.array_equal(motion.axes, np.eye(3))
    better = motion.mapped < CLEARLY * min(motion.as_read, motion.still)
    return bool(other and better and motion.as_read > MISSED and motion.sigma < KNOWN)


def _near(value: float, usual: Collection[float], within: float) -> float | None:
    """The usual value within this part of it."""
    return next((u for u in usual if abs(value / u - 1.0) < within), None)


def _accel(rest: float) -> list[Finding]:
    """What is said of the accelerometer's reading at rest, m/s^2."""
    if RIGHT[0] <= rest <= RIGHT[1]:
        return []
    reads = f"The accelerometer reads {rest:.3g} m/s^2 at rest"
    unit = _near(rest / STANDARD_GRAVITY, ACCEL_UNITS, 0.2)
    if unit is not None:
        name = ACCEL_UNITS[unit]
        return [_refused(f"{reads}: that is {name}, not m/s^2; give --units accel={name}.")]
    if _near(rest / STANDARD_GRAVITY, [STANDARD_GRAVITY], 0.2):
        return [_refused(f"{reads}, gravity squared: it is in m/s^2 already; give "
                         "--units accel=m/s^2.")]  # fmt: skip
    scale = _near(rest / STANDARD_GRAVITY, FULL_SCALES, BIASED)
    if scale is not None:
        return [Finding(
            f"The accelerometer reads {rest / STANDARD_GRAVITY:.2f} g at rest, {rest:.2f} m/s^2 in "
            "every attitude: is its full scale another than the file was made with? If so, give "
            f"--units accel=m/s^2/{scale:g} (or the file's own unit, divided by {scale:g}).",
            "accel", unfit=True,
        )]  # fmt: skip
    if GRAVITY[0] <= rest <= GRAVITY[1]:
        return [Finding(f"The accelerometer reads {rest:.2f} m/s^2 when stillest; 9.8 is expected.",
                        "accel")]  # fmt: skip
    if rest < GRAVITY[0]:
        return [_refused(f"{reads}, where 9.8 is expected: gravity seems to have been removed; the "
                         "raw accelerometer is needed.")]  # fmt: skip
    return [_refused(f"{reads}, where 9.8 is expected: name its unit with --units accel=...")]


def _refused(text: str, quantity: str = "accel") -> Finding:
    return Finding(text, quantity, refused=True)


def _gyro(recording: Recording, motion: Turning | None) -> list[Finding]:
    """What is said of the gyro's unit, factor and axes, and of the time base."""
    imu = recording.imu
    counted = _counts_samples(imu.t)
    slow = slow_stamps(imu.t)
    if counted:
        rate = ""
        if motion is not None and _factor(motion):
            rate = f"; as gravity turns, about {1 / motion.factor:.0f}"
        return [_refused(f"The time counts samples: give --rate HZ{rate}. (If it counts ms, give "
                         "--units time=ms.)", "time")]  # fmt: skip
    if motion is None or not another(motion):
        fastest = float(np.abs(imu.gyro).max())
        out = [Finding(slow, "time", refused=motion is not None and motion.as_read > 0.5)
               ] if slow else []  # fmt: skip
        if fastest > FASTEST_GYRO:
            out.append(Finding(
                f"The gyroscope reads up to {fastest:.0f} rad/s, more than most can measure: "
                "check its unit (--units gyro=deg/s).", "gyro"))  # fmt: skip
        return out
    if slow:
        return [_refused(slow, "time")]
    return [*_of_factor(motion), *_of_axes(motion)]


def _counts_samples(t: Array) -> bool:
    """Whether stamps t (n,), s, are whole numbers one after the other."""
    return bool(np.median(np.abs(np.diff(t) - 1.0)) < 1e-9)


def _factor(motion: Turning) -> bool:
    return another(motion) and bool(abs(np.log(motion.factor)) > OTHER)


def _of_factor(motion: Turning) -> list[Finding]:
    f = motion.factor
    if not _factor(motion):
        return []
    unit = _near(f, GYRO_UNITS, USUAL)
    if unit == DEGREE:
        return [_refused("The gyroscope turns 57 times faster than gravity does: it is in deg/s, "
                         "not rad/s; give --units gyro=deg/s.", "gyro")]  # fmt: skip
    if unit == 1 / DEGREE:
        return [_refused("Gravity turns 57 times faster than the gyroscope: it is in rad/s, not "
                         "deg/s; give --units gyro=rad/s.", "gyro")]  # fmt: skip
    if unit is not None:
        name = GYRO_UNITS[unit]
        return [_refused(f"The gyroscope turns {1 / f:.3g} times as far as gravity does: it is in "
                         f"{name}; give --units gyro={name}.", "gyro")]  # fmt: skip
    usual = _near(f, (*FULL_SCALES, STANDARD_GRAVITY, 1 / STANDARD_GRAVITY, 1e3, 1e-3), USUAL)
    missed = f"{np.degrees(motion.as_read):.0f} deg off as read, {np.degrees(motion.mapped):.1f} so"
    return [Finding(
        f"Gravity turns {_shown(usual or f)} times as far as the gyroscope says ({missed}): is the "
        "gyroscope's full scale or the sample rate another than the file says? If the scale is, "
        f"give --units gyro=rad/s/{1 / (usual or f):.3g} (or the file's own unit, divided by "
        f"{1 / (usual or f):.3g}); if the rate is, --rate HZ.",
        "gyro", unfit=usual is not None,
    )]  # fmt: skip


def _shown(factor: float) -> str:
    return f"{factor:.1f}" if factor >= 1.0 else f"{factor:.2g}"


def _of_axes(motion: Turning) -> list[Finding]:
    """That the two sensors' axes differ, with the fewest changes that mend them."""
    P = motion.axes
    if np.array_equal(P, np.eye(3)):
        return []
    ways = [("gyro", P)]
    # (what mends the accelerometer's mirrored axes is a rotation of the gyro's)
    if np.linalg.det(P) > 0:
        ways += [("accel", s * P.T) for s in (1.0, -1.0)]
    sensor, A = max(ways, key=lambda way: float(np.trace(way[1])))
    name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
    axes = named(A)
    return [Finding(
        f"Gravity does not turn as the gyroscope says ({np.degrees(motion.as_read):.0f} deg off); "
        f"with the {name}'s {', '.join(axes)} in the place of its x, y, z it does "
        f"({np.degrees(motion.mapped):.1f} deg): the two sensors' axes are not the same. Give "
        f"--axes {sensor}={','.join(axes)}.", f"{sensor}'s axes", refused=True,
    )]  # fmt: skip


def _temperature(recording: Recording) -> list[Finding]:
    if "temperature" not in recording.streams:
        return []
    value = recording.streams["temperature"].value
    low, high = float(value.min()), float(value.max())
    if POSSIBLE_DEGC[0] <= low and high <= POSSIBLE_DEGC[1]:
        return []
    return [Finding(f"The temperature reads {low:.4g} to {high:.4g} degC, which no device has: it "
                    "is in another unit, or raw; effects of the temperature are not to be "
                    "believed.", "temperature")]  # fmt: skip

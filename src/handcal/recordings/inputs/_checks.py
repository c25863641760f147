"""Is it plausible that these numbers are what they are said to be? Units, dead sensors,
saturation. Every refusal names the option that would put it right."""

from __future__ import annotations

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.types import Array, BoolArray, InputError

# Sensors that stand still for longer are looked at, as many spans of each: a coarse one may do so
# in every rest, if nothing moves.
LONGEST_STUCK_S, SPANS = 1.0, 20
# No gyro reads so much at rest, rad/s; no hand that rests lets gravity turn so far, rad.
RESTING_RATE, TILTED = 0.2, 0.1
# Hundreds of times the Earth's field, tesla: beyond any iron in a phone and any full scale.
STRONGEST_T = 0.02
# Hardly an IMU is read less often, s; and stamps that are further apart than a tenth of a second's
# worth of ms, of us, are in the next smaller unit.
SLOWEST_S, STEPS = 1.0, {"ms": 3e2, "us": 3e5}


def saturated(value: Array, smallest: float) -> BoolArray:
    """Where a sensor sits at its full scale. value (n, 3); result (n,).

    A clipped signal piles up at one value that it otherwise passes through quickly.
    Quantised readings of a resting or steadily turning sensor repeat their extreme too,
    but have as many neighbours just below it, or sit there most of the time. Rows that
    stay the same in all three numbers are no readings but the rate that a table was told.
    smallest: below it nothing is a full scale.
    """
    clipped = np.zeros(len(value), dtype=np.bool_)
    commanded = held(value)
    for column in value.T:
        for signed in (column, -column):
            extreme = signed.max(initial=0.0)
            if extreme < smallest:
                continue
            at = (signed == extreme) & ~commanded
            count = int(at.sum())
            below = int((signed > 0.97 * extreme).sum()) - count
            runs = bool(np.any(at[1:] & at[:-1]))
            if runs and 5 <= count < 0.5 * len(signed) and count > 2 * below:
                clipped |= at
    return clipped


def held(value: Array) -> BoolArray:
    """Rows (n,) of value (n, 3) that are one of five or more equal ones in a row."""
    same = np.all(value[1:] == value[:-1], axis=1).astype(float)
    if len(same) < 4:
        return np.zeros(len(value), dtype=np.bool_)
    four = np.convolve(same, np.ones(4), mode="valid") > 3.5
    return np.asarray(np.convolve(four, np.ones(5)) > 0.5)


def check_alive(gyro: Array, accel: Array) -> list[str]:
    """A sensor that never moves by one bit is dead, unless the other one rests as perfectly.

    (n, 3) each. Returns warnings. Errors: InputError.
    """
    constant = [bool(np.all(value == value[0])) for value in (gyro, accel)]
    if all(constant) and np.any(accel):
        return ["Neither sensor moves by one bit: an ideal device at rest, or a frozen one."]
    for dead, name, value in zip(
        constant, ("gyroscope", "accelerometer"), (gyro, accel), strict=True
    ):
        if dead:
            reads = "the same value" if np.any(value) else "zero"
            raise InputError(f"The {name} reads {reads} throughout: it was not recording.")
    return _dead_axes(gyro, "gyroscope") + _dead_axes(accel, "accelerometer")


def _dead_axes(value: Array, name: str) -> list[str]:
    """A warning where an axis of (n, 3) never moves by one bit while another does."""
    axes = [axis for axis, column in zip("xyz", value.T, strict=True) if np.ptp(column) == 0]
    if not axes:
        return []
    return [
        f"The {name}'s {' and '.join(axes)} never moves by one bit while its other axes do: "
        "dead, unless the device is an ideal one."
    ]


def stuck(t: Array, gyro: Array, accel: Array) -> tuple[list[str], BoolArray]:
    """Warnings where one sensor stays at one value for over a second while the other shows a
    motion that it would have had to see, and where that is (n,): what is read there is no
    measurement. t (n,) s; (n, 3) each, on these stamps."""
    said, at_all = [], np.zeros(len(t), dtype=np.bool_)
    for name, value, missed in (
        ("gyroscope", gyro, _turned_by_accel),
        ("accelerometer", accel, _tilted_by_gyro),
    ):
        step = least_step(value)
        ends = np.flatnonzero(np.any(np.diff(value, axis=0) != 0, axis=1)) + 1
        ends = np.concatenate([[0], ends, [len(t)]])
        for k in np.argsort(-np.diff(ends), kind="stable")[:SPANS]:
            at = slice(int(ends[k]), int(ends[k + 1]))
            first, last = t[at.start], t[at.stop - 1]
            if last - first > LONGEST_STUCK_S and missed(t[at], gyro[at], accel[at], step):
                at_all[at] = True
                said.append(
                    f"The {name} reads one value from {first:.1f} to {last:.1f} s while the "
                    "other sensor moves: it was stuck, or its steps are coarser than that motion. "
                    "These readings count as missing."
                )
    return said, at_all


def least_step(value: Array) -> Array:
    """The least by which each axis of (n, 3) ever changes, (3,); zero for one that never does."""
    changes = np.abs(np.diff(value, axis=0))
    least = np.where(changes > 0, changes, np.inf).min(axis=0, initial=np.inf)
    return np.asarray(np.where(np.isfinite(least), least, 0.0))


def _means(t: Array, value: Array) -> tuple[Array, Array]:
    """Of quarters of a second: when, (k,), and their means, (k, d)."""
    window = ((t - t[0]) / 0.25).astype(np.int64)
    starts = np.flatnonzero(np.diff(window, prepend=-1))
    count = np.diff(np.append(starts, len(t)))
    when = np.add.reduceat(t, starts) / count
    return when, np.add.reduceat(value, starts) / count[:, None]


def _turned_by_accel(t: Array, gyro: Array, accel: Array, step: Array) -> bool:
    """Whether gravity turns by more than a gyro hides that reads this one rate: what its step is
    short of, and the turn about gravity itself; or the rate is none of a rest."""
    if np.any(np.abs(gyro[0]) > RESTING_RATE + 2.0 * step):
        return True
    _, force = _means(t, accel)
    up = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    turned = float(np.linalg.norm(up - up[0], axis=1).max())
    hidden = float(np.linalg.norm(np.minimum(step, RESTING_RATE))) * (t[-1] - t[0])
    return bool(turned > TILTED + hidden)


def _tilted_by_gyro(t: Array, gyro: Array, accel: Array, step: Array) -> bool:
    """Whether the gyro tilts gravity by more than an accelerometer hides that reads this one
    value; a constant rate is the gyro's bias."""
    value = accel[0]
    up = value / max(float(np.linalg.norm(value)), 1e-9)
    when, rate = _means(t, gyro)
    across = rate - np.median(rate, axis=0)
    across -= np.outer(across @ up, up)
    tilt = np.cumsum(across * np.gradient(when)[:, None] if len(when) > 1 else 0 * across, axis=0)
    hidden = 2.0 * float(np.linalg.norm(step)) / STANDARD_GRAVITY
    return float(np.ptp(tilt, axis=0).max()) > TILTED + hidden


def rest_magnitude(accel: Array, rate_hz: float) -> float:
    """Magnitude of the mean reading over the stillest tenth of half-second windows."""
    size = min(len(accel), max(5, round(0.5 * rate_hz)))
    windows = accel[: len(accel) // size * size].reshape(-1, size, 3)
    restless = windows.var(axis=1).sum(axis=1)
    stillest = np.argsort(restless, kind="stable")[: max(1, len(windows) // 10)]
    return float(np.median(np.linalg.norm(windows[stillest].mean(axis=1), axis=1)))


def wrong_field(value: Array) -> str:
    """What is said of a field (n, 3), in tesla, that is about no device; empty of any other."""
    finite = value[np.all(np.isfinite(value), axis=1)]
    size = float(np.median(np.linalg.norm(finite, axis=1))) if len(finite) else 0.0
    if size < STRONGEST_T:
        return ""
    guess = "microtesla: give --units mag=uT" if size > 5.0 else "gauss: give --units mag=gauss"
    return (
        f"The magnetometer was left out: it reads {size:.3g} tesla, where the Earth's field is "
        f"0.00005. That may be {guess}."
    )


def turned(u: Array, rotation: Array) -> Array:
    """A direction fixed in space, seen from a body that turned by `rotation` (k, 3), rad."""
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)
    axis = rotation / np.maximum(angle, 1e-12)
    along = np.sum(axis * u, axis=1, keepdims=True)
    turned: Array = (
        u * np.cos(angle) - np.cross(axis, u) * np.sin(angle) + axis * along * (1 - np.cos(angle))
    )
    return turned


def slow_stamps(t: Array) -> str | None:
    """A sentence where t (n,), s, has less than a reading a second: it may be in another unit."""
    step = float(np.median(np.diff(t)))
    if step <= SLOWEST_S:
        return None
    unit = next((u for u, longest in STEPS.items() if step < longest), "ns")
    return (
        f"The IMU's stamps are {step:.3g} s apart: they seem to be in {unit}, not s; if so, give "
        f"--units time={unit}."
    )

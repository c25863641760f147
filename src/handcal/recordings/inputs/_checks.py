"""Is it plausible that these numbers are what they are said to be? Units, dead sensors,
saturation. Every refusal names the option that would put it right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.streams import DEGREE
from handcal.types import Array, BoolArray, InputError

IntArray = NDArray[np.int64]

# Sensors that stand still for longer are looked at, as many spans of each: a coarse one may do so
# in every rest, if nothing moves.
LONGEST_STUCK_S, SPANS = 1.0, 20
# No gyro reads so much at rest, rad/s; no hand that rests lets gravity turn so far, rad.
RESTING_RATE, TILTED = 0.2, 0.1
# Hundreds of times the Earth's field, tesla: beyond any iron in a phone and any full scale.
STRONGEST_T = 0.02
FASTEST_GYRO = 40.0  # rad/s; beyond the full scale of nearly every consumer gyro
# Hardly an IMU is read less often, s; and stamps that are further apart than a tenth of a second's
# worth of ms, of us, are in the next smaller unit.
SLOWEST_S, STEPS = 1.0, {"ms": 3e2, "us": 3e5}
# A heading that was unwrapped may be many turns, rad, but no faster than the gyro by this factor,
# from one second to the next; degrees are 57 times as many.
FEW_TURNS, HEADING_FASTER = 6.0 * np.pi, 5.0


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


def check_accel_unit(accel: Array, rate_hz: float) -> list[str]:
    """Gravity must be there, in m/s^2. Returns warnings. Errors: InputError."""
    rest = rest_magnitude(accel, rate_hz)
    if 5.0 <= rest <= 20.0:
        if 8.8 <= rest <= 10.8:
            return []
        return [f"The accelerometer reads {rest:.2f} m/s^2 when stillest; 9.8 is expected."]
    if 0.8 <= rest <= 1.2:
        raise InputError(
            f"The accelerometer reads {rest:.2f} at rest: that is g, not m/s^2; "
            "give --units accel=g."
        )
    if 800 <= rest <= 1200:
        raise InputError(
            f"The accelerometer reads {rest:.0f} at rest: that is mg, not m/s^2; "
            "give --units accel=mg."
        )
    if 0.8 * STANDARD_GRAVITY**2 <= rest <= 1.2 * STANDARD_GRAVITY**2:
        raise InputError(
            f"The accelerometer reads {rest:.1f} m/s^2 at rest, gravity squared: "
            "it is in m/s^2 already; give --units accel=m/s^2."
        )
    if rest < 5.0:
        raise InputError(
            f"The accelerometer reads {rest:.2f} m/s^2 at rest, where 9.8 is expected: "
            "gravity seems to have been removed; the raw accelerometer is needed."
        )
    raise InputError(
        f"The accelerometer reads {rest:.1f} m/s^2 at rest, where 9.8 is expected: "
        "name its unit with --units accel=..."
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


def calm_windows(t: Array, gyro: Array, accel: Array) -> tuple[IntArray, int, Array, Array]:
    """Windows of 0.4 s between moments without other acceleration than gravity.

    First samples (k,), length, and the directions of gravity before and after (k, 3); of all
    such windows those that turn most, whatever the gyro's unit.
    """
    step = float(np.median(np.diff(t)))
    size, half = max(2, round(0.4 / step)), max(1, round(0.04 / step))
    last = len(t) - size - half - 1
    starts = np.unique(np.linspace(half, max(half, last), 1600).astype(np.int64))
    starts = starts[starts <= last]
    starts = starts[t[starts + size] - t[starts] < 1.5 * size * step]
    sums = np.vstack([np.zeros(3), np.cumsum(accel, axis=0)])
    before, after = (
        (sums[at + half + 1] - sums[at - half]) / (2 * half + 1) for at in (starts, starts + size)
    )
    g0, g1 = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    calm = (abs(g0 - STANDARD_GRAVITY) < 1.0) & (abs(g1 - STANDARD_GRAVITY) < 1.0)
    starts, u0, u1 = starts[calm], (before.T / g0).T[calm], (after.T / g1).T[calm]
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(gyro, axis=1))])
    turn = path[starts + size] - path[starts]
    most = turn >= 0.5 * np.quantile(turn, 0.98) if len(turn) else turn > 0
    return starts[most], size, u0[most], u1[most]


def between(u: Array, v: Array) -> float:
    """Median angle between the rows, rad."""
    return float(np.median(np.arccos(np.clip(np.sum(u * v, axis=1), -1, 1))))


def turning_mismatch(
    t: Array, gyro: Array, accel: Array, factors: tuple[float, ...] = (1.0, DEGREE, 1 / DEGREE)
) -> list[float]:
    """Median error, rad, of the gravity direction predicted by the gyro times each factor.

    Empty where there are fewer than five windows to judge by.
    """
    starts, size, u0, u1 = calm_windows(t, gyro, accel)
    if len(starts) < 5:
        return []
    return [between(turned_by(t, factor * gyro, starts, size, u0), u1) for factor in factors]


def turned_by(t: Array, gyro: Array, starts: IntArray, size: int, u: Array) -> Array:
    """Directions u (k, 3) that are fixed in space, so many samples after each start (k,)."""
    dt = np.diff(t)
    for k in range(size):
        row = starts + k
        u = turned(u, 0.5 * (gyro[row] + gyro[row + 1]) * dt[row, None])
    return u


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


def check_gyro_unit(t: Array, gyro: Array, accel: Array) -> list[str]:
    """The gyro must explain how the direction of gravity turns. accel in m/s^2.

    Returns warnings. Errors: InputError if another unit explains it far better.
    """
    errors = turning_mismatch(t, gyro, accel)
    if errors:
        as_is, degrees, radians = errors
        slow = slow_stamps(t)
        if slow is not None and as_is > 0.5:
            raise InputError(slow)
        # Turning 57 times too fast ends anywhere, about a right angle off.
        if as_is > 0.5 and degrees < 0.4 * as_is:
            raise InputError(
                "The gyroscope turns 57 times faster than gravity does: it is in deg/s, "
                "not rad/s; give --units gyro=deg/s."
            )
        if as_is > 0.15 and radians < 0.4 * as_is:
            raise InputError(
                "Gravity turns 57 times faster than the gyroscope: it is in rad/s, "
                "not deg/s; give --units gyro=rad/s."
            )
    fastest = float(np.abs(gyro).max())
    if fastest > FASTEST_GYRO:
        return [
            f"The gyroscope reads up to {fastest:.0f} rad/s, more than most can measure: "
            "check its unit (--units gyro=deg/s)."
        ]
    return []


def check_heading_unit(t: Array, gyro: Array, when: Array, heading: Array) -> None:
    """A heading must not turn faster than the device. t (n,) s, gyro (n, 3) rad/s; heading (m,)
    as rad at when (m,) s, same clock. Errors: InputError where it seems to be in degrees."""
    usable = (when >= t[0]) & (when <= t[-1]) & (np.abs(heading) < 1e7)
    when, heading = when[usable], heading[usable]
    most = float(np.quantile(np.abs(heading), 0.9)) if len(heading) else 0.0
    if most <= FEW_TURNS:
        return
    rate = np.linalg.norm(gyro, axis=1)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    _, seconds = np.unique(np.floor(when), return_index=True)
    own = float(np.abs(np.diff(heading[seconds])).sum())
    device = float(np.diff(np.interp(when[seconds], t, turned)).sum())
    if own > HEADING_FASTER * device or most > FEW_TURNS + 2.0 * float(turned[-1]):
        raise InputError(
            f"The heading is in degrees? It reads up to {np.abs(heading).max():.0f} rad and turns "
            f"by {own:.0f} rad where the gyroscope turns by {device:.0f}; if so, give "
            "--units heading=deg."
        )

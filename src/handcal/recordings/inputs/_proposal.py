"""The options that would make a recording of a table, filled in as far as its numbers tell: time
goes on, gravity has one size at rest, and it turns as the gyro says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.inputs._cells import Table
from handcal.recordings.inputs._checks import rest_magnitude
from handcal.recordings.inputs._names import ASIDE, Understood, axes_of
from handcal.recordings.inputs._options import Options, parse_unit, si, unit_factor
from handcal.recordings.inputs._stamps import is_counter, stamped, unit_of
from handcal.recordings.inputs._turning import turning
from handcal.types import Array, Imu, InputError

UNKNOWN = "?"
# By how much gravity at rest may be off in its unit; what holds for SI, m/s^2.
_NEAR, _SI_GRAVITY = 0.15, (5.0, 20.0)
_ACCEL = ("m/s^2", "g", "mg", *(f"g/{2**k}" for k in range(14, 9, -1)))
# Counts of the usual full scales: 250 to 2000 deg/s of 16 bits, and ST's mdeg/s a count.
_GYRO = ("rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/s/131", "deg/s/65.5", "deg/s/32.8",
         "deg/s/16.4", "mdeg/s*4.375", "mdeg/s*8.75", "mdeg/s*17.5", "mdeg/s*35",
         "mdeg/s*70")  # fmt: skip
_ROWS, _CLEARLY, _SPREAD = 200_000, 0.5, 0.2
_SHORT = {"gyro": "g", "accel": "a", "mag": "m", "time": "t", "temperature": "temp"}


def implausible(accel: Array) -> str | None:
    """A sentence where an accelerometer (n, 3) without a stated unit reads gravity in one that is
    not SI."""
    rest = _rest(accel)
    if not rest or _SI_GRAVITY[0] <= rest <= _SI_GRAVITY[1] or _unit_of_gravity(rest) is None:
        return None
    return f"the accelerometer reads {rest:.4g} at rest, and its unit is not stated"


def refusal(table: Table, known: Understood, options: Options, wrong: Sequence[str]) -> InputError:
    """What is wrong with a table, and the options to type."""
    found = _guessed(table, known, options)
    words = []
    if found.columns:
        words.append(f"--columns {','.join(found.columns)}")
    if found.rate:
        words.append("--rate HZ")
    if found.units:
        words.append("--units " + ",".join(f"{q}={unit}" for q, unit in found.units.items()))
    text = f"{table.path}: {'; '.join(wrong)}."
    if words:
        text += f" By its numbers, give {' '.join(words)}{_explained(found)}."
    if not found.columns and known.missing:
        text += " Expected: t, gx, gy, gz, ax, ay, az and, if there, mx, my, mz, temp, heading."
    return InputError(text)


@dataclass(frozen=True)
class _Guess:
    """columns: () where the table's names do; rate: whether one has to be given; units: to be
    stated, by quantity."""

    columns: tuple[str, ...]
    rate: bool
    units: Mapping[str, str]


def _explained(found: _Guess) -> str:
    parts = []
    if UNKNOWN in found.columns:
        parts.append(f"{UNKNOWN} is for you to name, as gx, ax, mx; {ASIDE} leaves a column aside")
    if found.rate:
        parts.append(
            "HZ is how many samples there are a second; --units time=ms, if time counts such"
        )
    if "/131" in found.units.get("gyro", ""):
        parts.append("131 counts to a deg/s are a full scale of 250 deg/s, 65.5 of 500, 32.8 of "
                     "1000, 16.4 of 2000")  # fmt: skip
    return f" ({'; '.join(parts)})" if parts else ""


def _guessed(table: Table, known: Understood, options: Options) -> _Guess:
    """What its numbers say of a table."""
    numbers = _numbers(table)
    if not len(numbers):
        return _Guess((), False, {})
    names = [UNKNOWN] * table.width
    for quantity, found in known.found.items():
        for _, places in found.terms:
            for axis, at in zip(axes_of(quantity), places, strict=True):
                names[at] = _SHORT.get(quantity, quantity) + axis
    changing = [k for k in range(table.width) if np.ptp(numbers[:, k]) > 0]
    names = [ASIDE if n == UNKNOWN and k not in changing else n for k, n in enumerate(names)]
    before = list(names)
    if "t" not in names and not (options.rate_hz or table.rate_hz):
        _name_time(names, numbers)
    t = _seconds(names, numbers, options.rate_hz or table.rate_hz)
    t = _by_clock(table, known, len(numbers)) if t is None else t
    units: dict[str, str] = {}
    accel = _places(names, "a")
    if not accel:
        accel = _name_accel(names, numbers)
    force = None
    if accel:
        unit = _unit_of_gravity(_rest(numbers[:, accel]))
        stated = options.units.get("accel") or (_stated(known, "accel"))
        if unit and not stated and unit != si("accel"):
            units["accel"] = unit
        chosen = stated or unit
        force = numbers[:, accel] * unit_factor("accel", chosen) if chosen else None
    gyro_unit = options.units.get("gyro") or _stated(known, "gyro")
    if not gyro_unit:
        unit = _name_gyro(names, numbers, t, force, "/" in units.get("accel", ""))
        if unit and unit != si("gyro"):
            units["gyro"] = unit
    rate = not (options.rate_hz or table.rate_hz) and t is None
    lost = {one.split()[0] for one in known.missing} & {"gyro", "accel"}
    whole = _places(names, "a") and _places(names, "g") and names != before
    new = not table.names or (known.missing and whole) or (lost and UNKNOWN in names)
    return _Guess(tuple(names) if new else (), rate, units)


def _by_clock(table: Table, known: Understood, size: int) -> Array | None:
    """Times (n,), s, of a table whose times are the clock's; None where they are none."""
    time = known.found.get("time")
    clock = None if time is None else table.clock(time.terms[0][1][0])
    if clock is None or isinstance(clock, np.ndarray):
        return None
    ns = stamped(str(table.path), clock, "", [])[:size]
    return np.asarray((ns - ns[0]) / 1e9)


def _stated(known: Understood, quantity: str) -> str:
    """The unit that the file states, as far as it is one."""
    unit = known.found[quantity].unit if quantity in known.found else ""
    return (parse_unit(quantity, unit) or "") if unit else ""


def _numbers(table: Table) -> Array:
    """All columns (n, width) that are numbers; zeros for the others."""
    out: list[Array | None] = []
    for k in range(table.width):
        try:
            out.append(np.nan_to_num(table.numbers([k])[:_ROWS, 0], posinf=0.0, neginf=0.0))
        except InputError:
            out.append(None)
    size = max((len(one) for one in out if one is not None), default=0)
    held = np.zeros((size, table.width))
    for k, one in enumerate(out):
        if one is not None:
            held[:, k] = one
    return held


def _places(names: Sequence[str], short: str) -> list[int]:
    """Where the three axes stand, [] where not all do."""
    wanted = [short + axis for axis in "xyz"]
    return [names.index(name) for name in wanted] if set(wanted) <= set(names) else []


def _free(names: Sequence[str]) -> list[int]:
    return [k for k, name in enumerate(names) if name == UNKNOWN]


def _triples(names: Sequence[str]) -> list[list[int]]:
    """Three columns beside each other that are not named."""
    free = set(_free(names))
    return [[k, k + 1, k + 2] for k in sorted(free) if {k, k + 1, k + 2} <= free]


def _name_time(names: list[str], numbers: Array) -> None:
    """The first column that always increases, by steps that are alike."""
    for k in _free(names):
        steps = np.diff(numbers[:, k])
        if len(steps) and np.all(steps > 0) and np.median(steps) > 0.2 * steps.mean():
            names[k] = ASIDE if is_counter(numbers[:, k]) else "t"
            if names[k] == "t":
                return


def _seconds(names: Sequence[str], numbers: Array, rate_hz: float | None) -> Array | None:
    if rate_hz:
        return np.arange(len(numbers)) / rate_hz
    if "t" not in names:
        return None
    t = numbers[:, names.index("t")]
    if not np.ptp(t) or np.any(np.diff(t) <= 0) or is_counter(t):
        return None
    seconds: Array = (t - t[0]) * (unit_factor("time", unit_of(t)) / 1e9)
    return seconds


def _rest(accel: Array) -> float:
    finite = accel[np.all(np.isfinite(accel), axis=1)]
    return rest_magnitude(finite, 50.0) if len(finite) else 0.0


def _unit_of_gravity(rest: float) -> str | None:
    """The unit in which gravity would read so much."""
    for unit in _ACCEL:
        if abs(rest * unit_factor("accel", unit) / STANDARD_GRAVITY - 1.0) < _NEAR:
            return unit
    return None


def _name_accel(names: list[str], numbers: Array) -> list[int]:
    """Name the three columns whose size is gravity's, in some unit, and varies the least."""
    best, spread = [], _SPREAD
    for places in _triples(names):
        size = np.linalg.norm(numbers[:, places], axis=1)
        middle = float(np.median(size))
        apart = float(np.median(np.abs(size - middle))) / middle if middle else np.inf
        if apart < spread and _unit_of_gravity(_rest(numbers[:, places])):
            best, spread = places, apart
    for axis, at in zip("xyz", best, strict=False):
        names[at] = f"a{axis}"
    return best


def _name_gyro(
    names: list[str], numbers: Array, t: Array | None, force: Array | None, counts: bool
) -> str:
    """Name the three columns that turn as gravity does, and the unit in which they do; "" where
    that is not known. counts: the accelerometer is in such."""
    named = _places(names, "g")
    choices = [named] if named else _triples(names)
    best, unit, least = [], "", _CLEARLY
    for places in choices:
        if t is None or force is None:
            break
        sound = np.ones(len(t), dtype=np.bool_)
        motion = turning(Imu(t, numbers[:, places], force, sound), STANDARD_GRAVITY)
        if motion is not None and motion.mapped < least * motion.still:
            least = motion.mapped / motion.still
            off = [abs(np.log(unit_factor("gyro", one) / motion.factor)) for one in _GYRO]
            best, unit = places, _GYRO[int(np.argmin(off))]
    if not best and len(choices) == 1 and force is not None:
        best = choices[0]
    for axis, at in zip("xyz", best, strict=False):
        names[at] = f"g{axis}"
    return unit or ("deg/s/131" if counts and best else "")

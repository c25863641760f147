"""What the user may say about a file, and the units he may say it in."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.streams import DEGREE, STREAMS
from handcal.types import Array, InputError

# The sensors of an IMU, each of which may be in a topic of its own.
HALVES = ("gyro", "accel")
ALONE = (
    "Only handcal allan takes a gyroscope or an accelerometer alone, and handcal lab scalar an "
    "accelerometer."
)
# Factors to SI; of time, to nanoseconds.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},
    "gyro": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": DEGREE, "mdeg/s": DEGREE * 1e-3},
    "accel": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3},
}
TURNED = ("gyro", "accel", "mag")
_NUMBER = r"\d*\.?\d+(?:e[+-]?\d+)?"
# Other names of units, without blanks, brackets and lines below.
_OF_ONE = {("gyro", word): f"{word[:3]}/s" for word in ("rad", "deg", "radians", "degrees")}
_SPELLINGS = {
    "dps": "deg/s",
    "mdps": "mdeg/s",
    "degrees/s": "deg/s",
    "deg/sec": "deg/s",
    "rad/sec": "rad/s",
    "radians/s": "rad/s",
    "d/s": "deg/s",
    "rads": "rad/s",
    "radps": "rad/s",
    "radsec": "rad/s",
    "rads-1": "rad/s",
    "rads^-1": "rad/s",
    "degs": "deg/s",
    "degps": "deg/s",
    "degree/s": "deg/s",
    "degrees/sec": "deg/s",
    "degrees/second": "deg/s",
    "deg/second": "deg/s",
    "radians/sec": "rad/s",
    "radians/second": "rad/s",
    "rad/second": "rad/s",
    "rps": "rad/s",
    "degsec": "deg/s",
    "degs-1": "deg/s",
    "degs^-1": "deg/s",
    "m/s2": "m/s^2",
    "m/sec2": "m/s^2",
    "m/sec^2": "m/s^2",
    "ms2": "m/s^2",
    "ms^2": "m/s^2",
    "mss": "m/s^2",
    "mps2": "m/s^2",
    "ms^-2": "m/s^2",
    "milli-g": "mg",
    "millig": "mg",
    "mgs": "mg",
    "gs": "g",
    "m/s/s": "m/s^2",
    "ms-2": "m/s^2",
    "tesla": "t",
    "utesla": "ut",
    "seconds": "s",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "useconds": "us",
    "nsec": "ns",
    "nanos": "ns",
    "nanosec": "ns",
    "nanoseconds": "ns",
    "c": "degc",
    "celsius": "degc",
    "℃": "degc",
    "degrees": "deg",
    "radians": "rad",
}


def quantities() -> Mapping[str, Mapping[str, float]]:
    """The units of each quantity that a file may hold, as factors to SI; SI first."""
    return {**_UNITS, **{row.name: row.units for row in STREAMS.values() if row.units}}


@dataclass(frozen=True)
class Options:
    """What ``load`` is told of a file.

    units: by quantity, as ``parse_unit`` spells them. columns: what the columns of a table are,
    in their order, "-" for one that is left aside. rate_hz: of a table without times, or whose
    time counts samples. axes: of a sensor, which of its axes stand for the IMU's x, y, z. needs:
    which of gyro and accelerometer there have to be.
    """

    topics: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    progress: Callable[[float], None] = lambda _fraction: None
    columns: tuple[str, ...] = ()
    rate_hz: float | None = None
    axes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    needs: tuple[str, ...] = HALVES

    def factor(self, quantity: str, usual: str = "") -> float:
        """From the file's unit to SI: the unit that the user names, else the usual, else SI."""
        return unit_factor(quantity, self.units.get(quantity) or usual or si(quantity))

    def on_axes(self, sensor: str, value: Array) -> Array:
        """Readings (n, 3) of a sensor on the IMU's axes."""
        return permuted(value, self.axes[sensor]) if sensor in self.axes else value


def si(quantity: str) -> str:
    """The SI unit of a quantity; "" of what has none."""
    return next(iter(quantities().get(quantity, {"": 1.0})))


def permuted(value: Array, axes: Sequence[str]) -> Array:
    """Readings (n, 3) whose axes, such as ("y", "x", "-z"), stand for x, y, z."""
    signs = [-1.0 if axis.startswith("-") else 1.0 for axis in axes]
    return value[:, ["xyz".index(axis[-1]) for axis in axes]] * signs


def parse_unit(quantity: str, text: str) -> str | None:
    """The unit as spelt in ``quantities``, with a number behind it where there is one (g/16384,
    mg*0.061); None if it is none of that quantity's."""
    unit = text.strip().lower().replace("µ", "u").replace("μ", "u").replace("micro", "u")
    unit = unit.replace("°", "deg").replace("²", "^2").replace("⁻", "-").replace("**", "^")
    plain = re.sub(r"[\s_()·]|\.(?=[a-z])", "", unit)
    plain = _OF_ONE.get((quantity, plain), _SPELLINGS.get(plain, plain))
    if quantity in STREAMS:
        plain = STREAMS[quantity].spellings.get(plain, plain)
    if plain in quantities()[quantity]:
        return plain
    if match := re.fullmatch(rf"(.+?)\s*([/*])\s*({_NUMBER})", unit):
        base, sign, number = match.groups()
    elif match := re.fullmatch(rf"({_NUMBER})\s*\*?\s*(.+)", unit):
        number, base, sign = match[1], match[2], "*"
    else:
        return None
    known = parse_unit(quantity, base) if not re.search(_NUMBER + "$", base) else None
    return f"{known}{sign}{number}" if known and 0 < float(number) < 1e12 else None


def unit_factor(quantity: str, unit: str) -> float:
    """From a unit, as ``parse_unit`` spells it, to SI; of time to ns."""
    known = quantities()[quantity]
    if unit in known:
        return known[unit]
    base, sign, number = re.split(r"([/*])(?=[^/*]*$)", unit)
    return known[base] / float(number) if sign == "/" else known[base] * float(number)


def checked_options(
    topics: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
    progress: Callable[[float], None] | None,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    axes: Mapping[str, str] | None = None,
) -> Options:
    """Options with names and units that exist. Errors: InputError."""
    for stream in topics or {}:
        if stream not in STREAMS and stream not in HALVES:
            known_streams = ", ".join((*STREAMS, *HALVES))
            raise InputError(f"--topic {stream}=...: the streams are {known_streams}.")
    known: dict[str, str] = {}
    known_units = quantities()
    for quantity, text in (units or {}).items():
        if quantity not in known_units:
            listed = ", ".join(known_units)
            raise InputError(f"--units {quantity}=...: the quantities are {listed}.")
        unit = parse_unit(quantity, text)
        if unit is None:
            choices = ", ".join(known_units[quantity])
            raise InputError(
                f"--units {quantity}={text}: the units of {quantity} are {choices}, each also by "
                "a number (/131, *0.061)."
            )
        known[quantity] = unit
    if rate_hz is not None and not 0 < rate_hz < 1e6:
        raise InputError(f"--rate {rate_hz:g}: expected how many samples a second has, as 100.")
    told = {sensor: _axes(sensor, text) for sensor, text in (axes or {}).items()}
    options = Options(dict(topics or {}), known, columns=tuple(columns), rate_hz=rate_hz, axes=told)
    return options if progress is None else replace(options, progress=progress)


def _axes(sensor: str, text: str) -> tuple[str, ...]:
    """``y,x,-z`` of a sensor. Errors: InputError."""
    axes = tuple(word.strip().lower().removeprefix("+") for word in text.split(","))
    if sensor not in TURNED:
        raise InputError(f"--axes {sensor}=...: the sensors are {', '.join(TURNED)}.")
    if sorted(axis.removeprefix("-") for axis in axes) != ["x", "y", "z"]:
        raise InputError(
            f"--axes {sensor}={text}: expected which of its axes stand for the IMU's x, y, z, as "
            f"{sensor}=y,x,-z."
        )
    return axes

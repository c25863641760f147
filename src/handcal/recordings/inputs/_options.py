"""What the user may say about a file, and the units he may say it in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from handcal.earth import STANDARD_GRAVITY
from handcal.recordings.streams import DEGREE, STREAMS
from handcal.types import InputError

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
_SPELLINGS = {
    "dps": "deg/s",
    "mdps": "mdeg/s",
    "degrees/s": "deg/s",
    "deg/sec": "deg/s",
    "rad/sec": "rad/s",
    "radians/s": "rad/s",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
    "ms-2": "m/s^2",
    "tesla": "t",
    "microtesla": "ut",
    "seconds": "s",
    "sec": "s",
    "c": "degc",
    "celsius": "degc",
    "degrees": "deg",
    "radians": "rad",
}


def quantities() -> Mapping[str, Mapping[str, float]]:
    """The units of each quantity that a file may hold, as factors to SI; SI first."""
    return {**_UNITS, **{row.name: row.units for row in STREAMS.values() if row.units}}


@dataclass(frozen=True)
class Options:
    """What ``load`` was told. units: by quantity, as spelt in ``quantities``. needs: which of gyro
    and accelerometer there have to be."""

    topics: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    progress: Callable[[float], None] = lambda _fraction: None
    needs: tuple[str, ...] = HALVES

    def factor(self, quantity: str) -> float:
        """From the file's unit to SI: the unit the user named, else SI itself."""
        units = quantities()[quantity]
        return units[self.units.get(quantity, next(iter(units)))]


def parse_unit(quantity: str, text: str) -> str | None:
    """The unit as spelt in ``quantities``, or None if it is none of that quantity's."""
    unit = text.strip().lower().replace("µ", "u").replace("μ", "u")
    unit = unit.replace("°", "deg").replace("²", "^2").replace(" ", "")
    unit = _SPELLINGS.get(unit, unit)
    if quantity in STREAMS:
        unit = STREAMS[quantity].spellings.get(unit, unit)
    return unit if unit in quantities()[quantity] else None


def checked_options(
    topics: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
    progress: Callable[[float], None] | None,
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
            raise InputError(f"--units {quantity}={text}: the units of {quantity} are {choices}.")
        known[quantity] = unit
    options = Options(dict(topics or {}), known)
    return options if progress is None else Options(options.topics, known, progress)

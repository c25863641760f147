"""What the user may say about a file, and the units he may say it in."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from handcal.types import InputError

GRAVITY = 9.80665
DEGREE = math.pi / 180

STREAMS = ("imu", "reference", "heading", "mag", "temperature", "pose")

# Factors to SI; of time, to nanoseconds.
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},
    "gyro": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": DEGREE, "mdeg/s": DEGREE * 1e-3},
    "accel": {"m/s^2": 1.0, "g": GRAVITY, "mg": GRAVITY * 1e-3},
    "mag": {"t": 1.0, "mt": 1e-3, "ut": 1e-6, "nt": 1e-9, "gauss": 1e-4, "mgauss": 1e-7},
    "heading": {"rad": 1.0, "deg": DEGREE},
    "temperature": {"degc": 1.0},
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


@dataclass(frozen=True)
class Options:
    """What ``load`` was told. units: by quantity, as spelt in UNITS."""

    topics: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    progress: Callable[[float], None] = lambda _fraction: None

    def factor(self, quantity: str, default: str) -> float:
        """From the file's unit to SI: the unit the user named, else the default."""
        return UNITS[quantity][self.units.get(quantity, default)]


def parse_unit(quantity: str, text: str) -> str | None:
    """The unit as spelt in UNITS, or None if it is none of that quantity's."""
    unit = text.strip().lower().replace("µ", "u").replace("μ", "u")
    unit = unit.replace("°", "deg").replace("²", "^2").replace(" ", "")
    unit = _SPELLINGS.get(unit, unit)
    if quantity == "mag":
        unit = {"g": "gauss", "mg": "mgauss"}.get(unit, unit)
    return unit if unit in UNITS[quantity] else None


def checked_options(
    topics: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
    progress: Callable[[float], None] | None,
) -> Options:
    """Options with names and units that exist. Errors: InputError."""
    for stream in topics or {}:
        if stream not in STREAMS:
            raise InputError(f"--topic {stream}=...: the streams are {', '.join(STREAMS)}.")
    known: dict[str, str] = {}
    for quantity, text in (units or {}).items():
        if quantity not in UNITS:
            raise InputError(f"--units {quantity}=...: the quantities are {', '.join(UNITS)}.")
        unit = parse_unit(quantity, text)
        if unit is None:
            choices = ", ".join(UNITS[quantity])
            raise InputError(f"--units {quantity}={text}: the units of {quantity} are {choices}.")
        known[quantity] = unit
    options = Options(dict(topics or {}), known)
    return options if progress is None else Options(options.topics, known, progress)

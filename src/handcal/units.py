"""Units as people think of them. Inside, everything is SI.

Inside ``showing`` numbers are shown in the units that somebody asked for; otherwise in those of
``_UNITS``, by size.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from handcal.did_you_mean import did_you_mean
from handcal.earth import STANDARD_GRAVITY
from handcal.types import InputError

# What takes rad to degrees, and m/s^2 to thousandths of standard gravity.
DEG = 180.0 / math.pi
MG = 1000.0 / STANDARD_GRAVITY

# SI unit without brackets and blanks -> (shown unit, factor, used up to this shown value)
_UNITS: dict[str, tuple[tuple[str, float, float], ...]] = {
    "rad/s": (("deg/h", 3600 * DEG, 100.0), ("deg/s", DEG, math.inf)),
    "m/s^2": (("mg", MG, math.inf),),
    "1": (("ppm", 1e6, 1000.0), ("%", 100.0, math.inf)),
    "1e-6": (("ppm", 1.0, math.inf),),
    "rad": (("deg", DEG, math.inf),),
    "m": (("mm", 1000.0, 1000.0), ("m", 1.0, math.inf)),
    "s": (("ms", 1000.0, 1000.0), ("s", 1.0, math.inf)),
    "m/s": (("mm/s", 1000.0, 1000.0), ("m/s", 1.0, math.inf)),
    "tesla": (("µT", 1e6, math.inf),),
    "tesla/m": (("µT/m", 1e6, math.inf),),
    "s/rad": (("%/(100 deg/s)", 1e4 / DEG, math.inf),),
    "s^2/m": (("mg/g²", 1000.0 * STANDARD_GRAVITY, math.inf),),
    "rad/s/m/s^2": (("deg/s/g", DEG * STANDARD_GRAVITY, math.inf),),
    "rad/s/K": (("deg/s/K", DEG, math.inf),),
    "m/s^2/K": (("mg/K", MG, math.inf),),
    "rad/s/sqrts": (("deg/s/√s", DEG, math.inf),),
    "m/s^2/sqrts": (("mg/√s", MG, math.inf),),
    "rad/s/sqrtHz": (("mdeg/s/√Hz", 1000 * DEG, 1000.0), ("deg/s/√Hz", DEG, math.inf)),
    "m/s^2/sqrtHz": (("µg/√Hz", 1000 * MG, 1000.0), ("mg/√Hz", MG, math.inf)),
    "rad/sqrts": (("deg/√s", DEG, math.inf),),
    "m/rad/s": (("mm/(100 deg/s)", 1e5 / DEG, math.inf),),
    "m/s/sqrts": (("mm/s/√s", 1000.0, math.inf),),
}


# What may be asked for: of the SI units that begin so, the shown unit and its factor; None: as SI
# has it. Units that are made of several (deg/s/K) go with those they begin with.
WORDS: dict[str, tuple[str, dict[str, tuple[str, float]] | None]] = {
    "deg": ("rad", {"rad": ("deg", DEG), "rad/s": ("deg/s", DEG)}),
    "deg/h": ("rad/s", {"rad/s": ("deg/h", 3600 * DEG)}),
    "mrad": ("rad", {"rad": ("mrad", 1000.0), "rad/s": ("mrad/s", 1000.0)}),
    "rad": ("rad", None),
    "mg": ("m/s^2", {"m/s^2": ("mg", MG)}),
    "g": ("m/s^2", {"m/s^2": ("g", 1e-3 * MG)}),
    "m/s^2": ("m/s^2", None),
    "percent": ("1", {"1": ("%", 100.0), "1e-6": ("%", 1e-4)}),
    "ppm": ("1", {"1": ("ppm", 1e6), "1e-6": ("ppm", 1.0)}),
    "mm": ("m", {"m": ("mm", 1000.0)}),
    "ms": ("s", {"s": ("ms", 1000.0)}),
}
SI = "si"
MOST_DIGITS = 7  # behind the point; smaller numbers are shown with a power of ten
_ASKED: ContextVar[tuple[str, ...]] = ContextVar("units", default=())


@contextmanager
def showing(words: Sequence[str]) -> Iterator[None]:
    """Inside, numbers are shown in these units: "si", or some of ``WORDS``, the others as usual.

    Raises InputError for a word that is unknown.
    """
    for word in words:
        if word != SI and word not in WORDS:
            meant = did_you_mean(word, [SI, *WORDS])
            raise InputError(
                f"--units {word}: expected a unit to show numbers in (si, or of "
                f"{', '.join(WORDS)}), or NAME=UNIT of what is in the file (accel=g).{meant}"
            )
    token = _ASKED.set(tuple(words))
    try:
        yield
    finally:
        _ASKED.reset(token)


def _asked(key: str) -> tuple[str, float] | None:
    """The unit that was asked for, of an SI unit; None for the usual."""
    for word in _ASKED.get():
        if word == SI:
            return ("" if key == "1" else key), 1.0
        first, units = WORDS[word]
        if units is not None and key in units:
            return units[key]
        if units is None and key.startswith(first):
            return key, 1.0
    return None


def plain(value: float, digits: int) -> str:
    """A number with so many digits that count, and no power of ten."""
    if not math.isfinite(value):
        return "–"
    places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    text = f"{round(value, places):.{max(places, 0)}f}"
    return text.replace("-", "−") if float(text) else "0"


@dataclass(frozen=True)
class Shown:
    """A unit for people and the factor that takes SI to it."""

    unit: str
    factor: float

    def value(self, value: float, sigma: float | None = None, sign: bool = False) -> str:
        """The number with as many digits as ``sigma`` (SI) justifies, three without one."""
        scaled = value * self.factor
        if not math.isfinite(scaled):
            return "–"
        size = abs(self.factor * sigma) if sigma is not None else 0.0
        if not (math.isfinite(size) and size > 0):
            return f"{scaled:.0f}" if abs(scaled) >= 1000 else f"{scaled:.3g}"
        digits = max(1 - math.floor(math.log10(size)), 0)
        if digits > MOST_DIGITS:
            more = max(math.floor(math.log10(abs(scaled) or size)) + digits, 0)
            return f"{scaled:{'+' if sign else ''}.{min(more, MOST_DIGITS)}e}".replace("-", "−")
        text = f"{scaled:{'+' if sign else ''}.{digits}f}"
        # (what rounds to nothing has no sign)
        return text.replace("-", "−") if text.strip("+-0.") else text.lstrip("+-")


def shown(unit: str, values: Iterable[float]) -> Shown:
    """The friendly unit for numbers of this SI unit and size."""
    key = unit.replace("(", "").replace(")", "").replace(" ", "")
    if (asked := _asked(key)) is not None:
        return Shown((unit if asked[0] == key else asked[0]).replace("s^2", "s²"), asked[1])
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    for name, factor, limit in _UNITS.get(key, ()):
        if largest * factor <= limit:
            return Shown(name, factor)
    return Shown("" if is_number(unit) else unit, 1.0)


def is_number(unit: str) -> bool:
    """Whether a unit is none: "1", or one over itself."""
    return unit == "1" or re.fullmatch(r"\((.+)\)/\(\1\)", unit) is not None

"""Units as people think of them. Inside, everything is SI."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from handcal.earth import STANDARD_GRAVITY

# What takes rad to degrees, and m/s^2 to thousandths of standard gravity.
DEG = 180.0 / math.pi
MG = 1000.0 / STANDARD_GRAVITY

# SI unit without brackets and blanks -> (shown unit, factor, used up to this shown value)
_UNITS: dict[str, tuple[tuple[str, float, float], ...]] = {
    "rad/s": (("deg/h", 3600 * DEG, 100.0), ("deg/s", DEG, math.inf)),
    "m/s^2": (("mg", MG, math.inf),),
    "1": (("ppm", 1e6, 1000.0), ("%", 100.0, math.inf)),
    "1e-6": (("ppm", 1.0, math.inf),),
    "rad": (("mrad", 1000.0, 5.0), ("deg", DEG, math.inf)),
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
        digits = min(max(1 - math.floor(math.log10(size)), 0), 7)
        return f"{scaled:{'+' if sign else ''}.{digits}f}".replace("-", "−")


def shown(unit: str, values: Iterable[float]) -> Shown:
    """The friendly unit for numbers of this SI unit and size."""
    key = unit.replace("(", "").replace(")", "").replace(" ", "")
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    for name, factor, limit in _UNITS.get(key, ()):
        if largest * factor <= limit:
            return Shown(name, factor)
    return Shown("" if unit == "1" else unit, 1.0)

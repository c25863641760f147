"""What would help a fit that is refused: a further effect that leaves less, or fewer effects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from handcal.effects import catalogue
from handcal.lab.choice import chosen
from handcal.types import InputError
from handcal.units import shown

# What a fit with these effects leaves beyond the noise, by kind, SI; None where it is refused.
Leaves = Callable[[Sequence[str]], Mapping[str, float] | None]
KINDS = {
    "gyro": ("rad/s", "of the gyroscope's readings"),
    "accel": ("m/s^2", "of the accelerometer's readings"),
    "turn": ("rad", "of the turns between rests"),
}
# What is much, of each.
MUCH = {"gyro": 0.01, "accel": 0.2, "turn": 0.01}
# Squares of the residuals of these effects with others besides, about the estimate without them.
Beside = Callable[[Sequence[str]], float]
# So many further effects are fitted, those that leave the least to first order.
TRIED = 3
# A further effect helps that leaves less than this part.
HELPS = 0.5
# Without more than so many of its effects it is another calibration.
MOST_LEFT_OUT = 3


@dataclass(frozen=True)
class Fits:
    """A method's fits: what they leave, and to first order with others beside; the ids that were
    asked for; sensors that were read; temperature: whether it is known."""

    leaves: Leaves
    beside: Beside
    ids: tuple[str, ...]
    sensors: tuple[str, ...]
    temperature: bool


def of_misfit(fits: Fits, left: Mapping[str, float]) -> str:
    """What these effects leave, and the further one that would leave least; left: by kind."""
    kind = max(left, key=lambda k: left[k] / MUCH[k])
    said = f"These effects leave {_much(kind, left[kind])} {KINDS[kind][1]} unexplained"
    likely = sorted(_further(fits), key=lambda more: fits.beside((*fits.ids, more)))[:TRIED]
    found = [(rest[kind], more) for more in likely
             if (rest := fits.leaves((*fits.ids, more))) is not None]  # fmt: skip
    least, more = min(found, default=(left[kind], ""))
    if least < HELPS * left[kind]:
        return (
            f"{said}; {more} would leave {_much(kind, least)}: "
            f"--effects {','.join((*fits.ids, more))}."
        )
    return f"{said}, and no further effect would leave half of it."


def fewer(fits: Fits) -> tuple[str, ...]:
    """The effects that would work, as many as can be; of as many, those that leave least."""
    for out in range(1, min(MOST_LEFT_OUT, len(fits.ids) - 1) + 1):
        found = [(sum(v / MUCH[k] for k, v in rest.items()), ids)
                 for ids in combinations(fits.ids, len(fits.ids) - out)
                 if (rest := fits.leaves(ids)) is not None]  # fmt: skip
        if found:
            return min(found)[1]
    return ()


def _further(fits: Fits) -> Iterator[str]:
    """Effects that could be estimated beside these."""
    for e in catalogue():
        if e in fits.ids or e in ("gyro_bias", "accel_bias"):
            continue
        try:
            chosen([*fits.ids, e], fits.temperature)
        except InputError:
            continue
        if "gyro" in fits.sensors or not e.startswith("gyro"):
            yield e


def _much(kind: str, value: float) -> str:
    unit = shown(KINDS[kind][0], (value,))
    return f"{value * unit.factor:.2g} {unit.unit}"

"""What a strange law is: a response of one sensor to drivers, and how it is drawn.

Drivers, in the simulator's words (templates: i stands for the axis that errs, j and k for the
next two; ``past X``: what X was before counts, not only what it is):

omega_x, f_x, alpha_x, jerk_x: rate, specific force, and how fast each of them changes;
up_x, north_x: what points up, or north, in body axes; |omega|, |f|, |alpha|, |jerk|: sizes;
tilt: angle between body z and up; heading; turn: rate about the vertical; T; t.

A response acts on drivers in units of ``UNITS``, called u, v, w in formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strangers import AXES, Scene

# fn(t, u, ...) -> (n,), and the same as text.
Response = Callable[[np.random.Generator], tuple[Callable[..., Array], str]]

# By what drivers are divided: about the root mean square of each in a hand that turns freely.
UNITS: dict[str, tuple[float, str]] = {
    "omega": (1.0, "rad/s"), "f": (6.0, "m/s^2"), "alpha": (2.0, "rad/s^2"),
    "jerk": (8.0, "m/s^3"), "up": (1.0, "1"), "north": (1.0, "1"), "tilt": (1.0, "rad"),
    "heading": (1.0, "rad"), "turn": (1.0, "rad/s"), "T": (8.0, "K"), "t": (1.0, "s"),
}  # fmt: skip
# Share of a number's range by which it is moved to see what that changes: some hundredths of what
# a recording tells of it.
NEAR = 0.003
_FIELDS = {"omega": "omega", "f": "f", "alpha": "alpha", "jerk": "jerk", "up": "up",
           "north": "north"}  # fmt: skip


@dataclass(frozen=True)
class Law:
    """A response of a sensor (gyro, accel, heading) to drivers (templates), and why it happens."""

    sensor: str
    response: Response
    drivers: tuple[str, ...]
    why: str

    @property
    def name(self) -> str:
        """Its name in answers and tables."""
        of = "_".join(d.replace("|", "").replace(" ", "_") for d in self.drivers)
        return f"{self.sensor}_{self.response.__name__}_of_{of}"

    @property
    def needs_temperature(self) -> bool:
        """Whether it cannot be told without a thermometer."""
        return any(bare(driver) == "T" for driver in self.drivers)

    @property
    def turns_with_axes(self) -> bool:
        """Whether it may be one law on all axes of its sensor."""
        return self.sensor != "heading" and any(d.endswith("_i") for d in self.drivers)


def stated(sensor: str, response: Response, drivers: str, why: str) -> Law:
    """A law as the tables of them have it, its drivers in a row."""
    return Law(sensor, response, tuple(drivers.split(", ")), why)


@dataclass(frozen=True)
class Strange:
    """A law as it was drawn, on one channel. drivers: with axes; formula: but for its size k;
    error_of(scene): the error (n,) at the scene's instants with k = 1; by_numbers(scene): its
    derivatives (n, m) by the numbers that were drawn for it, each in its range as one."""

    law: str
    channel: str
    drivers: tuple[str, ...]
    formula: str
    error_of: Callable[[Scene], Array]
    by_numbers: Callable[[Scene], Array]


class _Moved(np.random.Generator):
    """A generator of which one draw between two numbers is moved by a share of its range."""

    def __init__(self, seed: int, moved: int, share: float) -> None:
        super().__init__(np.random.PCG64(seed))
        self.draws, self.moved, self.share = 0, moved, share

    def uniform(self, low: float, high: float, size: int | None = None) -> Any:  # type: ignore[override]
        """As numpy's; of several numbers, each is a draw."""
        found = np.array(super().uniform(low, high, size))
        at = self.moved - self.draws
        if 0 <= at < found.size:
            found[(at,) if size else ()] += self.share * (high - low)
        self.draws += found.size
        return found if size else float(found)


def drawn(law: Law, axis: int, seed: int) -> Strange:
    """The law on that axis (any, for heading) with the numbers that this seed gives it."""
    counted = _Moved(seed, -1, 0.0)
    respond, text = law.response(counted)
    drivers = tuple(on_axes(driver, axis) for driver in law.drivers)
    channel = law.sensor if law.sensor == "heading" else f"{law.sensor}_{AXES[axis]}"

    def of(scene: Scene, respond: Callable[..., Array]) -> Array:
        return respond(scene.t, *(signal(scene, bare(d)) / _unit(d)[0] for d in drivers))

    def error_of(scene: Scene) -> Array:
        return of(scene, respond)

    def by_numbers(scene: Scene) -> Array:
        ends = [[of(scene, law.response(_Moved(seed, n, share))[0]) for share in (-NEAR, NEAR)]
                for n in range(counted.draws)]  # fmt: skip
        columns = [(more - less) / (2.0 * NEAR) for less, more in ends]
        return np.stack(columns, axis=1) if columns else np.zeros((len(scene.t), 0))

    given = ", ".join(
        f"{letter} = {bare(d)} / ({_unit(d)[0]:g} {_unit(d)[1]})"
        for letter, d in zip("uvw", drivers, strict=False)
    )
    formula = f"{channel} += k * ({text}); {given}"
    return Strange(law.name, channel, drivers, formula, error_of, by_numbers)


def bare(driver: str) -> str:
    """The driver without its past."""
    return driver.removeprefix("past ")


def signal(scene: Scene, name: str) -> Array:
    """A driver's values (n,) in SI, T in K above 25 degC. KeyError: there is none of this name."""
    plain = {"t": scene.t, "T": scene.warm, "heading": scene.heading}
    if name in plain:
        return plain[name]
    if name == "turn":
        return np.asarray(np.sum(scene.omega * scene.up, axis=1))
    if name == "tilt":
        return np.arccos(np.clip(scene.up[:, 2], -1.0, 1.0))
    if name.startswith("|") and name.endswith("|") and "_" not in name:
        return np.asarray(np.linalg.norm(getattr(scene, _FIELDS[name[1:-1]]), axis=1))
    if name.startswith("|") and name.endswith("|"):
        return np.abs(signal(scene, name[1:-1]))
    head, _, axis = name.partition("_")
    values: Array = getattr(scene, _FIELDS[head])[:, {"x": 0, "y": 1, "z": 2}[axis]]
    return values


def on_axes(driver: str, axis: int) -> str:
    """The driver with the letters i, j and k as axes of a sensor whose own axis this is."""
    head, _, letter = driver.partition("_")
    return (
        f"{head}_{AXES[(axis + 'ijk'.index(letter)) % 3]}" if letter in ("i", "j", "k") else driver
    )


def _unit(driver: str) -> tuple[float, str]:
    return UNITS[bare(driver).strip("|").partition("_")[0]]


def rms(values: Array) -> float:
    """Root mean square about the mean, which no sensor's bias tells from its own."""
    return math.sqrt(float(np.var(values)))

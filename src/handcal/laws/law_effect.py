"""A law without a name, as an effect: what a sensor reads too much, as a form of a driver."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.effects import (
    ROOM,
    TIME,
    WARMTH,
    Z_DIM,
    Catalogue,
    Effect,
    Param,
    Signals,
    catalogue,
    imu_jacobian,
    observed_error,
)
from handcal.effects._linear import added
from handcal.laws import grammar
from handcal.laws.drivers import AXES, HEADING, PRODUCT, Driver
from handcal.laws.grammar import Form
from handcal.laws.vocabulary import driver_of
from handcal.signals import probe
from handcal.types import Array, BoolArray

SENSORS = ("gyro", "accel", "heading")
# Of each sensor: a heading is one number.
AXES_OF = ((0, 1, 2), (0, 1, 2), (0,))
CHANNELS = tuple(f"{sensor}_{axis}" for sensor in SENSORS[:HEADING] for axis in AXES)
UNITS = ("rad/s", "m/s^2", "rad")
# Root mean square of what a law adds, one prior sigma: half a degree a second, 10 mg, 6 deg.
SIZE = (0.01, 0.1, 0.1)
# Samples of the motion on which the catalogue is tried, and the share (squared) of a law that may
# be left for it to be named: a central difference leaves far less, another law far more. Of a
# column of length one, so much must be new.
PROBED, SPANNED = 120, 1e-8
DEPENDENT = 1e-6
# Laws of which it is kept whether they have a name: more than one look has, with all its drivers.
MOST_LAWS = 20000
# Nats that a law over a driver made of several signals and an operator costs besides: with these
# there are about five times as many drivers as without. (And at one moment there are 168 products
# of two signals, and 31 single ones.)
COMPOSED = math.log(5.0)
# The size of what is one.
_SIZED = re.compile(r"\babs\((\|[^|]+\|)\)")


@dataclass(frozen=True)
class Law:
    """sensor: 0 gyro, 1 accelerometer, 2 heading; axes: one or all three; each: whether each axis
    has its own constants; driver, form: of what, and how; sigmas: prior of each constant of the
    form."""

    sensor: int
    axes: tuple[int, ...]
    each: bool
    driver: Driver
    form: Form
    sigmas: tuple[float, ...]

    def __reduce__(self) -> tuple[Callable[..., Law], tuple[str, tuple[float, ...]]]:
        """To another process it is what it is made of."""
        return again, _made(self)

    @property
    def channels(self) -> tuple[str, ...]:
        """To which it adds."""
        if self.sensor == HEADING:
            return (SENSORS[HEADING],)
        return tuple(CHANNELS[3 * self.sensor + axis] for axis in self.axes)

    @property
    def cost(self) -> float:
        """Nats by which it is less likely beforehand than the simplest law."""
        # (of a heading, waves that are felt by as much as a signal are no more than signals)
        plain = not self.driver.several or (
            self.sensor == HEADING and PRODUCT not in self.driver.name and not self.driver.composed
        )
        made = 0.0 if plain else COMPOSED
        return self.form.cost + made + (grammar.FREEDOM if self.driver.number else 0.0)

    @property
    def axis(self) -> int | None:
        """The one axis that it is of, or None."""
        return self.axes[0] if len(self.axes) == 1 else None

    @property
    def unit(self) -> str:
        """Of its curve, or of what its formula says."""
        own, factor = UNITS[self.sensor], self.driver.factor
        if factor is None or factor.unit in ("", "1"):
            return own
        return "1" if factor.unit == own else f"({own})/({factor.unit})"

    @property
    def said(self) -> str:
        """The formula: ``gyro_x += k * omega_x^3``, ``accel_xyz += g(|omega|)``."""
        left = SENSORS[self.sensor]
        if self.sensor != HEADING:
            left += f"_{''.join(AXES[a] for a in self.axes)}"
        x, own = self.driver.said(self.axis), "_i" if self.each else ""
        by = "" if self.driver.factor is None else f"{self.driver.factor.said(self.axis)} * "
        if self.form.smooth:
            return f"{left} += {by}g{own}({x})"
        many = len(self.form.texts) > 1
        parts = [
            f"k{n + 1 if many else ''}{own} * {by}{text.format(x=x)}".removesuffix(" * 1")
            for n, text in enumerate(self.form.texts)
        ]
        return f"{left} += " + _SIZED.sub(r"\1", " + ".join(parts))

    @property
    def parameters(self) -> tuple[Param, ...]:
        """Its constants, those of one axis after those of another where each has its own."""
        one = self.form.constants
        name = "c" if self.form.smooth else "k"
        names = [f"{name}{n + 1}" if one > 1 else name for n in range(one)]
        if self.each:
            names = [f"{n}_{AXES[a]}" for a in self.axes for n in names]
        units = [_unit(self.unit, self.driver.unit, p) for p in self.form.powers]
        rows = zip(names, [*units] * 3, [*self.sigmas] * 3, strict=False)
        return tuple(Param(*row, self.driver.positive == self.sensor) for row in rows)

    def values(self, signals: Signals, axis: int) -> Array:
        """What a unit of each constant of the form adds on one axis, (n, k)."""
        scale = np.reshape(self.driver.scale(signals, axis), (-1, 1))
        return np.asarray(self.form.values(self.driver.course(signals, axis)) * scale)


def _unit(own: str, driver: str, power: float) -> str:
    if power == 0 or driver in ("", "1"):
        return own
    return f"({own})/({driver})" + (f"^{power:g}" if power != 1 else "")


def effect_of(law: Law) -> Effect:
    """The law as an effect, linear in its constants."""
    root = law.form.root
    if root is not None and law.each:
        root = np.asarray(np.kron(np.eye(len(law.axes)), root))
    return Effect(
        id=law.said,
        title=law.said,
        parameters=law.parameters,
        story="",
        source="found in this recording",
        motion="The motion in which it was found.",
        validated="held-out data alone",
        cost=law.cost,
        together=root,
        needs=law.driver.needs,
        made=_made(law),
        **adding(law, law.form.constants, lambda s, n: law.values(s, law.axes[n])),
    )


def adding(law: Law, each: int, columns: Callable[[Signals, int], Array]) -> dict[str, Any]:
    """The physics of an effect that adds columns(signals, n) (m, k) to the nth axis of a law, whose
    first parameter is n times ``each`` where each axis has its own."""
    if law.sensor == HEADING:
        return {"seen": {SENSORS[HEADING]: lambda signals: columns(signals, 0)}}

    def features(signals: Signals) -> list[tuple[int, int, Array]]:
        return [
            (3 * law.sensor + axis, n * each if law.each else 0, columns(signals, n))
            for n, axis in enumerate(law.axes)
        ]

    return {"imu_error": added(features), "features": features}


def _made(law: Law) -> tuple[str, tuple[float, ...]]:
    """Kind and numbers by which a law is made again."""
    axes = "".join(AXES[a] for a in law.axes)
    own = "each" if law.each else "same"
    kind = " | ".join((SENSORS[law.sensor], axes, own, law.driver.name, law.form.kind))
    return kind, (*law.form.numbers, *law.sigmas)


def again(kind: str, numbers: tuple[float, ...]) -> Law:
    """The law that was found before, by what it was made of (``Effect.made``).

    Raises KeyError or ValueError for one that there is none of.
    """
    sensor, axes, own, driver, form = kind.split(" | ")
    found = grammar.again(form, numbers)
    sigmas = numbers[len(found.numbers) :]
    places = tuple(AXES.index(a) for a in axes)
    return Law(SENSORS.index(sensor), places, own == "each", driver_of(driver), found, sigmas)


def law_of(effect: Effect) -> Law | None:
    """The law that an effect is; None where it is none."""
    return law_made(effect.made)


def law_made(made: tuple[str, tuple[float, ...]] | None) -> Law | None:
    """The law that was made of this (``Effect.made``); None where it is none."""
    return again(*made) if made is not None and is_law(made[0]) else None


def channel_of(formula: str) -> str:
    """The channel that a term adds to."""
    return formula.partition(" += ")[0]


def channels_of(term: Effect) -> tuple[str, ...]:
    """All channels to which a law, or a course on one of them, adds."""
    law = law_of(term)
    return (channel_of(term.id),) if law is None else law.channels


def is_law(kind: str) -> bool:
    """Whether this kind (``Effect.made``) is that of a law over a driver."""
    return kind.count(" | ") == 4


# --- what has a name -----------------------------------------------------------------------


def named(law: Law) -> bool:
    """Whether effects of the catalogue add up to the law, tried on a probing motion."""
    key = law.sensor, law.axes, law.each, law.driver.name, law.form.kind, law.form.numbers
    return _named(key, catalogue())


@lru_cache(maxsize=MOST_LAWS)
def _named(key: tuple[Any, ...], known: Catalogue) -> bool:
    sensor, axes, each, driver, kind, numbers = key
    form = grammar.again(kind, numbers)
    law = Law(sensor, axes, each, driver_of(driver), form, (1.0,) * form.constants)
    if sensor == HEADING:
        columns = law.values(_probing(), 0)
        # (what does not change on that motion, as the side of what is warm, tells nothing there)
        changing = np.ptp(columns, axis=0).any()
        inside = spanned(known_headings(known), columns - columns.mean(axis=0))
        return bool(changing and inside.all())
    # (an exponential may be beyond all numbers on the probing motion: that lies in no span)
    with np.errstate(over="ignore", invalid="ignore"):
        J = imu_jacobian(effect_of(law), np.zeros(0), _probing())
    return bool(spanned(_catalogue(known), J.transpose(1, 0, 2).reshape(6 * PROBED, -1)).all())


@cache
def _probing() -> Signals:
    return probe(PROBED)


@cache
def _catalogue(known: Catalogue) -> Array:
    """Basis (6 n, r) of all that effects of the catalogue add on the probing motion.

    How the axes of the body are turned against the sensors' is convention: a turn of all readings
    together is no error (what lies above the accelerometer's diagonal is the gyro's misalignment).
    """
    s = _probing()
    n = len(s.t)
    columns = [np.kron(np.eye(6), np.ones((n, 1)))]  # the biases
    for axis in np.eye(3):
        turned = np.hstack([np.cross(axis, s.gyro), np.cross(axis, s.accel)])
        columns.append(turned.T.reshape(-1, 1))
    for effect in known.values():
        J = imu_jacobian(effect, np.zeros(len(effect.parameters)), s)
        columns.append(J.transpose(1, 0, 2).reshape(6 * n, -1))
    return basis(np.hstack(columns))


@cache
def known_headings(known: Catalogue) -> Array:
    """Basis (n, r) of all that effects of the catalogue add to a heading on the probing motion; a
    constant offset is the heading's own."""
    s = _probing()
    assert s.C_nb is not None
    acting = [e for e in known.values() if "heading" in e.observation_error and not e.process]
    columns = [np.ones((len(s.t), 1)), *map(heading_columns, acting)]
    if any("heading" in e.lateness for e in known.values()):
        columns.append(np.einsum("ni,ni->n", s.C_nb[:, 2], s.gyro)[:, None])
    return basis(np.hstack(columns))


def heading_columns(effect: Effect) -> Array:
    """What an effect's parameters add to a heading on the probing motion, (n, k), to scale."""
    s = _probing()
    assert s.C_nb is not None
    assert s.temperature is not None
    n = len(s.t)
    place, speed = s.streams["pose"][:, :3], s.streams["mag"]
    nav = np.hstack([place, speed, s.C_nb.reshape(n, 9), s.gyro, s.accel])
    z = np.zeros((n, Z_DIM))
    z[:, 0], z[:, TIME] = so3.yaw_of(s.C_nb), s.t
    z[:, WARMTH] = s.temperature - ROOM
    steps = np.diag(1e-3 * effect.prior_sigma)
    pairs = [(observed_error(effect, "heading", x, nav, z, 1) for x in (-e, e)) for e in steps]
    return np.hstack([more - less for less, more in pairs])


def basis(columns: Array) -> Array:
    """Orthonormal basis (n, r) of what the columns (n, k) span, by Gram and Schmidt.

    (So few numbers are sooner done than shared out among threads, which a library would do.)
    """
    found = np.zeros((columns.shape[1], len(columns)))
    r = 0
    for column in columns.T:
        size = float(np.sqrt(np.einsum("n,n->", column, column)))
        rest = column / size if size else column
        for _ in range(2):
            inside = np.einsum("rn,n->r", found[:r], rest)
            rest = rest - np.einsum("rn,r->n", found[:r], inside)
        left = float(np.sqrt(np.einsum("n,n->", rest, rest)))
        if left > DEPENDENT:
            found[r] = rest / left
            r += 1
    return found[:r].T


def spanned(Q: Array, U: Array) -> BoolArray:
    """Which columns of U (n, q) lie in the span of the orthonormal ones Q (n, r)."""
    with np.errstate(over="ignore", invalid="ignore"):
        whole = np.einsum("nq,nq->q", U, U)
        part = np.einsum("nr,nq->rq", Q, U)
        return np.asarray(whole - np.einsum("rq,rq->q", part, part) <= SPANNED * whole)

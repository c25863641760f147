"""Which poses tell the parameters of chosen effects: what each would add to what is known.

A pose is the direction up (3,) in body axes: nothing else counts where the device rests, or
turns steadily about the vertical. What a pose tells of an effect is asked of the catalogue:
the derivative of the readings by the effect's parameters. Of a set of n poses the information
matrix is M (k, k), the mean of J' J over the poses; the design is the set with the best M.

What is known of a pose decides which readings count:

- ``norm``: only that gravity has its size; the reading is the length of the specific force.
- ``pose``: the attitude, from a cube or a dividing head; the device rests.
- ``rate``: the device turns about the vertical at a known rate, on a rate table.
- ``spin``: the same, and what counts is the change against a rest in the same attitude.

Biases are unknown too (a spin takes them off), and so is how the device is mounted where an
attitude is known, unless misalignments say it already. All parameters count alike: each in the
unit in which it changes no reading by more than that reading's standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.effects import Effect, Param, Signals, select
from handcal.estimate.regression import BIASES, Unknown, columns, unknowns, unseen
from handcal.signals import of_arrays
from handcal.types import Array, InputError

KNOWN = ("norm", "pose", "rate", "spin")
RATE = math.radians(100.0)
# Samples of a steady turn of which the middle one has no angular acceleration.
HELD = 5
# What an averaged reading is taken to be good to: rad/s, m/s^2. Sigmas are in proportion.
NOISE = (math.radians(0.01), 1e-3 * STANDARD_GRAVITY)
NOTHING = 1e-9
MOST_SAID = 3
# Along the axes, the diagonals of faces and those of the cube.
PLAIN = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
PLAIN = PLAIN / np.linalg.norm(PLAIN, axis=1, keepdims=True)


def _turned(theta: Array, signals: Signals) -> Array:
    return np.hstack([np.cross(theta, signals.gyro), np.cross(theta, signals.accel)])


MOUNTING = Effect(
    id="mounting",
    title="Mounting",
    parameters=tuple(Param(a, "rad", 0.1) for a in "xyz"),
    story="The device's axes are not quite those of whatever holds it.",
    source="rotation by a small angle",
    motion="Any.",
    validated="",
    imu_error=_turned,
)


@dataclass(frozen=True)
class Experiment:
    """What is read in each pose, and the k parameters that it is to tell.

    known: one of ``KNOWN``; effects: those asked for, then what is unknown besides; rate:
    rad/s. scale (k,): what one of the units in which parameters count is in the parameter's
    own: a parameter of that size changes a reading by at most its standard deviation ``NOISE``.
    rows: which of gyro x y z, accelerometer x y z are read.
    """

    known: str
    effects: tuple[Effect, ...]
    rate: float
    scale: Array
    rows: tuple[int, ...]

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The parameters, in order."""
        return unknowns(self.effects)

    @property
    def readings(self) -> int:
        """Number m of readings in a pose."""
        return 1 if self.known == "norm" else len(self.rows)

    def jacobian(self, up: Array) -> Array:
        """Derivatives (n, m, k) of the readings, divided by their standard deviations, in poses
        up (n, 3); parameters in units of ``scale``."""
        full = _columns(self.effects, up, self.known, self.rate)
        if self.known == "norm":
            return np.asarray(np.einsum("ni,nik->nk", up, full[:, 3:])[:, None] * self.scale)
        return np.asarray(full[:, list(self.rows)] * self.scale)

    def information(self, up: Array, weight: Array | None = None) -> Array:
        """M (k, k) of poses up (n, 3): the mean over them, or the sum with these weights (n,)."""
        J = self.jacobian(up)
        w = np.full(len(up), 1.0 / len(up)) if weight is None else weight
        return np.asarray(np.einsum("n,nmi,nmj->ij", w, J, J))

    def hidden(self, up: Array) -> str:
        """What poses up (n, 3) do not show, as combinations of parameters; "" if they show all."""
        lost = unseen(self.jacobian(up).reshape(-1, len(self.scale)), np.ones(len(self.scale)))
        said = [_combination(c * self.scale, self.unknowns) for c in lost[:MOST_SAID]]
        more = len(lost) - len(said)
        return "; ".join(said) + (f"; and {more} more" if more else "")


def _combination(c: Array, of: Sequence[Unknown]) -> str:
    """c (k,) as a sum of parameters, each in its own unit, the first of them as one."""
    inside = [(x, u.title) for x, u in zip(c, of, strict=True) if x != 0.0]
    terms = []
    for x, title in inside:
        part = x / inside[0][0]
        size = "" if abs(abs(part) - 1.0) < 1e-6 else f"{abs(part):.3g} times "
        terms.append(f"{'minus' if part < 0 else 'plus'} {size}{title}")
    return " ".join(terms).removeprefix("plus ")


def experiment(effects: Sequence[str], known: str = "norm", rate: float = RATE) -> Experiment:
    """What can be told of these effects (ids) when so much is known of the poses.

    rate: of turns, rad/s. Errors: InputError where an effect changes no reading, or cannot
    be told from others whatever the poses.
    """
    if known not in KNOWN:
        raise InputError(f"Unknown: '{known}'. What is known of a pose: {', '.join(KNOWN)}.")
    if not (math.isfinite(rate) and rate > 0.0):
        raise InputError("The rate of turning must be a number above 0.")
    chosen = select(effects)
    if not chosen:
        raise InputError("No effects are named that the poses are to tell.")
    sphere = np.vstack([PLAIN, everywhere()[0]])
    seen = {e.id: _seen(e, sphere, known, rate) for e in chosen}
    sensors = [any(s[i] for s in seen.values()) for i in range(2)]
    rows = tuple(i for i in range(6) if sensors[i // 3])
    biases = tuple(b for b, read in zip(BIASES, sensors, strict=True) if read and known != "spin")
    options = [(*chosen, *biases)]
    if known in ("pose", "rate"):
        options.insert(0, (*options[0], MOUNTING))
    lost = ""
    for option in options:
        size = np.abs(_columns(option, sphere, known, rate)[:, list(rows)]).max(axis=(0, 1))
        if not size.all():
            continue
        found = Experiment(known, option, rate, 1.0 / size, rows)
        lost = found.hidden(sphere)
        if not lost:
            return found
    raise InputError(f"No set of poses can tell these apart: {lost}. Leave one of them out.")


def _seen(effect: Effect, sphere: Array, known: str, rate: float) -> tuple[bool, bool]:
    """Whether the effect changes readings of gyro and accelerometer. Errors: InputError."""
    for need in effect.needs:
        raise InputError(
            f"{effect.id}: what it adds depends on the {need}, which a set of poses does not give."
        )
    if effect.imu_error is None or effect.process is not None:
        raise InputError(f"{effect.id} is no constant error of the IMU: poses do not show it.")
    J = np.abs(_columns((effect,), sphere, known, rate)).max(axis=0)
    counted = J[3:] if known == "norm" else J
    if not counted.any(axis=0).all():
        said = {
            "norm": "changes nothing that the size of gravity would show; more has to be known "
            "of the poses (pose, rate or spin)",
            "pose": "changes no reading at rest (rate, spin or a motion would show it)",
            "rate": "changes no reading in a steady turn (a motion would show it)",
            "spin": "does not change with a steady turn (rests in many poses would show it)",
        }
        raise InputError(f"{effect.id} {said[known]}.")
    return bool(J[:3].any()) and known != "norm", bool(J[3:].any())


def _columns(effects: Sequence[Effect], up: Array, known: str, rate: float) -> Array:
    """Derivatives (n, 6, k) of gyro and accelerometer by the parameters of effects, divided by
    the readings' standard deviations."""
    none = np.zeros(sum(len(e.parameters) for e in effects))

    def steady(rate: float) -> Array:
        times = HELD if rate else 1
        held = np.repeat(up, times, axis=0)
        truth = of_arrays(np.arange(float(len(held))), rate * held, STANDARD_GRAVITY * held)
        return columns(effects, none, truth)[times // 2 :: times]

    out = steady(rate if known in ("rate", "spin") else 0.0)
    out = out - steady(0.0) if known == "spin" else out
    out = np.where(np.abs(out) > NOTHING * max(rate, 1.0), out, 0.0)
    return np.asarray(out / np.repeat(NOISE, 3)[:, None])


def everywhere(rings: int = 12) -> tuple[Array, Array]:
    """Directions (n, 3) all over the sphere and weights (n,) that make their mean the mean over
    it, exact for polynomials of degree 2 rings - 1 (Gauss-Legendre by evenly spaced azimuths)."""
    z, w = np.polynomial.legendre.leggauss(rings)
    turns = 2 * rings
    azimuth = 2.0 * np.pi * np.arange(turns) / turns
    r = np.sqrt(1.0 - z**2)
    level = np.repeat(z[:, None], turns, axis=1)
    rings_of = [np.outer(r, np.cos(azimuth)), np.outer(r, np.sin(azimuth)), level]
    return np.stack(rings_of, axis=2).reshape(-1, 3), np.repeat(0.5 * w / turns, turns)

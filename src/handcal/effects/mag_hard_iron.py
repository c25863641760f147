"""Hard iron: magnetised parts of the device add a field that turns with it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from handcal.compiled.jit import residual_function
from handcal.effects import Effect, Param
from handcal.types import Array, InputError, Recording

PRIOR = 1e-4
# How far readings stray from the sphere, tesla: rooms bend the field.
STRAY = 3e-6
GUESS_RATE = 10.0
# The Earth's field where people live, tesla, and how much it varies.
EARTH, EARTH_SIGMA = 4.8e-5, 1.2e-5
# Two centres are one when they are that close, tesla; nats by which one is no longer worth a try.
SAME, WORSE = 5e-6, 8.0


@dataclass(frozen=True)
class Sphere:
    """Where readings may lie: centre (3,) and its sigmas (3,), tesla; cost in nats."""

    centre: Array
    sigma: Array
    cost: float


def guess(recording: Recording) -> Array:
    """A first value (3,), tesla: ``sphere``'s centre."""
    return spheres(recording)[0].centre


def sphere(recording: Recording) -> tuple[Array, Array]:
    """Centre (3,) of the likeliest sphere on which the readings lie and how well it is known (3,),
    tesla, the other spheres on which they may lie counted.

    Raises InputError without a magnetometer.
    """
    found = spheres(recording)
    best = found[0]
    weight = np.exp([best.cost - s.cost for s in found])
    away = np.array([s.centre - best.centre for s in found])
    variance = best.sigma**2 + (weight[:, None] * away**2).sum(axis=0) / weight.sum()
    return best.centre, np.minimum(np.sqrt(variance), PRIOR)


def spheres(recording: Recording) -> tuple[Sphere, ...]:
    """Spheres on which the readings may lie, the likeliest first.

    An iron may be stronger than the Earth's field, and until it is known north is unknown too:
    so this is where a fit begins. A sphere has the Earth's field for a radius; a motion
    about one axis shows a circle of it, with two centres, one on either side. As whatever bends
    the field lasts, many readings make the sigmas no smaller than the readings' own distance from
    the sphere. Robust least squares (a soft absolute value) in centre and radius.

    Raises InputError without a magnetometer.
    """
    mag = recording.streams.get("mag")
    if mag is None or len(mag.t) < 2:
        raise InputError("The recording has no magnetometer, so no hard iron can be guessed.")
    m = mag.thinned(GUESS_RATE).value
    found: list[Sphere] = []
    for start in _starts(m):
        s = _sphere(m, start)
        if all(np.linalg.norm(s.centre - other.centre) > SAME for other in found):
            found.append(s)
    found.sort(key=lambda s: s.cost)
    return tuple(s for s in found if s.cost < found[0].cost + WORSE)


def _starts(m: Array) -> list[Array]:
    """Centres (3,) from which to begin: of the sphere that fits best whatever its radius, and, as
    if the readings m (k, 3) lay on a circle, on either side of its plane."""
    mean = m.mean(axis=0)
    x = (m - mean) / EARTH
    rows = np.c_[2.0 * x, np.ones(len(x))]
    weak = np.vstack([rows, 1e-2 * math.sqrt(len(x)) * np.eye(3, 4)])
    c = np.linalg.lstsq(weak, np.r_[(x**2).sum(axis=1), np.zeros(3)], rcond=None)[0][:3]
    normal = np.linalg.svd(x, full_matrices=False)[2][2]
    flat = c - normal * (normal @ c)
    radius = float(np.median(np.linalg.norm(x - flat, axis=1)))
    height = math.sqrt(max(1.0 - radius**2, 0.04))
    return [mean + EARTH * p for p in (c, flat + height * normal, flat - height * normal)]


def _sphere(m: Array, start: Array) -> Sphere:
    """The sphere of readings m (k, 3) that is nearest to a centre (3,)."""
    from scipy.optimize import least_squares  # (slow to import, and few have a magnetometer)

    # (as many readings as have a disturbance of their own: a few a second at the most)
    share = 1.0 / math.sqrt(GUESS_RATE)

    def lost(x: Array) -> Array:
        away = share / STRAY * (np.linalg.norm(m - x[:3], axis=1) - x[3])
        # (squared, this is the soft absolute value)
        soft = away * np.sqrt(2.0 / (np.sqrt(1.0 + away**2) + 1.0))
        return np.concatenate([soft, x[:3] / PRIOR, [(x[3] - EARTH) / EARTH_SIGMA]])

    radius = float(np.median(np.linalg.norm(m - start, axis=1)))
    done = least_squares(lost, np.r_[start, radius], x_scale=1e-5, diff_step=1e-4)
    inverse = solve_triangular(np.linalg.qr(done.jac, mode="r"), np.eye(4))
    alone = np.linalg.norm(inverse[:3], axis=1)
    away = np.linalg.norm(m - done.x[:3], axis=1) - done.x[3]
    stray = max(1.0, 1.4826 * float(np.median(np.abs(away))) / STRAY)
    sigma = np.minimum(stray * np.hypot(alone, STRAY), PRIOR)
    return Sphere(done.x[:3], sigma, float(done.cost))


def cleaned(recording: Recording, iron: Array) -> Recording:
    """The recording with this iron (3,) taken off its magnetometer's readings."""
    mag = recording.streams["mag"]
    streams = {**recording.streams, "mag": replace(mag, value=mag.value - iron)}
    return replace(recording, streams=streams)


def _magnetometer(nav: Any, iron: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] -= iron[i]
    return 0


EFFECT = Effect(
    id="mag_hard_iron",
    title="Magnetometer hard iron",
    parameters=tuple(Param(axis, "tesla", PRIOR) for axis in "xyz"),
    story="Magnetised parts near the sensor add a field of their own, which turns with the device.",
    source="contract of this project; Gebre-Egziabher et al., J. Aerospace Eng. 19(2), 2006",
    motion="A full turn about at least two axes.",
    validated="the simulator's injection; motion capture of a hand-held IMU",
    common="some 10 to 500 uT in phones (their own corrections)",
    observation_error={"magnetometer": residual_function(_magnetometer)},
    conceal=lambda iron, recording, _: cleaned(recording, -iron),
    undo=lambda iron, recording: cleaned(recording, iron),
    always=True,
)

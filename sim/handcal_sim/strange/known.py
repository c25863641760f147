"""What the catalogue could make of an error: its effects as columns, by least squares.

Walks, correlated noise and outliers are left out: they take any course for their own, which
makes them no description of it.
"""

from __future__ import annotations

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strange.law import signal
from handcal_sim.strangers import AXES, Scene

# A filter looks at the held point about three times a second; what averages out in between is
# not seen.
LOOK_S = 1.0 / 3.0
# Moments at which a bias may jump: the quarters of a recording. Many would make stairs of
# anything slow, and a bias jumps but once.
_STEPS = 3


def columns(scene: Scene, channel: str) -> Array:
    """(n, m): a constant, and what each effect of the catalogue adds to this channel."""
    sensor, _, axis = channel.partition("_")
    if sensor == "heading":
        known = _heading(scene)
    else:
        known = {"gyro": _gyro, "accel": _accel}[sensor](scene, AXES.index(axis))
    return np.column_stack([np.ones(len(scene.t)), *known])


def _gyro(s: Scene, i: int) -> list[Array]:
    """Bias, scale, misalignment, g-sensitivity, square, products, temperature, bandwidth, the
    Earth's rate, a step."""
    steps = [np.where(s.t > at, 1.0, 0.0) for at in np.linspace(s.t[0], s.t[-1], _STEPS + 2)[1:-1]]
    return [*s.omega.T, *s.f.T, s.omega[:, i] ** 2, *_products(s.omega), s.warm, s.alpha[:, i],
            s.north[:, i], s.up[:, i], *steps]  # fmt: skip


def _accel(s: Scene, i: int) -> list[Array]:
    """Bias, scale, misalignment, asymmetry, products, temperature, delay, gravity, and a place
    (lever arm, size effect)."""
    j, k = (i + 1) % 3, (i + 2) % 3
    w, turned = s.omega, s.alpha
    place = [-(w[:, j] ** 2) - w[:, k] ** 2, w[:, i] * w[:, j] - turned[:, k],
             w[:, i] * w[:, k] + turned[:, j]]  # fmt: skip
    return [*s.f.T, np.abs(s.f[:, i]), *_products(s.f), s.warm, s.jerk[:, i], s.up[:, i], *place]


def _heading(s: Scene) -> list[Array]:
    """Offset, hard and soft iron, delay, drift."""
    waves = [f(n * s.heading) for n in (1, 2) for f in (np.sin, np.cos)]
    return [*waves, signal(s, "turn"), s.t]


def _products(v: Array) -> list[Array]:
    return [v[:, 0] * v[:, 1], v[:, 1] * v[:, 2], v[:, 0] * v[:, 2]]


def remainder(scene: Scene, channel: str, error: Array) -> Array:
    """What of an error (n,) no effect of the catalogue takes, nor all together; (n,)."""
    known = columns(scene, channel)
    return np.asarray(error - known @ _fitted(known, error))


def seen(scene: Scene, channel: str, error: Array) -> Array:
    """The same of the error's means over each whole ``LOOK_S``: (looks,)."""
    looks = np.floor((scene.t - scene.t[0]) / LOOK_S).astype(int)
    count = np.bincount(looks)
    whole = count > 0.5 * np.median(count)

    def means(column: Array) -> Array:
        return np.asarray(np.bincount(looks, column)[whole] / count[whole])

    known = np.column_stack([means(column) for column in columns(scene, channel).T])
    mean = means(error)
    return np.asarray(mean - known @ _fitted(known, mean))


def _fitted(known: Array, error: Array) -> Array:
    unit = np.linalg.norm(known, axis=0).clip(min=1e-12)
    return np.asarray(np.linalg.lstsq(known / unit, error, rcond=1e-9)[0] / unit)

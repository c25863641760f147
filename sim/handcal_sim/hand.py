"""What a hand adds unasked: slow sway of the held point, wobble, and tremor.

Sway and wobble are Gaussian wander of low frequency, small at rest and larger in
proportion to the rate of turning. Physiological tremor lies at 8 to 12 Hz, with
0.05 to 0.3 mm from peak to peak. All are sums of sinusoids with random amplitudes,
hence as smooth as the motion that they ride on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim import profiles
from handcal_sim.motion import Motion
from handcal_sim.profiles import Array

# Of sway and of wobble, each: with few, the two would be alike by chance in a long recording.
LINES = 40


@dataclass(frozen=True)
class Hand:
    """Root mean squares for each axis.

    sway_m, wobble_rad: at rest; ..._per_rate: in addition for each rad/s of turning;
    tremor_m: displacement; tremor_rad_s: rate of turning, at 8 to 12 Hz; creep_m: slow drift of
    an arm that tires, below 0.08 Hz.
    """

    sway_m: float = 0.0
    sway_per_rate_m: float = 0.0
    wobble_rad: float = 0.0
    wobble_per_rate_rad: float = 0.0
    tremor_m: float = 0.0
    tremor_rad_s: float = 0.0
    creep_m: float = 0.0


def random_hand(rng: np.random.Generator, scale: float = 1.0) -> Hand:
    """Somebody's hand; scale 0 holds perfectly still, 1 is usual."""
    draw = rng.uniform(
        [0.5e-3, 3e-3, math.radians(0.1), math.radians(0.3), 0.012e-3, math.radians(0.1)],
        [2.0e-3, 9e-3, math.radians(0.4), math.radians(1.0), 0.075e-3, math.radians(0.5)],
    )
    return Hand(*(float(scale * x) for x in draw))


def somebodys(rng: np.random.Generator, scale: float, tremor: float, creep_m: float) -> Hand:
    """A random hand of this scale, with so many times its tremor, that creeps by so much."""
    hand = random_hand(rng, scale)
    return replace(hand, tremor_m=tremor * hand.tremor_m,
                   tremor_rad_s=tremor * hand.tremor_rad_s, creep_m=creep_m)  # fmt: skip


def in_hand(motion: Motion, hand: Hand, rng: np.random.Generator) -> Motion:
    """The motion as this hand carries it out."""
    size = np.array([hand.sway_m] * 3 + [hand.wobble_rad] * 3)
    more = np.array([hand.sway_per_rate_m] * 3 + [hand.wobble_per_rate_rad] * 3)
    slow, moving = (_apart(rng, LINES, 0.08, 1.4, 0.4) for _ in range(2))
    omega, sin, cos = _wander(rng, 8, 8.0, 12.0, math.inf)
    shake = np.array([hand.tremor_m] * 3 + [hand.tremor_rad_s] * 3)
    per_rad_s = np.where(np.arange(6) < 3, 1.0, 1.0 / omega[:, None])
    resting = profiles.sinusoids(
        np.concatenate([slow[0], omega]),
        np.vstack([slow[1] * size, sin * shake * per_rad_s]),
        np.vstack([slow[2] * size, cos * shake * per_rad_s]),
    )
    turning = profiles.sinusoids(moving[0], moving[1] * more, moving[2] * more)
    wander = profiles.add(
        profiles.multiply(motion.held, resting), profiles.multiply(motion.activity, turning)
    )
    if hand.creep_m > 0.0:
        omega, sin, cos = _wander(rng, 12, 0.005, 0.08, math.inf)
        drift = np.array([hand.creep_m] * 3 + [0.0] * 3)
        wander = profiles.add(wander, profiles.sinusoids(omega, sin * drift, cos * drift))
    return replace(motion, wander=wander)


def _apart(
    rng: np.random.Generator, count: int, low_hz: float, high_hz: float, corner_hz: float
) -> tuple[Array, Array, Array]:
    """As ``_wander``, but sway and wobble have no frequency in common.

    With those in common, a sway would be in proportion to a wobble for as long as one looks,
    which is what a lever arm is.
    """
    sway, wobble = (_wander(rng, count, low_hz, high_hz, corner_hz) for _ in range(2))
    none = np.zeros((count, 3))
    sin, cos = (np.block([[sway[i][:, :3], none], [none, wobble[i][:, 3:]]]) for i in (1, 2))
    return np.concatenate([sway[0], wobble[0]]), np.asarray(sin), np.asarray(cos)


def _wander(
    rng: np.random.Generator, count: int, low_hz: float, high_hz: float, corner_hz: float
) -> tuple[Array, Array, Array]:
    """Frequencies and amplitudes of six Gaussian signals with unit rms, falling beyond corner."""
    edges = np.linspace(low_hz, high_hz, count + 1)
    f = rng.uniform(edges[:-1], edges[1:])
    weight = (1.0 / (1.0 + (f / corner_hz) ** 2))[:, None]
    sin, cos = weight * rng.standard_normal((2, count, 6))
    rms = np.sqrt(0.5 * np.sum(sin**2 + cos**2, axis=0))
    return 2.0 * math.pi * f, sin / rms, cos / rms

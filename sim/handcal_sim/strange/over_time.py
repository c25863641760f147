"""Responses to time: what happens whatever the hand does, and gains that change meanwhile."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strange.still import Made, Rng


def start_up(rng: Rng) -> Made:
    """Settles after switching on."""
    tau = rng.uniform(4.0, 12.0)
    return lambda _t, u: np.exp(-u / tau), f"exp(-u / {tau:.2f})"


def ringing_start(rng: Rng) -> Made:
    """Swings to its value after switching on."""
    tau, period = rng.uniform(12.0, 25.0), rng.uniform(5.0, 12.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.exp(-u / tau) * np.cos(2.0 * math.pi * u / period))

    return respond, f"exp(-u / {tau:.2f}) cos(2 pi u / {period:.2f})"


def hum(rng: Rng) -> Made:
    """Something fast, seen slowed down by sampling."""
    period, phase = rng.uniform(6.0, 25.0), rng.uniform(0.0, 2.0 * math.pi)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sin(2.0 * math.pi * u / period + phase))

    return respond, f"sin(2 pi u / {period:.2f} + {phase:.2f})"


def beat(rng: Rng) -> Made:
    """Two oscillators that nearly agree."""
    slow, quick = rng.uniform(25.0, 60.0), rng.uniform(4.0, 9.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sin(2.0 * math.pi * u / slow) * np.sin(2.0 * math.pi * u / quick))

    return respond, f"sin(2 pi u / {slow:.2f}) sin(2 pi u / {quick:.2f})"


def on_and_off(rng: Rng) -> Made:
    """A load that is switched at regular times."""
    period, duty = rng.uniform(8.0, 24.0), rng.uniform(0.25, 0.6)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.where(np.mod(u / period, 1.0) < duty, 1.0, 0.0))

    return respond, f"1 where u / {period:.2f} mod 1 < {duty:.3f}"


def sawtooth(rng: Rng) -> Made:
    """Drifts, and is set right at regular times."""
    period = rng.uniform(8.0, 24.0)
    return lambda _t, u: np.mod(u / period, 1.0) - 0.5, f"u / {period:.2f} mod 1"


def bursts(rng: Rng) -> Made:
    """Something comes by a few times."""
    at, width = np.sort(rng.uniform(8.0, 76.0, 3)), rng.uniform(1.0, 3.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(sum(np.exp(-0.5 * ((u - when) / width) ** 2) for when in at.tolist()))

    return respond, f"bumps {width:.2f} wide at " + ", ".join(f"{when:.1f}" for when in at)


def loose_contact(rng: Rng) -> Made:
    """Comes and goes at irregular times."""
    edges = np.sort(rng.uniform(8.0, 76.0, 6))

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.searchsorted(edges, u) % 2, dtype=float)

    return respond, "1 or 0, changing at " + ", ".join(f"{edge:.1f}" for edge in edges)


def drifting_gain(rng: Rng) -> Made:
    """The factor changes steadily."""
    from_s = rng.uniform(30.0, 55.0)
    return lambda _t, u, v: u * (v - from_s) / 40.0, f"u (v - {from_s:.1f}) / 40"


def gain_jump(rng: Rng) -> Made:
    """The factor changes once."""
    at = rng.uniform(25.0, 60.0)
    return lambda _t, u, v: u * np.where(v > at, 1.0, 0.0), f"u where v > {at:.1f}"


def gain_flutter(rng: Rng) -> Made:
    """The factor swings."""
    period, phase = rng.uniform(6.0, 25.0), rng.uniform(0.0, 2.0 * math.pi)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(u * np.sin(2.0 * math.pi * v / period + phase))

    return respond, f"u sin(2 pi v / {period:.2f} + {phase:.2f})"

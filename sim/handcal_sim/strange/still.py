"""Responses without memory: what is read depends on drivers as they are at that moment."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from handcal_sim.profiles import Array

Made = tuple[Callable[..., Array], str]
Rng = np.random.Generator


def linear(_rng: Rng) -> Made:
    """In proportion."""
    return lambda _t, u: u, "u"


def square(_rng: Rng) -> Made:
    """Even, of second order."""
    return lambda _t, u: u**2, "u^2"


def size(_rng: Rng) -> Made:
    """Another factor for each sign."""
    return lambda _t, u: np.abs(u), "|u|"


def cubic(_rng: Rng) -> Made:
    """Odd, of third order."""
    return lambda _t, u: u**3, "u^3"


def size_cubed(_rng: Rng) -> Made:
    """Even, of third order."""
    return lambda _t, u: np.abs(u) ** 3, "|u|^3"


def quintic(_rng: Rng) -> Made:
    """Odd, of fifth order."""
    return lambda _t, u: u**5, "u^5"


def one_sided_square(rng: Rng) -> Made:
    """A square for one sign alone."""
    way = rng.choice([-1.0, 1.0])
    return lambda _t, u: np.maximum(way * u, 0.0) ** 2, f"max({way:+.0f} u, 0)^2"


def root(_rng: Rng) -> Made:
    """Steep near zero, flat beyond, odd."""
    return lambda _t, u: np.sign(u) * np.sqrt(np.abs(u)), "sign(u) sqrt(|u|)"


def root_of_size(_rng: Rng) -> Made:
    """Steep near zero, flat beyond, even."""
    return lambda _t, u: np.sqrt(np.abs(u)), "sqrt(|u|)"


def soft_limit(rng: Rng) -> Made:
    """Gives way by and by."""
    a = rng.uniform(0.6, 1.3)
    return lambda _t, u: a * np.tanh(u / a) - u, f"{a:.3f} tanh(u / {a:.3f}) - u"


def hard_limit(rng: Rng) -> Made:
    """Goes so far and no farther."""
    a = rng.uniform(0.6, 1.1)
    return lambda _t, u: np.clip(u, -a, a) - u, f"clip(u, -{a:.3f}, {a:.3f}) - u"


def one_sided_limit(rng: Rng) -> Made:
    """Goes so far and no farther on one side."""
    a, way = rng.uniform(0.4, 0.9), rng.choice([-1.0, 1.0])

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(way * np.minimum(way * u, a) - u)

    return respond, f"{way:+.0f} min({way:+.0f} u, {a:.3f}) - u"


def dead_zone(rng: Rng) -> Made:
    """Nothing is felt near zero."""
    a = rng.uniform(0.2, 0.6)
    return lambda _t, u: -np.clip(u, -a, a), f"-clip(u, -{a:.3f}, {a:.3f})"


def missing_codes(rng: Rng) -> Made:
    """Within a window the output stays at its lower edge."""
    c, w = rng.uniform(-0.6, 0.3), rng.uniform(0.3, 0.7)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.where((u > c) & (u < c + w), c - u, 0.0))

    return respond, f"{c:.3f} - u where {c:.3f} < u < {c + w:.3f}"


def friction(rng: Rng) -> Made:
    """A step at zero."""
    a = rng.uniform(0.02, 0.08)
    return lambda _t, u: np.tanh(u / a), f"tanh(u / {a:.3f})"


def stribeck(rng: Rng) -> Made:
    """A step at zero that fades with size."""
    a = rng.uniform(0.3, 0.8)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.tanh(u / 0.03) * np.exp(-np.abs(u) / a))

    return respond, f"tanh(u / 0.03) exp(-|u| / {a:.3f})"


def knee(rng: Rng) -> Made:
    """Another factor beyond a point."""
    c, way = rng.uniform(0.3, 0.8), rng.choice([-1.0, 1.0])
    return lambda _t, u: np.maximum(way * u - c, 0.0), f"max({way:+.0f} u - {c:.3f}, 0)"


def excess(rng: Rng) -> Made:
    """Only what goes beyond a size counts, with its sign."""
    a = rng.uniform(0.5, 1.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sign(u) * np.maximum(np.abs(u) - a, 0.0))

    return respond, f"sign(u) max(|u| - {a:.3f}, 0)"


def excess_size(rng: Rng) -> Made:
    """Only what goes beyond a size counts, without its sign."""
    a = rng.uniform(0.5, 1.0)
    return lambda _t, u: np.maximum(np.abs(u) - a, 0.0), f"max(|u| - {a:.3f}, 0)"


def range_change(rng: Rng) -> Made:
    """An offset in the wide range of a converter."""
    a = rng.uniform(0.5, 1.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.where(np.abs(u) > a, np.sign(u), 0.0))

    return respond, f"sign(u) where |u| > {a:.3f}"


def latch_point(rng: Rng) -> Made:
    """A step at a point that is not zero."""
    c, w = rng.choice([-1.0, 1.0]) * rng.uniform(0.25, 0.7), rng.uniform(0.03, 0.12)
    return lambda _t, u: np.tanh((u - c) / w), f"tanh((u - {c:.3f}) / {w:.3f})"


def staircase(rng: Rng) -> Made:
    """Coarse steps."""
    q = rng.uniform(0.6, 1.2)
    return lambda _t, u: q * np.round(u / q) - u, f"{q:.3f} round(u / {q:.3f}) - u"


def ripple(rng: Rng) -> Made:
    """Periodic in the size of what is measured."""
    p, phase = rng.uniform(0.9, 1.8), rng.uniform(0.0, 2.0 * math.pi)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sin(2.0 * math.pi * u / p + phase))

    return respond, f"sin(2 pi u / {p:.3f} + {phase:.2f})"


def resonance(rng: Rng) -> Made:
    """A bump about one value."""
    c, w = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.9), rng.uniform(0.12, 0.35)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.exp(-0.5 * ((u - c) / w) ** 2))

    return respond, f"exp(-((u - {c:.3f}) / {w:.3f})^2 / 2)"


def detuned(rng: Rng) -> Made:
    """In proportion first, gone when large."""
    a = rng.uniform(0.12, 0.3)
    return lambda _t, u: u / (1.0 + (u / a) ** 2), f"u / (1 + (u / {a:.3f})^2)"


def leak(rng: Rng) -> Made:
    """Grows exponentially towards one side."""
    a, way = rng.uniform(0.25, 0.5), rng.choice([-1.0, 1.0])
    return lambda _t, u: np.exp(np.minimum(way * u, 3.0) / a - 3.0 / a), (
        f"exp({way:+.0f} u / {a:.3f})"
    )


def saturated(rng: Rng) -> Made:
    """In proportion first, constant when large."""
    a = rng.uniform(0.2, 0.5)
    return lambda _t, u: np.tanh(u / a), f"tanh(u / {a:.3f})"


# ---- of angles -----------------------------------------------------------------------------


def _wave(periods: int, rng: Rng) -> Made:
    phase = rng.uniform(0.0, 2.0 * math.pi)
    return lambda _t, u: np.sin(periods * u + phase), f"sin({periods} u + {phase:.2f})"


def once(rng: Rng) -> Made:
    """One period a turn."""
    return _wave(1, rng)


def twice(rng: Rng) -> Made:
    """Two periods a turn."""
    return _wave(2, rng)


def thrice(rng: Rng) -> Made:
    """Three periods a turn."""
    return _wave(3, rng)


def four_times(rng: Rng) -> Made:
    """Four periods a turn."""
    return _wave(4, rng)


def six_times(rng: Rng) -> Made:
    """Six periods a turn."""
    return _wave(6, rng)


def rectified_wave(rng: Rng) -> Made:
    """The size of a wave: a kink every half turn."""
    phase = rng.uniform(0.0, 2.0 * math.pi)
    return lambda _t, u: np.abs(np.sin(u + phase)), f"|sin(u + {phase:.2f})|"


def half_circle(rng: Rng) -> Made:
    """An offset on one half of the circle."""
    where, w = rng.uniform(-math.pi, math.pi), rng.uniform(0.05, 0.15)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.tanh(np.cos(u - where) / w))

    return respond, f"tanh(cos(u - {where:.2f}) / {w:.3f})"


def narrow_lobe(rng: Rng) -> Made:
    """Felt in one narrow direction only."""
    where, sharp = rng.uniform(-math.pi, math.pi), rng.uniform(5.0, 12.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.exp(sharp * (np.cos(u - where) - 1.0)))

    return respond, f"exp({sharp:.2f} (cos(u - {where:.2f}) - 1))"


def grid(rng: Rng) -> Made:
    """Drawn towards the marks of a scale."""
    q = math.radians(rng.choice([30.0, 45.0, 60.0]))
    return lambda _t, u: q * np.round(u / q) - u, f"{q:.4f} round(u / {q:.4f}) - u"


# ---- of two or three -----------------------------------------------------------------------


def product(_rng: Rng) -> Made:
    """One times the other."""
    return lambda _t, u, v: u * v, "u v"


def times_size(_rng: Rng) -> Made:
    """One times the size of the other."""
    return lambda _t, u, v: u * np.abs(v), "u |v|"


def times_sign(rng: Rng) -> Made:
    """A factor that changes with the sign of the other."""
    a = rng.uniform(0.05, 0.2)
    return lambda _t, u, v: u * np.tanh(v / a), f"u tanh(v / {a:.3f})"


def times_square(_rng: Rng) -> Made:
    """One times the square of the other."""
    return lambda _t, u, v: u * v**2, "u v^2"


def triple(_rng: Rng) -> Made:
    """The product of three."""
    return lambda _t, u, v, w: u * v * w, "u v w"


def limited_product(rng: Rng) -> Made:
    """A product that saturates."""
    a = rng.uniform(0.1, 0.3)
    return lambda _t, u, v: np.tanh(u * v / a), f"tanh(u v / {a:.3f})"


def gain_beyond(rng: Rng) -> Made:
    """The factor falls once the other is large."""
    a = rng.uniform(0.4, 0.9)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(u * np.maximum(np.abs(v) - a, 0.0))

    return respond, f"u max(|v| - {a:.3f}, 0)"


def direction(rng: Rng) -> Made:
    """The share of one in the size of all."""
    a = rng.uniform(0.2, 0.4)
    return lambda _t, u, v: u / np.sqrt(v**2 + a**2), f"u / sqrt(v^2 + {a:.3f}^2)"


def wave_times(rng: Rng) -> Made:
    """A wave of an angle, as large as the other."""
    phase = rng.uniform(0.0, 2.0 * math.pi)
    return lambda _t, u, v: np.sin(u + phase) * v, f"sin(u + {phase:.2f}) v"

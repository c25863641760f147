"""Responses of a third helping of strange laws, of the moment, of the past and of time.

Drivers come in units of ``law.UNITS``, time t in s; what is returned is an error of order one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from handcal_sim.profiles import Array
from handcal_sim.strange.memory import interval, lagged, passed
from handcal_sim.strange.others import since
from handcal_sim.strange.still import Made, Rng

Spell = NDArray[np.bool_]


def began(now: Spell) -> Spell:
    """Where a spell (n,) begins, not counting one that was there from the start."""
    return np.asarray(np.diff(now.astype(int), prepend=int(now[0])) > 0)


def held(u: Array, now: Spell) -> Array:
    """u (n,) as it was when it last was so, or at first, in the unit of u."""
    return np.asarray(u[np.maximum.accumulate(np.where(now, np.arange(len(u)), 0))])


# ---- as things are at that moment ----------------------------------------------------------


def bit_weight(rng: Rng) -> Made:
    """As much more wherever one bit of the number is set."""
    q, shift = rng.uniform(0.5, 0.9), rng.uniform(0.0, 1.0)
    return lambda _t, u: np.mod(np.floor(u / q + shift), 2.0), (
        f"floor(u / {q:.3f} + {shift:.3f}) mod 2"
    )


def single_gap(rng: Rng) -> Made:
    """What goes with one over a distance that shrinks to one side."""
    g, way = rng.uniform(2.2, 3.2), rng.choice([-1.0, 1.0])

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(u / (1.0 - np.minimum(way * u / g, 0.8)) - u)

    return respond, f"u / (1 - min({way:+.0f} u / {g:.3f}, 0.8)) - u"


def leaning_axis(rng: Rng) -> Made:
    """The axis itself turns by an angle in proportion to what it reads."""
    c = rng.uniform(0.6, 1.0)
    return lambda _t, u, v: u * np.cos(c * u) + v * np.sin(c * u) - u, (
        f"u cos({c:.3f} u) + v sin({c:.3f} u) - u"
    )


def higher(_rng: Rng) -> Made:
    """The higher one of two."""
    return lambda _t, u, v: np.maximum(u, v), "max(u, v)"


def loaded_friction(rng: Rng) -> Made:
    """A step at zero, as high as the size of another."""
    a = rng.uniform(0.02, 0.08)
    return lambda _t, u, v: np.tanh(u / a) * np.abs(v), f"tanh(u / {a:.3f}) |v|"


# ---- of what was before ---------------------------------------------------------------------


def gated(rng: Rng) -> Made:
    """What strays too far from its running mean is clipped there."""
    a, tau = rng.uniform(0.35, 0.7), rng.uniform(1.5, 4.0)

    def respond(t: Array, u: Array) -> Array:
        away = u - lagged(t, u, tau)
        return np.asarray(np.clip(away, -a, a) - away)

    return respond, f"clip(d, -{a:.3f}, {a:.3f}) - d, d = u - lag(u, {tau:.2f} s)"


def blanked(rng: Rng) -> Made:
    """Each overload holds the reading for a while."""
    a, hold = rng.uniform(0.6, 1.0), rng.uniform(0.8, 1.6)

    def respond(t: Array, u: Array) -> Array:
        over = began(np.abs(u) > a)
        return np.asarray(np.where(since(t, over.astype(float)) < hold, held(u, over) - u, 0.0))

    return respond, f"u as it was when |u| last rose above {a:.3f}, - u; for {hold:.2f} s"


def tunnelling(rng: Rng) -> Made:
    """A charge that comes ever faster with drive, and leaks off slowly."""
    a, tau = rng.uniform(0.5, 0.8), rng.uniform(6.0, 15.0)
    return lambda t, u: lagged(t, np.sinh(u / a), tau), f"lag(sinh(u / {a:.3f}), {tau:.2f} s)"


def notched(rng: Rng) -> Made:
    """One band of frequencies is taken out."""
    hz, wide = rng.uniform(0.3, 0.8), rng.uniform(0.5, 1.0)

    def respond(t: Array, u: Array) -> Array:
        w = 2.0 * math.pi * hz
        return -passed(t, u, [wide * w, 0.0], [1.0, wide * w, w * w])

    return respond, f"-band(u, {hz:.3f} Hz, width {wide:.3f})"


def wound(rng: Rng) -> Made:
    """An angle, with all its turns since the start, beyond some slack."""
    slack = rng.uniform(0.5, 1.5)

    def respond(_t: Array, u: Array) -> Array:
        come = np.unwrap(u) - u[0]
        return np.asarray(np.sign(come) * np.maximum(np.abs(come) - slack, 0.0))

    return respond, f"sign(w) max(|w| - {slack:.3f}, 0), w = unwrap(u) - u(0)"


# ---- of several, one of them before ---------------------------------------------------------


def crept_gain(rng: Rng) -> Made:
    """A factor that creeps after another, with its sign."""
    tau = rng.uniform(1.5, 6.0)
    return lambda t, u, v: u * lagged(t, v, tau), f"u lag(v, {tau:.2f} s)"


def seated(rng: Rng) -> Made:
    """One couples in, with a sign that another left behind when it was last far out."""
    far = rng.uniform(0.3, 0.8)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(u * np.sign(held(v, np.abs(v) > far)))

    return respond, f"u last sign(v) with |v| > {far:.3f}"


def shaken_together(rng: Rng) -> Made:
    """Two that shake in step leave a mean of their product."""
    tau = rng.uniform(0.3, 0.8)

    def respond(t: Array, u: Array, v: Array) -> Array:
        return lagged(t, (u - lagged(t, u, 0.3)) * (v - lagged(t, v, 0.3)), tau)

    return respond, f"lag((u - lag(u, 0.3 s)) (v - lag(v, 0.3 s)), {tau:.2f} s)"


def grabbed(rng: Rng) -> Made:
    """What was read when things last calmed down is taken off."""
    a = rng.uniform(0.7, 1.2)
    return lambda _t, u, v: -held(u, began(v < a)), f"-(u as it was when v last fell below {a:.3f})"


def opened_filter(rng: Rng) -> Made:
    """A low pass that is the quicker the larger another is."""
    tau, a = rng.uniform(3.0, 6.0), rng.uniform(0.3, 0.6)

    def respond(t: Array, u: Array, v: Array) -> Array:
        shares = -np.expm1(-interval(t) / tau * (1.0 + v / a))
        read, at = np.empty(len(u)), float(u[0])
        for n, (x, share) in enumerate(zip(u.tolist(), shares.tolist(), strict=True)):
            read[n] = at = at + share * (x - at)
        return read - u

    return respond, f"y - u, dy/dt = (u - y) (1 + v / {a:.3f}) / {tau:.2f}"


# ---- of time --------------------------------------------------------------------------------


def log_creep(rng: Rng) -> Made:
    """Creeps on with the logarithm of time."""
    a = rng.uniform(0.5, 4.0)
    return lambda _t, u: np.log1p(u / a), f"log(1 + u / {a:.2f})"


def slips(rng: Rng) -> Made:
    """Slips a few times, and creeps back after each."""
    at, tau = np.sort(rng.uniform(8.0, 76.0, 3)), rng.uniform(4.0, 10.0)

    def respond(_t: Array, u: Array) -> Array:
        after = u[:, None] - at
        return np.asarray(np.where(after > 0.0, np.exp(-after.clip(min=0.0) / tau), 0.0).sum(1))

    return respond, f"sum of exp(-s / {tau:.2f}), s since " + ", ".join(
        f"{when:.1f}" for when in at
    )


# ---- of headings ---------------------------------------------------------------------------


def attracted(rng: Rng) -> Made:
    """Drawn to one direction, most of all from close by on either side of it."""
    where, c = rng.uniform(-math.pi, math.pi), rng.uniform(1.08, 1.3)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sin(where - u) / (c - np.cos(where - u)))

    return respond, f"sin(d) / ({c:.3f} - cos(d)), d = {where:.2f} - u"


def steep_wave(rng: Rng) -> Made:
    """A wave of an angle that grows as little is left of another's cosine."""
    phase, a = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.15, 0.35)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.sin(u + phase) / np.sqrt(np.maximum(1.0 - v**2, 0.0) + a**2))

    return respond, f"sin(u + {phase:.2f}) / sqrt(1 - v^2 + {a:.3f}^2)"


def wave_while(rng: Rng) -> Made:
    """A wave of an angle, there only in spells."""
    phase = rng.uniform(0.0, 2.0 * math.pi)
    period, duty = rng.uniform(8.0, 24.0), rng.uniform(0.3, 0.6)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.where(np.mod(v / period, 1.0) < duty, np.sin(u + phase), 0.0))

    return respond, f"sin(u + {phase:.2f}) where v / {period:.2f} mod 1 < {duty:.3f}"


def not_level(rng: Rng) -> Made:
    """By how much two differed before, within seconds."""
    tau = rng.uniform(1.5, 6.0)
    return lambda t, u, v: lagged(t, u - v, tau), f"lag(u - v, {tau:.2f} s)"


def waiting(rng: Rng) -> Made:
    """An angle stays as it was for as long as another is large."""
    a = rng.uniform(1.4, 1.9)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        on = np.unwrap(u)
        return np.asarray(held(on, v < a) - on)

    return respond, f"u as it was when v was last below {a:.3f}, - u"

"""Responses of a fourth helping of strange laws, of the moment, of the past and of time.

Drivers come in units of ``law.UNITS``, time t in s; what is returned is an error of order one.
"""

from __future__ import annotations

import math

import numpy as np

from handcal_sim.phone import STANDARD_GRAVITY
from handcal_sim.profiles import Array
from handcal_sim.strange.beyond import began
from handcal_sim.strange.law import UNITS
from handcal_sim.strange.memory import followed, interval, lagged
from handcal_sim.strange.others import switched
from handcal_sim.strange.still import Made, Rng

# Gravity in units of force.
ONE_G = STANDARD_GRAVITY / UNITS["f"][0]


def excess(u: Array, a: float) -> Array:
    """What of u (n,) goes beyond a size, with its sign."""
    return np.asarray(np.sign(u) * np.maximum(np.abs(u) - a, 0.0))


# ---- as things are at that moment ----------------------------------------------------------


def mode_crossing(rng: Rng) -> Made:
    """A factor that peaks at one value of another."""
    c, w = rng.uniform(-0.3, 0.6), rng.uniform(0.25, 0.6)
    return lambda _t, u, v: u / (1.0 + ((v - c) / w) ** 2), f"u / (1 + ((v - {c:.3f}) / {w:.3f})^2)"


def stronger_wins(rng: Rng) -> Made:
    """Lost as far as another is stronger."""
    c = rng.uniform(0.7, 1.5)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(-u * v**2 / np.maximum((c * u) ** 2 + v**2, 1e-12))

    return respond, f"-u v^2 / ({c:.3f}^2 u^2 + v^2)"


def enveloped(rng: Rng) -> Made:
    """The size of two together, with the sign of one."""
    c = rng.uniform(0.3, 0.8)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.copysign(np.hypot(u, c * v), u) - u)

    return respond, f"sign(u) sqrt(u^2 + ({c:.3f} v)^2) - u"


def late_switch(rng: Rng) -> Made:
    """What is left of another beyond a difference that is made up for in time."""
    a = rng.uniform(0.5, 1.2)
    return lambda _t, u, v: excess(v - u, a), f"sign(v - u) max(|v - u| - {a:.3f}, 0)"


def leaky_hold(rng: Rng) -> Made:
    """A factor that multiplies by as much for every step of another."""
    a = rng.uniform(0.5, 1.2)
    return lambda _t, u, v: u * np.exp(np.minimum(v / a, 6.0)), f"u exp(v / {a:.3f})"


def shone_on(rng: Rng) -> Made:
    """What comes from so far above the one direction, and from one side only."""
    e = rng.uniform(0.3, 1.2)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.maximum(math.cos(e) * u + math.sin(e) * v, 0.0))

    return respond, f"max(cos({e:.3f}) u + sin({e:.3f}) v, 0)"


# ---- of what was before ---------------------------------------------------------------------


def torn(rng: Rng) -> Made:
    """Coarse and fine part of a number are of different times."""
    late, q = rng.uniform(0.15, 0.45), rng.uniform(0.35, 0.8)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(q * (np.floor(np.interp(t - late, t, u) / q) - np.floor(u / q)))

    return respond, f"{q:.3f} (floor(u(t - {late:.3f} s) / {q:.3f}) - floor(u / {q:.3f}))"


def windup(rng: Rng) -> Made:
    """A loop at its limit goes on summing, and has to go all the way back."""
    a, tau = rng.uniform(0.6, 1.0), rng.uniform(0.1, 0.4)

    def respond(t: Array, u: Array) -> Array:
        share, read = interval(t) / tau, np.empty(len(u))
        total = float(np.clip(u[0], -a, a))
        for n, x in enumerate(u.tolist()):
            total += share * (x - min(max(total, -a), a))
            read[n] = min(max(total, -a), a)
        return read - u

    return respond, f"y - u, y = clip(x, -{a:.3f}, {a:.3f}), dx/dt = (u - y) / {tau:.3f}"


def swung_stop(rng: Rng) -> Made:
    """What swings against a turn, and returns within a second, meets its stop."""
    tau, a = rng.uniform(0.4, 1.2), rng.uniform(0.15, 0.4)

    def respond(t: Array, u: Array) -> Array:
        return excess(tau * lagged(t, u, tau), a)

    return respond, f"sign(x) max(|x| - {a:.3f}, 0), x = {tau:.3f} lag(u, {tau:.3f} s)"


def touched(rng: Rng) -> Made:
    """Each touch of a stop leaves as much behind, which leaks off."""
    a, tau = rng.uniform(0.8, 1.2), rng.uniform(2.0, 8.0)

    def respond(t: Array, u: Array) -> Array:
        touches = began(switched(np.abs(u), a - 0.1, a) > 0.5)
        return np.asarray(lagged(t, touches.astype(float), tau) * tau / interval(t))

    return respond, f"sum of exp(-s / {tau:.2f}), s since |u| rose above {a:.3f}"


def handed_over(rng: Rng) -> Made:
    """When large, a slower sensor is read by and by instead."""
    tau, a, w = rng.uniform(0.15, 0.5), rng.uniform(0.6, 1.1), rng.uniform(0.05, 0.2)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray((lagged(t, u, tau) - u) * 0.5 * (1.0 + np.tanh((np.abs(u) - a) / w)))

    return respond, f"(lag(u, {tau:.3f} s) - u) (1 + tanh((|u| - {a:.3f}) / {w:.3f})) / 2"


def breathed(rng: Rng) -> Made:
    """Follows with the root of what is to be made up for, as flow through a hole does."""
    tau = rng.uniform(0.2, 0.8)

    def respond(t: Array, u: Array) -> Array:
        step, away, at = interval(t) / tau, np.empty(len(u)), float(u[0])
        for n, x in enumerate(u.tolist()):
            move = math.copysign(step * math.sqrt(abs(x - at)), x - at)
            at = x if abs(move) > abs(x - at) else at + move
            away[n] = at - x
        return away

    return respond, f"y - u, dy/dt = sign(u - y) sqrt(|u - y|) / {tau:.3f}"


def both_ways(rng: Rng) -> Made:
    """Smoothed forwards, then backwards."""
    tau = rng.uniform(0.15, 0.6)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(lagged(t, lagged(t, u, tau)[::-1], tau)[::-1] - u)

    return respond, f"lag(lag(u, {tau:.3f} s), {tau:.3f} s backwards) - u"


# ---- of several, now or before --------------------------------------------------------------


def creeping_delay(rng: Rng) -> Made:
    """A delay that grows until a buffer is emptied."""
    most, period = rng.uniform(0.12, 0.4), rng.uniform(8.0, 24.0)

    def respond(t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.interp(t - most * np.mod(v / period, 1.0), t, u) - u)

    return respond, f"u as it was {most:.3f} s (v / {period:.2f} mod 1) ago, - u"


def autozeroed(rng: Rng) -> Made:
    """At regular times, whatever is there is taken for zero."""
    period, shift = rng.uniform(5.0, 12.0), rng.uniform(0.0, 1.0)

    def respond(t: Array, u: Array, v: Array) -> Array:
        into = period * np.mod(v / period + shift, 1.0)
        return np.asarray(-np.interp(t - into, t, u))

    return respond, f"-(u as it was when v / {period:.2f} + {shift:.3f} was last whole)"


def hiccup(rng: Rng) -> Made:
    """A store that another empties; once empty, nothing works until it is full again."""
    a, tau = rng.uniform(0.8, 1.2), rng.uniform(1.0, 3.0)

    def respond(t: Array, u: Array, v: Array) -> Array:
        step, off, left, rests = interval(t) / tau, np.zeros(len(u)), 1.0, False
        for n, x in enumerate(v.tolist()):
            left = min(left + step * (a if rests else a - x), 1.0)
            rests = left < 1.0 if rests else left <= 0.0
            off[n] = float(rests)
        return np.asarray(-u * off)

    return respond, (
        f"-u since c = 0, until c = 1; dc/dt = ({a:.3f} - v) / {tau:.2f}, without v meanwhile"
    )


def learned_bias(rng: Rng) -> Made:
    """By how much turning differs from that of a direction which is taken for fixed."""
    tau = rng.uniform(1.5, 6.0)

    def respond(t: Array, u: Array, v: Array, w: Array) -> Array:
        turned = v * np.gradient(w, t) - w * np.gradient(v, t)
        return -lagged(t, u * (v**2 + w**2) + turned, tau)

    return respond, f"-lag(u (v^2 + w^2) + v dw/dt - w dv/dt, {tau:.2f} s)"


def bead_in_groove(rng: Rng) -> Made:
    """A bead in a round groove rolls only when off its lowest point by an angle."""
    repose = rng.uniform(0.3, 0.9)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        return np.sin(followed(np.unwrap(np.arctan2(u, v)), repose))

    return respond, f"sin(play(angle(u, v), {repose:.3f}))"


def dangling(rng: Rng) -> Made:
    """A pendulum hangs from the case, swings, and pulls as it does."""
    hz, damping = rng.uniform(0.6, 1.4), rng.uniform(0.2, 0.45)

    def respond(t: Array, u: Array, v: Array) -> Array:
        step, w, pull = interval(t), 2.0 * math.pi * hz, np.empty(len(u))
        angle, rate = math.atan2(float(u[0]), float(v[0])), 0.0
        for n, (x, z) in enumerate(zip(u.tolist(), v.tolist(), strict=True)):
            s, c = math.sin(angle), math.cos(angle)
            rate += step * (w * w * (x * c - z * s) / ONE_G - 2.0 * damping * w * rate)
            angle += step * rate
            pull[n] = (x * s + z * c + ONE_G * (rate / w) ** 2) * s
        return pull

    return respond, (
        f"(u sin(a) + v cos(a) + {ONE_G:.4f} a'^2 / w^2) sin(a), a'' = w^2 (u cos(a) - v sin(a)) / "
        f"{ONE_G:.4f} - {2.0 * damping:.3f} w a', w = {2.0 * math.pi * hz:.3f}"
    )


# ---- of time --------------------------------------------------------------------------------


def run_down(rng: Rng) -> Made:
    """A factor that dies away after the start."""
    tau = rng.uniform(8.0, 30.0)
    return lambda _t, u, v: u * np.exp(-v / tau), f"u exp(-v / {tau:.2f})"


def topped_up(rng: Rng) -> Made:
    """A kick at regular times that dies away."""
    period, tau, shift = rng.uniform(6.0, 18.0), rng.uniform(0.8, 3.0), rng.uniform(0.0, 1.0)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.exp(-period * np.mod(u / period + shift, 1.0) / tau))

    return respond, f"exp(-{period:.2f} (u / {period:.2f} + {shift:.3f} mod 1) / {tau:.2f})"


def leaned_on(rng: Rng) -> Made:
    """Pressed twice for a while: gives way by and by, and comes back as slowly."""
    at, long, tau = np.sort(rng.uniform(8.0, 70.0, 2)), rng.uniform(3.0, 9.0), rng.uniform(0.5, 2.5)

    def given(since: Array) -> Array:
        return np.asarray(-np.expm1(-np.maximum(since, 0.0) / tau))

    def respond(_t: Array, u: Array) -> Array:
        after = u[:, None] - at
        return np.asarray((given(after) - given(after - long)).sum(axis=1))

    return respond, f"lag(1 for {long:.2f} s from {at[0]:.1f} and from {at[1]:.1f}, {tau:.2f} s)"


def driven_past(rng: Rng) -> Made:
    """A dipole goes by on a straight line."""
    when, wide = rng.uniform(20.0, 64.0), rng.uniform(2.0, 7.0)
    b = rng.uniform(0.0, 2.0 * math.pi)

    def respond(_t: Array, u: Array) -> Array:
        x = (u - when) / wide
        along = math.cos(b) * (2.0 * x**2 - 1.0) + 3.0 * math.sin(b) * x
        return np.asarray(along / (1.0 + x**2) ** 2.5)

    return respond, (
        f"(cos({b:.2f}) (2 x^2 - 1) + 3 sin({b:.2f}) x) / (1 + x^2)^2.5, "
        f"x = (u - {when:.1f}) / {wide:.2f}"
    )


# ---- of headings ---------------------------------------------------------------------------


def saturated_iron(rng: Rng) -> Made:
    """A strip is magnetised along itself, until it is saturated, and pulls."""
    where, a = rng.uniform(-math.pi, math.pi), rng.uniform(0.15, 0.5)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.tanh(np.cos(u - where) / a) * np.sin(u - where))

    return respond, f"tanh(cos(d) / {a:.3f}) sin(d), d = u - {where:.2f}"


def eddied(rng: Rng) -> Made:
    """Currents of turning in one loop, felt across it."""
    where = rng.uniform(0.0, math.pi)
    return lambda _t, u, v: v * np.sin(u - where) ** 2, f"v sin(u - {where:.2f})^2"


def under_compensated(rng: Rng) -> Made:
    """An angle of a vector to which as much of two others has been added."""
    c = rng.uniform(0.25, 0.7)

    def respond(_t: Array, u: Array, v: Array, w: Array) -> Array:
        along, across = v * np.cos(u) + w * np.sin(u), w * np.cos(u) - v * np.sin(u)
        return np.arctan2(c * across, 1.0 + c * along)

    return respond, f"angle(cos(u) + {c:.3f} v, sin(u) + {c:.3f} w) - u"


def clipped_channel(rng: Rng) -> Made:
    """The angle of a vector one side of which is clipped."""
    a, way = rng.uniform(0.2, 0.7), rng.choice([-1.0, 1.0])

    def respond(_t: Array, u: Array, v: Array) -> Array:
        clipped = way * np.minimum(way * u, a)
        return np.asarray(np.arctan2(v * (u - clipped), u * clipped + v**2))

    return respond, f"angle({way:+.0f} min({way:+.0f} u, {a:.3f}), v) - angle(u, v)"


def stepped_rose(rng: Rng) -> Made:
    """A motor turns the rose after the heading, and has so much torque and no more."""
    hz, most = rng.uniform(0.5, 1.2), rng.uniform(3.0, 8.0)

    def respond(t: Array, u: Array) -> Array:
        on, step, w = np.unwrap(u), interval(t), 2.0 * math.pi * hz
        away, at, rate = np.empty(len(u)), float(on[0]), 0.0
        for n, x in enumerate(on.tolist()):
            rate += step * min(max(w * w * (x - at) - w * rate, -most), most)
            at += step * rate
            away[n] = at - x
        return away

    w = 2.0 * math.pi * hz
    return respond, f"y - u, y'' = clip({w * w:.3f} (u - y) - {w:.3f} y', -{most:.3f}, {most:.3f})"

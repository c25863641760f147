"""Responses with memory: what is read depends on what drivers were before."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strange.still import Made, Rng


def lagged(t: Array, u: Array, tau: float) -> Array:
    """First-order low pass (n,), as if u had been what it first was for ever."""
    from scipy.signal import lfilter

    keep = math.exp(-interval(t) / tau)
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], u, zi=[keep * u[0]])
    return np.asarray(smooth)


def passed(t: Array, u: Array, top: list[float], below: list[float], hold: str = "zoh") -> Array:
    """u (n,), less what it first was, through top / below, polynomials of s, highest power
    first."""
    from scipy.signal import cont2discrete, lfilter

    over, under, _ = cont2discrete((top, below), interval(t), hold)
    return np.asarray(lfilter(np.ravel(over), under, u - u[0]))


def followed(u: Array, half: float) -> Array:
    """What follows u (n,) with so much play to either side."""
    follow, at = np.empty(len(u)), float(u[0])
    for n, x in enumerate(u.tolist()):
        follow[n] = at = min(max(at, x - half), x + half)
    return follow


def stuck(u: Array, loose: float) -> Array:
    """What stays where it is until u (n,) has moved on so far, then jumps to it."""
    out, at = np.empty(len(u)), float(u[0])
    for n, x in enumerate(u.tolist()):
        at = x if abs(x - at) > loose else at
        out[n] = at
    return out


def interval(t: Array) -> float:
    """Mean time between samples at t (n,)."""
    return float(t[-1] - t[0]) / (len(t) - 1)


def settling(rng: Rng) -> Made:
    """What was before fades within seconds."""
    tau = rng.uniform(1.5, 6.0)
    return lambda t, u: lagged(t, u, tau), f"lag(u, {tau:.2f} s)"


def settling_size(rng: Rng) -> Made:
    """The size of what was before fades within seconds."""
    tau = rng.uniform(1.5, 6.0)
    return lambda t, u: lagged(t, np.abs(u), tau), f"lag(|u|, {tau:.2f} s)"


def overshoot(rng: Rng) -> Made:
    """Changes are read too large at first."""
    tau = rng.uniform(0.5, 1.5)
    return lambda t, u: u - lagged(t, u, tau), f"u - lag(u, {tau:.2f} s)"


def absorption(rng: Rng) -> Made:
    """What was before fades quickly first, then ever more slowly."""
    tau = rng.uniform(0.4, 0.8)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(sum(lagged(t, u, tau * 5.0**n) for n in range(3)))

    return respond, "+".join(f"lag(u, {tau * 5.0**n:.2f} s)" for n in range(3))


def warming_up(rng: Rng) -> Made:
    """Power, the square of the driver, heats what cools slowly."""
    tau = rng.uniform(5.0, 15.0)
    return lambda t, u: lagged(t, u**2, tau), f"lag(u^2, {tau:.2f} s)"


def play(rng: Rng) -> Made:
    """What follows begins to move only once the play is used up."""
    half = rng.uniform(0.15, 0.45)

    return lambda _, u: followed(u, half) - u, f"play(u, {half:.3f}) - u"


def stiction(rng: Rng) -> Made:
    """The reading sticks until the driver has moved on so far, then jumps to it."""
    loose = rng.uniform(0.3, 0.7)

    return lambda _, u: stuck(u, loose) - u, f"stick(u, {loose:.3f}) - u"


def hysteresis(rng: Rng) -> Made:
    """A loop that closes behind every change of direction (Bouc and Wen)."""
    width = rng.uniform(0.3, 0.8)

    def respond(_t: Array, u: Array) -> Array:
        loop, z = np.zeros(len(u)), 0.0
        for n, du in enumerate(np.diff(u).tolist(), start=1):
            z += (du - abs(du) * z) / width if abs(du) < width else 0.0
            loop[n] = z
        return loop

    return respond, f"z, dz = (du - |du| z) / {width:.3f}"


def remanence(rng: Rng) -> Made:
    """The side on which the driver was last far out is remembered."""
    far = rng.uniform(0.3, 0.8)

    def respond(_t: Array, u: Array) -> Array:
        side, at = np.empty(len(u)), 0.0
        for n, x in enumerate(u.tolist()):
            at = math.copysign(1.0, x) if abs(x) > far else at
            side[n] = at
        return side

    return respond, f"last sign(u) with |u| > {far:.3f}"


def peak_hold(rng: Rng) -> Made:
    """The largest size is held, and droops."""
    tau = rng.uniform(2.0, 8.0)

    def respond(t: Array, u: Array) -> Array:
        keep, held, at = math.exp(-interval(t) / tau), np.empty(len(u)), 0.0
        for n, x in enumerate(np.abs(u).tolist()):
            held[n] = at = max(x, keep * at)
        return held

    return respond, f"peak of |u|, falling within {tau:.2f} s"


def recovery(rng: Rng) -> Made:
    """An overload is recovered from within seconds."""
    a, tau = rng.uniform(0.7, 1.1), rng.uniform(1.0, 4.0)

    def respond(t: Array, u: Array) -> Array:
        over = np.sign(u) * np.maximum(np.abs(u) - a, 0.0)
        return lagged(t, over, tau)

    return respond, f"lag(sign(u) max(|u| - {a:.3f}, 0), {tau:.2f} s)"


def slow_fall(rng: Rng) -> Made:
    """Rises at once, falls slowly."""
    tau = rng.uniform(1.0, 3.0)

    def respond(t: Array, u: Array) -> Array:
        share, read, at = 1.0 - math.exp(-interval(t) / tau), np.empty(len(u)), float(u[0])
        for n, x in enumerate(u.tolist()):
            read[n] = at = x if x > at else at + share * (x - at)
        return read - u

    return respond, f"u where it rises, lag(u, {tau:.2f} s) where it falls; - u"


def slew_limit(rng: Rng) -> Made:
    """The reading follows no faster than so."""
    fast = rng.uniform(0.6, 1.2)

    def respond(t: Array, u: Array) -> Array:
        most, read, at = fast * interval(t), np.empty(len(u)), float(u[0])
        for n, x in enumerate(u.tolist()):
            read[n] = at = at + min(max(x - at, -most), most)
        return read - u

    return respond, f"slew(u, {fast:.3f} / s) - u"


def echo(rng: Rng) -> Made:
    """A stale buffer: what was read some time ago comes along."""
    late = rng.uniform(0.8, 3.0)
    return lambda t, u: np.interp(t - late, t, u), f"u(t - {late:.2f} s)"


def ringing(rng: Rng) -> Made:
    """A soft mounting swings on after every change."""
    hz, damping = rng.uniform(0.5, 1.2), rng.uniform(0.08, 0.2)

    def respond(t: Array, u: Array) -> Array:
        w = 2.0 * math.pi * hz
        return np.asarray(passed(t, u, [w * w], [1.0, 2.0 * damping * w, w * w]) - (u - u[0]))

    return respond, f"swing(u, {hz:.3f} Hz, damping {damping:.3f}) - u"


def vibration(rng: Rng) -> Made:
    """Shaking is rectified: its mean square over half a second."""
    tau = rng.uniform(0.3, 0.8)
    return lambda t, u: lagged(t, (u - lagged(t, u, 0.3)) ** 2, tau), (
        f"lag((u - lag(u, 0.3 s))^2, {tau:.2f} s)"
    )


def rate_of_change(_rng: Rng) -> Made:
    """How fast the driver changes."""

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(lagged(t, np.gradient(u, t), 0.3))

    return respond, "du/dt"


def behind(rng: Rng) -> Made:
    """The inside follows the outside late; the difference strains."""
    tau = rng.uniform(5.0, 15.0)
    return lambda t, u: u - lagged(t, u, tau), f"u - lag(u, {tau:.2f} s)"


def drooping_gain(rng: Rng) -> Made:
    """The factor falls with what another driver drew from the supply."""
    tau = rng.uniform(1.0, 4.0)
    return lambda t, u, v: u * lagged(t, np.abs(v), tau), f"u lag(|v|, {tau:.2f} s)"


def heated_gain(rng: Rng) -> Made:
    """The factor changes with heat from another driver's power."""
    tau = rng.uniform(5.0, 15.0)
    return lambda t, u, v: u * lagged(t, v**2, tau), f"u lag(v^2, {tau:.2f} s)"


# ---- of headings, which go round -----------------------------------------------------------


def late_needle(rng: Rng) -> Made:
    """A damped needle follows slowly."""
    tau = rng.uniform(0.8, 2.5)

    def respond(t: Array, u: Array) -> Array:
        on = np.unwrap(u)
        return lagged(t, on, tau) - on

    return respond, f"lag(u, {tau:.2f} s) - u"


def sticking_needle(rng: Rng) -> Made:
    """A pivot lets go only when the heading has moved on so far."""
    loose = rng.uniform(0.25, 0.6)

    def respond(_t: Array, u: Array) -> Array:
        on = np.unwrap(u)
        return stuck(on, loose) - on

    return respond, f"stick(u, {loose:.3f}) - u"


def needle_play(rng: Rng) -> Made:
    """A worn pivot has play."""
    follow, text = play(rng)
    return lambda t, u: follow(t, np.unwrap(u)), text


def swinging_needle(rng: Rng) -> Made:
    """A needle in little oil swings on."""
    swing, text = ringing(rng)
    return lambda t, u: swing(t, np.unwrap(u)), text

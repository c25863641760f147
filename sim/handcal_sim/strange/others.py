"""Further responses of strange laws, of the moment and of the past, of one signal or of several."""

from __future__ import annotations

import math

import numpy as np

from handcal_sim.profiles import Array
from handcal_sim.strange.memory import followed, interval, lagged, stuck
from handcal_sim.strange.still import Made, Rng


def switched(u: Array, below: float, above: float, first: float = 0.0) -> Array:
    """1 once u (n,) has been above the one, 0 once it has been below the other."""
    on, at = np.empty(len(u)), first
    for n, x in enumerate(u.tolist()):
        at = 1.0 if x > above else 0.0 if x < below else at
        on[n] = at
    return on


def since(t: Array, now: Array) -> Array:
    """Time (n,) since it last was so: infinite before it first was."""
    return np.asarray(t - np.maximum.accumulate(np.where(now, t, -np.inf)))


# ---- as things are at that moment ----------------------------------------------------------


def interferometer(rng: Rng) -> Made:
    """The sine of a phase stands for the phase."""
    a = rng.uniform(0.45, 0.75)
    return lambda _t, u: a * np.sin(u / a) - u, f"{a:.3f} sin(u / {a:.3f}) - u"


def companded(rng: Rng) -> Made:
    """Steps that are as many to each doubling."""
    r, shift = rng.uniform(1.8, 2.6), rng.uniform(0.0, 1.0)

    def respond(_t: Array, u: Array) -> Array:
        octave = np.log(np.maximum(np.abs(u), 0.02)) / math.log(r)
        return np.asarray(np.sign(u) * r ** (np.round(octave - shift) + shift) - u)

    return respond, f"sign(u) {r:.3f}^(round(log|u| - {shift:.3f}) + {shift:.3f}) - u"


def phase_reversal(rng: Rng) -> Made:
    """Beyond a point of one side the sign is the wrong one."""
    a, way = rng.uniform(0.4, 0.9), rng.choice([-1.0, 1.0])
    return lambda _t, u: np.where(way * u > a, -2.0 * u, 0.0), f"-2 u where {way:+.0f} u > {a:.3f}"


def common_range(rng: Rng) -> Made:
    """Another factor while any of three is large."""
    a = rng.uniform(0.7, 1.1)

    def respond(_t: Array, u: Array, v: Array, w: Array) -> Array:
        largest = np.maximum(np.abs(u), np.maximum(np.abs(v), np.abs(w)))
        return np.asarray(np.where(largest > a, u, 0.0))

    return respond, f"u where max(|u|, |v|, |w|) > {a:.3f}"


def captured(rng: Rng) -> Made:
    """Held by marks of a scale, but only close to them."""
    q, w = math.radians(rng.choice([45.0, 60.0, 90.0])), rng.uniform(0.2, 0.35)

    def respond(_t: Array, u: Array) -> Array:
        away = q * np.round(u / q) - u
        return np.asarray(np.where(np.abs(away) < w, away / w, 0.0))

    return respond, f"d / {w:.3f} where |d| < {w:.3f}, d = {q:.4f} round(u / {q:.4f}) - u"


def sweeping_hum(rng: Rng) -> Made:
    """Something that goes ever faster."""
    hz, more, phase = rng.uniform(0.02, 0.06), rng.uniform(0.001, 0.004), rng.uniform(0.0, 6.28)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(np.sin(2.0 * math.pi * (hz * u + 0.5 * more * u**2) + phase))

    return respond, f"sin(2 pi ({hz:.4f} u + {0.5 * more:.5f} u^2) + {phase:.2f})"


# ---- of what was before ---------------------------------------------------------------------


def sleep_and_wake(rng: Rng) -> Made:
    """Asleep, nothing is felt: it falls asleep where little happens and wakes where more does."""
    low, high = rng.uniform(0.15, 0.3), rng.uniform(0.5, 0.8)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(u * (switched(np.abs(u), low, high) - 1.0))

    return respond, f"-u since |u| < {low:.3f}, until |u| > {high:.3f}"


def sticky_range(rng: Rng) -> Made:
    """Another factor in a range that is left later than it was entered."""
    low, high = rng.uniform(0.1, 0.25), rng.uniform(0.9, 1.2)

    def respond(_t: Array, u: Array) -> Array:
        return np.asarray(u * switched(np.abs(u), low, high))

    return respond, f"u since |u| > {high:.3f}, until |u| < {low:.3f}"


def snapping(rng: Rng) -> Made:
    """Snaps over at one point, and back at a lower one."""
    c, w = rng.uniform(-0.3, 0.3), rng.uniform(0.2, 0.35)

    def respond(_t: Array, u: Array) -> Array:
        return switched(u, c - w, c + w, float(u[0] > c))

    return respond, f"1 since u > {c + w:.3f}, until u < {c - w:.3f}"


def median_window(rng: Rng) -> Made:
    """The middle one of the last readings."""
    window = rng.uniform(0.8, 1.6)

    def respond(t: Array, u: Array) -> Array:
        many = max(round(window / interval(t)), 2)
        padded = np.concatenate([np.full(many - 1, u[0]), u])
        last = np.lib.stride_tricks.sliding_window_view(padded, many)
        return np.asarray(np.median(last, axis=1) - u)

    return respond, f"median(u over {window:.2f} s) - u"


def automatic_gain(rng: Rng) -> Made:
    """What was large lately makes the factor small."""
    tau = rng.uniform(1.0, 4.0)
    return lambda t, u: u / (1.0 + lagged(t, u**2, tau)) - u, f"u / (1 + lag(u^2, {tau:.2f} s)) - u"


def whole_angle(rng: Rng) -> Made:
    """A pattern that is carried round: a wave of the angle through which it has come."""
    m, phase = rng.uniform(0.8, 1.8), rng.uniform(0.0, 2.0 * math.pi)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(np.sin(m * np.cumsum(u) * interval(t) + phase))

    return respond, f"sin({m:.3f} integral(u) + {phase:.2f})"


def seldom_updated(rng: Rng) -> Made:
    """A reading stands until the next one, which comes late."""
    period = rng.uniform(0.7, 1.4)

    def respond(t: Array, u: Array) -> Array:
        return np.asarray(np.interp(np.floor(t / period) * period, t, u) - u)

    return respond, f"u as it was at the last multiple of {period:.2f} s, - u"


def bouncing(rng: Rng) -> Made:
    """Falls to the other side, and hops there until it rests."""
    tau, hop = rng.uniform(0.5, 1.2), rng.uniform(0.5, 0.9)

    def respond(t: Array, u: Array) -> Array:
        side = 2.0 * switched(u, -0.1, 0.1) - 1.0
        after = since(t, np.diff(side, prepend=side[0]) != 0.0)
        hops = np.abs(np.cos(math.pi * np.minimum(after, 60.0) / hop))
        return np.asarray(side * np.exp(-after / tau) * hops)

    return respond, f"sign(u) exp(-s / {tau:.2f}) |cos(pi s / {hop:.2f})|, s since u changed sign"


def sliding(rng: Rng) -> Made:
    """Rests until it is steep enough, then slides as far as the wall."""
    a, fast = rng.uniform(0.3, 0.6), rng.uniform(1.0, 3.0)

    def respond(t: Array, u: Array) -> Array:
        moves = fast * interval(t) * np.sign(u) * np.maximum(np.abs(u) - a, 0.0)
        place, at = np.empty(len(u)), 0.0
        for n, move in enumerate(moves.tolist()):
            place[n] = at = min(max(at + move, -1.0), 1.0)
        return place

    return respond, f"x within -1..1, dx/dt = {fast:.3f} sign(u) max(|u| - {a:.3f}, 0)"


def sunlit(rng: Rng) -> Made:
    """One side alone is heated, and cools slowly."""
    tau, way = rng.uniform(4.0, 12.0), rng.choice([-1.0, 1.0])
    return lambda t, u: lagged(t, np.maximum(way * u, 0.0), tau), (
        f"lag(max({way:+.0f} u, 0), {tau:.2f} s)"
    )


# ---- of several, now or before --------------------------------------------------------------


def frozen(rng: Rng) -> Made:
    """Now and then, the reading stands still for a while."""
    period, still_s = rng.uniform(5.0, 9.0), rng.uniform(1.2, 2.2)

    def respond(t: Array, u: Array, v: Array) -> Array:
        into = np.mod(v, period)
        return np.asarray(np.where(into < still_s, np.interp(v - into, t, u) - u, 0.0))

    return respond, f"u as it was at v - s, - u; where s = v mod {period:.2f} < {still_s:.2f}"


def bias_tracking(rng: Rng) -> Made:
    """What is read while little happens is taken for nothing, and taken off ever after."""
    a, tau = rng.uniform(0.7, 1.1), rng.uniform(0.5, 1.5)

    def respond(t: Array, u: Array, v: Array) -> Array:
        share, taken, at = 1.0 - math.exp(-interval(t) / tau), np.empty(len(u)), 0.0
        for n, (x, calm) in enumerate(zip(u.tolist(), (v < a).tolist(), strict=True)):
            taken[n] = at = at + share * (x - at) if calm else at
        return -taken

    return respond, f"-b, b = lag(u, {tau:.2f} s) where v < {a:.3f}, else as it was"


def turned_past(rng: Rng) -> Made:
    """How two that belong together have gone round each other."""
    tau = rng.uniform(0.3, 1.0)

    def respond(t: Array, u: Array, v: Array) -> Array:
        return np.asarray(lagged(t, u, tau) * v - lagged(t, v, tau) * u)

    return respond, f"lag(u, {tau:.2f} s) v - lag(v, {tau:.2f} s) u"


def screen_turned(rng: Rng) -> Made:
    """One of two states, by which of two was plainly larger after a moment."""
    c, tau = rng.uniform(1.6, 2.4), rng.uniform(0.3, 0.8)

    def respond(t: Array, u: Array, v: Array) -> Array:
        angle = np.arctan2(np.abs(lagged(t, u, tau)), np.abs(lagged(t, v, tau)))
        return switched(angle, math.atan(1.0 / c), math.atan(c))

    return respond, f"1 since |x| > {c:.3f} |y|, until |y| > {c:.3f} |x|; lags of u, v: {tau:.2f} s"


def strained_gain(rng: Rng) -> Made:
    """The factor changes while inside and outside differ."""
    tau = rng.uniform(5.0, 15.0)
    return lambda t, u, v: u * (v - lagged(t, v, tau)), f"u (v - lag(v, {tau:.2f} s))"


def dithered_friction(rng: Rng) -> Made:
    """A step at zero that shaking takes away."""
    b, tau = rng.uniform(1.0, 2.0), rng.uniform(0.5, 1.5)

    def respond(t: Array, u: Array, v: Array) -> Array:
        return np.asarray(np.tanh(u / 0.05) * np.exp(-lagged(t, v, tau) / b))

    return respond, f"tanh(u / 0.05) exp(-lag(v, {tau:.2f} s) / {b:.3f})"


def leaning(rng: Rng) -> Made:
    """One couples in by a lean that jumps on once the other has moved on so far."""
    loose = rng.uniform(0.5, 0.9)
    return lambda _t, u, v: u * stuck(v, loose), f"u stick(v, {loose:.3f})"


# ---- of headings ---------------------------------------------------------------------------


def tick(rng: Rng) -> Made:
    """A kick at every quarter that is passed."""
    tau, shift, q = rng.uniform(0.4, 0.8), rng.uniform(0.0, 1.0), 0.5 * math.pi

    def respond(t: Array, u: Array) -> Array:
        quarter = np.floor(followed(np.unwrap(u) / q, 0.05) - shift)
        passed = np.abs(np.diff(quarter, prepend=quarter[0]))
        return np.asarray(lagged(t, passed, tau) * tau / interval(t))

    return respond, f"sum of exp(-s / {tau:.2f}), s since u passed {q:.4f} (n + {shift:.3f})"


def eased_needle(rng: Rng) -> Made:
    """Follows slowly where little is to be made up for, quickly where much is."""
    tau, a = rng.uniform(1.0, 2.5), rng.uniform(0.2, 0.5)

    def respond(t: Array, u: Array) -> Array:
        on, step = np.unwrap(u), interval(t) / tau
        away, at = np.empty(len(u)), float(on[0])
        for n, x in enumerate(on.tolist()):
            at += (x - at) * -math.expm1(-step * (1.0 + ((x - at) / a) ** 2))
            away[n] = at - x
        return away

    return respond, f"y - u, dy/dt = d (1 + (d / {a:.3f})^2) / {tau:.2f}, d = u - y"


def vector_play(rng: Rng) -> Made:
    """A magnetisation that a field drags along behind it, and that pulls across it."""
    r = rng.uniform(0.3, 0.7)

    def respond(_t: Array, u: Array, v: Array) -> Array:
        pull, x, y = np.empty(len(u)), float(u[0]), float(v[0])
        for n, (a, b) in enumerate(zip(u.tolist(), v.tolist(), strict=True)):
            share = max(1.0 - r / max(math.hypot(a - x, b - y), 1e-9), 0.0)
            x, y = x + share * (a - x), y + share * (b - y)
            pull[n] = x * b - y * a
        return pull

    return respond, f"x v - y u, where (x, y) follows (u, v) with play {r:.3f}"


def recentred(rng: Rng) -> Made:
    """The middle of what was seen lately is taken for the middle, which shows across it."""
    tau = rng.uniform(6.0, 15.0)

    def respond(t: Array, u: Array, v: Array) -> Array:
        share, middle, low, high = interval(t) / tau, np.empty(len(u)), float(u[0]), float(u[0])
        for n, x in enumerate(u.tolist()):
            closer = share * (high - low)
            low, high = min(x, low + closer), max(x, high - closer)
            middle[n] = 0.5 * (low + high)
        return np.asarray(middle * v)

    return respond, f"v (least + largest u, forgotten within {tau:.2f} s) / 2"


def seam(rng: Rng) -> Made:
    """Averaged across the points, opposite each other, where numbers begin anew."""
    tau, where = rng.uniform(0.4, 1.2), rng.uniform(0.0, math.pi)

    def respond(t: Array, u: Array) -> Array:
        halves = np.floor((np.unwrap(u) - where) / math.pi)
        return np.asarray(lagged(t, halves, tau) - halves)

    return respond, f"lag(n, {tau:.2f} s) - n, n = floor((u - {where:.2f}) / pi)"


def carried_card(rng: Rng) -> Made:
    """Held by the case beyond a tilt and turned along with it, it swings back when free."""
    c, slow, quick = rng.uniform(0.6, 1.0), rng.uniform(2.0, 4.0), rng.uniform(0.3, 0.7)

    def respond(t: Array, u: Array, v: Array) -> Array:
        step, away, at = interval(t), np.empty(len(u)), 0.0
        for n, (x, held) in enumerate(zip(u.tolist(), (v > c).tolist(), strict=True)):
            at -= step * (x + at / slow) if held else step * at / quick
            away[n] = at
        return away

    return respond, f"y, dy/dt = -u - y / {slow:.2f} where v > {c:.3f}, else -y / {quick:.2f}"

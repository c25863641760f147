"""A measured heading's laws without a name: functions of the attitude, the rate and of time.

What the catalogue covers is left out, so that a term found here has no name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handcal.compiled.jit import inner, residual_function
from handcal.effects import TIME, WARMTH, Catalogue, Effect, Param, catalogue
from handcal.laws.drivers import WARM
from handcal.laws.grammar import SIZES, WIDTHS, process_root
from handcal.laws.law_effect import heading_columns, known_headings, spanned
from handcal.signals import warmth_at
from handcal.types import Array, Recording

# Root mean square of what a term adds, one prior sigma, rad.
HEADING_SIZE = 0.1
# Harmonics beyond those of iron, and grids of whole parts of the circle, deg.
HARMONICS = 4
GRIDS = (1.0, 2.0, 5.0, 10.0, 15.0, 22.5, 30.0, 45.0)
# A change of temperature that is none, K.
LEAST_WARMING = 0.3
# Rate below which a compass may stick, rad/s; its inverse sinh's largest size, at 20 rad/s.
SLOW = 0.1
FASTEST = math.asinh(20.0 / SLOW)
# Where the axis whose heading is told stands more steeply than this (the cosine), too little of it
# is level for one.
STEEPEST = 0.25
# Knots of a curve over the heading's direction, and over anything else.
DIRECTIONS, KNOTS = 32, 9
# How the kind of a curve begins (``Effect.made``).
CURVE = "heading over "


def again(formula: str, prior: float) -> Effect:
    """The term that was found before by its formula, with its prior (SI).

    Raises KeyError for a formula that there is none of.
    """
    return _term_of(formula.removeprefix("heading += "), prior)


def term(formula: str, unit: str, prior: float, story: str = "", **physics: Any) -> Effect:
    """An effect of one parameter k without a name but its formula; prior: sigma of k; story: what
    that means in plain words, if it can be said."""
    return Effect(
        id=formula,
        title=formula,
        parameters=(Param("k", unit, prior),),
        story=story,
        source="found in this recording",
        motion="The motion in which it was found.",
        validated="held-out data alone",
        **physics,
    )


@inner
def cubic(u: float, a: float, b: float, c: float, d: float) -> float:
    """The cubic spline between two knots, a share u of the way, by its four coefficients there."""
    v = 1.0 - u
    return (
        v * v * v * a
        + (4.0 - 6.0 * u * u + 3.0 * u * u * u) * b
        + (4.0 - 6.0 * v * v + 3.0 * v * v * v) * c
        + u * u * u * d
    ) / 6.0


# --- formulas ------------------------------------------------------------------------------

Residual = Callable[..., int]


def _harmonic(n: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        yaw = np.arctan2(nav[9], nav[6])
        r[0] -= k[0] * np.sin(n * yaw) + k[1] * np.cos(n * yaw)
        return 0

    return heading


def _tilted(row: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= k[0] * nav[row]
        return 0

    return heading


@inner
def wave(nav: Any, k: Any) -> Any:
    """Once round the circle of headings, of any phase."""
    yaw = np.arctan2(nav[9], nav[6])
    return k[0] * np.sin(yaw) + k[1] * np.cos(yaw)


def _tilted_iron(row: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= wave(nav, k) * nav[row]
        return 0

    return heading


def _turning_iron(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= wave(nav, k) * np.sqrt(nav[15] * nav[15] + nav[16] * nav[16] + nav[17] * nav[17])
    return 0


def _steep_iron(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= wave(nav, k) / max(np.sqrt(max(1.0 - nav[12] * nav[12], 0.0)), STEEPEST)
    return 0


def _of_stream_iron(stream: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:
        r[0] -= wave(nav, k) * z[stream]
        return 0

    return heading


def _both_tilted(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * nav[12] * nav[13]
    return 0


def _tilted_turn(row: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        r[0] -= k[0] * (nav[12] * nav[15] + nav[13] * nav[16] + nav[14] * nav[17]) * nav[row]
        return 0

    return heading


def _tilt2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * (1.0 - nav[14] * nav[14])
    return 0


def _time2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * z[TIME] * z[TIME]
    return 0


def _warmth(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * z[WARMTH]
    return 0


def _warmth2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * z[WARMTH] * z[WARMTH]
    return 0


def _turn_size(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * abs(nav[12] * nav[15] + nav[13] * nav[16] + nav[14] * nav[17])
    return 0


def _turning(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * np.sqrt(nav[15] * nav[15] + nav[16] * nav[16] + nav[17] * nav[17])
    return 0


def _turn_sign(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    rate = nav[12] * nav[15] + nav[13] * nav[16] + nav[14] * nav[17]
    r[0] -= k[0] * np.tanh(rate / SLOW)
    return 0


def _grid(step: float) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        yaw = np.arctan2(nav[9], nav[6])
        r[0] -= k[0] * (np.floor(yaw / step + 0.5) * step - yaw)
        return 0

    return heading


def _table() -> Iterator[tuple[str, tuple[Residual, tuple[str, ...]]]]:
    for n in range(3, 3 + HARMONICS):
        yield f"k1 * sin({n} yaw) + k2 * cos({n} yaw)", (_harmonic(n), ("rad", "rad"))
    for axis, row in (("x", 12), ("y", 13)):
        yield f"k * sin(pitch of {axis})", (_tilted(row), ("rad",))
        text = f"(k1 * sin(yaw) + k2 * cos(yaw)) * sin(pitch of {axis})"
        yield text, (_tilted_iron(row), ("rad", "rad"))
        yield f"k * yaw rate * sin(pitch of {axis})", (_tilted_turn(row), ("s",))
    yield "(k1 * sin(yaw) + k2 * cos(yaw)) * |omega|", (_turning_iron, ("s", "s"))
    text = f"(k1 * sin(yaw) + k2 * cos(yaw)) / max(cos(pitch of x), {STEEPEST:g})"
    yield text, (_steep_iron, ("rad", "rad"))
    text = f"(k1 * sin(yaw) + k2 * cos(yaw)) * {WARM}"
    yield text, (_of_stream_iron(WARMTH), ("rad/K", "rad/K"))
    yield "(k1 * sin(yaw) + k2 * cos(yaw)) * t", (_of_stream_iron(TIME), ("rad/s", "rad/s"))
    yield "k * sin(pitch of x) * sin(pitch of y)", (_both_tilted, ("rad",))
    yield "(k1 * sin(yaw) + k2 * cos(yaw)) * cos(tilt)", (_tilted_iron(14), ("rad", "rad"))
    yield "k * yaw rate * cos(tilt)", (_tilted_turn(14), ("s",))
    yield "k * sin(tilt)^2", (_tilt2, ("rad",))
    yield "k * t^2", (_time2, ("rad/s^2",))
    yield f"k * {WARM}", (_warmth, ("rad/K",))
    yield f"k * {WARM}^2", (_warmth2, ("rad/K^2",))
    yield "k * abs(yaw rate)", (_turn_size, ("s",))
    yield "k * |omega|", (_turning, ("s",))
    yield f"k * tanh(yaw rate / {SLOW:g})", (_turn_sign, ("rad",))
    for step in GRIDS:
        text = f"k * (round(yaw / {step:g} deg) * {step:g} deg - yaw)"
        yield text, (_grid(math.radians(step)), ("1",))


_HEADING: Mapping[str, tuple[int, tuple[str, ...]]] = {
    text: (residual_function(function), units) for text, (function, units) in _table()
}


def _term_of(text: str, prior: float) -> Effect:
    address, units = _HEADING[text]
    acts, needs = {"heading": address}, ("temperature",) * (WARM in text)
    one = term(f"heading += {text}", units[0], prior, observation_error=acts, needs=needs)
    if len(units) == 1:
        return one
    several = tuple(Param(f"k{n + 1}", unit, prior) for n, unit in enumerate(units))
    return replace(one, parameters=several)


def heading_terms(recording: Recording) -> list[Effect]:
    """Terms of a measured heading."""
    known, span = _named_headings(catalogue()), recording.duration_s
    size, warmth = HEADING_SIZE, warmth_at(recording, recording.imu.t)
    sizes = {
        "rad": size,
        "rad/s": 2.0 * size / span,
        "rad/s^2": 2.0 * size / span**2,
        "s": size,
        "1": 1.0,
    }
    if np.ptp(warmth) > LEAST_WARMING:
        sizes |= {"rad/K": size / _rms(warmth), "rad/K^2": size / _rms(warmth**2)}
    return [
        _term_of(text, sizes[u[0]])
        for text, (_, u) in _HEADING.items()
        if text not in known and u[0] in sizes
    ]


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


@cache
def _named_headings(catalogued: Catalogue) -> frozenset[str]:
    """Formulas of the heading that effects of the catalogue add up to, on a probing motion."""
    inside = known_headings(catalogued)
    return frozenset(
        text for text in _HEADING if spanned(inside, heading_columns(_term_of(text, 1.0))).all()
    )


# --- curves --------------------------------------------------------------------------------


def _over(row: int) -> Residual:
    def heading(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
        u = (min(max(nav[row], -1.0), 1.0) + 1.0) * 0.5 * (KNOTS - 3)
        i = min(int(u), KNOTS - 4)
        r[0] -= cubic(u - i, k[i], k[i + 1], k[i + 2], k[i + 3])
        return 0

    return heading


def _over_turn(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    rate = nav[12] * nav[15] + nav[13] * nav[16] + nav[14] * nav[17]
    u = (np.arcsinh(rate / SLOW) / FASTEST + 1.0) * 0.5 * (KNOTS - 3)
    u = min(max(u, 0.0), KNOTS - 3.0)
    i = min(int(u), KNOTS - 4)
    r[0] -= cubic(u - i, k[i], k[i + 1], k[i + 2], k[i + 3])
    return 0


def _over_yaw(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    x = (math.atan2(nav[9], nav[6]) / math.pi + 1.0) * 0.5 * DIRECTIONS
    i = int(x)
    before, after = (i + DIRECTIONS - 1) % DIRECTIONS, (i + 1) % DIRECTIONS
    r[0] -= cubic(x - i, k[before], k[i % DIRECTIONS], k[after], k[(i + 2) % DIRECTIONS])
    return 0


# Address and number of knots of the heading's curves, by what drives them.
CURVES: Mapping[str, tuple[int, int]] = {
    "yaw": (residual_function(_over_yaw), DIRECTIONS),
    "pitch of x": (residual_function(_over(12)), KNOTS),
    "pitch of y": (residual_function(_over(13)), KNOTS),
    "tilt": (residual_function(_over(14)), KNOTS),
    "yaw rate": (residual_function(_over_turn), KNOTS),
}


def curve(driver: str, width: float, size: float) -> Effect:
    """The heading's error as a smooth curve over a driver; width of the Gaussian process that is
    its prior, in knots, and size, of a clearly visible error. Raises KeyError."""
    address, knots = CURVES[driver]
    apart = np.abs(np.arange(knots)[:, None] - np.arange(knots))
    if driver == "yaw":
        # (a chord for the way round, as a covariance on the circle must be one everywhere)
        apart = knots / np.pi * np.sin(np.pi * apart / knots)
    acts, made = {"heading": address}, (f"{CURVE}{driver}", (width, size))
    one = term(f"heading += g({driver})", "rad", HEADING_SIZE, observation_error=acts, made=made)
    several = tuple(Param(f"c{n + 1}", "rad", HEADING_SIZE) for n in range(knots))
    return replace(one, parameters=several, together=size * process_root(apart, width))


def heading_curves() -> list[list[Effect]]:
    """The heading's curves over each driver, of every width and size."""
    widths = {"yaw": (1.5, 4.0)}
    return [
        [curve(driver, w, s) for w in widths.get(driver, WIDTHS) for s in SIZES]
        for driver in CURVES
    ]

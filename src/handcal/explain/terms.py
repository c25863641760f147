"""Physics that nobody named: sparse terms in products of measured signals.

Each term is an effect of one parameter: a channel reads k times a signal in addition. What
the catalogue covers is left out, so that a term found here has no name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from handcal import so3
from handcal._jit import njit, residual_function
from handcal.effects import (
    TIME,
    Z_DIM,
    Catalogue,
    Effect,
    Param,
    Signals,
    catalogue,
    imu_jacobian,
    observed_error,
)
from handcal.signals import probe
from handcal.types import Array, BoolArray, Recording

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
UNITS = ("rad/s", "m/s^2")
# Root mean square of what a term adds, one prior sigma: half a degree a second, 10 mg.
SIZE = (0.01, 0.1)
HEADING_SIZE = 0.1
# Half widths of play in an accelerometer, m/s^2; wider than its noise.
PLAY = (0.1, 0.2, 0.4)
# Samples of the motion on which the catalogue is tried, and the share (squared) of a term that may
# be left for it to be named: a central difference leaves far less, another law far more. Of a
# column of length one, so much must be new.
PROBED, SPANNED = 120, 1e-8
DEPENDENT = 1e-6
_AXES = "xyz"
_UNIT = {"omega": "rad/s", "f": "m/s^2", "alpha": "rad/s^2", "t": "s", "T": "K"}

Feature = Callable[[Signals], Array]


def _power(unit: str, times: int) -> str:
    return f"({unit})^{times}" if times > 1 else f"({unit})"


def _omega(i: int) -> Feature:
    return lambda s: s.gyro[:, i]


def _force(i: int) -> Feature:
    return lambda s: s.accel[:, i]


def _time(s: Signals) -> Array:
    return np.asarray(s.t - s.t[0])


def _warmth(s: Signals) -> Array:
    return np.zeros_like(s.t) if s.temperature is None else s.temperature - 25.0


def _alpha(i: int) -> Feature:
    return lambda s: np.asarray(np.gradient(s.gyro[:, i], s.t))


def _times(*factors: Feature) -> Feature:
    def product(s: Signals) -> Array:
        out = np.array(factors[0](s))
        for f in factors[1:]:
            out = out * f(s)
        return out

    return product


def _absolute(f: Feature) -> Feature:
    return lambda s: np.abs(f(s))


@njit
def _follower(x: Array, half: float) -> Array:
    out = np.empty(len(x))
    follow = x[0]
    for i in range(len(x)):
        follow = min(max(follow, x[i] - half), x[i] + half)
        out[i] = follow
    return out


def _play(f: Feature, half: float) -> Feature:
    """By how much what follows a signal f with play lags behind it (the operator of which
    Prandtl and Ishlinskii built hysteresis)."""
    return lambda s: _follower(np.ascontiguousarray(f(s)), half) - f(s)


def features(temperature: bool) -> dict[str, tuple[Feature, str]]:
    """Every signal that may be a term: formula, function, unit."""
    w, f = [_omega(i) for i in range(3)], [_force(i) for i in range(3)]
    out: dict[str, tuple[Feature, str]] = {}
    for i, a in enumerate(_AXES):
        out[f"omega_{a}"] = (w[i], "rad/s")
        out[f"f_{a}"] = (f[i], "m/s^2")
        out[f"abs(omega_{a})"] = (_absolute(w[i]), "rad/s")
        out[f"abs(f_{a})"] = (_absolute(f[i]), "m/s^2")
        out[f"omega_{a}^2"] = (_times(w[i], w[i]), "(rad/s)^2")
        out[f"omega_{a}^3"] = (_times(w[i], w[i], w[i]), "(rad/s)^3")
        out[f"omega_{a} * abs(omega_{a})"] = (_times(w[i], _absolute(w[i])), "(rad/s)^2")
        out[f"f_{a}^2"] = (_times(f[i], f[i]), "(m/s^2)^2")
        out[f"f_{a}^3"] = (_times(f[i], f[i], f[i]), "(m/s^2)^3")
        for half in PLAY:
            out[f"(play({half:g} m/s^2) of f_{a} - f_{a})"] = (_play(f[i], half), "m/s^2")
        out[f"alpha_{a}"] = (_alpha(i), "rad/s^2")
        out[f"omega_{a} * t"] = (_times(w[i], _time), "rad")
        out[f"f_{a} * t"] = (_times(f[i], _time), "m/s")
        if temperature:
            out[f"omega_{a} * T"] = (_times(w[i], _warmth), "rad/s*K")
            out[f"f_{a} * T"] = (_times(f[i], _warmth), "m/s^2*K")
        for j, b in enumerate(_AXES):
            out[f"omega_{a} * f_{b}"] = (_times(w[i], f[j]), "rad*m/s^3")
            if i < j:
                out[f"omega_{a} * omega_{b}"] = (_times(w[i], w[j]), "(rad/s)^2")
                out[f"f_{a} * f_{b}"] = (_times(f[i], f[j]), "(m/s^2)^2")
    out["t"] = (_time, "s")
    out["t^2"] = (_times(_time, _time), "s^2")
    if temperature:
        out["T^2"] = (_times(_warmth, _warmth), "K^2")
    return out


def named(channel: int, formula: str) -> bool:
    """Whether the catalogue has this already."""
    return (channel, formula) in _named(catalogue())


@cache
def _named(known: Catalogue) -> frozenset[tuple[int, str]]:
    """Channels and formulas that effects of the catalogue add up to, tried on a probing motion.

    How the axes of the body are turned against the sensors' is convention: a turn of all readings
    together is no error (what lies above the accelerometer's diagonal is the gyro's misalignment).
    """
    s = probe(PROBED)
    n = len(s.t)
    columns = [np.kron(np.eye(6), np.ones((n, 1)))]  # the biases
    for axis in np.eye(3):
        turned = np.hstack([np.cross(axis, s.gyro), np.cross(axis, s.accel)])
        columns.append(turned.T.reshape(-1, 1))
    for effect in known.values():
        J = imu_jacobian(effect, np.zeros(len(effect.parameters)), s)
        columns.append(J.transpose(1, 0, 2).reshape(6 * n, -1))
    Q = _basis(np.hstack(columns)).reshape(6, n, -1)
    formulas = features(True)
    U = np.stack([feature(s) for feature, _ in formulas.values()], axis=1)
    return frozenset(
        (channel, formula)
        for channel in range(6)
        for formula, inside in zip(formulas, _spanned(Q[channel], U), strict=True)
        if inside
    )


def _basis(columns: Array) -> Array:
    """Orthonormal basis (n, r) of what the columns (n, k) span, by Gram and Schmidt.

    (So few numbers are sooner done than shared out among threads, which a library would do.)
    """
    found = np.zeros((columns.shape[1], len(columns)))
    r = 0
    for column in columns.T:
        size = math.sqrt(np.einsum("n,n->", column, column))
        rest = column / size if size else column
        for _ in range(2):
            inside = np.einsum("rn,n->r", found[:r], rest)
            rest = rest - np.einsum("rn,r->n", found[:r], inside)
        left = math.sqrt(np.einsum("n,n->", rest, rest))
        if left > DEPENDENT:
            found[r] = rest / left
            r += 1
    return found[:r].T


def _spanned(Q: Array, U: Array) -> BoolArray:
    """Which columns of U (n, q) lie in the span of orthonormal ones, of which Q (n, r) are the
    rows that concern U (there is nothing of U in the others)."""
    whole = np.einsum("nq,nq->q", U, U)
    part = np.einsum("nr,nq->rq", Q, U)
    return np.asarray(whole - np.einsum("rq,rq->q", part, part) <= SPANNED * whole)


def _elsewhere(channel: int, formula: str) -> bool:
    """Whether only another channel could have this: play is an accelerometer's own."""
    return "play" in formula and not (channel >= 3 and f"f_{_AXES[channel - 3]}" in formula)


def imu_terms(signals: Signals, channel: int) -> list[Effect]:
    """Terms of one IMU channel (0 to 5) as effects; prior of each: a clearly visible size."""
    out = []
    for formula, (feature, unit) in features(signals.temperature is not None).items():
        if named(channel, formula) or _elsewhere(channel, formula):
            continue
        size = float(np.sqrt(np.mean(feature(signals) ** 2)))
        if size > 1e-9:
            out.append(_imu_term(channel, formula, feature, unit, SIZE[channel // 3] / size))
    return out


def _imu_term(channel: int, formula: str, feature: Feature, unit: str, prior: float) -> Effect:
    def error(k: Array, signals: Signals) -> Array:
        out = np.zeros((len(signals.t), 6))
        out[:, channel] = k[0] * feature(signals)
        return out

    own = UNITS[channel // 3]
    return term(
        f"{CHANNELS[channel]} += k * {formula}",
        own if unit == "1" else f"({own})/({unit})",
        prior,
        positive="play" in formula,  # (it lags, and cannot lead)
        imu_error=error,
        features=lambda truth: [(channel, feature(truth)[:, None])],
    )


def again(formula: str, prior: float) -> Effect:
    """The term that was found before by its formula, with its prior (SI).

    Raises KeyError for a formula that there is none of.
    """
    channel, product = formula.split(" += k * ", 1)
    if channel == "heading":
        address, unit = _HEADING[product]
        acts = {"heading": address}
        return term(formula, unit, prior, observation_error=acts)
    column = {c: i for i, c in enumerate(CHANNELS)}[channel]
    feature, unit = features(temperature=True)[product]
    return _imu_term(column, product, feature, unit, prior)


def term(
    formula: str, unit: str, prior: float, story: str = "", positive: bool = False, **physics: Any
) -> Effect:
    """An effect of one parameter k without a name but its formula; prior: sigma of k; story: what
    that means in plain words, if it can be said."""
    return Effect(
        id=formula,
        title=formula,
        parameters=(Param("k", unit, prior, positive),),
        story=story,
        source="found in this recording",
        motion="The motion in which it was found.",
        validated="held-out data alone",
        **physics,
    )


def _sin3(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = np.arctan2(nav[9], nav[6])
    r[0] -= k[0] * np.sin(3.0 * yaw)
    return 0


def _cos3(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = np.arctan2(nav[9], nav[6])
    r[0] -= k[0] * np.cos(3.0 * yaw)
    return 0


def _pitch(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * nav[12]
    return 0


def _roll(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * nav[13]
    return 0


def _tilt2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * (1.0 - nav[14] * nav[14])
    return 0


def _time2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * z[TIME] * z[TIME]
    return 0


_HEADING: Mapping[str, tuple[int, str]] = {
    "sin(3 yaw)": (residual_function(_sin3), "rad"),
    "cos(3 yaw)": (residual_function(_cos3), "rad"),
    "sin(pitch of x)": (residual_function(_pitch), "rad"),
    "sin(pitch of y)": (residual_function(_roll), "rad"),
    "sin(tilt)^2": (residual_function(_tilt2), "rad"),
    "t^2": (residual_function(_time2), "rad/s^2"),
}


def heading_terms(recording: Recording) -> list[Effect]:
    """Terms of a measured heading."""
    out = []
    known = _named_headings(catalogue())
    for formula, (address, unit) in _HEADING.items():
        if formula in known:
            continue
        prior = HEADING_SIZE * (2.0 / recording.duration_s**2 if unit == "rad/s^2" else 1.0)
        out.append(
            term(
                f"heading += k * {formula}",
                unit,
                prior,
                observation_error={"heading": address},
            )
        )
    return out


@cache
def _named_headings(known: Catalogue) -> frozenset[str]:
    """Formulas of the heading that effects of the catalogue add up to, tried as in ``_named``."""
    s = probe(PROBED)
    assert s.C_nb is not None
    n = len(s.t)
    place, speed = s.streams["pose"][:, :3], s.streams["mag"]
    nav = np.hstack([place, speed, s.C_nb.reshape(n, 9), s.gyro, s.accel])
    z = np.zeros((n, Z_DIM))
    z[:, 0], z[:, TIME] = so3.yaw_of(s.C_nb), s.t
    columns = [np.ones((n, 1))]  # a constant offset
    for effect in known.values():
        if "heading" in effect.observation_error and effect.process is None:
            for step in np.diag(1e-3 * effect.prior_sigma):
                less, more = (
                    observed_error(effect, "heading", x, nav, z, 1) for x in (-step, step)
                )
                columns.append(more - less)
    found = []
    for formula, (address, unit) in _HEADING.items():
        alone = term(formula, unit, 1.0, observation_error={"heading": address})
        found.append(observed_error(alone, "heading", np.ones(1), nav, z, 1))
    inside = _spanned(_basis(np.hstack(columns)), np.hstack(found))
    return frozenset(f for f, yes in zip(_HEADING, inside, strict=True) if yes)

"""Physics that nobody named: sparse terms in products of measured signals.

Each term is an effect of one parameter: a channel reads k times a signal in addition. What
the catalogue covers is left out, so that a term found here has no name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from handcal._jit import njit, residual_function
from handcal.effects import TIME, Effect, Param, Signals
from handcal.types import Array, Recording

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
UNITS = ("rad/s", "m/s^2")
# Root mean square of what a term adds, one prior sigma: half a degree a second, 10 mg.
SIZE = (0.01, 0.1)
HEADING_SIZE = 0.1
# Half widths of play in an accelerometer, m/s^2; wider than its noise.
PLAY = (0.1, 0.2, 0.4)
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


def _named(channel: int, formula: str) -> bool:
    """Whether the catalogue has this already."""
    axis = _AXES[channel % 3]
    if channel < 3:
        plain = [f"omega_{a}" for a in _AXES] + [f"f_{a}" for a in _AXES] + [f"omega_{axis}^2"]
        pairs = [f"omega_{a} * omega_{b}" for a, b in ("xy", "xz", "yz")]
        return formula in plain or formula in pairs
    # (all of f: what lies above the diagonal turns the body's axes, and is the gyro's misalignment)
    plain = [f"f_{a}" for a in _AXES] + [f"abs(f_{axis})"]
    return formula in plain or formula in [f"f_{a} * f_{b}" for a, b in ("xy", "xz", "yz")]


def _elsewhere(channel: int, formula: str) -> bool:
    """Whether only another channel could have this: play is an accelerometer's own."""
    return "play" in formula and not (channel >= 3 and f"f_{_AXES[channel - 3]}" in formula)


def imu_terms(signals: Signals, channel: int) -> list[Effect]:
    """Terms of one IMU channel (0 to 5) as effects; prior of each: a clearly visible size."""
    out = []
    for formula, (feature, unit) in features(signals.temperature is not None).items():
        if _named(channel, formula) or _elsewhere(channel, formula):
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
    )


def again(formula: str, prior: float) -> Effect:
    """The term that was found before by its formula, with its prior (SI).

    Raises KeyError for a formula that there is none of.
    """
    channel, product = formula.split(" += k * ", 1)
    if channel == "heading":
        address, unit = _HEADING[product]
        acts = {"heading": address, "magnetometer": address}
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
    """Terms of the heading, measured or magnetic."""
    out = []
    for formula, (address, unit) in _HEADING.items():
        prior = HEADING_SIZE * (2.0 / recording.duration_s**2 if unit == "rad/s^2" else 1.0)
        out.append(
            term(
                f"heading += k * {formula}",
                unit,
                prior,
                observation_error={"heading": address, "magnetometer": address},
            )
        )
    return out

"""A ``Result`` made up without any filter, to look at and test what people see."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from handcal.estimate.live import Frame, Observed
from handcal.types import (
    Array,
    History,
    Imu,
    Innovations,
    NoiseLevel,
    Parameter,
    Recording,
    Result,
    Series,
)

GRAVITY = 9.80665
MOTION_FROM_S = 8.0

Row = tuple[str, str, float, float, float, str]
BASELINE: tuple[Row, ...] = (
    # effect, name, value, final sigma, prior sigma, unit
    ("gyro_bias", "x", 0.0121, 1.1e-4, 0.01745, "rad/s"),
    ("gyro_bias", "y", -0.0083, 1.2e-4, 0.01745, "rad/s"),
    ("gyro_bias", "z", 0.0040, 1.6e-4, 0.01745, "rad/s"),
    ("accel_bias", "x", 0.142, 4.1e-3, 0.6, "m/s^2"),
    ("accel_bias", "y", -0.087, 3.8e-3, 0.6, "m/s^2"),
    ("accel_bias", "z", 0.231, 5.2e-3, 0.6, "m/s^2"),
)
EXTRA: tuple[Row, ...] = (
    ("gyro_scale", "x", 0.0062, 7e-4, 0.01, "1"),
    ("gyro_scale", "y", -0.0041, 9e-4, 0.01, "1"),
    ("gyro_scale", "z", 0.0012, 7.1e-3, 0.01, "1"),
    ("lever_arm", "x", 0.031, 2.1e-3, 0.1, "m"),
    ("lever_arm", "y", 0.082, 2.4e-3, 0.1, "m"),
    ("lever_arm", "z", -0.004, 8.9e-3, 0.1, "m"),
    ("heading_delay", "delay", 0.121, 0.012, 0.15, "s"),
)
# What a motion did not show: one at its usual size, one with the tails of its prior.
HIDDEN: tuple[Row, ...] = (
    *(("accel_scale", a, 1e-4, 0.0099, 0.01, "1") for a in "xyz"),
    *(("gyro_g_sensitivity", a + b, 1e-6, 5.4e-4, 1.8e-4, "(rad/s)/(m/s^2)")
      for a in "xyz" for b in "xyz"),
)  # fmt: skip


def _attitudes(t: Array) -> Array:
    """C_nb over time (n, 3, 3): at rest first, then turned about changing axes."""
    s = np.clip(t - MOTION_FROM_S, 0.0, None)
    yaw = 0.4 + 2.1 * np.sin(0.35 * s) + 0.05 * s
    pitch = 1.1 * np.sin(0.5 * s)
    roll = 1.4 * np.sin(0.63 * s) * np.clip(s / 10, 0, 1)
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _quaternions(c: Array) -> Array:
    """(n, 4) w x y z of (n, 3, 3) rotation matrices, of either sign."""
    trace = np.clip(1.0 + np.trace(c, axis1=1, axis2=2), 1e-9, None)
    w = 0.5 * np.sqrt(trace)
    xyz = np.stack([c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], 1)
    q = np.column_stack([w, xyz / (4 * w[:, None])])
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def _imu(t: Array, rng: np.random.Generator) -> Imu:
    c = _attitudes(t)
    step = np.einsum("nij,nik->njk", c[:-1], c[1:])
    rate = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], 1) / np.diff(t)[:, None]
    gyro = np.vstack([rate, rate[-1:]]) + rng.normal(0, 0.004, (t.size, 3))
    accel = GRAVITY * c[:, 2, :] + rng.normal(0, 0.06, (t.size, 3))
    return Imu(t, gyro, accel, np.ones(t.size, dtype=bool))


def _innovations(
    rng: np.random.Generator,
    t: Array,
    sigma: float,
    names: tuple[str, ...],
    unit: str,
    scale: float,
) -> Innovations:
    d = len(names)
    bound = np.full((t.size, d), sigma) * (1 + 2 * np.exp(-t / 3))[:, None]
    residual = rng.normal(0, scale, (t.size, d)) * bound
    return Innovations(t, residual, bound, ((residual / bound) ** 2).sum(1), 0, unit, names)


def _parameters(rows: tuple[Row, ...]) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(effect, name, value, sigma, unit, prior, 31.5 if sigma < prior / 2 else None)
        for effect, name, value, sigma, prior, unit in rows
    )


def _history(t: Array, parameters: tuple[Parameter, ...], rng: np.random.Generator) -> History:
    prior = np.array([p.prior_sigma for p in parameters])
    final = np.array([p.sigma for p in parameters])
    progress = np.clip((t - 1.0) / 40.0, 0, 1)[:, None] ** 0.25
    sigma = np.exp(np.log(prior) * (1 - progress) + np.log(final) * progress)
    wander = np.cumsum(rng.normal(0, 1, (t.size, prior.size)), 0) / math.sqrt(t.size)
    value = np.array([p.value for p in parameters]) + sigma * (wander - wander[-1]) * 0.8
    c = _attitudes(t)
    yaw = np.arctan2(c[:, 1, 0], c[:, 0, 0])
    k = t.size
    p_n = 0.004 * np.cumsum(rng.normal(0, 0.2, (k, 3)), 0) / math.sqrt(20)
    nav_sigma = np.tile([0.01] * 3 + [0.02] * 3 + [0.004] * 3, (k, 1))
    v_n = np.gradient(p_n, t, axis=0)
    return History(t, p_n, v_n, _quaternions(c), yaw, nav_sigma, value, sigma)


def fake_result(
    *, heading: bool = True, extra: bool = True, overconfident: bool = False, hidden: bool = False
) -> Result:
    """A consistent result of 84 s in the hand; ``extra`` adds effects beyond the baseline,
    ``hidden`` some of which nothing is shown."""
    rng = np.random.default_rng(5)
    t = np.arange(0, 84, 0.01)
    slow = t[::5]
    rows = list(BASELINE + (EXTRA if extra else ()) + (HIDDEN if hidden else ()))
    if not heading:
        rows = [r for r in rows if not r[0].startswith("heading")]
        rows = [(*r[:3], 0.9 * r[4], *r[4:]) if r[:2] == ("gyro_bias", "z") else r for r in rows]
    parameters = _parameters(tuple(rows))
    history = _history(slow, parameters, rng)
    scale = 3.0 if overconfident else 1.0
    xyz = ("x", "y", "z")
    innovations = {
        "position": _innovations(
            rng, slow[::2], 0.012, tuple(f"position_{a}" for a in xyz), "m", scale
        ),
        "velocity": _innovations(
            rng, slow[::2], 0.03, tuple(f"velocity_{a}" for a in xyz), "m/s", 1.0
        ),
    }
    streams: dict[str, Series] = {}
    observed = None
    if heading:
        innovations["heading"] = _innovations(rng, slow[::2], 0.05, ("heading",), "rad", 1.0)
        noisy = history.yaw[::2] + rng.normal(0, 0.05, slow[::2].size)
        observed = np.column_stack([slow[::2], np.angle(np.exp(1j * noisy))])
        streams["heading"] = Series(observed[:, 0], observed[:, 1:])
    recording = Recording("hand-motion.mcap", _imu(t, rng), streams)
    return Result(
        recording=recording,
        assume="fixed-point",
        parameters=parameters,
        covariance=np.diag([p.sigma**2 for p in parameters]),
        noise=(
            NoiseLevel("gyro_noise", 2.1e-4, "rad/s/sqrt(Hz)", True),
            NoiseLevel("accel_noise", 1.9e-3, "m/s^2/sqrt(Hz)", True),
            NoiseLevel("hand_sway", 0.011, "m", True),
        ),
        history=history,
        innovations=innovations,
        log_evidence=18321.4,
        rests=np.array([[0.4, 7.6], [80.5, 83.5]]),
        warnings=("3 readings of the accelerometer were not finite and were left out.",),
        observed_heading=observed,
    )


def fake_frames(result: Result, rate_hz: float = 30.0) -> Iterator[Frame]:
    """Frames such as a filter would have yielded on its way to this result."""
    h, imu = result.history, result.recording.imu
    tick = np.floor((h.t - h.t[0]) * rate_hz + 1e-9)
    rows = np.flatnonzero(np.diff(tick, prepend=-1.0) > 0)
    after = -np.inf
    for row in rows:
        t = float(h.t[row])
        observed = tuple(
            Observed(float(i.t[j]), kind, i.residual[j], i.sigma[j], float(i.nis[j]))
            for kind, i in result.innovations.items()
            for j in np.flatnonzero((i.t > after) & (i.t <= t))
        )
        seen = result.observed_heading
        heading = None
        if seen is not None and (new := (seen[:, 0] > after) & (seen[:, 0] <= t)).any():
            heading = float(seen[new, 1][-1])
        n = max(int(np.searchsorted(imu.t, t, side="right")) - 1, 0)
        state = (h.p_n[row], h.q_nb[row], float(h.yaw[row]))
        known = (h.parameters[row], h.parameter_sigma[row])
        yield Frame(t, *state, *known, observed, heading, imu.gyro[n], imu.accel[n])
        after = t

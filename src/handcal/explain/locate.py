"""Where and when the baseline falls short, by channel, time and regime of motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from handcal.device.twin import sensor_residuals
from handcal.estimate.driven import driven
from handcal.estimate.model import Fitted
from handcal.estimate.problem import observation_variances
from handcal.explanation import Mismatch, Trace
from handcal.types import Array, BoolArray

# Time bins of a recording at the most; share of the shortfall from which a channel is named.
BINS = 60
LEAST_SHARE = 0.05
# For showing: points of a trace, and what they are means over, s.
TRACE_POINTS = 1500
SLOT_S = 0.1
# Turning rates that people tell apart, rad/s.
FAST = np.radians(90.0)
SLOW = np.radians(5.0)


def penalties(f: Fitted) -> dict[str, tuple[Array, Array]]:
    """What each channel pays for a fit: (t (k,), cost (k,)), half the squared standardised
    residuals of the smoothed trajectory: readings against the noise of the sensors, observations
    against theirs, and what drives sway or distortion against its own size."""
    linear, levels = f.linear, f.levels
    problem = linear.problem
    out: dict[str, tuple[Array, Array]] = {}
    residuals = sensor_residuals(linear, SLOT_S)
    known = "known_input" in f.case.kinds
    for name, density in (("gyro", levels["gyro_noise"]), ("accel", levels["accel_noise"])):
        for a in "xyz":
            t, x = residuals[f"{name}_{a}"]
            white = levels[f"reference_{name}_noise"] if known else density / np.sqrt(SLOT_S)
            out[f"{name}_{a}"] = (t, 0.5 * (x / white) ** 2)
    if known:
        return out
    R = observation_variances(problem, levels)
    t_row = np.repeat(linear.t, np.diff(linear.first))
    for k, observation in enumerate(problem.observations):
        mine = (linear.kind == k) & linear.used
        for i, channel in enumerate(observation.channels):
            if channel in out and channel.startswith(("gyro", "accel")):
                continue
            cost = 0.5 * linear.r[mine, i] ** 2 / R[k, i]
            _add(out, channel, t_row[mine], cost)
    noise = driven(linear, levels)
    at = 0
    for observation in problem.observations:
        if observation.markov is None:
            continue
        s = slice(at, at + observation.markov.size)
        at = s.stop
        channels = observation.channels
        for i, x in enumerate(_whitened(noise.d_e[1:, s], noise.Q_e[1:, s, s]).T):
            cost = 0.5 * np.minimum(x**2, 1e6)
            _add(out, channels[i % len(channels)], linear.t[1:], cost)
    return out


def _whitened(steps: Array, Q: Array) -> Array:
    """Steps (k, e) in units of their covariance Q (k, e, e), as near to the states as can be."""
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", Q), 1e-30))
    # over a very short interval position and velocity are driven by one and the same push
    values, axes = np.linalg.eigh(Q / (scale[:, :, None] * scale[:, None]))
    along = np.einsum("kji,kj->ki", axes, steps / scale)
    return np.asarray(np.einsum("kij,kj->ki", axes, along / np.sqrt(np.maximum(values, 1e-3))))


def _add(out: dict[str, tuple[Array, Array]], channel: str, t: Array, cost: Array) -> None:
    if channel in out:
        t, cost = np.r_[out[channel][0], t], np.r_[out[channel][1], cost]
    out[channel] = (t, cost)


def shortfall(before: Fitted, after: Fitted) -> tuple[Array, dict[str, Array]]:
    """Bins (k + 1,) s and, by channel, nats (k,) that the baseline pays more than the model."""
    t = before.linear.t
    bins = np.linspace(t[0], t[-1], min(BINS, max(4, int(t[-1] - t[0]))) + 1)
    more, less = penalties(before), penalties(after)
    out = {}
    for channel in more:
        a, _ = np.histogram(more[channel][0], bins, weights=more[channel][1])
        if channel in less:
            b, _ = np.histogram(less[channel][0], bins, weights=less[channel][1])
            a = a - b
        out[channel] = np.asarray(a)
    return bins, out


def mismatches(
    before: Fitted, bins: Array, short: Mapping[str, Array], recording: int = 0
) -> list[Mismatch]:
    """The channels that carry most of the shortfall: from when to when, and doing what."""
    whole = sum(float(np.maximum(s, 0.0).sum()) for s in short.values())
    if whole <= 0.0:
        return []
    out = []
    for channel, nats in short.items():
        positive = np.maximum(nats, 0.0)
        share = float(positive.sum()) / whole
        if share < LEAST_SHARE:
            continue
        a, b = _span(positive)
        when = _regime(before, bins, positive)
        out.append(Mismatch(channel, float(bins[a]), float(bins[b]), share, when, recording))
    return sorted(out, key=lambda m: -m.share)


def _span(nats: Array) -> tuple[int, int]:
    """The shortest run of bins that holds nine tenths of the shortfall."""
    total = np.r_[0.0, np.cumsum(nats)]
    best = (0, len(nats))
    for a in range(len(nats)):
        b = int(np.searchsorted(total, total[a] + 0.9 * total[-1]))
        if b <= len(nats) and b - a < best[1] - best[0]:
            best = (a, b)
    return best


def _regime(f: Fitted, bins: Array, nats: Array) -> str:
    """What the device does while the shortfall grows, if that is more than chance."""
    linear = f.linear
    rate = np.array([_mean(linear.rate, linear.t, a, b) for a, b in pairwise(bins)])
    options: Sequence[tuple[str, BoolArray]] = (
        ("turning faster than 90 deg/s", rate > FAST),
        ("turning", rate > SLOW),
        ("at rest", rate <= SLOW),
    )
    total = float(nats.sum())
    for name, here in options:
        if 0 < here.sum() < len(here):
            inside, time = float(nats[here].sum()) / total, float(here.mean())
            if inside > 0.8 and inside > time + 0.15:
                return name
    return "throughout"


def _mean(x: Array, t: Array, a: float, b: float) -> float:
    inside = (t >= a) & (t <= b)
    return float(x[inside].mean()) if inside.any() else 0.0


def traces(before: Fitted, after: Fitted) -> tuple[Trace, ...]:
    """Recorded and simulated side by side in sensor units, smoothed over a tenth of a second."""
    imu = before.case.recording.imu
    a, b = sensor_residuals(before.linear, SLOT_S), sensor_residuals(after.linear, SLOT_S)
    out = []
    for i, name in enumerate(("gyro", "accel")):
        value = imu.gyro if i == 0 else imu.accel
        for k, axis in enumerate("xyz"):
            channel = f"{name}_{axis}"
            t, r = a[channel]
            recorded = _smoothed(imu.t, value[:, k], t)
            after_r = np.interp(t, *b[channel])
            known = after.levels.get(f"reference_{name}_noise")
            sigma = known or after.levels[f"{name}_noise"] / np.sqrt(SLOT_S)
            out.append(_trace(channel, t, recorded, r, after_r, sigma, ("rad/s", "m/s^2")[i]))
    for channel in a:
        if channel.startswith(("gyro", "accel")) or channel not in b:
            continue
        t, r = a[channel]
        kept = _read_by(t, b[channel][0])
        left_out, t, r = int((~kept).sum()), t[kept], r[kept]
        after_r = np.interp(t, *b[channel])
        unit = _unit(channel)
        sigma = float(np.sqrt(np.mean(after_r**2)))
        out.append(replace(_trace(channel, t, r, r, after_r, sigma, unit), left_out=left_out))
    return tuple(out)


def _read_by(t: Array, others: Array) -> BoolArray:
    """Which of the readings at times t (n,) another model has too, whose times are (m,)."""
    if len(t) < 2 or len(others) < 2:
        return np.ones(len(t), dtype=np.bool_)
    after = np.clip(np.searchsorted(others, t), 1, len(others) - 1)
    off = np.minimum(np.abs(t - others[after]), np.abs(t - others[after - 1]))
    return np.asarray(off < 0.5 * float(np.median(np.diff(t))))


def _unit(channel: str) -> str:
    kinds = {"heading": "rad", "position": "m", "velocity": "m/s", "attitude": "rad", "mag": "T"}
    return kinds.get(channel.split("_")[0], "1")


def _trace(
    channel: str, t: Array, recorded: Array, before: Array, after: Array, sigma: float, unit: str
) -> Trace:
    step = max(1, len(t) // TRACE_POINTS)
    k = slice(None, None, step)
    return Trace(
        channel, t[k], recorded[k], (recorded - before)[k], (recorded - after)[k], sigma, unit
    )


def _smoothed(t_imu: Array, x: Array, t: Array) -> Array:
    width = max(1, round(SLOT_S / float(np.median(np.diff(t_imu)))))
    total = np.cumsum(np.r_[np.full(width // 2 + 1, x[0]), x, np.full(width - width // 2, x[-1])])
    mean = (total[width:] - total[:-width])[: len(x)] / width
    return np.asarray(np.interp(t, t_imu, mean))


def residual_rms(f: Fitted) -> dict[str, float]:
    """Root mean square of each channel's residual, in sensor units."""
    return {
        channel: float(np.sqrt(np.mean(x**2)))
        for channel, (_, x) in sensor_residuals(f.linear, SLOT_S).items()
        if len(x)
    }


def at_levels(f: Fitted, levels: Mapping[str, float]) -> Fitted:
    """The same fit with the noise levels of another, as far as it has them."""
    return replace(f, levels={k: levels.get(k, v) for k, v in f.levels.items()})

"""A recording for a filter that starts again behind a gap.

Nothing is known of what happened in a gap: where it was long, what the filter would integrate over
it (a bias times a thousand seconds) is worth nothing and spoils its numbers. So a long gap is
replaced by a short bridge, whose samples count as missing: in it the device is turned as gravity
before and after shows, and the filter's doubt about attitude, velocity and place grows as over
readings that are no measurements.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.recordings.segment import gaps
from handcal.types import Array, Imu, Recording, Series

# A bridge takes so long, s: in it the doubt about the attitude grows to half a radian, which a
# linearised filter can still take back. Up before and after it is the mean over this long, s.
BRIDGE_S, SIDE_S = 0.2, 0.1


def bridged(recording: Recording) -> Recording:
    """The same with each gap longer than a bridge replaced by one; times behind it are earlier, and
    readings of other streams within it are left out. The recording itself without such gaps."""
    imu = recording.imu
    at = gaps(imu.t)
    if not len(at):
        return recording
    cut = np.diff(imu.t)[at] - BRIDGE_S
    t = imu.t - np.r_[0.0, np.cumsum(cut)][np.searchsorted(at, np.arange(len(imu.t)))]
    made = [_bridge(imu, int(k), float(t[k]), recording.rate_hz) for k in at]
    order = np.argsort(np.concatenate([t, *(b.t for b in made)]), kind="stable")
    parts = [replace(imu, t=t), *made]
    whole = Imu(*(np.concatenate([getattr(p, name) for p in parts])[order]
                  for name in ("t", "gyro", "accel", "valid")))  # fmt: skip
    streams = {n: _shifted(s, imu.t[at], imu.t[at + 1], cut) for n, s in recording.streams.items()}
    longest = int(np.argmax(cut))
    said = (
        f"The filter starts again behind {'a gap' if len(at) == 1 else f'each of {len(at)} gaps'} "
        f"(the longest of {cut[longest] + BRIDGE_S:.3g} s at {imu.t[at[longest]]:.1f} s); times "
        f"behind are earlier by what was cut out, {float(cut.sum()):.4g} s in all."
    )
    streams = {n: s for n, s in streams.items() if len(s.t)}
    return replace(recording, imu=whole, streams=streams, warnings=(*recording.warnings, said))


def _bridge(imu: Imu, k: int, start: float, rate_hz: float) -> Imu:
    """Samples between the k-th and the next, no measurements."""
    side = max(1, round(SIDE_S * rate_hz))
    force = imu.accel[max(0, k + 1 - side) : k + 1].mean(axis=0)
    last = imu.accel[k + 1 : k + 1 + side].mean(axis=0)
    u, v = (x / max(float(np.linalg.norm(x)), 1e-9) for x in (force, last))
    across = np.cross(v, u)
    angle = float(np.arctan2(np.linalg.norm(across), u @ v))
    if np.linalg.norm(across) < 1e-6:  # (upside down, or the same: about any level axis)
        across = np.cross(u, np.eye(3)[int(np.argmin(np.abs(u)))])
    across /= np.linalg.norm(across)
    n = max(2, round(BRIDGE_S * rate_hz))
    share = np.arange(1, n) / n
    a = angle * share[:, None]
    up = u * np.cos(a) - np.cross(across, u) * np.sin(a)
    size = float(np.linalg.norm(force))
    rate = np.tile(across * angle / BRIDGE_S, (n - 1, 1))
    return Imu(start + BRIDGE_S * share, rate, size * up, np.zeros(n - 1, dtype=np.bool_))


def _shifted(series: Series, begin: Array, end: Array, cut: Array) -> Series:
    """A stream without what lies in the gaps, what is behind them earlier."""
    behind = np.searchsorted(end, series.t, side="right")
    inside = np.searchsorted(begin, series.t, side="left") > behind
    t = series.t - np.r_[0.0, np.cumsum(cut)][behind]
    return Series(t[~inside], series.value[~inside])

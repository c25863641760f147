"""Stamps that are late or of a fast clock (no effect of its own: delays and a clock need it)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.recordings.streams import STREAMS
from handcal.types import Array, BoolArray, Imu, InputError, Recording, Series


def shifted(series: Series, delay: float, imu: Imu) -> Series:
    """The same values at stamps that come later: nothing needs interpolation."""
    t = series.t + delay
    kept = (t >= imu.t[0]) & (t <= imu.t[-1])
    if not kept.any():
        raise InputError(f"A delay of {delay:g} s leaves no reading within the recording.")
    return Series(t[kept], series.value[kept])


def stretched(recording: Recording, fast: float) -> Recording:
    """Stamps of a clock that runs fast; some streams have clocks of their own."""
    streams = {
        name: series if STREAMS[name].own_clock else replace(series, t=series.t * fast)
        for name, series in recording.streams.items()
    }
    imu = recording.imu
    return replace(recording, imu=replace(imu, t=imu.t * fast), streams=streams)


def measured(t: Array, valid: BoolArray, wanted: Array) -> BoolArray:
    """Which of the times wanted (m,) lie between readings at t (n,) that are measurements."""
    return np.asarray(np.interp(wanted, t, valid.astype(float)) > 1.0 - 1e-9)

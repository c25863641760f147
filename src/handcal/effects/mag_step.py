"""Magnetometer step: the device's iron changes at one moment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.effects import TIME, Effect, Known, Param
from handcal.effects._moments import moments
from handcal.types import Array, Recording


def _magnetometer(nav: Any, p: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    if z[TIME] >= p[3]:
        for i in range(3):
            r[i] -= p[i]
    return 0


def _stepped(recording: Recording, p: Array, sign: float) -> Recording:
    """x y z (tesla) added to the readings from ``at`` (s after the first sample) on; p (4,)."""
    mag = recording.streams["mag"]
    after = mag.t - recording.imu.t[0] >= p[3]
    value = mag.value + sign * np.where(after[:, None], p[:3], 0.0)
    return replace(recording, streams={**recording.streams, "mag": replace(mag, value=value)})


def _conceal(p: Array, recording: Recording, known: Known) -> Recording:  # noqa: ARG001
    return _stepped(recording, p, 1.0)


def _undo(p: Array, recording: Recording) -> Recording:
    return _stepped(recording, p, -1.0)


EFFECT = Effect(
    id="mag_step",
    title="Magnetometer step",
    parameters=(*(Param(axis, "tesla", 2e-5) for axis in "xyz"), Param("at", "s", 30.0)),
    story="The device's iron changes at one moment: the phone calibrates its magnetometer anew "
    "while it records, or something magnetic is put to it or taken off.",
    source="Android's SENSOR_STATUS_ACCURACY: a magnetometer is calibrated whenever its readings "
    "allow; hard iron as in the contract of this project",
    motion="Full turns about two axes before the moment and after it.",
    validated="the simulator's injection",
    observation_error={"magnetometer": residual_function(_magnetometer)},
    moments=moments(4),
    conceal=_conceal,
    undo=_undo,
    of_one_day=True,
)

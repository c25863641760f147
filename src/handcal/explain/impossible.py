"""Residuals that no hand makes: the final fit explains nothing, whatever it names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handcal.estimate.model import Model
from handcal.explain import locate
from handcal.types import Parameter, Recording

# A held point that strays so far, m; what rests that moves so fast, m/s; and a force at rest that
# differs so much from gravity, of it: root mean squares over the final fit's residuals.
STRAYS, MOVES, OFF = 1.0, 0.5, 0.5
CHECK = (
    "nothing that was fitted is to be believed. Check full scales, sample rate, units and axes "
    "(handcal info says what gravity shows of them), and whether the device did what was assumed "
    "of the hand (--assume rest-only where no point was held)."
)


def impossible(model: Model, parameters: Sequence[Parameter], gravity: float) -> tuple[str, ...]:
    """A sentence for each residual that no hand makes. gravity: m/s^2."""
    out = []
    for f in model.parts:
        rms = locate.residual_rms(f)
        far, fast = _size(rms, "position"), _size(rms, "velocity")
        if far > STRAYS:
            out.append(f"In the final fit the held point strays by {far:.2g} m: {CHECK}")
        if fast > MOVES:
            out.append(f"In the final fit what rests moves at {fast:.2g} m/s: {CHECK}")
        off = _force_off(f.case.recording, f.case.rests, parameters, gravity)
        if off > OFF * gravity:
            out.append(f"At rest the corrected specific force is off by {off:.2g} m/s^2: {CHECK}")
    return tuple(dict.fromkeys(out))


def _size(rms: Mapping[str, float], kind: str) -> float:
    """Root of the sum of squares over a kind's channels."""
    return float(np.sqrt(sum(v**2 for k, v in rms.items() if k.startswith(kind))))


def _force_off(
    recording: Recording, rests: np.ndarray, parameters: Sequence[Parameter], gravity: float
) -> float:
    """How far the size of the specific force at rest, less bias and scale, is off, m/s^2; the
    median over rests (r, 2)."""
    known = {(p.effect, p.name): p.value for p in parameters}
    bias, scale = (np.array([known.get((effect, a), 0.0) for a in "xyz"])
                   for effect in ("accel_bias", "accel_scale"))  # fmt: skip
    imu = recording.imu
    means = [imu.accel[slice(*np.searchsorted(imu.t, rest))].mean(axis=0) for rest in rests]
    off = [abs(float(np.linalg.norm((f - bias) / (1.0 + scale))) - gravity) for f in means]
    return float(np.median(off)) if off else 0.0

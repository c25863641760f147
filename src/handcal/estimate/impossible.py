"""What no hand does and no device has: a fit that says so is not to be believed."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.effects import catalogue
from handcal.types import Array, Parameter, Recording, Result

# A held point that strays so far, m; what rests that moves so fast, m/s; and a force at rest that
# differs so much from gravity, of it: root mean squares.
STRAYS, MOVES, OFF = 1.0, 0.5, 0.5
# Usual sizes of a sensor's error beyond which a device is a strange one: priors' tails end there.
FAR = 25.0
CHECK = (
    "do not use this fit. Check full scales, sample rate, units and axes (handcal info compares "
    "them with gravity), and the assumption about the hand (--assume rest-only if no point was "
    "held)."
)


def sentences(far: float, fast: float, off: float) -> tuple[str, ...]:
    """One for each that no hand does. far: m; fast: m/s; off: m/s^2."""
    out = []
    if far > STRAYS:
        out.append(f"In the final fit the held point strays by {far:.2g} m: {CHECK}")
    if fast > MOVES:
        out.append(f"In the final fit the device moves at {fast:.2g} m/s during rests: {CHECK}")
    if off > OFF * STANDARD_GRAVITY:
        out.append(f"At rest the corrected specific force is off by {off:.2g} m/s^2: {CHECK}")
    return tuple(out)


def of_result(result: Result) -> tuple[str, ...]:
    """The sentences about a calibration."""
    track = result.smoothed or result.history
    resting = np.zeros(len(track.t), dtype=np.bool_)
    for start, end in result.rests:
        resting |= (track.t >= start) & (track.t <= end)
    held = result.assume == "fixed-point" and "fixed_position" in result.innovations
    far = _size(track.p_n - track.p_n.mean(axis=0)) if held else 0.0
    fast = _size(track.v_n[resting]) if "zero_velocity" in result.innovations else 0.0
    off = force_off(result.recording, result.rests, result.parameters, STANDARD_GRAVITY)
    return sentences(far, fast, off)


def _size(rows: Array) -> float:
    """Root mean square length of rows (k, 3)."""
    return float(np.sqrt((rows**2).sum(axis=1).mean())) if len(rows) else 0.0


def force_off(
    recording: Recording, rests: Array, parameters: Sequence[Parameter], gravity: float
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


def strange(ids: Collection[str]) -> str | None:
    """A sentence about effects of the catalogue that came out larger than any device has them;
    None of none."""
    if not (known := sorted({*ids} & {*catalogue()})):
        return None
    return (
        "Larger than in any real device: "
        f"{', '.join(catalogue()[i].title.lower() for i in known)}. Another error, without a "
        "name, is the probable cause: use these numbers only as a sign of that."
    )


def too_large(parameters: Sequence[Parameter]) -> set[str]:
    """Effects of which a parameter that is shown is larger than any device has it."""
    return {p.effect for p in parameters if p.shown and abs(p.value) > _most(p.effect, p.name)}


def _most(effect: str, name: str) -> float:
    known = catalogue().get(effect)
    own = next((q for q in known.parameters if q.name == name), None) if known else None
    if known is None or own is None:
        return math.inf
    return min(own.most, FAR * own.prior_sigma if known.misreads else math.inf)

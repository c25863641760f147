"""Steady spins about the vertical, and the rests beside them, as tests of known rate and force.

The gyro says about which axis of the device a table turns, and how fast; that axis is up. A
table that leans carries gravity around in the device: what goes round with the turn is fitted
and says by how much, and the mean of a spin is right all the same. A rest on such a table
stands in an attitude that is not quite known, so it is left out where other rates do instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from handcal.earth import STANDARD_GRAVITY
from handcal.lab.steady_tests import Bench, of_arrays
from handcal.lab.stretches import PERFECT, noise_power
from handcal.recordings import segment
from handcal.types import Array, BoolArray, HandcalError, Recording

SPINNING = np.radians(20.0)
RESTING = np.radians(4.0)
TILTED = np.radians(8.0)
LEAST_FORCE = 0.9
# Rates that differ by this factor tell arms from biases without a rest.
APART = 1.3
# No reading of a cheap accelerometer stays better than this from a rest to a spin, m/s^2.
LEAST_SIGMA = 1e-4 * STANDARD_GRAVITY


@dataclass(frozen=True)
class Steady:
    """n steady stretches: omega (n, 3) rad/s, zero in rests, mean accelerometer (n, 3) m/s^2,
    its variance (n, 3), lean (n,) of the spins' axes, rad, spinning (n,)."""

    omega: Array
    accel: Array
    variance: Array
    lean: Array
    spinning: BoolArray


def steady(recording: Recording, gravity: float) -> Steady:
    """The steady stretches of a recording. Errors: HandcalError where nothing spins or rests."""
    imu = recording.imu
    ends = [np.searchsorted(imu.t, span) for span in segment.steady(recording)]
    rows = [np.flatnonzero(imu.valid[a:b]) + a for a, b in ends]
    gyro = np.array([imu.gyro[r].mean(axis=0) for r in rows]).reshape(-1, 3)
    rate = np.linalg.norm(gyro, axis=1)
    resting, spinning = rate < RESTING, rate > SPINNING
    if not spinning.any():
        raise HandcalError(
            "No steady spin was found (faster than 20 deg/s, for a second at least). Turn the "
            "device on a rate table about the vertical, or record a reference beside it."
        )
    if not resting.any():
        raise HandcalError("The table never stops: let the device rest before each spin.")
    gyro = gyro - gyro[resting].mean(axis=0)
    rate = np.where(spinning, np.linalg.norm(gyro, axis=1), 0.0)
    parts = [_mean(imu.t[r], imu.accel[r], w) for r, w in zip(rows, rate, strict=True)]
    power, count = noise_power([left for _, _, left in parts])
    keep = resting | spinning
    return Steady(
        np.where(spinning[:, None], gyro, 0.0)[keep],
        np.array([mean for mean, _, _ in parts])[keep],
        (power / count[:, None] + PERFECT**2)[keep],
        np.array([round_ / gravity for _, round_, _ in parts])[keep],
        spinning[keep],
    )


def _mean(t: Array, accel: Array, rate: float) -> tuple[Array, float, Array]:
    """Mean (3,) of readings (n, 3), how much goes round with a turn at this rate, what is left."""
    angle = rate * (t - t[0])
    basis = [np.ones(len(t))]
    if angle[-1] > 2.0 * np.pi:
        basis += [np.cos(angle), np.sin(angle)]
    B = np.stack(basis, axis=1)
    x = np.linalg.lstsq(B, accel, rcond=None)[0]
    return x[0], float(np.sqrt(0.5 * (x[1:] ** 2).sum())), accel - B @ x


def of_spins(recording: Recording, gravity: float) -> Bench:
    """Tests of a recording of spins. Errors: HandcalError where none is about the vertical."""
    found = steady(recording, gravity)
    spinning = found.spinning
    up, use = _up(found, gravity)
    if not (use & spinning).any():
        raise HandcalError(
            "The axes of the spins are not upright: gravity has to stay where it is in the device."
        )
    warnings = []
    if not use.all():
        warnings.append(
            f"{(~use).sum()} of {len(use)} steady stretches were left out: spins about an axis "
            "that is not upright, and rests in attitudes in which nothing spins."
        )
    lean = float(np.median(found.lean[use & spinning]))
    if lean * gravity > 3.0 * LEAST_SIGMA:
        said = f"The axis of the table leans by {np.degrees(lean):.2g} deg"
        rates = np.linalg.norm(found.omega[use & spinning], axis=1)
        if rates.max() > APART * rates.min():
            use = use & spinning
            warnings.append(f"{said}, which rests would feel: the spins alone are used.")
        else:
            warnings.append(
                f"{said}, which the rests feel by up to {1000.0 * lean:.2g} mg and the spins "
                "do not: level it, or spin at two rates in each attitude."
            )
    force = gravity * np.cos(found.lean)[:, None] * up
    tests = of_arrays(found.omega[use], force[use], None, found.accel[use])
    variance = np.hstack([np.ones_like(up[use]), found.variance[use]])
    return replace(tests, variance=variance, warnings=tuple(warnings))


def _up(found: Steady, gravity: float) -> tuple[Array, BoolArray]:
    """Up (n, 3) in body axes, and which stretches have one.

    Of a spin it is the axis of the turn; a rest has that of the spin in its attitude.
    """
    omega, spinning = found.omega, found.spinning
    size = np.linalg.norm(found.accel, axis=1)
    felt = found.accel / size[:, None]
    axis = np.zeros_like(omega)
    axis[spinning] = omega[spinning] / np.linalg.norm(omega[spinning], axis=1, keepdims=True)
    axis *= np.sign(np.einsum("ni,ni->n", axis, felt))[:, None]
    along = np.einsum("ni,ni->n", axis, felt) > np.cos(TILTED)
    # a spin about an axis that leans far feels less on the average
    use = spinning & along & (size > LEAST_FORCE * gravity)
    up = axis.copy()
    spins = np.flatnonzero(use)
    for i in np.flatnonzero(~spinning):
        if len(spins):
            near = spins[np.argmax(axis[spins] @ felt[i])]
            up[i], use[i] = axis[near], bool(axis[near] @ felt[i] > np.cos(TILTED))
    return up, use

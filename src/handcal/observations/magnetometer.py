"""The magnetic field as a magnetometer reads it: three numbers, tesla.

Predicted is the field where the device is, in its axes: C_nb' (0, h, u), for north (+y of n) is
where the field's horizontal part points. How strong that is (h) and how strong the upward part
(u), are not known beforehand: ``theta`` holds by how much they differ from a first guess.

Rooms bend the field, motors and currents change it, and no sensor is free of errors without
a name. All that lasts as long as the device does and changes as it turns: were it taken for
white noise, a hundred readings would seem to know the attitude ten times better than one. So the
noise from one reading to the next is what neighbours show, and the rest is a Markov state of each
axis, whose clock is the angle turned. (At rest hardly anything changes: for a phone in a hand
beside iron, evidence prefers that to a memory of ten seconds by 90 nats, and finds the delay only
then.) These are the sensor's axes: of what the room adds and of what the device adds, the one is
forgotten before it can be told from the other, and in the sensor's axes it says nothing of the
attitude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled.jit import residual_function
from handcal.effects import mag_hard_iron
from handcal.effects._field import NORTH, UP
from handcal.observations import Constant, Observation, Rows, Scene
from handcal.observations._turning import Turning
from handcal.types import Array, Level, Recording, Series

MAX_RATE = 10.0
# By how much the field's strengths may differ from the first guess, tesla.
STRENGTH_SIGMA = 1.5e-5
# The Earth's field is that strong, tesla: a sphere that is larger or smaller is not its.
EARTHLY = (2.2e-5, 6.7e-5)
# Places in z of the first guess of the field's strengths, and of the noise, tesla.
HORIZONTAL, UPWARD, NOISE = 3, 4, 5
# White noise that readings can show: less is their rounding, more is motion.
LEAST_NOISE, MOST_NOISE = 1e-7, 3e-6
# So late (s) or early may readings be and still lie within the recording: evidence must be of the
# same readings whatever a delay is taken to be.
LATEST = 0.5


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:
    north, up = z[3] + theta[0], z[4] + theta[1]
    for i in range(3):
        r[i] = z[i] - (nav[9 + i] * north + nav[12 + i] * up)
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:
    # C' (m x psi): an attitude error turns the field as it is predicted.
    north, up = z[3] + theta[0], z[4] + theta[1]
    for i in range(3):
        east_i, north_i, up_i = nav[6 + i], nav[9 + i], nav[12 + i]
        H[15 * i + 6] = north_i * up - up_i * north
        H[15 * i + 7] = -east_i * up
        H[15 * i + 8] = east_i * north
    return 0


def _bent(nav: Any, bend: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(3):
        r[i] -= bend[i]
    return 0


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    series = recording.streams.get("mag")
    if series is None or len(series.t) < 2:
        return None
    # Neighbouring readings share their disturbance; more of them would only feign certainty.
    thin = series.thinned(MAX_RATE)
    t, field = thin.t, thin.value
    begin, end = recording.imu.t[0] + LATEST, recording.imu.t[-1] - LATEST
    inside = (t >= begin) & (t <= end)
    if inside.any():
        t, field = t[inside], field[inside]
    guess = strengths(recording, scene.iron)
    known = (*guess, _white(series.value), *guess)
    return Rows(t, np.hstack([field, np.tile(known, (len(t), 1))]))


def _believed(z: Array, theta: Array) -> Array:
    out = z.copy()
    out[:, [NORTH, UP]] = z[:, [HORIZONTAL, UPWARD]] + theta
    return out


def strengths(recording: Recording, iron: Array | None = None) -> tuple[float, float]:
    """First guess of the field's horizontal and upward strength, tesla: medians, less the iron
    (None: what the readings lie around), taking the force as up; such as the Earth may have."""
    imu, mag = recording.imu, recording.streams["mag"]
    field = mag.value - (mag_hard_iron.guess(recording) if iron is None else iron)
    up = np.stack([np.interp(mag.t, imu.t, imu.accel[:, i]) for i in range(3)], axis=1)
    size = np.linalg.norm(field, axis=1)
    product = np.maximum(np.linalg.norm(up, axis=1) * size, 1e-12)
    sine = float(np.median((up * field).sum(axis=1) / product))
    strength = float(np.clip(np.median(size), *EARTHLY))
    return strength * math.sqrt(max(1.0 - sine * sine, 0.01)), strength * sine


def heading_off(C_nb: Array, residual: Array, north: Array) -> Array:
    """By how much a heading taken from readings (k, 3) would be larger than that of attitudes
    C_nb (k, 3, 3), rad; residual (k, 3), and horizontal strength of the field (k,), tesla."""
    off = np.einsum("kij,kj->ki", C_nb, residual)
    return np.asarray(np.arctan2(off[:, 0], north + off[:, 1]))


def _white(field: Array) -> float:
    """White noise of one axis, tesla, from readings (k, 3) of which some may be repeated: fourth
    differences hardly see the motion of a hand, and the quieter third of windows least."""
    fresh = np.r_[True, np.diff(field, axis=0).any(axis=1)]
    d4 = np.diff(field[fresh], n=4, axis=0)
    width = 20
    m = len(d4) // width
    if m == 0:
        return MOST_NOISE
    windows = (d4[: m * width].reshape(m, width, 3) ** 2).mean(axis=(1, 2))
    return float(np.clip(math.sqrt(np.quantile(windows, 0.3) / 70.0), LEAST_NOISE, MOST_NOISE))


def _variance(levels: Mapping[str, float]) -> Array:
    return np.full(3, levels["mag_noise"] ** 2)


def _guess(z: Array) -> Mapping[str, float]:
    return {"mag_noise": float(z[0, NOISE])} if len(z) and z[0, NOISE] > 0.0 else {}


def _constants(scene: Scene) -> tuple[Constant, ...]:  # noqa: ARG001
    return (
        Constant("horizontal", "tesla", STRENGTH_SIGMA),
        Constant("upward", "tesla", STRENGTH_SIGMA),
    )


def _moved(recording: Recording, series: Series, C_nb: Array, shift: Array) -> Series:  # noqa: ARG001
    return Series(series.t, series.value + shift)


OBSERVATION = Observation(
    kind="magnetometer",
    title="magnetic field",
    dim=3,
    channels=("mag_x", "mag_y", "mag_z"),
    unit="tesla",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(
        Level("mag_noise", "tesla", 5e-7, 2e-8, 1e-5, above=0.3, most=1.5),
        Level("mag_disturbance", "tesla", 1.5e-6, 5e-8, 3e-5, above=0.7),
    ),
    variance=_variance,
    constants=_constants,
    guess=_guess,
    believed=_believed,
    markov=Turning(*("mag_disturbance",) * 3),
    markov_residual=residual_function(_bent),
    moved=_moved,
)

"""A second simulator, that shares nothing with the first: attitudes along minimum-jerk arcs on a
grid of 2 kHz, a hand whose sway has one of three spectra, readings by finite differences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import butter, lfilter, sosfilt, sosfiltfilt
from scipy.spatial.transform import Rotation

from handcal.compiled import so3
from handcal.types import Imu, Recording, Series

FINE = 2000.0
RATE = 100.0
G = 9.80665
# Each effect's prior, and how many parameters it has.
SIZES = {
    "gyro_scale": (3, 0.01), "accel_scale": (3, 0.01), "gyro_misalignment": (6, 0.01),
    "accel_misalignment": (3, 0.01), "lever_arm": (3, 0.1), "gyro_bandwidth": (1, 0.02),
    "gyro_g_sensitivity": (9, 1.8e-4), "accel_asymmetry": (3, 0.01), "gyro_quadratic": (3, 0.005),
}  # fmt: skip


def drawn(seed: int, count: int) -> dict[str, np.ndarray]:
    """So many effects, each parameter 0.5 to 1.5 times its prior."""
    rng = np.random.default_rng([seed, 7])
    out = {}
    for i in rng.permutation(len(SIZES))[:count]:
        name, (n, size) = list(SIZES.items())[i]
        sign = 1.0 if name == "gyro_bandwidth" else rng.choice([-1.0, 1.0], n)
        out[name] = sign * size * rng.uniform(0.5, 1.5, n)
    return out


def recorded(seed: int, effects: Mapping[str, np.ndarray], seconds: float = 84.0) -> Recording:
    """What a phone of this world records, a heading with it."""
    rng = np.random.default_rng([seed, 99])
    t = np.arange(0.0, seconds, 1.0 / FINE)
    C, omega = _turned(rng, t)
    p = _swayed(rng, t, omega, seed % 3)
    a = np.gradient(np.gradient(p, 1 / FINE, axis=0), 1 / FINE, axis=0)
    f = np.einsum("nji,nj->ni", C, a + np.array([0.0, 0.0, G]))
    arm = effects.get("lever_arm", np.zeros(3))
    alpha = np.gradient(omega, 1 / FINE, axis=0)
    f = f + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
    if "gyro_bandwidth" in effects:
        c = 2.0 * FINE * effects["gyro_bandwidth"][0]
        omega = lfilter([1.0, 1.0], [1.0 + c, 1.0 - c], omega, axis=0)
    stamps = np.arange(0.05, seconds - 0.2, 1.0 / RATE)
    w, f = _sampled(omega, t, stamps), _sampled(f, t, stamps)
    gyro, accel = w + _gyro_error(effects, w, f), f + _accel_error(effects, f)
    gyro = gyro + rng.normal(0, 0.5, 3) * np.pi / 180
    accel = accel + rng.uniform(-0.4, 0.4, 3)
    gyro += rng.normal(0, rng.uniform(0.003, 0.01) * np.pi / 180 * np.sqrt(RATE), gyro.shape)
    accel += rng.normal(0, rng.uniform(80, 250) * 1e-6 * G * np.sqrt(RATE), accel.shape)
    at = np.arange(0.1, seconds - 0.2, 1.0 / rng.choice([5.0, 10.0, 20.0]))
    C_at = C[np.searchsorted(t, at)]
    yaw = np.arctan2(C_at[:, 1, 0], C_at[:, 0, 0])
    yaw = so3.wrap(yaw + rng.normal(0, np.radians(rng.uniform(3, 10)), len(at)))
    imu = Imu(stamps, gyro, accel, np.ones(len(stamps), dtype=bool))
    return Recording("another world", imu, {"heading": Series(at, yaw[:, None])})


def _turned(rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """C_nb (n, 3, 3) and rate (n, 3): a rest, arcs about random axes with rests between, a rest."""
    times, keys = [0.0, 3.0], [Rotation.identity()] * 2
    while True:
        axis = rng.normal(size=3)
        arc = rng.uniform(0.6, 2.4) * axis / np.linalg.norm(axis)
        end = times[-1] + np.linalg.norm(arc) / rng.uniform(0.8, 2.5)
        if end > t[-1] - 4.0:
            break
        times.append(end)
        keys.append(keys[-1] * Rotation.from_rotvec(arc))
        if rng.random() < 0.3:
            times.append(end + rng.uniform(0.5, 2.0))
            keys.append(keys[-1])
    times.append(t[-1] + 1.0)
    keys.append(keys[-1])
    C, omega = np.empty((len(t), 3, 3)), np.zeros((len(t), 3))
    for i in range(len(times) - 1):
        here = (t >= times[i]) & (t < times[i + 1])
        s, length = (t[here] - times[i]) / (times[i + 1] - times[i]), times[i + 1] - times[i]
        arc = (keys[i].inv() * keys[i + 1]).as_rotvec()
        done = 10 * s**3 - 15 * s**4 + 6 * s**5
        C[here] = (keys[i] * Rotation.from_rotvec(done[:, None] * arc)).as_matrix()
        omega[here] = ((30 * s**2 - 60 * s**3 + 30 * s**4) / length)[:, None] * arc
    return C, omega


def _swayed(rng: np.random.Generator, t: np.ndarray, omega: np.ndarray, kind: int) -> np.ndarray:
    """Where the held point wanders (n, 3), m: more while turning, and trembling."""
    n, size, margin = len(t), rng.uniform(0.003, 0.02), 30_000
    white = rng.normal(size=(n + 2 * margin, 3))
    if kind == 0:
        x = sosfiltfilt(_low(2, rng.uniform(0.15, 0.8)), white, axis=0)[margin : margin + n]
    elif kind == 1:
        x = np.zeros((n, 3))
        for f in rng.uniform(0.05, 1.5, 6):
            wave = np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
            x += rng.normal(size=3) / (1 + (f / 0.4) ** 2) * wave[:, None]
    else:
        x = sosfilt(_low(1, rng.uniform(0.3, 1.0)), white, axis=0)
        x = sosfilt(_low(2, 3.0), x, axis=0)[margin : margin + n]
    busy = 1.0 + sosfiltfilt(_low(2, 0.5), np.linalg.norm(omega, axis=1))
    band = butter(2, [7.0, 12.0], btype="band", fs=FINE, output="sos")
    tremor = sosfiltfilt(band, rng.normal(size=(n, 3)), axis=0)
    x *= size / x.std() * (busy / busy.mean())[:, None]
    return x + tremor / tremor.std() * rng.uniform(2e-5, 2e-4)


def _low(order: int, hz: float) -> np.ndarray:
    return butter(order, hz, fs=FINE, output="sos")


def _sampled(x: np.ndarray, t: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Means over half an interval about the stamps, (m, 3)."""
    box = np.ones(11) / 11
    mean = [np.convolve(x[:, i], box, "same") for i in range(3)]
    return np.stack([np.interp(stamps, t, m) for m in mean], axis=1)


def _gyro_error(effects: Mapping[str, np.ndarray], w: np.ndarray, f: np.ndarray) -> np.ndarray:
    out = w * effects.get("gyro_scale", 0.0) + w**2 * effects.get("gyro_quadratic", 0.0)
    xy, xz, yx, yz, zx, zy = effects.get("gyro_misalignment", np.zeros(6))
    out = out + w @ np.array([[0, xy, xz], [yx, 0, yz], [zx, zy, 0]]).T
    return out + f @ effects.get("gyro_g_sensitivity", np.zeros(9)).reshape(3, 3).T


def _accel_error(effects: Mapping[str, np.ndarray], f: np.ndarray) -> np.ndarray:
    out = f * effects.get("accel_scale", 0.0) + np.abs(f) * effects.get("accel_asymmetry", 0.0)
    yx, zx, zy = effects.get("accel_misalignment", np.zeros(3))
    return out + f @ np.array([[0, 0, 0], [yx, 0, 0], [zx, zy, 0]]).T

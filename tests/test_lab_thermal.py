"""Bias and scale against temperature: soak, ramp, turns on a table, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from typer.testing import CliRunner

import handcal
from handcal.commands._app import app
from handcal.compiled import so3
from handcal.lab.thermal.basis import Basis, candidates
from handcal.lab.thermal.curves import Curve, Thermal, thermal
from handcal.lab.thermal.fit import Rows, best_extra, fitted, log_evidence
from handcal.recordings.export import write_mcap
from handcal.types import Array, HandcalError, Imu, InputError, Recording, Series

G = 9.80665
HZ = 20.0
Shape = Callable[[Array], Array]


def parabola(T: Array) -> Array:
    """x, y, z (n, 3): straight, bent, flat."""
    u = (T - 25.0) / 10.0
    return np.stack([1.0 + 0.3 * u, -2.0 + 0.2 * u**2, 0.5 + 0.0 * u], axis=1)


def hump(T: Array) -> Array:
    """What no polynomial of a low degree follows."""
    u = 1.0 / (1.0 + np.exp(-(T - 28.0) / 1.5))
    return np.stack([u, -0.5 * u, 0.2 * u], axis=1)


class Device:
    """An IMU whose errors follow the temperature, by formulas of its own."""

    def __init__(self, gyro: Shape = parabola, accel: Shape = parabola) -> None:
        self.gyro_shape, self.accel_shape = gyro, accel
        self.misaligned = np.array([[0.0, 0, 0], [0.003, 0, 0], [-0.002, 0.004, 0]])

    def gyro_bias(self, T: Array) -> Array:
        return 1e-3 * self.gyro_shape(T)

    def accel_bias(self, T: Array) -> Array:
        return 0.05 * self.accel_shape(T)

    def scale(self, T: Array) -> Array:
        return np.stack([0.004 + 3e-5 * (T - 25.0), -0.002 - 2e-5 * (T - 25.0),
                         0.001 + 1e-5 * (T - 25.0)], axis=1)  # fmt: skip

    def read(self, T: Array, omega: Array, f: Array) -> tuple[Array, Array]:
        gyro = omega + self.scale(T) * omega + self.gyro_bias(T)
        return gyro, f + self.scale(T) * f + f @ self.misaligned.T + self.accel_bias(T)

    def truth(self, c: Curve, T: Array) -> Array:
        curve = {"gyro_bias": self.gyro_bias, "accel_bias": self.accel_bias}.get(
            c.effect, self.scale
        )
        return curve(T)[:, "xyz".index(c.name)]


def sides(n: int) -> Array:
    """Directions (n, 3) all round, always the same."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, math.pi * (1.0 + math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def recorded(
    device: Device,
    ups: Array,
    T: Array,
    noise: tuple[float, float] = (0.0, 0.0),
    rest: float = 3.0,
    seed: int = 0,
) -> Recording:
    """A rest with each of ups (n, 3) upward at temperatures T (n,), (n, 2) from and to; a quick
    move between them."""
    rng = np.random.default_rng(seed)
    span = np.reshape(np.repeat(T, 2) if np.ndim(T) == 1 else T, (-1, 2))
    still, moving = int(rest * HZ), int(1.5 * HZ)
    warm, omega, f = [], [], []
    for (a, b), up in zip(span, ups, strict=True):
        warm += [np.linspace(a, b, still), np.full(moving, b)]
        swing = np.sin(np.linspace(0.0, math.pi, moving))[:, None]
        omega += [np.zeros((still, 3)), swing * [1.0, 0.7, -0.5]]
        f += [np.tile(G * up, (still, 1)), G * (up + swing * [0.3, -0.2, 0.1])]
    degC = np.concatenate(warm)
    gyro, accel = device.read(degC, np.vstack(omega), np.vstack(f))
    gyro = gyro + noise[0] * rng.standard_normal(gyro.shape)
    accel = accel + noise[1] * rng.standard_normal(accel.shape)
    t = np.arange(len(degC)) / HZ
    imu = Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))
    return Recording("rests", imu, {"temperature": Series(t[::5], degC[::5, None])})


def soak(device: Device, **more: object) -> Recording:
    """Twelve sides at each of eight temperatures."""
    T = np.repeat(np.linspace(10.0, 45.0, 8), 12)
    return recorded(device, np.tile(sides(12), (8, 1)), T, **more)  # type: ignore[arg-type]


def worst(result: Thermal, device: Device, effect: str) -> float:
    T = np.linspace(*result.span, 50)
    return max(float(np.abs(c.at(T)[0] - device.truth(c, T)).max())
               for c in result.curves if c.effect == effect)  # fmt: skip


def curve_of(result: Thermal, effect: str) -> Curve:
    return next(c for c in result.curves if c.effect == effect)


# --- curves -------------------------------------------------------------------------------------


def test_a_soak_without_noise_gives_everything_back() -> None:
    device = Device()
    found = thermal([soak(device)])
    assert worst(found, device, "gyro_bias") < 1e-15
    assert worst(found, device, "accel_bias") < 1e-12
    assert worst(found, device, "accel_scale") < 1e-13
    assert curve_of(found, "gyro_bias").basis.title == "parabola"
    assert curve_of(found, "accel_bias").basis.title == "parabola"
    assert curve_of(found, "accel_scale").basis.title == "straight line"
    assert found.warnings == ()


def test_a_soak_with_noise_is_as_good_as_its_sigmas() -> None:
    device = Device()
    found = thermal([soak(device, noise=(2e-4, 0.01))])
    assert curve_of(found, "gyro_bias").basis.title == "parabola"
    assert curve_of(found, "accel_bias").basis.title == "parabola"
    assert curve_of(found, "gyro_bias").gain > 20.0
    z = []
    for c in found.curves:
        for T in (12.0, 27.0, 43.0):
            value, sigma = c.at(np.array([T]))
            z.append(float((value - device.truth(c, np.array([T])))[0] / sigma[0]))
    # 27 numbers, hardly correlated: sum of squares within 0.0005 and 0.9995 of chi-squared
    assert 9.0 < float(np.sum(np.square(z))) < 57.9


def test_one_long_ramp_tells_the_gyro_and_how_the_accelerometer_changes() -> None:
    device = Device()
    up = np.array([[0.1, 0.2, math.sqrt(0.95)]])
    found = thermal([recorded(device, up, np.array([[15.0, 45.0]]), (2e-4, 0.002), rest=900.0)])
    assert worst(found, device, "gyro_bias") < 5e-5
    assert {c.effect for c in found.curves} == {"gyro_bias", "accel_bias"}
    assert "rests on all sides" in found.warnings[0]
    x = curve_of(found, "accel_bias")
    assert not x.anchored
    T, middle = np.linspace(15.5, 44.5, 20), np.array([x.basis.middle])
    # what the scale changes in this attitude is in the bias
    felt = device.accel_bias(T)[:, 0] + G * up[0, 0] * device.scale(T)[:, 0]
    change = felt - (device.accel_bias(middle) + G * up[0, 0] * device.scale(middle))[0, 0]
    value, sigma = x.at(T)
    assert np.abs(value - change).max() < 4.0 * sigma.max()
    assert sigma.max() < 0.005


@pytest.mark.prove
def test_what_no_polynomial_follows_becomes_a_spline() -> None:
    device = Device(gyro=hump)
    ups = np.tile(sides(1), (60, 1))
    T = np.linspace(10.0, 45.0, 60)
    found = thermal([recorded(device, ups, T, (1e-5, 0.01))])
    basis = curve_of(found, "gyro_bias").basis
    assert (basis.kind, basis.degree) in {("spline", 4), ("spline", 5), ("polynomial", 5)}
    assert worst(found, device, "gyro_bias") < 1.2e-4
    line = thermal([recorded(Device(gyro=lambda T: 0.0 * parabola(T)), ups, T, (1e-4, 0.01))])
    assert curve_of(line, "gyro_bias").basis.title == "constant"


def test_turns_at_known_rates_show_the_gyros_scale() -> None:
    device, rng = Device(), np.random.default_rng(0)
    rows = []
    for T in np.linspace(15.0, 45.0, 6):
        for axis in np.vstack([sides(8), 0.0 * sides(2)]):
            rows.append((T, np.radians(120.0) * axis, sides(10)[len(rows) % 10]))
    still, moving = int(3.0 * HZ), int(1.5 * HZ)
    T, omega, f = (np.concatenate([
        np.vstack([np.tile(row[i], (still, 1)), np.tile(row[i], (moving, 1))]) for row in rows
    ]) for i in range(3))  # fmt: skip
    between = np.tile(np.r_[np.zeros(still), np.sin(np.linspace(0.0, 3.0, moving))], len(rows))
    omega_held, omega = omega, omega + between[:, None] * [2.0, -1.0, 1.5]
    t = np.arange(len(T)) / HZ
    # gravity goes round in the device as it turns, which is no noise
    since = np.tile(np.arange(still + moving) / HZ, len(rows))
    f = G * np.einsum("nij,nj->ni", so3.rotations(-since[:, None] * omega_held), f)
    gyro, accel = device.read(T[:, 0], omega, f)
    gyro = gyro + 1e-4 * rng.standard_normal(gyro.shape)
    accel = accel + 1e-3 * rng.standard_normal(accel.shape)
    known = Series(t, np.hstack([omega, f]))
    imu = Imu(t, gyro, accel, np.ones(len(t), dtype=np.bool_))
    found = thermal([Recording("table", imu, {"temperature": Series(t, T), "reference": known})])
    assert worst(found, device, "gyro_bias") < 5e-5
    assert worst(found, device, "gyro_scale") < 5e-5
    assert curve_of(found, "gyro_scale").basis.title == "straight line"
    assert worst(found, device, "accel_scale") < 2e-4
    assert max(c.at(np.array([30.0]))[1][0] for c in found.curves if "accel_b" in c.effect) < 1e-3


def test_files_are_put_together() -> None:
    device = Device()
    parts = [recorded(device, sides(12), np.full(12, T), (1e-4, 0.005), seed=int(T))
             for T in (10.0, 20.0, 30.0, 40.0)]  # fmt: skip
    found = thermal(parts)
    assert found.span == pytest.approx((10.0, 40.0))
    assert len(found.pieces) == 48
    assert worst(found, device, "gyro_bias") < 2e-4
    with pytest.raises(HandcalError, match=r"changes by 0\.0 K only"):
        thermal(parts[:1])


@pytest.mark.prove
def test_sensors_that_lag_behind_the_thermometer_are_noticed() -> None:
    device = Device()
    ups = np.tile(sides(1), (80, 1))
    T = np.r_[np.linspace(15.0, 45.0, 40), np.linspace(45.0, 15.0, 40)]
    edges = np.r_[T[0], T]
    span = np.stack([edges[:-1], edges[1:]], axis=1)
    sound = recorded(device, ups, span, (1e-4, 0.005))
    assert not any("rises or falls" in w for w in thermal([sound]).warnings)
    late = sound.streams["temperature"]
    shifted = np.interp(late.t + 12.0, late.t, late.value[:, 0])[:, None]
    lagging = replace(sound, streams={"temperature": Series(late.t, shifted)})
    assert any("rises or falls" in w for w in thermal([lagging]).warnings)


# --- what is refused ----------------------------------------------------------------------------


def test_hopeless_recordings_are_refused() -> None:
    device = Device()
    still = recorded(device, sides(12), np.linspace(24.0, 25.5, 12))
    with pytest.raises(HandcalError, match=r"changes by 1\.5 K only"):
        thermal([still])
    with pytest.raises(InputError, match="no temperature"):
        thermal([replace(still, streams={})])
    t = np.arange(0.0, 60.0, 1.0 / HZ)
    shaken = np.sin(7.0 * t)[:, None] * [2.0, 1.0, -1.0]
    imu = Imu(t, shaken, G + shaken, np.ones(len(t), dtype=np.bool_))
    warm = Series(t, np.linspace(10.0, 40.0, len(t))[:, None])
    with pytest.raises(HandcalError, match="never rests"):
        thermal([Recording("shaken", imu, {"temperature": warm})])
    with pytest.raises(HandcalError, match="too few"):
        thermal([recorded(device, sides(2), np.array([10.0, 30.0]))])


def test_command_writes_what_it_shows(tmp_path: Path) -> None:
    device = Device()
    write_mcap(soak(device, noise=(2e-4, 0.01)), tmp_path / "soak.mcap")
    out = [tmp_path / "a.json", tmp_path / "a.html"]
    options = ["--json", str(out[0]), "--report", str(out[1])]
    done = CliRunner().invoke(app, ["lab", "thermal", str(tmp_path / "soak.mcap"), *options])
    assert done.exit_code == 0, done.output
    said = json.loads(out[0].read_text())
    assert said["schema"] == "handcal/lab-thermal/1"
    (x,) = [c for c in said["curves"] if (c["effect"], c["name"]) == ("gyro_bias", "x")]
    T = np.array([15.0, 40.0])
    by_powers = np.polynomial.polynomial.polyval(T - x["zero_degC"], x["powers"])
    assert by_powers == pytest.approx(device.gyro_bias(T)[:, 0], abs=1e-4)
    assert np.interp(30.0, x["degC"], x["value"]) == pytest.approx(by_powers.mean(), abs=3e-4)
    assert "<svg" in out[1].read_text()
    flat = tmp_path / "flat.mcap"
    write_mcap(recorded(device, sides(12), np.full(12, 20.0)), flat)
    assert CliRunner().invoke(app, ["lab", "thermal", str(flat)]).exit_code == 1
    none = tmp_path / "none.mcap"
    write_mcap(replace(recorded(device, sides(3), np.full(3, 20.0)), streams={}), none)
    assert CliRunner().invoke(app, ["lab", "thermal", str(none)]).exit_code == 2


# --- arithmetic ---------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", candidates(10.0, 50.0, 40), ids=lambda b: b.title)
def test_bases_are_what_they_say(basis: Basis) -> None:
    T = np.linspace(10.0, 50.0, 401)
    B = basis.values(T)
    assert B.shape == (401, basis.size)
    assert np.linalg.matrix_rank(B) == basis.size
    assert np.abs(B).max() < 1.0 + 1e-9
    assert B[:, 0] == pytest.approx(1.0)
    if basis.size > 1:
        assert B[:, 1] == pytest.approx(np.linspace(-1.0, 1.0, 401))
    # the values at the knots give the whole curve, and nothing breaks at the ends
    at = basis.values(basis.knots)
    assert np.linalg.matrix_rank(at) == basis.size
    beyond = basis.values(np.array([49.9, 50.0, 50.1]))
    assert np.abs(np.diff(beyond, n=2, axis=0)).max() < 1e-2
    if basis.kind == "spline":
        assert np.abs(B[:, :2].T @ B[:, 2:]).max() < 1e-6 * len(T)
        outside = basis.values(np.array([51.0, 52.0, 53.0]))
        assert np.abs(np.diff(outside, n=2, axis=0)).max() < 1e-12


def test_few_temperatures_allow_few_functions() -> None:
    assert {b.size for b in candidates(0.0, 30.0, 3)} == {1, 2}
    assert [b.title for b in candidates(0.0, 30.0, 1)] == ["constant"]


def test_evidence_is_that_of_the_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    m, k = 12, 3
    A, prior = rng.standard_normal((m, k)), np.array([0.5, 2.0, 1.0])
    variance = rng.uniform(0.5, 2.0, m)
    x = rng.standard_normal(k)
    y = A @ x + rng.standard_normal(m)
    about = rng.standard_normal(k)
    rows = Rows(y - A @ about, A, variance, prior, about)
    C = (A * prior**2) @ A.T + np.diag(variance + 0.3**2)
    assert log_evidence(rows, 0.3) == pytest.approx(multivariate_normal(cov=C).logpdf(y), abs=1e-9)
    mean, P = fitted(rows, 0.3)
    W = np.diag(1.0 / (variance + 0.3**2))
    expected = np.linalg.inv(A.T @ W @ A + np.diag(prior**-2.0))
    assert pytest.approx(expected, abs=1e-12) == P
    assert mean == pytest.approx(expected @ A.T @ W @ y, abs=1e-12)
    best, value = best_extra(rows)
    assert value >= log_evidence(rows, 0.3) - 1e-9
    assert value >= log_evidence(rows, best * 1.2) - 1e-9


@pytest.mark.prove
def test_a_soak_of_the_simulator_gives_its_slopes_back(tmp_path: Path) -> None:
    file = tmp_path / "soak.mcap"
    slopes = {"gyro": (2e-4, -1e-4, 5e-5), "accel": (0.002, -0.001, 0.003)}
    options = ["--perfect", "--seed", "0", "--duration", "150"]
    for sensor, values in slopes.items():
        options += ["--effect", f"{sensor}_temperature={','.join(map(str, values))}"]
    done = CliRunner().invoke(app, ["simulate", "soak", "-o", str(file), *options])
    assert done.exit_code == 0, done.output
    whole = handcal.load(file)
    for recording in (whole, replace(whole, streams={"temperature": whole.streams["temperature"]})):
        found = thermal([recording])
        T = np.linspace(*found.span, 9)
        for c in found.curves:
            if c.effect.endswith("_bias"):
                slope = slopes[c.effect.split("_")[0]]["xyz".index(c.name)]
                assert c.basis.title == "straight line"
                assert c.at(T)[1].max() < 5e-3 * abs(slope) * 40.0 or not c.anchored
                change = c.at(T)[0] - c.at(T[:1])[0]
                assert change == pytest.approx(slope * (T - T[0]), abs=1e-3 * abs(slope) * 40.0)

"""Where the accelerometers sit: spins, a shake beside a reference, and paper 003."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import handcal
from handcal.commands._app import app
from handcal.compiled import so3
from handcal.lab.papers import paper_003 as paper
from handcal.lab.size import FACE_DIAGONALS, Sized, force_of, size
from handcal.recordings.export import write_mcap
from handcal.types import Array, HandcalError, Imu, Recording, Series

G = 9.80665
RATE_HZ = 100.0
FACES = np.vstack([np.eye(3), -np.eye(3)])
BODY_DIAGONALS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / math.sqrt(3.0)


class Device:
    """Accelerometers with errors, by formulas of its own."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.bias = rng.normal(0.0, 0.2, 3)
        self.response = np.eye(3) + np.diag(rng.normal(0.0, 0.01, 3))
        self.response += np.tril(rng.normal(0.0, 0.005, (3, 3)), -1)
        self.places = rng.normal(0.0, 0.01, (3, 3))

    def read(self, f: Array, omega: Array, alpha: Array) -> Array:
        out = self.bias + f @ self.response.T
        for i, r in enumerate(self.places):
            swung = np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
            out[:, i] += swung[:, i]
        return out


def on_a_table(
    device: Device, ups: Array, degs: Sequence[float], noise: float = 0.0, lean: float = 0.0
) -> Recording:
    """For each axis up: rest, up to each speed, steady, down again, and over to the next."""
    rng = np.random.default_rng(0)
    t_rest, t_ramp, t_spin = (int(s * RATE_HZ) for s in (5.0, 1.0, 8.0))
    s = np.arange(t_ramp) / t_ramp
    smooth = s**2 * (3.0 - 2.0 * s)
    rest, once = np.zeros(t_rest), np.r_[smooth, np.ones(t_spin), smooth[::-1]]
    course = np.radians(np.concatenate([rest, *(v * once for v in degs), np.zeros(20)]))
    over = np.sin(np.linspace(0.0, math.pi, 80))
    gyro, accel = [], []
    for up in ups:
        rate = course
        omega = rate[:, None] * up
        alpha = (np.gradient(rate) * RATE_HZ)[:, None] * up
        axis = np.cross(up, up[[1, 2, 0]] + [0.1, 0.2, 0.3])
        beside = axis / np.linalg.norm(axis)
        turned = np.cumsum(rate) / RATE_HZ
        around = np.cos(turned)[:, None] * beside - np.sin(turned)[:, None] * np.cross(up, beside)
        f = G * (math.cos(lean) * up + math.sin(lean) * around)
        gyro += [omega, 3.0 * over[:, None] * beside]
        accel += [device.read(f, omega, alpha), G * (up + over[:, None] * beside)]
    n = sum(map(len, gyro))
    w, a = np.vstack(gyro), np.vstack(accel)
    w = w + [0.01, -0.02, 0.005] + 0.1 * noise * rng.standard_normal(w.shape)
    a = a + noise * rng.standard_normal(a.shape)
    return Recording("table", Imu(np.arange(n) / RATE_HZ, w, a, np.ones(n, dtype=np.bool_)))


def shaken(device: Device, degs: float, noise: float, lag: Array | None = None) -> Recording:
    """Smooth turns to and fro about all axes beside a perfect reference; lag (3,): how the
    reference is mounted, a rotation vector."""
    t = np.arange(0.0, 30.0, 0.01)
    rng = np.random.default_rng(1)
    phase, hz = rng.uniform(0.0, 6.0, (3, 3)), rng.uniform(0.7, 1.6, (3, 3))
    x = 2.0 * math.pi * hz * t[:, None, None] + phase
    size = math.radians(degs) / math.sqrt(4.5)
    on = (t > 4.0)[:, None] * np.clip(0.5 * (t - 4.0), 0.0, 1.0)[:, None]
    omega = size * on * np.sin(x).sum(axis=2)
    ramp = np.where((t > 4.0) & (t < 6.0), 0.5, 0.0)[:, None]
    alpha = size * (on * (2.0 * math.pi * hz * np.cos(x)).sum(axis=2))
    alpha += size * ramp * np.sin(x).sum(axis=2)
    f = G * np.stack([np.sin(t / 5), np.cos(t / 5) * np.sin(t / 7), np.cos(t / 5)], axis=1)
    f /= np.maximum(1.0, np.linalg.norm(f, axis=1, keepdims=True) / G)
    accel = device.read(f, omega, alpha) + noise * rng.standard_normal(f.shape)
    R = np.eye(3) if lag is None else so3.matrix_exp(lag)
    reference = np.hstack([omega @ R, f @ R]) + 0.3 * noise * rng.standard_normal((len(t), 6))
    imu = Imu(t, omega + 0.01, accel, np.ones(len(t), dtype=np.bool_))
    return Recording("shaken", imu, {"reference": Series(t, reference)})


def worst(result: Sized, device: Device) -> float:
    return float(np.abs(result.arms - device.places).max())


# --- spins --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ups", [FACE_DIAGONALS, BODY_DIAGONALS], ids=["faces", "cube"])
def test_spins_give_everything_back_without_noise(ups: Array) -> None:
    device = Device()
    found = size(on_a_table(device, ups, (200.0,)))
    assert worst(found, device) < 1e-13
    value = {(p.effect, p.name): p.value for p in found.parameters}
    assert [value["accel_bias", a] for a in "xyz"] == pytest.approx(device.bias, abs=1e-12)
    scale = np.diag(device.response) - 1.0
    assert [value["accel_scale", a] for a in "xyz"] == pytest.approx(scale, abs=1e-13)
    assert value["accel_misalignment", "zy"] == pytest.approx(device.response[2, 1], abs=1e-13)
    assert np.abs([value["mounting", a] for a in "xyz"]).max() < 1e-13


def test_arms_are_as_well_known_as_their_sigmas_say() -> None:
    """At 0.1 mg and 200 deg/s off-axis arms are good to 0.16 mm (a spin less a rest, six times:
    sqrt 2 sigma / (omega^2 sqrt(6/12)))."""
    sigma, seconds = 1e-4 * G, 6.5
    noise = sigma * math.sqrt(seconds * RATE_HZ)
    device = Device(1)
    found = size(on_a_table(device, FACE_DIAGONALS, (200.0,), noise))
    expected = math.sqrt(2.0) * sigma / (math.radians(200.0) ** 2 * math.sqrt(0.5))
    off = ~np.eye(3, dtype=bool)
    assert found.arm_sigma[off] == pytest.approx(expected, rel=0.35)
    assert found.arm_sigma.max() < 2.2e-4
    z = (found.arms - device.places) / found.arm_sigma
    # nine of them: chi-squared within 0.001 and 0.999
    assert 1.15 < float((z**2).sum()) < 27.9


def test_body_axis_spins_are_refused_and_better_ones_proposed() -> None:
    with pytest.raises(HandcalError) as error:
        size(on_a_table(Device(), FACES, (100.0,)))
    said = str(error.value)
    assert "x, y and z do not show the arms xy, xz, yx, yz, zx, zy" in said
    assert "x+y, x−y, x+z, x−z, y+z and y−z" in said


def test_a_table_that_leans_is_known_to_and_one_that_lies_is_refused() -> None:
    device, lean = Device(), math.radians(0.5)
    one_rate = size(on_a_table(device, FACE_DIAGONALS, (180.0,), lean=lean))
    assert "leans by 0.5 deg" in one_rate.warnings[0]
    assert worst(one_rate, device) < 4.0 * one_rate.arm_sigma.max()
    # spins alone tell all, since their means do not feel which way the table leans
    two_rates = size(on_a_table(device, FACE_DIAGONALS, (90.0, 180.0), lean=lean))
    assert "spins alone" in two_rates.warnings[0]
    assert worst(two_rates, device) < 2e-6
    with pytest.raises(HandcalError, match="upright"):
        size(on_a_table(device, FACE_DIAGONALS, (180.0,), lean=math.radians(60.0)))


def test_hopeless_recordings_are_refused() -> None:
    still = on_a_table(Device(), FACE_DIAGONALS, (0.0,))
    with pytest.raises(HandcalError, match="No steady spin"):
        size(still)
    recording = on_a_table(Device(), FACE_DIAGONALS[:1], (200.0,))
    with pytest.raises(HandcalError, match="do not show the arms"):
        size(recording)
    spun = on_a_table(Device(), FACE_DIAGONALS, (200.0,)).imu
    fast = np.linalg.norm(spun.gyro, axis=1) > 3.3
    never = Imu(
        np.arange(fast.sum()) / RATE_HZ, spun.gyro[fast], spun.accel[fast], spun.valid[fast]
    )
    with pytest.raises(HandcalError, match="never stops"):
        size(Recording("spinning", never))


# --- a reference --------------------------------------------------------------------------------


def test_a_shake_beside_a_reference_shows_the_places() -> None:
    device = Device(2)
    clean = size(shaken(device, 400.0, 0.0))
    assert clean.way == "reference"
    # what is left is the difference that stands for the angular acceleration, at 100 Hz
    assert worst(clean, device) < 2e-5
    mounted = size(shaken(device, 400.0, 0.0, np.array([0.3, -0.2, 1.0])))
    assert worst(mounted, device) < 5e-4
    noisy = size(shaken(device, 400.0, 0.05))
    z = (noisy.arms - device.places) / noisy.arm_sigma
    assert 1.15 < float((z**2).sum()) < 35.0
    with pytest.raises(HandcalError, match="hardly turns"):
        size(shaken(device, 3.0, 0.02))


def test_real_arms_are_those_that_are_drawn(real_recordings: Path) -> None:
    found = size(handcal.load(real_recordings / "array_1_imu5.mcap"))
    drawn = np.tile([0.0189, 0.0, 0.0], (3, 1))
    assert np.abs(found.arms - drawn).max() < 1.5e-3
    assert np.abs((found.arms - drawn) / found.arm_sigma).max() < 3.5
    assert found.arm_sigma.max() < 1e-3


def test_a_smoothed_gyro_makes_the_arm_too_long(real_recordings: Path) -> None:
    """The trap that size avoids: the square of a mean is less than the mean of the squares."""
    recording = handcal.load(real_recordings / "array_1_imu5.mcap")
    reference = recording.streams["reference"]
    smooth = reference.value.copy()
    for i in range(3):
        smooth[:, i] = np.convolve(smooth[:, i], np.ones(5) / 5.0, mode="same")
    wrong = Recording("smoothed", recording.imu, {"reference": Series(reference.t, smooth)})
    assert size(wrong).arms[0, 0] > 0.0189 + 1e-3


# --- the command --------------------------------------------------------------------------------


def test_command_reads_recordings_and_tables(tmp_path: Path) -> None:
    device = Device(3)
    write_mcap(on_a_table(device, FACE_DIAGONALS, (200.0,), 0.01), tmp_path / "a.mcap")
    out = [tmp_path / "a.json", tmp_path / "a.html"]
    options = ["--json", str(out[0]), "--report", str(out[1])]
    done = CliRunner().invoke(app, ["lab", "size", str(tmp_path / "a.mcap"), *options])
    assert done.exit_code == 0, done.output
    said = json.loads(out[0].read_text())
    found = [p["value"] for p in said["parameters"] if p["effect"] == "size_effect"]
    assert np.abs(np.reshape(found, (3, 3)) - device.places).max() < 5e-4
    assert "Places" in out[1].read_text()
    rows = [f"{w[0]},{w[1]},{w[2]},{f[0]},{f[1]},{f[2]},{a[0]},{a[1]},{a[2]}"
            for w, f, a in zip(*table_of(device, FACE_DIAGONALS, 200.0), strict=True)]  # fmt: skip
    table = tmp_path / "b.csv"
    table.write_text("\n".join(["wx,wy,wz,fx,fy,fz,ax,ay,az", *rows]))
    done = CliRunner().invoke(app, ["lab", "size", str(table), "--json", str(out[0])])
    assert done.exit_code == 0, done.output
    found = [p["value"] for p in json.loads(out[0].read_text())["parameters"]
             if p["effect"] == "size_effect"]  # fmt: skip
    assert np.abs(np.reshape(found, (3, 3)) - device.places).max() < 1e-12
    table.write_text("\n".join(["wx,wy,wz,fx,fy,fz,ax,ay,az", rows[0].replace(",", ",nan", 1)]))
    assert CliRunner().invoke(app, ["lab", "size", str(table)]).exit_code == 2
    body = tmp_path / "c.mcap"
    write_mcap(on_a_table(device, FACES, (100.0,), 0.01), body)
    assert CliRunner().invoke(app, ["lab", "size", str(body)]).exit_code == 1


def table_of(device: Device, ups: Array, degs: float) -> tuple[Array, Array, Array]:
    """Rates, forces and readings of rests and spins, (n, 3) each."""
    omega = np.vstack([0.0 * ups, math.radians(degs) * ups])
    f = G * np.vstack([ups, ups])
    return omega, f, device.read(f, omega, np.zeros_like(f))


# --- paper 003 ----------------------------------------------------------------------------------


def test_equation_24_mended_is_least_squares() -> None:
    rate = math.radians(100.0)
    C, spin, rest = paper.spins(rate)
    found = paper.equation_24(C, spin, rest, rate)
    assert np.abs(found - paper.PLACES).max() < 1e-12
    noise = 1e-4 * G * np.random.default_rng(0).standard_normal((2, 3, 3))
    C, spin, rest = paper.spins(rate, noise)
    by_formula = paper.equation_24(C, spin, rest, rate)
    by_squares, _ = paper.arms(C, spin - rest, rate * np.eye(3))
    assert np.abs(by_formula - by_squares).max() < 1e-12
    # as printed it is off by metres, but for the accelerometer along the axis
    C, spin, rest = paper.spins(rate)
    printed = paper.equation_24_printed(C, spin, rest, rate)
    assert np.abs(printed - paper.PLACES[:, 0]).max() > 0.1


def test_off_axis_arms_of_the_paper_are_not_identifiable() -> None:
    off = ~np.eye(3, dtype=bool)
    body = paper.spread(np.eye(3), 100.0)[off]
    assert body.min() == pytest.approx(0.027, abs=5e-4)
    assert body.max() == pytest.approx(0.088, abs=1.5e-3)
    assert paper.spread(FACE_DIAGONALS, 200.0)[off] == pytest.approx(1.6e-4, abs=5e-6)
    assert paper.spread(FACE_DIAGONALS, 200.0).max() < 2e-4


def test_static_calibration_needs_the_inverse() -> None:
    C = paper.cosines(paper.ANGLES)
    assert np.degrees(math.acos(C[1, 1])) == pytest.approx(0.934, abs=5e-4)
    assert np.abs(C @ C.T - np.eye(3)).max() == pytest.approx(4.8e-3, abs=5e-5)
    device = paper.Static(paper.BIAS, paper.SCALE, C)
    u = paper.outputs(device, FACES, np.zeros((6, 3)), paper.PLACES)
    found = paper.static(u, FACES)
    for mine, true in ((found.bias, paper.BIAS), (found.scale, paper.SCALE), (found.C, C)):
        assert mine == pytest.approx(true, abs=1e-14)
    assert found.force(u) == pytest.approx(FACES, abs=1e-14)
    assert 4e-3 < np.abs(found.transposed(u) - FACES).max() < 6e-3


def test_the_error_turns_with_the_body() -> None:
    """10 mm at 100 deg/s: v = 2 omega r at most, and r omega t on the average, not 3 m/s."""
    rate, arm = math.radians(100.0), np.diag([0.01, 0.0, 0.0])
    assert force_of(100.0, 0.01) == pytest.approx(0.03, abs=5e-4)
    t = np.arange(0.0, 100.001, 0.01)
    drift = paper.reckoned(t, rate * t, paper.pushed(t, rate * t, arm))
    assert drift.speed == pytest.approx(2.0 * rate * 0.01, rel=1e-3)
    assert drift.distance == pytest.approx(rate * 0.01 * 100.0, rel=0.01)


def test_navigation_is_better_by_what_the_arms_are_known() -> None:
    t = np.arange(0.0, 100.001, 0.01)
    angle = math.radians(30.0) * np.sin(4.0 * math.pi * t)
    found = paper.found_places(1e-4 * G, math.radians(200.0), np.random.default_rng(0))
    before = paper.reckoned(t, angle, paper.pushed(t, angle, paper.PLACES))
    after = paper.reckoned(t, angle, paper.pushed(t, angle, paper.PLACES - found))
    # to and fro the mean force, turned into n, is not zero where the places differ
    omega = math.radians(30.0) * 4.0 * math.pi * np.cos(4.0 * math.pi * t)
    alpha = -((4.0 * math.pi) ** 2) * angle
    x = -(omega**2) * paper.PLACES[0, 0] - alpha * paper.PLACES[0, 1]
    y = -(omega**2) * paper.PLACES[1, 1] + alpha * paper.PLACES[1, 0]
    mean = np.mean((x + 1j * y) * np.exp(1j * angle))
    assert before.speed == pytest.approx(100.0 * abs(mean), rel=0.01)
    assert after.speed < before.speed / 20.0


def test_the_page_of_the_paper_is_computed() -> None:
    page = paper.paper(lambda _: None)
    verdicts = {c.claim: c.verdict for c in page.claims}
    assert len(verdicts) == len(page.claims) >= 12
    assert sum(v.startswith("holds") for v in verdicts.values()) >= 6
    assert sum(v == "does not hold" for v in verdicts.values()) >= 4
    assert all("nan" not in c.computed for c in page.claims)


@pytest.mark.prove
def test_spins_of_the_simulator_give_the_places_back(tmp_path: Path) -> None:
    places = (0.01, -0.004, 0.002, 0.003, -0.008, 0.005, -0.002, 0.006, 0.009)
    file = tmp_path / "spins.mcap"
    effect = f"size_effect={','.join(map(str, places))}"
    options = ["--perfect", "--seed", "0", "--spin", "200", "--effect", effect, "--duration", "100"]
    done = CliRunner().invoke(app, ["simulate", "steady-spins", "-o", str(file), *options])
    assert done.exit_code == 0, done.output
    found = size(handcal.load(file))
    assert found.way == "spins"
    assert np.abs(found.arms - np.reshape(places, (3, 3))).max() < 1e-12
    # the same from the gyro's own readings, without the table's
    alone = size(replace(handcal.load(file), streams={}))
    assert np.abs(alone.arms - np.reshape(places, (3, 3))).max() < 1e-6

"""What every reader checks and repairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proved import proved
from sample_recording import sample

from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.recordings.inputs._checks import saturated
from handcal.recordings.inputs._health import checked
from handcal.recordings.inputs._repair import Columns, assemble, columns
from handcal.types import Imu, InputError, Recording

DEG, G = np.pi / 180, 9.80665


def assembled(imu: Imu, ns: np.ndarray | None = None) -> Recording:
    stamps = np.rint(imu.t * 1e9).astype(np.int64) if ns is None else ns
    one = Columns(stamps, imu.gyro.copy(), imu.valid, np.arange(len(stamps)))
    return checked(assemble(Path("a"), one, replace(one, value=imu.accel.copy()), {}))


def clipped_gyro() -> tuple[Imu, np.ndarray]:
    """A gyro that reaches 1.4 times its full scale, and where it does."""
    imu = sample().imu
    top = np.abs(imu.gyro).max() / 1.4
    assert top > 1
    gyro = 2 * np.clip(imu.gyro, -top, top)
    return replace(imu, gyro=gyro), np.any(np.abs(gyro) == 2 * top, axis=1)


def stamps_of(imu: Imu) -> np.ndarray:
    return np.rint(imu.t * 1e9).astype(np.int64)


def test_a_few_late_readings_are_sorted() -> None:
    imu = sample().imu
    swap = np.arange(len(imu.t))
    swap[[50, 51]] = [51, 50]
    back = assembled(Imu(imu.t, imu.gyro[swap], imu.accel[swap], imu.valid), stamps_of(imu)[swap])
    np.testing.assert_array_equal(back.imu.gyro, imu.gyro)
    assert "1 reading came late" in back.warnings[0]


@pytest.mark.parametrize("kind", ["many", "far"])
def test_time_running_backwards_is_refused(kind: str) -> None:
    imu, ns = sample().imu, stamps_of(sample().imu)
    ns = ns.reshape(-1, 2)[:, ::-1].ravel() if kind == "many" else np.roll(ns, 100)
    with pytest.raises(InputError, match="time runs backwards"):
        assembled(imu, ns)


def test_repeated_stamps_are_dropped() -> None:
    imu, ns = sample().imu, stamps_of(sample().imu)
    ns[[30, 31]] = ns[29]
    back = assembled(imu, ns)
    assert len(back.imu.t) == len(imu.t) - 2
    assert np.all(np.diff(back.imu.t) > 0)
    assert "2 readings with a repeated stamp" in back.warnings[0]


def test_gaps_are_told_and_stay() -> None:
    imu = sample().imu
    keep = np.ones(len(imu.t), dtype=bool)
    keep[20:40] = keep[60:66] = False
    back = assembled(Imu(imu.t[keep], imu.gyro[keep], imu.accel[keep], imu.valid[keep]))
    assert back.duration_s == imu.t[-1]
    assert back.warnings == ("The IMU has 2 gaps, the longest of 0.209 s at 0.2 s.",)


@pytest.mark.parametrize(("n", "rate_hz"), [(40, 10.0), (150, 100.0)])
def test_too_short_is_refused(n: int, rate_hz: float) -> None:
    with pytest.raises(InputError, match="at least 50 over 2 s"):
        assembled(sample(n=n, rate_hz=rate_hz).imu)


def test_a_perfect_device_at_rest_is_not_dead() -> None:
    imu = sample().imu
    still = replace(imu, gyro=0 * imu.gyro, accel=0 * imu.accel + [0, 0, G])
    assert "ideal device at rest" in assembled(still).warnings[0]
    with pytest.raises(InputError, match="was not recording"):
        assembled(replace(still, accel=0 * imu.accel))


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("value", [0.0, 1.25])
def test_a_dead_sensor_is_refused(sensor: str, value: float) -> None:
    imu = sample().imu
    with pytest.raises(InputError, match="was not recording"):
        assembled(replace(imu, **{sensor: np.full_like(imu.gyro, value)}))


@pytest.mark.parametrize(
    ("factor", "match"),
    [
        (1 / G, r"that is g, not m/s\^2; give --units accel=g"),
        (1000 / G, "give --units accel=mg"),
        (G, r"give --units accel=m/s\^2"),
        (0.01, "gravity seems to have been removed"),
        (5.0, "name its unit"),
    ],
)
def test_accelerometer_in_another_unit_is_refused(factor: float, match: str) -> None:
    imu = sample().imu
    with pytest.raises(InputError, match=match):
        assembled(replace(imu, accel=imu.accel * factor))


@pytest.mark.parametrize("seed", range(5))
def test_gyro_in_another_unit_is_refused(seed: int) -> None:
    imu = sample(seed).imu
    assert assembled(imu).warnings == ()
    with pytest.raises(InputError, match="give --units gyro=deg/s"):
        assembled(replace(imu, gyro=imu.gyro / DEG))
    with pytest.raises(InputError, match="give --units gyro=rad/s"):
        assembled(replace(imu, gyro=imu.gyro * DEG))


def test_the_option_that_a_refusal_names_helps(tmp_path: Path) -> None:
    recording = sample()
    imu = replace(recording.imu, gyro=recording.imu.gyro / DEG, accel=recording.imu.accel / G)
    write_mcap(replace(recording, imu=imu, streams={}), tmp_path / "a.mcap")
    with pytest.raises(InputError, match="--units accel=g"):
        load(tmp_path / "a.mcap")
    with pytest.raises(InputError, match="--units gyro=deg/s"):
        load(tmp_path / "a.mcap", units={"accel": "g"})
    back = load(tmp_path / "a.mcap", units={"accel": "g", "gyro": "deg/s"})
    np.testing.assert_allclose(back.imu.gyro, recording.imu.gyro, rtol=1e-13)
    np.testing.assert_allclose(back.imu.accel, recording.imu.accel, rtol=1e-13)


def test_rates_beyond_any_gyro_are_doubted() -> None:
    imu = sample().imu
    gyro = imu.gyro.copy()
    gyro[200] = 45.0
    assert any("check its unit" in w for w in assembled(replace(imu, gyro=gyro)).warnings)


def test_saturated_readings_are_not_trusted() -> None:
    imu, clipped = clipped_gyro()
    assert clipped.sum() > 20
    back = assembled(imu)
    np.testing.assert_array_equal(back.imu.valid, ~clipped)
    assert "saturated" in back.warnings[0]


def test_a_saturated_accelerometer_is_not_trusted() -> None:
    """Shaken along x with 30 m/s^2 at a full scale of 2 g."""
    imu = sample().imu
    accel = imu.accel.copy()
    accel[200:, 0] += 30 * np.sin(40 * imu.t[200:])
    accel[:, 0] = np.clip(accel[:, 0], -2 * G, 2 * G)
    back = assembled(replace(imu, accel=accel))
    np.testing.assert_array_equal(back.imu.valid, np.abs(accel[:, 0]) < 2 * G)
    assert not back.imu.valid.all()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("bits", [1e-3, 1e-2, 0.02, 0.03, 0.5])
@pytest.mark.parametrize("offset", [0.0, 9.8, 40.0])
def test_quantised_rest_and_steady_turning_are_not_saturated(
    seed: int, bits: float, offset: float
) -> None:
    rng = np.random.default_rng(seed)
    value = offset + rng.normal(0, 0.01, (3000, 3))
    assert not saturated(np.round(value / bits) * bits, 2.0).any()


@pytest.mark.parametrize(
    "name",
    [
        "array_1_imu5",
        *proved(
            "array_2_imu3",
            "broad_01_slow_rotation",
            "broad_06_fast_rotation",
            "broad_08_fast_rotation_breaks",
        ),
    ],
)
def test_real_gyros_are_judged_rightly(real_recordings: Path, name: str) -> None:
    recording = load(real_recordings / f"{name}.mcap")
    imu = recording.imu
    assert checked(recording).unfit == ""
    with pytest.raises(InputError, match="gyro=deg/s"):
        checked(replace(recording, imu=replace(imu, gyro=imu.gyro / DEG)))
    with pytest.raises(InputError, match="gyro=rad/s"):
        checked(replace(recording, imu=replace(imu, gyro=imu.gyro * DEG)))


def test_real_saturation(real_recordings: Path) -> None:
    """2000 deg/s is the array's full scale; nothing slower is masked."""
    recording = load(real_recordings / "array_1_imu5.mcap")
    masked = ~recording.imu.valid
    assert 900 < masked.sum() < 1400
    assert np.abs(recording.imu.gyro[masked]).max(axis=1).min() > 34.8


def test_reference_loses_its_saturated_rows() -> None:
    imu = sample().imu
    clipped, where = clipped_gyro()
    ns = stamps_of(imu)
    streams = {"reference": columns(ns, np.hstack([clipped.gyro, imu.accel]))}
    back = assemble(Path("a"), columns(ns, imu.gyro), columns(ns, imu.accel), streams)
    np.testing.assert_array_equal(back.streams["reference"].t, imu.t[~where])
    assert back.imu.valid.all()

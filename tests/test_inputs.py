"""Plain CSV, and what every reader checks and repairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_recording import sample

from handcal.export import write_mcap
from handcal.inputs import load
from handcal.inputs._checks import check_gyro_unit, saturated
from handcal.inputs._repair import Columns, assemble, columns
from handcal.types import Imu, InputError, Recording

DEG, G = np.pi / 180, 9.80665
HEADER = "t,gx,gy,gz,ax,ay,az"


def write_csv(path: Path, header: str, table: np.ndarray, separator: str = ",") -> Path:
    rows = [separator.join(repr(float(v)) for v in row) for row in table]
    target = path / "a.csv"
    target.write_text("\n".join([header, *rows]) + "\n")
    return target


def rows_of(recording: Recording) -> np.ndarray:
    imu = recording.imu
    return np.column_stack([imu.t, imu.gyro, imu.accel])


# --- plain CSV --------------------------------------------------------------------------


def test_simple_names_are_si(tmp_path: Path) -> None:
    back = load(write_csv(tmp_path, HEADER, rows_of(sample())))
    np.testing.assert_array_equal(back.imu.t, sample().imu.t)
    np.testing.assert_array_equal(back.imu.gyro, sample().imu.gyro)
    np.testing.assert_array_equal(back.imu.accel, sample().imu.accel)
    assert back.start_ns == 0
    assert back.warnings == ()


SCALED = np.array([1e3, *[1 / DEG] * 3, *[1 / G] * 3])


@pytest.mark.parametrize(
    ("header", "units"),
    [
        (HEADER, {"time": "ms", "gyro": "deg/s", "accel": "g"}),
        (
            "Time (ms),Gyroscope X (deg/s),Gyroscope Y (dps),Gyroscope Z (°/s),"
            "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (G)",
            None,
        ),
        (
            "timestamp [ms];gyro_x [dps];gyro_y [dps];gyro_z [dps];acc_x [g];acc_y [g];acc_z [g]",
            None,
        ),
    ],
)
def test_units_by_header_or_option(tmp_path: Path, header: str, units: dict[str, str]) -> None:
    separator = ";" if ";" in header else ","
    path = write_csv(tmp_path, header, rows_of(sample()) * SCALED, separator)
    back = load(path, units=units)
    np.testing.assert_allclose(back.imu.t, sample().imu.t, atol=1e-9)
    np.testing.assert_allclose(back.imu.gyro, sample().imu.gyro, rtol=1e-13)
    np.testing.assert_allclose(back.imu.accel, sample().imu.accel, rtol=1e-13)


def test_nanoseconds_since_1970_keep_their_last_digit(tmp_path: Path) -> None:
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    header, *rows = path.read_text().splitlines()
    start = 1_700_000_000_123_456_789
    stamps = [start + round(float(row.split(",")[0]) * 1e9) for row in rows]
    rows = [f"{ns},{row.split(',', 1)[1]}" for ns, row in zip(stamps, rows, strict=True)]
    path.write_text("\n".join([header, *rows]))
    back = load(path, units={"time": "ns"})
    assert back.start_ns == start
    np.testing.assert_array_equal(back.imu.t, sample().imu.t)


def test_further_columns_and_empty_cells(tmp_path: Path) -> None:
    """A magnetometer in every fourth row only; yaw in degrees beyond half a turn."""
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    _, *rows = path.read_text().splitlines()
    rows = [
        f"{row},{'20,-5,43' if k % 4 == 0 else ' ,,'},{25 + k / 100},{k % 360},x"
        for k, row in enumerate(rows)
    ]
    header = f"{HEADER},mx (uT),my (uT),mz (uT),temp,heading (deg),note"
    path.write_text("\n".join([header, *rows]))
    back = load(path)
    assert len(back.streams["mag"].t) == 100
    np.testing.assert_allclose(back.streams["mag"].value[7], [20e-6, -5e-6, 43e-6])
    assert back.streams["temperature"].value[100, 0] == 26
    assert back.streams["heading"].value[180, 0] == pytest.approx(np.pi)
    assert back.streams["heading"].value[270, 0] == pytest.approx(-np.pi / 2)
    assert "'note'" in back.warnings[0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("t,gx,gy,gz,foo,bar\n1,2,3,4,5,6\n", r"accel x.*'foo', 'bar'.*Expected: t, gx"),
        (HEADER + "\n", "no rows"),
        (HEADER + "\n1,2,3,4,5,6,seven\n", "from line 2.*seven"),
        (HEADER + "\n1,2,3\n", "from line 2"),
        (HEADER + "\n1,1,2,3,4,5,6\n2,1,2,3,4,5,6\n", "2 IMU samples over 1.0 s"),
        ("t (h),gx,gy,gz,ax,ay,az\n1,2,3,4,5,6,7\n", "unit of column 't .h.'"),
        (HEADER + ",mx\n1,2,3,4,5,6,7,8\n", "lacks columns for mag y, mag z"),
        ("\x00\x01\x02", "lacks columns"),
        (HEADER + "\n1e300,2,3,4,5,6,7\n", "280 years"),
        (HEADER + "\nnan,2,3,4,5,6,7\n", "280 years"),
    ],
)
def test_bad_tables_are_sentences(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=match):
        load(tmp_path / "a.csv")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(max_size=200), st.text(",;\t\n 019.eE-+naif\0#\"'", max_size=99)))
def test_any_table_gives_a_sentence(tmp_path: Path, tail: bytes | str) -> None:
    tail = tail.encode() if isinstance(tail, str) else tail
    for head in (b"", HEADER.encode() + b"\n"):
        (tmp_path / "a.csv").write_bytes(head + tail)
        with pytest.raises(InputError):
            load(tmp_path / "a.csv")


def test_what_is_understood_is_listed(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(InputError, match=r"MCAP.*CSV.*Sensor Logger"):
        load(tmp_path / "a.txt")
    with pytest.raises(InputError, match="does not exist"):
        load(tmp_path / "b.txt")
    with pytest.raises(InputError, match="no known format"):
        load(tmp_path)


@pytest.mark.parametrize("units", [{"speed": "m/s"}, {"accel": "furlong"}])
def test_units_that_do_not_exist(tmp_path: Path, units: dict[str, str]) -> None:
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    with pytest.raises(InputError, match="--units"):
        load(path, units=units)


# --- what every reader checks -----------------------------------------------------------


def assembled(imu: Imu, ns: np.ndarray | None = None) -> Recording:
    stamps = np.rint(imu.t * 1e9).astype(np.int64) if ns is None else ns
    one = Columns(stamps, imu.gyro.copy(), imu.valid)
    return assemble(Path("a"), one, replace(one, value=imu.accel.copy()), {})


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
    assert "1 readings came late" in back.warnings[0]


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


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("bits", [1e-3, 1e-2, 0.5])
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
        *(f"broad_0{k}" for k in ("1_slow_rotation", "6_fast_rotation", "8_fast_rotation_breaks")),
        "array_1_imu5",
        "array_2_imu3",
    ],
)
def test_real_gyros_are_judged_rightly(real_recordings: Path, name: str) -> None:
    imu = load(real_recordings / f"{name}.mcap").imu
    with pytest.raises(InputError, match="gyro=deg/s"):
        check_gyro_unit(imu.t, imu.gyro / DEG, imu.accel)
    with pytest.raises(InputError, match="gyro=rad/s"):
        check_gyro_unit(imu.t, imu.gyro * DEG, imu.accel)


def test_real_saturation(real_recordings: Path) -> None:
    """2000 deg/s is the array's full scale; nothing slower is masked."""
    recording = load(real_recordings / "array_1_imu5.mcap")
    masked = ~recording.imu.valid
    assert 900 < masked.sum() < 1400
    assert np.abs(recording.imu.gyro[masked]).max(axis=1).min() > 34.8


def test_real_csv(real_recordings: Path) -> None:
    back = load(real_recordings / "xio_fusion.csv")
    assert back.duration_s == pytest.approx(135.33, abs=0.01)
    np.testing.assert_allclose(back.imu.accel[:50].mean(axis=0)[2], G * 0.995, atol=0.1)
    assert abs(np.degrees(back.imu.gyro[:50]).mean()) < 1
    strength = np.linalg.norm(back.streams["mag"].value, axis=1)
    assert 2e-5 < np.median(strength) < 8e-5


def test_reference_loses_its_saturated_rows() -> None:
    imu = sample().imu
    clipped, where = clipped_gyro()
    ns = stamps_of(imu)
    streams = {"reference": columns(ns, np.hstack([clipped.gyro, imu.accel]))}
    back = assemble(Path("a"), columns(ns, imu.gyro), columns(ns, imu.accel), streams)
    np.testing.assert_array_equal(back.streams["reference"].t, imu.t[~where])
    assert back.imu.valid.all()

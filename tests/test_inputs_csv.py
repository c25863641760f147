"""Plain CSV: units, further columns, tables that are none; and ``load`` itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_recording import sample

from handcal.recordings.inputs import load
from handcal.types import InputError, Recording

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


def test_simple_names_are_si(tmp_path: Path) -> None:
    table = rows_of(sample())
    table[:, 0] += 5  # whatever the clock counts from, it is not 1970
    back = load(write_csv(tmp_path, HEADER, table))
    np.testing.assert_array_equal(back.imu.t, sample().imu.t)
    np.testing.assert_array_equal(back.imu.gyro, sample().imu.gyro)
    np.testing.assert_array_equal(back.imu.accel, sample().imu.accel)
    assert back.start_ns == 0
    assert back.warnings == ()


def test_a_heading_in_degrees_has_to_say_so(tmp_path: Path) -> None:
    table = rows_of(sample())
    table = np.column_stack([table, 90.0 + np.sin(table[:, 0])])
    with pytest.raises(InputError, match="--units heading=deg"):
        load(write_csv(tmp_path, HEADER + ",heading", table))
    back = load(write_csv(tmp_path, HEADER + ",heading (deg)", table))
    assert np.abs(back.streams["heading"].value - np.pi / 2).max() < 0.02


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


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_decimal_comma_is_a_decimal_point(tmp_path: Path, separator: str) -> None:
    path = write_csv(tmp_path, HEADER.replace(",", separator), rows_of(sample()), separator)
    path.write_text(path.read_text().replace(".", ","))
    back = load(path)
    np.testing.assert_allclose(back.imu.t, sample().imu.t, atol=1e-9)
    np.testing.assert_allclose(back.imu.gyro, sample().imu.gyro, rtol=1e-13)


def test_what_is_no_number_is_shown_with_its_line(tmp_path: Path) -> None:
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    header, *rows = path.read_text().splitlines()
    for k in range(6, 26):
        rows[k] = rows[k].replace(rows[k].split(",")[2], "broken", 1)
    path.write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match="'broken' in line 8"):
        load(path)


def test_a_line_that_a_link_has_torn_is_left_out_and_said(tmp_path: Path) -> None:
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    header, *rows = path.read_text().splitlines()
    torn = {6: rows[6][: len(rows[6]) // 2], 9: "sensor restarted", 12: rows[12].replace(".", "#")}
    path.write_text("\n".join([header, *(torn.get(k, row) for k, row in enumerate(rows))]))
    back, whole = load(path), sample().imu
    assert "3 broken lines were left out." in back.warnings
    kept = np.delete(np.arange(len(whole.t)), sorted(torn))
    np.testing.assert_allclose(back.imu.gyro, whole.gyro[kept], rtol=1e-13)


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
        ("\x00\x01\x02", "no rows of numbers"),
        (HEADER + "\n1e300,2,3,4,5,6,7\n", "280 years"),
        (HEADER + "\n0,2,3,4,1e308,6,7\n1,2,3,4,5,6,1e-320\n", "1 IMU samples"),
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
    with pytest.raises(InputError, match=r"MCAP.*Sensor Logger.*CSV"):
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


def test_real_csv(real_recordings: Path) -> None:
    back = load(real_recordings / "xio_fusion.csv")
    assert back.duration_s == pytest.approx(135.33, abs=0.01)
    np.testing.assert_allclose(back.imu.accel[:50].mean(axis=0)[2], G * 0.995, atol=0.1)
    assert abs(np.degrees(back.imu.gyro[:50]).mean()) < 1
    strength = np.linalg.norm(back.streams["mag"].value, axis=1)
    assert 2e-5 < np.median(strength) < 8e-5


@pytest.mark.parametrize("ended", ["\n", ""])
def test_a_file_that_is_whole_is_read_whole(ended: str, tmp_path: Path) -> None:
    path = write_csv(tmp_path, HEADER, rows_of(sample()))
    path.write_text(path.read_text().rstrip("\n") + ended)
    back = load(path)
    assert len(back.imu.t) == len(sample().imu.t)
    assert back.warnings == ()


def test_a_line_that_is_cut_off_is_left_out_and_said(tmp_path: Path) -> None:
    """Wherever the last line is cut; of a number that lost a digit or two nothing is seen."""
    whole = sample(n=210, streams=False)
    content = write_csv(tmp_path, HEADER, rows_of(whole)).read_bytes()
    begins = content.rstrip(b"\n").rindex(b"\n") + 1
    for end in [
        begins,
        *range(begins + 1, len(content) - 8, 5),
        *range(len(content) - 8, len(content)),
    ]:
        (tmp_path / "b.csv").write_bytes(content[:end])
        back = load(tmp_path / "b.csv")
        n = len(back.imu.t)
        cut = "" if n == len(whole.imu.t) or end == begins else "middle of a line"
        assert cut in " ".join(back.warnings)
        assert n >= len(whole.imu.t) - 1
        assert bool(back.warnings) == bool(cut)
        np.testing.assert_array_equal(back.imu.gyro, whole.imu.gyro[:n])
        np.testing.assert_allclose(back.imu.accel, whole.imu.accel[:n], rtol=0, atol=1e-9)


@pytest.fixture
def moving():
    """Stamps, s, and readings (n, 7)."""
    rng = np.random.default_rng(0)
    t = np.arange(400) * 0.01
    readings = rng.normal(0, 0.1, (400, 3)), rng.normal((0, 0, 9.8), 0.05, (400, 3))
    return np.column_stack([t, *readings])


def test_stamps_that_are_rounded_are_put_at_a_steady_rate(tmp_path, moving):
    true = moving[:, 0].copy()
    moving[:, 0] = np.floor(10.0 * true + 1e-9) / 10.0
    back = load(write_csv(tmp_path, HEADER, moving))
    assert "10 readings every 0.1 s" in back.warnings[0]
    np.testing.assert_allclose(back.imu.t, true, atol=1e-6)


def test_readings_lost_to_unevenly_rounded_stamps_are_said(tmp_path, moving):
    keep = np.random.default_rng(1).random(len(moving)) < 0.6
    moving = np.vstack([moving[keep], moving[-1] + [1.0, *[0.0] * 6]])
    moving[:, 0] = np.round(moving[:, 0], 1)
    with pytest.raises(InputError, match=r"rounded \(to 0\.1 s, where there are \d readings\)"):
        load(write_csv(tmp_path, HEADER, moving))


def test_of_a_column_without_a_number_the_name_is_said(tmp_path, moving):
    moving[:, 2] = np.nan
    with pytest.raises(InputError, match="Of its 400 rows none has a number for gyroscope y"):
        load(write_csv(tmp_path, HEADER, moving))


def test_where_time_runs_backwards_is_said(tmp_path, moving):
    moving[200:, 0] -= 1.5
    with pytest.raises(InputError, match=r"backwards once, by up to 1\.49 s after 2\.0 s"):
        load(write_csv(tmp_path, HEADER, moving))


def test_stamps_in_another_unit_are_asked_about(tmp_path, moving):
    moving[:, 0] /= 1000
    with pytest.raises(InputError, match="Are the stamps in another unit"):
        load(write_csv(tmp_path, HEADER, moving))


def test_remarks_before_the_header_are_none_of_it(tmp_path, moving):
    path = write_csv(tmp_path, f"# recorded 2024\n# {HEADER}", moving)
    assert len(load(path).imu.t) == 400


def test_another_encoding_is_named(tmp_path, moving):
    path = write_csv(tmp_path, HEADER, moving)
    path.write_text(path.read_text(), encoding="utf-16")
    with pytest.raises(InputError, match="UTF-16"):
        load(path)


def test_a_field_that_no_device_is_in_is_another_unit(tmp_path, moving):
    table = np.hstack([moving, np.tile([20.0, 5.0, -40.0], (400, 1))])
    path = write_csv(tmp_path, f"{HEADER},mx,my,mz", table)
    plain = load(path)
    assert "mag" not in plain.streams
    assert any("--units mag=uT" in w for w in plain.warnings)
    assert load(path, units={"mag": "uT"}).streams["mag"].value[0, 0] == pytest.approx(2e-5)

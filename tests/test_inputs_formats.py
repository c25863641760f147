"""Every format: a recording written by its documented layout is read as what was written, by that
format alone, from a folder as from a zip; what a file lacks is said in a sentence."""

from __future__ import annotations

import dataclasses
import sqlite3
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import format_files
import numpy as np
import pytest
import pyulog
from format_files import WRITERS
from sample_recording import START_NS, sample

from handcal.recordings.inputs import format_of, formats, load, phyphox
from handcal.recordings.inputs._options import Options
from handcal.recordings.streams import STREAMS
from handcal.types import InputError, Recording

WRITTEN = [(kind, *one) for kind, found in WRITERS.items() for one in found]
Writer = Callable[[Recording], bytes]


def folder(path: Path, files: format_files.Files) -> Path:
    for name, content in files.items():
        target = path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return path


def written(path: Path, ending: str, content: bytes) -> Path:
    target = path / f"log{ending}"
    target.write_bytes(content)
    return target


def same(got: Recording, expected: Recording, *, atol: float = 1e-4) -> None:
    """The IMU, and of the streams those that were read; stamps may be of 100 us."""
    np.testing.assert_allclose(got.imu.t, expected.imu.t, atol=1.1e-4)
    np.testing.assert_allclose(got.imu.gyro, expected.imu.gyro, atol=1e-6)  # (autopilots: float32)
    np.testing.assert_allclose(got.imu.accel, expected.imu.accel, atol=atol)
    for name, series in got.streams.items():
        if name == "temperature" and expected.path.endswith((".ulg", ".bin")):
            continue  # (of an autopilot's IMU, one a reading)
        value = expected.streams[name].value.copy()
        np.testing.assert_allclose(series.t, expected.streams[name].t, atol=1e-5)
        if name == "pose":  # q and -q are one attitude
            value[:, 3:] *= np.sign(np.sum(value[:, 3:] * series.value[:, 3:], axis=1))[:, None]
        single = 1e-6 if expected.path.endswith((".ulg", ".bin")) else 1e-9
        np.testing.assert_allclose(series.value, value, atol=single)


@pytest.mark.parametrize(("kind", "ending", "write"), WRITTEN)
def test_what_was_written_is_read(kind: str, ending: str, write: Writer, tmp_path: Path) -> None:
    expected = sample(n=300)
    path = written(tmp_path, ending, write(expected))
    assert format_of(path).__name__.endswith(f".{kind}")
    same(load(path), dataclasses.replace(expected, path=str(path)))


def test_every_format_is_among_these_and_reads_the_streams_that_it_says(tmp_path: Path) -> None:
    names = {module.__name__.rsplit(".", 1)[-1]: module for module in formats()}
    assert set(names) - set(WRITERS) == {"mcap", "plain_csv"}  # (files of their own)
    for k, (kind, ending, write) in enumerate(WRITTEN):
        path = tmp_path / f"{k}{ending}"
        path.write_bytes(write(sample(n=300)))
        said = names[kind].STREAMS_READ
        titles = [STREAMS[name].title for name in load(path).streams]
        assert [t for t in titles if t not in said and "all" not in said] == [], kind


@pytest.mark.parametrize(("kind", "ending", "write"), WRITTEN)
def test_no_other_format_takes_it(kind: str, ending: str, write: Writer, tmp_path: Path) -> None:
    path = written(tmp_path, ending, write(format_files.small()))
    takers = [m for m in formats() if m.can_read(path) and not getattr(m, "LAST", False)]
    assert [m.__name__.rsplit(".", 1)[-1] for m in takers] == [kind]


@pytest.mark.parametrize("write", [format_files.phyphox, format_files.euroc,
                                   format_files.stray_scanner, format_files.ximu3,
                                   format_files.mars_logger, format_files.data_logger])  # fmt: skip
def test_a_folder_is_read_as_its_zip(
    write: Callable[[Recording], format_files.Files], tmp_path: Path
) -> None:
    expected = sample(n=300)
    same(load(folder(tmp_path / "log", write(expected))), expected)


def test_stamps_since_1970_are_kept(tmp_path: Path) -> None:
    for name, write in (("a", format_files.euroc), ("b", format_files.phyphox)):
        got = load(folder(tmp_path / name, write(sample(n=300))))
        assert abs(got.start_ns - START_NS) < 1000, name


def test_phyphox_in_each_of_its_separators(tmp_path: Path) -> None:
    expected = sample(n=300)
    kinds = ((",", False), ("\t", False), ("\t", True), (";", True))
    for k, (separator, comma) in enumerate(kinds):
        files = dict(format_files.phyphox(expected, separator, "Apple"))
        if comma:
            files = {n: c.replace(b".", b",") for n, c in files.items()}
        same(load(folder(tmp_path / str(k), files)), expected)


def test_a_g_of_phyphox_is_not_9_80665_on_ios_alone(tmp_path: Path) -> None:
    expected = sample(n=300)
    android = load(folder(tmp_path / "a", format_files.phyphox(expected, brand="google")))
    np.testing.assert_allclose(android.imu.accel, expected.imu.accel, atol=1e-9)
    files = dict(format_files.phyphox(expected, brand="Apple"))
    del files["meta/device.csv"]
    silent = load(folder(tmp_path / "b", files))
    np.testing.assert_allclose(silent.imu.accel, expected.imu.accel * 9.81 / 9.80665, atol=1e-9)
    assert any("9.81 to a g" in warning for warning in silent.warnings)


def test_a_pause_of_phyphox_is_a_gap(tmp_path: Path) -> None:
    """Experiment time stands still meanwhile."""
    expected = sample(n=300)
    files = dict(format_files.phyphox(expected))
    begun = float(START_NS // 10**9)
    middle = float(expected.imu.t[150]) - 1e-4
    files["meta/time.csv"] = (
        '"event";"experiment time";"system time"\n'
        f'"START";0.0;{begun}\n"PAUSE";{middle};{begun + middle}\n'
        f'"START";{middle};{begun + middle + 60}\n'
    ).encode()
    steps = np.diff(load(folder(tmp_path / "a", files)).imu.t)
    assert np.argmax(steps) == 149
    assert abs(steps[149] - 60 - np.diff(expected.imu.t)[149]) < 1e-5


def test_a_phyphox_file_without_accelerometer_says_what_to_record(tmp_path: Path) -> None:
    files = dict(format_files.phyphox(sample(n=300)))
    del files["Accelerometer.csv"]
    with pytest.raises(InputError, match=r"no accelerometer with gravity.*it holds .*Gyroscope"):
        load(folder(tmp_path / "a", files))


def test_an_instrument_s_pose_is_taken_before_an_estimate(tmp_path: Path) -> None:
    expected = sample(n=300)
    files = dict(format_files.euroc(expected, "state_groundtruth_estimate0"))
    files |= format_files.euroc(sample(1, n=300), "vicon0") | {
        "mav0/imu0/data.csv": files["mav0/imu0/data.csv"]
    }
    got = load(folder(tmp_path / "a", files))
    place = sample(1, n=300).streams["pose"].value[0, :3]
    np.testing.assert_allclose(got.streams["pose"].value[0, :3], place, atol=1e-9)


@pytest.mark.parametrize("write", [format_files.ios_logger, format_files.phyphox,
                                   format_files.euroc, format_files.stray_scanner,
                                   format_files.ximu3, format_files.mars_logger,
                                   format_files.data_logger])  # fmt: skip
def test_a_bomb_is_not_unpacked(
    write: Callable[[Recording], format_files.Files], tmp_path: Path
) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in write(format_files.small()).items():
            archive.writestr(name, content + (b"0" * (8 * 2**20) if "yr" in name else b""))
        if write in (format_files.euroc, format_files.stray_scanner):
            name = "imu.csv" if write is format_files.stray_scanner else "mav0/vicon0/data.csv"
            archive.writestr(f"x/{name}", b"0" * (8 * 2**20))
        archive.writestr("Magnetometer.csv", b"0" * (8 * 2**20))
    with pytest.raises(InputError, match="would unpack to too much"):
        load(path)


def test_only_tracked_poses_of_the_longest_world_are_read(tmp_path: Path) -> None:
    """ARCore's rows while it is lost, and of an earlier world, are not poses of this one."""
    files = dict(format_files.mars_logger(sample(n=300)))
    name = "2026_01_02/arcore_poses.csv"
    lines = files[name].decode().splitlines()
    for k in range(1, 6):
        lines[k] = lines[k].replace(",1,TRACKING,", ",0,TRACKING,")
    for k in range(10, 14):
        lines[k] = lines[k].replace("TRACKING", "PAUSED")
    files[name] = "\n".join(lines).encode()
    pose = sample(n=300).streams["pose"]
    got = load(folder(tmp_path, files)).streams["pose"]
    kept = np.setdiff1d(np.arange(len(pose.t)), [*range(5), *range(9, 13)])
    np.testing.assert_allclose(got.t, pose.t[kept], atol=1e-8)


def test_what_the_phone_has_corrected_is_said_to_be(tmp_path: Path) -> None:
    for k, files in enumerate((format_files.mars_logger(format_files.small()),
                               format_files.mars_logger_arkit(format_files.small()))):  # fmt: skip
        said = load(folder(tmp_path / str(k), files)).warnings
        assert any("taken a changing bias out of the gyroscope" in one for one in said)
    path = written(tmp_path, ".csv", format_files.mars_csv(format_files.small(), apple=True))
    assert load(path).warnings == ()
    files = dict(format_files.data_logger(format_files.small()))
    del files["gyro_uncalib.txt"], files["rv.txt"]
    said = load(folder(tmp_path / "raw", files)).warnings
    assert any("gyro.txt is used" in one for one in said)
    assert any("Android's is taken" in one for one in said)


def test_matrices_that_are_no_rotation_are_no_pose(tmp_path: Path) -> None:
    """ARKit gives zeros before it has begun."""
    files = dict(format_files.data_logger(sample(n=300), apple=True))
    lines = files["ARKit_camera_pose.txt"].decode().splitlines()
    lines[1] = lines[1].split(" ")[0] + " 0" * 12
    files["ARKit_camera_pose.txt"] = "\n".join(lines).encode()
    got = load(folder(tmp_path, files))
    assert len(got.streams["pose"].t) == len(sample(n=300).streams["pose"].t) - 1
    assert any("without an orientation" in one for one in got.warnings)


@pytest.mark.parametrize("column", ["x", "time"])
def test_a_database_that_lacks_a_column_is_a_sentence(tmp_path: Path, column: str) -> None:
    path = written(tmp_path, ".sqlite", format_files.sensor_logger_database(format_files.small()))
    database = sqlite3.connect(path)
    database.execute(f"ALTER TABLE GyroscopeUncalibrated RENAME COLUMN {column} TO other")
    database.commit()
    database.close()
    with pytest.raises(InputError, match=f"no such column: {column}"):
        load(path)


def test_cells_that_a_database_computes_are_not_believed(tmp_path: Path) -> None:
    """60 cells of 15 MB each out of a file of some kB."""
    path = tmp_path / "export.sqlite"
    database = sqlite3.connect(path)
    made = "x AS (printf('%.*c', 15000000, '1'))"
    database.execute(f"CREATE TABLE GyroscopeUncalibrated (time, seconds_elapsed, z, y, {made})")
    database.executemany("INSERT INTO GyroscopeUncalibrated VALUES (?, 0, 0, 0)",
                         [(k,) for k in range(60)])  # fmt: skip
    database.commit()
    database.close()
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"GyroscopeUncalibrated lacks|too big"):
            load(path)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_a_pose_estimated_with_the_imu_is_called_so(tmp_path: Path) -> None:
    files = format_files.euroc(sample(n=300), "state_groundtruth_estimate0")
    got = load(folder(tmp_path / "a", files))
    assert "pose" in got.streams
    assert any("estimated with the readings of this IMU" in w for w in got.warnings)


def test_a_magnetometer_without_a_unit_of_field_is_left_out(tmp_path: Path) -> None:
    files = dict(format_files.ximu3(sample(n=300)))
    files["Magnetometer.csv"] = files["Magnetometer.csv"].replace(b"(uT)", b"(a.u.)")
    got = load(folder(tmp_path / "a", files))
    assert "mag" not in got.streams
    assert any("mag: its unit is a.u." in w for w in got.warnings)


def test_the_gyro_unit_of_an_xsens_export_is_checked_against_gravity(tmp_path: Path) -> None:
    """An export set to deg/s, which MT Manager's files do not say."""
    degrees = sample(n=300, streams=False)
    text = format_files.mt_manager(degrees).decode().splitlines()
    rows = [line.split("\t") for line in text[4:]]
    for row in rows:
        row[5:8] = [repr(57.29578 * float(cell)) for cell in row[5:8]]
    turned = ["\t".join(row) for row in rows]
    path = written(tmp_path, ".txt", "\n".join([*text[:4], *turned]).encode())
    with pytest.raises(InputError, match="--units gyro=deg/s"):
        load(path)
    np.testing.assert_allclose(
        load(path, units={"gyro": "deg/s"}).imu.gyro, degrees.imu.gyro, atol=1e-6
    )


def test_a_matlab_file_in_other_units(tmp_path: Path) -> None:
    expected = sample(n=300)
    imu = expected.imu
    more = {"gyro": np.degrees(imu.gyro), "temp": np.linspace(20, 30, 300)[:, None]}
    path = written(tmp_path, ".mat", format_files.mat(expected, **more))
    with pytest.raises(InputError, match="--units gyro=deg/s"):
        load(path)
    got = load(path, units={"gyro": "deg/s"})
    np.testing.assert_allclose(got.imu.gyro, imu.gyro, atol=1e-12)
    assert got.streams["temperature"].value[-1] == 30


def test_a_matlab_bomb_and_a_version_that_is_not_read(tmp_path: Path) -> None:
    bomb = format_files.mat(format_files.small(), big=np.zeros((1_000_000, 2)))
    assert len(bomb) < 100_000
    with pytest.raises(InputError, match="would unpack to too much"):
        load(written(tmp_path, ".mat", bomb))
    with pytest.raises(InputError, match="save it with '-v7'"):
        load(written(tmp_path, ".mat", b"MATLAB 7.3 MAT-file" + bytes(600)))


def test_a_parquet_column_of_no_letters_is_a_sentence(tmp_path: Path) -> None:
    """Found by `make fuzz`: pyarrow decodes names when they are asked for."""
    content = format_files.parquet(format_files.small())
    assert b"gx" in content
    path = written(tmp_path, ".parquet", content.replace(b"gx", b"\xe1x"))
    with pytest.raises(InputError, match="damaged Parquet"):
        load(path)


def test_a_px4_log_is_the_one_that_pyulog_reads(tmp_path: Path) -> None:
    """So the logs written here are ULog; and one cut in a message gives what is before."""
    expected = sample(n=300, streams=False)
    path = written(tmp_path, ".ulg", format_files.ulog(expected))
    gyro = next(d.data for d in pyulog.ULog(str(path)).data_list if d.name == "sensor_gyro")
    got = load(path)
    theirs = np.column_stack([gyro[axis] for axis in "xyz"])
    np.testing.assert_array_equal(got.imu.gyro, theirs.astype(np.float64) * [1, -1, -1])
    assert "PX4's axes (forward, right, down) were turned to forward, left, up." in got.warnings
    content = path.read_bytes()
    short = load(written(tmp_path, ".ulg", content[: len(content) - 41 * 50 - 20]))
    assert len(short.imu.t) == 249
    assert any("ends early" in warning for warning in short.warnings)


def test_what_a_crash_appended_to_a_px4_log_is_read(tmp_path: Path) -> None:
    """Half a message, and behind it the rest at the offset that the flags say."""
    whole = format_files.ulog(sample(n=300, streams=False), raw=False)
    size = 3 + 2 + 8 + 7 * 4  # of a message of sensor_combined
    at = len(whole) - 100 * size
    flags = bytearray(40)
    flags[8] = 1
    flags[16:24] = (at + 17).to_bytes(8, "little")
    content = whole[:19] + bytes(flags) + whole[59:at] + whole[at : at + 17] + whole[at:]
    got = load(written(tmp_path, ".ulg", content))
    assert len(got.imu.t) == 300
    assert not any("ends early" in warning for warning in got.warnings)


def test_real_phyphox_exports(real_recordings: Path) -> None:
    """A zip whose acceleration is of another recording than its rate (35 s of poses, 3 s of a
    throw), and a workbook with a rate alone: numbers as they stand in the files, and sentences."""
    raw = real_recordings / "raw"
    if not raw.is_dir():
        pytest.skip(f"no raw recordings in {raw}")
    both, alone = raw / "phyphox_rigid_body.zip", raw / "phyphox_gyro_only.xls"
    assert {format_of(path) for path in (both, alone)} == {phyphox}
    with pytest.raises(InputError, match=r"on to 35\.3 s.*stopped at 3\.1 s: .*two recordings"):
        load(both)
    export = dataclasses.replace(phyphox._of_files(both, Options()), stop=np.inf)
    held = phyphox._held(both, export)
    assert held["gyro"].value[0].tolist() == [-2.871690877e-2, -7.556324825e-3, -8.267381229e-3]
    assert [len(held[q].ns) for q in ("gyro", "accel")] == [312, 3560]
    assert held["accel"].value[0, 2] > 9.8  # (screen up)
    assert held["gyro"].ns[0] == pytest.approx(1.750383375135371e18 + 7.314666669e6, abs=1e3)
    with pytest.raises(InputError, match=r"no accelerometer .* it holds Raw Data"):
        load(alone)
    workbook = phyphox._held(alone, phyphox._of_workbook(alone))["gyro"]
    assert len(workbook.ns) == 2239
    first = [0.40231743454933167, 2.3317110538482666, 4.094337463378906]
    assert workbook.value[0].tolist() == first


def test_the_real_android_export_is_its_conversion(real_recordings: Path) -> None:
    """Made by others, which ends a reading earlier and counts its stamps from elsewhere."""
    raw = real_recordings / "raw" / "sensorlogger_android.zip"
    if not raw.is_file():
        pytest.skip(f"no {raw}")
    got, expected = load(raw).imu, load(real_recordings / "devices" / "android_fullpitch.mcap").imu
    n = len(expected.t)
    assert n > 1800
    np.testing.assert_allclose(got.t[:n], expected.t, atol=1e-6)
    np.testing.assert_allclose(got.gyro[:n], expected.gyro, atol=1e-9)
    # (interpolated at stamps that differ by 0.3 us, where it changes by 100 m/s^3)
    np.testing.assert_allclose(got.accel[:n], expected.accel, atol=1e-4)

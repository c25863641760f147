"""Sensor Logger exports: signs and units of both systems, all three containers, damage."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_recording import START_NS, sample

from handcal.recordings.inputs import load
from handcal.types import InputError, Recording

G = 9.80665
N = 210


def table(value: np.ndarray, shift_ns: int = 0) -> str:
    """A CSV as the app writes it: columns in the order z, y, x."""
    stamps = START_NS + shift_ns + np.arange(len(value)) * 10_000_000
    rows = [
        f"{ns},{(ns - START_NS) / 1e9},{z!r},{y!r},{x!r}"
        for ns, (x, y, z) in zip(stamps.tolist(), value.tolist(), strict=True)
    ]
    return "\n".join(["time,seconds_elapsed,z,y,x", *rows]) + "\n"


def metadata(platform: str, standardised: bool = False) -> str:
    return f"version,platform,standardisation\n3,{platform},{str(standardised).lower()}\n"


def motion() -> Recording:
    return sample(n=N, streams=False)


def export(**files: str) -> dict[str, str]:
    """Files by sensor name, with a gyroscope, for ``folder`` and ``zipped``."""
    return {"GyroscopeUncalibrated": table(motion().imu.gyro)} | files


def folder(path: Path, files: dict[str, str]) -> Path:
    target = path / "export"
    target.mkdir()
    for name, text in files.items():
        (target / f"{name}.csv").write_text(text)
    return target


def zipped(path: Path, files: dict[str, str], prefix: str = "") -> Path:
    target = path / "export.zip"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(f"{prefix}{name}.csv", text)
    return target


def as_json(path: Path, files: dict[str, str]) -> Path:
    entries: list[dict[str, str]] = []
    for name, text in files.items():
        header, *rows = text.splitlines()
        for row in rows:
            cells = dict(zip(header.split(","), row.split(","), strict=True))
            entries.append({"sensor": name, **cells})
    target = path / "export.json"
    target.write_text(json.dumps(entries))
    return target


Container = Callable[[Path, dict[str, str]], Path]
CONTAINERS: list[Container] = [folder, zipped, as_json]


@pytest.mark.parametrize("container", CONTAINERS)
def test_ios_reads_g_with_the_other_sign(tmp_path: Path, container: Container) -> None:
    """Flat with the screen up an iPhone reads z = -1 g; the specific force is +9.80665."""
    force = motion().imu.accel
    files = export(AccelerometerUncalibrated=table(-force / G), Metadata=metadata("ios"))
    back = load(container(tmp_path, files))
    np.testing.assert_allclose(back.imu.accel, force, rtol=1e-14)
    np.testing.assert_array_equal(back.imu.gyro, motion().imu.gyro)
    assert back.start_ns == START_NS
    assert back.warnings == ()


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("meta", [metadata("android"), metadata("ios", standardised=True)])
def test_android_and_standardised_ios_are_si(
    tmp_path: Path, container: Container, meta: str
) -> None:
    force = motion().imu.accel
    back = load(container(tmp_path, export(AccelerometerUncalibrated=table(force), Metadata=meta)))
    np.testing.assert_array_equal(back.imu.accel, force)


@pytest.mark.parametrize(("factor", "system"), [(-1 / G, "iOS"), (1.0, "Android")])
def test_without_metadata_the_magnitude_decides(tmp_path: Path, factor: float, system: str) -> None:
    force = motion().imu.accel
    back = load(folder(tmp_path, export(AccelerometerUncalibrated=table(force * factor))))
    np.testing.assert_allclose(back.imu.accel, force, rtol=1e-14)
    assert system in back.warnings[0]


@pytest.mark.parametrize(("platform", "sign"), [("ios", -1), ("android", 1)])
def test_fallback_to_motion_plus_gravity(tmp_path: Path, platform: str, sign: int) -> None:
    force = motion().imu.accel
    gravity = np.tile([0.0, 0.0, G], (N, 1))
    files = export(
        AccelerometerUncalibrated="time,seconds_elapsed,z,y,x\n",
        Accelerometer=table(sign * (force - gravity)),
        Gravity=table(sign * gravity),
        Metadata=metadata(platform),
    )
    back = load(zipped(tmp_path, files))
    np.testing.assert_allclose(back.imu.accel, force, atol=1e-12)
    assert "AccelerometerUncalibrated is absent or empty" in back.warnings[0]


def test_fallback_without_metadata_is_not_guessed(tmp_path: Path) -> None:
    files = export(Accelerometer=table(np.ones((N, 3))), Gravity=table(np.ones((N, 3))))
    with pytest.raises(InputError, match=r"Metadata\.csv"):
        load(folder(tmp_path, files))


def test_total_acceleration_and_the_corrected_gyroscope(tmp_path: Path) -> None:
    files = {"Gyroscope": table(motion().imu.gyro), "TotalAcceleration": table(motion().imu.accel)}
    back = load(folder(tmp_path, files))
    np.testing.assert_array_equal(back.imu.accel, motion().imu.accel)
    assert len(back.warnings) == 3
    assert any("signs of Android" in w and "up is down" in w for w in back.warnings)


def test_magnetometer_is_in_microtesla(tmp_path: Path) -> None:
    files = export(
        AccelerometerUncalibrated=table(motion().imu.accel),
        MagnetometerUncalibrated=table(np.tile([20.0, -5.0, 43.0], (N, 1))),
        Metadata=metadata("android"),
    )
    field = load(zipped(tmp_path, files)).streams["mag"].value
    np.testing.assert_allclose(field, np.tile([20e-6, -5e-6, 43e-6], (N, 1)), rtol=1e-14)


def test_accelerometer_is_brought_to_the_gyro_clock(tmp_path: Path) -> None:
    """4 ms later stamps of a force that grows linearly by 1 m/s^2 a second."""
    t = np.arange(N) * 0.01
    force = np.column_stack([t + 0.004, 0 * t, np.full(N, G)])
    files = export(
        GyroscopeUncalibrated=table(motion().imu.gyro * 1e-3),
        AccelerometerUncalibrated=table(force, shift_ns=4_000_000),
        Metadata=metadata("android"),
    )
    back = load(folder(tmp_path, files))
    assert back.start_ns == START_NS + 10_000_000
    assert back.imu.t[0] == 0
    np.testing.assert_allclose(back.imu.accel[:, 0], back.imu.t + 0.01, atol=1e-12)
    assert any("outside" in w for w in back.warnings)


def test_a_gap_of_the_accelerometer_is_not_trusted(tmp_path: Path) -> None:
    lines = table(motion().imu.accel).splitlines()
    files = export(
        AccelerometerUncalibrated="\n".join(lines[:101] + lines[121:]),
        Metadata=metadata("android"),
    )
    back = load(folder(tmp_path, files))
    assert np.flatnonzero(~back.imu.valid).tolist() == list(range(100, 120))


@pytest.mark.parametrize("prefix", ["", "2024-01-01_recording/", "/etc/"])
def test_member_paths_are_only_names(tmp_path: Path, prefix: str) -> None:
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    files = export(AccelerometerUncalibrated=table(motion().imu.accel))
    before = set(tmp_path.rglob("*"))
    path = zipped(inside, files, prefix)
    assert len(load(path).imu.t) == N
    assert set(tmp_path.rglob("*")) == before | {path}


@pytest.mark.parametrize(
    ("files", "match"),
    [
        ({"Gravity": table(np.ones((9, 3)))}, "no gyroscope readings; it holds Gravity"),
        ({"Gyroscope": table(np.ones((9, 3)))}, "no accelerometer with gravity"),
        ({"Gyroscope": "time,x\n1,2\n"}, "lacks one of the columns"),
        ({"Gyroscope": "time,x,y,z\n1,2,3,four\n"}, "is damaged"),
        ({"Gyroscope": "time,x,y,z\n-1,2,3,4\n"}, "no time since 1970"),
    ],
)
def test_incomplete_exports_are_sentences(
    tmp_path: Path, files: dict[str, str], match: str
) -> None:
    with pytest.raises(InputError, match=match):
        load(folder(tmp_path, files))


def test_truncated_json_is_a_sentence(tmp_path: Path) -> None:
    path = as_json(tmp_path, export())
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match="truncated"):
        load(path)


@pytest.fixture(scope="module")
def small_exports(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    files = export(
        AccelerometerUncalibrated=table(motion().imu.accel), Metadata=metadata("android")
    )
    path = tmp_path_factory.mktemp("small")
    return [make(path, files).read_bytes() for make in (zipped, as_json)]


@settings(max_examples=200, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@given(st.data())
def test_any_damage_gives_a_recording_or_a_sentence(
    small_exports: list[bytes], tmp_path: Path, data: st.DataObject
) -> None:
    content = bytearray(data.draw(st.sampled_from(small_exports)))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(-600, len(content) - 1))  # the directory is at the end
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path / "export"
    path.write_bytes(bytes(content))
    with suppress(InputError):
        assert isinstance(load(path), Recording)


def test_real_iphone(real_recordings: Path, tmp_path: Path) -> None:
    source = real_recordings / "sensor_logger_ios"
    back = load(source)
    assert back.duration_s == pytest.approx(27.1, abs=0.1)
    assert back.rate_hz == pytest.approx(100, abs=1)
    # it lay with the screen up at the end
    np.testing.assert_allclose(back.imu.accel[-50:].mean(axis=0), [0, 0, G], atol=0.3)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in source.iterdir():
            archive.write(file, f"Recording/{file.name}")
    (tmp_path / "a.zip").write_bytes(buffer.getvalue())
    again = load(tmp_path / "a.zip")
    np.testing.assert_array_equal(again.imu.accel, back.imu.accel)
    np.testing.assert_array_equal(again.streams["mag"].value, back.streams["mag"].value)


def test_an_empty_cell_is_a_reading_that_was_not_taken(tmp_path: Path) -> None:
    text = table(motion().imu.gyro)
    lines = text.splitlines(keepends=True)
    cells = lines[5].rstrip("\n").split(",")
    lines[5] = ",".join([*cells[:-1], ""]) + "\n"
    files = export(GyroscopeUncalibrated="".join(lines),
                   AccelerometerUncalibrated=table(motion().imu.accel))  # fmt: skip
    back = load(folder(tmp_path, files))
    assert len(back.imu.t) == N - 1
    assert any("NaN" in w for w in back.warnings)

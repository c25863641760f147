"""What a file says of its device is kept, and tells a fleet's devices apart."""

from __future__ import annotations

import struct
from pathlib import Path

import format_files
import numpy as np
import pytest
from sample_recording import sample
from test_inputs_phone import export, folder, table

from handcal.fleet.record import Source
from handcal.fleet.run import as_told
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load


def file(path: Path, ending: str, content: bytes) -> Path:
    target = path / f"recording{ending}"
    target.write_bytes(content)
    return target


def sensor_logger(path: Path) -> Path:
    said = "version,device name,platform,device id\n3,Pixel 8,android,5f1e-77\n"
    force = sample(n=210, streams=False).imu.accel
    return folder(path, export(AccelerometerUncalibrated=table(force), Metadata=said))


def phyphox(path: Path) -> Path:
    files = format_files.phyphox(sample(n=300))
    (name,) = (n for n in files if n.endswith("device.csv"))
    text = '"property";"value"\n"deviceBrand";"google"\n"deviceModel";"Pixel 8"\n'
    return file(path, ".zip", format_files.zipped(files | {name: text.encode()}))


def px4(path: Path) -> Path:
    log = format_files.ulog(sample(n=300))
    said = b""
    for key, value in (("char[4] sys_uuid", "00a1"), ("char[9] ver_hw", "PX4_FMU_X")):
        content = bytes([len(key)]) + f"{key}{value}".encode()
        said += struct.pack("<Hc", len(content), b"I") + content
    at = 16 + 3 + 40  # (behind the header and the flags)
    return file(path, ".ulg", log[:at] + said + log[at:])


def dot(path: Path) -> Path:
    return file(path, ".csv", format_files.dot(sample(n=300)))


def mti(path: Path) -> Path:
    text = format_files.mt_manager(sample(n=300))
    return file(path, ".txt", b"// Device information:\n//  DeviceId: 00B48A1C\n" + text)


@pytest.mark.parametrize(
    ("made", "device", "model"),
    [
        (sensor_logger, "5f1e-77", "Pixel 8"),
        (phyphox, "", "google Pixel 8"),
        (px4, "00a1", "PX4_FMU_X"),
        (dot, "DOT 1", ""),
        (mti, "00B48A1C", ""),
    ],
)
def test_what_a_file_says_is_kept_and_goes_on_into_mcap(tmp_path, made, device, model):
    recording = load(made(tmp_path))
    assert (recording.device, recording.model) == (device, model)
    write_mcap(recording, tmp_path / "again.mcap")
    again = load(tmp_path / "again.mcap")
    assert (again.device, again.model) == (device, model)
    assert np.array_equal(again.imu.gyro, recording.imu.gyro)


def test_a_file_that_says_nothing_has_no_device(tmp_path):
    write_mcap(sample(n=300), tmp_path / "a.mcap")
    recording = load(tmp_path / "a.mcap")
    assert (recording.device, recording.model) == ("", "")


def test_the_manifest_goes_before_what_files_say():
    record = {"device": "5f1e-77", "model": "Pixel 8", "recording": {"recorded": "2026-05-01"}}
    alone = as_told(Source("a"), record)
    assert (alone.device, alone.model, alone.started) == ("5f1e-77", "Pixel 8", "2026-05-01")
    named = as_told(Source("a", "my model", "mine", "2026-01-01"), record)
    assert (named.device, named.model, named.started) == ("mine", "my model", "2026-01-01")
    # (a device of the manifest has the manifest's model in all of its recordings, also none)
    assert as_told(Source("a", "", "mine"), record).model == ""
    assert as_told(Source("a", "my model"), record).device == "5f1e-77"

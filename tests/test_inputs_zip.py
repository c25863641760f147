"""Zips and folders of any format: bombs, paths that climb, nested zips and absurd sizes are refused
in under a second, by a sentence, and what nothing reads is told what came nearest."""

from __future__ import annotations

import io
import struct
import time
import zipfile
from pathlib import Path

import pytest

from handcal.recordings.inputs import load
from handcal.types import InputError

HEADER = "time,seconds_elapsed,z,y,x\n"


def zipped(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def nested() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("GyroscopeUncalibrated.csv", HEADER)
    return out.getvalue()


def refused(path: Path, match: str) -> None:
    """By a sentence, in less than a second of processor time."""
    started = time.process_time()
    with pytest.raises(InputError, match=match):
        load(path)
    assert time.process_time() - started < 1.0


@pytest.mark.parametrize("name", ["GyroscopeUncalibrated.csv", "Accelerometer.csv"])
def test_a_bomb_is_not_unpacked(tmp_path: Path, name: str) -> None:
    bomb = HEADER.encode() + b"0" * (100 * 2**20)
    refused(zipped(tmp_path / "a.zip", {name: bomb}), "unpack to too much")


def test_a_size_that_is_a_lie_is_found_out(tmp_path: Path) -> None:
    """The directory says four gigabytes of a file of some bytes, and the reverse."""
    path = zipped(tmp_path / "a.zip", {"GyroscopeUncalibrated.csv": HEADER.encode() * 30})
    whole = path.read_bytes()
    at = whole.index(b"PK\x01\x02") + 24
    for size in (0xFFFFFFF0, 3):
        path.write_bytes(whole[:at] + struct.pack("<I", size) + whole[at + 4 :])
        refused(path, "unpack to too much|damaged|has no gyroscope|GyroscopeUncalibrated")


@pytest.mark.parametrize("climbing", ["../../x/", "a/../../", "..\\"])
def test_a_path_that_leads_out_is_refused(tmp_path: Path, climbing: str) -> None:
    name = f"{climbing}GyroscopeUncalibrated.csv"
    before = set(tmp_path.parent.iterdir())
    refused(zipped(tmp_path / "a.zip", {name: HEADER.encode()}), "leads out of it")
    assert set(tmp_path.parent.iterdir()) == before


def test_a_zip_in_a_zip_is_not_looked_into(tmp_path: Path) -> None:
    refused(zipped(tmp_path / "a.zip", {"inner.zip": nested()}), "It holds inner.zip, which are no")


def test_a_hundred_thousand_files_are_too_many(tmp_path: Path) -> None:
    members = {f"{k}.csv": b"" for k in range(21_000)}
    path = zipped(tmp_path / "a.zip", members | {"GyroscopeUncalibrated.csv": HEADER.encode()})
    refused(path, "holds 21001 files")


def test_the_nearest_format_is_named_with_what_it_lacks(tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(b"\xff\xd8\xff")
    with pytest.raises(InputError, match=r"no known format\. Understood are: .*MCAP.*plain CSV"):
        load(path)
    folder = tmp_path / "holiday"
    folder.mkdir()
    (folder / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(InputError, match=r"holds photo\.jpg, which are no files of any"):
        load(folder)


def test_an_empty_folder_or_zip_is_said_to_be_empty(tmp_path: Path) -> None:
    """A ROS 2 user read of a folder that holds nothing "which are no files of any of them"."""
    folder = tmp_path / "holiday"
    folder.mkdir()
    for path in (folder, zipped(tmp_path / "a.zip", {})):
        with pytest.raises(InputError) as refused:
            load(path)
        assert str(refused.value) == f"{path} holds no recording: it is empty."


def test_a_file_without_a_name_in_a_zip_is_a_sentence(tmp_path: Path) -> None:
    """Found by `make fuzz-guided`."""
    path = tmp_path / "x.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Gyroscope.csv", "a")
    path.write_bytes(path.read_bytes().replace(b"Gyroscope.csv", b"\0" * 13))
    with pytest.raises(InputError):
        load(path)

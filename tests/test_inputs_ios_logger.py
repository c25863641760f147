"""ios_logger: Apple's sign, g and microtesla become SI, ARKit's world gets z up, and a real folder
becomes, number by number, what its conversion by other hands holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sample_recording import sample

from handcal.recordings.inputs import load
from handcal.types import InputError

START_S = 1_600_000_000


def write(folder: Path, **streams: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    for name, table in streams.items():
        rows = [f"{START_S + row[0]:.6f}," + ",".join(map(repr, row[1:])) for row in table.tolist()]
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    return folder


def imu() -> dict[str, np.ndarray]:
    """As Apple has it: g, the axis up negative."""
    one = sample(n=300, streams=False).imu
    accel = -one.accel / 9.80665
    return {"Gyro": np.column_stack([one.t, one.gyro]), "Accel": np.column_stack([one.t, accel])}


def test_signs_and_units(tmp_path: Path) -> None:
    expected = sample(n=300, streams=False).imu
    magnet = np.column_stack([expected.t[::4], np.tile([500.0, -100.0, 30.0], (75, 1))])
    got = load(write(tmp_path / "log", **imu(), Magnet=magnet))
    np.testing.assert_allclose(got.imu.gyro, expected.gyro, atol=1e-12)
    np.testing.assert_allclose(got.imu.accel, expected.accel, atol=1e-4)  # (stamps to 1 us)
    np.testing.assert_allclose(got.streams["mag"].value[0], [5e-4, -1e-4, 3e-5], rtol=1e-12)
    assert got.warnings == ()


def test_the_world_gets_z_up(tmp_path: Path) -> None:
    """A camera level in ARKit's world (y up) whose x points along the world's x; one metre up."""
    t = imu()["Gyro"][::3, 0]
    pose = np.tile([0.2, 1.0, -3.0, 1.0, 0.0, 0.0, 0.0], (len(t), 1))
    got = load(write(tmp_path / "log", **imu(), ARposes=np.column_stack([t, pose])))
    x, y, z, w, *v = got.streams["pose"].value[0]
    assert (x, y, z) == (0.2, 3.0, 1.0)
    up = np.array([0.0, 1.0, 0.0])  # the camera's y, in the world: v' = v + 2 q x (q x v + w v)
    turned = up + 2 * np.cross(v, np.cross(v, up) + w * up)
    np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-12)


def test_what_is_wrong_is_said(tmp_path: Path) -> None:
    folder = write(tmp_path / "log", **imu())
    whole = (folder / "Accel.txt").read_text()
    (folder / "Accel.txt").write_text(whole + "1600000003.1,0.1\n")
    with pytest.raises(InputError, match=r"accel\.txt.* line 301 has 2 columns"):
        load(folder)
    (folder / "Accel.txt").write_text("")
    with pytest.raises(InputError, match=r"accel\.txt is empty"):
        load(folder)
    (folder / "Accel.txt").unlink()
    with pytest.raises(InputError, match=r"Nearest is .*ios_logger.*lacks Accel\.txt"):
        load(folder)


def test_the_real_folder_is_its_conversion(real_recordings: Path) -> None:
    """Which begins later, ends earlier and counts its stamps from elsewhere."""
    raw, other = real_recordings / "raw" / "ios_logger", real_recordings / "devices"
    if not raw.is_dir():
        pytest.skip(f"no raw recordings in {raw.parent}")
    got, expected = load(raw), load(other / "iphone_arkit.mcap")
    first = int(np.flatnonzero((got.imu.gyro == expected.imu.gyro[0]).all(axis=1))[0])
    same = slice(first, first + len(expected.imu.t))
    t = got.imu.t[same] - got.imu.t[first]
    np.testing.assert_allclose(t, expected.imu.t, atol=1e-6)
    np.testing.assert_allclose(got.imu.gyro[same], expected.imu.gyro, atol=1e-9)
    np.testing.assert_allclose(got.imu.accel[same], expected.imu.accel, atol=1e-3)
    for name, digits in (("mag", 1e-12), ("pose", 2e-6)):
        own, theirs = got.streams[name], expected.streams[name]
        at = np.searchsorted(own.t - got.imu.t[first], theirs.t - 1e-4)
        np.testing.assert_allclose(own.t[at] - got.imu.t[first], theirs.t, atol=1e-6)
        sign = np.where(own.value[at, -1:] * theirs.value[:, -1:] < 0, [[1] * 3 + [-1] * 4], 1)
        value = own.value[at] * (sign if name == "pose" else 1)
        np.testing.assert_allclose(value, theirs.value, atol=digits)

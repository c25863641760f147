"""What is written reads back equal, by handcal and by an independent ROS 2 decoder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from proved import proved
from sample_recording import START_NS, sample

from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.recordings.streams import quaternions_of_yaw, yaw_of_quaternions
from handcal.types import HandcalError, Recording


def assert_equal(a: Recording, b: Recording) -> None:
    """Bit by bit, but for path and warnings."""
    for name in ("t", "gyro", "accel", "valid"):
        np.testing.assert_array_equal(getattr(a.imu, name), getattr(b.imu, name), err_msg=name)
    assert set(a.streams) == set(b.streams)
    for name, series in a.streams.items():
        np.testing.assert_array_equal(series.t, b.streams[name].t, err_msg=name)
        np.testing.assert_array_equal(series.value, b.streams[name].value, err_msg=name)
    assert a.start_ns == b.start_ns


@pytest.mark.parametrize("seed", range(3))
def test_round_trip_is_exact(tmp_path: Path, seed: int) -> None:
    recording = sample(seed)
    write_mcap(recording, tmp_path / "a.mcap")
    back = load(tmp_path / "a.mcap")
    assert back.warnings == ()
    assert_equal(recording, back)


def test_round_trip_keeps_what_is_not_valid_and_an_unknown_start(tmp_path: Path) -> None:
    recording = sample()
    valid = recording.imu.valid.copy()
    valid[100:110] = False
    recording = replace(recording, imu=replace(recording.imu, valid=valid), start_ns=0)
    write_mcap(recording, tmp_path / "a.mcap")
    assert_equal(recording, load(tmp_path / "a.mcap"))


def test_independent_decoder_reads_the_same(tmp_path: Path) -> None:
    recording = sample()
    write_mcap(recording, tmp_path / "a.mcap")
    messages: dict[str, list[object]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    imu = messages["/imu"]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in imu]
    assert stamps == (START_NS + np.rint(recording.imu.t * 1e9).astype(np.int64)).tolist()
    w = [[getattr(m.angular_velocity, a) for a in "xyz"] for m in imu]
    np.testing.assert_array_equal(w, recording.imu.gyro)
    f = [[getattr(m.linear_acceleration, a) for a in "xyz"] for m in imu]
    np.testing.assert_array_equal(f, recording.imu.accel)
    assert {m.orientation_covariance[0] for m in imu} == {-1.0}
    assert {m.header.frame_id for m in imu} == {"imu"}
    pose = messages["/pose"][3].pose
    found = [getattr(pose.position, a) for a in "xyz"]
    found += [getattr(pose.orientation, a) for a in "wxyz"]
    np.testing.assert_array_equal(found, recording.streams["pose"].value[3])
    field = messages["/mag"][3].magnetic_field
    np.testing.assert_array_equal([field.x, field.y, field.z], recording.streams["mag"].value[3])
    assert messages["/temperature"][3].temperature == recording.streams["temperature"].value[3, 0]
    q = messages["/heading"][3].quaternion
    yaw = np.arctan2(2 * (q.x * q.y + q.w * q.z), 1 - 2 * (q.y**2 + q.z**2))
    assert yaw == pytest.approx(recording.streams["heading"].value[3, 0], abs=1e-12)
    assert len(messages["/reference"]) == len(imu)


@given(hnp.arrays(np.float64, 20, elements=st.floats(-np.pi, np.pi)))
def test_yaw_survives_its_quaternion_to_the_last_bit(yaw: np.ndarray) -> None:
    yaw = np.where(yaw == -np.pi, np.pi, yaw)
    # smaller angles than the smallest normal number are zero
    yaw = np.where(np.abs(yaw) < 1e-300, 0.0, yaw)
    back = yaw_of_quaternions(quaternions_of_yaw(yaw[:, None]))
    np.testing.assert_array_equal(back[:, 0], yaw)


def test_folder_that_does_not_exist_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(HandcalError, match="could not be written"):
        write_mcap(sample(streams=False), tmp_path / "nowhere" / "a.mcap")


def test_time_beyond_ros_is_a_sentence(tmp_path: Path) -> None:
    late = replace(sample(streams=False), start_ns=2**31 * 10**9)
    with pytest.raises(HandcalError, match="2038"):
        write_mcap(late, tmp_path / "a.mcap")


@pytest.mark.parametrize(
    "name",
    [
        "array_1_imu5.mcap",
        *proved("broad_06_fast_rotation.mcap"),
    ],
)
def test_real_recordings_round_trip(real_recordings: Path, tmp_path: Path, name: str) -> None:
    first = load(real_recordings / name)
    write_mcap(first, tmp_path / name)
    assert_equal(first, load(tmp_path / name))

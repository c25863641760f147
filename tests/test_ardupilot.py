"""From a log of ArduPilot to its parameters: what is left is added to the vehicle's own."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import format_files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import DFReader_binary
from sample_recording import sample
from test_px4 import FRD, check_both_ways, result_of
from worlds import recording_of

import handcal
from handcal.device import apply as device
from handcal.exports import format_of
from handcal.exports._contents import contents
from handcal.types import HandcalError, InputError
from handcal_sim.scenario import simulate

OWN = {
    "INS_GYROFFS_X": 0.01, "INS_GYROFFS_Y": -0.02, "INS_GYROFFS_Z": 0.03,
    "INS_ACCOFFS_X": 0.3, "INS_ACCOFFS_Y": -0.74, "INS_ACCOFFS_Z": 0.1,
    "INS_ACCSCAL_X": 0.98, "INS_ACCSCAL_Y": 1.012, "INS_ACCSCAL_Z": 1.03,
    "AHRS_ORIENTATION": 0.0,
}  # fmt: skip
ELSEWHERE = {"INS_GYR2OFFS_X": 7.0, "INS_GYR_CAL": 1.0, "SCHED_LOOP_RATE": 400.0}


def by_axis(parameters):
    names = ("INS_GYROFFS_{}", "INS_ACCOFFS_{}", "INS_ACCSCAL_{}")
    return [np.array([parameters[name.format(a)] for a in "XYZ"]) for name in names]


def written(path):
    form = format_of("ardupilot")
    lines = form.write(contents(path, form)).splitlines()
    rows = [line.split(",") for line in lines if line and not line.startswith("#")]
    return {name: float(value) for name, value in rows}


@pytest.fixture(scope="module")
def hand():
    return replace(recording_of(simulate("free-hand", seed=0, duration_s=12.0)), streams={})


@pytest.fixture
def corrected(hand, tmp_path):
    """The raw readings (n, 3) of both sensors, and a log of what ArduPilot made of them by OWN."""
    raw = hand.imu.gyro * FRD, hand.imu.accel * FRD
    gyro_off, accel_off, scale = by_axis(OWN)
    gyro, accel = (raw[0] - gyro_off) * FRD, (raw[1] - accel_off) * scale * FRD
    one = replace(hand, imu=replace(hand.imu, gyro=gyro, accel=accel))

    def write(later=None, **how):
        path = tmp_path / "00000017.bin"
        path.write_bytes(
            format_files.dataflash(one, parameters=OWN | ELSEWHERE, later=later, **how)
        )
        return path

    return raw, write


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("as_mcap", [False, True])
def test_what_was_left_is_added_to_the_vehicles_own_calibration(
    corrected, tmp_path, raw, as_mcap
):  # fmt: skip
    """Raw readings, once by the file, are those of the log, once by `apply`."""
    readings, write = corrected
    log = write(raw=raw)
    check_both_ways(readings, log, as_mcap, tmp_path, lambda path: by_axis(written(path)))


def test_what_is_left_of_a_corrected_recording_is_refused(corrected, tmp_path):
    recording = handcal.read(corrected[1]())
    path = result_of(recording, tmp_path / "a.json")
    once = device.apply(recording, device.read(path), biases=True).recording
    with pytest.raises(HandcalError, match="--parameters FILE"):
        written(result_of(once, tmp_path / "b.json"))


def test_parameters_that_changed_in_the_log_are_not_taken_for_known(corrected, tmp_path):
    recording = handcal.read(corrected[1]({"INS_ACCOFFS_Y": 0.5, "INS_ACCOFFS_X": 0.3}))
    assert "ArduPilot's calibration changed during the log: INS_ACCOFFS_Y." in recording.warnings
    with pytest.raises(HandcalError, match="INS_ACCOFFS_Y"):
        written(result_of(recording, tmp_path / "a.json"))


def test_pymavlink_reads_the_same(corrected):
    """So the logs written here are ArduPilot's."""
    path = corrected[1]()
    rows, said = [], {}
    with contextlib.closing(DFReader_binary(str(path))) as log:
        while (m := log.recv_match(type=["IMU", "PARM"])) is not None:
            if m.get_type() == "PARM":
                said[m.Name] = m.Value
            elif m.I == 0:
                rows.append([m.TimeUS / 1e6, m.GyrX, m.GyrY, m.GyrZ, m.AccX, m.AccY, m.AccZ])
    got, table = handcal.read(path), np.array(rows)
    np.testing.assert_allclose(got.imu.t, table[:, 0] - table[0, 0], atol=1e-6)
    np.testing.assert_array_equal(got.imu.gyro, table[:, 1:4] * FRD)
    np.testing.assert_array_equal(got.imu.accel, table[:, 4:] * FRD)
    assert got.vehicle == {name: said[name] for name in OWN}
    assert set(said) == {*OWN, *ELSEWHERE}


def test_the_readings_at_full_rate_are_taken_and_it_is_said(corrected):
    slow, fast = (handcal.read(corrected[1](raw=raw)) for raw in (False, True))
    assert (slow.topics["imu"], fast.topics["imu"]) == ("IMU", "GYR, ACC")
    np.testing.assert_array_equal(fast.imu.accel, slow.imu.accel)
    for read, name in ((slow, "IMU"), (fast, "GYR, ACC")):
        said = f"{name}: ArduPilot has corrected it by a calibration of its own."
        assert said in read.warnings


def test_a_log_with_a_hole_gives_what_is_around_it(corrected):
    path = corrected[1]()
    whole, content = handcal.read(path), bytearray(path.read_bytes())
    middle = len(content) // 2
    path.write_bytes(content[:middle] + bytes(range(40)) + content[middle + 100 :])
    read = handcal.read(path)
    assert 0 < len(whole.imu.t) - len(read.imu.t) < 4
    assert any("damaged" in said for said in read.warnings)


def test_a_log_without_an_imu_is_a_sentence(tmp_path):
    path = tmp_path / "a.bin"
    # (of the second IMU alone)
    content = format_files.dataflash(format_files.small())
    layout = content.index(b"IMU\0QBff")
    path.write_bytes(content[:layout] + b"IMV\0" + content[layout + 4 :])
    with pytest.raises(InputError, match="neither IMU nor GYR and ACC"):
        handcal.read(path)


CONTENT = format_files.dataflash(sample(n=210), parameters=OWN)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_torn_and_mutated_logs_end_in_a_value_or_a_sentence(data, tmp_path_factory):
    content = bytearray(CONTENT)
    for _ in range(data.draw(st.integers(0, 4))):
        # (most of what matters stands in the formats at the beginning)
        at = data.draw(st.integers(3, 900) | st.integers(3, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(3, len(content)) | st.just(len(content)))
    path: Path = tmp_path_factory.mktemp("torn") / "a.bin"
    path.write_bytes(content[:cut])
    with contextlib.suppress(InputError):
        read = handcal.read(path)
        assert np.isfinite(read.imu.accel[read.imu.valid]).all()
        assert set(read.vehicle) <= set(OWN)

"""From a log of PX4 to its parameters: what the vehicle's own readings need is taken off them."""

import json
from dataclasses import replace

import format_files
import numpy as np
import pytest
import pyulog
from worlds import injected, recording_of

import handcal
from handcal.device import apply as device
from handcal.exports import format_of
from handcal.exports._contents import contents
from handcal.recordings.export import write_mcap
from handcal.show.calibration.summary import recording_json
from handcal.types import HandcalError
from handcal_sim.scenario import simulate

FRD = np.array([1.0, -1.0, -1.0])
EFFECTS = {
    "gyro_bias": [0.02, 0.03, -0.04],
    "accel_bias": [0.1, 0.2, -0.3],
    "accel_scale": [0.01, -0.02, 0.03],
}
# What the vehicle has of an earlier calibration.
OWN = {
    "CAL_GYRO0_ID": 1, "CAL_GYRO0_XOFF": 0.01, "CAL_GYRO0_YOFF": -0.02, "CAL_GYRO0_ZOFF": 0.03,
    "CAL_ACC0_ID": 1, "CAL_ACC0_ROT": -1, "CAL_ACC0_XOFF": 0.3, "CAL_ACC0_YOFF": -0.74,
    "CAL_ACC0_ZOFF": 0.1, "CAL_ACC0_XSCALE": 0.98, "CAL_ACC0_YSCALE": 1.012,
    "CAL_ACC0_ZSCALE": 1.03,
}  # fmt: skip
NAMES = ("CAL_GYRO0_{}OFF", "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE")


def by_axis(parameters):
    return [np.array([parameters[name.format(a)] for a in "XYZ"]) for name in NAMES]


def written(path):
    form = format_of("px4")
    rows = [line.split("\t") for line in form.write(contents(path, form)).split("\n")
            if line.startswith("1\t")]  # fmt: skip
    return {r[2]: float(r[3]) for r in rows}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A hand whose sensor errs by what the log, written in PX4's axes, has of it."""
    world = simulate("free-hand", seed=0, duration_s=30.0, effects=EFFECTS)
    path = tmp_path_factory.mktemp("px4") / "hand.ulg"
    path.write_bytes(format_files.ulog(recording_of(world), parameters=OWN))
    return world, path


def test_a_log_of_px4_becomes_parameters_with_its_own_signs(flown, tmp_path):
    """Readings of the raw log by PX4's formula are those of a sensor without these errors."""
    world, path = flown
    found = handcal.calibrate(path, "accel_scale")
    found.save(tmp_path / "a.json")
    gyro_off, accel_off, scale = by_axis(written(tmp_path / "a.json"))
    raw = {d.name: d.data for d in pyulog.ULog(str(path)).data_list}
    gyro, accel = (
        np.column_stack([raw[name][a] for a in "xyz"]).astype(float)
        for name in ("sensor_gyro", "sensor_accel")
    )
    gyro_bias, accel_bias = (FRD * injected(world, i) for i in ("gyro_bias", "accel_bias"))
    rate = gyro - gyro_bias
    force = (accel - accel_bias) / (1.0 + injected(world, "accel_scale"))
    # A wrong sign leaves twice the error; a right one a tenth, at 30 s.
    assert np.abs(gyro - gyro_off - rate).max() < 0.1 * np.abs(gyro_bias).min()
    assert np.abs((accel - accel_off) * scale - force).mean() < 0.3 * np.abs(accel_bias).min()


def test_the_readings_are_turned_and_it_is_said(flown):
    world, path = flown
    read = handcal.read(path)
    np.testing.assert_allclose(read.imu.accel, recording_of(world).imu.accel, atol=1e-5)
    assert any("forward, left, up" in said for said in read.warnings)
    assert read.topics == {"imu": "sensor_gyro, sensor_accel", "temperature": "sensor_accel"}


@pytest.fixture
def corrected(flown, tmp_path):
    """The raw readings (n, 3) of both sensors, and a log of what PX4 made of them by parameters."""
    read = handcal.read(flown[1])
    raw = read.imu.gyro * FRD, read.imu.accel * FRD
    gyro_off, accel_off, scale = by_axis(OWN)
    gyro, accel = (raw[0] - gyro_off) * FRD, (raw[1] - accel_off) * scale * FRD
    one = replace(read, imu=replace(read.imu, gyro=gyro, accel=accel), streams={})

    def write(later=None, **more):
        path = tmp_path / "combined.ulg"
        path.write_bytes(format_files.ulog(one, raw=False, parameters=OWN | more, later=later))
        return path

    return raw, write


def result_of(recording, path):
    """What ``calibrate`` would write of a recording, if it found EFFECTS in it."""
    rows = [
        {"effect": i, "name": axis, "value": v, "sigma": 1e-4, "unit": "", "observable": True}
        for i, values in EFFECTS.items()
        for axis, v in zip("xyz", values, strict=True)
    ]
    said = {"schema": "handcal/calibration/1", "recording": recording_json(recording, "auto"),
            "parameters": rows, "noise": [], "warnings": []}  # fmt: skip
    path.write_text(json.dumps(said))
    return path


def check_both_ways(raw, log, as_mcap, folder, found_in):
    """Raw readings (gyro, accel, forward right down) by what ``found_in`` reads of a result, and
    those of the log by `apply`."""
    recording = handcal.read(log)
    if as_mcap:
        write_mcap(recording, folder / "again.mcap")
        recording = handcal.read(folder / "again.mcap")
    path = result_of(recording, folder / "a.json")
    gyro_off, accel_off, scale = found_in(path)
    wanted = device.apply(recording, device.read(path), biases=True).recording.imu
    # (the log is in single precision)
    for got, same in (((raw[0] - gyro_off) * FRD, wanted.gyro),
                      ((raw[1] - accel_off) * scale * FRD, wanted.accel)):  # fmt: skip
        np.testing.assert_allclose(got, same, rtol=0, atol=1e-5)


@pytest.mark.parametrize("as_mcap", [False, True])
def test_what_px4_had_left_is_added_to_its_own_calibration(corrected, tmp_path, as_mcap):
    """Raw readings, once by the file, are those of the log, once by `apply`. The file had the
    residual errors as the whole calibration: 0.74 m/s^2 and 3 % off."""
    raw, write = corrected
    check_both_ways(raw, write(), as_mcap, tmp_path, lambda path: by_axis(written(path)))


def test_what_is_left_in_a_corrected_recording_is_not_added_to_the_vehicles_own(
    corrected, tmp_path
):
    """Between the two there is a correction that the vehicle does not have."""
    recording = handcal.read(corrected[1]())
    path = result_of(recording, tmp_path / "a.json")
    once = device.apply(recording, device.read(path), biases=True).recording
    with pytest.raises(HandcalError, match="--parameters FILE"):
        written(result_of(once, tmp_path / "b.json"))


def test_parameters_that_changed_in_the_log_are_not_taken_for_known(corrected, tmp_path):
    recording = handcal.read(corrected[1](later={"CAL_ACC0_YOFF": 0.5, "CAL_ACC0_XOFF": 0.3}))
    assert "PX4's calibration changed during the log: CAL_ACC0_YOFF." in recording.warnings
    path = result_of(recording, tmp_path / "a.json")
    with pytest.raises(HandcalError, match="CAL_ACC0_YOFF"):
        written(path)


def test_parameters_are_those_that_pyulog_reads(corrected):
    path = corrected[1](SENS_BOARD_ROT=0, SYS_AUTOSTART=4001)
    said = pyulog.ULog(str(path)).initial_parameters
    assert said.pop("SYS_AUTOSTART") == 4001
    assert handcal.read(path).vehicle == said

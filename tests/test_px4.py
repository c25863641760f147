"""From a log of PX4 to its parameters: what the vehicle's own readings need is taken off them."""

import format_files
import numpy as np
import pytest
import pyulog
from worlds import injected, recording_of

import handcal
from handcal.exports import format_of
from handcal.exports._contents import contents
from handcal_sim.scenario import simulate

FRD = np.array([1.0, -1.0, -1.0])
EFFECTS = {
    "gyro_bias": [0.02, 0.03, -0.04],
    "accel_bias": [0.1, 0.2, -0.3],
    "accel_scale": [0.01, -0.02, 0.03],
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A hand whose sensor errs by what the log, written in PX4's axes, has of it."""
    world = simulate("free-hand", seed=0, duration_s=30.0, effects=EFFECTS)
    path = tmp_path_factory.mktemp("px4") / "hand.ulg"
    path.write_bytes(format_files.ulog(recording_of(world)))
    return world, path


def test_a_log_of_px4_becomes_parameters_with_its_own_signs(flown, tmp_path):
    """Readings of the raw log by PX4's formula are those of a sensor without these errors."""
    world, path = flown
    found = handcal.calibrate(path, "accel_scale")
    found.save(tmp_path / "a.json")
    form = format_of("px4")
    rows = [line.split("\t") for line in form.write(contents(tmp_path / "a.json", form)).split("\n")
            if line.startswith("1\t")]  # fmt: skip
    value = {r[2]: float(r[3]) for r in rows}
    names = ("CAL_GYRO0_{}OFF", "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE")
    gyro_off, accel_off, scale = (np.array([value[n.format(a)] for a in "XYZ"]) for n in names)
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

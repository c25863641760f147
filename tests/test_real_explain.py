"""What `explain`, told nothing, finds in recordings of real hands (run by `make prove`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handcal import load
from handcal.explain import explain

pytestmark = pytest.mark.prove


@pytest.mark.parametrize(
    ("name", "drawn"),
    [("array_1_imu5", (0.0189, 0.0, 0.0)), ("array_2_imu3", (0.0, -0.0189, 0.0))],
)
def test_the_arm_between_two_imus_is_found_untold(name, drawn, real_recordings: Path):
    """Within 1.5 mm of the board's drawing, with the scale differences; residuals halved. (Beside
    an error of the gyro that goes with the rate its scale is shown, but not named.)"""
    found = explain([load(real_recordings / f"{name}.mcap")])
    missing = {m.effect: m for m in found.missing}
    assert {"lever_arm", "accel_scale"} <= set(missing)
    assert "gyro_scale" in {p.effect for p in found.parameters if p.shown}
    arm = np.array([p.value for p in missing["lever_arm"].parameters])
    print(f"{name}: {found.verdict}, arm {1e3 * arm} mm")
    assert np.linalg.norm(arm - drawn) < 0.0015
    assert found.held_out is not None
    assert found.held_out.log_score_after > found.held_out.log_score_before


def test_a_hand_held_imu_against_motion_capture(real_recordings: Path):
    """Arm within 4 mm of the estimate given with the recording; lags as known from it."""
    found = explain([load(real_recordings / "broad_06_fast_rotation.mcap")])
    value = {p.effect: p.value for p in found.parameters if p.name in ("delay", "tau")}
    arm = [found_.value for found_ in found.parameters if found_.effect == "lever_arm"]
    print(f"arm {arm}, {value}")
    assert np.linalg.norm(np.array(arm) - [-0.002, 0.001, 0.012]) < 0.004
    # a lag of the gyro is a delay of all others, to the first order
    lag = value.get("gyro_bandwidth", 0.0)
    assert value["pose_delay"] - lag == pytest.approx(-0.0041, abs=0.0015)
    assert value.get("accel_delay", 0.0) - lag == pytest.approx(-0.0016, abs=0.0015)


def test_a_real_hand_that_holds_no_point_has_no_size_effect(real_recordings: Path):
    """Seventy seconds in the hand without the pose, which knows that there is none: 13 nats of it
    were named beside the arm of the hand."""
    whole = load(real_recordings / "broad_01_slow_rotation.mcap")
    begin, end = whole.imu.t[0] + 25.0, whole.imu.t[0] + 95.0
    inside = (whole.imu.t >= begin) & (whole.imu.t <= end)
    imu = replace(
        whole.imu,
        **{name: getattr(whole.imu, name)[inside] for name in ("t", "gyro", "accel", "valid")},
    )
    mag = whole.streams["mag"]
    seen = (mag.t >= begin) & (mag.t <= end)
    streams = {"mag": replace(mag, t=mag.t[seen], value=mag.value[seen])}
    found = explain([replace(whole, imu=imu, streams=streams)])
    print(found.verdict, [m.effect for m in found.missing])
    assert {"lever_arm", "gyro_scale"} <= {m.effect for m in found.missing}
    assert "size_effect" not in {m.effect for m in found.missing}

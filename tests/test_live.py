"""The filter as it runs: its frames know the past and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

import handcal
from handcal.estimate.live import live_frames
from handcal.show.frames import layout_of
from handcal_sim import simulate, write

LEVELS = {"gyro_noise": 1e-3, "accel_noise": 5e-3, "sway": 0.004, "sway_per_rate": 0.004,
          "sway_time": 0.5, "position_noise": 3e-4}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "x.mcap"
    write(simulate("three-turns", seed=5, duration_s=12.0), path)
    return calibrated(handcal.load(path), only=True)


def calibrated(recording, only):
    options = {"assume": "fixed-point", "noise": LEVELS, "heading_sigma": 0.09}
    return handcal.calibrate(recording, ["gyro_scale"], **options, only=only)


@pytest.fixture(scope="module")
def frames(result):
    return list(live_frames(result, rate_hz=20))


def test_frames_come_evenly_and_hold_every_update(result, frames):
    t = np.array([f.t for f in frames])
    assert np.all(np.diff(t) > 0.03)
    assert len(t) == pytest.approx(20 * 12, abs=2)
    for kind, i in result.innovations.items():
        n = sum(o.kind == kind for f in frames for o in f.observed)
        assert n == pytest.approx((i.t <= t[-1]).sum(), rel=0.02)
    measured = [f.heading for f in frames if f.heading is not None]
    assert len(measured) > 100
    assert set(np.round(measured, 9)) <= set(
        np.round(result.recording.streams["heading"].value[:, 0], 9)
    )


def test_the_last_frame_is_where_the_calibration_ends(result, frames):
    """Nearly: a live filter levels itself with a bias it does not know yet, which leaves errors
    of the tilt squared; the calibration goes back over the recording until none are left."""
    last = frames[-1]
    for p, value, sigma in zip(result.parameters, last.parameters, last.sigma, strict=True):
        assert abs(value - p.value) < 5 * p.sigma, p
        assert sigma == pytest.approx(p.sigma, rel=0.2), p


def test_with_all_that_a_device_has_it_ends_there_too(result):
    """A filter has the usual scale of each prior alone, a calibration wider ones as well: of what
    is not shown the filter is the surer. Headings are drawn as they were measured, whatever the
    irons are taken to be."""
    whole = calibrated(result.recording, only=False)
    *_, last = frames = list(live_frames(whole, rate_hz=20))
    assert len(whole.parameters) > 30
    for p, value, sigma in zip(whole.parameters, last.parameters, last.sigma, strict=True):
        assert abs(value - p.value) < 5 * p.sigma, p
        assert 0.5 * p.sigma < sigma < 1.2 * p.sigma, p
    measured = [f.heading for f in frames if f.heading is not None]
    assert len(measured) > 100
    assert set(np.round(measured, 9)) <= set(
        np.round(result.recording.streams["heading"].value[:, 0], 9)
    )


def test_a_frame_knows_nothing_of_what_is_to_come(result, frames):
    recording, end = result.recording, 6.0
    n = int(np.searchsorted(recording.imu.t, end))
    imu = recording.imu
    cut = replace(imu, t=imu.t[:n], gyro=imu.gyro[:n], accel=imu.accel[:n], valid=imu.valid[:n])
    past = list(live_frames(replace(result, recording=replace(recording, imu=cut)), rate_hz=20))
    pairs = [(a, b) for a, b in zip(past, frames, strict=False) if a.t < end - 0.5]
    assert len(pairs) > 100
    for a, b in pairs:
        np.testing.assert_allclose(a.parameters, b.parameters, rtol=0, atol=1e-9)
        np.testing.assert_allclose(a.q_nb, b.q_nb, rtol=0, atol=1e-9)


def test_both_engines_show_the_same(result, frames):
    other = list(live_frames(result, engine="filterpy", rate_hz=20))
    assert [f.t for f in other] == [f.t for f in frames]
    for a, b in zip(other, frames, strict=True):
        np.testing.assert_allclose(a.parameters, b.parameters, rtol=0, atol=1e-6)
        np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-4)


def test_frames_fit_the_layout(result, frames):
    layout = layout_of(result, live=True)
    assert "is running" in layout.text
    assert {o.kind for f in frames for o in f.observed} == set(layout.kinds)
    assert len(frames[0].parameters) == sum(len(g.columns) for g in layout.groups) == 9

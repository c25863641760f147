"""How the marker of a pose is turned on the device is found, said and handed on."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import schemas
import yaml
from fake_explanation import fake_explanation
from proved import proved
from rich.console import Console
from worlds import recording_of

import handcal
from handcal.compiled import so3
from handcal.exports import format_of
from handcal.exports._contents import contents
from handcal.show.calibration.report import render
from handcal.show.calibration.summary import calibration_json
from handcal.show.calibration.terminal import print_summary
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.report import render_explanation
from handcal.show.explanation.terminal import print_explanation
from handcal.types import MarkerRotation
from handcal_sim import simulate
from handcal_sim.companions import Pose
from handcal_sim.phone import consumer_phone

TURNED = so3.matrix_exp(np.array([0.4, -1.1, 2.0]))  # marker to IMU


def filmed(rng: np.random.Generator):
    return replace(consumer_phone(rng), pose=Pose(sigma_m=1e-3, sigma_rad=2e-3, C_bm=TURNED))


@pytest.fixture(scope="module", params=[0, *proved(1, 2)])
def found(request):
    world = simulate("free-hand", seed=request.param, duration_s=40.0, phone=filmed,
                     effects={"lever_arm": [0.1, -0.05, 0.2]})  # fmt: skip
    return handcal.calibrate(recording_of(world, "pose"))


def turned(quaternion):
    """Rotation from the IMU's axes to the marker's, off what it is, rad, about the IMU's axes."""
    return so3.matrix_log((TURNED @ so3.matrix_of(np.array([quaternion]))[0])[None])[0]


def test_it_is_the_truth_within_its_sigmas(found):
    said = calibration_json(found)
    schemas.check(said | {"version": "1"})
    marker = said["marker_rotation"]
    assert np.linalg.norm(marker["quaternion"]) == pytest.approx(1.0)
    sigma = np.array(marker["sigma"])
    assert sigma.max() < math.radians(0.5)
    assert (np.abs(turned(marker["quaternion"])) < 4.0 * sigma).all()


@pytest.mark.usefixtures("no_figures")
def test_terminal_and_page_say_it(found):
    console = Console(width=200, record=True)
    print_summary(found, console)
    degrees = math.degrees(np.linalg.norm(so3.matrix_log(TURNED[None])[0]))
    words = f"The marker's axes are turned by {degrees:.0f}"[:-1]  # (to ten degrees)
    assert words in console.export_text()
    assert words in render(found).replace("&#39;", "'")


@pytest.mark.parametrize("name", ["kalibr", "openvins"])
def test_a_chain_has_it_as_its_body(found, tmp_path, name):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(calibration_json(found)))
    form = format_of(name)
    chain = yaml.safe_load(form.write(contents(path, form)).removeprefix("%YAML:1.0\n"))["imu0"]
    T = np.array(chain["T_i_b"])
    off = so3.matrix_log((T[:3, :3] @ TURNED.T)[None])[0]
    assert np.linalg.norm(off) < math.radians(1.0)
    # where the marker sits, as seen from the IMU
    np.testing.assert_allclose(T[:3, 3], [-0.1, 0.05, -0.2], atol=0.01)
    np.testing.assert_array_equal(T[3], [0.0, 0.0, 0.0, 1.0])


@pytest.mark.usefixtures("no_figures")
def test_an_explanation_says_it_of_each_recording():
    turned = MarkerRotation(np.array([0.5, 0.5, 0.5, 0.5]), np.radians([0.1, 0.2, 0.3]))
    for count in (1, 2):
        explained = fake_explanation("explained", recordings=count)
        each = tuple(replace(r, marker=turned) for r in explained.recordings)
        explained = replace(explained, recordings=each)
        document = explanation_json(explained)
        schemas.check(document | {"version": "1"})
        for said in document["recordings"] if count > 1 else [document]:
            assert said["marker_rotation"]["quaternion"] == [0.5, 0.5, 0.5, 0.5]
        console = Console(width=200, record=True)
        print_explanation(explained, console)
        for text in (console.export_text(), render_explanation(explained)):
            assert text.count("axes are turned by 120.00° about (0.58, 0.58, 0.58)") == count
            assert text.count("± 0.3°.") == count


def test_without_a_pose_there_is_none():
    world = simulate("free-hand", seed=0, duration_s=20.0)
    assert "marker_rotation" not in calibration_json(
        handcal.calibrate(recording_of(world), only=True)
    )


@pytest.mark.prove
@pytest.mark.parametrize(
    ("name", "about"),
    [
        # motion capture whose poses BROAD gives in the IMU's axes
        ("broad_01_slow_rotation", [0.0, 0.0, 0.0]),
        # a phone's camera, mounted a quarter turn from the axes of its screen
        ("devices/iphone_arkit", [0.0, 0.0, 90.0]),
    ],
)
def test_real_markers_sit_as_they_were_mounted(real_recordings, name, about):
    marker = handcal.calibrate(real_recordings / f"{name}.mcap").marker
    mounted = so3.matrix_exp(np.radians(about))
    off = so3.matrix_log((so3.matrix_of(marker.quaternion[None])[0] @ mounted.T)[None])[0]
    assert np.degrees(np.linalg.norm(off)) < 1.0


@pytest.mark.prove
def test_a_real_marker_sits_as_its_turns_say(real_recordings):
    """Turns of a second by the gyro and by Vicon, 0.199 s apart, compared without a filter."""
    recording = handcal.load(real_recordings / "devices" / "euroc_v203.mcap")
    marker = handcal.calibrate(recording).marker
    imu, pose = recording.imu, recording.streams["pose"]
    rate = imu.gyro - [-0.0016, 0.0247, 0.0805]  # (the data set's own bias)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.t)[:, None]
    C = [np.eye(3)]
    for step in steps:
        C.append(C[-1] @ so3.matrix_exp(step))
    C_gyro = np.array(C)[np.clip(np.searchsorted(imu.t, pose.t + 0.199), 0, len(C) - 1)]
    C_pose = so3.matrix_of(pose.value[:, 3:])
    apart = round(1.0 / float(np.median(np.diff(pose.t))))
    a, b = (so3.matrix_log(c[:-apart].transpose(0, 2, 1) @ c[apart:]) for c in (C_pose, C_gyro))
    size = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    sound = (size[0] < 2.5) & (np.abs(size[0] - size[1]) < 0.05)
    U, _, Vt = np.linalg.svd(b[sound].T @ a[sound])
    R_bm = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    off = so3.matrix_log((R_bm @ so3.matrix_of(marker.quaternion[None])[0])[None])[0]
    assert (np.abs(off) < 3.0 * marker.sigma).all()

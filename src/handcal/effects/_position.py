"""A sensor at another place of the body (no effect of its own: a lever arm needs it)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal.compiled import so3
from handcal.effects import Known
from handcal.effects._derivative import derivative
from handcal.types import Array, Recording, Series

# Left out, these would turn the marker against the IMU by a degree in real recordings.
TURNS_MARKER = (
    "lever_arm", "gyro_scale", "gyro_misalignment", "accel_scale", "accel_misalignment",
    "accel_delay", "pose_delay",
)  # fmt: skip
# Rotation vectors of larger turns (rad) are no longer unique.
MOST_TURN = 2.0


def placed(r: Array, recording: Recording, known: Known) -> Recording:
    """The IMU at r (3,) m: with a pose alone it is exact to move the marker the other way; else
    the accelerometer swings."""
    if "pose" in recording.streams and "reference" not in recording.streams:
        streams = {**recording.streams, "pose": _moved_marker(recording, r, known)}
        return replace(recording, streams=streams)
    imu, truth = recording.imu, known.unbiased
    w, alpha = truth.gyro, derivative(truth.t, truth.gyro)
    swing = np.cross(alpha, r) + np.cross(w, np.cross(w, r))
    return replace(recording, imu=replace(imu, accel=imu.accel + swing))


def _moved_marker(recording: Recording, r: Array, known: Known) -> Series:
    """The IMU stays, so the marker goes to -r from where it was, in the IMU's axes.

    How the marker is turned against those shows in turns that both made within a second.
    """
    pose = known.recording.streams["pose"]
    late = known.result(TURNS_MARKER).parameter("pose_delay", "delay").value
    step = max(1, round(1.0 / float(np.median(np.diff(pose.t)))))
    turns = [
        so3.matrix_log(C[:-step].transpose(0, 2, 1) @ C[step:])
        for C in (so3.matrix_of(pose.value[:, 3:]), known.attitude(pose.t - late, TURNS_MARKER))
    ]
    usable = np.linalg.norm(turns[0], axis=1) < MOST_TURN
    U, _, Vt = np.linalg.svd(turns[1][usable].T @ turns[0][usable])
    R_bm = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    value = recording.streams["pose"].value.copy()
    value[:, :3] -= so3.matrix_of(value[:, 3:]) @ (R_bm.T @ r)
    return Series(pose.t, value)

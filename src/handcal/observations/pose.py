"""The measured pose of a marker on the device (motion capture, a camera).

The marker's axes and the pose's world are turned against b and n by unknown constants.
Both are first aligned roughly from the recording itself (turns seen by both sensors;
gravity on average), then what remains is estimated: ``theta`` holds the world's (3,) and
the marker's (3,) rotation vectors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import lean, local_matrix, local_vector, residual_function
from handcal.observations import Constant, Observation, Rows, Scene
from handcal.observations._turning import Turning
from handcal.types import Array, InputError, Level, Recording, Series

# Rows a second at the most. What they say of the sensors is limited by the IMU's own noise and by
# what neighbours share: of two optical trackers and a phone's odometry 10 tell as much of gyro and
# accelerometer as 25, to 7 % of a sigma (20 % of a delay's); their own delay has 1.7 times its
# sigma.
MAX_RATE = 10.0
# Turns of gyro and marker are compared over so long, s; so few are none.
TURN_S, LEAST_TURNS = 0.2, 10
# How far the rough alignment may be wrong, rad: what is estimated of it begins with this sigma.
ALIGNED = 0.1

# Marker sets are seen from other sides, and by other cameras, as the device turns:
# position (3,) m, attitude (3,) rad.
DISTORTION = ("pose_position_distortion",) * 3 + ("pose_attitude_distortion",) * 3


@lean
def _rotation(theta: Any, first: int, out: Array) -> None:
    phi = local_vector(3)
    for i in range(3):
        phi[i] = theta[first + i]
    so3.exp(phi, out)


@lean
def _log(C: Array, out: Array) -> None:
    """Rotation vector of a matrix away from half a turn (residuals are small)."""
    out[0] = 0.5 * (C[2, 1] - C[1, 2])
    out[1] = 0.5 * (C[0, 2] - C[2, 0])
    out[2] = 0.5 * (C[1, 0] - C[0, 1])
    sine = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    angle = math.atan2(sine, 0.5 * (C[0, 0] + C[1, 1] + C[2, 2] - 1.0))
    if sine >= 1e-7:
        for i in range(3):
            out[i] *= angle / sine


@lean
def _angle(nav: Any, theta: Any, z: Any, world: Array, out: Array) -> None:
    """Rotation vector (3,) from the attitude that is predicted to the one that was measured, and
    the world's rotation (3, 3)."""
    marker, C, measured = local_matrix(3, 3), local_matrix(3, 3), local_matrix(3, 3)
    D, back = local_matrix(3, 3), local_matrix(3, 3)
    _rotation(theta, 0, world)
    _rotation(theta, 3, marker)
    so3.matrix_into(z[3], z[4], z[5], z[6], measured)
    for i in range(3):
        for j in range(3):
            C[i, j] = nav[6 + 3 * i + j]
    so3.matmul(world, C, D)
    so3.matmul(D, marker, C)
    for i in range(3):
        for j in range(3):
            back[j, i] = C[i, j]
    so3.matmul(measured, back, D)
    _log(D, out)


def _residual(nav: Any, theta: Any, z: Any, r: Any) -> int:
    world, angle = local_matrix(3, 3), local_vector(3)
    _angle(nav, theta, z, world, angle)
    for i in range(3):
        # the world's rotation is taken off the measurement, so that r is in n
        r[i] = world[0, i] * z[0] + world[1, i] * z[1] + world[2, i] * z[2] - nav[i]
        r[3 + i] = angle[i]
    return 0


def _jacobian(nav: Any, theta: Any, z: Any, H: Any) -> int:
    # An attitude error psi turns what is left, exp(a), into exp(a) exp(-W psi): its rotation vector
    # falls by the inverse right Jacobian of a, times W psi.
    world, a = local_matrix(3, 3), local_vector(3)
    _angle(nav, theta, z, world, a)
    square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    size = math.sqrt(square)
    bend = 1.0 / 12.0
    if size > 1e-3:
        bend = (1.0 - 0.5 * size / math.tan(0.5 * size)) / square
    for i in range(3):
        H[15 * i + i] = 1.0
        j, k = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            along = a[0] * world[0, c] + a[1] * world[1, c] + a[2] * world[2, c]
            cross = a[j] * world[k, c] - a[k] * world[j, c]
            twice = a[i] * along - square * world[i, c]
            H[15 * (3 + i) + 6 + c] = world[i, c] + 0.5 * cross + bend * twice
    return 0


def _bent(nav: Any, bend: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    for i in range(6):
        r[i] -= bend[i]
    return 0


def _step(pose: Series) -> int:
    """Rows of the pose from the beginning to the end of a turn."""
    return max(1, round(TURN_S / float(np.median(np.diff(pose.t)))))


def _turns(recording: Recording, pose: Series, C_wm: Array) -> tuple[Array, Array]:
    """Rotation vectors over ``TURN_S`` as the marker and the gyro saw them, each (k, 3)."""
    step = _step(pose)
    a, b = C_wm[:-step], C_wm[step:]
    marker = so3.matrix_log(a.transpose(0, 2, 1) @ b)
    imu = recording.imu
    steps = 0.5 * (imu.gyro[1:] + imu.gyro[:-1]) * np.diff(imu.t)[:, None]
    angle = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    at = np.stack([np.interp(pose.t, imu.t, angle[:, i]) for i in range(3)], axis=1)
    gyro = at[step:] - at[:-step]
    small = np.linalg.norm(marker, axis=1) < 0.5
    return marker[small], gyro[small]


def _rotation_between(a: Array, b: Array) -> Array:
    """Rotation R (3, 3) that best takes rows of a to rows of b (Kabsch)."""
    a, b = a - a.mean(0), b - b.mean(0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _sigma(R: Array, a: Array, b: Array, step: int) -> float:
    """How far R may be wrong about the axis that rows of a and b (k, 3) tell least of, rad; each
    row shares its time with ``step`` others."""
    a, b = a - a.mean(0), b - b.mean(0)
    variance = float(np.mean((b - a @ R.T) ** 2)) * step
    both = R @ a.T @ b  # (of what both saw: the noise of one alone is no turn)
    seen = np.eye(3) * np.trace(both) - 0.5 * (both + both.T)
    least = float(np.linalg.eigvalsh(seen)[0])
    return math.sqrt(variance / least) if least > 0.0 else math.inf


def _level(up: Array) -> Array:
    """The smallest rotation that takes the unit vector ``up`` to (0, 0, 1)."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    s = float(np.linalg.norm(axis))
    if s < 1e-12:
        return np.eye(3)
    return so3.matrix_exp(axis / s * math.atan2(s, up[2]))


def aligned(recording: Recording, pose: Series) -> tuple[Array, Array]:
    """R_bm (3, 3), which takes the marker's axes to b, and R_nw, which levels the pose's world.

    From turns that gyro and marker both saw, and from gravity; the world's yaw is kept.
    Raises InputError where the motion turns about too few axes.
    """
    C_wm = so3.matrix_of(pose.value[:, 3:])
    marker, gyro = _turns(recording, pose, C_wm)
    R_bm = _rotation_between(marker, gyro) if len(gyro) > LEAST_TURNS else np.eye(3)
    if len(gyro) <= LEAST_TURNS or _sigma(R_bm, marker, gyro, _step(pose)) > ALIGNED:
        raise InputError(
            "The motion turns about too few axes to align the pose's marker with the IMU."
        )
    imu = recording.imu
    inside = (pose.t >= imu.t[0]) & (pose.t <= imu.t[-1])
    force = np.stack([np.interp(pose.t[inside], imu.t, imu.accel[:, i]) for i in range(3)], axis=1)
    up = np.einsum("kij,kj->i", C_wm[inside] @ R_bm.T, force)
    return R_bm, _level(up / np.linalg.norm(up))


def _rows(recording: Recording, scene: Scene) -> Rows | None:
    pose = recording.streams.get("pose")
    if pose is None:
        return None
    R_bm, R_nw = aligned(recording, pose)
    if scene.align_yaw is not None:
        first = int(np.searchsorted(pose.t, recording.imu.t[0]))
        C_wb = so3.matrix_of(pose.value[first, 3:]) @ R_bm.T
        turn = scene.align_yaw - float(so3.yaw_of(R_nw @ C_wb))
        R_nw = so3.matrix_exp(np.array([0.0, 0.0, turn])) @ R_nw
    thin = pose.thinned(MAX_RATE)
    q = so3.quaternion_of(R_nw @ so3.matrix_of(thin.value[:, 3:]) @ R_bm.T)
    return Rows(thin.t, np.hstack([thin.value[:, :3] @ R_nw.T, q]))


def _variance(levels: Mapping[str, float]) -> Array:
    position, attitude = levels["pose_position_noise"], levels["pose_attitude_noise"]
    return np.repeat([position**2, attitude**2], 3)


def _constants(scene: Scene) -> tuple[Constant, ...]:
    yaw = 1.0 if scene.has_heading else 1e-6
    return (
        Constant("world_x", "rad", ALIGNED),
        Constant("world_y", "rad", ALIGNED),
        Constant("world_z", "rad", yaw),
        Constant("marker_x", "rad", ALIGNED),
        Constant("marker_y", "rad", ALIGNED),
        Constant("marker_z", "rad", ALIGNED),
    )


def _moved(recording: Recording, series: Series, C_nb: Array, shift: Array) -> Series:
    """Shifts are in n, the readings in the pose's world: both know the device's attitude."""
    R_bm, _ = aligned(recording, recording.streams["pose"])
    C_wm = so3.matrix_of(series.value[:, 3:])
    C_wn = C_wm @ R_bm.T @ C_nb.transpose(0, 2, 1)
    position, turn = (np.einsum("kij,kj->ki", C_wn, x) for x in (shift[:, :3], shift[:, 3:]))
    q = so3.quaternion_of(so3.rotations(turn) @ C_wm)
    return Series(series.t, np.hstack([series.value[:, :3] + position, q]))


OBSERVATION = Observation(
    kind="pose",
    title="measured pose",
    dim=6,
    channels=("position_x", "position_y", "position_z", "attitude_x", "attitude_y", "attitude_z"),
    unit="m, rad",
    residual=residual_function(_residual),
    jacobian=residual_function(_jacobian),
    rows=_rows,
    levels=(
        Level("pose_position_noise", "m", 0.001, 2e-5, 0.1),
        Level("pose_attitude_noise", "rad", 0.001, 5e-5, 0.3),
        Level("pose_position_distortion", "m", 0.0005, 2e-5, 0.1),
        Level("pose_attitude_distortion", "rad", 0.003, 1e-4, 0.3),
    ),
    variance=_variance,
    places=True,
    constants=_constants,
    markov=Turning(*DISTORTION),
    markov_residual=residual_function(_bent),
    moved=_moved,
)

"""What the sensors should have read according to a fit, and what they read beyond that.

A settled fit is a trajectory and the noise that it implies: of two epochs with the readings
between them, the noise is what turns one state into the other. Taken off the readings it
leaves what the model says they should have been, biases and effects included. There is
**no implied noise at a finer resolution than the epochs**: the mean over the time between
two observations (10 Hz for pseudo-observations) is all that a trajectory can tell, so what
is quicker, the white noise of single samples included, stays in the simulated readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import BASE
from handcal.effects import DELAY
from handcal.estimate.linear import Linear
from handcal.observations import Observation
from handcal.observations.pose import aligned
from handcal.recordings.streams import observed_by
from handcal.types import Array, BoolArray, Imu, Recording, Series

SLOT_S = 0.1
IMU_CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


@dataclass(frozen=True)
class _Seen:
    """The used observations of one kind: stamps t (k,) s, residual r (k, d) observed minus
    predicted, sway and distortion included, z (k, zdim), nominal C_nb (k, 3, 3)."""

    t: Array
    r: Array
    z: Array
    C_nb: Array


def twin(linear: Linear) -> Recording:
    """The simulated counterpart of a recording: its streams as the fitted model says they read.

    IMU at its own stamps, in sensor units; heading, mag and pose at the stamps at which they
    were used, as trajectory and effects have them: noise with a memory that every model
    allows for (a bent field, a marker seen from another side) is left out like any noise.
    """
    imu = linear.problem.recording.imu
    at, noise = _against_known(linear) or _intervals(linear)[:2]
    noise = np.stack([np.interp(imu.t, at, noise[:, i]) for i in range(6)], axis=1)
    simulated = Imu(imu.t, imu.gyro - noise[:, :3], imu.accel - noise[:, 3:], _all(len(imu.t)))
    streams = {}
    for observation in linear.problem.observations:
        seen, row = _seen(linear, observation.kind), observed_by(observation.kind)
        if row is not None and observation.moved is not None and seen is not None and len(seen.t):
            streams[row.name] = _predicted(linear, observation, seen)
    recording = linear.problem.recording
    return Recording(recording.path, simulated, streams, recording.start_ns)


def sensor_residuals(linear: Linear, slot: float = SLOT_S) -> dict[str, tuple[Array, Array]]:
    """What was read beyond what the fit says, by the contract's channels: (t (k,) s, (k,)).

    ``gyro_x`` ... ``accel_z`` in rad/s and m/s^2 from the implied noise, a mean over each
    ``slot`` seconds (or over the time between two epochs, if longer: nothing finer exists);
    with a known input, reading by reading against that.
    It is the noise that a smoother implies, hence smaller than the sensors' own wherever the
    trajectory is free to follow them. Times in which a reading was no measurement (saturated,
    missing) are left out. ``heading`` rad, ``mag_x`` ... tesla, ``position_x`` ... m,
    ``velocity_x`` ... m/s and ``attitude_x`` ... rad (in n) at the observations' own times.
    Sway and distortion, noise with a memory, are part of them: whatever physics a model lacks
    hides there first, and a residual without them would shrink as the model gets worse.
    """
    at, noise = _against_known(linear) or _in_slots(linear, slot)
    out = {name: (at, noise[:, i]) for i, name in enumerate(IMU_CHANNELS)}
    for observation in linear.problem.observations:
        seen = _seen(linear, observation.kind)
        if seen is None:
            continue
        for i, channel in enumerate(observation.channels):
            # (a zero rate is only nearly true: the gyro is judged by the noise it implies)
            if channel not in IMU_CHANNELS and (channel not in out or observation.kind == channel):
                out[channel] = (seen.t, seen.r[:, i])
    return out


def _all(n: int) -> BoolArray:
    return np.ones(n, dtype=np.bool_)


def _against_known(linear: Linear) -> tuple[Array, Array] | None:
    """Times (k,) s and noise of the IMU (k, 6) against a known input, if there is one."""
    known = _seen(linear, "known_input")
    return None if known is None or not len(known.t) else (known.t, -known.r)


def _in_slots(linear: Linear, slot: float) -> tuple[Array, Array]:
    """Times (k,) s and mean implied noise (k, 6) of slots in which something was measured."""
    middle, noise, dt = _intervals(linear)
    begin = linear.t[:-1]
    first = np.searchsorted(begin, np.arange(begin[0], linear.t[-1], slot))
    first = np.unique(first.clip(max=len(dt) - 1))
    weight = np.where(linear.Q_extra[1:].any(axis=(1, 2)), 0.0, dt)
    total = np.add.reduceat(weight, first)
    kept = total > 0.0
    mean = np.add.reduceat(weight[:, None] * noise, first)[kept] / total[kept, None]
    return np.add.reduceat(weight * middle, first)[kept] / total[kept], mean


def _intervals(linear: Linear) -> tuple[Array, Array, Array]:
    """Middle (k - 1,) s, mean implied noise (k - 1, 6) in b, and length s between the epochs.

    d of the linearised problem is what integrating the readings makes of the epoch before,
    minus this one: the noise's own integral. A gyro's noise turns the force as well; that
    part of the velocity is not the accelerometer's.
    """
    nominal, t = linear.trajectory, linear.t
    dt = np.maximum(np.diff(t), 1e-6)[:, None]
    force = np.diff(nominal.v, axis=0) / dt - linear.problem.g_n
    turn = linear.d[1:, 6:9]
    velocity = linear.d[1:, 3:6] - 0.5 * dt * np.cross(turn, force)
    C = nominal.C
    half = 0.5 * so3.matrix_log(C[:-1].transpose(0, 2, 1) @ C[1:])
    middle = C[:-1] @ so3.rotations(half)
    noise = np.hstack([np.einsum("kji,kj->ki", middle, x) / dt for x in (turn, velocity)])
    return 0.5 * (t[1:] + t[:-1]), noise, dt[:, 0]


def _seen(linear: Linear, kind: str) -> _Seen | None:
    """The used observations of a kind, None if it is not among the problem's."""
    kinds = [o.kind for o in linear.problem.observations]
    if kind not in kinds:
        return None
    number = kinds.index(kind)
    mine = (linear.kind == number) & linear.used
    epoch = np.repeat(np.arange(len(linear.t)), np.diff(linear.first))[mine]
    observations, z = linear.problem.observations, linear.problem.nodes.z[mine]
    r = linear.r[mine, : observations[number].dim]
    # The kind's own Markov states enter r linearly: put back what they took off.
    sizes = [0 if o.markov is None else o.markov.size for o in observations]
    own = slice(sum(sizes[:number]), sum(sizes[: number + 1]))
    H = linear.H[mine, : r.shape[1], BASE + linear.problem.constants :][:, :, own]
    r = r + np.einsum("kij,kj->ki", H, linear.trajectory.markov[epoch, own])
    return _Seen(linear.t[epoch] + z[:, DELAY], r, z, linear.trajectory.C[epoch])


def _predicted(linear: Linear, observation: Observation, seen: _Seen) -> Series:
    """A stream as the fit says it read, in the units and axes of the recording."""
    if observation.kind == "pose":
        return _pose(linear, seen)
    read = Series(seen.t, seen.z[:, : seen.r.shape[1]])
    assert observation.moved is not None
    return observation.moved(linear.problem.recording, read, seen.C_nb, -seen.r)


def _pose(linear: Linear, seen: _Seen) -> Series:
    """Poses moved by their residual, back in the tracker's world and the marker's axes."""
    problem = linear.problem
    recording = problem.recording
    raw = recording.streams["pose"]
    row = int(np.argmin(np.abs(raw.t - seen.t[0])))
    R_bm, _ = aligned(recording, raw)
    C_as_seen = so3.matrix_of(seen.z[:, 3:7])
    R_nw = C_as_seen[0] @ R_bm @ so3.matrix_of(raw.value[row, 3:]).T
    at = next(i for i, s in enumerate(problem.slots) if s.owner == "pose")
    world = so3.matrix_exp(linear.trajectory.constants[at : at + 3])
    p = (seen.z[:, :3] - seen.r[:, :3] @ world.T) @ R_nw
    C = R_nw.T @ so3.rotations(-seen.r[:, 3:6]) @ C_as_seen @ R_bm
    return Series(seen.t, np.hstack([p, so3.quaternion_of(C)]))

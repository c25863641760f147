"""A real hand, judged by motion capture and by the rests at both ends.

The recordings are public (their README says which); they stay outside the repository.
Some of them run in the suite, all of them in ``make prove``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from vqf import VQF

import handcal
from handcal.compiled import so3
from handcal.effects import mag_hard_iron
from handcal.estimate.consistency import nis_between
from handcal.observations import pose
from handcal.recordings import segment
from handcal.types import Array, BoolArray, Imu, Recording, Result, Series

ALL = (
    "broad_01_slow_rotation",
    "broad_04_slow_rotation_breaks",
    "broad_06_fast_rotation",
    "broad_08_fast_rotation_breaks",
    "broad_10_slow_translation",
)
# What these recordings are known to hold besides biases; needed where motion alone must
# give the gyro bias, since an unmodelled scale or delay is worth more than the bias sought.
PHYSICS = ("gyro_scale", "gyro_misalignment", "lever_arm", "pose_delay", "accel_delay")


def _some(*quick: str) -> list[object]:
    """All recordings, those not named only in ``make prove``."""
    return [n if n in quick else pytest.param(n, marks=pytest.mark.prove) for n in ALL]


@cache
def _blind(path: Path) -> tuple[Recording, Result]:
    """Calibrated without the pose, noise levels from the first 60 % of the recording."""
    recording = handcal.load(path)
    result = handcal.calibrate(
        recording,
        ("gyro_scale",),
        ignore=("pose",),
        noise_until=0.6 * recording.duration_s,
    )
    return recording, result


def _rest_bias(result: Result) -> Array:
    """Mean gyro reading (3,) deg/s of the first and the last rest."""
    imu = result.recording.imu
    ends = (result.rests[0], result.rests[-1])
    means = [imu.gyro[(imu.t >= a) & (imu.t <= b)].mean(axis=0) for a, b in ends]
    return np.degrees(np.mean(means, axis=0))


def _gyro_bias(result: Result) -> Array:
    return np.degrees([p.value for p in result.parameters[:3]])


@pytest.mark.parametrize("name", _some())
def test_bias_and_noise_without_the_pose(name: str, real_recordings: Path) -> None:
    recording, result = _blind(real_recordings / f"{name}.mcap")
    difference = _gyro_bias(result) - _rest_bias(result)
    later = nis_between(result.innovations, 0.6 * recording.duration_s, np.inf)
    print(f"\n{name}: {result.assume}, bias - rests {difference} deg/s, NIS later {later:.3f}")
    assert result.assume == "rest-only"
    assert np.all(np.abs(difference) < 0.03)
    # (the sensors' noise is bounded by what the readings show: what this device has besides, an
    # early and slow accelerometer for one, scatters beyond it)
    assert 0.7 < later < 1.5


def _between(recording: Recording, a: float, b: float) -> Recording:
    def part(t: Array) -> BoolArray:
        return np.asarray((t >= a) & (t <= b))

    imu, k = recording.imu, part(recording.imu.t)
    streams = {n: Series(s.t[part(s.t)], s.value[part(s.t)]) for n, s in recording.streams.items()}
    cut = Imu(imu.t[k], imu.gyro[k], imu.accel[k], imu.valid[k])
    return replace(recording, imu=cut, streams=streams)


@pytest.mark.prove
@pytest.mark.parametrize("name", _some(ALL[2]))
def test_bias_from_the_motion_alone_with_the_pose(name: str, real_recordings: Path) -> None:
    recording = handcal.load(real_recordings / f"{name}.mcap")
    imu = recording.imu
    rests = segment.rests(recording)
    ends = (rests[0], rests[-1])
    means = [imu.gyro[(imu.t >= a) & (imu.t <= b)].mean(axis=0) for a, b in ends]
    motion = _between(recording, rests[0, 1], rests[-1, 0])
    until = motion.imu.t[0] + 0.6 * motion.duration_s
    result = handcal.calibrate(motion, PHYSICS, observations=("pose",), noise_until=until)
    difference = _gyro_bias(result) - np.degrees(np.mean(means, axis=0))
    later = nis_between(result.innovations, until, np.inf)
    print(f"\n{name}: motion alone, bias - rests {difference} deg/s, NIS later {later:.3f}")
    assert np.all(np.abs(difference) < 0.05)


def _attitude_error(C: Array, reference: Array) -> float:
    """RMS angle, deg, between attitudes (k, 3, 3), the best constant yaw offset removed."""
    D = np.einsum("kij,klj->kil", C, reference)
    yaw = np.arctan2((D[:, 1, 0] - D[:, 0, 1]).sum(), (D[:, 0, 0] + D[:, 1, 1]).sum())
    D = so3.matrix_exp(np.array([0.0, 0.0, -yaw])) @ D
    return float(np.degrees(np.sqrt((so3.matrix_log(D) ** 2).sum(axis=1).mean())))


def _at(t: Array, C: Array, wanted: Array) -> Array:
    """Attitudes (k, 3, 3) between those at t, turned at a constant rate."""
    i = np.clip(np.searchsorted(t, wanted) - 1, 0, len(t) - 2)
    part = (wanted - t[i]) / (t[i + 1] - t[i])
    step = so3.matrix_log(np.einsum("kji,kjl->kil", C[i], C[i + 1]))
    turn = np.stack([so3.matrix_exp(v) for v in part[:, None] * step])
    return np.asarray(C[i] @ turn)


@pytest.mark.prove
@pytest.mark.parametrize("name", ALL[:2])
def test_attitude_is_no_worse_than_vqf(name: str, real_recordings: Path) -> None:
    """From IMU and magnetometer alone: neither is told anything of the pose."""
    recording = handcal.load(real_recordings / f"{name}.mcap")
    result = handcal.calibrate(recording, ("gyro_scale", "gyro_misalignment"), ignore=("pose",))
    imu, pose, mag = recording.imu, recording.streams["pose"], recording.streams["mag"]
    reference = so3.matrix_of(pose.value[:, 3:])
    field = np.stack([np.interp(imu.t, mag.t, mag.value[:, i]) for i in range(3)], axis=1)
    vqf = VQF(float(np.median(np.diff(imu.t))))
    out = vqf.updateBatch(imu.gyro.copy(), imu.accel.copy(), np.ascontiguousarray(field))
    at = np.clip(np.searchsorted(imu.t, pose.t - 1e-6), 0, len(imu.t) - 1)
    theirs = _attitude_error(so3.matrix_of(out["quat9D"])[at], reference)
    assert result.smoothed is not None
    ours = _attitude_error(
        _at(result.smoothed.t, so3.matrix_of(result.smoothed.q_nb), pose.t), reference
    )
    print(f"\n{name}: attitude {ours:.3f} deg, vqf {theirs:.3f} deg")
    assert ours <= theirs


# Two IMUs of one board, shaken: their places are drawn on it, in m.
BOARDS = {"array_1_imu5": (0.0189, 0.0, 0.0), "array_2_imu3": (0.0, -0.0189, 0.0)}
ERRORS = ("gyro_scale", "accel_scale", "gyro_misalignment", "accel_misalignment")


@pytest.mark.prove
def test_a_small_iron_is_not_run_away_with(real_recordings: Path) -> None:
    """A magnetometer whose readings lie about zero to 2 uT: the online pass, with noise levels
    not known yet, took 0.4 mT for its iron, and a disturbance of half a radian for the rest."""
    recording = handcal.load(real_recordings / f"{ALL[1]}.mcap")
    result = handcal.calibrate(recording, ("mag_hard_iron",))
    centre, sigma = mag_hard_iron.sphere(recording)
    found = [p for p in result.parameters if p.effect == "mag_hard_iron"]
    assert np.all(np.abs([p.value for p in found] - centre) < 3.0 * sigma)
    assert all(p.shown for p in found)
    assert result.settled
    disturbance = next(n for n in result.noise if n.name == "mag_disturbance")
    assert disturbance.value < 5e-6


@cache
def _against_reference(path: Path, effects: tuple[str, ...], half: int) -> Result:
    """Calibrated against the other IMU; half 1 or 2: of the rest poses and of the shaking."""
    recording = handcal.load(path)
    if half:
        imu = recording.imu
        shaken = imu.t[np.linalg.norm(imu.gyro, axis=1) > 10.0]
        middle, begin = float(np.median(shaken)), shaken[0] - 1.0
        poses = (0.0, 0.5 * begin) if half == 1 else (0.5 * begin, begin)
        shake = (begin, middle) if half == 1 else (middle, imu.t[-1])
        recording = _joined(_between(recording, *poses), _between(recording, *shake))
    return handcal.calibrate(recording, effects)


def _joined(one: Recording, two: Recording) -> Recording:
    """Two parts one behind the other, the second stamped 0.5 s after the first."""
    later = one.imu.t[-1] + 0.5 - two.imu.t[0]

    def both(a: Series, b: Series) -> Series:
        return Series(np.r_[a.t, b.t + later], np.vstack([a.value, b.value]))

    imu = Imu(
        np.r_[one.imu.t, two.imu.t + later],
        np.vstack([one.imu.gyro, two.imu.gyro]),
        np.vstack([one.imu.accel, two.imu.accel]),
        np.r_[one.imu.valid, two.imu.valid],
    )
    streams = {n: both(s, two.streams[n]) for n, s in one.streams.items()}
    return replace(one, imu=imu, streams=streams)


def _motion_rms(result: Result) -> Array:
    """Root mean square of the force's innovations (3,) m/s^2 while turning faster than 5 rad/s."""
    found, imu = result.innovations["known_input"], result.recording.imu
    rate = np.interp(found.t, imu.t, np.linalg.norm(imu.gyro, axis=1))
    return np.asarray(np.sqrt((found.residual[rate > 5.0, 3:] ** 2).mean(axis=0)))


@pytest.mark.prove
@pytest.mark.parametrize("name", ["array_1_imu5", "array_2_imu3"])
def test_lever_arm_between_two_imus(name: str, real_recordings: Path) -> None:
    path = real_recordings / f"{name}.mcap"
    result = _against_reference(path, ("lever_arm", *ERRORS), 0)
    arm = [result.parameter("lever_arm", a) for a in "xyz"]
    error = np.array([p.value for p in arm]) - BOARDS[name]
    sigma = np.array([p.sigma for p in arm])
    nis = result.innovations["known_input"].mean_nis
    print(f"\n{name}: arm off by {1e3 * error} mm, sigma {1e3 * sigma}, NIS {nis:.3f}")
    assert set(result.innovations) == {"known_input"}
    assert np.all(np.abs(error) < 5e-4)
    assert np.all(sigma < 2e-4)
    assert 0.8 < nis < 1.2
    assert np.isfinite(result.history.p_n).all()
    assert np.isfinite(result.history.nav_sigma).all()


@pytest.mark.prove
@pytest.mark.parametrize("name", list(BOARDS))
def test_without_the_lever_arm_the_forces_disagree(name: str, real_recordings: Path) -> None:
    path = real_recordings / f"{name}.mcap"
    without = _against_reference(path, ERRORS, 0)
    with_arm = _against_reference(path, ("lever_arm", *ERRORS), 0)
    along = int(np.argmax(np.abs(BOARDS[name])))
    before, after = _motion_rms(without), _motion_rms(with_arm)
    print(f"\n{name}: forces disagree by {before} m/s^2 without the arm, {after} with it")
    assert with_arm.log_evidence - without.log_evidence > 1000
    assert before[along] > 4 * after[along]


@pytest.mark.prove
@pytest.mark.parametrize("name", list(BOARDS))
def test_both_halves_of_the_shaking_agree(name: str, real_recordings: Path) -> None:
    path = real_recordings / f"{name}.mcap"
    one, two = (_against_reference(path, ("lever_arm", *ERRORS), half) for half in (1, 2))
    normed = np.array(
        [
            (a.value - b.value) / np.hypot(a.sigma, b.sigma)
            for a, b in zip(one.parameters, two.parameters, strict=True)
        ]
    )
    print(f"\n{name}: halves differ by {np.round(normed, 1)} sigma")
    assert np.abs(normed).max() < 4.0


@pytest.mark.prove
def test_so_many_poses_tell_as_much_of_the_sensors_as_25_a_second(
    real_recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = handcal.load(real_recordings / "devices" / "euroc_v203.mcap")
    effects = ("gyro_scale", "accel_scale", "lever_arm", "pose_delay")

    def sigmas() -> dict[tuple[str, str], float]:
        # (what has no walk: of two models, one with it, other sigmas would be compared)
        found = handcal.calibrate(recording, effects, only=True).parameters
        return {(p.effect, p.name): p.sigma for p in found if not p.effect.startswith("pose")}

    usual = sigmas()
    monkeypatch.setattr(pose, "MAX_RATE", 25.0)
    more = sigmas()
    assert max(usual[k] / more[k] for k in usual) < 1.2

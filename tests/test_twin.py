"""The simulated counterpart of a recording: what a fit says the sensors should have read."""

import dataclasses

import numpy as np
import pytest
from settled import solve
from worlds import recording_of

import handcal
from handcal.compiled import so3
from handcal.device.twin import IMU_CHANNELS, sensor_residuals, twin
from handcal.earth import local_earth
from handcal.effects import select
from handcal.estimate.observed import problem_of
from handcal.observations import catalogue
from handcal.recordings import segment
from handcal.recordings.export import write_twin
from handcal.types import Imu, InputError
from handcal_sim import simulate
from handcal_sim.phone import capture_pose, consumer_magnetometer, consumer_phone

ARM, IRON, SCALE = [0.05, 0.02, -0.03], [2e-5, 1e-5, -1e-5], [0.02, -0.02, 0.01]


def fit(recording, effects, kinds):
    rests = segment.rests(recording)
    problem, start = problem_of(recording, select(effects), kinds, rests, local_earth(None), None)
    return solve(problem, start, {})


def world_of(effects, *, seed=3, **more):
    rng = np.random.default_rng(1)
    sensors = {"pose": capture_pose, "mag": consumer_magnetometer}
    own = {"heading": None} | {k: sensors[k](rng) for k in more}
    phone = consumer_phone(rng) if not more else dataclasses.replace(consumer_phone(rng), **own)
    return simulate("free-hand", seed=seed, duration_s=30.0, phone=phone, effects=effects)


def pair(world, stream, effect, kinds):
    recording = recording_of(world, stream)
    return recording, fit(recording, (), kinds), fit(recording, (effect,), kinds)


@pytest.fixture(scope="module")
def turned():
    """A gyro's scale error, beside a heading."""
    world = world_of({"gyro_scale": SCALE})
    return world, *pair(world, "heading", "gyro_scale", ("fixed_position", "heading"))


@pytest.fixture(scope="module")
def seen():
    """A lever arm, beside a measured pose."""
    world = world_of({"lever_arm": ARM}, pose=1)
    return world, *pair(world, "pose", "lever_arm", ("pose",))


@pytest.fixture(scope="module")
def ironed():
    """A hard iron in a magnetometer."""
    world = world_of({"mag_hard_iron": IRON}, mag=1)
    return world, *pair(world, "mag", "mag_hard_iron", ("fixed_position", "magnetometer"))


def rms(x):
    return float(np.sqrt((np.asarray(x) ** 2).mean()))


def smoothed(x, width=20):
    return np.stack([np.convolve(c, np.ones(width) / width, "valid") for c in x.T], axis=1)


def test_channels_are_the_contracts(turned, seen, ironed):
    found = [set(sensor_residuals(case[2].linear)) for case in (turned, seen, ironed)]
    position = {f"position_{a}" for a in "xyz"}
    assert found[0] == {*IMU_CHANNELS, *position, "heading"}
    assert found[1] == {*IMU_CHANNELS, *position, *(f"attitude_{a}" for a in "xyz")}
    assert found[2] == {*IMU_CHANNELS, *position, *(f"mag_{a}" for a in "xyz")}
    for t, r in sensor_residuals(turned[2].linear).values():
        assert t.shape == r.shape
        assert np.isfinite(r).all()
        assert (np.diff(t) > 0).all()


def test_missing_physics_shows_in_its_own_channel(turned, seen, ironed):
    """Before, the residual is what the missing effect does; after, it is noise."""
    for case, channel, least in ((turned, "gyro_x", 5.0), (ironed, "mag_x", 5.0)):
        before, after = (rms(sensor_residuals(s.linear)[channel][1]) for s in case[2:])
        assert before > least * after, channel
    before, after = (sensor_residuals(s.linear) for s in seen[2:])
    apart = [rms(np.hstack([r[f"{s}_{a}"][1] for a in "xyz"])) for s in ("accel", "position")
             for r in (before, after)]  # fmt: skip
    assert apart[0] > 5.0 * apart[1] or apart[2] > 5.0 * apart[3]


def test_gyro_residual_is_the_error_itself(turned):
    """What the scale error added, in sensor units and with its sign: the part that shows."""
    world, _, before, _ = turned
    t, r = sensor_residuals(before.linear)["gyro_x"]
    omega = np.interp(t, world.t, world.truth.omega[:, 0])
    slope = float(r @ omega / (omega @ omega))
    assert 0.25 * SCALE[0] < slope < 1.1 * SCALE[0]


def test_twin_reads_as_the_truth_does(turned):
    """After: the model's readings are true rate and force with the errors the device has."""
    world, recording, before, after = turned
    bias = world.parameters["effects"]
    truth = np.hstack([world.truth.omega * (1.0 + np.array(SCALE)), world.truth.f])
    truth[:, :3] += [p["value"] for p in bias["gyro_bias"]]
    truth[:, 3:] += [p["value"] for p in bias["accel_bias"]]
    off = []
    for solution in (before, after):
        imu = twin(solution.linear).imu
        np.testing.assert_array_equal(imu.t, recording.imu.t)
        off.append(rms(smoothed(imu.gyro - truth[:, :3])))
    assert off[1] < 1.5 * rms(smoothed(recording.imu.gyro - truth[:, :3]))
    assert off[0] > 3.0 * off[1]


def test_twin_is_what_was_read_less_the_residual(turned, seen, ironed):
    for case, stream, channel in ((turned, "heading", "heading"), (ironed, "mag", "mag_x")):
        recording, solution = case[1], case[3]
        simulated = twin(solution.linear).streams[stream]
        t, r = sensor_residuals(solution.linear)[channel]
        np.testing.assert_array_equal(simulated.t, t)
        at = np.argmin(np.abs(recording.streams[stream].t[:, None] - t), axis=0)
        read = recording.streams[stream].value[at]
        np.testing.assert_allclose(so3.wrap(read[:, 0] - simulated.value[:, 0]), r, atol=1e-9)
    # poses go back into the world and the axes of the tracker
    recording, solution = seen[1], seen[3]
    pose, raw = twin(solution.linear).streams["pose"], recording.streams["pose"]
    at = np.argmin(np.abs(raw.t[:, None] - pose.t), axis=0)
    away = np.linalg.norm(raw.value[at, :3] - pose.value[:, :3], axis=1)
    residual = sensor_residuals(solution.linear)
    size = np.linalg.norm([residual[f"position_{a}"][1] for a in "xyz"], axis=0)
    np.testing.assert_allclose(away, size, atol=1e-9)
    turn = so3.matrix_log(
        so3.matrix_of(raw.value[at, 3:]) @ so3.matrix_of(pose.value[:, 3:]).transpose(0, 2, 1)
    )
    size = np.linalg.norm([residual[f"attitude_{a}"][1] for a in "xyz"], axis=0)
    np.testing.assert_allclose(np.linalg.norm(turn, axis=1), size, atol=1e-3 * size.max())


def test_twin_of_a_twin_leaves_less(turned):
    """The model explains its own readings; of a sensor's noise a smoother sees only a part."""
    _, recording, _, after = turned
    simulated = twin(after.linear)
    again = fit(
        dataclasses.replace(recording, imu=simulated.imu, streams=simulated.streams),
        ("gyro_scale",),
        ("fixed_position", "heading"),
    )
    first, second = (sensor_residuals(s.linear) for s in (after, again))
    assert rms(second["heading"][1]) < 0.1 * rms(first["heading"][1])
    for a in "xyz":
        assert rms(second[f"accel_{a}"][1]) < rms(first[f"accel_{a}"][1])


def test_saturated_readings_are_no_residual(turned):
    recording = turned[1]
    imu = recording.imu
    valid = np.ones(len(imu.t), dtype=bool)
    valid[1000:1030] = False
    gyro = imu.gyro.copy()
    gyro[1000:1030] = 0.0
    masked = dataclasses.replace(recording, imu=Imu(imu.t, gyro, imu.accel, valid))
    solution = fit(masked, ("gyro_scale",), ("fixed_position", "heading"))
    t, _ = sensor_residuals(solution.linear)["gyro_x"]
    inside = (t > imu.t[1003]) & (t < imu.t[1026])
    assert not inside.any()
    assert np.isfinite(twin(solution.linear).imu.gyro).all()


def test_slots_average(turned):
    linear = turned[3].linear
    fine, coarse = (sensor_residuals(linear, slot)["gyro_x"] for slot in (1e-3, 1.0))
    assert len(fine[0]) > 3 * len(coarse[0])
    assert fine[1].mean() == pytest.approx(coarse[1].mean(), abs=0.2 * rms(fine[1]))


@pytest.mark.prove
def test_known_input_is_compared_reading_by_reading():
    if "known_input" not in catalogue():
        pytest.skip("no known input yet")
    from handcal_sim.phone import Clocking, Reference

    rng = np.random.default_rng(1)
    phone = dataclasses.replace(consumer_phone(rng), reference=Reference(clocking=Clocking(100.0)))
    world = simulate("free-hand", seed=3, duration_s=12.0, phone=phone,
                     effects={"gyro_scale": SCALE})  # fmt: skip
    recording = recording_of(world, "reference")
    kinds = ("known_input", "fixed_position")
    before, after = (
        sensor_residuals(fit(recording, effects, kinds).linear) for effects in ((), ("gyro_scale",))
    )
    assert len(before["gyro_x"][0]) > 0.5 * len(recording.imu.t)
    assert rms(before["gyro_x"][1]) > 2.0 * rms(after["gyro_x"][1])
    t, r = before["gyro_x"]
    omega = np.interp(t, world.t, world.truth.omega[:, 0])
    assert float(r @ omega / (omega @ omega)) == pytest.approx(SCALE[0], rel=0.2)


def test_file_reads_back_as_what_was_recorded(turned, tmp_path):
    _, recording, before, after = turned
    path = tmp_path / "twin.mcap"
    write_twin(recording, twin(before.linear), twin(after.linear), path)
    read = handcal.load(path)
    np.testing.assert_array_equal(read.imu.gyro, recording.imu.gyro)
    assert set(read.streams) == {"heading"}
    np.testing.assert_array_equal(read.streams["heading"].value, recording.streams["heading"].value)
    chosen = {"imu": "/after/imu", "heading": "/after/heading"}
    simulated = handcal.load(path, topics=chosen)
    np.testing.assert_array_equal(simulated.imu.gyro, twin(after.linear).imu.gyro)
    with pytest.raises(InputError, match="/before/nothing"):
        handcal.load(path, topics={"imu": "/before/nothing"})

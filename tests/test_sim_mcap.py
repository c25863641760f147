"""The simulator's files, read back with an independent decoder, and its command."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import schemas
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from typer.testing import CliRunner

import handcal
import handcal_sim
from handcal.commands._app import app
from handcal_sim import phone
from handcal_sim.effects import EFFECTS

START_NS = 1_760_000_000_000_000_000
EVERYTHING = replace(
    phone.perfect_phone(),
    mag=phone.Magnetometer(clocking=phone.Clocking(20.0)),
    pose=phone.Pose(clocking=phone.Clocking(30.0, 0.01)),
    reference=phone.Reference(clocking=phone.Clocking(50.0)),
    thermometer=phone.Thermometer(reported=True),
)


def parameters(path):
    with Path(path).open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages(topics=["/truth/parameters"])
    found = json.loads(message.data)
    schemas.check(found)
    return found


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def xyzw(q):
    return [q.x, q.y, q.z, q.w]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("sim") / "all.mcap"
    world = handcal_sim.simulate("three-turns", seed=2, phone=EVERYTHING, duration_s=15.0)
    count = handcal_sim.write(world, path)
    with Path(path).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == count
    topics = {channel.topic for channel in summary.channels.values()}
    return world, path, topics


def decoded(path, topic):
    with Path(path).open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (schema.name, message.log_time, ros)
            for schema, _, message, ros in reader.iter_decoded_messages(topics=[topic])
        ]


def checked(written, topic, schema, stamps):
    """The decoded messages of a topic, their schema and stamps compared."""
    messages = decoded(written[1], topic)
    assert {name for name, _, _ in messages} == {schema}
    expected = START_NS + np.rint(stamps * 1e9).astype(np.int64)
    for stamp, (_, log_time, ros) in zip(expected, messages, strict=True):
        assert log_time == stamp
        assert ros.header.stamp.sec * 10**9 + ros.header.stamp.nanosec == stamp
    return [ros for _, _, ros in messages]


def test_all_topics_are_there(written):
    usual = {"/imu", "/heading", "/mag", "/temperature", "/pose", "/reference"}
    assert written[2] == usual | {"/truth/imu", "/truth/pose", "/truth/parameters"}


@pytest.mark.parametrize("topic", ["/imu", "/reference", "/truth/imu"])
def test_imu_messages(written, topic):
    world = written[0]
    stream = world.streams["reference"] if topic == "/reference" else world.imu
    messages = checked(written, topic, "sensor_msgs/msg/Imu", stream.stamps)
    values = [xyz(m.angular_velocity) + xyz(m.linear_acceleration) for m in messages]
    expected = stream.values
    if topic == "/truth/imu":
        expected = np.hstack([world.truth.omega, world.truth.f])
    np.testing.assert_array_equal(values, expected)
    assert all(m.orientation_covariance[0] == -1.0 for m in messages)
    assert all(list(m.angular_velocity_covariance) == [0.0] * 9 for m in messages)


def test_heading_mag_and_temperature_messages(written):
    streams = written[0].streams
    schema = "geometry_msgs/msg/QuaternionStamped"
    heading = checked(written, "/heading", schema, streams["heading"].stamps)
    yaw = [2.0 * math.atan2(m.quaternion.z, m.quaternion.w) for m in heading]
    np.testing.assert_allclose(yaw, streams["heading"].values[:, 0], atol=1e-14)
    assert all(m.quaternion.x == m.quaternion.y == 0.0 for m in heading)
    mag = checked(written, "/mag", "sensor_msgs/msg/MagneticField", streams["mag"].stamps)
    np.testing.assert_array_equal([xyz(m.magnetic_field) for m in mag], streams["mag"].values)
    warm = streams["temperature"]
    messages = checked(written, "/temperature", "sensor_msgs/msg/Temperature", warm.stamps)
    np.testing.assert_array_equal([[m.temperature] for m in messages], warm.values)


def test_pose_messages(written):
    world = written[0]
    pose = world.streams["pose"]
    schema = "geometry_msgs/msg/PoseStamped"
    messages = checked(written, "/pose", schema, pose.stamps)
    values = [xyz(m.pose.position) + xyzw(m.pose.orientation) for m in messages]
    np.testing.assert_array_equal(values, pose.values)
    truth = checked(written, "/truth/pose", schema, world.imu.stamps)
    position = [xyz(m.pose.position) for m in truth]
    np.testing.assert_array_equal(position, world.truth.position)
    x, y, z, w = np.array([xyzw(m.pose.orientation) for m in truth]).T
    C = world.truth.C_nb
    np.testing.assert_allclose(1.0 - 2.0 * (y * y + z * z), C[:, 0, 0], atol=1e-14)
    np.testing.assert_allclose(2.0 * (x * y + z * w), C[:, 1, 0], atol=1e-14)
    np.testing.assert_allclose(2.0 * (x * z - y * w), C[:, 2, 0], atol=1e-14)


def test_the_parameters_are_all_there(written):
    found = parameters(written[1])
    assert found == json.loads(json.dumps(dict(written[0].parameters)))
    assert found["scenario"] == "three-turns"
    assert set(found["effects"]) == {"gyro_bias", "accel_bias"}


def test_one_seed_gives_one_file_byte_for_byte(tmp_path):
    files = []
    for k, seed in enumerate((1, 1, 2)):
        handcal_sim.write(
            handcal_sim.simulate("travel", seed=seed, duration_s=8.0), tmp_path / f"{k}.mcap"
        )
        files.append((tmp_path / f"{k}.mcap").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def run(*arguments):
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def test_the_command_writes_a_recording(tmp_path):
    path = tmp_path / "a.mcap"
    result = run(
        "z-turn",
        "-o",
        path,
        "--seed",
        5,
        "--device",
        "paper",
        "--heading-sigma",
        15,
        "--effect",
        "gyro_scale=0.01,0,0",
        "--effect",
        "accel_delay=0.02",
        "--pose",
        "--mag",
        "--bias-gyro-deg-h",
        "100,0,0",
        "--latitude",
        48,
    )
    assert result.exit_code == 0, result.output
    assert result.stdout.count("\n") == 1
    assert "z-turn, 30 s, /imu, /heading, /mag, /pose;" in result.stdout
    assert "seed 5" in result.stdout
    found = parameters(path)
    assert found["asked"] == {"gyro_scale": [0.01, 0.0, 0.0], "accel_delay": [0.02]}
    assert found["effects"]["gyro_bias"][0]["value"] == pytest.approx(math.radians(100 / 3600))
    assert found["effects"]["accel_scale"][2]["value"] == -0.00775
    assert found["phone"]["heading"]["sigma"] == pytest.approx(math.radians(15.0))
    assert found["start"] == {"heading": 0.0, "pitch": 0.0, "roll": 0.0, "direction": 1}
    assert found["hand"]["sway_m"] == 0.0
    assert 9.80 < found["earth"]["gravity"] < 9.82


def test_the_command_draws_a_seed_and_says_it(tmp_path):
    first = run("static", "-o", tmp_path / "a.mcap", "--duration", 2)
    assert first.exit_code == 0
    seed = first.stderr.split()[-1]
    second = run("static", "-o", tmp_path / "b.mcap", "--duration", 2, "--seed", seed)
    assert second.stderr == ""
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_the_command_takes_all_its_options(tmp_path):
    result = run(
        "three-turns",
        "-o",
        tmp_path / "a.mcap",
        "--seed",
        1,
        "--perfect",
        "--no-heading",
        "--rate",
        200,
        "--duration",
        5,
        "--bias-accel-mg",
        "1,2,3",
        "--temperature",
        "--mag",
        "--reference",
        "--sway",
        0.5,
        "--start-heading",
        90,
        "--start-tilt",
        "1,2",
        "--clockwise",
        "--effect",
        "pose_delay=0.01",
    )
    assert result.exit_code == 0, result.output
    assert "/imu, /mag, /temperature, /pose, /reference;" in result.stdout
    found = parameters(tmp_path / "a.mcap")
    assert found["phone"]["rate_hz"] == 200.0
    assert found["start"]["direction"] == -1
    assert np.degrees(found["start"]["heading"]) == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["jump"], "no scenario 'jump'; there are z-turn"),
        (["z-turns"], "Did you mean z-turn"),
        (["z-turn", "--device", "toy"], "no device 'toy'"),
        (["z-turn", "--effect", "gyro_scal=1"], "no effect 'gyro_scal'; there are"),
        (["z-turn", "--effect", "gyro_scal=1"], "Did you mean gyro_scale"),
        (["z-turn", "--effect", "gyro_scale=1"], "gyro_scale=x,y,z"),
        (["z-turn", "--effect", "gravity=1", "--effect", "gravity=2"], "gravity is given twice"),
        (["z-turn", "--heading-sigma", "-1"], "--no-heading"),
        (["z-turn", "--heading-sigma", "nan"], "--no-heading"),
        (["z-turn", "--heading-rate", "0"], "--heading-rate"),
        (["z-turn", "--no-heading", "--effect", "heading_delay=1"], "needs a heading sensor"),
        (["z-turn", "--rate", "nan"], "rate"),
        (["z-turn", "--duration", "1e9"], "duration"),
        (["z-turn", "--sway", "nan"], "sway"),
        (["z-turn", "--seed", "-1"], "--seed"),
        (["z-turn", "--latitude", "nan"], "no such place"),
        (["z-turn", "--start-heading", "inf"], "--start-heading takes 1 number"),
        (["z-turn", "--start-tilt", "1"], "--start-tilt takes 2 number"),
        (["z-turn", "--bias-gyro-deg-h", "1,2"], "--bias-gyro-deg-h takes 3 number"),
    ],
)
def test_wrong_use_is_one_line_and_status_2(tmp_path, arguments, sentence):
    result = run("--seed", 1, *arguments, "-o", tmp_path / "a.mcap")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert sentence in result.stderr
    assert not (tmp_path / "a.mcap").exists()


def test_a_name_of_another_format_is_wrong_use(tmp_path):
    result = run("z-turn", "--seed", 1, "-o", tmp_path / "a.csv")
    assert result.exit_code == 2
    assert "ends in .mcap" in result.stderr


def test_a_file_that_cannot_be_written_is_one_line(tmp_path):
    result = run("z-turn", "-o", tmp_path / "none" / "a.mcap", "--seed", 1)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "cannot be written: there is no folder" in result.stderr


def test_the_command_is_quick_to_import():
    code = (
        "import sys, typer, handcal_sim.commands; "
        "print([m for m in ('numpy', 'scipy', 'mcap') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.prove
def test_an_effect_that_is_not_the_simulators_own_comes_from_the_catalogue(tmp_path, monkeypatch):
    """As if it were new: concealed by the other program; the truth stays, and names it."""
    plain, out = tmp_path / "plain.mcap", tmp_path / "a.mcap"
    options = ["z-turn", "--seed", "0", "--duration", "5", "--no-heading"]
    assert run(*options, "-o", plain).exit_code == 0
    monkeypatch.delitem(EFFECTS, "gyro_scale")
    given = [*options, "--effect", "gyro_scale=0.1,0.2,0.3", "--effect", "accel_scale=0,0,0.01"]
    done = run(*given, "-o", out)
    assert done.exit_code == 0, done.output
    truth = [parameters(path) for path in (plain, out)]
    assert truth[1]["concealed"] == ["gyro_scale=0.1,0.2,0.3"]
    rates = [handcal.load(path).imu.gyro for path in (plain, out)]
    np.testing.assert_allclose(rates[1], rates[0] * [1.1, 1.2, 1.3], rtol=1e-12)
    done = run(*options, "--effect", "gyro_scale=1", "-o", tmp_path / "b.mcap")
    assert done.exit_code == 2
    assert "gyro_scale takes 3 values, not 1" in done.stderr
    assert not (tmp_path / "b.mcap").exists()

"""What goes to an autopilot: raw or corrected readings, which sensor, and what is left as it is."""

from __future__ import annotations

import json
from dataclasses import replace

import format_files
import numpy as np
import pytest
from fake_explanation import fake_explanation
from sample_recording import sample
from test_exports import INS_NAMES, INS_OWN, PX4_NAMES, PX4_OWN, document, main, recording
from test_px4 import FRD
from typer.testing import CliRunner

import handcal
from handcal.commands import _app
from handcal.exports import format_of, refusals
from handcal.exports._contents import contents
from handcal.recordings.inputs import load
from handcal.show.explanation.next_commands import commands
from handcal.types import HandcalError, InputError

__all__ = ["main"]
IDS = {"sensor_gyro.device_id": 7.0, "sensor_accel.device_id": 9.0}
BIAS, SCALE = np.array([0.1, -0.2, 0.3]), np.array([0.01, -0.02, 0.03])
VALUES = {"gyro_bias": [0.02, 0.03, -0.04], "accel_bias": BIAS.tolist(),
          "accel_scale": SCALE.tolist()}  # fmt: skip
PROGRAMS = {"px4": (PX4_NAMES, PX4_OWN), "ardupilot": (INS_NAMES, INS_OWN)}


@pytest.fixture
def result(tmp_path):
    def write(vehicle, values=VALUES, sigma=1e-5, **more):
        path = tmp_path / "result.json"
        made = document(values, **more)
        made["recording"]["vehicle"] = vehicle
        made["parameters"] = [p | {"sigma": sigma} for p in made["parameters"]]
        path.write_text(json.dumps(made))
        return path

    return write


@pytest.fixture
def parameters(tmp_path):
    def write(own):
        path = tmp_path / "before.params"
        path.write_text("\n".join(f"1\t1\t{k}\t{v}\t9" for k, v in own.items()))
        return path

    return write


def text_of(path, name, **how):
    form = format_of(name)
    return form.write(contents(path, form, **how))


def numbers(text):
    """Parameters of either program's file."""
    rows = [x.replace(",", "\t").split("\t") for x in text.splitlines() if x and x[0] != "#"]
    return {r[2]: float(r[3]) if len(r) == 5 else None for r in rows if len(r) == 5} | {
        r[0]: float(r[1]) for r in rows if len(r) == 2
    }


def of(found, names):
    return [np.array([found[name.format(a)] for a in "XYZ"]) for name in names]


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_table_is_raw_or_corrected_as_is_said(result, parameters, name):
    """Raw readings were taken for corrected ones, and both calibrations written as one."""
    names, own = PROGRAMS[name]
    path, file = result({}), parameters(own)
    with pytest.raises(HandcalError, match="--readings raw, or --readings corrected"):
        text_of(path, name, parameters=file)
    _, offset, scale = of(numbers(text_of(path, name, parameters=file, readings="raw")), names)
    np.testing.assert_allclose(offset, FRD * BIAS, atol=1e-11)
    np.testing.assert_allclose(scale, 1 / (1 + SCALE), atol=1e-11)
    both = numbers(text_of(path, name, parameters=file, readings="corrected"))
    _, before, factor = of(own, names)
    np.testing.assert_allclose(of(both, names)[1], before + FRD * BIAS / factor, atol=1e-11)
    with pytest.raises(HandcalError, match="--parameters FILE"):
        text_of(path, name, readings="raw")


def test_a_log_says_itself_what_it_is(result):
    for vehicle, said in ((PX4_OWN | IDS, "raw"), (PX4_OWN, "corrected")):
        path = result(vehicle)
        other = {"raw": "corrected", "corrected": "raw"}[said]
        assert text_of(path, "px4") == text_of(path, "px4", readings=said)
        with pytest.raises(InputError, match=f"readings are {said}"):
            text_of(path, "px4", readings=other)
    with pytest.raises(InputError, match="expected raw or corrected"):
        text_of(path, "px4", readings="row")
    with pytest.raises(InputError, match="--readings is for"):
        text_of(path, "kalibr", readings="raw")


def test_raw_and_corrected_logs_are_not_averaged(result):
    of_one = document(VALUES)
    parts = [{"recording": of_one["recording"] | {"path": f"{k}.ulg", "vehicle": vehicle},
              "parameters": of_one["parameters"], "noise": []}
             for k, vehicle in enumerate((PX4_OWN, PX4_OWN | IDS))]  # fmt: skip
    path = result({}, schema="handcal/explanation/1", recordings=parts)
    with pytest.raises(InputError, match="Some of these recordings are raw"):
        text_of(path, "px4")


def test_the_instance_is_as_is_said(result, parameters):
    second = {k.replace("GYRO1", "GYRO0").replace("ACC2", "ACC0"): v for k, v in PX4_OWN.items()}
    file = parameters(PX4_OWN | second | {"CAL_GYRO0_ID": 1, "CAL_ACC0_ID": 1})
    path, how = result({}), {"parameters": file, "readings": "raw"}
    with pytest.raises(HandcalError, match="--instance 0 or --instance 1"):
        text_of(path, "px4", **how)
    found = numbers(text_of(path, "px4", instance={"gyro": 0, "accel": 2}, **how))
    assert {name[:9] for name in found} == {"CAL_GYRO0", "CAL_ACC2_"}
    with pytest.raises(InputError, match="--instance accel=1: the vehicle has CAL_ACC0_ID 1"):
        text_of(path, "px4", instance={"gyro": 0, "accel": 1}, **how)
    with pytest.raises(InputError, match="the log is of 7"):
        text_of(result(PX4_OWN | IDS), "px4", instance={"gyro": 0})
    with pytest.raises(InputError, match="only the first IMU"):
        text_of(result(INS_OWN), "ardupilot", instance={"gyro": 1})


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize(("sigmas", "written"), [(1.9, False), (2.1, True)])
def test_what_is_within_two_sigmas_of_the_vehicles_is_left(result, raw, sigmas, written):
    """A short log had overwritten a calibration that its numbers did not say to be wrong."""
    sigma = 0.05
    apart = np.array([sigmas * sigma, 0.0, 0.0])
    _, before, factor = of(PX4_OWN, PX4_NAMES)
    bias = FRD * (before + apart if raw else apart * factor)
    values = {"gyro_bias": [1.0, 1.0, 1.0], "accel_bias": bias.tolist()}
    path = result(PX4_OWN | (IDS if raw else {}), values, sigma if raw else sigma * factor[0])
    text = text_of(path, "px4")
    assert ("CAL_ACC2_XOFF" in numbers(text)) == written
    assert "CAL_ACC2_YOFF" not in numbers(text)
    assert "# CAL_ACC2_YOFF: left at -0.74, for -0.74 ± " in text
    line = next(x for x in text.splitlines() if x.startswith("# CAL_ACC2_XOFF"))
    assert "0.3 before" in line if written else "left at 0.3" in line
    assert "± 0.05" in line


def test_what_was_left_is_said_and_nothing_is_no_file(result, tmp_path, main):
    one = {"gyro_bias": [1.0, 0.0, 0.0], "accel_bias": [0.0] * 3}
    out = tmp_path / "out.params"
    status, _, said = main("export", result(PX4_OWN, one, 0.01), "--to", "px4", "-o", out)
    assert (status, "CAL_GYRO1_YOFF (-0.02; found -0.02 ± 0.01)" in said) == (0, True)
    assert "not shown: CAL_ACC2_XSCALE, CAL_ACC2_YSCALE, CAL_ACC2_ZSCALE" in said
    out.unlink()
    status, _, said = main("export", result(PX4_OWN, one, 1.0), "--to", "px4", "-o", out)
    assert (status, "nothing to write" in said, out.exists()) == (1, True, False)


def test_a_scale_error_of_exactly_zero_is_a_scale_of_one(result):
    """It was taken for one that was not shown, and the vehicle's 0.98 stayed."""
    values = VALUES | {"accel_scale": [0.0, 0.01, 0.0]}
    path = result(PX4_OWN | IDS, values)
    assert numbers(text_of(path, "px4"))["CAL_ACC2_XSCALE"] == 1.0
    found = json.loads(path.read_text())
    for p in found["parameters"]:
        if (p["effect"], p["name"]) == ("accel_scale", "x"):
            p["shown"] = False
    path.write_text(json.dumps(found))
    assert "# CAL_ACC2_XSCALE: not shown" in text_of(path, "px4")


@pytest.mark.parametrize(("sigma", "said"), [(1e-5, True), (10.0, False)])
def test_that_biases_need_the_rest_is_said_where_the_rest_is_large(result, sigma, said):
    path = result(PX4_OWN, VALUES | {"gyro_scale": [0.01, 0.0, 0.0]})
    found = json.loads(path.read_text())
    for p in found["parameters"]:
        p["sigma"] = sigma if p["effect"] == "gyro_bias" else p["sigma"]
    path.write_text(json.dumps(found))
    text = text_of(path, "px4", recording=recording())
    assert ("The biases were found together with" in text) == said
    assert "whether the biases hold without it: handcal export" in text_of(path, "px4")


def test_that_biases_need_the_rest_is_said_in_the_terminal(result, tmp_path, main):
    given = replace(sample(n=600, streams=False), path="")
    file = tmp_path / "turns.ulg"
    file.write_bytes(format_files.ulog(given))
    path = result(PX4_OWN, VALUES | {"gyro_scale": [0.05] * 3}, 1e-9)
    _, _, said = main("export", path, "--to", "px4", "--recording", file, "-o", tmp_path / "o")
    assert said.count("The biases were found together with") == 1


@pytest.mark.parametrize(
    ("vehicle", "said"),
    [
        (IDS, r"parameters are not in the recording .*--parameters FILE"),
        (IDS | {"CAL_GYRO0_ID": 0.0}, "once in QGroundControl, .* with --parameters FILE"),
        ({"CAL_GYRO0_ID": 0.0}, "once in QGroundControl, .* and record anew"),
        (PX4_OWN | {"CAL_ACC2_ROT": 0.0, "SENS_BOARD_Z_OFF": 5.0}, "SENS_BOARD_Z_OFF 5"),
    ],
)
def test_refusals_say_what_helps(result, vehicle, said):
    with pytest.raises(HandcalError, match=said):
        text_of(result(vehicle), "px4")


def test_a_sensor_off_the_board_is_not_turned_with_it(result):
    external = {"CAL_ACC2_ROT": 0.0, "CAL_GYRO1_ROT": 0.0, "SENS_BOARD_ROT": 2.0}
    assert text_of(result(PX4_OWN | external), "px4") == text_of(result(PX4_OWN), "px4")


@pytest.mark.parametrize(
    ("vehicle", "to", "other"), [(PX4_OWN, "ardupilot", "px4"), (INS_OWN, "px4", "ardupilot")]
)
def test_a_log_of_the_one_is_not_for_the_other(result, vehicle, to, other):
    with pytest.raises(InputError, match=f"--to {other}"):
        text_of(result(vehicle), to)


def test_a_recording_is_no_result_and_a_typed_result_has_no_maker(result, tmp_path, main):
    log = tmp_path / "a b.ulg"
    log.write_bytes(format_files.ulog(sample(n=300, streams=False)))
    status, _, said = main("export", log, "--to", "px4", "-o", tmp_path / "out")
    assert (status, f"handcal explain '{log}' --json" in said) == (2, True)
    path = result(PX4_OWN, version="")
    maker = "# From result.json, calibration that does not say what wrote it\n"
    assert maker in text_of(path, "px4")


WHOLE = {k.replace("GYRO1", "GYRO0").replace("ACC2", "ACC0"): v for k, v in PX4_OWN.items()}
WHOLE |= {"CAL_GYRO0_ID": 1, "CAL_ACC0_ID": 1}


@pytest.mark.parametrize(
    ("raw", "own", "said"),
    [
        (True, {}, ["parameters are not in the recording"]),
        (True, WHOLE, []),
        (True, WHOLE | {"TC_A_ENABLE": 1}, ["TC_A_ENABLE"]),
        (True, WHOLE | {"SENS_BOARD_ROT": 2}, []),
        (False, WHOLE | {"SENS_BOARD_ROT": 2}, ["SENS_BOARD_ROT 2"]),
        (False, {}, ["parameters are not in the recording"]),
    ],
)
def test_info_says_what_an_export_will_lack(tmp_path, raw, own, said):
    path = tmp_path / "a.ulg"
    path.write_bytes(format_files.ulog(sample(n=300, streams=False), raw=raw, parameters=own))
    found = refusals(handcal.read(path))
    assert len(found) == len(said)
    assert all(word in line for word, line in zip(said, found, strict=True))
    shown = CliRunner().invoke(_app.app, ["info", str(path), "--json", "-"])
    assert [w for w in json.loads(shown.output)["warnings"] if "would refuse" in w] == found


def test_of_a_log_of_ardupilot_too(tmp_path):
    path = tmp_path / "a.bin"
    own = INS_OWN | {"AHRS_ORIENTATION": 8.0}
    path.write_bytes(format_files.dataflash(sample(n=300, streams=False), parameters=own))
    assert ["AHRS_ORIENTATION 8" in line for line in refusals(handcal.read(path))] == [True]
    assert any("only the first is read" in said for said in handcal.read(path).warnings)
    assert refusals(sample(n=300, streams=False)) == []


def test_a_log_has_further_imus_and_they_can_be_read(tmp_path):
    one = sample(n=300, streams=False)
    other = replace(one, imu=replace(one.imu, gyro=2 * one.imu.gyro, accel=one.imu.accel + 1.0))
    path = tmp_path / "two.ulg"
    path.write_bytes(format_files.ulog(one, second=other))
    first = load(path)
    (said,) = (w for w in first.warnings if "further IMUs" in w)
    np.testing.assert_allclose(first.imu.gyro, one.imu.gyro, atol=1e-5)
    topics = dict(word.split("=") for word in said.rstrip(".").split() if "=" in word)
    second = load(path, topics=topics)
    np.testing.assert_allclose(second.imu.gyro, other.imu.gyro, atol=1e-5)
    np.testing.assert_allclose(second.imu.accel, other.imu.accel, atol=1e-5)
    assert second.vehicle == dict.fromkeys(first.vehicle, 2.0)
    assert not any("further IMUs" in w for w in second.warnings)
    with pytest.raises(InputError, match="has sensor_gyro_0, sensor_gyro_1"):
        load(path, topics={"gyro": "sensor_gyro_2"})


def test_a_log_without_an_imu_says_how_to_log_one(tmp_path):
    content = format_files.ulog(sample(n=300, streams=False))
    path = tmp_path / "a.ulg"
    path.write_bytes(content.replace(b"sensor_gyro", b"sensor_gyrx"))
    with pytest.raises(InputError, match=r"'sensor_gyro 0 0' .*logger_topics\.txt"):
        handcal.read(path)


@pytest.mark.parametrize(
    ("vehicle", "topic", "path", "to"),
    [
        (PX4_OWN, "sensor_combined", "a.ulg", "px4"),
        ({}, "sensor_combined", "a.ulg", "px4"),
        (PX4_OWN, "/imu", "a.mcap", "px4"),
        (INS_OWN, "IMU", "a.bin", "ardupilot"),
        ({}, "/camera/imu", "a.mcap", "ros2"),
        ({}, "/imu", "a.bag", "ros2"),
        ({}, "/imu", "a.mcap", ""),
        ({}, "", "a.csv", ""),
    ],
)
def test_what_follows_is_the_export_that_fits(vehicle, topic, path, to):
    e = fake_explanation("explained", recordings=1)
    read = replace(e.recordings[0].recording, vehicle=vehicle, path=path,
                   topics={"imu": topic} if topic else {})  # fmt: skip
    e = replace(e, recordings=(replace(e.recordings[0], recording=read),))
    lines = [x for x in commands(e, [path], [], "b.json") if x.startswith("handcal export")]
    wanted = f"handcal export b.json --to {to} --recording {path} -o a-calibration."
    assert [x[: len(wanted)] for x in lines] == ([wanted] if to else [])

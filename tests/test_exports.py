"""Each export, read back and applied as its program documents it, does what `apply` does."""

import json
import re
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import yaml
from imucal import FerrarisCalibrationInfo
from imufusion import model_inertial
from pymavlink.mavparm import MAVParmDict

from handcal import exports
from handcal.commands import _app
from handcal.device import apply as device
from handcal.effects import Effect, Param, catalogue, with_effects
from handcal.exports import format_of, formats
from handcal.exports._contents import contents
from handcal.types import HandcalError, Imu, InputError, Recording

BIASES = ("gyro_bias", "accel_bias")
DIAGONAL = (*BIASES, "accel_scale")
NO_G = (*DIAGONAL, "accel_misalignment", "gyro_scale", "gyro_misalignment")
MATRICES = (*NO_G, "gyro_g_sensitivity")
EQUAL = 1e-9
# Eight roundings of readings up to ten, in single precision.
SINGLE = 8 * 10 * 2.0**-24


def drawn(seed, ids):
    """Values of effects, of the usual sizes."""
    rng = np.random.default_rng(seed)
    found = {i: rng.normal(0.0, [p.prior_sigma for p in catalogue()[i].parameters]) for i in ids}
    for i in ids:
        found[i] = [abs(v) if p.positive else float(v)
                    for v, p in zip(found[i], catalogue()[i].parameters, strict=True)]  # fmt: skip
    return found


def document(values, **more):
    """What `calibrate --json` writes, with these values."""
    parameters = [
        {"effect": i, "name": p.name, "value": v, "sigma": p.prior_sigma / 2000.0, "unit": p.unit,
         "observable": True, "converged_at_s": 30.0}
        for i, own in values.items()
        for p, v in zip(catalogue()[i].parameters, own, strict=True)
    ]  # fmt: skip
    noise = [{"name": "gyro_noise", "value": 2e-5, "unit": "rad/s/sqrt(Hz)"},
             {"name": "accel_noise", "value": 2e-3, "unit": "m/s^2/sqrt(Hz)"}]  # fmt: skip
    recording = {"path": "turns.mcap", "duration_s": 10.0, "imu_rate_hz": 100.0, "sha256": "1f",
                 "vehicle": OWN}  # fmt: skip
    return {"schema": "handcal/calibration/1", "version": "9.8.7", "recording": recording,
            "parameters": parameters, "noise": noise, "warnings": []} | more  # fmt: skip


@pytest.fixture
def result(tmp_path):
    def write(values, **more):
        path = tmp_path / "result.json"
        path.write_text(json.dumps(document(values, **more)), encoding="utf-8")
        return path

    return write


def recording(seed=0, n=500):
    """Readings of a hand in motion, as far as size goes."""
    rng = np.random.default_rng(1000 + seed)
    t = np.arange(n) / 100.0
    tones = rng.uniform(0.5, 4.0, 6)
    waves = np.sin(t[:, None] * tones + rng.uniform(0.0, 6.0, 6)) * 3.0
    gyro, accel = waves[:, :3], 3.0 * waves[:, 3:]
    return Recording("turns.mcap", Imu(t, gyro, accel, np.ones(n, dtype=bool)), {})


def readings(given):
    return given.imu.gyro, given.imu.accel


def applied(path, given):
    """Rate and force as `handcal apply --biases` gives them."""
    imu = device.apply(given, device.read(path), biases=True).recording.imu
    return imu.gyro, imu.accel


def written(path, name, **options):
    form = format_of(name)
    return form.write(contents(path, form, **options))


def close(found, wanted, atol=EQUAL):
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=atol)


def of(values):
    return (np.array(values[i]) for i in BIASES)


@pytest.mark.parametrize("seed", range(3))
def test_kalibr(result, seed):
    values, given = drawn(seed, MATRICES), recording(seed)
    path = result(values)
    text = yaml.safe_load(written(path, "kalibr", topic="/phone/imu"))
    chain = text["imu0"]
    M_a, M_g, A, C = (
        np.array(chain[sensor][name])
        for sensor, name in (("accelerometers", "M"), ("gyroscopes", "M"), ("gyroscopes", "A"),
                             ("gyroscopes", "C_gyro_i"))
    )  # fmt: skip
    np.testing.assert_array_equal([np.triu(M_a, 1), np.triu(M_g, 1)], 0.0)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(C) > 0
    (gyro, accel), (b_g, b_a) = readings(given), of(values)
    force = np.linalg.solve(M_a, (accel - b_a).T)
    rate = C.T @ np.linalg.solve(M_g, (gyro - b_g).T - A @ C @ force)
    close((rate.T, force.T), applied(path, given))
    for place in (text, chain):
        assert place["gyroscope_noise_density"] == 2e-5  # (a number, no word)
        assert place["accelerometer_noise_density"] == 2e-3
        assert place["update_rate"] == 100.0
        assert place["rostopic"] == "/phone/imu"
    assert chain["model"] == "scale-misalignment"


def of_openvins(text):
    first, rest = text.split("\n", 1)
    assert first == "%YAML:1.0"
    chain = yaml.safe_load(rest)["imu0"]
    names = ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC", "Tg")
    return chain["model"], *(np.array(chain[name]) for name in names)


def openvins(chain, values, given, triangle):
    """OpenVINS' own way: inverses first, then only a triangle of each."""
    _, Tw, R_gyro, Ta, R_acc, Tg = chain
    Dw, Da = triangle(np.linalg.inv(Tw)), triangle(np.linalg.inv(Ta))
    (gyro, accel), (b_g, b_a) = readings(given), of(values)
    force = R_acc.T @ Da @ (accel - b_a).T
    rate = R_gyro.T @ Dw @ ((gyro - b_g).T - Tg @ force)
    return rate.T, force.T


@pytest.mark.parametrize("seed", range(3))
def test_openvins_kalibr(result, seed):
    values, given = drawn(seed, MATRICES), recording(seed)
    path = result(values)
    chain = of_openvins(written(path, "openvins"))
    assert chain[0] == "kalibr"
    np.testing.assert_array_equal(chain[4], np.eye(3))
    close(openvins(chain, values, given, np.tril), applied(path, given))


@pytest.mark.parametrize("seed", range(3))
def test_openvins_rpng_on_the_axes_that_it_says(result, seed):
    values, given = drawn(seed, MATRICES), recording(seed)
    path = result(values)
    text = written(path, "openvins_rpng")
    chain = of_openvins(text)
    assert chain[0] == "rpng"
    np.testing.assert_array_equal(chain[2], np.eye(3))
    line = next(x for x in text.split("\n") if x.startswith("# R_openvins_handcal: "))
    R = np.array(json.loads(line.split(": ")[1]))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    turned = [x @ R.T for x in applied(path, given)]
    close(openvins(chain, values, given, np.triu), turned)


@pytest.mark.parametrize("seed", range(3))
def test_fusion_by_its_own_package(result, seed):
    given = recording(seed)
    path = result(drawn(seed, NO_G))
    lines = written(path, "fusion").split("\n")
    names = {"numpy": np}
    for line in lines:
        if "= numpy.array" in line:
            exec(line.removeprefix("// "), names)
    for sensor, read, wanted in zip(("gyroscope", "accelerometer"), readings(given),
                                    applied(path, given), strict=True):  # fmt: skip
        numbers = [names[f"{sensor}_{n}"] for n in ("misalignment", "sensitivity", "offset")]
        for r, w in zip(read[::50], wanted[::50], strict=True):
            np.testing.assert_allclose(model_inertial(r, *numbers), w, rtol=0.0, atol=SINGLE)
        M, s, b = numbers
        np.testing.assert_allclose((M @ (s * (read - b)).T).T, wanted, rtol=0.0, atol=EQUAL)
        c_line = next(x for x in lines if f"{sensor}Misalignment" in x)
        in_c = c_line.split("{.array = ")[1].rstrip("};").replace("f", "")
        in_c = json.loads("[" + in_c.replace("{", "[").replace("}", "]").rstrip("]") + "]" * 3)
        np.testing.assert_allclose(np.ravel(in_c), M.ravel(), rtol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_imucal_by_its_own_package(result, seed, tmp_path):
    given = recording(seed)
    path = result(drawn(seed, MATRICES))
    file = tmp_path / "ferraris.json"
    file.write_text(written(path, "imucal"), encoding="utf-8")
    info = FerrarisCalibrationInfo.from_json_file(file)
    gyro, accel = readings(given)
    force, rate = info.calibrate(accel, gyro, "m/s^2", "rad/s")
    close((rate, force), applied(path, given))
    assert "turns.mcap" in info.comment


# The calibration that a vehicle had, by which readings were corrected before they were logged.
PX4_OWN = {"CAL_GYRO1_ID": 7, "CAL_GYRO1_XOFF": 0.01, "CAL_GYRO1_YOFF": -0.02,
           "CAL_GYRO1_ZOFF": 0.03, "CAL_ACC2_ID": 9, "CAL_ACC2_XOFF": 0.3, "CAL_ACC2_YOFF": -0.74,
           "CAL_ACC2_ZOFF": 0.1, "CAL_ACC2_XSCALE": 0.98, "CAL_ACC2_YSCALE": 1.012,
           "CAL_ACC2_ZSCALE": 1.03}  # fmt: skip
PX4_NAMES = ("CAL_GYRO1_{}OFF", "CAL_ACC2_{}OFF", "CAL_ACC2_{}SCALE")
INS_NAMES = ("INS_GYROFFS_{}", "INS_ACCOFFS_{}", "INS_ACCSCAL_{}")
INS_OWN = {new.format(axis): PX4_OWN[old.format(axis)]
           for old, new in zip(PX4_NAMES, INS_NAMES, strict=True) for axis in "XYZ"}  # fmt: skip
OWN = PX4_OWN | INS_OWN


def vehicle(parameters, names, given, axes):
    """The readings in the vehicle's axes without its own correction, and then corrected as both
    autopilots do it; what the file does not have the vehicle keeps."""
    turn = np.array([1.0, -1.0, -1.0]) if axes == "flu" else np.ones(3)
    gyro, accel = (x * turn for x in readings(given))
    before, after = (
        [np.array([own[name.format(axis)] for axis in "XYZ"]) for name in names]
        for own in (OWN, OWN | dict(parameters))
    )
    raw_gyro, raw_accel = gyro + before[0], accel / before[2] + before[1]
    return (raw_gyro - after[0]) * turn, (raw_accel - after[1]) * after[2] * turn


def qgroundcontrol(text):
    """Its loader's way (ParameterManager::readParametersFromStream): tabs, five fields."""
    rows = [line.split("\t") for line in text.splitlines() if line and not line.startswith("#")]
    assert {(len(r), r[0], r[1], r[4]) for r in rows} == {(5, "1", "1", "9")}
    return {r[2]: float(r[3]) for r in rows}


@pytest.mark.parametrize("axes", ["flu", "frd"])
def test_px4(result, axes):
    given = recording()
    values = drawn(0, DIAGONAL)
    path = result(values)
    parameters = qgroundcontrol(written(path, "px4", axes=axes))
    assert set(parameters) == {name.format(axis) for name in PX4_NAMES for axis in "XYZ"}
    close(vehicle(parameters, PX4_NAMES, given, axes), applied(path, given))
    sign = -1.0 if axes == "flu" else 1.0
    assert parameters["CAL_GYRO1_ZOFF"] == pytest.approx(
        0.03 + sign * values["gyro_bias"][2], abs=1e-11
    )


@pytest.mark.parametrize("axes", ["flu", "frd"])
def test_ardupilot_by_pymavlink(result, axes, tmp_path):
    given = recording()
    path = result(drawn(0, DIAGONAL))
    file = tmp_path / "a.param"
    file.write_text(written(path, "ardupilot", axes=axes), encoding="utf-8")
    parameters = MAVParmDict()
    assert parameters.load(str(file), use_excludes=False)
    assert len(parameters) == 9
    close(vehicle(parameters, INS_NAMES, given, axes), applied(path, given))


def test_ardupilot_refuses_a_scale_that_it_does_not_take(result):
    path = result(drawn(0, BIASES) | {"accel_scale": [0.3, 0.0, 0.0]})
    with pytest.raises(HandcalError, match=r"0\.8 to 1\.2"):
        written(path, "ardupilot")


@pytest.mark.parametrize("seed", range(3))
def test_realsense(result, seed):
    given = recording(seed)
    path = result(drawn(seed, NO_G))
    imu = json.loads(written(path, "realsense"))["imus"][0]
    found = []
    for sensor, read in zip(("gyroscope", "accelerometer"), readings(given), strict=True):
        one = imu[sensor]
        X = np.reshape([*one["scale_and_alignment"], *one["bias"]], (4, 3))
        found.append(np.column_stack([read, -np.ones(len(read))]) @ X)  # as the script fits it
        data = np.array(one["data"])
        np.testing.assert_allclose(read @ data[:, :3].T - data[:, 3], found[-1], atol=1e-12)
    close(found, applied(path, given))


def test_python_function(result):
    given = recording()
    path = result(drawn(0, MATRICES))
    names = {}
    exec(written(path, "python"), names)
    found = [names["corrected"](w, a) for w, a in zip(*readings(given), strict=True)]
    close([np.array(x) for x in zip(*found, strict=True)], applied(path, given))


MAIN = """
#include <stdio.h>
#include "correct.h"
int main(void) {
    double w[3], a[3];
    while (scanf("%lf %lf %lf %lf %lf %lf", w, w + 1, w + 2, a, a + 1, a + 2) == 6) {
        handcal_correct(w, a, w, a);
        printf("%.17g %.17g %.17g %.17g %.17g %.17g\\n", w[0], w[1], w[2], a[0], a[1], a[2]);
    }
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler cc")
def test_c_header_compiled(result, tmp_path):
    given = recording()
    path = result(drawn(0, MATRICES))
    (tmp_path / "correct.h").write_text(written(path, "c"), encoding="utf-8")
    (tmp_path / "main.c").write_text(MAIN, encoding="utf-8")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["cc", *strict, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    lines = "".join(" ".join(map(repr, map(float, r))) + "\n" for r in np.hstack(readings(given)))
    done = subprocess.run([tmp_path / "main"], input=lines, capture_output=True, text=True,
                          check=True)  # fmt: skip
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    close((found[:, :3], found[:, 3:]), applied(path, given))


def ros2_reads(text):
    """What ROS 2's reader of parameter files takes (rcl_yaml_param_parser, README): a node, then
    ros__parameters, of which each is a scalar or a list of scalars of one type."""
    ((node, own),) = yaml.safe_load(text).items()
    assert (node, set(own)) == ("/**", {"ros__parameters"})
    for key, value in own["ros__parameters"].items():
        kinds = {type(one) for one in (value if isinstance(value, list) else [value])}
        assert len(kinds) == 1, key
        assert kinds <= {bool, int, float, str}, key
        if key.endswith("_covariance"):
            assert (len(value), kinds) == (9, {float}), key
    return own["ros__parameters"]


def test_ros2_covariance_is_that_of_the_samples(result):
    text = ros2_reads(written(result(drawn(0, MATRICES)), "ros2"))
    for name, density in (("angular_velocity", 2e-5), ("linear_acceleration", 2e-3)):
        covariance = np.reshape(text[f"{name}_covariance"], (3, 3))
        np.testing.assert_allclose(covariance, np.eye(3) * density**2 * 100.0)
    assert text["orientation_covariance"] == [-1.0, *[0.0] * 8]


def kalibr_reads(text):
    """What Kalibr's reader asks of --imu (kalibr_common/ConfigReader.py, ImuParameters)."""
    found = yaml.safe_load(text)
    assert isinstance(found["rostopic"], str)
    for key in ("update_rate", *STATISTICS):
        assert isinstance(found[key], float), key  # (a word has no <=)
        assert found[key] > 0.0
    return found


def openvins_reads(text):
    """What OpenVINS asks of its IMU chain (VioManagerOptions.h, opencv_yaml_parse.h): all of these
    keys, matrices as lists of rows, and the line by which OpenCV knows YAML."""
    first, rest = text.split("\n", 1)
    assert first == "%YAML:1.0"
    found = yaml.safe_load(rest)["imu0"]
    for key in STATISTICS:
        assert isinstance(found[key], float)
        assert found[key] > 0.0
    for key, n in (("Tw", 3), ("Ta", 3), ("R_IMUtoACC", 3), ("R_IMUtoGYRO", 3), ("Tg", 3),
                   ("T_i_b", 4)):  # fmt: skip
        assert np.array(found[key]).shape == (n, n)
        assert all(isinstance(v, float) for row in found[key] for v in row)
    return found


STATISTICS = ("accelerometer_noise_density", "accelerometer_random_walk",
              "gyroscope_noise_density", "gyroscope_random_walk")  # fmt: skip
CHAINS = {"kalibr": kalibr_reads, "openvins": openvins_reads, "openvins_rpng": openvins_reads}


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_is_loaded_whatever_noise_is_known(result, tmp_path, name):
    """Kalibr refused every file of a device that had not lain still for hours."""
    allan = tmp_path / "allan.json"
    seen = [{"name": "gyro_noise", "value": 1e-4}, {"name": "gyro_bias_walk", "value": 3e-6}]
    bounds = [{"channel": f"accel_{axis}", "not_seen": [{"name": "K", "at_most": most},
                                                        {"name": "R", "at_most": 0.3}]}
              for axis, most in zip("xyz", (1e-4, 4e-4, 2e-4), strict=True)]  # fmt: skip
    said = {"schema": "handcal/allan/1", "suggested": seen, "channels": bounds}
    allan.write_text(json.dumps(said))
    for noise in ([], None):
        more = {} if noise is None else {"noise": noise}
        text = written(result(drawn(0, MATRICES), **more), name)
        found = CHAINS[name](text)
        defaults = [line for line in text.splitlines() if "DEFAULT, not measured" in line]
        own = 0 if noise == [] else 2
        assert len(defaults) == (4 - own) * (2 if name == "kalibr" else 1)
        assert ("EuRoC data set: accel_bias_walk, gyro_bias_walk." in text) == (own == 2)
        assert ("of the motion: accel_noise, gyro_noise." in text) == (own == 2)
        if own:
            assert found["gyroscope_noise_density"] == 2e-5
    text = written(result(drawn(0, MATRICES)), name, allan=allan)
    found = CHAINS[name](text)
    assert found["gyroscope_noise_density"] == 1e-4
    assert found["gyroscope_random_walk"] == 3e-6
    assert found["accelerometer_random_walk"] == 4e-4
    (line, *_) = [x for x in text.splitlines() if "accelerometer_random_walk" in x]
    assert "at most, 95 %: not seen at rest (allan.json)" in line
    assert "of the fit" not in text
    assert "EuRoC data set: accel_noise." in text


def allan_json(path, name="still.mcap", rate=100.0):
    levels = [("gyro_noise", 1e-4), ("accel_noise", 2e-3), ("gyro_bias_walk", 3e-6)]
    imu = {"samples": 60_000, "topic": "/imu/raw"}
    document = {
        "schema": "handcal/allan/1", "version": "9.8.7", "channels": [], "warnings": ["It hums."],
        "suggested": [{"name": n, "value": v} for n, v in levels],
        "recording": {"path": name, "duration_s": 600.0, "imu_rate_hz": rate,
                      "streams": {"imu": imu}},
    }  # fmt: skip
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", CHAINS)
def test_the_noise_of_a_rest_alone_makes_a_chain(tmp_path, name, main):
    """A Kalibr user's commonest need was refused."""
    allan, out = allan_json(tmp_path / "allan.json", rate=200.0000000001819), tmp_path / "out.yaml"
    status, _, said = main("export", allan, "--to", name, "-o", out)
    assert (status, "Nothing was calibrated" in said) == (0, True)
    text = out.read_text()
    found = CHAINS[name](text)
    assert found["gyroscope_noise_density"] == 1e-4
    assert found["gyroscope_random_walk"] == 3e-6
    assert "accelerometer_random_walk: 0.003  # m/s^3/sqrt(Hz), walk of the bias; DEFAULT" in text
    assert (found["rostopic"], found["update_rate"]) == ("/imu/raw", 200.0)
    for said in (
        "at rest, allan.json of still.mcap",
        "Warning: It hums.",
        "From allan.json, allan",
    ):
        assert said in text
    covariances = ros2_reads(written(allan, "ros2"))
    assert covariances["angular_velocity_covariance"][0] == pytest.approx(1e-8 * 200.0)


def test_noise_alone_is_refused_where_it_has_no_place(tmp_path, result):
    allan = allan_json(tmp_path / "allan.json")
    for name in formats().keys() - {*CHAINS, "ros2"}:
        with pytest.raises(InputError, match=r"noise alone.*kalibr, openvins"):
            written(allan, name)
    with pytest.raises(InputError, match="leave --noise away"):
        written(allan, "kalibr", allan=allan)
    with pytest.raises(InputError, match=r"explain.*lab scalar.*allan"):
        written(result({}, schema="handcal/info/1"), "kalibr")


def test_noise_of_another_rate_is_pointed_out(tmp_path, result):
    path = result(drawn(0, NO_G))
    for rate, said in ((100.2, False), (200.0, True)):
        allan = allan_json(tmp_path / "allan.json", rate=rate)
        assert ("measured at 200 Hz, and the rate here is 100 Hz" in
                written(path, "kalibr", allan=allan)) == said  # fmt: skip


@pytest.mark.parametrize(
    ("rest", "said"),
    [({"gyro_noise": 1.9e-5}, "about that of its rest"), ({"gyro_noise": 1e-6}, "20 times that"),
     ({}, "without a rest")],
)  # fmt: skip
def test_noise_of_a_fit_stands_beside_that_of_the_rest(result, rest, said):
    """What drones do was told to devices that lay still."""
    of = document({})["recording"] | {"rest_noise": rest}
    text = written(result(drawn(0, NO_G), recording=of), "kalibr")
    (line, *_) = [x for x in text.splitlines() if x.startswith("gyroscope_noise_density")]
    assert said in line
    (warned,) = [x for x in text.splitlines() if "noise of the fit" in x]
    assert ("gyro_noise" in warned) == (said != "about that of its rest")


def test_rate_and_topic_are_of_one_recording(result):
    """Those of a recording by which errors were measured stood beside the result's."""
    imu = {"imu": {"samples": 1000, "topic": "/imu/raw"}}
    path = result(drawn(0, MATRICES), recording=document({})["recording"] | {"streams": imu})
    given = recording()
    other = Recording("other.mcap", Imu(given.imu.t / 2.0, *readings(given), given.imu.valid), {},
                      topics={"imu": "/imu/other"})  # fmt: skip
    found = kalibr_reads(text := written(path, "kalibr", recording=other))
    assert (found["rostopic"], found["update_rate"]) == ("/imu/raw", 100.0)
    assert "other.mcap has 200 Hz on /imu/other" in text
    assert "other.mcap seems to be of another device" in text
    assert "Warning: turns.mcap" not in written(path, "kalibr", recording=given)


@pytest.mark.parametrize(
    ("typed", "read", "found"),
    [("cam0/imu", "", "/cam0/imu"), ("cam0/imu", "cam0/imu", "cam0/imu"),
     ("/cam0/imu", "cam0/imu", "/cam0/imu"), (None, "cam0/imu", "cam0/imu")],
)  # fmt: skip
def test_a_topic_is_as_the_bag_has_it_or_as_ros_resolves_it(result, typed, read, found):
    streams = {"imu": {"samples": 1000, "topic": read}}
    path = result(drawn(0, NO_G), recording=document({})["recording"] | {"streams": streams})
    assert kalibr_reads(written(path, "kalibr", topic=typed))["rostopic"] == found


def test_which_errors_a_file_corrects_and_which_of_them_were_found(result):
    missing = [{"effect": "gyro_scale"}]
    path = result(drawn(0, (*DIAGONAL, "gyro_scale", "gyro_bandwidth", "lever_arm")),
                  schema="handcal/explanation/1", missing=missing)  # fmt: skip
    header = contents(path, format_of("kalibr")).header
    assert "Errors that this file corrects: accel_scale, gyro_scale" in header
    (line,) = [x for x in header if x.startswith("Of these explain found")]
    assert line.split(": ", 1)[1].startswith("gyro_scale; ")
    assert line.endswith("not found: accel_scale")
    header = contents(path, format_of("python")).header
    assert f"Errors that this file corrects: {', '.join(BIASES)}, accel_scale, gyro_scale" in header


def test_of_which_readings_the_numbers_are(result):
    of = document({})["recording"] | {"corrected": {"ab": "why.json"}}
    for name in (*CHAINS, "ros2", "c", "python"):
        assert "For raw readings, not for" in written(result(drawn(0, NO_G)), name)
        text = written(result(drawn(0, NO_G), recording=of), name)
        assert "For readings that why.json had corrected" in text


def test_sizes_say_of_which_readings_they_are(result):
    """A delay left 0.02 m/s^2 without --recording and 0.6 with it."""
    missing = [{"effect": "gyro_bandwidth", "size": {"gyro_x": 0.03}}]
    path = result(drawn(0, (*MATRICES, "gyro_bandwidth")), missing=missing)
    text = written(path, "python")
    assert "gyro 0.0173 rad/s RMS in the steps of the fit" in text
    assert "--recording turns.mcap" in text
    (line,) = [x for x in written(path, "python", recording=recording()).splitlines()
               if "Not in this file, gyro_bandwidth" in x]  # fmt: skip
    assert line.endswith("RMS in the readings of turns.mcap")


def test_noise_that_is_needed_is_asked_for(result):
    path = result(drawn(0, MATRICES), noise=[{"name": "accel_beyond_noise", "value": 0.1}])
    with pytest.raises(HandcalError, match="--noise"):
        written(path, "ros2")
    with pytest.raises(InputError, match="handcal allan"):
        written(path, "kalibr", allan=path)


def test_the_rate_is_the_sensors(result):
    """Of an older result, or one that says none, that of the recording."""
    given = recording()
    path = result(drawn(0, MATRICES), recording={"path": "turns.mcap"})
    with pytest.raises(HandcalError, match="--recording"):
        written(path, "kalibr")
    assert kalibr_reads(written(path, "kalibr", recording=given))["update_rate"] == 100.0
    averaged = document({})["recording"] | {"imu_rate_hz": 50.0}
    path = result(drawn(0, MATRICES), recording=averaged)
    assert kalibr_reads(written(path, "kalibr", recording=given))["update_rate"] == 100.0
    text = ros2_reads(written(path, "ros2", recording=given))
    assert text["angular_velocity_covariance"][0] == pytest.approx(2e-5**2 * 100.0)


def unknown(lines):
    """Sensors of which a file says that they were not calibrated."""
    return [line.split(" nothing was calibrated")[0].split()[-1] for line in lines
            if " nothing was calibrated" in line]  # fmt: skip


@pytest.mark.parametrize("name", [*CHAINS, "python", "imucal", "realsense", "fusion"])
def test_no_identity_without_a_word(result, main, tmp_path, name):
    one = result(drawn(0, (*BIASES, "gyro_scale")))
    assert unknown(contents(one, format_of(name)).header) == ["accelerometer"]
    path = result(drawn(0, BIASES))
    status, _, said = main("export", path, "--to", name, "-o", tmp_path / "out")
    assert (status, unknown(said.splitlines())) == (0, ["gyro", "accelerometer"])
    assert said.count("nothing was calibrated but the bias: ") == 2
    for effect in ("gyro_scale", "accel_scale"):
        assert catalogue()[effect].motion in said.replace("\n", " ")
    assert unknown(written(result(drawn(0, NO_G)), name).splitlines()) == []
    path = result(drawn(0, ("gyro_scale",)))  # (an accelerometer of which not even a bias is known)
    (line,) = [x for x in contents(path, format_of(name)).header if "nothing was calibrated" in x]
    assert "nothing was calibrated: scale" in line


def test_nothing_at_all_is_refused_with_what_would_show_it(result):
    rows = [
        p | {"observable": False, "shown": False} for p in document(drawn(0, BIASES))["parameters"]
    ]
    path = result({}, parameters=rows)
    for name in ("px4", "ardupilot", "python", "c"):
        with pytest.raises(HandcalError, match=r"nothing was calibrated.*up and down for a while"):
            written(path, name)


@pytest.mark.parametrize("name", [n for n, form in formats().items()])
def test_header_says_what_from_which_and_by_whom(result, name):
    text = written(result(drawn(0, MATRICES)), name)
    for words in ("gyro_misalignment", "result.json", "turns.mcap", "handcal 9.8.7", "sha256 1f"):
        assert words in text


@pytest.mark.parametrize("name", sorted(formats().keys() - {"ros2", "px4", "ardupilot", "kalibr"}))
def test_a_result_that_says_the_least_is_enough(result, name):
    full = document(drawn(0, MATRICES))["parameters"]
    rows = [{k: p[k] for k in ("effect", "name", "value")} for p in full]
    path = result({}, parameters=rows, noise=[], schema="handcal/explanation/1", recording={})
    assert "gyro_misalignment" in written(path, name)


OTHERS = "a.mcap\nimport os; os.system('x')\r\u2028#\x1b[31m ??/\\"


@pytest.mark.parametrize("name", sorted(formats()))
def test_the_words_of_somebody_elses_result_begin_no_line(result, name):
    """An exported program ran what a result had for the name of its recording."""
    values = drawn(0, DIAGONAL)
    plain = written(result(values, warnings=["w"]), name)
    given = document(values, version=OTHERS, warnings=[OTHERS])
    given["recording"]["path"] = OTHERS
    path = result(values)
    path.write_text(json.dumps(given), encoding="utf-8")
    text = written(path, name)
    assert all(c.isprintable() for c in text.replace("\n", "").replace("\t", ""))
    said = [line for line in text.splitlines() if "import os;" in line]
    assert not any(line.endswith(("\\", "??/")) for line in said)
    assert len(text.splitlines()) == len(plain.splitlines())
    assert not any(line.startswith("import os;") for line in text.splitlines())


@pytest.mark.parametrize(
    ("name", "words", "shown"),
    [
        ("latex", r"\input{x}^a", r"\textbackslash{}input\{x\}$^{a}$"),
        ("markdown", "a|<b>", r"a\|&lt;b&gt;"),
        ("csv", "=1+1", "'=1+1"),
    ],
)
def test_a_table_shows_words_as_words(result, name, words, shown):
    given = document(drawn(0, DIAGONAL))
    given["parameters"][0]["unit"] = words
    path = result({})
    path.write_text(json.dumps(given), encoding="utf-8")
    assert shown in written(path, name)
    assert words not in written(path, name).replace(shown, "")


def rms(error):
    return np.sqrt((error**2).mean())


def test_what_is_left_is_what_is_measured(result):
    given, values = recording(), drawn(1, (*MATRICES, "gyro_bandwidth", "lever_arm"))
    path = result(values)
    form = format_of("px4")
    made = contents(path, form, given)
    left = {line.split(": ")[0].removeprefix("Not in this file, "): line.split(": ")[1]
            for line in made.header if line.startswith(("Not in", "All of"))}  # fmt: skip
    total = left.pop("All of that together, in turns.mcap")
    assert set(left) == {"gyro_scale", "gyro_misalignment", "accel_misalignment",
                         "gyro_g_sensitivity", "gyro_bandwidth"}  # fmt: skip
    assert "No errors of gyro or accelerometer: lever_arm" in made.header
    # The parameter file's own correction beside all that is known.
    kept = [x[:, :3] for x in np.split(made.correction.applied(np.hstack(readings(given))), 2, 1)]
    for found, wanted, sensor in zip(kept, applied(path, given), ("gyro", "accelerometer"),
                                     strict=True):  # fmt: skip
        number = float(total.split(f"{sensor} ")[1].split()[0])
        assert number == pytest.approx(rms(found - wanted), rel=0.01)
    scale = device.read(path).values["gyro_scale"]
    number = float(left["gyro_scale"].split()[1])
    assert number == pytest.approx(rms(given.imu.gyro * scale / (1 + scale)), rel=0.01)
    with_it, without = values, {i: v for i, v in values.items() if i != "gyro_bandwidth"}
    change = applied(result(with_it), given)[0] - applied(result(without), given)[0]
    assert float(left["gyro_bandwidth"].split()[1]) == pytest.approx(rms(change), rel=0.01)


def test_rounding_is_not_told_as_an_error_that_is_left(result):
    """Of a gyro's misalignment an autopilot's scales leave nothing in the accelerometer."""
    path = result(drawn(0, (*DIAGONAL, "gyro_misalignment")))
    (total,) = (x for x in contents(path, format_of("px4"), recording()).header
                if x.startswith("All of that together"))  # fmt: skip
    assert "gyro 0." in total
    assert "accelerometer" not in total


def test_sizes_of_an_explanation_are_told_without_the_recording(result):
    missing = [{"effect": "gyro_bandwidth", "size": {"gyro_x": 0.03, "gyro_z": 0.04}}]
    path = result(drawn(0, (*MATRICES, "gyro_bandwidth")), missing=missing)
    assert "gyro_bandwidth: gyro 0.0289 rad/s RMS" in written(path, "python")


def test_a_law_without_a_name_is_named_by_its_formula(result):
    formula = "gyro_x += k * omega_y^2"
    row = {"effect": formula, "name": "k", "value": 0.01, "sigma": 1e-3, "unit": "s/rad"}
    rows = [*document(drawn(0, MATRICES))["parameters"], row]
    more = {"parameters": rows, "unnamed": [{"formula": formula}]}
    path = result({}, schema="handcal/explanation/1", **more)
    for given in (None, recording()):
        text = written(path, "python", recording=given)
        assert f"Not in this file, {formula}: it has no name" in text


def of_my_own(name, error):
    words = dict.fromkeys(("title", "story", "source", "motion", "validated"), "x")
    return Effect(id=name, parameters=(Param("k", "1", 0.01),), imu_error=error, **words)


def adds(column, function):
    def error(k, signals):
        out = np.zeros((len(signals.t), 6))
        out[:, column] = k[0] * function(signals)
        return out

    return error


def test_an_effect_file_that_is_linear_is_exported_unchanged(result):
    effect = of_my_own("gyro_feels", adds(0, lambda s: s.gyro[:, 2] - 0.1 * s.accel[:, 1] + 0.5))
    given = recording()
    with with_effects([("here", effect)]):
        path = result(drawn(0, MATRICES) | {"gyro_feels": [0.02]})
        names = {}
        text = written(path, "python")
        exec(text, names)
        found = [names["corrected"](w, a) for w, a in zip(*readings(given), strict=True)]
        close([np.array(x) for x in zip(*found, strict=True)], applied(path, given))
    assert "Not in this file" not in text


@pytest.mark.parametrize(
    "error",
    [adds(0, lambda s: s.gyro[:, 0] ** 2), adds(1, lambda s: np.sin(s.t)),
     adds(3, lambda s: s.gyro[:, 0]), adds(4, lambda s: np.abs(s.accel[:, 1]))],
)  # fmt: skip
def test_an_effect_that_is_no_matrix_is_named(result, error):
    with with_effects([("here", of_my_own("bends", error))]):
        assert "Not in this file, bends" in written(
            result({"bends": [0.02]} | drawn(0, BIASES)), "c"
        )


def test_an_accelerometer_that_turns_against_the_body_is_refused(result):
    effect = of_my_own("accel_xy", adds(3, lambda s: s.accel[:, 1]))
    with with_effects([("here", effect)]):
        path = result({"accel_xy": [0.02]} | drawn(0, BIASES))
        for name in ("kalibr", "openvins"):
            with pytest.raises(HandcalError, match="x axis"):
                written(path, name)
        given = recording()
        text = written(path, "openvins_rpng")  # whose axes are the gyro's
        values = {i: drawn(0, BIASES)[i] for i in BIASES}
        line = next(x for x in text.split("\n") if x.startswith("# R_openvins_handcal: "))
        R = np.array(json.loads(line.split(": ")[1]))
        close(openvins(of_openvins(text), values, given, np.triu),
              [x @ R.T for x in applied(path, given)])  # fmt: skip


def test_hidden_axes_are_left_to_the_vehicle(result):
    path = result(drawn(0, DIAGONAL))
    found = json.loads(path.read_text())
    for p in found["parameters"]:
        if (p["effect"], p["name"]) == ("accel_bias", "z"):
            p["observable"] = False
    path.write_text(json.dumps(found))
    text = written(path, "px4")
    assert "accel_bias z: not shown" in text
    assert "\tCAL_ACC2_ZOFF\t" not in text
    assert "\tCAL_ACC2_XOFF\t" in text
    close(vehicle(qgroundcontrol(text), PX4_NAMES, recording(), "flu"),
          applied(path, recording()))  # fmt: skip
    names = {}
    exec(written(path, "python"), names)
    assert names["ACCEL_BIAS"][2] == 0.0


def test_without_biases_no_zeros_for_a_vehicle(result):
    path = result(drawn(0, ("accel_scale",)))
    for name in ("px4", "ardupilot"):
        with pytest.raises(HandcalError, match="no biases"):
            written(path, name)
    assert "ACCEL_BIAS = (0.0, 0.0, 0.0)" in written(path, "python")
    with pytest.raises(HandcalError, match="nothing that this format can hold"):
        written(result(drawn(0, ("gyro_bandwidth",))), "python")


def test_biases_of_several_recordings(result):
    one, other = drawn(0, BIASES), drawn(1, BIASES)
    parts = [
        {"recording": document({})["recording"] | {"path": name},
         "parameters": document(values)["parameters"], "noise": []}
        for name, values in (("a.mcap", one), ("turns.mcap", other))
    ]  # fmt: skip
    more = {"schema": "handcal/explanation/1", "recordings": parts}
    path = result({"accel_scale": [0.01, 0.0, 0.0]}, **more)
    form = format_of("python")
    wanted = np.concatenate([other[i] for i in BIASES])
    np.testing.assert_allclose(contents(path, form, recording()).bias, wanted, atol=1e-15)
    mean = contents(path, form)
    both = 0.5 * (wanted + np.concatenate([one[i] for i in BIASES]))
    np.testing.assert_allclose(mean.bias, both, atol=1e-15)
    assert any("mean of a.mcap, turns.mcap" in line for line in mean.header)


def test_tables(result):
    values = drawn(0, MATRICES)
    path = result(values)
    lines = [x for x in written(path, "csv").split("\n") if x and not x.startswith("#")]
    rows = [dict(zip(lines[0].split(","), x.split(","), strict=True)) for x in lines[1:]]
    assert [float(r["value"]) for r in rows] == [v for own in values.values() for v in own]
    assert [r["unit"] for r in rows[:3]] == ["rad/s"] * 3
    assert written(path, "markdown").count("\n| `") == len(rows)
    latex = written(path, "latex")
    assert latex.count(r" \\") == len(rows) + 1
    assert r"gyro\_bias" in latex
    value, sigma = (float(rows[0][k]) for k in ("value", "sigma"))
    assert f"${value:.7f}$ & ${sigma:.7f}$" in latex  # 0.0000087: two digits
    assert f"| {value:.7f} | {sigma:.7f} |" in written(path, "markdown")


def test_packages_bring_formats_of_their_own(tmp_path, monkeypatch):
    folder = tmp_path / "more_formats"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    text = "from handcal.exports import Format\n{} = Format('x', 'X: made up', lambda c: 'x')\n"
    (folder / "made_up.py").write_text(text.format("FORMAT"))
    monkeypatch.syspath_prepend(tmp_path)
    entry = EntryPoint("more", "more_formats", exports.GROUP)
    monkeypatch.setattr(exports, "entry_points", lambda **_: [entry])
    formats.cache_clear()
    try:
        assert format_of("made_up").line == "X: made up"
        assert "px4" in formats()
        (folder / "px4.py").write_text(text.format("FORMAT"))
        formats.cache_clear()
        with pytest.raises(InputError, match=r"more_formats\.px4"):
            formats()
    finally:
        formats.cache_clear()


@pytest.fixture
def main(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["handcal", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            _app.main()
        captured = capsys.readouterr()
        return stop.value.code, captured.out, captured.err

    return call


def test_command(result, tmp_path, main):
    path, out = result(drawn(0, MATRICES)), tmp_path / "out.txt"
    for arguments in (["export"], ["export", "--to", "list"], ["export", path]):
        status, shown, _ = main(*arguments)
        assert status == 0
        assert [line.split()[0] for line in shown.splitlines()] == sorted(formats())
    status, shown, said = main("export", path, "--to", "px4", "-o", out)
    assert status == 0
    assert out.read_text().startswith("# PX4")
    assert "gyro_misalignment" in said
    assert main("export", path, "--to", "px4", "-o", "-")[1].startswith("# PX4")
    for wrong in (["--to", "pxr", "-o", out], ["--to", "px4"], ["--to", "px4", "-o", path]):
        status, _, said = main("export", path, *wrong)
        assert (status, said.count("\n")) == (2, 1)


def test_what_a_result_warns_of_goes_with_it_and_the_rest_can_be_asked_for(result, tmp_path, main):
    """In the header and on the way, once; with the command that tells how much is left."""
    warned = "sensor_combined: PX4 has corrected it by a calibration of its own."
    path, out = result(drawn(0, MATRICES), warnings=[warned, warned]), tmp_path / "out.txt"
    status, _, said = main("export", path, "--to", "PX4", "-o", out)
    assert status == 0
    command = "handcal export result.json --to px4 --recording turns.mcap -o FILE"
    for text in (out.read_text(), said):
        assert text.count(f"Warning: {warned}") == 1
        assert text.count(command) == 1
    assert "How much" not in written(path, "px4", recording=recording())


@pytest.mark.parametrize(("alike", "said"), [([], 0), (["gyro_misalignment"], 1)])
def test_that_a_recording_cannot_tell_which_is_said_of_sets_alone(result, alike, said):
    """A search that was cut short cannot tell either, of other reasons."""
    missing = [{"effect": "gyro_scale", "indistinguishable_from": alike}]
    path = result(drawn(0, DIAGONAL), schema="handcal/explanation/1", verdict="cannot_tell",
                  missing=missing)  # fmt: skip
    assert written(path, "px4").count("cannot tell which") == said


def test_axes_are_refused_where_they_mean_nothing(result, tmp_path, main):
    path, out = result(drawn(0, DIAGONAL)), tmp_path / "out.txt"
    status, _, said = main("export", path, "--to", "kalibr", "--axes", "frd", "-o", out)
    assert (status, out.exists()) == (2, False)
    assert "--axes is for ardupilot, px4" in said
    turned = "PX4's axes (forward, right, down) were turned to forward, left, up."
    path = result(drawn(0, DIAGONAL), warnings=[turned])
    assert main("export", path, "--to", "px4", "--axes", "frd", "-o", out)[0] == 2
    status, _, said = main("export", path, "--to", "px4", "-o", out)
    assert (status, "Warning" in said) == (0, False)


@pytest.mark.parametrize("name", ["kalibr", "openvins"])
def test_the_topic_is_that_of_the_recording(result, name):
    of = document({})["recording"]
    imu = {"samples": 1000, "topic": "/camera/imu"}
    path = result(drawn(0, NO_G), recording=of | {"streams": {"imu": imu}})
    assert "rostopic: /camera/imu\n" in written(path, name)
    assert "rostopic: /phone/imu\n" in written(path, name, topic="/phone/imu")
    path = result(drawn(0, NO_G), recording=of | {"streams": {"imu": imu | {"topic": "/a: [b"}}})
    assert "rostopic: /imu\n" in written(path, name)


def test_scales_that_were_not_found_are_left_to_the_vehicle(result):
    path = result(drawn(0, BIASES) | {"accel_scale": [0.01, 0.0, 0.0]})
    for name, scale in (("px4", "CAL_ACC2_{}SCALE"), ("ardupilot", "INS_ACCSCAL_{}")):
        lines = [x for x in written(path, name).splitlines() if not x.startswith("#")]
        found = [axis for axis in "XYZ" if any(scale.format(axis) in line for line in lines)]
        assert found == ["X"]


def own_result(result, **vehicle):
    of = document({})["recording"] | {"vehicle": vehicle}
    return result(drawn(0, DIAGONAL), recording=of)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (dict.fromkeys(PX4_OWN), "--readings raw"),
        ({"CAL_ACC2_YOFF": None}, "CAL_ACC2_YOFF"),
        ({"CAL_ACC0_ID": 3}, "--instance 0 or --instance 2, or log the topic sensor_selection"),
        ({"CAL_ACC0_ID": 3, "sensor_selection.accel_device_id": 4}, "is 4"),
        ({"SENS_BOARD_ROT": 2}, "SENS_BOARD_ROT 2"),
        ({"CAL_ACC2_ROT": 6}, "CAL_ACC2_ROT 6"),
        ({"sensor_accel.device_id": 9, "sensor_gyro.device_id": 7, "TC_A_ENABLE": 1}, "thermal"),
    ],
)
def test_px4_refuses_what_it_cannot_combine(result, change, said):
    """Residual errors stood in the file as if they were the whole calibration."""
    own = {k: v for k, v in (PX4_OWN | change).items() if v is not None}
    with pytest.raises(HandcalError, match=said):
        written(own_result(result, **own), "px4")


def test_px4_takes_the_sensor_that_was_read(result):
    more = {"CAL_ACC0_ID": 3, "sensor_selection.accel_device_id": 9, "CAL_ACC2_ROT": -1}
    assert "\tCAL_ACC2_XOFF\t" in written(own_result(result, **PX4_OWN, **more), "px4")
    unsigned = {"CAL_ACC0_ID": -9, "sensor_selection.accel_device_id": 2**32 - 9}
    unsigned |= {f"CAL_ACC0_{x}{n}": 1.0 for x in "XYZ" for n in ("OFF", "SCALE")}
    assert "\tCAL_ACC0_XOFF\t" in written(own_result(result, **PX4_OWN, **unsigned), "px4")


@pytest.mark.parametrize(
    "line", ["{},{}", "{} {}", "1\t1\t{}\t{}\t9", "1700000000.5,52000,{},{},0.0"]
)
def test_the_vehicles_parameters_may_come_as_a_file(result, tmp_path, line):
    file, given = tmp_path / "own.param", recording()
    file.write_text("# of Monday\n" + "\n".join(line.format(k, v) for k, v in OWN.items()))
    path = own_result(result)
    for name, names in (("px4", PX4_NAMES), ("ardupilot", INS_NAMES)):
        with pytest.raises(HandcalError, match="--parameters"):
            written(path, name)
        text = written(path, name, parameters=file, readings="corrected")
        kept = [x for x in text.splitlines() if x and not x.startswith("#")]
        rows = [re.split(r"[\t,]", x) for x in kept]
        found = {r[-3] if name == "px4" else r[0]: float(r[-2 if name == "px4" else -1])
                 for r in rows}  # fmt: skip
        close(vehicle(found, names, given, "flu"), applied(path, given))


def test_ardupilot_refuses_what_it_cannot_combine(result, tmp_path):
    with pytest.raises(HandcalError, match="AHRS_ORIENTATION 8"):
        written(own_result(result, **INS_OWN, AHRS_ORIENTATION=8), "ardupilot")
    file = tmp_path / "own.param"
    for text, said in (("nothing", "no parameters"), ("INS_ACCOFFS_X,1e", "no number")):
        file.write_text(text)
        with pytest.raises(InputError, match=said):
            written(own_result(result), "ardupilot", parameters=file)
    # (a log in which a parameter changed says it with two values)
    file.write_text("\n".join(f"{k},{v}" for k, v in INS_OWN.items()) + "\nINS_ACCOFFS_X,0.5\n")
    with pytest.raises(HandcalError, match="INS_ACCOFFS_X"):
        written(own_result(result), "ardupilot", parameters=file, readings="corrected")
    with pytest.raises(InputError, match="--parameters is for"):
        written(own_result(result), "kalibr", parameters=file)

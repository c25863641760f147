"""What `apply` takes off is what the simulator, written apart, put in; and bad input is refused."""

import dataclasses
import json

import numpy as np
import pytest
import typer
from fake_explanation import fake_explanation
from fake_result import fake_result
from test_conceal import ON_HEADING, ON_IMU, rms, world
from worlds import injected, recording_of

import handcal
from handcal.commands import _registry
from handcal.commands.apply import apply as command
from handcal.compiled import so3
from handcal.device import apply as taken
from handcal.recordings.export import write_mcap
from handcal.show.calibration.summary import calibration_json, recording_json, write_json
from handcal.show.explanation.document import explanation_json
from handcal.types import HandcalError, InputError, Series

# What stays of an error's rms; where none is named, what rounds of substitution leave.
STAYS = {
    "accel_delay": 0.02,
    "gyro_bandwidth": 0.03,
    "size_effect": 0.03,
    "gyro_bias_step": 0.03,
}
# Samples at the end: what a delayed sensor felt then it never told.
LAST = 10
NO_SENSOR = ("lever_arm", "gravity", "earth_rate")


@pytest.fixture(scope="module")
def simulated():
    return world()


@pytest.fixture(scope="module")
def plain(simulated):
    return recording_of(simulated, "heading", "temperature")


@pytest.fixture(scope="module")
def bias(simulated):
    return np.concatenate([injected(simulated, i) for i in taken.BIASES])


def learnt(values, bias=None, unnamed=()):
    biases = () if bias is None else (("", bias),)
    return taken.Learnt("x.json", {i: np.array(v) for i, v in values.items()}, biases, unnamed)


def corrected(recording, values, bias=None, **options):
    return taken.apply(recording, learnt(values, bias), **options)


@pytest.mark.parametrize("effect", [e for e in ON_IMU if e not in NO_SENSOR])
def test_readings_are_as_if_the_effect_were_not_there(plain, bias, effect):
    values = ON_IMU[effect][0]
    changed = recording_of(world({effect: values}), "heading", "temperature")
    by_day = effect == "gyro_bias_step"
    if by_day:  # the step alone
        bias = np.zeros(6)
    found = corrected(changed, {effect: values}, bias, biases=by_day)
    assert effect in found.taken
    for sensor in ("gyro", "accel"):
        left = getattr(found.recording.imu, sensor) - getattr(plain.imu, sensor)
        was = getattr(changed.imu, sensor) - getattr(plain.imu, sensor)
        if effect == "accel_delay":
            left, was = left[:-LAST], was[:-LAST]
        if effect.endswith("_temperature"):  # (what it adds to the mean is part of the bias)
            left, was = left - left.mean(axis=0), was - was.mean(axis=0)
        assert rms(left) <= STAYS.get(effect, 2e-3) * rms(was) + 1e-6


@pytest.mark.parametrize("effect", ON_HEADING)
def test_headings_are_as_if_the_effect_were_not_there(plain, effect):
    values, share = ON_HEADING[effect]  # of the simulator's constant offset none is taken off
    changed = recording_of(world({effect: values}), "heading").streams["heading"]
    true = plain.streams["heading"]
    recording = dataclasses.replace(plain, streams={"heading": changed})
    found = corrected(recording, {effect: values}).recording.streams["heading"]
    was = rms(so3.wrap(changed.value - true.value))
    assert rms(so3.wrap(found.value - true.value)) < share * was


def test_irons_are_undone_to_the_last_digit(plain):
    yaw = np.linspace(-np.pi, np.pi, 500)
    read = yaw + 0.2 * np.sin(yaw) - 0.1 * np.cos(yaw) + 0.1 * np.sin(2 * yaw)
    given = dataclasses.replace(
        plain, streams={"heading": Series(np.linspace(0.0, 20.0, 500), so3.wrap(read)[:, None])}
    )
    values = {"heading_hard_iron": [0.2, -0.1], "heading_soft_iron": [0.1, 0.0]}
    found = corrected(given, values).recording.streams["heading"].value[:, 0]
    np.testing.assert_allclose(so3.wrap(found - yaw), 0.0, atol=1e-12)


def test_several_effects_at_once(plain, bias):
    effects = {i: ON_IMU[i][0] for i in ("gyro_scale", "gyro_misalignment", "accel_misalignment")}
    effects["accel_delay"] = [0.005]
    changed = recording_of(world(effects), "heading", "temperature").imu
    found = corrected(dataclasses.replace(plain, imu=changed), effects, bias, biases=True)
    found_plain = corrected(plain, {}, bias, biases=True)
    for sensor in ("gyro", "accel"):
        one, other = (getattr(r.recording.imu, sensor) for r in (found, found_plain))
        was = getattr(changed, sensor) - getattr(plain.imu, sensor)
        assert rms((one - other)[:-LAST]) < 0.02 * rms(was)


def test_late_streams_come_earlier(plain):
    n = len(plain.streams["heading"].t)
    pose = Series(plain.streams["heading"].t, np.tile([0.0, 0, 0, 1, 0, 0, 0], (n, 1)))
    field = Series(plain.streams["heading"].t, np.full((n, 3), 4e-5))
    given = dataclasses.replace(plain, streams={"pose": pose, "mag": field})
    values = {"pose_delay": [0.02], "heading_delay": [0.1], "mag_hard_iron": [1e-5, 0.0, -1e-5]}
    streams = corrected(given, values).recording.streams
    for name, delay in (("pose", 0.02), ("mag", 0.1)):
        kept = pose.t - delay >= plain.imu.t[0]
        np.testing.assert_allclose(streams[name].t, (pose.t - delay)[kept])
    np.testing.assert_allclose(streams["mag"].value[0], [3e-5, 4e-5, 5e-5])


def test_a_fast_clock_is_slowed(plain):
    found = corrected(plain, {"clock_rate": [200.0]}).recording
    assert found.duration_s * 1.0002 == pytest.approx(plain.duration_s, rel=1e-12)
    np.testing.assert_array_equal(found.imu.gyro, plain.imu.gyro)


def test_saturated_readings_stay(plain):
    valid = np.ones(len(plain.imu.t), dtype=bool)
    valid[100:110] = False
    masked = dataclasses.replace(plain, imu=dataclasses.replace(plain.imu, valid=valid))
    values = {"gyro_scale": [0.1] * 3, "accel_delay": [0.02], "gyro_bandwidth": [0.01]}
    found = corrected(masked, values).recording.imu
    np.testing.assert_array_equal(found.gyro[100:110], plain.imu.gyro[100:110])
    np.testing.assert_array_equal(found.accel[100:110], plain.imu.accel[100:110])
    assert not found.valid[97:110].any()  # what was felt while saturated is read later
    assert found.valid[:97].all()
    assert found.valid[112:].all()


def test_what_is_left_and_why(plain):
    values = {i: np.ones(len(v)) for i, (v, _) in ON_IMU.items() if i in NO_SENSOR}
    values |= {"gyro_bias_walk": [1e-3], "heading_outliers": [0.1], "heading_correlated_noise": [1]}
    values |= {"gyro_temperature": [1e-3] * 3, "pose_delay": [0.1], "mag_hard_iron": [1e-5] * 3}
    bare = dataclasses.replace(plain, streams={})
    found = corrected(bare, values, np.ones(6))
    assert found.taken == ()
    np.testing.assert_array_equal(found.recording.imu.gyro, plain.imu.gyro)
    assert found.left[taken.NOT_ASKED] == taken.BIASES
    assert found.left[taken.NO_STREAM] == ("gyro_temperature", "pose_delay", "mag_hard_iron")
    noise = ("gyro_bias_walk", "heading_outliers", "heading_correlated_noise")
    assert found.left[taken.NO_SENSOR] == (*NO_SENSOR, *noise)


def test_biases_are_taken_off_the_recording_they_belong_to(plain):
    mine, other = np.arange(6.0), np.ones(6)
    known = taken.Learnt("x.json", {}, (("/a/one.mcap", other), ("/b/two.mcap", mine)), ())
    two = dataclasses.replace(plain, path="elsewhere/two.mcap")
    found = taken.apply(two, known, biases=True).recording.imu
    np.testing.assert_allclose(plain.imu.accel - found.accel, np.tile(mine[3:], (len(found.t), 1)))
    with pytest.raises(InputError, match=r"has the biases of one.mcap, two.mcap, not of three"):
        taken.apply(dataclasses.replace(plain, path="three.mcap"), known, biases=True)


def test_irons_that_cannot_be_undone(plain):
    with pytest.raises(HandcalError, match="turn the heading back on itself"):
        corrected(plain, {"heading_soft_iron": [0.6, 0.0]})


# --- files --------------------------------------------------------------------------------------


def test_reads_what_calibrate_and_explain_write(tmp_path):
    result, file = fake_result(), tmp_path / "x.json"
    write_json(calibration_json(result), file)
    found = taken.read(file)
    for p in result.parameters:
        if p.effect not in taken.BIASES and p.shown:
            assert p.value in found.values[p.effect]
    hidden = {p.effect for p in result.parameters} - set(found.values) - set(taken.BIASES)
    assert not any(p.shown for p in result.parameters if p.effect in hidden)
    ((of, bias),) = found.biases
    assert of == result.recording.path
    np.testing.assert_array_equal(bias, [p.value for p in result.parameters[:6]])
    explanation = fake_explanation("unexplained")
    write_json(explanation_json(explanation), file)
    found = taken.read(file)
    assert found.unnamed == tuple(u.formula for u in explanation.unnamed)
    assert found.unnamed
    write_json(calibration_json([result, result]), file)
    with pytest.raises(InputError, match="holds 2 calibrations, each on its own"):
        taken.read(file)


def test_an_explanation_of_several_tells_each_ones_biases(tmp_path):
    def of(effect, values):
        pairs = zip("xyz", values, strict=True)
        return [{"effect": effect, "name": n, "value": v} for n, v in pairs]

    own = [*of("gyro_bias", [1, 2, 3]), *of("accel_bias", [4, 5, 6])]
    document = {
        "schema": "handcal/explanation/1", "parameters": of("gyro_scale", [0.1, 0.2, 0.3]),
        "unnamed": [], "recordings": [{"recording": {"path": "a"}, "parameters": own},
                                      {"recording": {"path": "b"}, "parameters": own}],
    }  # fmt: skip
    file = tmp_path / "x.json"
    file.write_text(json.dumps(document))
    found = taken.read(file)
    assert [of for of, _ in found.biases] == ["a", "b"]
    np.testing.assert_array_equal(found.biases[0][1], [1, 2, 3, 4, 5, 6])
    assert list(found.values) == ["gyro_scale"]


SCALE = [{"effect": "gyro_scale", "name": n, "value": 0.01} for n in "xyz"]


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        (None, "lacks something"),
        ([1], "lacks something"),
        ([{"effect": "gyro_scale"}], "lacks something"),
        ([{"effect": ["a"], "name": "x", "value": 1}], "lacks something"),
        ([*SCALE[:2], {**SCALE[2], "value": 10**400}], "lacks something"),
        ([*SCALE, {"effect": "aether", "name": "x", "value": 1.0}], "'aether', of which nothing"),
        (SCALE[:2], "gyro_scale needs a finite number for x, y, z"),
        ([*SCALE, {**SCALE[0], "name": "w"}], "gyro_scale needs a finite number"),
        ([*SCALE[:2], {**SCALE[2], "value": None}], "gyro_scale needs a finite number"),
        ([*SCALE[:2], {**SCALE[2], "value": float("nan")}], "gyro_scale needs a finite number"),
        ([*SCALE[:2], {**SCALE[2], "value": "1"}], "gyro_scale needs a finite number"),
    ],
)
def test_damaged_explanations_are_refused(tmp_path, parameters, says):
    file = tmp_path / "x.json"
    file.write_text(json.dumps({"schema": "handcal/explanation/1", "parameters": parameters}))
    with pytest.raises(InputError, match=says):
        taken.read(file)


@pytest.mark.parametrize("text", ["", "[]", "1", "{}", '{"schema": "x"}', "{", "[" * 100_000])
def test_other_files_are_refused(tmp_path, text):
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(InputError, match="is not"):
        taken.read(file)
    with pytest.raises(InputError, match="cannot be read"):
        taken.read(tmp_path / "none.json")


# --- the command --------------------------------------------------------------------------------


@pytest.fixture
def main(monkeypatch, capsys):
    app = typer.Typer(cls=_registry.Commands, add_completion=False)
    app.command("apply")(command)
    app.callback()(lambda: None)

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["handcal", "apply", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            _registry.run(app)
        said = capsys.readouterr()
        return stop.value.code, said.out, said.err

    return call


def written(path, parameters, **more):
    document = {"schema": "handcal/explanation/1", "parameters": parameters, **more}
    path.write_text(json.dumps(document))
    return path


def test_command(plain, tmp_path, main):
    source, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_mcap(plain, source)
    arm = [{"effect": "lever_arm", "name": n, "value": 0.01} for n in "xyz"]
    term = {"formula": "accel_x += k * omega_y"}
    found = written(tmp_path / "x.json", [*SCALE, *arm], unnamed=[term])
    status, shown, said = main(source, "--from", found, "-o", out)
    assert status == 0
    assert "gyro_scale removed from a.mcap" in shown
    assert said == (
        "handcal: Not removed: lever_arm (no error of a sensor); "
        "accel_x += k * omega_y (the model has no law for it).\n"
    )
    read = handcal.load(out)
    np.testing.assert_allclose(read.imu.gyro, plain.imu.gyro / 1.01, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(read.imu.accel, plain.imu.accel)
    np.testing.assert_array_equal(read.streams["heading"].value, plain.streams["heading"].value)


def test_a_law_of_the_model_that_the_verdict_does_not_count_is_left_and_said(tmp_path):
    """A verdict may find it next to nothing: then it is in no list of what has no name."""
    law = "gyro_xyz += g_i((T - 25))"
    numbers = [{"effect": law, "name": f"{a}{k}", "value": 1e-5} for a in "xyz" for k in range(6)]
    found = taken.read(written(tmp_path / "x.json", [*SCALE, *numbers], unnamed=[]))
    assert list(found.values) == ["gyro_scale"]
    assert found.unnamed == (law,)


def test_command_refuses(plain, tmp_path, main):
    source, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_mcap(plain, source)
    arm = [{"effect": "lever_arm", "name": n, "value": 0.01} for n in "xyz"]
    nothing, found = written(tmp_path / "n.json", arm), written(tmp_path / "x.json", SCALE)
    for arguments, status, says in (
        (
            (source, "--from", nothing, "-o", out),
            1,
            "no error that could be removed from a.mcap",
        ),
        ((source, "--from", source, "-o", out), 2, "is not JSON"),
        ((source, "--from", found, "-o", source), 2, "is what is read"),
        ((source, "--from", found, "-o", out.with_suffix(".db3")), 2, "ends in .mcap"),
        ((source, "--from", found, "-o", out.with_suffix("")), 2, "ends in .mcap"),
        ((tmp_path / "none", "--from", found, "-o", out), 2, "none"),
        ((source, "--from", found, "-o", tmp_path / "no" / "b.mcap"), 2, "there is no folder"),
        ((source, "--from", found, "-o", out, "--biases"), 2, "has the biases of no recording"),
        ((source, "-o", out), 2, "--from"),
    ):
        code, shown, said = main(*arguments)
        assert (code, shown) == (status, "")
        assert says in said
        assert said.count("\n") == 1
    assert not out.exists()


def test_what_was_corrected_is_not_corrected_again(plain, tmp_path, main):
    """`apply` took every error off a second time without a word."""
    source, once, twice = (tmp_path / f"{n}.mcap" for n in ("a", "b", "c"))
    write_mcap(plain, source)
    found = written(tmp_path / "x.json", SCALE)
    assert main(source, "--from", found, "-o", once)[0] == 0
    read = handcal.load(once)
    assert list(read.corrected.values()) == ["x.json"]
    assert any("corrected by x.json" in said for said in read.warnings)
    status, _, said = main(once, "--from", found, "-o", twice)
    assert (status, twice.exists()) == (1, False)
    assert "b.mcap was corrected by x.json already" in said
    with pytest.raises(HandcalError, match=r"already.*anyway=True"):
        handcal.apply(once, found)
    # (of another result of the raw readings as much is in them)
    other = written(tmp_path / "y.json", SCALE, recording={"path": "a.mcap"})
    status, _, said = main(once, "--from", other, "-o", twice)
    assert (status, "taken off twice" in said) == (1, True)
    assert main(once, "--from", found, "-o", twice, "--anyway")[0] == 0
    np.testing.assert_allclose(handcal.load(twice).imu.gyro, plain.imu.gyro / 1.01**2)


def test_the_rest_that_a_correction_left_is_taken_off(plain, tmp_path, main):
    source, once, twice = (tmp_path / f"{n}.mcap" for n in ("a", "b", "c"))
    write_mcap(plain, source)
    main(source, "--from", written(tmp_path / "x.json", SCALE), "-o", once)
    of = recording_json(handcal.load(once), "auto")
    rest = written(tmp_path / "rest.json", SCALE, recording=of)
    status, _, said = main(source, "--from", rest, "-o", twice)
    assert (status, "apply x.json first" in said) == (1, True)
    assert main(once, "--from", rest, "-o", twice)[0] == 0
    assert list(handcal.load(twice).corrected.values()) == ["x.json", "rest.json"]


def test_a_file_cannot_put_words_into_the_terminal_as_its_correction(plain, tmp_path):
    path = tmp_path / "a.mcap"
    bad = {"f" * 64: "\x1b[31mred", "no digest": "x.json"}
    write_mcap(dataclasses.replace(plain, corrected=bad), path)
    assert handcal.load(path).corrected == {"f" * 64: "?[31mred"}


def test_what_was_shown_but_not_found_is_taken_off_and_said(plain, tmp_path, main):
    source, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_mcap(plain, source)
    own = [*SCALE, *({**p, "effect": "accel_scale"} for p in SCALE)]
    found = written(tmp_path / "x.json", own, missing=[{"effect": "gyro_scale"}])
    status, shown, said = main(source, "--from", found, "-o", out)
    assert (status, "gyro_scale, accel_scale removed from" in shown) == (0, True)
    assert "not found to be missing: accel_scale." in said

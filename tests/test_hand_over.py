"""A law without a name goes with its result: from the JSON alone it is taken off, kept by a second
calibration, concealed about and exported beside."""

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from worlds import recording_of, slow

import handcal as hc
from handcal.commands import _app
from handcal.compiled import so3
from handcal.estimate.calibration import recalibrate
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.scan import scan
from handcal.estimate.specification import Options, Specification, document_of
from handcal.explain import pipeline
from handcal.explain.assembled import End
from handcal.explain.model_file import laws_of, of_document
from handcal.laws import law_effect, shapes, terms
from handcal.recordings.export import write_mcap
from handcal.search.drifting_point import begun
from handcal.search.multistart import Found
from handcal.search.space import space
from handcal.signals import of_recording
from handcal.types import Imu, InputError
from handcal_sim import simulate

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "benchmarks"))

import hand_over  # noqa: E402
from judge_cases import Case  # noqa: E402

BIASES = ("gyro_bias", "accel_bias")


def law(kind, *numbers):
    return law_effect.effect_of(law_effect.again(kind, numbers))


# Formulas of one constant, of each axis, a curve, and courses of a heading.
CUBE = law("gyro | x | same | omega_{i} | cube", 0.01)
OWN = law("gyro | yz | each | f_{i} | line", 0.002)
CURVE = law("accel | z | same | omega_{i} | curve", -4.0, 4.0, 0.3, 5.0, 1.0, *[0.1] * 6)
WAVES = terms.again("heading += k1 * sin(4 yaw) + k2 * cos(4 yaw)", 0.1)
BUMP = shapes.again("gyro_z", ("bump", (8.0, 1.5)))
LATE = law("gyro | z | same | omega_{i} * t | line", 0.001)


def values_of(effect):
    return 0.5 * effect.prior_sigma * np.cos(np.arange(len(effect.parameters)))


def document(*laws, shown=True):
    """An explanation with these laws, and no biases to speak of."""
    rows = [{"effect": i, "name": a, "value": 0.0, "sigma": 1e-3, "unit": "x"}
            for i in BIASES for a in "xyz"]  # fmt: skip
    for e in laws:
        rows += [{"effect": e.id, "name": p.name, "value": float(v), "sigma": 1e-3,
                  "unit": p.unit, "shown": shown}
                 for p, v in zip(e.parameters, values_of(e), strict=True)]  # fmt: skip
    out = {"schema": "handcal/explanation/1", "verdict": "unexplained", "missing": [],
           "warnings": [], "recording": {"path": "turns.mcap"}, "parameters": rows,
           "unnamed": [{"formula": e.id} for e in laws],
           "model": document_of(Specification(laws, (), Options()))}  # fmt: skip
    return json.loads(json.dumps(out))


@pytest.fixture(scope="module")
def turns():
    return recording_of(simulate("free-hand", seed=0, duration_s=20.0, phone=slow), "heading")


@pytest.fixture(scope="module")
def folder(turns, tmp_path_factory):
    out = tmp_path_factory.mktemp("hand-over")
    write_mcap(turns, out / "turns.mcap")
    (out / "laws.json").write_text(json.dumps(document(CUBE, BUMP)))
    return out


def run(*words):
    done = CliRunner().invoke(_app.app, [str(w) for w in words])
    assert done.exit_code == 0, done.output
    return done.output


def readings(recording):
    return np.hstack([recording.imu.gyro, recording.imu.accel])


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def bent(recording, effect):
    """The recording as a device with this law reads it."""
    error = effect.imu_error(values_of(effect), of_recording(recording))
    imu = recording.imu
    assert rms(error) > 1e-3
    return replace(
        recording, imu=replace(imu, gyro=imu.gyro + error[:, :3], accel=imu.accel + error[:, 3:])
    )


@pytest.mark.parametrize("shown", [True, False])
@pytest.mark.parametrize("effect", [CUBE, OWN, CURVE, BUMP, LATE], ids=lambda e: e.id)
def test_what_a_law_adds_is_taken_off(turns, effect, shown, tmp_path):
    """All of it: a curve is one thing, whichever of its coefficients are shown. What goes with time
    is of that one recording, as its biases are."""
    file, read = tmp_path / "why.json", bent(turns, effect)
    file.write_text(json.dumps(document(effect, shown=shown)))
    done = hc.apply(read, file, biases=True)
    assert effect.id in done.taken
    np.testing.assert_allclose(readings(done.recording), readings(turns), atol=1e-8)
    done = hc.apply(read, hc.open_result(file))
    by_time = effect in (BUMP, LATE)
    assert (effect.id in done.taken) != by_time
    assert (effect.id in sum(done.left.values(), ())) == by_time
    wanted = read if by_time else turns
    np.testing.assert_allclose(readings(done.recording), readings(wanted), atol=1e-8)


def test_a_law_of_the_heading_is_taken_off(turns, tmp_path):
    (tmp_path / "why.json").write_text(json.dumps(document(WAVES)))
    true = turns.streams["heading"]
    k, yaw = values_of(WAVES), true.value[:, 0]
    read = yaw + k[0] * np.sin(4.0 * yaw) + k[1] * np.cos(4.0 * yaw)
    given = replace(turns, streams={"heading": replace(true, value=so3.wrap(read)[:, None])})
    found = hc.apply(given, tmp_path / "why.json").recording.streams["heading"]
    assert rms(so3.wrap(found.value - true.value)) < 1e-6
    assert rms(so3.wrap(read - yaw)) > 0.01


def test_every_command_takes_it_from_the_json_alone(folder):
    source, laws, out = folder / "turns.mcap", folder / "laws.json", folder / "out.mcap"
    said = run("apply", source, "--from", laws, "--biases", "-o", out)
    assert f"gyro_bias, accel_bias, {CUBE.id}, {BUMP.id} removed from" in said
    assert f"Laws without a name that were removed: {CUBE.id}: gyro " in said
    run("conceal", source, "--from", laws, "--effect", "gyro_scale=0.1,0,0", "--seed", 0, "-o", out)
    same = hc.conceal(source, {"gyro_scale": [0.1, 0, 0]}, learnt=laws)
    np.testing.assert_array_equal(hc.read(out).imu.gyro, same.imu.gyro)
    # (a tenth of the rate without the law, not of what is read)
    rate = hc.apply(source, laws, biases=True).recording.imu.gyro
    added = same.imu.gyro - hc.read(source).imu.gyro
    np.testing.assert_allclose(added[:, 0], 0.1 * rate[:, 0], atol=1e-9)
    told = run("export", laws, "--to", "csv", "-o", folder / "out.csv")
    assert "Warning" not in told
    assert CUBE.id in (folder / "out.csv").read_text()
    given = {"recording": source}
    text = hc.export(laws, "kalibr", **given)
    assert f"Not in this file, {CUBE.id}: gyro" in text  # (with its size)
    assert hc.export(hc.open_result(laws), "kalibr", **given) == text


@pytest.mark.prove
def test_another_recording_of_the_device_tells_the_law_anew(turns, folder):
    """But for what goes with time; the recording itself is fitted again as it was."""
    model = of_document("x", document(CUBE, OWN, BUMP, LATE))
    (found,) = recalibrate([turns], model)
    assert {CUBE.id, OWN.id} < {p.effect for p in found.parameters}
    assert not {BUMP.id, LATE.id} & {p.effect for p in found.parameters}
    file = folder / "calibration.json"
    hc.api.Calibration.of(found).save(file)
    run("calibrate", folder / "turns.mcap", "--from", file, "--json", folder / "again.json")
    again = hc.calibrate(folder / "turns.mcap", learnt=hc.open_result(file))
    assert {p.effect for p in again.parameters} == {p.effect for p in found.parameters}
    written = json.loads((folder / "again.json").read_text())
    assert [p["value"] for p in written["parameters"]] == [p.value for p in again.parameters]
    with pytest.raises(InputError, match="leave out effects, only"):
        hc.calibrate(turns, "gravity", learnt=file, only=True)


def test_a_recording_with_a_gap_is_known_again(turns):
    """And keeps what happened at one moment of it, which another recording has no part of."""
    imu = turns.imu
    kept = (imu.t < 8.0) | (imu.t > 11.0)
    parts = (imu.t, imu.gyro, imu.accel, imu.valid)
    holed = replace(turns, imu=Imu(*(x[kept] for x in parts)))
    first = hc.calibrate(holed, only=True)
    assert any("starts again behind a gap" in w for w in first.warnings)
    written = json.loads(json.dumps(first.document))
    written["model"]["effects"].append(document_of(Specification((BUMP,), ()))["effects"][0])
    (again,) = recalibrate([holed], of_document("x", written))
    assert BUMP.id in {p.effect for p in again.parameters}
    (other,) = recalibrate([turns], of_document("x", written))
    assert BUMP.id not in {p.effect for p in other.parameters}


@pytest.mark.parametrize("damage", [{"effects": 3}, {"effects": [{"id": "gyro_x += 1"}]}, 3])
def test_a_damaged_law_is_a_sentence(damage):
    with pytest.raises(InputError, match=r"The model in x\.json is damaged"), \
            laws_of("x.json", {"model": damage}):  # fmt: skip
        pass


@pytest.mark.prove
def test_hand_over_tells_what_went_through(folder, tmp_path):
    file = folder / "laws.json"
    run("calibrate", folder / "turns.mcap", "--json", folder / "plain.json")
    case = Case("turns", "real", True, file=folder / "turns.mcap")
    rows = {way: (what, why) for _, way, what, why in
            hand_over.handed(case, folder / "plain.json", tmp_path)}  # fmt: skip
    refused = {"export px4", "export ardupilot"}
    assert {way for way, (what, _) in rows.items() if what == hand_over.REFUSED} == refused
    assert all("--parameters FILE" in rows[way][1] for way in refused)
    assert {what for what, _ in rows.values()} == {hand_over.REFUSED, hand_over.THROUGH}
    lost = json.loads((folder / "plain.json").read_text())
    lost["model"]["effects"].pop()
    file = tmp_path / "lost.json"
    file.write_text(json.dumps(lost))
    assert hand_over.FAILED in {w for _, _, w, _ in hand_over.handed(case, file, tmp_path)}


@pytest.mark.prove
@pytest.mark.parametrize("counts", [False, True])
def test_a_law_that_does_not_count_is_in_no_model(counts):
    """Found in the readings or next to nothing of it: in the one case it is told, in the other it
    leaves the model, and is said."""
    effects = {"gyro_scale": [0.1, 0.1, 0.1]}
    read = recording_of(simulate("free-hand", seed=0, duration_s=40.0, effects=effects), "heading")
    read = bent(read, CUBE) if counts else read
    base = pipeline.dense(begun([case_of(read)]))
    model = fitted(base.parts, [*base.effects, CUBE])
    candidates = [e for e in model.effects if not e.always]
    where = space(scan(model, candidates), candidates, {})
    end = End(base, Found(model, where, {}, {}), None, math.nan)
    done, chosen = pipeline._counted(end, None, Options())
    assert (CUBE.id in done.found.model.ids) == counts
    assert (CUBE.id in done.found.space.effects) == counts
    if counts:
        assert done.left == ()
    else:
        assert CUBE.id not in {e.id for e in chosen.effects}
        assert {e.id for e in chosen.effects} == set(base.ids)
        assert f"Besides, {CUBE.id} gains" in done.left[0]

"""handcal from Python: what a notebook does, what it shows, and what it refuses."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_explanation import fake_explanation
from fake_result import fake_result
from worlds import recording_of

import handcal as hc
from handcal import api, types
from handcal.device import apply
from handcal.estimate.calibration import calibrate, calibrate_together
from handcal.explain import pipeline
from handcal.show.calibration import verdict_text as of_calibration
from handcal.show.calibration.shown import in_front
from handcal.show.explanation import verdict_text as of_explanation
from handcal_sim import simulate

SCREEN = 40 * 120


@pytest.fixture(scope="module")
def recording() -> types.Recording:
    world = simulate("free-hand", seed=0, duration_s=20.0, effects={"gyro_scale": [0.02, 0, 0]})
    return recording_of(world, "heading")


@pytest.fixture(scope="module")
def written(recording: types.Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("api") / "turns.mcap"
    api.Recording.of(recording).write(path)
    return path


def test_arrays_and_files_are_the_same_recording(recording: types.Recording, written: Path) -> None:
    imu, heading = recording.imu, recording.streams["heading"]
    made = hc.Recording.from_arrays(
        imu.t, imu.gyro, imu.accel, heading=(heading.t, heading.value[:, 0])
    )
    for other in (made, hc.read(written)):
        assert np.array_equal(other.imu.gyro, imu.gyro)
        assert np.array_equal(other.imu.accel, imu.accel)
        assert np.abs(other.imu.t - (imu.t - imu.t[0])).max() < 2e-9
        assert np.array_equal(other.streams["heading"].value, heading.value)


def test_a_heading_in_degrees_is_refused(recording: types.Recording) -> None:
    imu, heading = recording.imu, recording.streams["heading"]
    yaw = np.degrees(heading.value[:, 0])
    still = np.tile(imu.accel[:1], (len(imu.t), 1)) + 1e-3 * np.sin(imu.t)[:, None]
    for gyro, accel, wrong in ((imu.gyro, imu.accel, yaw), (0 * still + still / 1e3, still, 90.0)):
        angles = np.broadcast_to(wrong, heading.t.shape) + 0.01 * np.cos(heading.t)
        with pytest.raises(hc.InputError, match="heading is in degrees"):
            hc.Recording.from_arrays(imu.t, gyro, accel, heading=(heading.t, angles))


def test_many_turns_of_an_unwrapped_heading_are_radians() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    gyro, accel = np.tile([0.0, 0.0, 2.0], (len(t), 1)), np.tile([0.0, 0.0, 9.8], (len(t), 1))
    gyro[:, 0] += 1e-3 * np.sin(t)
    accel[:, 0] += 1e-3 * np.sin(t)
    made = hc.Recording.from_arrays(t, gyro, accel, heading=(t[::10], 2.0 * t[::10]))
    assert np.abs(made.streams["heading"].value).max() <= np.pi


def test_a_heading_that_says_nothing_is_doubted() -> None:
    chance = (types.NoiseLevel("heading_noise", 1.8, "rad", estimated=True),)
    plain = fake_explanation("explained", 1)
    deaf = replace(plain, recordings=tuple(replace(r, noise=chance) for r in plain.recordings))
    for judge, sure, doubted in (
        (of_calibration, fake_result(), replace(fake_result(), noise=chance)),
        (of_explanation, plain, deaf),
    ):
        said = judge.verdict(doubted)
        assert said.level == "partly"
        assert any("heading carries no information" in s for s in said.sentences)
        assert not any("heading carries no information" in s for s in judge.verdict(sure).sentences)


@pytest.mark.usefixtures("no_figures")
def test_a_calibration_is_that_of_the_command_and_shows_itself(
    recording: types.Recording, written: Path, tmp_path: Path
) -> None:
    found = hc.calibrate(recording, "gyro_scale")
    plain = calibrate(recording, ("gyro_scale",))
    assert tuple(found.parameters) == plain.parameters
    assert np.array_equal(found.covariance, plain.covariance)
    assert found.parameters.values.tolist() == [p.value for p in plain.parameters]
    assert found.parameters["gyro_scale", "x"] is found.parameters["gyro_scale"][0]
    assert found.parameters[-1] == plain.parameters[-1]
    for shown in (found, found.parameters, hc.read(written), plain, recording, recording.imu):
        assert 10 < len(repr(shown)) < SCREEN
    front, rest = in_front(plain.parameters)
    assert rest
    assert found._repr_html_().count("<tr>") == 1 + len(front)
    assert "g-sensitivity" in repr(found)
    assert "g-sensitivity x" not in repr(found)
    assert len(found.plot().axes) == 1
    found.save(tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == found.document
    found.report(tmp_path / "a.html")
    assert "Gyro scale" in (tmp_path / "a.html").read_text()
    opened = hc.open_result(tmp_path / "a.json")
    assert opened.parameters.values.tolist() == found.parameters.values.tolist()
    assert np.array_equal(opened.covariance, found.covariance)
    found.rrd(tmp_path / "a.rrd")
    assert (tmp_path / "a.rrd").stat().st_size > 1000
    other = hc.conceal(recording, {"gyro_scale": [0.001, 0.0, 0.0]})
    several = hc.calibrate([other, written], only=True)
    assert len(several) == 2
    assert all(isinstance(one, api.Calibration) for one in several)


def test_what_was_explained_is_taken_off_and_written(
    recording: types.Recording, written: Path, tmp_path: Path
) -> None:
    why = hc.explain(written)
    assert [m.effect for m in why.missing] == ["gyro_scale"]
    assert "gyro scale" in repr(why).lower()
    assert f"removing it costs {why.missing[0].log_evidence_gain:,.0f}" in repr(why)
    assert "removing it costs" in why._repr_html_()
    assert len(repr(why)) < SCREEN
    assert why._repr_html_().count("<table>") == 2
    assert len(why.plot().axes) == 1
    why.save(tmp_path / "why.json")
    again = hc.open_result(tmp_path / "why.json")
    assert (again.kind, again.verdict, again.trust) == ("explanation", why.verdict, why.trust)
    assert again.warnings == tuple(why.document["warnings"])
    (one,), (other,) = again.missing, why.missing
    assert (one.title, one.probability, one.size) == (other.title, other.probability, other.size)
    assert [(p.value, p.sigma) for p in one.parameters] == [
        (p.value, p.sigma) for p in other.parameters
    ]
    assert repr(again.path.name)[1:-1] in repr(again)
    assert len(again.plot().axes) == 1
    saved = hc.apply(written, again).recording.imu.gyro
    assert np.array_equal(saved, hc.apply(written, why).recording.imu.gyro)
    made = hc.export(again, "kalibr", tmp_path / "imu.yaml", noise=None)
    assert (tmp_path / "imu.yaml").read_text() == made
    assert hc.export(why, "csv").splitlines()[-1] == hc.export(again, "csv").splitlines()[-1]
    why.rrd(tmp_path / "why.rrd")
    assert (tmp_path / "why.rrd").stat().st_size > 1000
    done = hc.apply(written, why)
    assert "gyro_scale" in done.taken
    again = hc.apply(written, tmp_path / "why.json").recording
    assert np.array_equal(again.imu.gyro, done.recording.imu.gyro)
    # (of the scale no more is left than its sigma allows)
    sigma = why.missing[0].parameters[0].sigma
    rate = recording.imu.gyro[:, 0] / 1.02
    slope = np.polyfit(rate, done.recording.imu.gyro[:, 0] - rate, 1)[0]
    assert abs(slope) < 4.0 * sigma < 0.5 * 0.02


def test_what_was_calibrated_alone_is_taken_off_alone(
    recording: types.Recording, written: Path, tmp_path: Path
) -> None:
    found = hc.calibrate(written, "gyro_scale", only=True)
    done = hc.apply(written, found)
    assert done.taken == ("gyro_scale",)
    again = hc.apply(recording, found).recording
    assert np.array_equal(again.imu.gyro, done.recording.imu.gyro)
    done.write(tmp_path / "corrected.mcap")
    left = hc.read(tmp_path / "corrected.mcap").imu.gyro - recording.imu.gyro / [1.02, 1.0, 1.0]
    assert np.abs(left - left.mean(axis=0)).max() < 0.002 * np.abs(recording.imu.gyro).max()


def test_what_is_concealed_is_another_recording(recording: types.Recording) -> None:
    worse = hc.conceal(recording, {"gyro_quadratic": [0.01, 0, 0]})
    assert np.abs(worse.imu.gyro[:, 0] - recording.imu.gyro[:, 0]).max() > 1e-4
    assert np.array_equal(worse.imu.gyro[:, 1], recording.imu.gyro[:, 1])


def test_misuse_is_one_sentence(recording: types.Recording, written: Path) -> None:
    imu = recording.imu
    wrong = [
        lambda: hc.calibrate(imu.gyro),
        lambda: hc.calibrate([written, imu]),
        lambda: hc.explain(3),
        lambda: hc.read("no-such-file.mcap"),
        lambda: hc.apply(recording, recording),
        lambda: hc.calibrate(recording, "gyro_scal"),
        lambda: hc.read(written).write(written),
        lambda: hc.Recording.from_arrays(imu.t, imu.gyro, imu.accel[:, :2]),
        lambda: hc.Recording.from_arrays(imu.t, imu.gyro, imu.accel, head=(imu.t, imu.t)),
        lambda: hc.Recording.from_arrays(["a"], imu.gyro, imu.accel),
        lambda: hc.Recording.from_arrays(imu.t, imu.gyro, 1j * imu.accel),
        lambda: hc.Recording.from_arrays(imu.t, imu.gyro, imu.accel, heading=imu.t),
        lambda: hc.Recording.from_arrays(imu.t, imu.gyro),
        lambda: hc.read(imu.gyro),
        lambda: hc.open_result(imu.gyro),
        lambda: hc.open_result("no-such-file.json"),
        lambda: hc.open_result(Path(__file__)),
        lambda: hc.export(recording, "kalibr"),
        lambda: hc.export("x.json", "calibr"),
        lambda: hc.read(written, units={"accel": 3}),
        lambda: hc.read(written, topics=["imu"]),
        lambda: hc.calibrate(recording, [3]),
        lambda: hc.calibrate(recording, 3),
        lambda: hc.calibrate(recording, heading_sigma="5deg"),
        lambda: hc.calibrate(recording, noise=[1e-4]),
        lambda: hc.calibrate(recording, ignore=3),
        lambda: hc.explain(recording, budget="1 h"),
        lambda: hc.explain(recording, imu.gyro),
        lambda: hc.conceal(recording, {"gyro_scale": 0.01}),
        lambda: hc.conceal(recording, {"gyro_scale": "0.01"}),
        lambda: hc.conceal(recording, {"gyro_scale": [0.01, "a", 0]}),
        lambda: hc.conceal(recording, ["gyro_scale"]),
        lambda: hc.conceal(recording, {"gyro_scale": [0.01, 0, 0]}, seed="a"),
        lambda: hc.conceal([recording, recording], {"gyro_scale": [0.01, 0, 0]}),
        lambda: hc.read(written).write("a.csv"),
        lambda: hc.effects_from(3).__enter__(),
        lambda: hc.effects_from("no-such-folder").__enter__(),
    ]
    for call in wrong:
        with pytest.raises(hc.InputError) as said:
            call()
        assert 20 < len(str(said.value)) < 900
        assert "--" not in str(said.value)
        assert str(said.value).endswith((".", "?"))
    for call, meant in (
        (lambda: hc.calibrate(recording, headingsigma=3), "Did you mean heading_sigma"),
        (lambda: hc.explain(recording, engine="compiled"), "explain has no option 'engine'"),
        (lambda: hc.Recording.from_arrays("my.mcap"), "handcal.read"),
    ):
        with pytest.raises(hc.InputError, match=meant):
            call()
    with pytest.raises(KeyError, match="gyro_bias"):
        hc.calibrate(recording).parameters["mag_hard_iron"]


def test_sentences_are_in_the_words_of_python(recording: types.Recording, tmp_path: Path) -> None:
    imu = recording.imu
    with pytest.raises(hc.InputError, match=r"multiply it by 9\.80665\."):
        hc.Recording.from_arrays(imu.t, imu.gyro, imu.accel / 9.80665)
    table = np.column_stack([imu.t, imu.gyro, imu.accel / 9.80665])
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="")
    with pytest.raises(hc.InputError, match=r'give units=\{"accel": "g"\}\.'):
        hc.read(path)
    assert hc.read(path, units={"accel": "g"}).duration_s > 0
    with pytest.raises(hc.InputError, match=r"handcal\.effects_from\(folder\)"):
        hc.calibrate(recording, "gyro_of_mine")
    with pytest.raises(hc.InputError, match=r'topics=\{"foo": \.\.\.\}: the streams'):
        hc.read(path, topics={"foo": "/x"})
    left = {apply.NOT_ASKED: ("gyro_bias",)}
    shown = repr(api.Corrected(api.Recording.of(recording), (), left))
    assert "biases=True" in shown
    assert "--" not in shown
    assert "--" not in api.Calibration.of(fake_result(overconfident=True))._repr_html_()


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e8)])
def test_stamps_that_are_no_seconds_are_said_to_be(
    recording: types.Recording, unit: str, factor: float
) -> None:
    imu = recording.imu
    with pytest.raises(hc.InputError, match=f"{unit}, not s; if so, multiply it by") as said:
        hc.Recording.from_arrays(factor * imu.t, imu.gyro, imu.accel)
    assert "deg/s" not in str(said.value)
    with pytest.raises(hc.InputError, match=r"in ms, us or ns\?$"):
        hc.Recording.from_arrays(1e10 * imu.t, imu.gyro, imu.accel)
    rare = hc.Recording.from_arrays(imu.t[::30], imu.gyro[::30], imu.accel[::30])
    assert rare.warnings == ()


def test_options_are_named_in_signatures() -> None:
    for function, core in (
        (hc.calibrate, calibrate_together),
        (sys.modules["handcal.explain"], pipeline.explain),
    ):
        shown = inspect.signature(function).parameters
        behind = inspect.signature(core).parameters
        options = {
            n: p for n, p in behind.items() if n not in ("recordings", "effects", "held_out")
        }
        assert {n: shown[n].default for n in options} == {n: p.default for n, p in options.items()}
        assert not any(p.kind is p.VAR_KEYWORD for p in shown.values())
    said = inspect.getdoc(sys.modules["handcal.explain"]) or ""
    assert said.startswith("Which physics")
    assert "budget" in said


@pytest.mark.prove
def test_a_device_is_simulated_and_swept_as_the_commands_do(tmp_path: Path) -> None:
    asked = {"seed": 3, "effects": {"gyro_scale": [0.01, 0, 0]}, "duration_s": 12.0, "mag": True}
    made = hc.simulate("free-hand", **asked)
    command = "simulate free-hand --seed 3 --effect gyro_scale=0.01,0,0 --duration 12 --mag -o"
    file = tmp_path / "typed.mcap"
    subprocess.run([sys.executable, "-m", "handcal", *command.split(), str(file)], check=True)
    typed = hc.read(file)
    assert np.array_equal(made.imu.gyro, typed.imu.gyro)
    assert set(made.streams) == set(typed.streams)
    kept = hc.simulate("free-hand", path=tmp_path / "kept.mcap", **asked)
    assert (tmp_path / "kept.mcap").read_bytes() == file.read_bytes()
    assert kept.path.endswith("kept.mcap")
    grid = tmp_path / "grid.toml"
    grid.write_text("[[grid]]\nrate_hz = [20]\nheading_sigma_deg = [5]\n", encoding="utf-8")
    done = hc.sweep(grid, seeds=1, jobs=1)
    assert (done["schema"], done["seeds"], len(done["cells"])) == ("handcal-sim/sweep/1", 1, 1)
    for wrong in (lambda: hc.simulate("free-hand", mags=True), lambda: hc.sweep("moon"),
                  lambda: hc.simulate("nowhere")):  # fmt: skip
        with pytest.raises(hc.InputError):
            wrong()


def test_error_bars_are_drawn_whole() -> None:
    """Also those that are wider than what is usual."""
    plain = fake_result()
    wide = tuple(replace(p, sigma=1.2 * p.prior_sigma, value=0.0) for p in plain.parameters)
    (axes,) = api.Calibration.of(replace(plain, parameters=wide)).plot().axes
    low, high = axes.get_xlim()
    assert low < -3.6
    assert high > 3.6


def test_noise_at_rest_is_that_of_the_command(tmp_path: Path) -> None:
    rng, t = np.random.default_rng(0), np.arange(0.0, 80.0, 0.01)
    noise = 1e-2 * rng.standard_normal((len(t), 6)) + [0, 0, 0, 0, 0, 9.8]
    still = hc.Recording.from_arrays(t, noise[:, :3], noise[:, 3:], name="still")
    found = hc.allan(still)
    chain = hc.export(found, "kalibr")
    assert f"gyroscope_noise_density: {found.suggested[0].value}" in chain
    assert found.channels[0].term("N").value == pytest.approx(1e-3, rel=0.1)
    assert found.document["channels"][0]["tau_s"] == found.channels[0].tau.tolist()
    assert list(found.to_pandas().name[:1]) == ["N"]
    assert "N white noise" in repr(found)
    assert len(repr(found)) < SCREEN
    assert found._repr_html_().count("<tr>") == 1 + sum(len(c.terms) for c in found.channels)
    found.save(tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text())["schema"] == "handcal/allan/1"
    assert hc.allan(still, (0.0, 70.0)).span[1] <= 70.0
    for span in (3, ("a", "b"), (500.0, 600.0)):
        with pytest.raises(hc.InputError, match="span"):
            hc.allan(still, span)


def test_without_pandas_a_table_is_a_sentence(
    recording: types.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters = hc.calibrate(recording).parameters
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(hc.HandcalError, match=r"pip install pandas.*notebook"):
        parameters.to_pandas()


def test_a_package_may_be_called_by_its_name(recording: types.Recording) -> None:
    import handcal.explain  # (which sets the attribute of that name)

    assert callable(handcal.explain)
    short = replace(recording, streams={})
    with pytest.raises(hc.InputError, match="explain takes"):
        handcal.explain(short, held_out=[3])


def test_importing_is_quick_and_help_says_all() -> None:
    code = "import sys, handcal as hc; print('numpy' in sys.modules, *dir(hc)); help(hc)"
    assert {"AlsoAFunction", "Any", "UNKNOWN", "TYPE_CHECKING"}.isdisjoint(dir(hc))
    assert set(hc.__all__) < set(dir(hc))
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, _, rest = run.stdout.partition("\n")
    assert first.startswith("False")
    for name in ("Calibration", "Explanation", "Corrected", "Parameters", "Saved"):
        assert f"``{name}``" in rest
    for name in ("read", "calibrate", "explain", "allan", "apply", "conceal", "export",
                 "simulate", "sweep", "open_result", "Recording"):  # fmt: skip
        assert name in first.split()
        assert f"hc.{name}" in rest
    assert "true minus estimated" in rest

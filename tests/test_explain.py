"""``explain`` from end to end on simulated recordings: readings in, a verdict out."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import schemas
from fake_explanation import fake_explanation
from proved import proved
from worlds import injected, recording_of, slow

import handcal
import handcal.types
from handcal.commands import _app
from handcal.effects import catalogue
from handcal.explain import Explanation, explain
from handcal.explanation import VERDICTS, Missing
from handcal.show.explanation.document import explanation_json
from handcal.types import Parameter, Recording, Series
from handcal_sim import simulate, write
from handcal_sim.scenario import World

ARM = {"lever_arm": [0.05, -0.04, 0.06]}


def world_of(effects: Mapping[str, Sequence[float]], seed: int = 0, seconds: float = 30.0) -> World:
    return simulate("free-hand", seed=seed, duration_s=seconds, phone=slow, effects=effects)


@cache
def with_the_arm() -> Explanation:
    """Of the first hand, whose recording several tests look at."""
    return explained(world_of(ARM))


def explained(world: World) -> Explanation:
    return explain([recording_of(world, "heading")])


def sigmas_off(parameters: Sequence[Parameter], truth: Sequence[float]) -> list[float]:
    return [(p.value - x) / p.sigma for p, x in zip(parameters, truth, strict=True)]


def own(explanation: Explanation, effect: str, k: int = 0) -> list[Parameter]:
    """Parameters of one of the recordings, its biases."""
    return [p for p in explanation.recordings[k].parameters if p.effect == effect]


def only(explanation: Explanation, effect: str) -> Missing:
    """What is missing, if that is this effect and nothing else."""
    assert explanation.verdict == "explained"
    assert [m.effect for m in explanation.missing] == [effect]
    assert not explanation.unnamed
    (missing,) = explanation.missing
    assert missing.probability > 0.99
    assert missing.indistinguishable_from == ()
    return missing


# --- nothing, one, several ---------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, *proved(1)])
def test_nothing_is_missing(seed: int) -> None:
    world = world_of({}, seed)
    found = explained(world)
    assert found.verdict == "nothing_missing"
    assert (found.missing, found.unnamed, found.mismatch) == ((), (), ())
    assert found.after.log_evidence == found.before.log_evidence
    for bias in ("gyro_bias", "accel_bias"):
        assert max(map(abs, sigmas_off(own(found, bias), injected(world, bias)))) < 4.0
    on_trial = {h.effect for h in found.hypotheses}
    assert {"gyro_scale", "lever_arm", "heading_delay"} <= on_trial
    assert not on_trial & {"mag_hard_iron", "pose_delay", "gyro_temperature"}
    assert all(h.verdict == "" and h.probability < 0.5 for h in found.hypotheses)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("effect", "values", "channels"),
    [
        ("gyro_scale", [0.02, -0.015, 0.02], {"gyro", "heading", "position"}),
        ("lever_arm", ARM["lever_arm"], {"accel", "position"}),
        ("heading_delay", [0.2], {"heading"}),
    ],
)
def test_one_effect_is_named_and_measured(
    effect: str, values: list[float], channels: set[str]
) -> None:
    """All by hundreds of nats: the first that is named is right, and so are its numbers."""
    found = with_the_arm() if effect in ARM else explained(world_of({effect: values}))
    missing = only(found, effect)
    assert missing.log_evidence_gain > 100.0
    assert max(map(abs, sigmas_off(missing.parameters, values))) < 4.0
    assert [(p.name, p.unit) for p in missing.parameters] == [
        (p.name, p.unit) for p in catalogue()[effect].parameters
    ]
    assert missing.story == catalogue()[effect].story
    # it was located, and with it the mismatch is gone
    assert found.mismatch[0].channel.split("_")[0] in channels
    assert sum(m.share for m in found.mismatch) <= 1.0 + 1e-9
    assert all(0.0 <= m.from_s < m.to_s <= 30.1 for m in found.mismatch)
    assert found.after.log_evidence - found.before.log_evidence > 100.0
    assert found.held_out is not None
    assert found.held_out.source == "later blocks"
    assert found.held_out.log_score_after - found.held_out.log_score_before > 20.0
    (named,) = [h for h in found.hypotheses if h.verdict == "named"]
    assert (named.effect, named.final) == (effect, missing.log_evidence_gain)
    total = found.recordings[0].evidence.gain[effect]
    assert total[-1] > 0.5 * missing.log_evidence_gain


@pytest.mark.prove
def test_a_walking_bias() -> None:
    found = explained(world_of({"gyro_bias_walk": [5e-3]}, seconds=20.0))
    (density,) = only(found, "gyro_bias_walk").parameters
    assert density.unit == "(rad/s)/sqrt(s)"
    assert abs(density.value - 5e-3) < 4.0 * density.sigma
    assert density.sigma < 0.5 * density.value


@pytest.mark.prove
def test_headings_that_point_anywhere() -> None:
    """The share that was drawn: 0.15 of 301, whatever their own binomial says."""
    found = explained(world_of({"heading_outliers": [0.15]}))
    (share,) = only(found, "heading_outliers").parameters
    # nothing else was missing; and what was left out stands in no picture
    assert only(found, "heading_outliers").share == pytest.approx(1.0)
    (drawn,) = [t for t in found.recordings[0].traces if t.channel == "heading"]
    assert drawn.left_out > 0.1 * len(drawn.t)
    off = np.abs(np.angle(np.exp(1j * (drawn.recorded - drawn.after))))
    assert off.max() < 6.0 * drawn.sigma
    assert abs(share.value - 0.15) < 4.0 * math.hypot(share.sigma, math.sqrt(0.15 * 0.85 / 301))


def test_physics_that_nobody_named_is_found_as_a_formula() -> None:
    """The accelerometer feels turning times force: rms 0.15 m/s^2, as the true motion has it."""
    world = world_of({}, seconds=30.0)
    recording = recording_of(world, "heading")
    accel = recording.imu.accel.copy()
    accel[:, 0] += 0.02 * world.truth.omega[:, 1] * world.truth.f[:, 2]
    found = explain([replace(recording, imu=replace(recording.imu, accel=accel))])
    assert found.verdict == "unexplained"
    assert found.missing == ()
    (term,) = found.unnamed
    assert term.formula == "accel_x += k * omega_y * f_z"
    assert abs(term.value - 0.02) < 4.0 * term.sigma
    assert term.unit == "(m/s^2)/(rad*m/s^3)"
    assert term.log_evidence_gain > 20.0


# --- several recordings ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two() -> list[World]:
    """The same lever arm in the hands of two, whose phones' biases differ."""
    return [world_of(ARM, seed) for seed in range(2)]


@pytest.fixture(scope="module")
def together(two: list[World]) -> Explanation:
    return explain([recording_of(w, "heading") for w in two])


@pytest.mark.prove
def test_two_recordings_share_the_effect_and_keep_their_biases(
    two: list[World], together: Explanation
) -> None:
    missing = only(together, "lever_arm")
    assert max(map(abs, sigmas_off(missing.parameters, ARM["lever_arm"]))) < 4.0
    for k, world in enumerate(two):
        for bias in ("gyro_bias", "accel_bias"):
            assert max(map(abs, sigmas_off(own(together, bias, k), injected(world, bias)))) < 4.0
    first, second = (np.array([p.value for p in own(together, "accel_bias", k)]) for k in (0, 1))
    assert np.abs(first - second).min() > 0.1
    assert {m.recording for m in together.mismatch} == {0, 1}
    assert sum(m.share for m in together.mismatch) <= 1.0 + 1e-9
    # together they know more than the first alone
    alone = only(with_the_arm(), "lever_arm")
    assert missing.log_evidence_gain > alone.log_evidence_gain
    for p, q in zip(missing.parameters, alone.parameters, strict=True):
        assert p.sigma < q.sigma


@pytest.mark.prove
def test_json_of_two_recordings_has_shared_parameters_apart(together: Explanation) -> None:
    document = explanation_json(together)
    schemas.check(document)
    told = {p["effect"] for p in document["parameters"]}
    assert {"lever_arm", "gyro_scale"} <= told
    assert not told & {"gyro_bias", "accel_bias"}
    assert len(document["recordings"]) == 2


@pytest.mark.prove
def test_another_recording_is_predicted_better_with_what_was_found(two: list[World]) -> None:
    """The second, of the same device; and no better where nothing was found."""
    scored = [recording_of(two[1], "heading")]
    scores = []
    for effects in (ARM, {}):
        fitted = recording_of(world_of(effects), "heading")
        found = explain([fitted], held_out=scored).held_out
        assert found is not None
        assert found.source == "simulated"
        scores.append(found)
    assert scores[0].log_score_after - scores[0].log_score_before > 20.0
    for a in "xyz":
        channel = f"position_{a}"
        assert scores[0].residual_rms_after[channel] < 0.6 * scores[0].residual_rms_before[channel]
    assert scores[1].log_score_after == scores[1].log_score_before


# --- readings that are none --------------------------------------------------------------------


@pytest.mark.prove
def test_saturated_readings_are_no_evidence() -> None:
    """A gyro that clips at four fifths of the fastest turn: some forty readings, in which the
    device turns on unmeasured."""
    world = world_of({})
    recording = recording_of(world, "heading")
    gyro = recording.imu.gyro
    most = 0.8 * float(np.abs(gyro).max())
    clipped = (np.abs(gyro) > most).any(axis=1)
    assert 20 <= clipped.sum() <= 100
    imu = replace(recording.imu, gyro=np.clip(gyro, -most, most), valid=~clipped)
    found = explain([replace(recording, imu=imu)])
    assert found.verdict == "nothing_missing"
    for bias in ("gyro_bias", "accel_bias"):
        assert max(map(abs, sigmas_off(own(found, bias), injected(world, bias)))) < 4.0


# --- the command -------------------------------------------------------------------------------


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "handcal", "explain", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture(scope="module")
def file(two: list[World], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explain") / "phone.mcap"
    write(two[0], path)
    return path


def test_the_command_writes_json_and_a_twin(file: Path, two: list[World], tmp_path: Path) -> None:
    """Read back: the JSON has the contract's keys and no others, the twin is a recording."""
    twin = tmp_path / "twin.mcap"
    done = _run(str(file), "--json", str(tmp_path / "x.json"), "--twin", str(twin))
    assert done.returncode == 0
    # (nothing but the stages, of what takes longer than two seconds)
    assert all(s.startswith("handcal: explaining phone.mcap: ") for s in done.stderr.splitlines())
    assert "lever arm" in done.stdout
    document = json.loads((tmp_path / "x.json").read_text())
    assert set(document) == {
        "schema", "version", "verdict", "mismatch", "missing", "unnamed", "hypotheses", "fit",
        "held_out", "recording", "covariance", "likelihood", "quality",
        "next_motion", "parameters", "noise", "untellable", "model", "warnings", "hand",
        "trust", "trust_reasons",
    }  # fmt: skip
    assert (document["schema"], document["verdict"]) == ("handcal/explanation/1", "explained")
    assert set(document["mismatch"][0]) == {"channel", "from_s", "to_s", "share", "when"}
    (missing,) = document["missing"]
    assert set(missing) == {
        "size", "share", "held_out_gain",
        "effect", "probability", "log_evidence_gain", "indistinguishable_from", "parameters",
        "story",
    }  # fmt: skip
    assert missing["effect"] == "lever_arm"
    assert all(set(p) == {"name", "value", "sigma", "unit"} for p in missing["parameters"])
    assert set(document["fit"]) == {"before", "after"}
    for fit in document["fit"].values():
        assert set(fit) == {"log_evidence", "residual_rms", "nis", "whiteness"}
    assert set(document["held_out"]) == {
        "log_score_before", "log_score_after", "residual_rms_before", "residual_rms_after",
    }  # fmt: skip
    told = {(p["effect"], p["name"]) for p in document["parameters"]}
    assert {
        (e, a) for e in ("gyro_bias", "accel_bias", "lever_arm", "accel_scale") for a in "xyz"
    } < told
    assert {"gyro_noise", "accel_noise", "heading_noise"} <= {n["name"] for n in document["noise"]}
    assert document["warnings"] == []

    recorded = handcal.load(twin)
    np.testing.assert_allclose(recorded.imu.gyro, two[0].imu.values[:, :3], atol=1e-12)
    # before, the model takes the arm's swing for what the sensor should not have read
    off = []
    for model in ("before", "after"):
        imu = handcal.load(twin, topics={"imu": f"/{model}/imu"}).imu
        np.testing.assert_array_equal(imu.t, recorded.imu.t)
        error = imu.accel - two[0].truth.f - injected(two[0], "accel_bias")
        slow = [np.convolve(x, np.full(20, 0.05), "valid") for x in error.T]
        off.append(float(np.sqrt(np.mean(np.square(slow)))))
    assert off[1] < off[0]


@pytest.fixture
def main(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable:
    """The command in this process; explaining is told what to say, or to fail."""

    def call(*arguments: str, says: Explanation | Exception | None = None) -> tuple[int, str, str]:
        def made_up(*_: object, **__: object) -> Explanation:
            if isinstance(says, Exception):
                raise says
            assert says is not None
            return says

        if says is not None:
            monkeypatch.setattr("handcal.explain.explain", made_up)
        monkeypatch.setattr(sys, "argv", ["handcal", "explain", *arguments])
        with pytest.raises(SystemExit) as stop:
            _app.main()
        captured = capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err

    return call


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_status_0(main: Callable, file: Path, verdict: str) -> None:
    said = fake_explanation(verdict, recordings=1)
    status, out, err = main(str(file), "--json", "-", says=said)
    assert (status, err) == (0, "")
    assert json.loads(out)["verdict"] == verdict


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nothing-there.mcap"],
        ["{file}", "nothing-there.mcap"],
        ["{file}", "--held-out", "nothing-there.mcap"],
        ["{file}", "--twin", "no-folder/x.mcap"],
        ["{file}", "--twin", "x.txt"],
        ["{file}", "--json", "no-folder/x.json"],
        ["{file}", "--assume", "nonsense"],
        ["{file}", "--latitude", "91"],
        ["{file}", "--units", "accel"],
        ["{file}", "--nonsense"],
        ["."],
        ["{file}", "--ignore", "nonsense"],
        ["{file}", "--heading-sigma", "0"],
    ],
)
def test_wrong_use_is_status_2_and_one_line(
    main: Callable, file: Path, arguments: list[str]
) -> None:
    status, out, err = main(*[a.format(file=file) for a in arguments])
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("handcal: ")


def test_no_result_is_status_1_and_a_sentence(main: Callable, file: Path) -> None:
    sentence = "The motion shows nothing."
    status, out, err = main(str(file), says=handcal.types.HandcalError(sentence))
    assert (status, out, err) == (1, "", f"handcal: {sentence}\n")


@pytest.mark.prove
def test_a_missing_file_is_told_without_a_traceback(tmp_path: Path) -> None:
    done = _run(str(tmp_path / "nothing-there.mcap"))
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


def test_help_explains(main: Callable) -> None:
    status, out, _ = main("--help")
    assert status == 0
    for word in ("--held-out", "--twin", "--json", "--report", "--rrd", "--heading-sigma",
                 "exit status is 0"):  # fmt: skip
        assert word in " ".join(out.split())


# --- options -----------------------------------------------------------------------------------


@pytest.mark.prove
def test_a_stream_can_be_ignored() -> None:
    """Without the heading, what only the heading shows is not on trial."""
    recording = recording_of(world_of({"heading_delay": [0.2]}), "heading")
    found = explain([recording], ignore=("heading",))
    assert found.verdict == "nothing_missing"
    assert not {h.effect for h in found.hypotheses if h.effect.startswith("heading")}


@pytest.mark.prove
def test_readings_too_few_to_say_anything(two: list[World]) -> None:
    """A stream of a few headings is left out with a word, as ``calibrate`` does."""
    recording = recording_of(two[0], "heading")
    heading = recording.streams["heading"]
    few: Recording = replace(
        recording, streams={"heading": Series(heading.t[:10], heading.value[:10])}
    )
    found = explain([few])
    assert found.verdict in VERDICTS
    assert any("heading" in w for w in found.warnings)

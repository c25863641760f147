"""Doubt is not lost on the way: what speaks against a result is said wherever it is handed on, and
what is not to be trusted is refused there."""

from __future__ import annotations

import html
import io
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import fleet_stub
import numpy as np
import pytest
import schemas
from fake_explanation import fake_explanation
from fake_result import fake_result
from rich.console import Console

import handcal
from handcal.api.words import in_python
from handcal.commands import _app
from handcal.device import another
from handcal.device import apply as device
from handcal.fleet import store
from handcal.fleet.record import DONE, RECORD_SCHEMA, Source
from handcal.fleet.results import write_all
from handcal.fleet.run import Member
from handcal.recordings.export import write_mcap
from handcal.show.calibration.report import render
from handcal.show.calibration.summary import calibration_json, write_json
from handcal.show.calibration.terminal import print_summary
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.report import render_explanation
from handcal.show.explanation.terminal import print_explanation
from handcal.types import HandcalError, Imu, InputError, Recording, Result


def plain() -> Result:
    return fake_result(extra=False)


def with_parameter(value: float) -> Result:
    r = fake_result()
    at = next(i for i, p in enumerate(r.parameters) if p.effect == "gyro_scale")
    changed = replace(r.parameters[at], value=value)
    return replace(r, parameters=(*r.parameters[:at], changed, *r.parameters[at + 1 :]))


def unread(recording: Recording) -> Recording:
    valid = np.ones(len(recording.imu.t), dtype=np.bool_)
    valid[2000:5000] = False
    return replace(recording, imu=replace(recording.imu, valid=valid))


def restless() -> Result:
    r = plain()
    values = r.history.parameters.copy()
    values[-300:-1, 0] += 0.01
    return replace(r, history=replace(r.history, parameters=values))


def louder() -> Result:
    r = plain()
    return replace(r, noise=(replace(r.noise[0], value=0.5, estimated=True), *r.noise[1:]))


def deaf() -> Result:
    r = plain()
    level = replace(r.noise[0], name="heading_noise", value=1.7, unit="rad", estimated=True)
    return replace(r, noise=(*r.noise, level))


def flying() -> Result:
    r = plain()
    assert "position" in r.innovations
    named = {"fixed_position": r.innovations["position"]}
    return replace(r, innovations=named, history=replace(r.history, p_n=r.history.p_n + far(r)))


def far(r: Result) -> np.ndarray:
    return np.linspace(-9.0, 9.0, len(r.history.t))[:, None]


def found():
    return fake_explanation("explained", recordings=1)


def worse():
    e = found()
    return replace(e, held_out=replace(e.held_out, log_score_after=6014.0))


def rough():
    e = found()
    return replace(e, after=replace(e.after, nis=e.after.nis | {"fixed_position": 4.0}))


def blind():
    e = found()
    one = replace(e.recordings[0], recording=unread(e.recordings[0].recording))
    return replace(e, recordings=(one,))


STRAYS = "In the final fit the held point strays by 7 m: do not use this fit."
SWAYS = "The held point would sway by 0.4 m, more than that of a hand which stays in one place."
ONLY = "These sigmas hold only if the device has no errors but its biases."
# what is wrong; the result; its trust; a part of the reason
DOUBTS: dict[str, tuple[Callable[[], object], str, str]] = {
    "unseen data fit worse": (worse, "doubtful", "the final model does worse, by 106 nats"),
    "not converged": (lambda: replace(plain(), settled=False), "doubtful", "still moved after"),
    "search cut short": (
        lambda: replace(found(), untried=("laws", "steps")), "doubtful", "tried: laws, steps."),
    "strange device": (partial(with_parameter, 0.9), "doubtful", "Larger than in any real device"),
    "saturated": (blind, "doubtful", "end of its measuring range"),
    "saturated, calibrated": (
        lambda: replace(plain(), recording=unread(plain().recording)), "doubtful", "or not read"),
    "hand implausible": (lambda: replace(found(), doubts=(SWAYS,)), "doubtful", "would sway"),
    "hand implausible, calibrated": (
        lambda: replace(plain(), doubts=(SWAYS,)), "doubtful", "would sway"),
    "filter inconsistent": (
        lambda: fake_result(extra=False, overconfident=True), "doubtful", "times as far as"),
    "final model inconsistent": (rough, "doubtful", "2.0 times as far"),
    "nothing but biases": (lambda: replace(plain(), doubts=(ONLY,)), "doubtful", "sigmas hold"),
    "an estimate that moves": (restless, "doubtful", "in the second half"),
    "noise made up": (louder, "doubtful", "times as large as the readings show"),
    "a heading that says nothing": (deaf, "doubtful", "The heading carries no information"),
    "no hand, explained": (lambda: replace(found(), impossible=(STRAYS,)), "none", "strays by 7 m"),
    "no hand, calibrated": (flying, "none", "the held point strays by"),
    "unfit": (
        lambda: replace(plain(), recording=replace(plain().recording, unfit="It reads 2 g.")),
        "none", "It reads 2 g."),
}  # fmt: skip


def of_api(made):
    return (handcal.Calibration if isinstance(made, Result) else handcal.Explanation).of(made)


def document_of(made) -> dict:
    return calibration_json(made) if isinstance(made, Result) else explanation_json(made)


def printed(made) -> str:
    console = Console(file=io.StringIO(), width=80)
    (print_summary if isinstance(made, Result) else print_explanation)(made, console)
    return flat(console.file.getvalue())


def flat(text: str) -> str:
    """Without line breaks, no-break spaces and entities."""
    return " ".join(html.unescape(text).split())


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """The command line in this process, in a folder of its own: status, output, errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["handcal", *arguments])
        with pytest.raises(SystemExit) as stop:
            _app.main()
        said = capsys.readouterr()
        return stop.value.code, said.out, flat(said.err)

    return call


NEW = ("--effect", "gyro_scale=0.01,0,0", "--seed", "0")
COMMANDS = {
    "apply": ("apply", "hand.mcap", "--from", "made.json", "-o", "out.mcap", "--biases"),
    "conceal": ("conceal", "hand.mcap", *NEW, "--from", "made.json", "-o", "out.mcap"),
    "export": ("export", "made.json", "--to", "csv", "-o", "out.csv"),
    "device add": ("device", "add", "out.toml", "made.json", "--date", "2026-05-01"),
}


@pytest.fixture(params=DOUBTS)
def doubted(request):
    make, level, part = DOUBTS[request.param]
    return make(), level, part


@pytest.fixture(params=["unseen data fit worse", "no hand, calibrated"])
def handed_on(request):
    """Of each kind one: whoever uses a result goes by its level and its reasons alone."""
    make, level, part = DOUBTS[request.param]
    return make(), level, part


@pytest.mark.usefixtures("no_figures")
def test_json_page_terminal_and_python_say_it(doubted):
    made, level, part = doubted
    document = document_of(made)
    assert document["trust"] == level
    (reason,) = (r for r in document["trust_reasons"] if part in flat(r))
    assert reason in document["warnings"]
    assert of_api(made).trust == level
    assert in_python(reason) in of_api(made).trust_reasons
    assert flat(in_python(reason)) in flat(repr(of_api(made)))
    page = render(made) if isinstance(made, Result) else render_explanation(made)
    assert flat(reason) in flat(page)
    assert flat(reason) in printed(made)


@pytest.mark.parametrize("command", COMMANDS)
def test_whoever_is_handed_it_hears_it_or_is_refused(handed_on, command, run, tmp_path):
    made, level, part = handed_on
    write_json(document_of(made), tmp_path / "made.json")
    recording = made.recording if isinstance(made, Result) else made.recordings[0].recording
    name = "hand-motion.mcap" if isinstance(made, Result) else recording.path
    write_mcap(replace(recording, unfit=""), tmp_path / name)
    words = [name if w == "hand.mcap" else w for w in COMMANDS[command]]
    status, _, said = run(*words)
    assert part in said
    assert status == (1 if level == "none" else 0), said
    assert bool(list(tmp_path.glob("out.*"))) == (level != "none")
    if level == "none":
        assert "--anyway" in said
        status, _, said = run(*words, "--anyway")
        assert (status, part in said) == (0, True), said
    if command == "export":
        assert part in flat((tmp_path / "out.csv").read_text("utf-8"))


def test_a_fit_is_repeated_with_the_reasons_or_refused(handed_on, run, tmp_path):
    made, level, part = handed_on
    # (without a model nothing is fitted, which is said after the doubts)
    (tmp_path / "made.json").write_text(json.dumps(document_of(made) | {"model": None}))
    write_mcap(plain().recording, tmp_path / "hand.mcap")
    words = ("calibrate", "hand.mcap", "--from", "made.json")
    status, _, said = run(*words)
    assert part in said
    assert ("--anyway" in said, "holds no model" in said) == (level == "none", level != "none")
    assert status == (1 if level == "none" else 2)
    _, _, said = run(*words, "--anyway")
    assert part in said
    assert "holds no model" in said


@pytest.mark.usefixtures("no_figures")
def test_a_live_session_ends_with_the_reasons_and_exports_what_is_to_be_trusted(
    handed_on, run, tmp_path, monkeypatch
):
    made, level, part = handed_on
    explanation, result = (found(), made) if isinstance(made, Result) else (made, plain())
    monkeypatch.setattr("handcal.explain.explain", lambda *_, **__: explanation)
    monkeypatch.setattr("handcal.estimate.calibration.calibrate", lambda *_, **__: result)
    write_mcap(plain().recording, tmp_path / "hand.mcap")
    for more in ((), ("--anyway",)) if level == "none" else ((),):
        words = ("live", "--from", "hand.mcap", "--speed", "0", "--out", f"out{len(more)}")
        status, out, said = run(*words, *more)
        assert status == 0, said
        assert part in flat(out)
        refused = level == "none" and not more
        assert ("--anyway" in out) == refused
        assert bool(list(tmp_path.glob(f"out{len(more)}/exports/*"))) != refused


@pytest.mark.parametrize("anyway", [False, True])
def test_a_fleet_names_it_and_learns_of_what_is_to_be_trusted(handed_on, anyway, tmp_path):
    made, level, part = handed_on
    own = {k: v for k, v in document_of(made).items() if k in ("trust", "trust_reasons")}
    place, members = store.opened(tmp_path / "out"), []
    for name, more in (("fine", {}), ("doubted", own)):
        file = tmp_path / f"{name}.csv"
        file.write_text("fine 0.01")
        record = fleet_stub.work({"path": str(file)}) | more
        record |= {"schema": RECORD_SCHEMA, "status": DONE, "reason": "", "sha256": name,
                   "key": name}  # fmt: skip
        place.keep(name, json.dumps(record), "")
        members.append(Member(Source(str(file), "m", name), name))
    written = write_all(members, place, anyway=anyway)
    used = level != "none" or anyway
    assert sum(m.recordings for m in written.fleet.models) == 1 + used
    (sentence,) = (s for s in written.said if part in flat(s))
    assert sentence.startswith("doubted.csv")
    assert ("--anyway" in sentence) != used
    document = json.loads((tmp_path / "out/fleet.json").read_text("utf-8"))
    schemas.check(document)
    assert part in flat(json.dumps(document["doubted" if used else "untold"], ensure_ascii=False))
    assert part in flat((tmp_path / "out/fleet.html").read_text("utf-8"))


def test_python_applies_it_with_the_reasons_or_refuses(handed_on):
    made, level, part = handed_on
    recording = plain().recording
    if level == "none":
        with pytest.raises(HandcalError, match="anyway=True"):
            handcal.apply(recording, made)
        with pytest.raises(HandcalError, match="anyway=True"):
            handcal.conceal(recording, {"gyro_scale": [0.01, 0.0, 0.0]}, learnt=made)
    done = handcal.apply(recording, made, anyway=level == "none")
    assert any(part in flat(w) for w in done.warnings)
    assert part in flat(repr(done))


def test_what_is_good_is_handed_on_without_a_word(run, tmp_path):
    made = of_api(plain())
    assert (made.trust, made.trust_reasons) == ("good", ())
    write_json(document_of(made), tmp_path / "made.json")
    write_mcap(made.recording, tmp_path / "hand-motion.mcap")
    for words in COMMANDS.values():
        status, _, said = run(*("hand-motion.mcap" if w == "hand.mcap" else w for w in words))
        assert (status, "doubtful" in said, "another device" in said) == (0, False, False), said


def test_several_results_of_one_fit_share_the_least_trust():
    one, other = plain(), replace(plain(), settled=False)
    document = calibration_json([one, other])
    assert document["trust"] == "doubtful"
    assert len(document["trust_reasons"]) == 1
    assert not any("trust" in part for part in document["recordings"])


@pytest.mark.parametrize("damage", [{"trust": "perfect"}, {"trust_reasons": "because"}])
def test_a_damaged_trust_is_a_sentence(damage):
    document = json.loads(json.dumps(calibration_json(plain()))) | damage
    with pytest.raises(InputError, match="damaged: its trust must be good or doubtful or none"):
        device.of_document("x.json", document)


# --- another device -----------------------------------------------------------------------------


def noisier(r: Recording) -> Recording:
    more = np.random.default_rng(0).normal(0.0, 0.2, r.imu.gyro.shape)
    return replace(r, imu=replace(r.imu, gyro=r.imu.gyro + more))


def biased(r: Recording) -> Recording:
    return replace(r, imu=replace(r.imu, gyro=r.imu.gyro + np.radians([0.0, 9.0, 0.0])))


def slower(r: Recording) -> Recording:
    imu = r.imu
    return replace(r, imu=Imu(imu.t[::2], imu.gyro[::2], imu.accel[::2], imu.valid[::2]))


def renamed(r: Recording) -> Recording:
    return replace(r, model="Pixel 9")


OTHERS = {
    noisier: "the noise of its gyro is",
    biased: "deg/s away from the bias",
    slower: "it has 50 readings in a second, not 100",
    renamed: "its model is Pixel 9, not Pixel 4",
}


@pytest.mark.parametrize("other", OTHERS)
def test_a_recording_of_another_device_is_noticed(other):
    made = replace(plain(), recording=replace(plain().recording, model="Pixel 4"))
    learnt = device.of_document("x.json", calibration_json(made))
    assert another.another(made.recording, learnt) == ""
    said = another.another(other(made.recording), learnt)
    assert "seems to be of another device than x.json: " in said
    assert OTHERS[other] in said
    assert said.count(";") == 0
    assert said in handcal.apply(other(made.recording), made).warnings[0].replace(
        "this calibration", "x.json"
    )

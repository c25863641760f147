"""What `explain` says to do next can be copied, and its page says how to apply what was found."""

import re
import shlex
from dataclasses import replace
from html import unescape
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from fake_explanation import fake_explanation
from rich.console import Console

from handcal.commands import _registry
from handcal.commands._options import AS_IT_IS, Reading
from handcal.commands.explain import Assume, _typed
from handcal.device.apply import BIASES_TOO
from handcal.effects import catalogue, with_effects
from handcal.estimate.specification import Specification
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.next_commands import applicable, beside, commands
from handcal.show.explanation.report import render_explanation
from handcal.show.explanation.terminal import print_explanation
from handcal.types import Parameter, Series

pytestmark = pytest.mark.usefixtures("no_figures")


def understood(line):
    """The options of a command as its command line reads them."""
    program, name, *words = shlex.split(line)
    assert program == "handcal"
    return _registry._loaded(_registry._plugins()[name]).make_context(name, words).params


MODEL = Specification((), ())


def fitted():
    return replace(fake_explanation("explained", recordings=1), model=MODEL)


def test_what_was_written_is_repeated_and_taken_off():
    how = Reading(["imu=/a b"], "gyro=deg/s")
    typed = _typed(Assume.rest_only, 3.0, 48.1, 520.0, ["mag"], True, how,
                   Path("d.json"), [Path("o.mcap")], 60.0)  # fmt: skip
    first, second, third = commands(fitted(), ["my turns.mcap"], typed, "out/why.json")
    given = understood(first)
    # (--from holds the hand's assumption and the effects, and refuses to be told them)
    assert (str(given["learnt_from"]), given["effects"]) == ("out/why.json", "")
    assert (str(given["assume"]), given["heading_sigma"], not given["ignore"]) == (
        "auto",
        None,
        True,
    )
    assert [str(f) for f in given["files"]] == ["my turns.mcap"]
    assert (given["topic"], given["units"]) == (["imu=/a b"], "gyro=deg/s")
    assert str(given["device"]) == "d.json"
    given = understood(second)
    assert str(given["recording"]) == "my turns.mcap"
    assert str(given["learnt_from"]) == "out/why.json"
    assert (given["topic"], given["units"]) == (["imu=/a b"], "gyro=deg/s")
    assert third == "handcal device add d.json out/why.json"


def test_what_is_of_no_device_is_not_kept_in_its_file():
    e = fitted()
    assert commands(e, ["a.zip"], [], "a.json")[-1] == "handcal device add my-device.toml a.json"
    iron = Parameter("mag_hard_iron", "x", 1e-5, 1e-6, "tesla", 1e-4, None)
    e = replace(e, missing=(replace(e.missing[0], effect=iron.effect, parameters=(iron,)),))
    read = e.recordings[0].recording
    mag = replace(read, streams={"mag": Series(read.imu.t, read.imu.accel)})
    e = replace(e, recordings=(replace(e.recordings[0], recording=mag),))
    assert commands(e, ["a.zip"], [], "a.json")[-1].startswith("handcal apply a.zip --from a.json")


def test_what_was_not_written_is_written_first_as_it_was_found():
    how = Reading(["imu=/a b"], "gyro=deg/s")
    typed = _typed(Assume.rest_only, 3.0, 48.1, 520.0, ["mag"], True, how,
                   Path("d.json"), [Path("o.mcap")], 60.0)  # fmt: skip
    first, second, third, _ = commands(fitted(), ["a.mcap"], typed)
    given = understood(first)
    assert first.startswith("handcal explain a.mcap ")
    assert (str(given["assume"]), given["heading_sigma"]) == ("rest-only", 3.0)
    assert (given["latitude"], given["height"], given["ignore"]) == (48.1, 520.0, ["mag"])
    assert (given["reference_exact"], given["topic"], given["units"]) == (
        True, ["imu=/a b"], "gyro=deg/s"
    )  # fmt: skip
    assert (str(given["held_out"][0]), given["budget"]) == ("o.mcap", 60.0)
    for line in (second, third):
        assert understood(line)["learnt_from"] == given["json"]


@pytest.mark.parametrize(("typed", "folder"), [("my laws", "my laws"), (None, "DIR")])
def test_effects_of_ones_own_are_read_from_where_they_were(typed, folder):
    e = fitted()
    e = replace(e, missing=(replace(e.missing[0], effect="gyro_odd"), *e.missing[1:]))
    options = _typed(Assume.auto, None, None, 0.0, None, False, AS_IT_IS,
                     effects_from=typed and Path(typed))  # fmt: skip
    with with_effects([("gyro_odd.py", replace(catalogue()["gyro_scale"], id="gyro_odd"))]):
        lines = commands(e, ["a.mcap"], options)
    assert all(line.count("--effects-from") == 1 for line in lines[:2])
    for line in lines[:2]:
        assert str(understood(line)["effects_from"]) == folder


def test_a_fit_that_cannot_be_repeated_is_made_again_of_its_effects():
    typed = _typed(Assume.rest_only, 3.0, None, 0.0, None, False, AS_IT_IS, None, None, 60.0)
    first, *_ = commands(fake_explanation("explained", 1), ["a.mcap"], typed, "why.json")
    given = understood(first)
    assert (given["effects"], given["learnt_from"]) == ("gyro_scale,lever_arm", None)
    assert (str(given["assume"]), given["heading_sigma"]) == ("rest-only", 3.0)


def test_nothing_typed_nothing_said():
    assert _typed(Assume.auto, None, None, 0.0, None, False, AS_IT_IS) == []
    (only,) = commands(fake_explanation("nothing_missing", recordings=1), ["a.mcap"], json="b.json")
    assert only == "handcal calibrate a.mcap --report a-calibration.html"


@pytest.mark.parametrize("json", ["phone.json", ""])
def test_the_page_has_the_terminals_commands(json):
    following = commands(fitted(), ["a.mcap"], [], json)
    page = unescape(render_explanation(fitted(), following))
    assert "\n".join(following) in page
    assert "explanation.json" not in page.replace("a-explanation.json", "")


def test_in_the_terminal_last_and_in_one_line():
    e = fake_explanation("explained", recordings=1)
    lines = commands(
        e, ["a-recording-with-quite-a-long-name-for-eighty-columns.mcap"], [], "b.json"
    )
    out = StringIO()
    print_explanation(e, Console(file=out, width=80), lines)
    last = ["Next", *lines, f"  {BIASES_TOO}"]
    assert out.getvalue().rstrip("\n").split("\n")[-len(last) :] == last


def test_what_biases_is_for_is_said_where_apply_comes_next():
    """Guides type `apply --biases`, these commands do not (a ROS 2 user asked which)."""
    assert beside(["handcal calibrate a.mcap"]) == ""
    assert beside(["handcal calibrate a", "handcal apply a --from b"]) == BIASES_TOO
    following = commands(fitted(), ["a.mcap"], [], "b.json")
    assert any(line.startswith("handcal apply") for line in following)
    assert BIASES_TOO in unescape(render_explanation(fitted(), following))
    guide = Path(__file__).parent.parent / "docs" / "guides" / "ros2-bag.md"
    assert BIASES_TOO.removeprefix("--biases ") in guide.read_text(encoding="utf-8")


@pytest.mark.parametrize("verdict", ["explained", "nothing_missing", "unexplained", "cannot_tell"])
def test_the_page_says_how_to_apply_it(verdict):
    e = fake_explanation(verdict, recordings=1)
    page = render_explanation(e)
    assert page.count("How to apply it") == 1
    code = unescape(re.findall(r"<pre><code>(.*?)</code></pre>", page, re.DOTALL)[0])
    rng = np.random.default_rng(0)
    scope = {"gyro": rng.normal(size=(5, 3)), "accel": rng.normal(size=(5, 3))}
    exec(code, scope)
    known = {(p.effect, p.name): p.value if p.shown else 0.0 for p in applicable(e)}
    bias = [known["gyro_bias", a] for a in "xyz"]
    scale = [known.get(("gyro_scale", a), 0.0) for a in "xyz"]
    wanted = (scope["gyro"] - bias) / (1.0 + np.array(scale))
    np.testing.assert_allclose(scope["gyro_true"], wanted, atol=1e-5)
    for line in commands(e):
        assert line in unescape(page)


def test_of_several_recordings_the_biases_are_said_to_be_of_one():
    e = fake_explanation("explained", recordings=2)
    one, other = e.recordings
    moved = tuple(replace(p, value=p.value + 1.0) for p in other.parameters)
    e = replace(e, recordings=(one, replace(other, parameters=moved)))
    page = render_explanation(e)
    assert f"The biases are those of {one.recording.path}" in page
    of = {(p.effect, p.name): p.value for p in one.parameters}
    assert {
        k: v for k, v in ((((p.effect, p.name), p.value)) for p in applicable(e)) if k in of
    } == of


def test_the_json_of_one_recording_names_it():
    e = fake_explanation("explained", recordings=1)
    named = explanation_json(e)["recording"]
    assert named["path"] == e.recordings[0].recording.path
    assert named["imu_rate_hz"] == pytest.approx(100.0)
    assert "recording" not in explanation_json(fake_explanation("explained", recordings=2))


def test_a_law_is_written_out_and_explained_with():
    e = replace(fake_explanation("unexplained", recordings=1), model=MODEL)
    lines = commands(e, ["a b.mcap"], ["--latitude", "48"], "why.json")
    written, again = (understood(line) for line in lines if "handcal explain" in line)
    assert written["write_effect"] == Path("my-effects/law_of_a_b.py")
    assert again["effects_from"] == Path("my-effects")
    assert (str(again["json"]), again["latitude"]) == ("why.json", 48.0)


def test_only_what_can_be_taken_off_is():
    e = fitted()
    arm = Parameter("lever_arm", "x", 0.03, 0.001, "m", 0.05, None)
    e = replace(e, missing=(replace(e.missing[0], effect=arm.effect, parameters=(arm,)),))
    assert not any("handcal apply" in line for line in commands(e, ["a.mcap"], [], "why.json"))

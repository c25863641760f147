"""Numbers and words of a result: the JSON of the contract, units, verdicts."""

import io
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import schemas
from fake_result import fake_result
from rich.console import Console
from worlds import recording_of

import handcal
from handcal import units
from handcal.estimate.white import white_levels
from handcal.show import doubts, words
from handcal.show.calibration import shown, summary, verdict_text
from handcal.show.calibration.plots import sizes
from handcal.show.calibration.terminal import print_summary
from handcal.show.frames import layout_of
from handcal.types import HandcalError, Innovations, NoiseLevel, Parameter
from handcal_sim.scenario import simulate


def innovations(nis_scale: float, updates: int = 400, seed: int = 3) -> Innovations:
    rng = np.random.default_rng(seed)
    residual = math.sqrt(nis_scale) * rng.normal(0, 0.1, (updates, 3))
    sigma = np.full((updates, 3), 0.1)
    t = np.arange(updates) * 0.1
    names = ("position_x", "position_y", "position_z")
    return Innovations(t, residual, sigma, ((residual / sigma) ** 2).sum(1), 0, "m", names)


def no_nulls_in_lists(node: object) -> bool:
    if isinstance(node, dict):
        return all(no_nulls_in_lists(v) for v in node.values())
    return not isinstance(node, list) or all(v is not None and no_nulls_in_lists(v) for v in node)


def test_the_json_has_the_contracts_fields():
    document = summary.calibration_json(fake_result())
    schemas.check(document)
    assert set(document) == {
        "schema", "recording", "parameters", "noise", "fit", "untellable", "covariance", "model",
        "warnings", "quality", "trust", "trust_reasons",
    }  # fmt: skip
    assert document["schema"] == "handcal/calibration/1"
    assert set(document["recording"]) == {
        "path",
        "duration_s",
        "imu_rate_hz",
        "streams",
        "assume",
        "sha256",
        "read_noise",
        "rest_noise",
    }
    assert document["recording"]["imu_rate_hz"] == pytest.approx(100)
    assert set(document["fit"]) == {"log_evidence", "observations", "nis", "whiteness"}
    for p in document["parameters"]:
        assert set(p) == {
            "effect",
            "name",
            "value",
            "sigma",
            "unit",
            "shown",
            "observable",
            "given_model",
            "converged_at_s",
        }
        assert p["shown"] is p["observable"]
    for n in document["noise"]:
        assert set(n) == {"name", "value", "unit"}
    by_name = {(p["effect"], p["name"]): p for p in document["parameters"]}
    assert by_name["gyro_bias", "x"]["value"] == 0.0121
    assert by_name["gyro_scale", "z"]["observable"] is False
    assert no_nulls_in_lists(document)


def test_json_holds_no_number_that_json_cannot(tmp_path):
    result = fake_result(extra=False)
    first = replace(result.parameters[0], value=math.nan, sigma=math.inf)
    broken = replace(result, parameters=(first, *result.parameters[1:]), log_evidence=math.nan)
    summary.write_json(summary.calibration_json(broken), tmp_path / "x.json")
    document = json.loads((tmp_path / "x.json").read_text(), parse_constant=pytest.fail)
    assert document["parameters"][0]["value"] is None
    assert document["parameters"][0]["sigma"] is None
    assert document["fit"]["log_evidence"] is None


def test_several_results_are_a_list_of_recordings():
    one = fake_result(extra=False)
    assert summary.calibration_json([one]) == summary.calibration_json(one)
    document = summary.calibration_json([fake_result(), fake_result()])
    schemas.check(document)
    assert {p["effect"] for p in document["parameters"]}.isdisjoint(summary.OWN)
    assert len(document["parameters"]) == 7
    assert [len(r["parameters"]) for r in document["recordings"]] == [6, 6]
    assert document["fit"]["log_evidence"] == document["recordings"][0]["fit"]["log_evidence"]


def test_a_folder_that_does_not_exist_is_a_sentence(tmp_path):
    with pytest.raises(HandcalError, match="could not be written"):
        summary.write_json({"schema": "x/1"}, tmp_path / "none" / "x.json")


def test_whiteness_tells_white_from_alike():
    white = innovations(1.0, 2000)
    assert abs(summary.whiteness(white)) < 0.05
    slow = replace(white, residual=np.repeat(white.residual[::10], 10, axis=0))
    assert summary.whiteness(slow) == pytest.approx(0.9, abs=0.05)
    assert summary.whiteness(innovations(1.0, 2)) is None


def test_running_nis_stays_in_its_band_as_often_as_it_should():
    """Windows that do not overlap, of white innovations: 95 % inside, give or take."""
    i = innovations(1.0, 20_000, seed=1)
    low, high = summary.nis_band(20 * 3)
    t, mean = summary.windowed_nis(i, 20)
    inside = ((mean >= low) & (mean <= high))[::20].mean()
    assert len(t) == len(mean) == 20_000 - 19
    assert t[0] == i.t[19]
    assert abs(inside - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 1000)


@pytest.mark.parametrize(
    ("unit", "value", "sigma", "text"),
    [
        ("rad/s", math.radians(0.5), math.radians(0.012), "0.500 deg/s"),
        ("rad/s", math.radians(10 / 3600), math.radians(1 / 3600), "10.0 deg/h"),
        ("m/s^2", 9.80665e-3, 0.5e-3, "1.000 mg"),
        ("1", 0.005, 1e-4, "0.500 %"),
        ("1", -200e-6, 10e-6, "−200 ppm"),
        ("m", 0.1, 0.002, "100.0 mm"),
        ("(rad/s)/(m/s^2)", math.radians(0.1) / 9.80665, 1e-5, "0.1000 deg/s/g"),
        ("s/rad", 0.01 / math.radians(100), 1e-4, "1.000 %/(100 deg/s)"),
        ("m/(rad/s)", 0.004, 0.0001, "6.98 mm/(100 deg/s)"),
        ("furlong", 3.0, 0.5, "3.00 furlong"),
    ],
)
def test_units_for_people(unit, value, sigma, text):
    of = units.shown(unit, [value])
    assert f"{of.value(value, sigma)} {of.unit}" == text


def test_digits_follow_sigma():
    assert units.Shown("", 1.0).value(1.23456, 0.012) == "1.235"
    assert units.Shown("", 1.0).value(1234.5, 37.0) == "1234"
    assert units.Shown("", 1.0).value(-0.5, 0.1, sign=True) == "−0.50"
    assert units.Shown("", 1.0).value(math.nan, 0.1) == "–"


@pytest.mark.parametrize(
    ("scale", "word"), [(1.0, "consistent"), (9.0, "too confident"), (0.1, "too cautious")]
)
def test_nis_in_a_word(scale, word):
    i = innovations(scale)
    assert doubts.nis_word(i) == word
    result = replace(fake_result(), innovations={"position": i})
    assert bool(doubts.oversure(result)) == (word == "too confident")
    assert bool(doubts.cautious(result)) == (word == "too cautious")


def test_the_verdict_says_what_was_learnt_and_what_was_not():
    assert verdict_text.verdict(fake_result(extra=False)).level == "good"
    partly = verdict_text.verdict(fake_result())
    assert (partly.level, partly.headline) == (
        "partly",
        "This motion determined 12 of 13 parameters.",
    )
    doubtful = verdict_text.verdict(fake_result(extra=False, overconfident=True))
    assert doubtful.level == "partly"
    assert any("3.1 times as far" in s for s in doubtful.sentences)
    (sentence,) = verdict_text.not_shown(fake_result())
    assert "z" in sentence
    assert "turn" in sentence


@pytest.mark.parametrize("extra", [False, True])
def test_what_nobody_asked_for_and_no_motion_showed_does_not_count(extra):
    plain, dense = (fake_result(extra=extra, hidden=h) for h in (False, True))
    judged = [verdict_text.verdict(r) for r in (plain, dense)]
    assert judged[0].level == judged[1].level == ("partly" if extra else "good")
    assert re.findall(r"\d+", judged[0].headline) == re.findall(r"\d+", judged[1].headline)
    assert not judged[1].headline.startswith("Every")
    more = len(verdict_text.not_shown(dense)) - len(verdict_text.not_shown(plain))
    assert more == 1  # (two effects, of twelve parameters)


def test_what_was_asked_for_comes_in_front_though_it_is_not_shown():
    asked = [Parameter("gyro_quadratic", a, 0.0, 0.005, "s/rad", 0.005, None) for a in "xyz"]
    own = fake_result(extra=False, hidden=True).parameters
    front, rest = shown.in_front((*own, *asked))
    assert {p.effect for p in front} == {"gyro_bias", "accel_bias", "gyro_quadratic"}
    assert {p.effect for p in rest} == {"accel_scale", "gyro_g_sensitivity"}
    front, rest = shown.in_front(own, ["accel_scale"])
    assert {p.effect for p in rest} == {"gyro_g_sensitivity"}


def test_where_hardly_anything_is_shown_the_first_line_says_what_to_do():
    result = fake_result(hidden=True)
    blind = tuple(replace(p, value=0.0, sigma=p.prior_sigma) for p in result.parameters)
    judged = verdict_text.verdict(replace(result, parameters=blind))
    assert judged.level == "poor"
    assert all(words.effect_motion(i) in judged.headline for i in shown.BIASES)
    gyro = verdict_text.verdict(replace(result, parameters=(*result.parameters[:3], *blind[3:])))
    assert gyro.level == "partly"
    assert words.effect_motion("accel_bias") in gyro.headline
    assert words.effect_motion("gyro_bias") not in gyro.headline
    scale = replace(result.parameters[6], value=0.5, sigma=1e-4)
    told = verdict_text.verdict(replace(result, parameters=(*blind[:6], scale, *blind[7:])))
    assert not any(words.effect_motion(i) in told.headline for i in shown.BIASES)


def test_a_sigma_beyond_the_usual_size_is_explained_and_not_clipped():
    parameters = fake_result(hidden=True).parameters
    wide = [p for p in parameters if p.sigma > p.prior_sigma]
    assert not any(
        "larger than the usual" in s for s in shown.under_table(*shown.in_front(parameters))
    )
    said = shown.under_table(*shown.in_front(parameters, ["gyro_g_sensitivity"]))[-1]
    assert all(words.parameter_title(p) in said for p in wide)
    figure = sizes(wide)
    ends = [line.get_xdata() for line in figure.axes[0].lines if len(line.get_xdata()) == 2]
    assert max(np.ptp(x) for x in ends) == pytest.approx(6.0 * wide[0].sigma / wide[0].prior_sigma)


def test_figures_are_of_what_is_shown_and_few():
    result = fake_result(hidden=True)
    assert {p.effect for p in shown.drawn(result.parameters)} == {
        "gyro_bias", "accel_bias", "gyro_scale", "lever_arm", "heading_delay",
    }  # fmt: skip
    assert ("gyro_scale", "z") not in {(p.effect, p.name) for p in shown.drawn(result.parameters)}
    assert shown.not_drawn(result.parameters) == ""
    known = [replace(p, sigma=1e-3 * p.prior_sigma) for p in result.parameters]
    drawn = shown.drawn(known)
    assert len(drawn) <= shown.MOST_DRAWN < len(known)
    assert drawn[:6] == known[:6]
    assert "g-sensitivity" in shown.not_drawn(known)
    assert len({g.effect for g in layout_of(result).groups}) == 5


@pytest.mark.prove
def test_rests_that_were_fallen_back_upon_are_no_good_verdict():
    """Whether the hand moved or effects are missing, `calibrate --only` cannot tell (without it a
    scale error is not missing)."""
    scale = [0.1, -0.1, 0.1]
    world = simulate("free-hand", seed=7, duration_s=30.0, effects={"gyro_scale": scale})
    whole = handcal.calibrate(recording_of(world))
    assert whole.assume == "fixed-point"
    for axis, true in zip("xyz", scale, strict=True):
        p = whole.parameter("gyro_scale", axis)
        assert abs(p.value - true) < 4.0 * p.sigma < 0.5 * abs(true)
    found = handcal.calibrate(recording_of(world), only=True)
    assert found.assume == "rest-only"
    told = verdict_text.verdict(found)
    assert told.level == "partly"
    assert "may be far off" in told.headline
    assert any("handcal explain" in s for s in told.sentences)
    trust = doubts.of_calibration(found)
    assert trust.level == "doubtful"
    assert [
        any(w in r for r in trust.reasons) for w in ("The hand travels", "sigmas hold only")
    ] == [
        True,
        True,
    ]
    assert not any("throughout" in w for w in found.warnings)
    asked = handcal.calibrate(recording_of(world), assume="rest-only", only=True)
    assert "far off" not in verdict_text.verdict(asked).headline


def test_an_estimate_that_strays_from_its_own_band_is_doubted():
    result = fake_result(extra=False)
    assert doubts.strayed(result) == ()
    h = result.history
    ramp = np.where(h.t > 40, 20 * h.parameter_sigma[-1, 5] * (h.t[-1] - h.t) / h.t[-1], 0.0)
    moved = h.parameters.copy()
    moved[:, 5] += ramp
    result = replace(result, history=replace(h, parameters=moved))
    (sentence,) = doubts.strayed(result)
    assert sentence.startswith("Accelerometer bias z moved by")
    assert verdict_text.verdict(result).level == "partly"


def test_noise_far_above_what_the_readings_show_is_doubted():
    result = fake_result(extra=False)
    honest = white_levels(result.recording)["gyro_noise"]
    for ratio, said in ((2, 0), (40, 1)):
        level = NoiseLevel("gyro_noise", ratio * honest, "rad/s/sqrt(Hz)", True)
        sentences = doubts.inflated(replace(result, noise=(level,)))
        assert len(sentences) == said
    assert "40 times as large" in sentences[0]
    assert doubts.inflated(replace(result, noise=(replace(level, estimated=False),))) == ()


@pytest.mark.parametrize(("width", "columns"), [(80, 6), (120, 7)])
def test_a_narrow_terminal_cuts_no_number(width, columns):
    out = io.StringIO()
    print_summary(fake_result(), Console(file=out, width=width, color_system=None))
    assert "…" not in out.getvalue()
    assert ("prior ±" in out.getvalue()) == (columns == 7)


def test_without_a_heading_the_advice_is_a_second_axis_or_a_heading():
    (sentence,) = verdict_text.not_shown(fake_result(heading=False, extra=False))
    assert sentence.startswith("Gyro bias z")
    assert "second axis" in sentence
    assert "heading" in sentence


def test_the_terminal_table_shows_what_the_motion_did_and_names_the_rest():
    out = io.StringIO()
    result = fake_result(hidden=True)
    print_summary(result, Console(file=out, width=100, color_system=None))
    text = out.getvalue()
    for p in result.parameters[:13]:
        assert words.parameter_title(p) in text
    assert "Accelerometer scale x" not in text
    assert "accelerometer scale and gyro g-sensitivity" in " ".join(text.split())
    assert "could not show" in text
    assert "too confident" not in text
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 100


def test_a_jump_past_half_a_turn_is_a_gap():
    t, y = summary.gapped(np.arange(4.0), np.array([170.0, 179.0, -179.0, -170.0]))
    np.testing.assert_array_equal(t, [0, 1, 1.5, 2, 3])
    np.testing.assert_array_equal(y, [170, 179, np.nan, -179, -170])


def test_channels_of_one_kind_may_have_two_units():
    names = [f"{what}_{a}" for what in ("position", "attitude") for a in "xyz"]
    sigma = np.full((9, 6), 0.01)
    pose = Innovations(np.arange(9.0), sigma, sigma, sigma[:, 0], 0, "m, rad", tuple(names))
    assert [u.unit for u in words.residual_units(pose)] == ["mm"] * 3 + ["deg"] * 3
    assert words.channel_labels(names)[0] == "position x"
    assert words.channel_labels(names[:3]) == ("x", "y", "z")
    assert words.channel_labels(["heading"]) == ("",)


def test_the_json_names_kinds_as_the_contract_does():
    result = fake_result(extra=False)
    kinds = {"fixed_position": innovations(1.0), "zero_velocity": innovations(1.0)}
    document = summary.calibration_json(replace(result, innovations=kinds))
    assert (
        set(document["fit"]["nis"]) == set(document["fit"]["whiteness"]) == {"position", "velocity"}
    )


def test_a_result_says_which_program_and_which_file(tmp_path):
    file = tmp_path / "a.bin"
    file.write_bytes(b"abc")
    recording = replace(fake_result().recording, path=str(file))
    # (FIPS 180-2, appendix B.1)
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert summary.recording_json(recording, "auto")["sha256"] == digest
    gone = replace(recording, path=str(tmp_path))
    assert summary.recording_json(gone, "auto")["sha256"] is None
    summary.write_json({"schema": "x/1", "a": 1}, tmp_path / "x.json")
    written = json.loads((tmp_path / "x.json").read_text())
    assert written == {"schema": "x/1", "version": handcal.__version__, "a": 1}

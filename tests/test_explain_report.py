"""What a person sees of an explanation: JSON, terminal, page and dashboard, of all verdicts."""

import io
import json
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import schemas
from fake_explanation import CASES, fake_explanation
from rerun.chunk import RrdReader
from rich.console import Console

from handcal.explanation import VERDICTS, Curve, Hypothesis, Missing, Unnamed
from handcal.laws.grammar import formula
from handcal.laws.law_effect import Law, effect_of
from handcal.laws.vocabulary import driver_of
from handcal.show import dashboard, drawing
from handcal.show.calibration import summary
from handcal.show.explanation import frames, plots, verdict_text, words
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.evidence_curves import evidence_plot
from handcal.show.explanation.report import render_explanation, write_explanation_report
from handcal.show.explanation.symbols import meanings
from handcal.show.explanation.terminal import print_explanation
from handcal.show.words import channel_title, effect_motion, noise_title, parameter_title
from handcal.types import HandcalError, Parameter
from handcal.units import plain

CONTRACT = {
    "schema", "verdict", "mismatch", "missing", "unnamed", "hypotheses", "fit", "held_out",
    "next_motion", "parameters", "noise", "untellable", "model", "warnings", "hand", "covariance",
}  # fmt: skip
ENTRIES = {
    "mismatch": {"channel": str, "from_s": float, "to_s": float, "share": float, "when": str},
    "missing": {"effect": str, "probability": float, "log_evidence_gain": float,
                "indistinguishable_from": list, "parameters": list, "story": str,
                "size": dict, "share": float, "held_out_gain": float},
    "unnamed": {"formula": str, "value": float, "sigma": float, "unit": str,
                "log_evidence_gain": float, "story": str, "channels": list, "drivers": list,
                "curve": dict, "constants": list},
    "next_motion": {"motion": str, "separates": list, "expected_gain": float},
    "noise": {"name": str, "value": float, "unit": str},
}  # fmt: skip


@pytest.fixture(scope="module", params=VERDICTS)
def verdict(request):
    return request.param


@pytest.fixture(scope="module")
def explanation(verdict):
    return fake_explanation(verdict)


@cache
def drawn(verdict):
    """Drawing takes most of a page's time: once is enough."""
    return plots.draw(fake_explanation(verdict))


@pytest.fixture(scope="module")
def figures(verdict):
    return drawn(verdict)


@pytest.fixture(scope="module")
def page(explanation, figures, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / f"{explanation.verdict}.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots, "draw", lambda _: figures)
        write_explanation_report(explanation, path)
    return path


def nothing_in_it():
    """An explanation of a recording without traces, evidence or noise."""
    e = fake_explanation("nothing_missing")
    r = e.recordings[0]
    bare = replace(r, traces=(), bins=np.zeros(0), shortfall={}, rests=np.zeros((0, 2)),
                   evidence=replace(r.evidence, t=np.zeros(0), gain={}), noise=())  # fmt: skip
    empty = replace(e.before, residual_rms={}, nis={}, whiteness={})
    return replace(e, recordings=(bare,), hypotheses=(), before=empty, after=empty, held_out=None,
                   next_motion=(), noise=())  # fmt: skip


def printed(explanation, width=80):
    out = io.StringIO()
    print_explanation(explanation, Console(file=out, width=width))
    return out.getvalue()


def numbers(node):
    if isinstance(node, dict):
        return [n for v in node.values() for n in numbers(v)]
    if isinstance(node, list):
        assert None not in node
        return [n for v in node for n in numbers(v)]
    return [node] if isinstance(node, float) else []


def test_there_is_a_made_up_explanation_of_every_verdict():
    assert set(CASES) == set(VERDICTS)


def test_the_json_has_the_contracts_keys_and_types(verdict):
    document = explanation_json(fake_explanation(verdict, recordings=1))
    schemas.check(document)
    assert set(document) == CONTRACT | {"recording", "quality", "trust", "trust_reasons"}
    assert document["schema"] == "handcal/explanation/1"
    assert document["verdict"] == verdict
    for name, fields in ENTRIES.items():
        for entry in document[name]:
            assert {k: type(v) for k, v in entry.items()} == fields
    for m in document["missing"]:
        for p in m["parameters"]:
            assert set(p) == {"name", "value", "sigma", "unit"}
    assert set(document["fit"]) == {"before", "after"}
    for fit in document["fit"].values():
        assert set(fit) == {"log_evidence", "residual_rms", "nis", "whiteness"}
        assert set(fit["nis"]) == {"position", "velocity", "heading"}
    assert set(document["held_out"]) in ({
        "log_score_before", "log_score_after", "residual_rms_before", "residual_rms_after",
    }, set())  # fmt: skip
    assert {"gyro_bias", "accel_bias"} <= {p["effect"] for p in document["parameters"]}
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert all(math.isfinite(n) for n in numbers(document))


def test_of_several_recordings_each_keeps_its_own(tmp_path):
    e = fake_explanation("explained", recordings=2)
    document = explanation_json(e)
    assert set(document) == CONTRACT | {"recordings", "trust", "trust_reasons"}
    assert [m["recording"] for m in document["mismatch"]] == [0, 0, 1]
    assert {p["effect"] for p in document["parameters"]}.isdisjoint({"gyro_bias", "accel_bias"})
    for r in document["recordings"]:
        assert {p["effect"] for p in r["parameters"]} == {"gyro_bias", "accel_bias"}
        assert r["recording"]["assume"] == "fixed-point"
    summary.write_json(document, tmp_path / "x.json")


def test_json_leaves_out_what_is_not_a_number():
    e = fake_explanation("explained", recordings=1)
    rms = dict(e.before.residual_rms) | {"heading": math.nan}
    m = replace(e.missing[0], log_evidence_gain=math.inf)
    before = replace(e.before, residual_rms=rms, log_evidence=math.nan)
    document = explanation_json(replace(e, before=before, missing=(m,)))
    assert "heading" not in document["fit"]["before"]["residual_rms"]
    assert document["fit"]["before"]["log_evidence"] is None
    assert document["missing"][0]["log_evidence_gain"] is None
    json.dumps(document, allow_nan=False)


LEVELS = {
    "explained": "good", "nothing_missing": "good", "unexplained": "poor", "cannot_tell": "partly",
}  # fmt: skip


def plainly(text):
    return text.replace("\u00a0", " ")


def told_by(e):
    judged = verdict_text.verdict(e)
    return plainly(" ".join((judged.headline, *judged.sentences)))


def test_the_headline_names_what_was_found_each_with_one_probability(verdict, explanation):
    judged = verdict_text.verdict(explanation)
    assert judged.level == LEVELS[verdict]
    assert judged.headline.startswith("Found: ") == bool(explanation.missing or explanation.unnamed)
    for m in explanation.missing:
        assert all(words.the(t) in judged.headline for t in words.members(m, explanation))
        assert told_by(explanation).count(plainly(words.percent(m.probability))) == 1
    assert not re.search(r"\bmissing\b|\bnats\b", told_by(explanation))


def test_nats_come_after_what_was_found_and_are_told_once(explanation, page):
    for text in (printed(explanation, 200), page.read_text(encoding="utf-8")):
        assert len(re.findall("natural logarithms? of", text)) == 1
        assert not re.search(r"\d\Wnats\b", text.partition("natural logarithm")[0])
        for m in explanation.missing:
            assert text.index(m.story) < text.index("natural logarithm")


def test_where_hardly_anything_is_shown_the_next_motion_comes_first():
    e = fake_explanation("nothing_missing")
    blind = tuple(replace(p, value=0.0, sigma=p.prior_sigma) for p in e.parameters)
    judged = verdict_text.verdict(replace(e, parameters=blind))
    assert judged.level == "poor"
    assert effect_motion("accel_bias") in judged.headline
    found = fake_explanation("explained", recordings=1)
    assert "Found" in verdict_text.verdict(replace(found, parameters=blind)).headline


def with_hard_iron(verdict="explained", count=0):
    """A made-up explanation of a magnetometer, whose hard iron is in the baseline too."""
    e = fake_explanation(verdict, recordings=1)
    rows = tuple(Parameter("mag_hard_iron", a, 2e-5, 1e-6, "tesla", 1e-4, 40.0) for a in "xyz")
    iron = Missing("mag_hard_iron", "Magnetometer hard iron", 0.9999, 546.0, (), rows, "", "",
                   {"mag_z": 1e-4}, 1.0, 263.0)  # fmt: skip
    last = Hypothesis(iron.effect, iron.title, 546.0, 546.0, 9e3, 0.9999, "named")
    tried = tuple(replace(h, verdict="") for h in e.hypotheses) if not count else e.hypotheses
    e = replace(e, missing=(*e.missing[:count], iron), hypotheses=(last, *tried))
    return e if count else replace(e, after=e.before)


@pytest.mark.usefixtures("no_figures")
def test_what_the_baseline_has_too_is_found_like_any_other():
    e = with_hard_iron()
    said = told_by(e)
    assert "the magnetometer hard iron" in verdict_text.verdict(e).headline
    shown = plainly(said + printed(e) + render_explanation(e))
    for wrong in ("of the mismatch", "do equally well", "Before and after", "+0.0"):
        assert wrong not in shown
    assert "fits worst" not in said
    assert plots.heat_plot(e, 0) is None
    both = verdict_text.verdict(with_hard_iron(count=2)).headline
    assert all(t in both for t in ("gyro scale", "lever arm", "hard iron"))


@pytest.mark.usefixtures("no_figures")
def test_shares_that_do_not_add_up_are_said_to_need_not():
    e = fake_explanation("explained", recordings=1)
    one, other = e.missing
    for shares, said in (((0.6, 0.4), False), ((0.62, 0.41), True)):
        pair = zip((one, other), shares, strict=True)
        told = replace(e, missing=tuple(replace(m, share=s) for m, s in pair))
        for text in (printed(told, 200), render_explanation(told)):
            assert ("need not add up" in text) == said


@pytest.mark.usefixtures("no_figures")
def test_a_search_cut_short_says_so_first():
    left = (
        "laws on fewer axes",
        "further effects",
        "noise effects",
        "walks",
        "laws",
        "a hand that moves",
    )
    for e in (fake_explanation("explained", recordings=1), with_hard_iron()):
        e = replace(e, untried=left)
        judged = verdict_text.verdict(e)
        assert judged.level == "partly"
        assert judged.headline == (
            "The search ended before all was tried. Not tried, or not to the end: laws on fewer "
            "axes, further effects, noise effects, walks and two more."
        )
        page, text = render_explanation(e), printed(e, 200)
        assert 'class="verdict partly"' in page
        rows = {h: r for h in e.hypotheses for r in text.splitlines() if r[5:].startswith(h.title)}
        assert any(not h.verdict for h in rows)
        for h, row in rows.items():
            assert row.rstrip().endswith(words.percent(h.probability if h.verdict else math.nan))
    told = verdict_text.verdict(replace(fake_explanation("explained"), untried=left)).sentences
    assert told[0].startswith("Found: the gyro scale error")


def test_a_search_cut_short_says_what_it_named_and_not_that_the_motion_cannot_tell():
    left = replace(fake_explanation("explained"), verdict="cannot_tell", untried=("laws",))
    told = verdict_text.verdict(left).sentences
    assert told[0].startswith("Found: the gyro scale error")
    both = replace(fake_explanation("cannot_tell"), untried=("laws",))
    told = verdict_text.verdict(both).sentences
    assert told[0].startswith("Found: gravity or, less probably, the accelerometer")
    assert "it is not clear which" in " ".join(verdict_text.untold(both))


def test_what_speaks_against_a_model_is_said():
    e = fake_explanation("explained", recordings=1)
    worse = replace(e.held_out, log_score_after=e.held_out.log_score_before - 12.0)
    judged = verdict_text.verdict(replace(e, held_out=worse))
    assert judged.level == "partly"
    assert any("does worse" in s for s in judged.sentences)
    rough = replace(e.after, nis=dict(e.after.nis) | {"heading": 4.0})
    judged = verdict_text.verdict(replace(e, after=rough))
    assert judged.level == "partly"
    assert any("heading scatters 2.0 times as far" in s for s in judged.sentences)


def test_what_cannot_be_told_is_said():
    e = fake_explanation("cannot_tell")
    look, hidden = verdict_text.untold(e)
    assert look.startswith("Gravity, the accelerometer scale error and the accelerometer asymm")
    assert "gyro temperature slope" in hidden
    unlearnt = verdict_text.untold(fake_explanation("explained"))[-1]
    assert unlearnt.startswith("Lever arm z")


def test_what_a_motion_would_do_is_said():
    e = fake_explanation("cannot_tell")
    apart = verdict_text.promise(e.next_motion[1], e)
    assert apart == "sets apart the accelerometer scale error and the accelerometer asymmetry"
    hidden = replace(e.next_motion[0], separates=("gyro_scale", "lever_arm"))
    assert verdict_text.promise(hidden, e) == "would show the gyro scale error and the lever arm"
    many = replace(hidden, separates=tuple(h.effect for h in e.hypotheses[:9]))
    assert verdict_text.promise(many, e).endswith(" and five more")


def test_a_less_probable_rival_of_a_named_effect_is_said():
    e = fake_explanation("explained", recordings=1)
    m = replace(e.missing[0], indistinguishable_from=("gyro_quadratic",))
    e = replace(e, missing=(m,))
    assert "the gyro scale error or, less probably, the gyro quadratic error (probability" in (
        verdict_text.verdict(e).headline
    )
    assert "most probably the gyro scale error" in verdict_text.untold(e)[0]


def test_where_nothing_was_added_there_is_one_model(monkeypatch):
    e, figures = fake_explanation("nothing_missing"), drawn("nothing_missing")
    monkeypatch.setattr(plots, "draw", lambda _: figures)
    html, text = render_explanation(e), printed(e)
    for word in ("Baseline", "Final model", "Before and after", "held-out data"):
        assert word not in html
    assert "Before and after" not in text
    assert "held-out data" not in text
    quiet = {c: 0.0 * s for c, s in e.recordings[0].shortfall.items()}
    e = replace(e, recordings=(replace(e.recordings[0], shortfall=quiet),))
    assert plots.heat_plot(e, 0) is None


def test_a_term_without_a_name_has_its_place_in_every_figure(tmp_path):
    e = fake_explanation("unexplained")
    formula = e.unnamed[0].formula
    r = e.recordings[0]
    gain = {formula: np.linspace(0.0, 95.0, r.evidence.t.size)}
    # (one trace: all the others look alike, and drawing them takes most of the time)
    few = replace(r, evidence=replace(r.evidence, gain=gain), traces=r.traces[:1])
    e = replace(e, recordings=(few,))
    bars, curve = plots.draw(e)["evidence"]
    assert formula.split(" += ")[1] in bars.svg
    assert formula in curve.svg
    dashboard.save_explanation_rrd(e, tmp_path / "x.rrd")
    (entity,) = [n for n in rows(tmp_path / "x.rrd") if n.startswith("/recording_1/evidence/")]
    assert "omega_y" in entity


@pytest.mark.usefixtures("no_figures")
def test_data_not_seen_have_a_score_and_no_residuals():
    """Those depend on the noise that each model allows itself."""
    html = render_explanation(fake_explanation("explained", recordings=1))
    table = re.search(r"Log score.*?</table>", html, re.S).group()
    assert "Gyro x" not in table


@pytest.mark.parametrize(
    ("share", "text"),
    [(1.0, "over 99.9 %"), (0.9951, "99.5 %"), (0.97, "97 %"), (0.004, "0.4 %"),
     (0.0, "under 0.1 %"), (math.nan, "–")],
)  # fmt: skip
def test_no_certainty_that_nobody_has(share, text):
    assert words.percent(share).replace("\u00a0", " ") == text


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "text"),
    [(0.1184, 0.0041, "s", "0.1184 ± 0.0041 s"), (-3.1e-5, 4.4e-6, "1", "(−3.10 ± 0.44)·10⁻⁵"),
     (2.0, math.nan, "m", "2"), (math.nan, 1.0, "m", "unknown"), (0.0, 0.5, "", "0.00 ± 0.50")],
)  # fmt: skip
def test_amounts_of_unnamed_terms(value, sigma, unit, text):
    assert words.amount(Unnamed("f", value, sigma, unit, 1.0)).strip() == text


def test_channels_in_words_and_units():
    assert channel_title("accel_y") == "accelerometer y"
    assert channel_title("heading") == "heading"
    assert words.channel_shown("gyro_x", [1.0]).unit == "deg/s"
    assert words.channel_shown("accel_x", [1.0]).unit == "m/s²"
    assert words.channel_shown("accel_x", [0.1], small=True).unit == "mg"
    assert words.channel_shown("position_x", [0.01]).unit == "mm"
    order = words.channels({"position_x": 1.0, "heading": 1.0}, {"gyro_z": 1.0})
    assert order == ["gyro_z", "heading", "position_x"]


@pytest.mark.parametrize("width", [80, 120])
def test_the_terminal_cuts_nothing_and_breaks_no_number(explanation, width):
    text = printed(explanation, width)
    lines = text.splitlines()
    assert max(len(line.rstrip()) for line in lines) <= width
    assert "…" not in text
    assert not re.search(r"\b(nan|None|inf)\b", text)
    assert not any(line.strip().startswith("%") for line in lines)
    headline = verdict_text.verdict(explanation).headline
    assert " ".join(text.split()).replace("\u00a0", " ").find(" ".join(headline.split())) >= 0
    for m in explanation.missing:
        assert f"Found: {m.title}" in text
    for u in explanation.unnamed:
        assert u.formula in text
    biases = [p for r in explanation.recordings for p in r.parameters]
    assert len(biases) >= 6 * len(explanation.recordings)
    for title in ("Gyro bias z", "Accelerometer bias x"):
        shown = [x for x in lines if re.match(rf"\s*{title}\s+[+−]?\d.* (deg/h|deg/s|mg)", x)]
        assert len(shown) == len(explanation.recordings)


def test_markup_in_names_is_text():
    explanation = fake_explanation("cannot_tell")
    r = explanation.recordings[0]
    odd = replace(r.recording, path="[red]<img src=x>[/red].mcap")
    # (one trace: see above)
    e = replace(explanation, recordings=(replace(r, recording=odd, traces=r.traces[:1]),),
                warnings=("<b>bold</b> [bold]",), mismatch=())  # fmt: skip
    assert "[red]" in printed(e)
    html = render_explanation(e)
    assert "<img" not in html
    assert "<b>bold" not in html


def test_the_page_is_whole_and_says_what_the_explanation_says(explanation, page):
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) < 1_500_000
    assert not re.search(r"https?://|<script|(?:src|href)=\"(?!#)", text)
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"url\(#([^)]*)\)", text)) <= set(ids)
    body = text.split("</style>")[1]
    words_only = re.sub(r"<[^>]*>", " ", body)
    assert not re.search(r"\b(nan|None|inf|undefined)\b", words_only, re.I)
    for colour in drawing.PALETTE:
        assert colour not in body
    assert verdict_text.verdict(explanation).headline in text
    for m in explanation.missing:
        assert m.story in words_only
    for r in explanation.recordings:
        assert Path(r.recording.path).name in text


def test_every_figure_is_there(explanation, figures):
    count = {section: len(p) for section, p in figures.items()}
    n = len(explanation.recordings)
    channels = sum(len(r.traces) for r in explanation.recordings)
    assert count["first"] == count["heat"] == n
    assert count["first"] + count["traces"] + count["others"] == channels
    assert count["evidence"] == 2
    assert count["balance"] == 1
    assert count["parameters"] == (1 if explanation.missing else 0)
    worst = explanation.mismatch[0].channel if explanation.mismatch else None
    if worst:
        assert channel_title(worst) in figures["first"][0].title.lower()


def test_an_explanation_with_next_to_nothing_in_it_still_shows(tmp_path):
    e = nothing_in_it()
    assert verdict_text.verdict(e).headline in render_explanation(e)
    assert verdict_text.verdict(e).headline in printed(e)
    dashboard.save_explanation_rrd(e, tmp_path / "x.rrd")
    assert explanation_json(e)["held_out"] == {}


def test_many_bins_are_added_up_and_none_is_lost():
    e = fake_explanation("cannot_tell")
    r = e.recordings[0]
    many = np.linspace(0, 84, 1001)
    spread = {c: np.linspace(0, 1, 1000) for c in r.shortfall}
    bins, cells = frames.cells(replace(r, bins=many, shortfall=spread))
    assert bins.size - 1 <= frames.CELLS
    assert bins[-1] == many[-1]
    assert cells["heading"].size == bins.size - 1
    assert cells["heading"].sum() == pytest.approx(500.0)


def rows(path):
    """Rows by entity, static ones too."""
    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        timed = dashboard.TIMELINE in chunk.timeline_names
        found[chunk.entity_path] = found.get(chunk.entity_path, 0) + timed * chunk.num_rows
    return found


def test_a_saved_explanation_reads_back(explanation, tmp_path):
    dashboard.save_explanation_rrd(explanation, tmp_path / "x.rrd")
    found = rows(tmp_path / "x.rrd")
    assert "/verdict" in found
    for h in explanation.hypotheses:
        assert (f"/hypotheses/{h.effect}" in found) or not h.verdict
    assert sum(e.startswith("/hypotheses/") for e in found) >= 3
    for i, r in enumerate(explanation.recordings):
        home = f"/recording_{i + 1}"
        for t in r.traces:
            assert found[f"{home}/simulated/{t.channel}"] == t.t.size
            assert found[f"{home}/difference/{t.channel}/model"] == t.t.size
            where = frames.mismatches(explanation, i, t.channel)
            assert found.get(f"{home}/difference/{t.channel}/amiss", 0) == 3 * len(where)
        for channel in r.shortfall:
            assert found[f"{home}/shortfall/{channel}"] == r.bins.size
        for effect in r.evidence.gain:
            assert found[f"{home}/evidence/{effect}"] == r.evidence.t.size


@pytest.mark.usefixtures("no_figures")
def test_a_folder_that_does_not_exist_is_a_sentence(tmp_path):
    e = fake_explanation("nothing_missing")
    for write in (write_explanation_report, dashboard.save_explanation_rrd):
        with pytest.raises(HandcalError, match="could not be written"):
            write(e, tmp_path / "none" / "x")


@pytest.mark.parametrize(("width", "scheme"), [(1180, "light"), (375, "dark")])
def test_a_browser_without_network_draws_it_without_complaint(browser, page, width, scheme):
    context = browser.new_context(
        offline=True, viewport={"width": width, "height": 800}, color_scheme=scheme
    )
    tab = context.new_page()
    said, asked = [], []
    tab.on("console", lambda m: said.append(m.text))
    tab.on("pageerror", lambda e: said.append(str(e)))
    tab.on("request", lambda r: asked.append(r.url))
    tab.goto(page.as_uri())
    assert said == []
    assert asked == [page.as_uri()]
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    outside = """[...document.querySelectorAll('svg')].flatMap(s => {
      const b = s.getBoundingClientRect();
      return [...s.querySelectorAll('text')].filter(t => {
        const r = t.getBoundingClientRect();
        return r.left < b.left - 2 || r.right > b.right + 2 || r.bottom > b.bottom + 2;
      }).map(t => t.textContent)})"""
    assert tab.evaluate(outside) == []
    wider = """[...document.querySelectorAll('.plot.over')].map(f => [f.scrollWidth > f.clientWidth,
      getComputedStyle(f.querySelector('figcaption'), '::after').content.includes('sideways')])"""
    assert tab.evaluate(wider)
    assert all(scrolls == said_so == (width < 700) for scrolls, said_so in tab.evaluate(wider))
    context.close()


def test_of_many_causes_those_that_matter_come_first():
    e = fake_explanation("explained")
    shares = (0.6, 0.3, 0.02, 0.01)
    four = tuple(replace(e.missing[k % 2], share=x) for k, x in enumerate(shares))
    said = verdict_text.matters(replace(e, missing=four))
    assert said is not None
    assert "two matter" in said
    assert "60" in said
    assert "30" in said
    assert "The two others" in said
    assert verdict_text.matters(e) is None
    told = verdict_text.verdict(replace(e, missing=four, untried=("laws on fewer axes",)))
    assert told.sentences[1] == verdict_text.matters(replace(e, missing=four))
    assert told.sentences[0] == verdict_text.verdict(replace(e, missing=four)).headline


def test_of_many_the_headline_names_the_largest_three_and_says_how_many():
    e = fake_explanation("explained")
    first, second = e.missing
    many = [replace(first, share=0.01 * k, title=f"Effect {k}") for k in range(1, 5)]
    said = verdict_text.verdict(replace(e, missing=(second, *many))).headline
    assert "five errors" in said
    assert re.findall(r"lever arm|effect \d", said) == ["lever arm", "effect 4", "effect 3"]
    assert "99.4" in said  # (the least of all probabilities)


@pytest.mark.parametrize("recordings", [1, 2])
def test_of_many_effects_each_has_a_panel_of_its_own(recordings):
    """The strongest sets the scale of a common one, and the others lie on its axis."""
    e = fake_explanation("explained", recordings)
    ids = ("gyro_scale", "lever_arm", "accel_delay", "gyro_bandwidth", "accel_scale")
    ends = dict(zip(ids, (40_000.0, 12.0, 300.0, 25.0, 80.0), strict=True))
    each = tuple(
        replace(r, evidence=replace(
            r.evidence, gain={i: end * np.linspace(0.0, 1.0, r.evidence.t.size)
                              for i, end in ends.items()}))
        for r in e.recordings
    )  # fmt: skip
    found = tuple(replace(e.hypotheses[0], effect=i, title=i, verdict="named") for i in ids)
    plot = evidence_plot(replace(e, recordings=each, hypotheses=found, unnamed=()))
    assert plot is not None
    said = re.findall(rf">({'|'.join(ids)})<", plot.svg)
    assert said == sorted(ids, key=lambda i: -ends[i])
    assert plot.svg.count("nats gained") == 0
    few = evidence_plot(replace(e, recordings=each, hypotheses=found[:3], unnamed=()))
    assert few is not None
    assert few.svg.count("nats gained") == recordings


def test_a_place_that_nobody_measured_is_not_called_recorded():
    r = fake_explanation("explained", recordings=1).recordings[0]
    streams = dict(r.recording.streams)
    held = replace(r, recording=replace(r.recording, streams={}))
    assert words.source("position_x", held) == "held point (assumed)"
    posed = replace(r, recording=replace(r.recording, streams=streams | {"pose": None}))
    assert words.source("position_x", posed) == "recorded"
    assert words.source("gyro_x", held) == "recorded"


def test_what_an_effect_does_to_the_readings_is_said_in_their_unit():
    m = fake_explanation("explained").missing[0]
    said = verdict_text.weight(m).replace("\N{NO-BREAK SPACE}", " ")
    assert "0.69 deg/s in gyro z" in said  # 0.012 rad/s, the largest of the three
    assert "held-out data agree" in said
    assert "do not agree" in verdict_text.weight(replace(m, held_out_gain=-4.0))
    assert "unseen" not in verdict_text.weight(replace(m, held_out_gain=None))


def test_a_law_is_drawn_on_the_page_and_in_one_line() -> None:
    """Friction: low at one end, high at the other, and the readings behind it."""
    x = np.linspace(-2.0, 2.0, 41)
    y = 0.02 * np.tanh(x / 0.2)
    behind = np.stack([x, y + 1e-3], axis=1)
    curve = Curve(x, y, np.full(41, 1e-3), "rad/s", "rad/s", behind)
    law = Unnamed("gyro_z += k * tanh(omega_z / 0.2)", 0.02, 1e-3, "rad/s", 100.0,
                  channels=("gyro_z",), drivers=("omega_z",), curve=curve)  # fmt: skip
    line = words.sparkline(law)
    signs = line.split()[1]
    assert signs == "".join(sorted(signs))
    assert {signs[0], signs[-1]} == {"▁", "█"}
    assert line.startswith("−115 ")
    assert line.endswith("−1.1 to 1.1 deg/s")
    plot = plots.law_plot(law, 0)
    assert plot is not None
    assert plot.svg.count("<use") >= len(behind)
    assert plots.law_plot(replace(law, curve=None), 0) is None
    assert words.sparkline(replace(law, curve=None)) == ""


def test_a_law_of_how_much_a_signal_is_felt_is_drawn_over_what_says_that() -> None:
    x = np.linspace(0.0, 2.0, 41)
    driver = driver_of("omega_{i} by t")
    effect = effect_of(Law(0, (1,), False, driver, formula([("step", (1.0,))]), (0.1,)))
    curve = Curve(x, x, x, "s", "1")
    law = Unnamed(effect.id, 0.02, 1e-3, "1", 100.0, channels=("gyro_y",),
                  drivers=("omega_y", "t"), curve=curve, made=effect.made)  # fmt: skip
    assert (words.over_what(law), words.of_what(law)) == ("t", "omega_y")
    plot = plots.law_plot(law, 0)
    assert plot is not None
    assert plot.caption.startswith("gyro_y: how much of omega_y it reads in addition")
    plain = replace(law, made=None)
    assert (words.over_what(plain), words.of_what(plain)) == ("omega_y, t", "")


def test_what_has_no_name_is_drawn_in_the_viewer_and_said_for_what_it_is(tmp_path) -> None:
    """A law over its driver, with the readings behind it; what goes with the motion, over time."""
    x = np.linspace(0.0, 2.0, 41)
    sigma = np.full(41, 1e-3)
    over = Curve(x, 0.02 * x, sigma, "rad/s", "rad/s", np.stack([x, 0.02 * x], axis=1))
    law = Unnamed("gyro_z += k * |omega|", 0.02, 1e-3, "1", 100.0,
                  channels=("gyro_z",), drivers=("|omega|",), curve=over)  # fmt: skip
    course = Curve(30.0 * x, 0.02 * np.sin(x), sigma, "s", "rad/s")
    rest = replace(law, formula="gyro_xy += e(t) * |omega|", curve=course, story="It errs.")
    e = replace(fake_explanation("unexplained"), unnamed=(law, rest))
    dashboard.save_explanation_rrd(e, tmp_path / "x.rrd")
    found = rows(tmp_path / "x.rrd")
    assert {"/laws/1/law", "/laws/1/read", "/laws/1/scale"} <= set(found)
    assert found["/laws/2"] == len(course.x)
    assert "lead, not yet a cause" in verdict_text.lead(law)
    assert verdict_text.lead(rest) == ""
    assert words.over_what(rest) == "t"
    assert words.sized(rest).startswith("a size of")
    assert "over time" in plots.law_plot(rest, 1).caption
    assert "It errs." in printed(e)


def test_a_law_that_was_found_is_not_called_shown_but_not_found() -> None:
    e = fake_explanation("unexplained")
    formula = e.unnamed[0].formula
    rows = [Parameter(i, "k", 0.1, 0.001, "1", 0.1, None) for i in (formula, "accel_scale")]
    (said,) = [x for x in printed(replace(e, parameters=tuple(rows)), 2000).splitlines()
               if "but not found" in x]  # fmt: skip
    assert "accelerometer scale" in said
    assert formula not in said


def test_signs_of_a_formula_are_told_and_no_others() -> None:
    said = meanings(["gyro_x += k * (stick(0.1 rad/s) of omega_y - omega_y)"])
    assert "omega: " in said
    assert "stick( ) of x: what stays where it is" in said
    assert not {"f: ", "T: ", "memory( )"} & set(said.split("; "))
    assert all(word not in said for word in ("specific force", "temperature", "memory"))


def test_a_number_is_never_a_power_of_ten() -> None:
    assert plain(-991.4, 2) == "−990"
    assert plain(-1.3e-6, 2) == "−0.0000013"
    assert plain(0.0, 3) == "0"
    assert plain(47.04, 3) == "47.0"


def test_a_law_is_called_by_its_formula_and_what_goes_with_the_motion_too() -> None:
    k = Parameter("gyro_x += k * f_x", "k", "1", 1.0, 0.1, 1.0, None)
    assert parameter_title(k) == "k of gyro_x += k * f_x"
    memory = noise_title("gyro_xz_turning_memory")
    assert memory == "gyro_xz += e(t) * |omega|, memory"
    tau = noise_title("heading_correlated_noise_tau")
    assert tau == "Correlated heading noise, tau"

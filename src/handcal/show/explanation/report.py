"""The report on an explanation: one self-contained HTML page, read from top to bottom."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import handcal
from handcal import output
from handcal.explanation import Explanation, Hypothesis, Mismatch, Missing, Unnamed, is_curve
from handcal.show import words
from handcal.show.calibration.report import how_to_apply
from handcal.show.calibration.shown import BIASES, in_front, under_table
from handcal.show.drawing import PALETTE
from handcal.show.explanation import document, frames, plots, verdict_text
from handcal.show.explanation import words as say
from handcal.show.explanation.evidence_curves import effect_styles
from handcal.show.explanation.next_commands import applicable, beside, biases_of, commands
from handcal.show.explanation.symbols import meanings
from handcal.show.html_page import page
from handcal.types import Parameter
from handcal.units import Shown


def write_explanation_report(
    explanation: Explanation, path: str | Path, following: Sequence[str] = ()
) -> None:
    """Write the report as one HTML file; nothing in it needs a network. following: the commands
    that come next, as ``next_commands.commands`` makes them of what was typed."""
    output.write_text(path, render_explanation(explanation, following))


def render_explanation(explanation: Explanation, following: Sequence[str] = ()) -> str:
    """The page as a string."""
    return page("explain.html.j2", _context(explanation, following or commands(explanation)))


def _context(e: Explanation, following: Sequence[str]) -> dict[str, Any]:
    names = say.recording_names(e)
    styles = effect_styles(e)
    gains = [m.log_evidence_gain for m in e.missing if not say.is_always(m)]
    gains += [u.log_evidence_gain for u in e.unnamed]
    return {
        "names": words.listed(names) if names else "nothing",
        "version": handcal.__version__,
        "assumed": verdict_text.assumptions(e),
        "verdict": verdict_text.verdict(e),
        "facts": _facts(e),
        "mismatch": [_where(m, names) for m in frames.told_mismatch(e)],
        "missing": [_card(m, e, styles) for m in e.missing],
        "shares_note": verdict_text.shares_note(e),
        "unnamed": [_unnamed(u) for u in e.unnamed],
        "symbols": meanings([u.formula for u in e.unnamed]),
        "plots": plots.draw(e),
        "hypotheses": [_hypothesis(h, e) for h in frames.by_gain(e)],
        "residuals": _residuals(e),
        "log": _scores(e.before.log_evidence, e.after.log_evidence),
        "held_out": _held_out(e),
        "groups": _groups(e),
        "below": [*under_table(*in_front(e.parameters, _found(e))), *say.markers(e)],
        "one_model": say.one_model(e),
        "more_apart": not say.one_model(e) and max(gains, default=0.0) > say.gain(e),
        "untold": verdict_text.untold(e),
        "next_motion": [
            {"motion": n.motion.rstrip("."), "gain": say.nats(n.expected_gain),
             "promise": verdict_text.promise(n, e)}
            for n in e.next_motion
        ],
        "noise": [words.noise_line(n) for n in e.noise],
        "warnings": document.all_warnings(e),
        "apply": how_to_apply(applicable(e)),
        "biases_of": biases_of(e),
        "following": following,
        "beside": beside(following),
    }  # fmt: skip


def _unnamed(u: Unnamed) -> dict[str, Any]:
    """Something without a name."""
    return {
        "formula": u.formula, "amount": say.sized(u), "gain": say.nats(u.log_evidence_gain),
        "story": u.story, "lead": verdict_text.lead(u),
    }  # fmt: skip


def _where(m: Mismatch, names: Sequence[str]) -> dict[str, Any]:
    """A place where the baseline does not fit."""
    return {
        "channel": words.channel_title(m.channel), "time": say.interval(m), "when": m.when,
        "share": say.whole_percent(m.share), "width": _width(m.share),
        "recording": names[m.recording] if len(names) > 1 else "",
    }  # fmt: skip


def _facts(e: Explanation) -> list[tuple[str, str]]:
    seconds = sum(r.recording.duration_s for r in e.recordings)
    shown = sum(p.shown for p in document.final_parameters(e))
    return [
        (f"{seconds:.0f} s", f"in {words.counted(len(e.recordings), 'recording')}"),
        (f"{len(e.hypotheses)}", "effects tried, not to the end" if e.untried else "effects tried"),
        (f"{shown} of {len(document.final_parameters(e))}", "parameters shown"),
    ]


def _found(e: Explanation) -> list[str]:
    """Ids of the effects found."""
    return [m.effect for m in e.missing]


def _width(share: float) -> str:
    """Of a bar, in percent."""
    return f"{100 * min(max(share, 0.0), 1.0):.1f}" if math.isfinite(share) else "0"


def _row(p: Parameter, unit: Shown) -> dict[str, Any]:
    return {
        "title": words.parameter_title(p),
        "name": words.parameter_name(p) or p.name,
        "value": unit.value(p.value, p.sigma, sign=True),
        "sigma": unit.value(p.sigma, p.sigma),
        "prior": unit.value(p.prior_sigma),
        "unit": unit.unit,
        "shown": p.shown,
    }


def _card(m: Missing, e: Explanation, styles: dict[str, tuple[str, Any]]) -> dict[str, Any]:
    titles = say.members(m, e)
    return {
        "title": titles[0],
        "others": titles[1:],
        "colour": PALETTE[styles.get(m.effect, (plots.AFTER, ""))[0]],
        "probability": say.percent(m.probability),
        "weight": verdict_text.weight(m),
        "story": m.story,
        "motion": m.motion,
        "rows": [_row(p, unit) for p, unit in say.in_units(m.parameters)],
    }


def _hypothesis(h: Hypothesis, e: Explanation) -> dict[str, str]:
    said = {"named": "present", "set": "one of a set"}.get(h.verdict, "")
    return {"title": h.title, "alone": say.number(say.first(h)), "final": say.number(h.final),
            "expected": say.expected(h), "probability": say.probable(h, e),
            "verdict": said}  # fmt: skip


def _scores(before: float, after: float) -> dict[str, str]:
    by = say.number(after - before)
    return {"before": say.number(before), "after": say.number(after),
            "change": f"+{by}" if after > before else by}  # fmt: skip


def _residuals(e: Explanation) -> list[dict[str, str]]:
    """Residuals by channel, before and after, with the widths of their bars in percent."""
    old, new = e.before.residual_rms, e.after.residual_rms
    rows = []
    for channel in say.channels(old, new):
        pair = [m.get(channel, math.nan) for m in (old, new)]
        largest = max((v for v in pair if math.isfinite(v)), default=0.0)
        unit = say.channel_shown(channel, pair, small=True)
        shown = [unit.value(v, 0.1 * largest) for v in pair]
        widths = [_width(v / largest if largest > 0 else 0.0) for v in pair]
        rows.append({
            "channel": words.channel_title(channel), "before": shown[0], "after": shown[1],
            "unit": unit.unit, "change": say.change(*pair), "before_width": widths[0],
            "after_width": widths[1],
        })  # fmt: skip
    return rows


def _held_out(e: Explanation) -> dict[str, Any] | None:
    """None where there were none. The score alone: residuals depend on how much noise each
    model allows itself, and a baseline that lets the hand sway by metres has small ones."""
    if (h := e.held_out) is None:
        return None
    return {
        "sentence": verdict_text.held_out_sentence(e) or "",
        "score": _scores(h.log_score_before, h.log_score_after),
    }


def _groups(e: Explanation) -> list[dict[str, Any]]:
    """Parameters of the final model by effect, those of each recording after the shared: found
    effects first, but for biases, then others that are shown."""
    names, groups = say.recording_names(e), []
    titles = {m.effect: m.title.removesuffix(" error") for m in e.missing}
    shared = {(p.effect, p.name) for p in e.parameters}
    found = [*BIASES, *_found(e)]
    front = in_front(e.parameters, found)[0]
    front.sort(key=lambda p: found.index(p.effect) if p.effect in found else len(found))
    sections: list[tuple[str, Sequence[Parameter]]] = [("", front)]
    sections += [
        (names[i] if len(names) > 1 else "",
         tuple(p for p in r.parameters if (p.effect, p.name) not in shared))
        for i, r in enumerate(e.recordings)
    ]  # fmt: skip
    for recording, parameters in sections:
        for (effect, _), group in words.by_effect(parameters).items():
            if is_curve(effect):  # (its coefficients are in the JSON, for programs)
                continue
            unit = words.shown_group(group)
            groups.append({
                "title": titles.get(effect) or words.effect_title(effect), "unit": unit.unit,
                "recording": recording,
                "rows": [_row(p, unit) for p in group],
            })  # fmt: skip
    return groups

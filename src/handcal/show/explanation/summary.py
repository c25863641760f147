"""An explanation as JSON, as text in the terminal and as Markdown for the dashboard."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from handcal.estimate.chosen import document_of
from handcal.explain.explanation import (
    Explained,
    Explanation,
    Fit,
    HeldOut,
    Hypothesis,
    Mismatch,
    Missing,
    Unnamed,
)
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.explanation import sentences
from handcal.show.explanation import words as say
from handcal.types import EXPLANATION_SCHEMA, NoiseLevel, Parameter

if TYPE_CHECKING:
    from rich.console import Console

KEY = (
    "● present, ◐ one of a set that this motion cannot tell apart. Alone: over the baseline, "
    "which may call noise what it lacks; final: beside everything found, at the noise found with "
    "it; promised: what an effect of the usual size would gain."
)
TOP = 8  # hypotheses in the terminal; those found are shown in any case


def explanation_json(explanation: Explanation) -> dict[str, Any]:
    """The contract's ``explain --json``.

    With several recordings, ``parameters`` holds the shared ones, ``recordings`` the rest,
    and each mismatch says which ``recording`` it is of. ``hypotheses`` is more than promised:
    nats of each effect ``alone`` over the baseline, in the ``final`` model, and ``expected_gain``
    of one of the usual size.
    """
    e, several = explanation, len(explanation.recordings) > 1
    document: dict[str, Any] = {
        "schema": EXPLANATION_SCHEMA,
        "verdict": e.verdict,
        "mismatch": [_mismatch_json(m, several) for m in e.mismatch],
        "missing": [_missing_json(m) for m in e.missing],
        "hand": {"id": e.hand.id, "probability": summary.finite(e.hand.probability)},
        "unnamed": [_unnamed_json(u) for u in e.unnamed],
        "hypotheses": [_hypothesis_json(h) for h in e.hypotheses],
        "fit": {"before": _fit_json(e.before), "after": _fit_json(e.after)},
        "held_out": _held_out_json(e.held_out),
        "next_motion": [
            {"motion": n.motion, "separates": list(n.separates),
             "expected_gain": summary.finite(n.expected_gain)}
            for n in e.next_motion
        ],
        "parameters": [summary.parameter_json(p) for p in final_parameters(e)],
        "noise": _noise_json(e.noise),
        "untellable": summary.untellable_json(e.untellable),
        "model": {} if e.model is None else document_of(e.model),
        "warnings": all_warnings(e),
    }  # fmt: skip
    if e.covariance is not None:
        document |= summary.covariance_json(e.covariance, e.parameters, final_parameters(e))
    document |= summary.device_json(e.device)
    if e.untried:
        document["untried"] = list(e.untried)
    if several:
        document["recordings"] = [_recording_json(r) for r in e.recordings]
    elif e.recordings:
        only = e.recordings[0]
        document["recording"] = summary.recording_json(only.recording, only.assume)
    return document


def _mismatch_json(m: Mismatch, several: bool) -> dict[str, Any]:
    out = {
        "channel": m.channel, "from_s": summary.finite(m.from_s), "to_s": summary.finite(m.to_s),
        "share": summary.finite(m.share), "when": m.when,
    }  # fmt: skip
    return out | ({"recording": m.recording} if several else {})


def _hypothesis_json(h: Hypothesis) -> dict[str, Any]:
    return {
        "effect": h.effect, "alone": summary.finite(h.alone), "final": summary.finite(h.final),
        "expected_gain": summary.finite(h.expected),
        "probability": summary.finite(h.probability),
    }  # fmt: skip


def final_parameters(explanation: Explanation) -> list[Parameter]:
    """Of the final model, those of the recording itself among them if there is only one."""
    found = {(p.effect, p.name): p for p in explanation.parameters}
    if len(explanation.recordings) == 1:
        for p in explanation.recordings[0].parameters:
            found.setdefault((p.effect, p.name), p)
    return list(found.values())


def all_warnings(explanation: Explanation) -> list[str]:
    """What the readers repaired and what the explanation remarks, each once."""
    read = [w for r in explanation.recordings for w in r.recording.warnings]
    return list(dict.fromkeys((*read, *explanation.warnings)))


def _numbers(values: Mapping[str, float]) -> dict[str, float]:
    """The finite ones."""
    return {k: float(v) for k, v in values.items() if math.isfinite(v)}


def _kinds(values: Mapping[str, float]) -> dict[str, float]:
    return {words.kind_name(k): v for k, v in _numbers(values).items()}


def _missing_json(m: Missing) -> dict[str, Any]:
    return {
        "effect": m.effect,
        "probability": summary.finite(m.probability),
        "log_evidence_gain": summary.finite(m.log_evidence_gain),
        "indistinguishable_from": list(m.indistinguishable_from),
        "parameters": [
            {"name": p.name, "value": summary.finite(p.value), "sigma": summary.finite(p.sigma),
             "unit": p.unit}
            for p in m.parameters
        ],
        "story": m.story,
        "size": _numbers(m.size),
        "share": summary.finite(m.share),
        "held_out_gain": None if m.held_out_gain is None else summary.finite(m.held_out_gain),
    }  # fmt: skip


def _unnamed_json(u: Unnamed) -> dict[str, Any]:
    c = u.curve
    return {
        "formula": u.formula,
        "value": summary.finite(u.value),
        "sigma": summary.finite(u.sigma),
        "unit": u.unit,
        "log_evidence_gain": summary.finite(u.log_evidence_gain),
        "story": u.story,
        "channels": list(u.channels),
        "drivers": list(u.drivers),
        "constants": [
            {"name": p.name, "value": summary.finite(p.value), "sigma": summary.finite(p.sigma),
             "unit": p.unit}
            for p in u.constants
        ],
        "curve": {} if c is None else {
            "x": c.x.tolist(), "y": c.y.tolist(), "sigma": c.sigma.tolist(),
            "x_unit": c.x_unit, "y_unit": c.y_unit,
        },
    }  # fmt: skip


def _fit_json(fit: Fit) -> dict[str, Any]:
    return {
        "log_evidence": summary.finite(fit.log_evidence),
        "residual_rms": _numbers(fit.residual_rms),
        "nis": _kinds(fit.nis),
        "whiteness": _kinds(fit.whiteness),
    }


def _held_out_json(h: HeldOut | None) -> dict[str, Any]:
    """Empty where nothing was held out."""
    if h is None:
        return {}
    return {
        "log_score_before": summary.finite(h.log_score_before),
        "log_score_after": summary.finite(h.log_score_after),
        "residual_rms_before": _numbers(h.residual_rms_before),
        "residual_rms_after": _numbers(h.residual_rms_after),
    }


def _noise_json(noise: Sequence[NoiseLevel]) -> list[dict[str, Any]]:
    return [
        {"name": summary.NOISE_NAMES.get(n.name, n.name), "value": summary.finite(n.value),
         "unit": n.unit}
        for n in noise
    ]  # fmt: skip


def _recording_json(r: Explained) -> dict[str, Any]:
    return {
        "recording": summary.recording_json(r.recording, r.assume),
        "parameters": [summary.parameter_json(p) for p in r.parameters],
        "noise": _noise_json(r.noise),
    }


def print_explanation(
    explanation: Explanation, console: Console, following: Sequence[str] = ()
) -> None:
    """Verdict first, then what stands behind it; fits 80 columns, but for the commands that follow,
    which are to be copied."""
    _print_verdict(explanation, console)
    _print_found(explanation, console)
    _print_judged(explanation, console)
    if following:
        from rich.markup import escape

        _heading(console, "Next")
        for command in following:
            console.print(escape(command), soft_wrap=True, highlight=False)


def _line(console: Console, text: str, indent: int = 2, style: str = "", bullet: str = "") -> None:
    """Wrapped here: rich would break lines at no-break spaces."""
    from rich.markup import escape

    first, hang = " " * indent + bullet, " " * (indent + len(bullet))
    wrapped = textwrap.fill(text, console.width - 1, initial_indent=first,
                            subsequent_indent=hang, break_on_hyphens=False)  # fmt: skip
    console.print(escape(wrapped), style=style, highlight=False)


def _heading(console: Console, text: str) -> None:
    from rich.markup import escape

    console.print(f"\n[bold]{escape(text)}[/]")


def _print_verdict(e: Explanation, console: Console) -> None:
    from rich.markup import escape

    line, judged = partial(_line, console), sentences.verdict(e)
    colour = {"good": "green", "partly": "yellow", "poor": "red"}[judged.level]
    for r in e.recordings:
        console.print(
            f"[bold]{escape(r.recording.path)}[/]  {r.recording.duration_s:.1f} s at "
            f"{say.rate(r)}; {words.counted(len(r.rests), 'rest')}"
        )
    for assumed in sentences.assumptions(e):
        line(assumed, 0, "dim")
    console.print()
    line(judged.headline, 0, f"bold {colour}")
    for sentence in judged.sentences:
        line(sentence)


def _print_found(e: Explanation, console: Console) -> None:
    """Where the baseline does not fit, and what was found."""
    line, heading = partial(_line, console), partial(_heading, console)
    if e.mismatch:
        heading("Where the baseline does not fit")
        console.print(_mismatch_table(e))
    for m in e.missing:
        heading(f"Missing: {' or '.join(say.members(m, e))}")
        line(m.story)
        line(sentences.weight(m), style="dim")
        console.print(_missing_table(m))
    if e.unnamed:
        heading("Found outside the catalogue")
    for u in e.unnamed:
        line(u.formula, style="bold")
        line(f"{say.sized(u)}, gains {say.nats(u.log_evidence_gain)}")
        if drawn := say.sparkline(u):
            line(drawn)
        if u.story:
            line(u.story)


def _print_judged(e: Explanation, console: Console) -> None:
    """The evidence for it, and what is still open."""
    line, heading = partial(_line, console), partial(_heading, console)
    if e.hypotheses:
        heading("Evidence for each effect, nats")
        console.print(_hypothesis_table(e, TOP))
        if (rest := len(e.hypotheses) - len(_top(e, TOP))) > 0:
            line(f"and {rest} more that gained less alone", style="dim")
        line(KEY, style="dim")
    heading("How well the model fits" if say.one_model(e) else "Before and after")
    console.print(_fit_table(e))
    if untold := sentences.untold(e):
        heading("What this motion could not tell")
        for sentence in untold:
            line(sentence, bullet="• ")
    if e.next_motion:
        heading("What motion would tell")
        for n in e.next_motion:
            promise = f"{sentences.promise(n, e)} ({say.nats(n.expected_gain)} expected)"
            line(f"{n.motion.rstrip('.')}: {promise}.", bullet="• ")
    if warnings := all_warnings(e):
        heading("Warnings")
        for warning in warnings:
            line(warning, bullet="• ")


def _table(*columns: str) -> Any:
    """A table whose columns are right-justified where their name begins with ">"."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        justify: Any = "right" if name.startswith(">") else "left"
        table.add_column(name.lstrip(">*"), justify=justify, no_wrap=not name.startswith("*"))
    return table


def _mismatch_table(e: Explanation) -> Any:
    from rich.markup import escape

    several = len(e.recordings) > 1
    table = _table("channel", ">time", ">share", "*when", *(["*recording"] if several else []))
    names = say.recording_names(e)
    for m in e.mismatch:
        row = [say.channel_title(m.channel), say.interval(m), say.whole_percent(m.share), m.when]
        table.add_row(*map(escape, row + ([names[m.recording]] if several else [])))
    return table


def _missing_table(m: Missing) -> Any:
    table = _table("", ">value", ">± 1 sigma", "unit", "observable")
    for p, unit in say.in_units(m.parameters):
        value = unit.value(p.value, p.sigma, sign=True)
        seen = "[green]yes[/]" if p.observable else "[yellow]no[/]"
        name = words.parameter_title(p)
        table.add_row(f"  {name}", value, unit.value(p.sigma, p.sigma), unit.unit, seen)
    return table


def _top(e: Explanation, count: int) -> list[Any]:
    """Those found, and the best of the others."""
    ranked = sorted(e.hypotheses, key=lambda h: -h.alone)
    others = [h.effect for h in ranked if not h.verdict]
    kept = set(others[: max(count - (len(ranked) - len(others)), 3)])
    return [h for h in ranked if h.verdict or h.effect in kept]


def _hypothesis_table(e: Explanation, count: int) -> Any:
    from rich.markup import escape

    table = _table("", "effect", ">alone", ">final", ">promised", ">probability")
    styles = {"named": "bold green", "set": "yellow"}
    for h in _top(e, count):
        mark = {"named": "●", "set": "◐"}.get(h.verdict, "")
        row = (escape(h.title), say.number(h.alone), say.number(h.final), say.promised(h),
               say.percent(h.probability))  # fmt: skip
        table.add_row(mark, *row, style=styles.get(h.verdict, ""))
    return table


def fit_rows(e: Explanation) -> list[tuple[str, ...]]:
    """(what, before, after, unit, change) of evidence, held-out score and residuals."""
    before, after = e.before, e.after
    rows: list[tuple[str, ...]]
    rows = [("log evidence", say.number(before.log_evidence), say.number(after.log_evidence),
             "nats", _signed(say.gain(e)))]  # fmt: skip
    if (h := e.held_out) is not None and not say.one_model(e):
        scores = say.number(h.log_score_before), say.number(h.log_score_after)
        rows.append(("score on unseen data", *scores, "nats", _signed(sentences.held_out_gain(e))))
    for channel in say.channels(before.residual_rms, after.residual_rms):
        pair = [f.residual_rms.get(channel, math.nan) for f in (before, after)]
        unit = say.channel_shown(channel, pair, small=True)
        digits = 0.1 * max(v for v in (*pair, 0.0) if math.isfinite(v))
        shown = [unit.value(v, digits) for v in pair]
        change = say.change(*pair)
        rows.append((f"residual of {say.channel_title(channel)}", *shown, unit.unit, change))
    for kind in dict.fromkeys((*before.nis, *after.nis)):
        pair = [f.nis.get(kind, math.nan) for f in (before, after)]
        shown = [f"{v:.2f}" if math.isfinite(v) else "–" for v in pair]
        rows.append((f"NIS of {words.kind_title(kind)} (1 is right)", *shown, "", ""))
    return rows


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + say.number(value)


def _fit_table(e: Explanation) -> Any:
    if say.one_model(e):
        table = _table("", ">value", "unit")
        for what, _, value, unit, _ in fit_rows(e):
            table.add_row(what[:1].upper() + what[1:], value, unit)
        return table
    table = _table("", ">before", ">after", "unit", ">change")
    for what, *row in fit_rows(e):
        table.add_row(what[:1].upper() + what[1:], *row)
    return table


def explanation_markdown(explanation: Explanation) -> str:
    """The verdict with its numbers, for the dashboard's text panel."""
    e, judged = explanation, sentences.verdict(explanation)
    lines = [f"## {judged.headline}", "", *(f"{s}\n" for s in judged.sentences)]
    for m in e.missing:
        lines += [f"### {' or '.join(say.members(m, e))}", "", m.story, "", sentences.weight(m), "",
                  "| | value | ± 1 sigma | |", "|---|---:|---:|---|"]  # fmt: skip
        for p, unit in say.in_units(m.parameters):
            value, sigma = unit.value(p.value, p.sigma, sign=True), unit.value(p.sigma, p.sigma)
            lines.append(f"| {words.parameter_title(p)} | {value} | {sigma} | {unit.unit} |")
        lines.append("")
    for u in e.unnamed:
        gained = say.nats(u.log_evidence_gain)
        lines += ["### Outside the catalogue", "", f"`{u.formula}`", "",
                  f"{say.sized(u)}, gains {gained}", ""]  # fmt: skip
        lines += [u.story, ""] if u.story else []
    told = sentences.untold(e)
    told += [f"Next: {sentences.motion_phrase(n.motion)}." for n in e.next_motion]
    lines += ["### What could not be told", "", *(f"- {s}" for s in told), ""] if told else []
    lines += [f"- {w}" for w in all_warnings(e)]
    return "\n".join(lines)

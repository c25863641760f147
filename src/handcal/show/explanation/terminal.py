"""An explanation as text in the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from handcal.explanation import Explanation, Missing
from handcal.show import words
from handcal.show.calibration.shown import BIASES, in_front, under_table
from handcal.show.doubts import held_out_gain
from handcal.show.explanation import verdict_text
from handcal.show.explanation import words as say
from handcal.show.explanation.document import all_warnings
from handcal.show.explanation.frames import told_mismatch
from handcal.show.explanation.next_commands import beside
from handcal.show.explanation.symbols import meanings
from handcal.show.terminal import table

if TYPE_CHECKING:
    from rich.console import Console

NATS = "A nat is a natural logarithm of probability: 3 nats are odds of 20 to 1, 7 of 1,000 to 1."
KEY = (
    "● present, ◐ one of a set that this motion cannot separate. First: the gain when added to "
    "the baseline, whose noise may absorb other errors. Last: the gain when added to all that "
    "was found, at the noise of the final model. Expected: the gain of an effect of the usual "
    "size, present or not."
)
TOP = 8  # hypotheses in the terminal; those found are shown in any case


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
        if said := beside(following):
            _line(console, said)


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

    line, judged = partial(_line, console), verdict_text.verdict(e)
    colour = {"good": "green", "partly": "yellow", "poor": "red"}[judged.level]
    for r in e.recordings:
        console.print(
            f"[bold]{escape(r.recording.path)}[/]  {r.as_read.duration_s:.1f} s at "
            f"{r.as_read.rate_hz:.0f} Hz; {words.counted(len(r.rests), 'rest')}"
        )
    for assumed in verdict_text.assumptions(e):
        line(assumed, 0, "dim")
    console.print()
    line(judged.headline, 0, f"bold {colour}")
    for sentence in judged.sentences:
        line(sentence)


def _print_found(e: Explanation, console: Console) -> None:
    """Where the baseline does not fit, and what was found."""
    line, heading = partial(_line, console), partial(_heading, console)
    if told_mismatch(e):
        heading("Where the baseline does not fit")
        console.print(_mismatch_table(e))
    for m in e.missing:
        heading(f"Found: {' or '.join(say.members(m, e))}")
        line(m.story)
        line(verdict_text.weight(m), style="dim")
        console.print(_missing_table(m))
    if note := verdict_text.shares_note(e):
        line(note, style="dim")
    if e.unnamed:
        heading("Found outside the catalogue")
    for u in e.unnamed:
        line(u.formula, style="bold")
        line(say.sized(u))
        if drawn := say.sparkline(u):
            line(drawn)
        if u.story:
            line(u.story)
    if signs := meanings([u.formula for u in e.unnamed]):
        line(signs, style="dim")


def _print_judged(e: Explanation, console: Console) -> None:
    """The evidence for it, and what is still open."""
    line, heading = partial(_line, console), partial(_heading, console)
    if e.hypotheses:
        heading("What each effect gains, nats")
        line(NATS, style="dim")
        console.print(_hypothesis_table(e, TOP))
        if (rest := len(e.hypotheses) - len(_top(e, TOP))) > 0:
            line(f"and {rest} more that gained less when added first", style="dim")
        line(KEY, style="dim")
    for u in e.unnamed:
        line(f"{u.formula}: gains {say.nats(u.log_evidence_gain)}", bullet="• ")
    if any(r.parameters for r in e.recordings):
        heading("Biases in the final model")
        console.print(_bias_table(e))
    for told in _beside(e):
        line(told)
    heading("How well the model fits" if say.one_model(e) else "Before and after")
    console.print(_fit_table(e))
    if untold := verdict_text.untold(e):
        heading("What this motion could not show")
        for sentence in untold:
            line(sentence, bullet="• ")
    if e.next_motion:
        heading("Motions that would help")
        for n in e.next_motion:
            promise = f"{verdict_text.promise(n, e)} ({say.nats(n.expected_gain)} expected)"
            line(f"{n.motion.rstrip('.')}: {promise}.", bullet="• ")
    if warnings := all_warnings(e):
        heading("Warnings")
        for warning in warnings:
            line(warning, bullet="• ")


def _mismatch_table(e: Explanation) -> Any:
    from rich.markup import escape

    several = len(e.recordings) > 1
    rows = table("channel", ">time", ">share", "*when", *(["*recording"] if several else []))
    names = say.recording_names(e)
    for m in e.mismatch:
        row = [words.channel_title(m.channel), say.interval(m), say.whole_percent(m.share), m.when]
        rows.add_row(*map(escape, row + ([names[m.recording]] if several else [])))
    return rows


def _missing_table(m: Missing) -> Any:
    rows = table("", ">value", ">± 1 sigma", "unit", "shown")
    for p, unit in say.in_units(m.parameters):
        value = unit.value(p.value, p.sigma, sign=True)
        seen = "[green]yes[/]" if p.shown else "[yellow]no[/]"
        name = f"{m.title.removesuffix(' error')} {words.parameter_name(p)}".rstrip()
        rows.add_row(f"  {name}", value, unit.value(p.sigma, p.sigma), unit.unit, seen)
    return rows


def _beside(e: Explanation) -> list[str]:
    """What else is in the final model."""
    found = [*(m.effect for m in e.missing), *(u.formula for u in e.unnamed)]
    front, rest = in_front(e.parameters, found)
    others = dict.fromkeys(p.effect for p in front if p.effect not in (*BIASES, *found))
    names = words.listed([words.effect_title(i).lower() for i in others]) if others else ""
    also = f"Determined too, but not found (values in the JSON): {names}." if others else ""
    return [s for s in (also, *under_table(front, rest), *say.markers(e)) if s]


def _bias_table(e: Explanation) -> Any:
    from rich.markup import escape

    several = len(e.recordings) > 1
    rows = table("", ">value", ">± 1 sigma", "unit", *(["*recording"] if several else []))
    for name, r in zip(say.recording_names(e), e.recordings, strict=True):
        for p, unit in say.in_units(r.parameters):
            row = (words.parameter_title(p), unit.value(p.value, p.sigma, sign=True),
                   unit.value(p.sigma, p.sigma), unit.unit)  # fmt: skip
            rows.add_row(*row, *([escape(name)] if several else []))
    return rows


def _top(e: Explanation, count: int) -> list[Any]:
    """Those found, and the best of the others."""
    ranked = sorted(e.hypotheses, key=lambda h: -h.alone)
    others = [h.effect for h in ranked if not h.verdict]
    kept = set(others[: max(count - (len(ranked) - len(others)), 3)])
    return [h for h in ranked if h.verdict or h.effect in kept]


def _hypothesis_table(e: Explanation, count: int) -> Any:
    from rich.markup import escape

    rows = table("", "effect", ">first", ">last", ">expected", ">probability")
    styles = {"named": "bold green", "set": "yellow"}
    for h in _top(e, count):
        mark = {"named": "●", "set": "◐"}.get(h.verdict, "")
        row = (escape(h.title), say.number(say.first(h)), say.number(h.final), say.expected(h),
               say.probable(h, e))  # fmt: skip
        rows.add_row(mark, *row, style=styles.get(h.verdict, ""))
    return rows


def fit_rows(e: Explanation) -> list[tuple[str, ...]]:
    """(what, before, after, unit, change) of evidence, held-out score and residuals."""
    before, after = e.before, e.after
    rows: list[tuple[str, ...]]
    rows = [("log evidence", say.number(before.log_evidence), say.number(after.log_evidence),
             "nats", _signed(say.gain(e)))]  # fmt: skip
    if (h := e.held_out) is not None and not say.one_model(e):
        scores = say.number(h.log_score_before), say.number(h.log_score_after)
        rows.append(("score on held-out data", *scores, "nats", _signed(held_out_gain(e))))
    for channel in say.channels(before.residual_rms, after.residual_rms):
        pair = [f.residual_rms.get(channel, math.nan) for f in (before, after)]
        unit = say.channel_shown(channel, pair, small=True)
        digits = 0.1 * max(v for v in (*pair, 0.0) if math.isfinite(v))
        shown = [unit.value(v, digits) for v in pair]
        change = say.change(*pair)
        rows.append((f"residual of {words.channel_title(channel)}", *shown, unit.unit, change))
    for kind in dict.fromkeys((*before.nis, *after.nis)):
        pair = [f.nis.get(kind, math.nan) for f in (before, after)]
        shown = [f"{v:.2f}" if math.isfinite(v) else "–" for v in pair]
        rows.append((f"NIS of {words.kind_title(kind)} (1 expected)", *shown, "", ""))
    return rows


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + say.number(value)


def _fit_table(e: Explanation) -> Any:
    if say.one_model(e):
        rows = table("", ">value", "unit")
        for what, _, value, unit, _ in fit_rows(e):
            rows.add_row(what[:1].upper() + what[1:], value, unit)
        return rows
    rows = table("", ">before", ">after", "unit", ">change")
    for what, *row in fit_rows(e):
        rows.add_row(what[:1].upper() + what[1:], *row)
    return rows

"""An ``Explanation`` in the Rerun viewer: the verdict and what stands behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from handcal.explanation import Explained, Explanation, Hypothesis, Trace
from handcal.show import words
from handcal.show.dashboard import unnamed_laws
from handcal.show.dashboard.common import GREY, TIMELINE, XYZ, columns, lines, plot, save
from handcal.show.explanation import frames, verdict_text
from handcal.show.explanation import words as say
from handcal.show.explanation.document import all_warnings
from handcal.units import Shown

RECORDED = (150, 156, 166)
BEFORE, AFTER = XYZ[0], XYZ[2]
FOUND = (XYZ[2], XYZ[1], (205, 150, 225))
OTHERS = ((165, 125, 100), (105, 145, 130), (110, 125, 160), (145, 120, 155), (160, 150, 105),
          (130, 130, 130))  # fmt: skip
AMISS, RED = (245, 190, 90), (255, 120, 120)
CHANNELS = (XYZ[2], XYZ[0], XYZ[1], (205, 150, 225), (240, 225, 110), GREY)
BARS = 8
NAMES = ("recorded", "baseline", "final model")


def _span(r: Explained) -> tuple[float, float]:
    return float(r.recording.imu.t[0]), float(r.recording.imu.t[-1])


def _ranked(e: Explanation) -> list[Hypothesis]:
    """Those worth a bar: found, or with some evidence; three at the least."""
    ranked = frames.by_gain(e)
    return [h for n, h in enumerate(ranked) if n < 3 or h.verdict or h.alone >= 1.0][:BARS]


def _colours(e: Explanation) -> dict[str, tuple[int, int, int]]:
    """Bright for each effect that was found, muted for the others."""
    found = frames.found_effects(e)
    others = [h.effect for h in frames.by_gain(e) if not h.verdict]
    bright = {effect: FOUND[i % 3] for i, effect in enumerate(found)}
    return bright | {effect: OTHERS[i % 6] for i, effect in enumerate(others)}


def _unit(trace: Trace) -> Shown:
    return say.channel_shown(trace.channel, [float(np.abs(trace.recorded).max(initial=0.0))])


def _limit(trace: Trace) -> float:
    """Half the height of the plot of differences, in the shown unit."""
    both = np.abs([frames.missed(trace, m) for m in (trace.before, trace.after)])
    return _unit(trace).factor * 1.25 * max(float(np.quantile(both, 0.998)), 1.5 * trace.sigma)


def explanation_blueprint(explanation: Explanation) -> rrb.Blueprint:
    """Verdict and hypotheses on the left; for each recording its channels and its evidence."""
    e = explanation
    names = say.recording_names(e)
    text = rrb.TextDocumentView(origin="/verdict", name="Verdict")
    bars = rrb.BarChartView(
        origin="/hypotheses", name="Each effect, added first (1: 10 nats, 2: 100, 3: 1,000)",
        plot_legend=rrb.PlotLegend("LeftTop"),
    )  # fmt: skip
    pages: list[Any] = [_page(e, i, names[i]) for i in range(len(e.recordings))]
    if e.recordings and (drawn := unnamed_laws.views(e, _span(e.recordings[0]))):
        pages.append(rrb.Vertical(*drawn, name="What has no name"))
    left = rrb.Vertical(text, bars, row_shares=[3, 2])
    panels = (rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"))
    time_panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE)
    body = [left, rrb.Tabs(*pages, active_tab=0)] if pages else [left]
    shares = [2, 5] if pages else None
    return rrb.Blueprint(rrb.Horizontal(*body, column_shares=shares), *panels, time_panel)


def _page(e: Explanation, i: int, name: str) -> rrb.Horizontal:
    """A recording's channels, the worst first, and its evidence."""
    r = e.recordings[i]
    home, span = f"/recording_{i + 1}", _span(r)
    traces = frames.ranked_traces(e, i)
    views = [_channel(home, span, t) for t in traces]
    shown: list[Any] = [v for pair in views[:2] for v in pair]
    if len(views) > 2:
        others = [
            rrb.Vertical(*pair, name=words.channel_title(t.channel))
            for pair, t in zip(views[2:], traces[2:], strict=True)
        ]
        shown.append(rrb.Tabs(*others, active_tab=0))
    shares = [1] * (len(shown) - 1) + [2] if len(views) > 2 else None
    right = [
        plot(
            span,
            f"{home}/shortfall",
            "Nats lost by the baseline: worst channels",
            only=list(frames.lost(r))[:5],
        ),
        plot(
            span,
            f"{home}/evidence",
            "Nats gained by what was found, added up",
            corner="LeftTop",
        ),
    ]
    return rrb.Horizontal(
        *([rrb.Vertical(*shown, row_shares=shares)] if shown else []),
        rrb.Vertical(*right), name=name,
    )  # fmt: skip


def _channel(home: str, span: tuple[float, float], trace: Trace) -> tuple[Any, Any]:
    """Two views: simulated against recorded, and the difference with what is allowed."""
    title, limit = words.channel_title(trace.channel), _limit(trace)
    unit = _unit(trace).unit
    name = f"{title[:1].upper()}{title[1:]}, {unit}"
    key = "recorded − model"
    return (
        plot(span, f"{home}/simulated/{trace.channel}", name),
        plot(span, f"{home}/difference/{trace.channel}", f"{name}: {key}", legend=False,
             limits=(-limit, limit)),
    )  # fmt: skip


def _markdown(explanation: Explanation) -> str:
    """The verdict with its numbers, for the text panel."""
    e, judged = explanation, verdict_text.verdict(explanation)
    lines = [f"## {judged.headline}", "", *(f"{s}\n" for s in judged.sentences)]
    for m in e.missing:
        lines += [f"### {' or '.join(say.members(m, e))}", "", m.story, "",
                  verdict_text.weight(m), "",
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
    told = verdict_text.untold(e)
    told += [f"Next: {verdict_text.motion_phrase(n.motion)}." for n in e.next_motion]
    lines += (
        ["### What this motion could not show", "", *(f"- {s}" for s in told), ""] if told else []
    )
    lines += [f"- {w}" for w in all_warnings(e)]
    return "\n".join(lines)


def log_explanation(rec: rr.RecordingStream, explanation: Explanation) -> None:
    """Send a whole explanation, by columns."""
    e = explanation
    text = rr.TextDocument(_markdown(e), media_type="text/markdown")
    rec.log("/verdict", text, static=True)
    _log_hypotheses(rec, e)
    if e.recordings:
        unnamed_laws.log(rec, e)
    colours, found = _colours(e), frames.found_effects(e)
    formulas = {u.formula for u in e.unnamed}
    for i, r in enumerate(e.recordings):
        home = f"/recording_{i + 1}"
        for trace in r.traces:
            _log_trace(rec, home, trace, [
                (m.from_s, m.to_s) for m in frames.mismatches(e, i, trace.channel)
            ])  # fmt: skip
        loss = frames.lost(r)
        for n, channel in enumerate(loss):
            name, colour = words.channel_title(channel), CHANNELS[n % len(CHANNELS)]
            style = lines([name], [colour], 2.0 if n < 3 else 1.0, interpolation_mode="StepAfter")
            rec.log(f"{home}/shortfall/{channel}", style, static=True)
            s = r.shortfall[channel]
            columns(rec, f"{home}/shortfall/{channel}", r.bins, np.append(s, s[-1:]))
        for effect, gain in r.evidence.gain.items():
            entity = f"{home}/evidence/{rr.escape_entity_path_part(effect)}"
            named = effect if effect in formulas else say.title_of(effect, e)
            colour = RED if effect in formulas else colours.get(effect, GREY)
            style = lines([named], [colour], 2.5 if found or effect in formulas else 1.0)
            rec.log(entity, style, static=True)
            columns(rec, entity, r.evidence.t, gain)


def _log_hypotheses(rec: rr.RecordingStream, e: Explanation) -> None:
    """A bar each: log10(1 + nats), so that ten and ten thousand nats fit one picture.

    The highest at the right, where the legend is not.
    """
    colours = _colours(e)
    for n, h in enumerate(_ranked(e)):
        height = math.log10(1.0 + max(h.alone, 0.0)) if math.isfinite(h.alone) else 0.0
        colour = colours.get(h.effect, GREY)
        bar = rr.BarChart([height], abscissa=[-float(n)], widths=[0.8], color=colour)
        rec.log(f"/hypotheses/{h.effect}", bar, static=True)


def _log_trace(
    rec: rr.RecordingStream, home: str, trace: Trace, where: Sequence[tuple[float, float]]
) -> None:
    """Angles go on past half a turn instead of jumping."""
    factor, entity = _unit(trace).factor, f"{home}/simulated/{trace.channel}"
    differences = [frames.missed(trace, m) for m in (trace.before, trace.after)]
    recorded = np.unwrap(trace.recorded) if trace.unit == "rad" else trace.recorded
    value = np.column_stack([recorded, *(recorded - d for d in differences)])
    style = rr.SeriesLines(names=NAMES, colors=[RECORDED, BEFORE, AFTER], widths=[4.0, 1.5, 1.5])
    rec.log(entity, style, static=True)
    columns(rec, entity, trace.t, factor * value)
    entity = f"{home}/difference/{trace.channel}"
    rec.log(f"{entity}/model", lines(NAMES[1:], [BEFORE, AFTER], 1.5), static=True)
    columns(rec, f"{entity}/model", trace.t, factor * np.column_stack(differences))
    if trace.t.size:
        ends, band = trace.t[[0, -1]], factor * trace.sigma * np.array([[1.0, -1.0]] * 2)
        rec.log(f"{entity}/sigma", lines(["+1σ", "−1σ"], [GREY, GREY], 1.0), static=True)
        columns(rec, f"{entity}/sigma", ends, band)
    if where:  # a bar along the lower edge, with gaps between the stretches
        rec.log(f"{entity}/amiss", lines(["baseline does not fit"], [AMISS], 6.0), static=True)
        t = np.array([[a, b, b + 1e-3] for a, b in where]).ravel()
        y = np.tile([-0.97 * _limit(trace)] * 2 + [np.nan], len(where))
        order = np.argsort(t, kind="stable")
        columns(rec, f"{entity}/amiss", t[order], y[order])


def save_explanation_rrd(explanation: Explanation, path: str | Path) -> None:
    """Write the explanation as a file that ``rerun FILE.rrd`` opens, blueprint included."""
    plan = explanation_blueprint(explanation)
    save(path, plan, lambda rec: log_explanation(rec, explanation))

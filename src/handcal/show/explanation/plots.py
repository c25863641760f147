"""Figures of an ``Explanation``; how they are drawn is in ``drawing``.

One colour, one meaning: ink is what was recorded, orange the baseline, blue the final
one; what was found has a colour of its own in every figure, what was not is grey.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.explanation import Explanation, Hypothesis, Trace, Unnamed
from handcal.laws.law_effect import law_made
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.calibration.plots import sizes
from handcal.show.drawing import (
    GRID,
    INK,
    MISS,
    MUTED,
    RC,
    RED,
    SHADE,
    WIDE,
    WIDTH,
    XYZ,
    Plot,
    broken,
    canvas,
    envelope,
    gaps_of,
    legend,
    shade,
    svg,
    thin,
)
from handcal.show.explanation import words as say
from handcal.show.explanation.evidence_curves import effect_styles, evidence_plot
from handcal.show.explanation.frames import (
    by_gain,
    cells,
    lost,
    mismatches,
    missed,
    nothing_added,
    ranked_traces,
)
from handcal.types import Array
from handcal.units import Shown, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEFORE, AFTER = XYZ[0], XYZ[2]
# Height of a line of a label, in rows of a bar.
LINE_HIGH = 0.55
BARS = 16  # hypotheses in one figure
SHOWS = 10.0  # nats: a circle so far out is one to ask about


def trace_plot(explanation: Explanation, recording: int, trace: Trace, wide: bool = False) -> Plot:
    """Simulated against recorded, and below what is left of the difference."""
    unit = say.channel_shown(trace.channel, [float(np.abs(trace.recorded).max(initial=0.0))])
    where = [(m.from_s, m.to_s) for m in mismatches(explanation, recording, trace.channel)]
    width, height = (WIDE, 4.8) if wide else (WIDTH, 4.2)
    figure, (top, low) = canvas(2, height, width, ratios=(4, 5))
    shade((top, low), where, MISS)
    points = 900 if wide else 420
    k = thin(trace.t.size, points)
    one = say.one_model(explanation)
    r = explanation.recordings[recording]
    gaps, source = gaps_of(r.recording.imu.t), say.source(trace.channel, r)
    for value, style in _courses(trace, source, one):
        at, y = trace.t[k], unit.factor * value[k]
        if trace.unit == "rad":
            at, y = summary.gapped(at, y)
        top.plot(*broken(at, gaps, y), **style)
    band = unit.factor * trace.sigma
    low.axhspan(-band, band, color=MUTED, alpha=0.22, lw=0, zorder=1)
    differences = [unit.factor * missed(trace, m) for m in (trace.before, trace.after)]
    shown_lines = list(zip(differences, (BEFORE, AFTER), strict=True))
    for difference, colour in shown_lines[one:]:
        at, y = envelope(trace.t, difference, points)
        low.plot(*broken(at, gaps, y), color=colour, lw=1.1)
    size = max(float(np.quantile(np.abs(d), 0.995)) for d in differences)
    limit = 1.15 * max(size, 1.5 * band) or 1.0
    low.set_ylim(-limit, limit)
    top.set_ylabel(unit.unit)
    low.set_ylabel(f"{source.split()[-1].strip('()')} − model")
    for ax in (top, low):
        ax.locator_params(axis="y", nbins=5)
    figure.align_ylabels([top, low])
    legend(top)
    caption = _trace_caption(trace, differences, unit, one)
    if where:
        caption += " Shaded: where the baseline does not fit."
    name = f"trace-{recording}-{trace.channel}-{wide}"
    return Plot(_capital(words.channel_title(trace.channel)), caption, svg(figure, name))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _courses(trace: Trace, source: str, one: bool) -> Iterator[tuple[Array, dict[str, Any]]]:
    """What is drawn of a channel, with its style: the readings and what each model makes of it."""
    yield trace.recorded, {"color": INK, "lw": 3.6, "alpha": 0.3, "label": source}
    if one:
        yield trace.after, {"color": AFTER, "lw": 1.2, "label": "model"}
        return
    yield trace.before, {"color": BEFORE, "lw": 1.2, "label": "baseline"}
    yield trace.after, {"color": AFTER, "lw": 1.2, "ls": (0, (3, 2)), "label": "final model"}


def heat_plot(explanation: Explanation, recording: int) -> Plot | None:
    """Shortfall by channel and time; None where there is none to speak of."""
    from matplotlib.patches import Patch, Rectangle

    r = explanation.recordings[recording]
    if nothing_added(explanation) or r.bins.size < 2 or sum(lost(r).values()) < 1.0:
        return None
    bins, loss = cells(r)
    rows = say.channels(dict.fromkeys(r.shortfall, 0.0))
    largest = _largest(explanation)
    total = sum(lost(e)[c] for e in explanation.recordings for c in lost(e)) or 1.0

    def strength(nats: Array | float) -> Any:
        return np.log1p(np.clip(nats, 0, None) / 2.0) / math.log1p(largest / 2.0)

    figure, (ax,) = canvas(1, 1.25 + 0.27 * len(rows), WIDE)
    for row, channel in enumerate(rows):
        for start, end, nats in zip(bins[:-1], bins[1:], loss[channel], strict=True):
            if (alpha := float(strength(nats))) > 0.03:
                ax.add_patch(Rectangle((start, row - 0.42), end - start, 0.84, color=BEFORE,
                                       alpha=round(alpha, 2), linewidth=0))  # fmt: skip
        for m in mismatches(explanation, recording, channel):
            ax.add_patch(Rectangle((m.from_s, row - 0.46), m.to_s - m.from_s, 0.92, fill=False,
                                   edgecolor=INK, linewidth=1.1))  # fmt: skip
        share = lost(r)[channel] / total
        ax.text(1.008, row, say.whole_percent(share), transform=ax.get_yaxis_transform(),
                va="center", fontsize=10, color=INK if share >= 0.1 else MUTED)  # fmt: skip
    ax.set(xlim=(bins[0], bins[-1]), ylim=(len(rows) - 0.4, -0.6))
    ax.set_yticks(range(len(rows)), [words.channel_title(c) for c in rows])
    ax.grid(visible=False, axis="y")
    scale = _swatched(largest)
    swatches = [Patch(color=BEFORE, alpha=round(float(strength(v)), 2), lw=0) for v in scale]
    ax.legend(swatches, [f"{v:,.0f} nats" for v in scale], loc="lower right", ncols=4,
              bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handlelength=1.3)  # fmt: skip
    caption = (
        f"Nats that the baseline loses to the final model in each {bins[1] - bins[0]:.3g} s. "
        "Right: the share of each channel."
    )
    if explanation.mismatch:
        caption += " Framed: what is listed above."
    title = f"Mismatch{say.of_recording(recording, explanation) or ' by channel'}"
    return Plot(title, caption, svg(figure, f"heat-{recording}"))


def _largest(explanation: Explanation) -> float:
    """Nats of the strongest cell of all recordings' plots."""
    worst = (float(c.max()) for e in explanation.recordings
             if e.bins.size > 1 for c in cells(e)[1].values())  # fmt: skip
    return max(10.0, *worst)


def _swatched(largest: float) -> list[float]:
    """Nats of which the legend shows how strong they are drawn."""
    scale = [v for v in (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0) if v <= 1.01 * largest]
    return scale if len(scale) <= 4 else scale[-5::2]


def law_plot(u: Unnamed, number: int) -> Plot | None:
    """What has no name: how much it adds, over what drives it, with the readings behind it."""
    c = u.curve
    if c is None or len(c.x) < 3:
        return None
    figure, (ax,) = canvas(1, 3.4, share=False)
    unit, over = (shown(u, v.tolist()) for u, v in ((c.y_unit, c.y), (c.x_unit, c.x)))
    x = over.factor * c.x
    if len(c.behind):
        driver, read = (c.behind * [over.factor, unit.factor]).T
        ax.plot(driver, read, "o", color=INK, ms=3.2, alpha=0.45, lw=0,
                label="readings minus the rest of the model")  # fmt: skip
    below, above = (unit.factor * (c.y + n * c.sigma) for n in (-2.0, 2.0))
    ax.fill_between(x, below, above, color=RED, alpha=0.18, lw=0)
    what = "the error" if say.lawless(u) else "the law"
    ax.plot(x, unit.factor * c.y, color=RED, lw=2.0, label=f"{what}, ± 2 sigma")
    ax.axhline(0, color=MUTED, lw=0.8)
    drivers = say.over_what(u)
    ax.set(xlabel=f"{drivers}, {over.unit}" if over.unit else drivers, ylabel=unit.unit)
    legend(ax, 2)
    over_ = "over time, where it is largest" if say.lawless(u) else "over what drives it"
    law = law_made(u.made)
    if law is not None and len(u.channels) > 1:
        over_ += ", of the axis to which it adds most" if law.each else ", the same for each axis"
    added = f"how much of {felt}" if (felt := say.of_what(u)) else "what"
    caption = f"{', '.join(u.channels)}: {added} it reads in addition, {over_}."
    return Plot(u.formula, caption, svg(figure, f"law-{number}"))


def _trace_caption(trace: Trace, differences: Sequence[Array], unit: Shown, one: bool) -> str:
    """How far the models are off, in words; differences: of both, in the unit shown."""
    rms = [float(np.sqrt((d**2).mean())) for d in differences]
    shown = [unit.value(v / unit.factor, 0.1 * max(rms) / unit.factor) for v in rms]
    caption = f"The baseline is {shown[0]} {unit.unit} (rms) off, the final model {shown[1]}."
    if one or shown[0] == shown[1]:
        who = "The model is" if one else "Both models are"
        caption = f"{who} {shown[1]} {unit.unit} (rms) off."
    if trace.left_out:
        caption += f" Not drawn: {words.counted(trace.left_out, 'reading')} rejected as outliers."
    if not trace.before.any():
        caption += f" Shown relative to what the {'model' if one else 'baseline'} predicts."
    return caption


def hypothesis_plot(explanation: Explanation) -> Plot:
    """What each effect gains alone, beside what was found, and what it could have gained."""
    shown, styles = by_gain(explanation)[:BARS], effect_styles(explanation)
    terms = explanation.unnamed
    dot: dict[str, Any] = {"markersize": 6.5, "markeredgewidth": 1.6, "zorder": 4}
    names = [say.in_lines(u.formula) for u in terms]
    high = [max(1.0, LINE_HIGH * (name.count("\n") + 1) + 0.15) for name in names]
    high += [1.0] * len(shown)
    place = np.cumsum(high) - 0.5 * np.array(high)
    figure, (ax,) = canvas(1, 1.3 + 0.31 * sum(high))
    for row, u in zip(place, terms, strict=False):
        ax.plot(u.log_evidence_gain, row, "o", color=RED, markerfacecolor=SHADE, **dot)
    for row, h in zip(place[len(terms) :], shown, strict=True):
        colour = styles.get(h.effect, (MUTED, "-"))[0]
        bar: dict[str, Any] = {"color": colour, "alpha": 0.85 if h.verdict else 0.35}
        ax.barh(row, say.first(h), height=0.56, lw=0, **bar)
        ax.plot(h.final, row, "o", color=INK, markerfacecolor=SHADE, **dot)
        ax.plot([h.expected] * 2, [row - 0.36, row + 0.36], color=INK, lw=1.6, zorder=3)
        likely = say.probable(h, explanation).replace("over ", "> ").replace("under ", "< ")
        ax.text(1.015, row, likely, transform=ax.get_yaxis_transform(), va="center", fontsize=10,
                color=INK if h.verdict else MUTED)  # fmt: skip
    values = [v for h in shown for v in (h.alone, h.final, h.expected)]
    _nats_axis(ax, [*values, *(u.log_evidence_gain for u in terms)])
    ax.set_ylim(sum(high) + 0.1, -0.1)
    ax.set_yticks(place, [*names, *(h.title for h in shown)])
    ax.tick_params(axis="y", labelcolor=INK)
    ax.grid(visible=False, axis="y")
    inks = [RED] * len(terms) + [INK if h.verdict else MUTED for h in shown]
    for label, ink in zip(ax.get_yticklabels(), inks, strict=True):
        label.set_color(ink)
    ax.text(1.015, -0.45, "present?", transform=ax.get_yaxis_transform(), fontsize=10, color=MUTED)
    rest = len(explanation.hypotheses) - len(shown)
    caption = _hypotheses_caption(shown, rest)
    return Plot("Evidence for each effect", caption, svg(figure, "hypotheses"))


def _hypotheses_caption(shown: Sequence[Hypothesis], rest: int) -> str:
    """What is drawn of each effect; rest: how many are not."""
    caption = (
        "Bar: gain when added first, coloured if it was found. Circle: gain when added last, to "
        "all that was found; a long bar whose circle is near zero stands in for something else. "
        "Tick: gain of an error of the usual size in this motion. (Noise is fitted only together "
        "with the rest, so it has no bar and no tick.)"
    )
    if any(not h.verdict and h.final > SHOWS for h in shown):
        caption += (
            " Grey with its circle far out: in the final model, but it may be part of an error "
            "without a name (“present?” is the probability that it is an error of its own)."
        )
    if rest:
        which = "another effect" if rest == 1 else f"{rest} other effects"
        caption += f" Not drawn: {which}, which gained less when added first."
    return caption


def _nats_axis(ax: Any, values: Sequence[float]) -> None:
    """A horizontal axis that has room for few and for thousands of nats, of both signs."""
    ax.set_xscale("symlog", linthresh=10, linscale=0.6)
    values = [v for v in values if math.isfinite(v)]
    high, low = max(100.0, 1.6 * max(values)), max(min(-10.0, 1.3 * min(values)), -300.0)
    step = 1 if high < 2e4 else 2
    decades = [10.0**d for d in range(1, 12, step)]
    ticks = [-d for d in decades if -d >= low] + [0.0] + [d for d in decades if d <= high]
    ax.set_xticks(ticks, [say.number(v) if v else "0" for v in ticks])
    ax.minorticks_off()
    ax.grid(visible=True, axis="x")  # setting a scale forgets it
    ax.axvline(0, color=MUTED, lw=0.9)
    ax.set(xlim=(low, high), xlabel="nats (beyond ±10 on a logarithmic scale)")


def balance_plot(explanation: Explanation) -> Plot | None:
    """NIS and whiteness before and after, by kind of observation."""
    before, after = explanation.before, explanation.after
    kinds = [k for k in before.nis if k in after.nis]
    if not kinds:
        return None
    figure, axes = canvas(2, 1.7 + 0.62 * len(kinds), share=False)
    pairs: tuple[tuple[Mapping[str, float], Mapping[str, float]], ...] = (
        (before.nis, after.nis), (before.whiteness, after.whiteness),
    )  # fmt: skip
    one = say.one_model(explanation)
    for ax, (old, new) in zip(axes, pairs, strict=True):
        for row, kind in enumerate(kinds):
            was = math.nan if one else old.get(kind, math.nan)
            _dumbbell(ax, row, was, new.get(kind, math.nan))
        ax.set_ylim(len(kinds) - 0.4, -0.6)
        ax.set_yticks(range(len(kinds)), [words.kind_title(k) for k in kinds])
        ax.grid(visible=False, axis="y")
    nis = [v for m in pairs[0] for v in m.values() if math.isfinite(v) and v > 0]
    low, high = min(0.4, 0.8 * min(nis, default=1.0)), max(2.5, 1.25 * max(nis, default=1.0))
    axes[0].set_xscale("log")
    ticks = [v for v in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if low <= v <= high]
    axes[0].set_xticks(ticks, [f"{v:g}" for v in ticks])
    axes[0].minorticks_off()
    axes[0].grid(visible=True, axis="x")
    axes[0].axvline(1, color=INK, lw=1)
    axes[0].set(xlim=(low, high), xlabel="NIS per degree of freedom (1 expected)")
    axes[1].axvline(0, color=INK, lw=1)
    axes[1].set(xlim=(-1, 1), xlabel="lag-1 autocorrelation of innovations (0 expected)")
    caption = (
        "How large the innovations are against their predicted uncertainty, and how correlated "
        "from one to the next."
    )
    if not one:
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1,
                       handlelength=1.0, handletextpad=0.4)  # fmt: skip
        caption += " Both models at the final noise."
    return Plot("Are the innovations as large as predicted?", caption, svg(figure, "balance"))


def _dumbbell(ax: Axes, row: int, before: float, after: float) -> None:
    label = (("baseline", "final model") if row == 0 else ("_", "_"))  # fmt: skip
    ax.plot([before, after], [row, row], color=GRID, lw=3, zorder=2, solid_capstyle="round")
    dot: dict[str, Any] = {"linestyle": "none", "markersize": 8, "markeredgewidth": 0, "zorder": 3}
    ax.plot([before], [row], "D", color=BEFORE, label=label[0], **(dot | {"markersize": 7}))
    ax.plot([after], [row], "o", color=AFTER, label=label[1], **dot)


def parameter_plot(explanation: Explanation) -> Plot | None:
    """What was found, in units of what is usual, with one and three sigma."""
    found = [p for m in explanation.missing for p in m.parameters if p.prior_sigma > 0]
    if not any(math.isfinite(p.value) for p in found):
        return None
    figure = sizes(found, {e: c for e, (c, _) in effect_styles(explanation).items()})
    caption = "Thick: ±1 sigma; thin: ±3 sigma. Shaded: the prior (±1 sigma)."
    return Plot("Size of what was found", caption, svg(figure, "parameters"))


def draw(explanation: Explanation) -> dict[str, list[Plot]]:
    """All figures by section: "first" (the worst channel of each recording, wide), "traces"
    (others with a mismatch, or the next worst), "others", "heat", "evidence", "balance",
    "parameters", "laws"."""
    import matplotlib as mpl

    plots: dict[str, list[Plot]] = {"first": [], "traces": [], "others": [], "laws": []}
    with mpl.rc_context(RC):
        for r in range(len(explanation.recordings)):
            for rank, trace in enumerate(ranked_traces(explanation, r)):
                found = bool(mismatches(explanation, r, trace.channel))
                section = "first" if rank == 0 else "traces" if found or rank < 3 else "others"
                plot = trace_plot(explanation, r, trace, wide=rank == 0)
                title = plot.title + say.of_recording(r, explanation)
                plots[section].append(Plot(title, plot.caption, plot.svg))
        single: Sequence[tuple[str, Plot | None]] = (
            *(("laws", law_plot(u, n)) for n, u in enumerate(explanation.unnamed)),
            *(("heat", heat_plot(explanation, r)) for r in range(len(explanation.recordings))),
            ("evidence", hypothesis_plot(explanation) if explanation.hypotheses else None),
            ("evidence", evidence_plot(explanation)),
            ("balance", balance_plot(explanation)),
            ("parameters", parameter_plot(explanation)),
        )
        for section, plot_or_none in single:
            plots.setdefault(section, [])
            if plot_or_none is not None:
                plots[section].append(plot_or_none)
    return plots

"""Where in a recording the evidence for each effect came from, and the colour that each has.

A few curves share a panel. Many would hide each other, for the strongest sets the scale (38,000
nats of a magnetometer's iron beside 12 of a misalignment): then each effect has a panel of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from handcal.explanation import Explained, Explanation
from handcal.show import words
from handcal.show.drawing import (
    MUTED,
    PURPLE,
    RED,
    XYZ,
    Plot,
    canvas,
    shade,
    svg,
    thin,
)
from handcal.show.explanation import words as say
from handcal.show.explanation.frames import found_effects

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOUND = (XYZ[2], XYZ[1], PURPLE)
DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)))
OTHERS = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))
# Curves at most where little was found, those not found among them.
CURVES = 6
# Curves that one panel shows side by side; of more the smaller ones lie on the axis.
TOGETHER = 3
TITLE = "Where the evidence came from"
CAPTION = (
    "Log evidence of the final model over the same model without the effect, cumulated over the "
    "recording: where a curve climbs, the readings support the effect. (Noise and outliers have "
    "no curve.) Rests shaded."
)


def effect_styles(explanation: Explanation) -> dict[str, tuple[str, Any]]:
    """Colour and dashes of each effect that was found."""
    return {e: (FOUND[i % 3], DASHES[i // 3 % 3]) for i, e in enumerate(found_effects(explanation))}


def evidence_plot(explanation: Explanation) -> Plot | None:
    """Cumulated gain over time of what is in the final model: a panel for each recording, or, of
    many effects, for each effect."""
    each = [r for r in explanation.recordings if r.evidence.t.size and r.evidence.gain]
    if not each:
        return None
    styles = effect_styles(explanation)
    for i, u in enumerate(explanation.unnamed):
        styles[u.formula] = (RED, DASHES[i % 3])
    if len(styles) > TOGETHER:
        return _apart(explanation, each, styles)
    figure, axes = canvas(len(each), 0.9 + 2.9 * len(each) if len(each) > 1 else 4.4, share=False)
    for ax, r in zip(axes, each, strict=True):
        _together(ax, explanation, r, styles)
        if ax is axes[0]:
            ax.legend(loc="upper left", fontsize=9.5, borderaxespad=0.3, labelspacing=0.3)
        if len(each) > 1:
            ax.set_title(_name(explanation, r), color=MUTED, pad=4)
    return Plot(TITLE, CAPTION, svg(figure, "evidence"))


def _together(
    ax: Axes, explanation: Explanation, r: Explained, styles: dict[str, tuple[str, Any]]
) -> None:
    """The curves of one recording in one panel."""
    end = _ends(r)
    order = sorted(end, key=lambda e: (e not in styles, -end[e]))[: max(CURVES, len(styles))]
    others = [e for e in order if e not in styles]
    k = thin(r.evidence.t.size)
    for effect in sorted(order, key=lambda e: -end[e]):
        found = effect in styles
        colour, dashes = styles[effect] if found else (MUTED, OTHERS[others.index(effect) % 4])
        ax.plot(r.evidence.t[k], r.evidence.gain[effect][k], color=colour, linestyle=dashes,
                lw=2.0 if found else 1.0, label=_title(explanation, effect))  # fmt: skip
    shade([ax], r.rests)
    ax.axhline(0, color=MUTED, lw=0.8)
    ax.set_ylabel("nats gained")


def _apart(
    explanation: Explanation, each: Sequence[Explained], styles: dict[str, tuple[str, Any]]
) -> Plot:
    """A panel for each effect that was found, the one that gained most on top, with a curve for
    each recording."""
    gained: dict[str, float] = {}
    for r in each:
        for effect, end in _ends(r).items():
            if effect in styles:
                gained[effect] = gained.get(effect, 0.0) + end
    order = sorted(gained, key=lambda e: -gained[e])
    figure, axes = canvas(len(order), 0.7 + 1.05 * len(order))
    for ax, effect in zip(axes, order, strict=True):
        for r, dashes in zip(each, OTHERS * len(each), strict=False):
            if effect in r.evidence.gain:
                k = thin(r.evidence.t.size)
                ax.plot(r.evidence.t[k], r.evidence.gain[effect][k], color=styles[effect][0],
                        linestyle=dashes, lw=1.8, label=_name(explanation, r))  # fmt: skip
        if len(each) == 1:
            shade([ax], each[0].rests)
        ax.axhline(0, color=MUTED, lw=0.8)
        ax.locator_params(axis="y", nbins=3)
        ax.set_title(_title(explanation, effect), loc="left", fontsize=10, pad=3)
    if len(each) > 1:
        axes[0].legend(loc="upper left", fontsize=8.5, borderaxespad=0.3, labelspacing=0.2)
    caption = f"{CAPTION} Each effect has a scale of its own, nats."
    if len(each) > 1:
        caption = caption.replace(" Rests shaded.", " A curve for each recording.")
    return Plot(TITLE, caption, svg(figure, "evidence"))


def _ends(r: Explained) -> dict[str, float]:
    """What each effect gained over the whole recording, nats."""
    return {e: float(g[-1]) for e, g in r.evidence.gain.items()}


def _title(explanation: Explanation, effect: str) -> str:
    """What an effect, or a term without a name, is called."""
    titles = {h.effect: h.title for h in explanation.hypotheses}
    titles |= {u.formula: u.formula for u in explanation.unnamed}
    return titles.get(effect) or words.effect_title(effect)


def _name(explanation: Explanation, r: Explained) -> str:
    return say.recording_names(explanation)[explanation.recordings.index(r)]

"""What the dashboard shows, frame by frame and as a plan; nothing here draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handcal.show import words
from handcal.show.calibration import summary, verdict_text
from handcal.show.calibration.shown import drawn, in_front, under_table
from handcal.types import Array, Innovations, Parameter, Result
from handcal.units import Shown


@dataclass(frozen=True)
class Group:
    """The parameters of one effect: their columns, how they are shown, a range to plot."""

    effect: str
    title: str
    names: tuple[str, ...]
    columns: tuple[int, ...]
    shown: Shown
    range: tuple[float, float] | None


@dataclass(frozen=True)
class Kind:
    """One kind of observation: its channels, their unit as shown, factors (d,) to it, a range."""

    channels: tuple[str, ...]
    unit: str
    factor: Array
    range: tuple[float, float] | None


@dataclass(frozen=True)
class Layout:
    """What there will be to see, known before the first frame.

    span: first and last t of the plots, s, where known; text: Markdown.
    """

    groups: tuple[Group, ...]
    kinds: Mapping[str, Kind]
    heading: bool
    text: str
    span: tuple[float, float] | None = None


LIVE = "_The filter is running. Where the whole recording leads:_\n\n"


def layout_of(result: Result, live: bool = False) -> Layout:
    """The layout that suits a result, with ranges fitted to its numbers; live: and says so."""
    columns: dict[tuple[str, str], list[int]] = {}
    shown = {p.effect for p in drawn(result.parameters)}
    for c, p in ((c, p) for c, p in enumerate(result.parameters) if p.effect in shown):
        columns.setdefault((p.effect, p.unit), []).append(c)
    kinds = {kind: _kind(i) for kind, i in result.innovations.items() if i.t.size}
    groups = tuple(_group(result, effect, tuple(cs)) for (effect, _), cs in columns.items())
    span = (float(result.history.t[0]), float(result.history.t[-1]))
    text = (LIVE if live else "") + _markdown(result)
    return Layout(groups, kinds, result.observed_heading is not None, text, span)


def _kind(innovations: Innovations) -> Kind:
    units = words.residual_units(innovations)
    names = words.channel_labels(innovations.channels)
    channels = tuple(n or c for n, c in zip(names, innovations.channels, strict=True))
    unit = ", ".join(dict.fromkeys(u.unit for u in units))
    factor = np.array([u.factor for u in units])
    limit = summary.settled(innovations.residual * factor, innovations.sigma * factor)
    return Kind(channels, unit, factor, (-limit, limit))


def _group(result: Result, effect: str, columns: tuple[int, ...]) -> Group:
    parameters: list[Parameter] = [result.parameters[c] for c in columns]
    unit, h = words.shown_group(parameters), result.history
    late = h.t >= h.t[0] + 0.25 * (h.t[-1] - h.t[0])
    value, band = (a[late][:, columns] for a in (h.parameters, 3 * h.parameter_sigma))
    low, high = unit.factor * (value - band).min(), unit.factor * (value + band).max()
    margin = 0.15 * (high - low)
    limits = (float(low - margin), float(high + margin)) if high > low else None
    title = f"{words.effect_title(effect)}, {unit.unit}".rstrip(", ")
    return Group(effect, title, tuple(p.name for p in parameters), columns, unit, limits)


def _markdown(result: Result) -> str:
    judged = verdict_text.verdict(result)
    front, rest = in_front(result.parameters)
    lines = [f"## {judged.headline}", *judged.sentences, "", "| | value | ± 1 sigma | |",
             "|---|---:|---:|---|"]  # fmt: skip
    for group in words.by_effect(front).values():
        unit = words.shown_group(group)
        lines += [
            f"| {words.parameter_title(p)} | {unit.value(p.value, p.sigma, sign=True)} "
            f"| {unit.value(p.sigma, p.sigma)} | {unit.unit} |"
            for p in group
        ]
    lines += ["", *(f"{s}\n" for s in under_table(front, rest))]
    lines += [f"- {s}" for s in verdict_text.not_shown(result)]
    return "\n".join(lines)

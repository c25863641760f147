"""Figures of a ``Result``; how they are drawn is in ``drawing``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.calibration.shown import drawn
from handcal.show.drawing import (
    AXES,
    INK,
    MUTED,
    RC,
    SHADE,
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
from handcal.types import Array, Innovations, Parameter, Result
from handcal.units import DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _turning(result: Result) -> Plot:
    h = result.history
    k = thin(h.t.size)
    w, x, y, z = h.q_nb[k].T
    up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    figure, (ax,) = canvas(1, 3.6)
    t, up = broken(h.t[k], gaps_of(result.recording.imu.t), up)
    for i in range(3):
        ax.plot(t, DEG * np.arcsin(np.clip(up[:, i], -1, 1)), color=XYZ[i], label=AXES[i])
    ax.set(ylabel="elevation, deg", ylim=(-95, 95), yticks=[-90, -45, 0, 45, 90])
    shade([ax], result.rests)
    legend(ax)
    caption = "How far each axis of the device pointed above or below the horizon. Rests shaded."
    return Plot("How it was turned", caption, svg(figure, "turning"))


def _heading(result: Result) -> Plot:
    h = result.history
    figure, (ax,) = canvas(1, 3.6)
    if (seen := result.observed_heading) is not None:
        k = thin(len(seen), 350)
        dots: dict[str, Any] = {
            "color": XYZ[0],
            "linestyle": "none",
            "markeredgewidth": 0,
            "alpha": 0.6,
        }
        ax.plot(
            seen[k, 0], DEG * seen[k, 1], ".", markersize=4.5, zorder=3, label="measured", **dots
        )
    k = thin(h.t.size)
    curve = broken(h.t[k], gaps_of(result.recording.imu.t), DEG * h.yaw[k])
    ax.plot(*summary.gapped(*curve), color=XYZ[2], lw=1.8, label="estimated")
    ax.set(ylabel="heading, deg", ylim=(-190, 190), yticks=[-180, -90, 0, 90, 180])
    legend(ax)
    caption = "Heading of the device's x axis, counter-clockwise from east."
    if seen is None:
        caption += " No heading was measured: its zero is arbitrary."
    return Plot("Heading", caption, svg(figure, "heading"))


def _held_point(result: Result) -> Plot:
    h = result.history
    k = thin(h.t.size)
    figure, axes = canvas(2, 3.9)
    pairs = ((h.p_n, h.nav_sigma[:, :3], "position"), (h.v_n, h.nav_sigma[:, 3:6], "velocity"))
    gaps = gaps_of(result.recording.imu.t)
    for ax, (value, sigma, name) in zip(axes, pairs, strict=True):
        for i in range(3):
            t, centre, band = broken(h.t[k], gaps, 100 * value[k, i], 300 * sigma[k, i])
            ax.plot(t, centre, color=XYZ[i], label=("east", "north", "up")[i])
            ax.fill_between(t, centre - band, centre + band, color=XYZ[i], alpha=0.09, lw=0)
        ax.set_ylabel(f"{name}, {'cm' if name == 'position' else 'cm/s'}")
        _zoom(ax, 100 * value, 300 * sigma, h.t)
    legend(axes[0])
    caption = "Estimated movement of the held point, with ±3 sigma."
    return Plot("The held point", caption, svg(figure, "held"))


def _zoom(ax: Axes, value: Array, band: Array, t: Array) -> None:
    """Limits that show the settled part of a band, not the width of the prior at the start."""
    late = t > t[0] + 0.3 * (t[-1] - t[0])
    low, high = (value - band)[late].min(), (value + band)[late].max()
    middle = value[t > t[0] + 0.05 * (t[-1] - t[0])]
    width = high - low  # an early excursion may take as much room again, no more
    low, high = min(low, max(middle.min(), low - width)), max(high, min(middle.max(), high + width))
    margin = 0.08 * (high - low) or 1.0
    ax.set_ylim(low - margin, high + margin)


def _parameters(result: Result, effect: str, columns: Sequence[int]) -> Plot:
    h, group = result.history, [result.parameters[c] for c in columns]
    unit, k = words.shown_group(group), thin(result.history.t.size)
    figure, axes = canvas(len(group), max(1.0 + 1.05 * len(group), 2.8))
    gaps = gaps_of(result.recording.imu.t)
    for ax, p, c in zip(axes, group, columns, strict=True):
        value, band = unit.factor * h.parameters[:, c], 3 * unit.factor * h.parameter_sigma[:, c]
        colour = XYZ[AXES.index(p.name[0])] if p.name[0] in AXES else XYZ[2]
        t, middle, half = broken(h.t[k], gaps, value[k], band[k])
        ax.fill_between(t, middle - half, middle + half, color=colour, alpha=0.16, lw=0)
        ax.plot(t, middle, color=colour)
        ax.set_ylabel(f"{p.name}, {unit.unit}" if len(group) > 1 else unit.unit)
        _zoom(ax, value, band, h.t)
        ax.locator_params(axis="y", nbins=4)
    figure.align_ylabels(axes)
    title = words.effect_title(effect)
    unseen = [p.name for p in result.parameters if p.effect == effect and not p.shown]
    caption = "Estimate over time with its ±3 sigma band."
    if unseen:
        caption += f" Not shown by this motion: {', '.join(unseen)}."
    return Plot(title, caption, svg(figure, f"parameters-{columns[0]}"))


def _innovation(kind: str, i: Innovations, first: int) -> Plot:
    """Three channels from ``first`` on, as many as one figure holds."""
    units, channels = words.residual_units(i), i.channels[first : first + 3]
    labels = words.channel_labels(channels)
    figure, axes = canvas(len(channels), max(1.0 + 1.0 * len(channels), 3.4))
    k = thin(i.t.size, 350)
    outside = (np.abs(i.residual) > 3 * i.sigma)[:, first : first + 3]
    for c, (ax, label) in enumerate(zip(axes, labels, strict=True), first):
        unit, colour = units[c], XYZ[c % 3] if len(axes) > 1 else XYZ[2]
        band = 3 * unit.factor * i.sigma[:, c]
        shown: dict[str, Any] = {"linestyle": "none", "markersize": 4, "markeredgewidth": 0}
        ax.fill_between(i.t[k], -band[k], band[k], color=colour, alpha=0.13, lw=0)
        ax.plot(i.t[k], unit.factor * i.residual[k, c], ".", color=colour, alpha=0.75, **shown)
        ax.set_ylabel(f"{label}, {unit.unit}" if label else unit.unit)
        limit = summary.settled(i.residual[:, c], i.sigma[:, c]) * unit.factor
        ax.set_ylim(-limit, limit)
        ax.locator_params(axis="y", nbins=5)
    figure.align_ylabels(axes)
    caption = (
        f"Observed minus predicted, with the ±3 sigma the filter expects; "
        f"{100 * outside.mean():.1f}\u202f% lie outside (0.3\u202f% expected)."
    )
    title = f"Innovations: {words.kind_title(kind)}"
    if len(i.channels) > 3:
        title += ", " + channels[0].rpartition("_")[0].replace("_", " ")
    return Plot(title, caption, svg(figure, f"innovation-{kind}-{first}"))


def _nis(result: Result) -> Plot:
    kinds = [(k, i) for k, i in result.innovations.items() if i.t.size >= 5]
    figure, axes = canvas(len(kinds), 1.0 + 0.95 * len(kinds))
    for c, (ax, (kind, i)) in enumerate(zip(axes, kinds, strict=True)):
        window = min(max(i.t.size // 40, 5), 50)
        t, mean = summary.windowed_nis(i, window)
        low, high = summary.nis_band(window * len(i.channels))
        k = thin(t.size)
        ax.axhspan(low, high, color=SHADE, linewidth=0, zorder=0)
        ax.axhline(1.0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
        ax.plot(t[k], mean[k], color=XYZ[(c + 2) % 3])
        ax.set_yscale("log")
        bottom, top = min(mean.min() * 0.8, low * 0.7), max(mean.max() * 1.25, high * 1.4)
        ax.set_ylim(bottom, top)
        fine = [m * 10.0**e for e in range(-3, 6) for m in (1, 2, 5)]
        ticks = [v for v in fine if bottom <= v <= top]
        ticks = ticks if len(ticks) <= 4 else [v for v in ticks if f"{v:e}"[0] == "1"]
        ax.set_yticks(ticks, [f"{v:g}" for v in ticks])
        ax.minorticks_off()
        ax.set_title(words.kind_title(kind), color=MUTED, pad=3)
    caption = (
        "Normalised innovation squared per degree of freedom, a running mean: 1 means that errors "
        "are as large as expected. Shaded: where 95\u202f% should lie if neighbours are unlike."
    )
    return Plot("Consistency over time (NIS)", caption, svg(figure, "nis"))


def _raw(result: Result) -> Plot:
    imu = result.recording.imu
    figure, axes = canvas(2, 3.9)
    pairs = ((DEG * imu.gyro, "gyro, deg/s"), (imu.accel, "accelerometer, m/s²"))
    for ax, (value, label) in zip(axes, pairs, strict=True):
        for i in range(3):
            line: dict[str, Any] = {"color": XYZ[i], "label": AXES[i], "linewidth": 0.9}
            t, y = envelope(imu.t, value[:, i])
            ax.plot(*broken(t, gaps_of(imu.t), y), **line)
        ax.set_ylabel(label)
    figure.align_ylabels(axes)
    shade(axes, result.rests)
    legend(axes[0])
    caption = "Readings as recorded, before any correction. Detected rests shaded."
    return Plot("What the sensor read", caption, svg(figure, "raw"))


def sizes(parameters: Sequence[Parameter], colours: Mapping[str, str] | None = None) -> Figure:
    """Parameters with one (thick) and three sigma, each in what is usual for such a device;
    colours: of effects."""
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return _sizes(parameters, colours or {})


def _sizes(parameters: Sequence[Parameter], colours: Mapping[str, str]) -> Figure:
    known = [p for p in parameters if p.prior_sigma > 0.0 and np.isfinite(p.value)]
    groups = [(words.shown_group(group), group) for group in words.by_effect(known).values()]
    shown = [(p, unit) for unit, group in groups for p in group]
    figure, (ax,) = canvas(1, 1.2 + 0.36 * len(shown))
    ax.axvspan(-1, 1, color=SHADE, lw=0, zorder=0)
    ax.axvline(0, color=MUTED, lw=0.9)
    reach = 1.5
    for row, (p, unit) in enumerate(shown):
        colour = colours.get(p.effect, XYZ[2])
        value, sigma = p.value / p.prior_sigma, p.sigma / p.prior_sigma
        for times, weight in ((3, 1.6), (1, 4.5)):
            ax.plot([value - times * sigma, value + times * sigma], [row, row], color=colour,
                    lw=weight, alpha=0.9, solid_capstyle="butt")  # fmt: skip
        ax.plot(value, row, "o", color=colour, markersize=6, markeredgewidth=0)
        amount = f"{unit.value(p.value, p.sigma, sign=True)} ± {unit.value(p.sigma, p.sigma)}"
        ax.text(1.015, row, f"{amount} {unit.unit}".rstrip(), va="center", fontsize=10, color=INK,
                transform=ax.get_yaxis_transform())  # fmt: skip
        reach = max(reach, 1.1 * (abs(value) + 3 * sigma))
    ax.set(xlim=(-reach, reach), ylim=(len(shown) - 0.4, -0.6),
           xlabel="value, in what is usual for such a device")  # fmt: skip
    ax.set_yticks(range(len(shown)), [words.parameter_title(p) for p, _ in shown])
    ax.tick_params(axis="y", labelcolor=INK)
    ax.grid(visible=False, axis="y")
    return figure


def draw(result: Result) -> dict[str, list[Plot]]:
    """All figures by section: "parameters", "fit" and "motion"."""
    import matplotlib as mpl

    columns: dict[tuple[str, str], list[int]] = {}
    for p in drawn(result.parameters):
        columns.setdefault((p.effect, p.unit), []).append(result.parameters.index(p))
    with mpl.rc_context(RC):
        parameters = [
            _parameters(result, effect, cs[i : i + 3])
            for (effect, _), cs in columns.items()
            for i in range(0, len(cs), 3)
        ]
        fit: list[Plot] = []
        for kind, i in result.innovations.items():
            if i.t.size:
                fit += [_innovation(kind, i, c) for c in range(0, len(i.channels), 3)]
        if any(i.t.size >= 5 for i in result.innovations.values()):
            fit.append(_nis(result))
        motion: list[Callable[[Result], Plot]] = [_raw, _turning, _heading, _held_point]
        return {"parameters": parameters, "fit": fit, "motion": [f(result) for f in motion]}

"""Figures of a ``Result`` as inline SVG that follows the page's light or dark colours.

Each figure is drawn in a palette of marker colours which are then replaced by CSS
variables, so that one drawing serves both themes. The x, y, z colours are
Okabe-Ito's vermilion, green and blue.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from handcal import summary, words
from handcal.types import Array, Innovations, Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID, SHADE = "#1c2330", "#5b6472", "#d9dee5", "#e9edf2"
XYZ = ("#c44e00", "#00875f", "#0067b3")
PALETTE = {INK: "--ink", MUTED: "--muted", GRID: "--grid", SHADE: "--shade",
           XYZ[0]: "--x", XYZ[1]: "--y", XYZ[2]: "--z"}  # fmt: skip
AXES = ("x", "y", "z")
WIDTH = 6.6  # inches of 72 SVG units
POINTS = 420  # per line; a page of ten figures stays far below 1.5 MB
DEG = 180.0 / np.pi

_RC: Any = {
    "font.size": 11.0, "axes.labelsize": 11.0, "axes.titlesize": 11.0, "legend.fontsize": 10.5,
    "xtick.labelsize": 10.0, "ytick.labelsize": 10.0, "svg.fonttype": "none",
    "text.color": INK, "axes.labelcolor": MUTED, "axes.edgecolor": GRID, "axes.titlecolor": INK,
    "xtick.color": MUTED, "ytick.color": MUTED, "grid.color": GRID, "axes.grid": True,
    "axes.axisbelow": True, "grid.linewidth": 0.7, "axes.spines.top": False,
    "axes.spines.right": False, "axes.spines.left": False, "xtick.major.size": 0.0,
    "ytick.major.size": 0.0, "lines.linewidth": 1.3, "legend.frameon": False,
    "axes.titlelocation": "left", "axes.xmargin": 0.01, "path.simplify": True,
    "font.family": "DejaVu Sans",
}  # fmt: skip


@dataclass(frozen=True)
class Plot:
    """One figure of the report: heading, a caption in words, and the drawing."""

    title: str
    caption: str
    svg: str


def thin(n: int, points: int = POINTS) -> NDArray[np.int_]:
    """Indices of about ``points`` rows out of n, the last one among them."""
    if n <= points:
        return np.arange(n)
    return np.unique(np.linspace(0, n - 1, points).round().astype(int))


def envelope(t: Array, y: Array, points: int = 2 * POINTS) -> tuple[Array, Array]:
    """t (n,) and y (n,) thinned to the lowest and highest of each stretch, so no peak is lost."""
    n = t.size
    if n <= points:
        return t, y
    width = -(-n // (points // 2))
    rows = n // width * width
    block = y[:rows].reshape(-1, width)
    start = np.arange(0, rows, width)
    keep = np.sort(np.concatenate([start + block.argmin(1), start + block.argmax(1), [n - 1]]))
    return t[keep], y[keep]


def _figure(rows: int, height: float) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    figure.get_layout_engine().set(h_pad=0.03, w_pad=0.02, hspace=0.02)  # type: ignore[union-attr, call-arg]
    axes[-1].set_xlabel("time, s")
    return figure, list(axes)


def _svg(figure: Figure, name: str) -> str:
    """The drawing as an SVG element without fixed size, colours, names or addresses."""
    import matplotlib as mpl

    out = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "svg.id": None}):
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.S)
    svg = re.sub(r'\s(xmlns(:\w+)?|version)="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", svg)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.S)
    svg = re.sub(r' (d|x|y|transform)="[^"]*"', _short_numbers, svg)
    svg = svg.replace("'DejaVu Sans'", "var(--sans)").replace("<svg", '<svg role="img"', 1)
    for colour, variable in PALETTE.items():
        svg = svg.replace(colour, f"var({variable})")
    return re.sub(r"\n\s*", "\n", svg)


def _short_numbers(attribute: re.Match[str]) -> str:
    return re.sub(r"(\d\.\d)\d+", r"\1", attribute.group())


def _legend(ax: Axes, columns: int = 3) -> None:
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1,
              columnspacing=1.2, handlelength=1.4, handletextpad=0.5, markerscale=2)  # fmt: skip


def _rests(axes: Sequence[Axes], result: Result) -> None:
    for ax in axes:
        for start, end in result.rests:
            ax.axvspan(start, end, color=SHADE, linewidth=0, zorder=0)


def _turning(result: Result) -> Plot:
    h = result.history
    k = thin(h.t.size)
    w, x, y, z = h.q_nb[k].T
    up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    figure, (ax,) = _figure(1, 3.6)
    for i in range(3):
        ax.plot(h.t[k], DEG * np.arcsin(np.clip(up[:, i], -1, 1)), color=XYZ[i], label=AXES[i])
    ax.set(ylabel="elevation, deg", ylim=(-95, 95), yticks=[-90, -45, 0, 45, 90])
    _rests([ax], result)
    _legend(ax)
    caption = "How far each axis of the device pointed above or below the horizon. Rests shaded."
    return Plot("How it was turned", caption, _svg(figure, "turning"))


def _heading(result: Result) -> Plot:
    h = result.history
    figure, (ax,) = _figure(1, 3.6)
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
    ax.plot(*summary.gapped(h.t[k], DEG * h.yaw[k]), color=XYZ[2], lw=1.8, label="estimated")
    ax.set(ylabel="heading, deg", ylim=(-190, 190), yticks=[-180, -90, 0, 90, 180])
    _legend(ax)
    caption = "Heading of the device's x axis, counter-clockwise from east."
    if seen is None:
        caption += " No heading was measured: its zero is arbitrary."
    return Plot("Heading", caption, _svg(figure, "heading"))


def _held_point(result: Result) -> Plot:
    h = result.history
    k = thin(h.t.size)
    figure, axes = _figure(2, 3.9)
    pairs = ((h.p_n, h.nav_sigma[:, :3], "position"), (h.v_n, h.nav_sigma[:, 3:6], "velocity"))
    for ax, (value, sigma, name) in zip(axes, pairs, strict=True):
        for i in range(3):
            centre, band = 100 * value[k, i], 300 * sigma[k, i]
            ax.plot(h.t[k], centre, color=XYZ[i], label=("east", "north", "up")[i])
            ax.fill_between(h.t[k], centre - band, centre + band, color=XYZ[i], alpha=0.09, lw=0)
        ax.set_ylabel(f"{name}, {'cm' if name == 'position' else 'cm/s'}")
        _zoom(ax, 100 * value, 300 * sigma, h.t)
    _legend(axes[0])
    caption = "Estimated movement of the held point, with ±3 sigma."
    return Plot("The held point", caption, _svg(figure, "held"))


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
    figure, axes = _figure(len(group), max(1.0 + 1.05 * len(group), 2.8))
    for ax, p, c in zip(axes, group, columns, strict=True):
        value, band = unit.factor * h.parameters[:, c], 3 * unit.factor * h.parameter_sigma[:, c]
        colour = XYZ[AXES.index(p.name[0])] if p.name[0] in AXES else XYZ[2]
        ax.fill_between(
            h.t[k], (value - band)[k], (value + band)[k], color=colour, alpha=0.16, lw=0
        )
        ax.plot(h.t[k], value[k], color=colour)
        ax.set_ylabel(f"{p.name}, {unit.unit}" if len(group) > 1 else unit.unit)
        _zoom(ax, value, band, h.t)
        ax.locator_params(axis="y", nbins=4)
    figure.align_ylabels(axes)
    title = words.effect_title(effect)
    unseen = [p.name for p in group if not p.observable]
    caption = "Estimate over time with its ±3 sigma band."
    if unseen:
        caption += f" Not learnt from this motion: {', '.join(unseen)}."
    return Plot(title, caption, _svg(figure, f"parameters-{columns[0]}"))


def _innovation(kind: str, i: Innovations, first: int) -> Plot:
    """Three channels from ``first`` on, as many as one figure holds."""
    units, channels = words.residual_units(i), i.channels[first : first + 3]
    labels = words.channel_labels(channels)
    figure, axes = _figure(len(channels), max(1.0 + 1.0 * len(channels), 3.4))
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
    return Plot(title, caption, _svg(figure, f"innovation-{kind}-{first}"))


def _nis(result: Result) -> Plot:
    kinds = [(k, i) for k, i in result.innovations.items() if i.t.size >= 5]
    figure, axes = _figure(len(kinds), 1.0 + 0.95 * len(kinds))
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
    return Plot("Consistency over time (NIS)", caption, _svg(figure, "nis"))


def _raw(result: Result) -> Plot:
    imu = result.recording.imu
    figure, axes = _figure(2, 3.9)
    pairs = ((DEG * imu.gyro, "gyro, deg/s"), (imu.accel, "accelerometer, m/s²"))
    for ax, (value, label) in zip(axes, pairs, strict=True):
        for i in range(3):
            line: dict[str, Any] = {"color": XYZ[i], "label": AXES[i], "linewidth": 0.9}
            ax.plot(*envelope(imu.t, value[:, i]), **line)
        ax.set_ylabel(label)
    figure.align_ylabels(axes)
    _rests(axes, result)
    _legend(axes[0])
    caption = "Readings as recorded, before any correction. Detected rests shaded."
    return Plot("What the sensor read", caption, _svg(figure, "raw"))


def draw(result: Result) -> dict[str, list[Plot]]:
    """All figures by section: "parameters", "fit" and "motion"."""
    import matplotlib as mpl

    columns: dict[tuple[str, str], list[int]] = {}
    for c, p in enumerate(result.parameters):
        columns.setdefault((p.effect, p.unit), []).append(c)
    with mpl.rc_context(_RC):
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

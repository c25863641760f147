"""How every figure is drawn: inline SVG that follows the page's light or dark colours.

Each figure is drawn in a palette of marker colours which are then replaced by CSS
variables, so that one drawing serves both themes. The x, y, z colours are
Okabe-Ito's vermilion, green and blue.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from handcal.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID, SHADE = "#1c2330", "#5b6472", "#d9dee5", "#e9edf2"
MISS = "#fdf0dc"  # the ground where something is amiss
PURPLE, RED = "#8a4a9e", "#a3262f"
XYZ = ("#c44e00", "#00875f", "#0067b3")
PALETTE = {INK: "--ink", MUTED: "--muted", GRID: "--grid", SHADE: "--shade",
           XYZ[0]: "--x", XYZ[1]: "--y", XYZ[2]: "--z",
           MISS: "--partly-bg", PURPLE: "--w", RED: "--poor"}  # fmt: skip
AXES = ("x", "y", "z")
WIDTH = 6.6  # inches of 72 SVG units
WIDE = 13.6  # of a figure as wide as the page
GAP_S = 1.0  # nothing read for so long: whatever happened then is not known
POINTS = 420  # per line; a page of ten figures stays far below 1.5 MB

RC: Any = {
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


def gaps_of(t: Array) -> Array:
    """Gaps (g, 2), from and to, s, in which a sensor that reads at times t (n,) read nothing."""
    at = np.flatnonzero(np.diff(t) > GAP_S)
    return np.column_stack([t[at], t[at + 1]])


def broken(t: Array, gaps: Array, *values: Array) -> tuple[Array, ...]:
    """t (n,) and each of values (n, ...), with a NaN in each gap (g, 2), so that neither lines nor
    bands go on where nothing was read."""
    middle = gaps.mean(axis=1)
    middle = middle[(middle > t[0]) & (middle < t[-1])] if len(t) else middle[:0]
    at = np.searchsorted(t, middle)
    return np.insert(t, at, middle), *(np.insert(v, at, np.nan, axis=0) for v in values)


def canvas(
    rows: int, height: float, width: float = WIDTH, ratios: Sequence[float] | None = None,
    share: bool = True,
) -> tuple[Figure, list[Axes]]:  # fmt: skip
    """A figure of so many panels above each other, which share their time unless told."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=share, squeeze=False, height_ratios=ratios)[:, 0]
    figure.get_layout_engine().set(h_pad=0.03, w_pad=0.02, hspace=0.02)  # type: ignore[union-attr, call-arg]
    axes[-1].set_xlabel("time, s")
    return figure, list(axes)


def svg(figure: Figure, name: str) -> str:
    """The drawing as an SVG element without fixed size, colours, names or addresses."""
    import matplotlib as mpl

    out = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "svg.id": None}):
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    text = re.sub(r'\s(xmlns(:\w+)?|version)="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.S)
    text = re.sub(r' (d|x|y|transform)="[^"]*"', _short_numbers, text)
    text = text.replace("'DejaVu Sans'", "var(--sans)").replace("<svg", '<svg role="img"', 1)
    for colour, variable in PALETTE.items():
        text = text.replace(colour, f"var({variable})")
    return re.sub(r"\n\s*", "\n", text)


def _short_numbers(attribute: re.Match[str]) -> str:
    return re.sub(r"(\d\.\d)\d+", r"\1", attribute.group())


def legend(ax: Axes, columns: int = 3) -> None:
    """Above the panel, at its right."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1,
              columnspacing=1.2, handlelength=1.4, handletextpad=0.5, markerscale=2)  # fmt: skip


def shade(axes: Sequence[Axes], intervals: Iterable[Sequence[float]], colour: str = SHADE) -> None:
    """A coloured ground behind stretches of time (start, end), s."""
    for ax in axes:
        for start, end in intervals:
            ax.axvspan(start, end, color=colour, linewidth=0, zorder=0)

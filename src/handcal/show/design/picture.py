"""A picture of a set of poses: the device as it lies in each, seen from the south-east."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handcal.design.search import Design
from handcal.output import write_bytes
from handcal.show.design.words import attitude_of, elevations, instruction
from handcal.show.drawing import GRID, INK, MUTED, RC, SHADE, XYZ, Plot, svg
from handcal.types import Array, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PHONE = np.array([0.50, 1.00, 0.11])
COLUMNS = 4
EACH = 2.75
EYE_AZIMUTH, EYE_ELEVATION = math.radians(-68.0), math.radians(24.0)
WRAPPED = 34
# An axis that points so far away from the eye lies behind the device.
HIDDEN = -0.6
ENDINGS = (".png", ".svg", ".pdf")


def poses_plot(design: Design) -> Plot:
    """All poses in one drawing, for a page."""
    caption = "The arrow points up. Axes of the device: x to its right edge, y to its top, z out."
    return Plot("The poses", caption, svg(_figure(design), "design-poses"))


def save_picture(design: Design, path: Path) -> None:
    """Write the drawing. Errors: InputError where the ending is not one of ``ENDINGS``."""
    write_figure(lambda: _figure(design), path)


def write_figure(figure: Callable[[], Figure], path: Path) -> None:
    """Draw and write. Errors: InputError as ``save_picture``."""
    import matplotlib as mpl

    check_ending(path)
    out = io.BytesIO()
    with mpl.rc_context(RC):
        figure().savefig(out, format=path.suffix[1:].lower(), dpi=110, facecolor="white")
    write_bytes(path, out.getvalue())


def check_ending(path: Path) -> None:
    """Errors: InputError where a picture of that name cannot be written."""
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: a picture ends in {', '.join(ENDINGS)}.")


def _figure(design: Design) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    n = len(design.up)
    columns = min(COLUMNS, n)
    rows = -(-n // columns)
    with mpl.rc_context(RC):
        figure = Figure(figsize=(EACH * columns, 1.16 * EACH * rows), layout="constrained")
        figure.get_layout_engine().set(h_pad=0.12)  # type: ignore[union-attr, call-arg]
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax in axes:
            ax.set_axis_off()
            ax.set_aspect("equal")
            ax.set(xlim=(-0.95, 0.95), ylim=(-0.9, 0.95))
        for i, up in enumerate(design.up):
            _pose(axes[i], up)
            axes[i].set_title(_title(i, up), fontsize=10, color=INK, loc="center", y=1.0)
    return figure


def _title(i: int, up: Array) -> str:
    said = textwrap.wrap(f"{i + 1}: {instruction(up)}", WRAPPED)
    level = "   ".join(f"{a} {round(e)}°" for a, e in zip("xyz", elevations(up), strict=True))
    return "\n".join([*said, level.replace("-", "−")])


def _eye() -> Array:
    """Rows: right and up in the picture, and towards the eye, (3, 3) in n."""
    a, e = EYE_AZIMUTH, EYE_ELEVATION
    towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def _pose(ax: Axes, up: Array) -> None:
    from matplotlib.patches import Ellipse

    view = _eye()
    C = view @ attitude_of(up)
    ground = 1.7 * math.sin(EYE_ELEVATION)
    ax.add_patch(Ellipse((0.0, -0.05), 1.75, ground, facecolor=SHADE, edgecolor="none"))
    ax.plot([0.0, 0.0], [0.0, 0.86], color=MUTED, lw=1.0, zorder=1.5)
    ax.plot([0.0], [0.86], marker="^", color=MUTED, markersize=7, markeredgewidth=0)
    behind = [i for i in range(3) if C[2, i] < 0.0]
    for i in behind:
        _axis(ax, C, i, 1.8)
    _box(ax, C)
    for i in range(3):
        if i not in behind:
            _axis(ax, C, i, 4.0)


def _axis(ax: Axes, C: Array, i: int, order: float) -> None:
    """One axis of the device, from its face outward."""
    start = C[:2, i] * 0.5 * PHONE[i]
    end = C[:2, i] * (0.5 * PHONE[i] + 0.24)
    ax.annotate("", end, start, zorder=order, arrowprops={
        "arrowstyle": "-|>", "color": XYZ[i], "lw": 1.6, "shrinkA": 0, "shrinkB": 0,
        "mutation_scale": 9,
    })  # fmt: skip
    if C[2, i] < HIDDEN:
        return
    name = C[:2, i] * (0.5 * PHONE[i] + 0.34)
    ax.text(
        float(name[0]),
        float(name[1]),
        "xyz"[i],
        color=XYZ[i],
        ha="center",
        va="center",
        fontsize=10,
        zorder=5,
    )


def _box(ax: Axes, C: Array) -> None:
    """The faces turned to the eye, and on the screen its display with a mark at the top."""
    half = 0.5 * PHONE
    for i in range(3):
        for sign in (-1.0, 1.0):
            if sign * C[2, i] <= 1e-9:
                continue
            j, k = (i + 1) % 3, (i + 2) % 3
            face = [_corner(half, i, j, k, sign, a, b) for a, b in _ROUND]
            screen = i == 2 and sign > 0.0
            _polygon(ax, C, np.array(face), MUTED if i == 2 else INK)
            if screen:
                _polygon(ax, C, np.array(face) * [0.86, 0.93, 1.0], GRID)
                mark = np.array([[-0.25, 0.84], [0.25, 0.84], [0.25, 0.9], [-0.25, 0.9]])
                lid = np.c_[mark * half[:2], np.full(4, half[2])]
                _polygon(ax, C, lid, INK)


_ROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _corner(half: Array, i: int, j: int, k: int, sign: float, a: int, b: int) -> Array:
    out = np.empty(3)
    out[[i, j, k]] = sign * half[i], a * half[j], b * half[k]
    return out


def _polygon(ax: Axes, C: Array, corners: Array, colour: str) -> None:
    from matplotlib.patches import Polygon

    flat = corners @ C[:2].T
    ax.add_patch(Polygon(flat, closed=True, facecolor=colour, edgecolor=INK, lw=0.8, zorder=3))

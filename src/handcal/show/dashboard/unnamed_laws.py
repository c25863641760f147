"""What has no name, in the Rerun viewer: each law over what drives it, or over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from handcal import units
from handcal.explanation import Explanation, Unnamed
from handcal.show.dashboard.common import GREY, columns, lines, plot
from handcal.show.explanation import words as say
from handcal.types import Array

RED, PALE = (255, 120, 120), (190, 110, 110)
# Of a picture without axes: how wide and high it is, and what it shows of the band.
WIDTH, HEIGHT, SIGMAS = 160.0, 50.0, 2.0


def shown(e: Explanation) -> list[Unnamed]:
    """Laws of which there is a picture."""
    return [u for u in e.unnamed if u.curve is not None and len(u.curve.x) > 2]


def views(e: Explanation, span: tuple[float, float]) -> list[Any]:
    """A view of each law."""
    return [_view(u, f"/laws/{n}", span) for n, u in enumerate(shown(e), start=1)]


def log(rec: rr.RecordingStream, e: Explanation) -> None:
    """Send every law."""
    for n, u in enumerate(shown(e), start=1):
        if say.lawless(u):
            _log_course(rec, f"/laws/{n}", u, float(e.recordings[0].recording.imu.t[0]))
        else:
            _log_curve(rec, f"/laws/{n}", u)


def _units(u: Unnamed) -> tuple[units.Shown, units.Shown]:
    """Of what is added and of what drives it."""
    assert u.curve is not None
    c = u.curve
    return units.shown(c.y_unit, c.y.tolist()), units.shown(c.x_unit, c.x.tolist())


def _view(u: Unnamed, origin: str, span: tuple[float, float]) -> Any:
    unit, over = _units(u)
    name = f"{u.formula}: {unit.unit} over {say.over_what(u)}"
    if say.lawless(u):
        return plot(span, origin, name, legend=False)
    bounds = rrb.VisualBounds2D(
        x_range=(-0.1 * WIDTH, 1.1 * WIDTH), y_range=(-1.3 * HEIGHT, 1.3 * HEIGHT)
    )
    name = f"{name}, {over.unit}" if over.unit else name
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds)


def _log_course(rec: rr.RecordingStream, entity: str, u: Unnamed, start: float) -> None:
    assert u.curve is not None
    c, factor = u.curve, _units(u)[0].factor
    band = c.y[:, None] + SIGMAS * np.outer(c.sigma, [0.0, 1.0, -1.0])
    style = lines([u.formula, "+2 sigma", "-2 sigma"], [RED, PALE, PALE], 1.5)
    rec.log(entity, style, static=True)
    columns(rec, entity, start + c.x, factor * band)


def _log_curve(rec: rr.RecordingStream, entity: str, u: Unnamed) -> None:
    """A picture of its own scale, its numbers written at its edges."""
    assert u.curve is not None
    c, (unit, over) = u.curve, _units(u)
    band = c.y[:, None] + SIGMAS * np.outer(c.sigma, [1.0, -1.0])
    low, wide = float(c.x.min()), max(float(np.ptp(c.x)), 1e-300)
    high = max(float(np.abs(np.concatenate([band.ravel(), c.behind[:, 1]])).max()), 1e-300)

    def placed(x: Array, y: Array) -> Array:  # (down is positive there)
        return np.column_stack([(x - low) / wide * WIDTH, -y / high * HEIGHT])

    strips = [placed(c.x, c.y), placed(c.x, band[:, 0]), placed(c.x, band[:, 1])]
    strips.append(placed(c.x[[0, -1]], np.zeros(2)))
    drawn = rr.LineStrips2D(strips, colors=[RED, PALE, PALE, GREY], radii=[0.5, 0.2, 0.2, 0.15])
    rec.log(f"{entity}/law", drawn, static=True)
    if len(c.behind):
        at = placed(c.behind[:, 0], c.behind[:, 1])
        rec.log(f"{entity}/read", rr.Points2D(at, colors=[GREY], radii=[0.7]), static=True)
    ends = [f"{v * over.factor:.3g} {over.unit}".strip() for v in c.x[[0, -1]]]
    most = [f"{sign}{high * unit.factor:.2g} {unit.unit}" for sign in ("+", "-")]
    edges = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, -1.15 * HEIGHT], [0.0, 1.15 * HEIGHT]])
    said = rr.Points2D(edges, labels=[*ends, *most], colors=[GREY], radii=[0.1], show_labels=True)
    rec.log(f"{entity}/scale", said, static=True)

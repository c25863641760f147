"""A set of poses in the Rerun viewer: side by side, and one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from handcal.compiled import so3
from handcal.design.search import Design
from handcal.show.dashboard.common import GREY, device, save
from handcal.show.design.words import attitude_of, instruction
from handcal.types import Array

TIMELINE = "pose"
COLUMNS = 5
APART_M = 0.32


def save_poses_rrd(design: Design, path: str | Path) -> None:
    """Write the poses as a file that ``rerun FILE.rrd`` opens."""
    save(path, _blueprint(len(design.up)), lambda rec: _log(rec, design.up))


def _blueprint(n: int) -> rrb.Blueprint:
    eye = rrb.EyeControls3D(position=(0.10, -0.34, 0.18), look_target=(0, 0, 0), eye_up=(0, 0, 1))
    one = rrb.Spatial3DView(
        origin="/", contents=["/one/**"], name="One after the other", eye_controls=eye
    )
    middle = (0.0, -0.5 * APART_M * (-(-n // COLUMNS) - 1), 0.0)
    above = (0.0, middle[1] - 1.1, 1.0)
    every = rrb.Spatial3DView(
        origin="/", contents=["/all/**"], name="All poses",
        eye_controls=rrb.EyeControls3D(position=above, look_target=middle, eye_up=(0, 0, 1)),
    )  # fmt: skip
    text = rrb.TextDocumentView(origin="/instruction", name="How to lay it")
    panels = (rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"))
    side = rrb.Vertical(one, text, row_shares=[4, 1])
    views = rrb.Horizontal(side, every, column_shares=[2, 3])
    return rrb.Blueprint(views, *panels, rrb.TimePanel(state="collapsed", timeline=TIMELINE))


def _log(rec: rr.RecordingStream, up: Array) -> None:
    rec.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for i, u in enumerate(up):
        row, column = divmod(i, COLUMNS)
        place = (APART_M * (column - 0.5 * (COLUMNS - 1)), -APART_M * row, 0.0)
        entity = f"/all/{i + 1}"
        _static(rec, entity)
        rec.log(entity, _transform(u, place), static=True)
        rec.log(f"{entity}/number", rr.Points3D([[0, 0, 0]], labels=[str(i + 1)], radii=0.0005,
                colors=[GREY]), static=True)  # fmt: skip
        rec.set_time(TIMELINE, sequence=i + 1)
        rec.log("/one/device", _transform(u, (0.0, 0.0, 0.0)))
        rec.log("/instruction", rr.TextDocument(f"{i + 1}: {instruction(u)}"))
    _static(rec, "/one/device")
    rec.log("/one/up", rr.Arrows3D(vectors=[(0, 0, 0.13)], colors=[GREY], labels=["up"],
            radii=0.001), static=True)  # fmt: skip


def _transform(up: Array, place: tuple[float, float, float]) -> Any:
    w, x, y, z = so3.quaternion_of(attitude_of(up))
    return rr.Transform3D(translation=place, quaternion=rr.Quaternion(xyzw=[x, y, z, w]))


def _static(rec: rr.RecordingStream, entity: str) -> None:
    boxes, axes = device()
    rec.log(f"{entity}/box", boxes, static=True)
    rec.log(f"{entity}/axes", axes, static=True)

"""What the pages of the dashboard share: colours, plots, columns of numbers, files."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from handcal import output
from handcal.types import Array, HandcalError

APPLICATION = "handcal"
TIMELINE = "time"
# Okabe-Ito's vermilion, green, blue, light enough for the viewer's dark background
XYZ = ((240, 130, 60), (40, 190, 140), (80, 165, 240))
GREY = (140, 146, 156)
PHONE_M = (0.072, 0.150, 0.009)


def plot(
    span: tuple[float, float] | None, origin: str, name: str, legend: bool = True,
    limits: tuple[float, float] | None = None, only: Sequence[str] = (),
    corner: Literal["RightTop", "LeftTop"] = "RightTop", axis: Any = None,
) -> Any:  # fmt: skip
    """One time series; without a legend, which would list every band, the title says it.

    span: of the time shown, s; limits: of the values; only: some of what is below the
    origin; corner: of the legend; axis: of time, instead of a span.
    """
    if span:
        start, end = (rrb.TimeRangeBoundary.absolute(seconds=t) for t in span)
        axis = rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
    return rrb.TimeSeriesView(
        origin=origin, contents=[f"$origin/{o}" for o in only] or "$origin/**", name=name,
        axis_x=axis, axis_y=rrb.ScalarAxis(range=limits) if limits else None,
        plot_legend=rrb.PlotLegend(corner, visible=legend),
    )  # fmt: skip


def device() -> tuple[Any, Any]:
    """A phone in body axes, and the axes themselves."""
    sizes = [PHONE_M, (0.066, 0.140, 0.001)]
    centres = [(0, 0, 0), (0, 0, PHONE_M[2] / 2)]
    boxes = rr.Boxes3D(sizes=sizes, centers=centres, fill_mode="solid",
                       colors=[(70, 78, 92), (150, 175, 205)])  # fmt: skip
    arrows = rr.Arrows3D(vectors=0.11 * np.eye(3), colors=XYZ, labels=["x", "y", "z"], radii=0.0016)
    return boxes, arrows


def lines(
    names: Iterable[str], colours: Iterable[Sequence[int]], width: float = 1.5, **more: Any
) -> Any:
    """How the series of an entity are drawn."""
    names, colours = list(names), list(colours)
    return rr.SeriesLines(names=names, colors=colours, widths=[width] * len(names), **more)


def columns(rec: rr.RecordingStream, entity: str, t: Array, values: Array) -> None:
    """Send (k,) or (k, d) scalars of one entity at once; d series in one plot."""
    if t.size == 0:
        return
    table = np.asarray(values, dtype=float).reshape(t.size, -1)
    scalars = rr.Scalars.columns(scalars=table.ravel()).partition([table.shape[1]] * t.size)
    rec.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, duration=t)], columns=scalars)


def save(path: str | Path, plan: rrb.Blueprint, log: Callable[[rr.RecordingStream], None]) -> None:
    """Write what ``log`` sends as a file that ``rerun FILE.rrd`` opens, blueprint included."""
    try:
        with output.whole(path) as place, file_sink(place) as sink, begun() as rec:
            rec.set_sinks(sink, default_blueprint=plan)
            log(rec)
            rec.flush()
    except RuntimeError as error:  # rerun's word where memory or threads are short
        raise HandcalError(f"{path} could not be written: {error}.") from error


@contextlib.contextmanager
def begun() -> Iterator[rr.RecordingStream]:
    """A stream that is disconnected in the end, however that comes: left open, it would wait at
    the program's end for a reader."""
    rec = rr.RecordingStream(APPLICATION)
    try:
        yield rec
    finally:
        rec.disconnect()


@contextlib.contextmanager
def file_sink(path: str | Path) -> Iterator[Any]:
    """A sink that writes an .rrd file; in the block the stream is to be disconnected again.

    By way of a pipe: where a disk is full, rerun's own writer waits for ever, or ends early and
    does not say why. Errors: OSError.
    """
    if not Path("/dev/fd").is_dir():
        yield rr.FileSink(path)
        return
    file = open(path, "wb")  # noqa: SIM115 (closed by who writes it, who may be the last to go)
    reading, writing = os.pipe()
    problems: list[OSError] = []
    copies = threading.Thread(target=_copy, args=(reading, file, problems), daemon=True)
    copies.start()
    try:
        yield rr.FileSink(f"/dev/fd/{writing}")
    finally:
        os.close(writing)
    copies.join()
    if problems:
        raise problems[0]


def _copy(reading: int, file: IO[bytes], problems: list[OSError]) -> None:
    """From the pipe to the file, to the end even where the disk takes no more; closes both."""
    try:
        with file, open(reading, "rb", buffering=0) as pipe:
            while piece := pipe.read(1 << 16):
                try:
                    if not problems:
                        file.write(piece)
                        file.flush()
                except OSError as problem:
                    problems.append(problem)
    except OSError as problem:  # (what was still to be written when it is closed)
        problems.append(problem)

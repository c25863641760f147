"""A ``Result`` in the Rerun viewer, saved or streamed as the filter runs."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from handcal import output
from handcal.estimate.live import Frame
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.dashboard.common import (
    GREY,
    TIMELINE,
    XYZ,
    begun,
    columns,
    device,
    file_sink,
    lines,
    plot,
    save,
)
from handcal.show.frames import Group, Kind, Layout, layout_of
from handcal.show.viewer import viewer
from handcal.types import Array, HandcalError, Result
from handcal.units import DEG

NIS_WINDOW = 20  # updates
YAW = "/yaw"  # beside the kinds of observation, none of which has a slash


def _key(names: Sequence[str]) -> str:
    """What the colours mean, for a title: three colours, of x y z."""
    return "  (orange x, green y, blue z)" if len(names) == 3 else ""


def blueprint(layout: Layout) -> rrb.Blueprint:
    """Attitude and heading on the left, parameters in the middle, consistency on the right."""
    eye = rrb.EyeControls3D(
        position=(0.16, -0.27, 0.15), look_target=(0, 0, -0.01), eye_up=(0, 0, 1)
    )
    grid = rrb.LineGrid3D(visible=True, spacing=0.05)
    device = rrb.Spatial3DView(
        origin="/", contents=["/device/**", "/level/**"], name="Attitude",
        eye_controls=eye, line_grid=grid,
    )  # fmt: skip

    def parameters(g: Group, key: bool = True) -> Any:
        name = f"{g.title}, 3 sigma{_key(g.names)}" if key else g.title
        legend = not _key(g.names)
        return plot(layout.span, f"/parameters/{g.effect}", name, legend=legend, limits=g.range)

    def innovation(kind: str, k: Kind) -> Any:
        name = f"Innovation: {words.kind_title(kind)}, {k.unit}, 3 sigma{_key(k.channels)}"
        return plot(layout.span, f"/innovation/{kind}", name, legend=False, limits=k.range)

    bias = [g for g in layout.groups if g.effect in ("gyro_bias", "accel_bias")]
    other = [parameters(g, key=False) for g in layout.groups if g not in bias]
    right = [innovation(kind, k) for kind, k in layout.kinds.items()]
    if right:
        right.append(plot(layout.span, "/nis", "NIS per degree of freedom (1 expected), 95 % band"))
    heading = plot(layout.span, "/heading", "Heading, deg", limits=(-190.0, 190.0))
    text = rrb.TextDocumentView(origin="/summary", name="Result")
    readings = [plot(layout.span, "/imu/gyro", "Gyro, deg/s"),
                plot(layout.span, "/imu/accel", "Accelerometer, m/s²")]  # fmt: skip
    columns = [
        rrb.Vertical(device, heading, rrb.Tabs(text, *readings, active_tab=0), row_shares=[4, 3, 3])
    ]
    middle = [parameters(g) for g in bias] + ([rrb.Tabs(*other, active_tab=0)] if other else [])
    columns += [rrb.Vertical(*views) for views in (middle, right) if views]
    panels = (rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"))
    time_panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE)
    return rrb.Blueprint(rrb.Horizontal(*columns), *panels, time_panel)


def _colours(n: int) -> list[tuple[int, int, int]]:
    return [XYZ[i % 3] for i in range(n)] if n > 1 else [XYZ[2]]


def _dim(colours: Iterable[Sequence[int]]) -> list[tuple[int, ...]]:
    """Band lines: the same hue, darker; upper bounds of all, then lower bounds of all."""
    half = [tuple(int(0.55 * v) for v in c) for c in colours]
    return half + half


def _log_static(rec: rr.RecordingStream, layout: Layout) -> None:
    def static(entity: str, *what: Any) -> None:
        rec.log(entity, *what, static=True)

    static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    boxes, arrows = device()
    static("/device/box", boxes)
    static("/device/axes", arrows)
    level = rr.Arrows3D(vectors=[(0.1, 0, 0), (0, 0.1, 0)], origins=[(-0.15, -0.1, 0)] * 2,
                        colors=[GREY] * 2, labels=["east", "north"], radii=0.0007)  # fmt: skip
    static("/level", level)
    static("/summary", rr.TextDocument(layout.text, media_type="text/markdown"))
    static("/heading/estimated", lines(["estimated"], [XYZ[2]], 2.5))
    if layout.heading:
        dots = rr.SeriesPoints(names="measured", colors=XYZ[0], markers="circle", marker_sizes=1.0)
        static("/heading/measured", dots)
    for g in layout.groups:
        colours = _colours(len(g.columns))
        static(f"/parameters/{g.effect}/estimate", lines(g.names, colours, 2.0))
        bounds = [f"{n} {s}3σ" for s in "+−" for n in g.names]
        static(f"/parameters/{g.effect}/band", lines(bounds, _dim(colours), 0.8))
    for n, (kind, k) in enumerate(layout.kinds.items()):
        colours = _colours(len(k.channels))
        dots = rr.SeriesPoints(
            names=list(k.channels), colors=colours,
            markers=["circle"] * len(colours), marker_sizes=[1.2] * len(colours),
        )  # fmt: skip
        static(f"/innovation/{kind}/residual", dots)
        bounds = [f"{c} {s}3σ" for s in "+−" for c in k.channels]
        static(f"/innovation/{kind}/bounds", lines(bounds, _dim(colours), 1.0))
        static(f"/nis/{kind}", lines([words.kind_title(kind)], [XYZ[(n + 2) % 3]]))
    static("/nis/band", lines(["2.5 %", "97.5 %"], [GREY, GREY], 1.0))
    for entity in ("/imu/gyro", "/imu/accel"):
        static(entity, lines("xyz", XYZ, 1.0))


def _bounds(value: Array, sigma: Array) -> Array:
    """(..., 2 d): value + 3 sigma of all, then value - 3 sigma of all."""
    return np.concatenate([value + 3 * sigma, value - 3 * sigma], axis=-1)


def log_result(rec: rr.RecordingStream, result: Result) -> None:
    """Send a whole result, by columns; some tens of milliseconds for a minute of data."""
    layout, h = layout_of(result), result.history
    _log_static(rec, layout)
    quaternion = np.roll(h.q_nb, -1, axis=1)  # rerun has x y z w
    rec.send_columns(
        "/device", indexes=[rr.TimeColumn(TIMELINE, duration=h.t)],
        columns=rr.Transform3D.columns(quaternion=quaternion),
    )  # fmt: skip
    columns(rec, "/heading/estimated", *summary.gapped(h.t, DEG * h.yaw))
    if (seen := result.observed_heading) is not None:
        columns(rec, "/heading/measured", seen[:, 0], DEG * seen[:, 1])
    for g in layout.groups:
        value, sigma = (g.shown.factor * a[:, g.columns] for a in (h.parameters, h.parameter_sigma))
        columns(rec, f"/parameters/{g.effect}/estimate", h.t, value)
        columns(rec, f"/parameters/{g.effect}/band", h.t, _bounds(value, sigma))
    for kind, k in layout.kinds.items():
        i = result.innovations[kind]
        columns(rec, f"/innovation/{kind}/residual", i.t, k.factor * i.residual)
        band = _bounds(np.zeros_like(i.sigma), k.factor * i.sigma)
        columns(rec, f"/innovation/{kind}/bounds", i.t, band)
        columns(rec, f"/nis/{kind}", *summary.windowed_nis(i, NIS_WINDOW))
    if layout.kinds:
        columns(rec, "/nis/band", h.t[[0, -1]], np.tile(_nis_band(layout), (2, 1)))
    imu = result.recording.imu
    columns(rec, "/imu/gyro", imu.t, DEG * imu.gyro)
    columns(rec, "/imu/accel", imu.t, imu.accel)


def _nis_band(layout: Layout) -> tuple[float, float]:
    """The band of the kind with fewest channels, the widest."""
    return summary.nis_band(NIS_WINDOW * min(len(k.channels) for k in layout.kinds.values()))


def save_rrd(result: Result, path: str | Path) -> None:
    """Write the result as a file that ``rerun FILE.rrd`` opens, blueprint included."""
    save(path, blueprint(layout_of(result)), lambda rec: log_result(rec, result))


def stream(
    frames: Iterable[Frame],
    layout: Layout,
    sinks: Sequence[Any],
    speed: float = 1.0,
    watched: Callable[[], bool] = lambda: True,
) -> int:
    """Log frames as they come, ``speed`` times as fast as they happened (0: no waiting).

    ``sinks`` are rerun's (GrpcSink, FileSink). Ends early when ``watched`` says no.
    Returns the number of frames.
    """
    with begun() as rec:
        return _streamed(rec, frames, layout, sinks, speed, watched)


def _streamed(
    rec: rr.RecordingStream,
    frames: Iterable[Frame],
    layout: Layout,
    sinks: Sequence[Any],
    speed: float,
    watched: Callable[[], bool],
) -> int:
    plan = blueprint(layout)
    rec.set_sinks(*sinks, default_blueprint=plan)
    rec.send_blueprint(plan, make_active=True, make_default=True)
    _log_static(rec, layout)
    recent: dict[str, deque[float]] = {k: deque(maxlen=NIS_WINDOW) for k in layout.kinds}
    recent[YAW] = deque(maxlen=1)
    started, first, count = time.monotonic(), None, 0
    for frame in frames:
        first = frame.t if first is None else first
        if speed > 0:
            time.sleep(max(started + (frame.t - first) / speed - time.monotonic(), 0.0))
        if not watched():
            break
        rec.set_time(TIMELINE, duration=frame.t)
        _log_frame(rec, layout, frame, recent)
        count += 1
    _flush(rec, watched)
    return count


def _flush(rec: rr.RecordingStream, watched: Callable[[], bool]) -> None:
    """Until everything has arrived. Without a limit, this would wait for a closed viewer."""
    for _ in range(30):
        if not watched():
            return
        try:
            rec.flush(timeout_sec=2.0)
            return
        except RuntimeError as e:
            reason = e
    raise HandcalError(f"Not everything could be written or shown: {reason}.") from reason


def _log_frame(
    rec: rr.RecordingStream, layout: Layout, frame: Frame, recent: dict[str, deque[float]]
) -> None:
    quaternion = rr.Quaternion(xyzw=np.roll(frame.q_nb, -1))
    rec.log("/device", rr.Transform3D(quaternion=quaternion))
    if (last := recent[YAW]) and abs(frame.yaw - last[0]) > np.pi:  # a gap, not a stroke
        rec.set_time(TIMELINE, duration=frame.t - 1e-4)
        rec.log("/heading/estimated", rr.Scalars(np.nan))
        rec.set_time(TIMELINE, duration=frame.t)
    last.append(frame.yaw)
    rec.log("/heading/estimated", rr.Scalars(DEG * frame.yaw))
    if frame.heading is not None:
        rec.log("/heading/measured", rr.Scalars(DEG * frame.heading))
    for g in layout.groups:
        value, sigma = (
            g.shown.factor * a[list(g.columns)] for a in (frame.parameters, frame.sigma)
        )
        rec.log(f"/parameters/{g.effect}/estimate", rr.Scalars(value))
        rec.log(f"/parameters/{g.effect}/band", rr.Scalars(_bounds(value, sigma)))
    for o in frame.observed:
        k = layout.kinds[o.kind]
        band = _bounds(np.zeros_like(o.sigma), k.factor * o.sigma)
        rec.log(f"/innovation/{o.kind}/residual", rr.Scalars(k.factor * o.residual))
        rec.log(f"/innovation/{o.kind}/bounds", rr.Scalars(band))
        recent[o.kind].append(o.nis / len(k.channels))
        rec.log(f"/nis/{o.kind}", rr.Scalars(float(np.mean(recent[o.kind]))))
    if frame.observed:
        rec.log("/nis/band", rr.Scalars(_nis_band(layout)))
    if frame.gyro is not None:
        rec.log("/imu/gyro", rr.Scalars(DEG * frame.gyro))
    if frame.accel is not None:
        rec.log("/imu/accel", rr.Scalars(frame.accel))


def replay(
    frames: Iterable[Frame],
    layout: Layout,
    *,
    speed: float = 1.0,
    rrd: str | Path | None = None,
    show: bool = True,
    web: bool = False,
    port: int | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Stream frames as they come about: into a viewer, a file, or both at once.

    Returns when the person closes the viewer, which ends the stream too; the web viewer
    ends by Ctrl-C.
    """
    try:
        with contextlib.ExitStack() as stack:
            files = [stack.enter_context(output.whole(rrd))] if rrd else []
            sinks = [stack.enter_context(file_sink(place)) for place in files]
            _replay(frames, layout, speed, sinks, show, web, port, say)
    except RuntimeError as error:  # rerun's word where memory or threads are short
        raise HandcalError(f"Nothing more could be written or shown: {error}.") from error


def _replay(
    frames: Iterable[Frame], layout: Layout, speed: float, files: Sequence[Any], show: bool,
    web: bool, port: int | None, say: Callable[[str], None],
) -> None:  # fmt: skip
    if not show:
        stream(frames, layout, files, speed)
        return
    with viewer(web=web, port=port) as shown:
        if shown.web_url:
            say(f"watch at {shown.web_url} (Ctrl-C ends it)")
        sinks = [rr.GrpcSink(shown.url), *files]
        stream(frames, layout, sinks, speed, lambda: shown.process.poll() is None)
        shown.wait()

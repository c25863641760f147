"""A session as it goes: attitude, signals, estimates that close in, innovations with their gates,
hypotheses, and what is asked for. Timeline ``time``: seconds since the session began.

``/device`` and ``/asked`` (what the hand is to do), ``/imu``, ``/parameters/EFFECT``,
``/innovation/KIND``, ``/nis/KIND``, ``/hypotheses/EFFECT``, ``/guidance``.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from handcal import output
from handcal.compiled import so3
from handcal.show import words
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
)
from handcal.show.viewer import viewer
from handcal.types import Array, BoolArray, HandcalError, Innovations, Parameter
from handcal.units import DEG

# Updates whose NIS is averaged.
NIS_WINDOW = 20
# An innovation with a gate so many times as wide as usual is not drawn.
WILD = 20.0
# Readings that are drawn a second: a plot of a minute has no more columns than that.
DRAWN_HZ = 50.0
# Of the signals so much is shown, s: two or three turns; of innovations more, since there are but
# three a second.
SEEN_S, CHECKED_S = 30.0, 60.0
# The phone that shows what to do stands beside the one in the hand, m.
BESIDE_M = (0.22, 0.0, 0.0)


class SessionBoard:
    """Draws into a recording of rerun. last: of each kind of observation, until when it has been
    drawn, s; nis: its latest, per degree of freedom; usual: how large its sigmas are."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self.rec = rec
        self.last: dict[str, float] = {}
        self.nis: dict[str, deque[float]] = {}
        self.usual: dict[str, float] = {}
        self.groups: dict[str, tuple[str, float]] = {}
        self.kinds: list[str] = []
        self.effects: list[str] = []
        self.turn: dict[str, Any] = {}
        self.shown_text = ""
        self._static()
        self._send()

    def readings(self, t: Array, gyro: Array, accel: Array, C_nb: Array | None) -> None:
        """Readings (n, 3) at times t (n,) s, and the attitude at the last."""
        span = max(float(t[-1] - t[0]), 1e-3)
        step = max(1, int(len(t) / span / DRAWN_HZ)) if len(t) > 1 else 1
        columns(self.rec, "/imu/gyro", t[::step], DEG * gyro[::step])
        columns(self.rec, "/imu/accel", t[::step], accel[::step])
        if C_nb is not None:
            self.rec.set_time(TIMELINE, duration=float(t[-1]))
            q = so3.quaternion_of(C_nb[None])[0]
            self.rec.log("/device", rr.Transform3D(quaternion=rr.Quaternion(xyzw=np.roll(q, -1))))

    def estimates(self, t: float, parameters: Sequence[Parameter]) -> None:
        """What is known at t (s)."""
        self.rec.set_time(TIMELINE, duration=t)
        self._parameters(parameters)

    def updates(self, innovations: Mapping[str, Innovations]) -> None:
        """Innovations by kind, those that are new of them; t: s of the session."""
        for kind, i in innovations.items():
            fresh = i.t > self.last.get(kind, -math.inf)
            if fresh.any():
                self._innovations(kind, i, fresh)
                self.last[kind] = float(i.t[fresh][-1])

    def guidance(self, t: float, told: Mapping[str, Any]) -> None:
        """What is asked for at t (s): its words, and the phone that shows it."""
        self.rec.set_time(TIMELINE, duration=t)
        turn = told["turn"]
        text = f"## {turn['say']}\n\n{_bar(turn['done'])}\n\n{turn.get('hint', '')}\n\n"
        text += str(told.get("brought", ""))
        if text != self.shown_text:
            self.rec.log("/guidance", rr.TextDocument(text, media_type="text/markdown"))
            self.shown_text = text
        picture = turn.get("picture")
        if picture:
            C = np.array(picture["from"]).reshape(3, 3) @ _turned(picture, t)
            q = np.roll(so3.quaternion_of(C[None])[0], -1)
            where = rr.Transform3D(translation=BESIDE_M, quaternion=rr.Quaternion(xyzw=q))
            self.rec.log("/asked", where)

    def hypotheses(self, t: float, gains: Mapping[str, float]) -> None:
        """Nats for each leading hypothesis at t (s)."""
        self.rec.set_time(TIMELINE, duration=t)
        for effect, gain in gains.items():
            if effect not in self.effects:
                self.effects.append(effect)
                name = words.effect_title(effect)
                colour = XYZ[(len(self.effects) - 1) % 3]
                self.rec.log(f"/hypotheses/{effect}", lines([name], [colour], 2.5), static=True)
            self.rec.log(f"/hypotheses/{effect}", rr.Scalars(gain))

    def _parameters(self, parameters: Sequence[Parameter]) -> None:
        new = False
        by_effect: dict[str, list[Parameter]] = {}
        for p in parameters:
            by_effect.setdefault(p.effect, []).append(p)
        for effect, some in by_effect.items():
            if effect not in self.groups:
                new = True
                unit = words.shown_group(some)
                title = f"{words.effect_title(effect)}, {unit.unit}".rstrip(", ")
                self.groups[effect] = (title, unit.factor)
                self._style(effect, [p.name for p in some])
            factor = self.groups[effect][1]
            value = factor * np.array([p.value for p in some])
            sigma = 3.0 * factor * np.array([p.sigma for p in some])
            self.rec.log(f"/parameters/{effect}/estimate", rr.Scalars(value))
            band = np.concatenate([value + sigma, value - sigma])
            self.rec.log(f"/parameters/{effect}/band", rr.Scalars(band))
        if new:
            self._send()

    def _style(self, effect: str, names: Sequence[str]) -> None:
        colours = [XYZ[i % 3] for i in range(len(names))]
        dim = [tuple(int(0.55 * v) for v in c) for c in colours] * 2
        self.rec.log(f"/parameters/{effect}/estimate", lines(names, colours, 2.0), static=True)
        bounds = [f"{n} {s}3σ" for s in "+−" for n in names]
        self.rec.log(f"/parameters/{effect}/band", lines(bounds, dim, 0.8), static=True)

    def _innovations(self, kind: str, i: Innovations, fresh: BoolArray) -> None:
        if kind not in self.kinds:
            self.kinds.append(kind)
            n = len(i.channels)
            dots = rr.SeriesPoints(
                names=list(i.channels), colors=[XYZ[k % 3] for k in range(n)],
                markers=["circle"] * n, marker_sizes=[1.2] * n,
            )  # fmt: skip
            self.rec.log(f"/innovation/{kind}/residual", dots, static=True)
            gate = [GREY] * (2 * n)
            names = [f"{c} {s}3σ" for s in "+−" for c in i.channels]
            self.rec.log(f"/innovation/{kind}/gate", lines(names, gate, 1.0), static=True)
            self.rec.log(f"/nis/{kind}", lines([words.kind_title(kind)], [XYZ[2]]), static=True)
            self._send()
        factor = np.array([u.factor for u in words.residual_units(i)])
        t, latest = i.t[fresh], self.nis.setdefault(kind, deque(maxlen=NIS_WINDOW))
        size = i.sigma[fresh].max(axis=1)
        self.usual[kind] = min(self.usual.get(kind, math.inf), float(np.median(size)))
        # (the first ones, before anything is known, would make the others invisible)
        tame = size < WILD * self.usual[kind]
        columns(self.rec, f"/innovation/{kind}/residual", t[tame], factor * i.residual[fresh][tame])
        sigma = 3.0 * factor * i.sigma[fresh][tame]
        columns(self.rec, f"/innovation/{kind}/gate", t[tame], np.hstack([sigma, -sigma]))
        means = []
        for nis in i.nis[fresh] / i.residual.shape[1]:
            latest.append(float(nis))
            means.append(float(np.mean(latest)))
        columns(self.rec, f"/nis/{kind}", t, np.array(means))

    def _static(self) -> None:
        def static(entity: str, *what: Any) -> None:
            self.rec.log(entity, *what, static=True)

        static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        boxes, arrows = device()
        static("/device/box", boxes)
        static("/device/axes", arrows)
        static("/asked/box", boxes)
        static("/asked", rr.Transform3D(translation=BESIDE_M))
        static("/asked/name", rr.Points3D([(0, 0, 0.09)], labels=["do this"], radii=0.0005))
        for entity in ("/imu/gyro", "/imu/accel"):
            static(entity, lines("xyz", XYZ, 1.0))
        start = rr.TextDocument("## Waiting for readings", media_type="text/markdown")
        self.rec.set_time(TIMELINE, duration=0.0)
        self.rec.log("/guidance", start)  # (what is static would stand before all that follows)

    def _send(self) -> None:
        """The arrangement, for what there is to see by now."""
        plan = blueprint(self.groups, self.kinds)
        self.rec.send_blueprint(plan, make_active=True, make_default=True)


def up_to_now(lately_s: float | None = None) -> Any:
    """An axis of time up to where the session is: its last seconds, or all of it."""
    boundary = rrb.TimeRangeBoundary
    begin = boundary.absolute(seconds=0.0)
    if lately_s is not None:
        begin = boundary.cursor_relative(seconds=-lately_s)
    return rrb.TimeAxis(
        view_range=rrb.TimeRange(start=begin, end=boundary.cursor_relative(seconds=0.0))
    )


def blueprint(
    groups: Mapping[str, tuple[str, float]] | None = None, kinds: Sequence[str] = ()
) -> rrb.Blueprint:
    """Guidance and attitude on the left, estimates in the middle, signals and checks on the
    right."""
    eye = rrb.EyeControls3D(
        position=(0.25, -0.42, 0.25), look_target=(0.11, 0, -0.01), eye_up=(0, 0, 1)
    )
    attitude = rrb.Spatial3DView(
        origin="/", contents=["/device/**", "/asked/**"],
        name="In the hand, and what to do", eye_controls=eye,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.05),
    )  # fmt: skip
    guidance = rrb.TextDocumentView(origin="/guidance", name="What to do next")
    left = rrb.Vertical(guidance, attitude, row_shares=[2, 5])
    axes = "3 sigma (orange x, green y, blue z)"
    shown = [
        plot(None, f"/parameters/{e}", f"{title}, {axes}", False, axis=up_to_now())
        for e, (title, _) in (groups or {}).items()
    ]
    first, more = shown[:4], shown[4:]
    middle = first + ([rrb.Tabs(*more, active_tab=0)] if more else [])
    checks = [
        plot(
            None,
            f"/innovation/{k}",
            f"Innovation: {words.kind_title(k)}, 3 sigma",
            False,
            axis=up_to_now(CHECKED_S),
        )
        for k in kinds
    ]
    nis = "NIS per degree of freedom (1 expected)"
    checks.append(plot(None, "/nis", nis, axis=up_to_now(CHECKED_S)))
    right = [
        plot(None, "/imu/gyro", "Gyro, deg/s", axis=up_to_now(SEEN_S)),
        plot(None, "/imu/accel", "Accelerometer, m/s²", axis=up_to_now(SEEN_S)),
        rrb.Tabs(*checks, active_tab=0), plot(None, "/hypotheses", "Evidence so far, nats"),
    ]  # fmt: skip
    parts = [left, *([rrb.Vertical(*middle)] if middle else []), rrb.Vertical(*right)]
    panels = (rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"))
    panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE)
    return rrb.Blueprint(rrb.Horizontal(*parts), *panels, panel)


def _bar(done: float) -> str:
    full = round(20 * done)
    return "`" + "█" * full + "░" * (20 - full) + f"` {done:.0%}"


def _turned(picture: Mapping[str, Any], t: float) -> Array:
    """How far the phone that shows the turn has come at t (s): it turns, waits, and begins anew."""
    seconds = float(picture["seconds"])
    s = min(1.0, (t % (seconds + 1.0)) / seconds)
    angle = math.radians(picture["degrees"]) * s * s * (3.0 - 2.0 * s)
    axis = np.array(picture["axis"], dtype=np.float64)
    return np.asarray(so3.matrix_exp(angle * axis / np.linalg.norm(axis)))


@contextlib.contextmanager
def board(
    *, show: bool, web: bool = False, rrd: Path | None = None,
    say: Callable[[str], None] = print, extra: tuple[str, ...] = (),
) -> Iterator[SessionBoard]:  # fmt: skip
    """A board into a viewer, a file, or both at once. extra: options of the viewer.

    Errors: HandcalError where it cannot be shown or written.
    """
    try:
        with contextlib.ExitStack() as stack:
            sinks: list[Any] = []
            if rrd:
                place = stack.enter_context(output.whole(rrd))
                sinks.append(stack.enter_context(file_sink(place)))
            if show:
                shown = stack.enter_context(viewer(web=web, extra=extra))
                sinks.append(rr.GrpcSink(shown.url))
                if shown.web_url:
                    say(f"watch at {shown.web_url}")
            rec = stack.enter_context(begun())
            rec.set_sinks(*sinks, default_blueprint=blueprint())
            yield SessionBoard(rec)
            with contextlib.suppress(RuntimeError):  # (a viewer that its owner has closed)
                rec.flush(timeout_sec=5.0)
    except RuntimeError as error:  # rerun's word where memory or threads are short
        raise HandcalError(f"Nothing more could be written or shown: {error}.") from error

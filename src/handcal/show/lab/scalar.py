"""A calibration against gravity as JSON, as a page and in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.lab.norm_rows import KINDS
from handcal.lab.scalar import Scalar
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.drawing import INK, MUTED, RC, XYZ, Plot, canvas, legend, svg
from handcal.show.lab.sheet import Sheet, Table
from handcal.types import CALIBRATION_SCHEMA, Array
from handcal.units import DEG, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNITS = {"accel": "m/s^2", "gyro": "rad/s", "turn": "1"}
MM = 1000.0


def scalar_json(result: Scalar, halves: Sequence[Scalar]) -> dict[str, Any]:
    """``lab scalar --json``: what ``calibrate --json`` has, and the rests and turns beside it.

    handcal apply takes it as it takes that.
    """
    rests, turns = result.rests, result.turns
    return {
        "schema": CALIBRATION_SCHEMA,
        "method": "gravity-norm",
        "recording": summary.recording_json(result.recording, "rest-only"),
        "parameters": [summary.parameter_json(p) for p in result.parameters],
        "covariance": result.covariance.tolist(),
        "noise": [{"name": f"{k}_beyond_noise", "value": result.extra[k], "unit": UNITS[k]}
                  for k in KINDS],
        "fit": {"log_evidence": None, "observations": 6 * len(rests) + 2 * len(turns),
                "nis": {}, "whiteness": {}},
        "gravity": result.gravity,
        "rests": [{"from_s": a, "to_s": b, "samples": int(n), "norm_error_before": e0,
                   "norm_error_after": e1}
                  for (a, b), n, (e0, e1) in zip(rests.span.tolist(), rests.count,
                                                 result.norm.tolist(), strict=True)],
        "turns": [{"from_rest": int(i), "to_rest": int(j), "seconds": s, "miss_before": c0,
                   "miss_after": c1}
                  for i, j, s, (c0, c1) in zip(turns.before, turns.after, turns.seconds.tolist(),
                                               result.closure.tolist(), strict=True)],
        "halves": [{"effect": a.effect, "name": a.name, "first": a.value, "second": b.value,
                    "sigma": float(np.hypot(a.sigma, b.sigma)), "unit": a.unit}
                   for a, b in _pairs(halves)],
        "warnings": _warnings(result),
    }  # fmt: skip


def scalar_sheet(result: Scalar, halves: Sequence[Scalar], pictures: bool) -> Sheet:
    """What a person sees; halves: from the first and the second half of the rests, or nothing."""
    recording = result.recording
    worst = np.abs(result.norm).max(axis=0)
    facts = [
        (f"{len(result.rests)}", "rests"),
        (f"{len(result.turns)}", "turns between them"),
        (f"{MM * worst[1]:.2g} mm/s²", f"largest error of gravity's size, was {MM * worst[0]:.0f}"),
    ]
    if len(result.turns):
        miss = DEG * _rms(result.closure)
        facts.append((f"{miss[1]:.2g}°", f"rms error of a turn, was {miss[0]:.2g}°"))
    return Sheet(
        f"Calibration of {Path(recording.path).name} against gravity",
        f"{recording.duration_s:.0f} s at {recording.rate_hz:.0f} Hz; gravity "
        f"{result.gravity:.5f} m/s².",
        tuple(facts),
        tuple(_sentences(result, halves)),
        result.parameters,
        tuple([_halves_table(halves)] if halves else []),
        tuple(_plots(result)) if pictures else (),
        tuple(_warnings(result)),
    )


def _sentences(result: Scalar, halves: Sequence[Scalar]) -> list[str]:
    norm = MM * _rms(result.norm)
    worst = MM * np.abs(result.norm).max(axis=0)
    said = [
        f"Size of the specific force in {len(result.rests)} rests: off by {norm[0]:.3g} mm/s² "
        f"(rms; at most {worst[0]:.3g}) as read, {norm[1]:.2g} mm/s² (at most {worst[1]:.2g}) "
        "calibrated."
    ]
    if len(result.turns):
        miss = DEG * _rms(result.closure)
        said.append(
            f"Gravity carried by the gyro through {len(result.turns)} turns: off by "
            f"{miss[0]:.2g}° (rms) as read, {miss[1]:.2g}° calibrated."
        )
    unit = shown("m/s^2", [result.extra["accel"]])
    if result.extra["accel"] > 0.0:
        said.append(
            f"Readings at rest repeat to {unit.value(result.extra['accel'])} {unit.unit} from one "
            "rest to the next, beyond their noise; sigmas count that."
        )
    if result.extra["gyro"] > 0.0:
        drift = shown("rad/s", [result.extra["gyro"]])
        said.append(
            f"The gyro's bias wandered by {drift.value(result.extra['gyro'])} {drift.unit} between "
            "rests: its sigma is that, and a turn is judged by the rests on both sides of it."
        )
    if halves:
        a, b = max(_pairs(halves), key=lambda pair: _apart(*pair))
        said.append(
            f"The first half of the rests and the second agree: the largest difference is "
            f"{_apart(a, b):.1f} sigma, of {words.parameter_title(a).lower()}."
            if _apart(a, b) < 3.0
            else f"The halves of the rests disagree by {_apart(a, b):.1f} sigma in "
            f"{words.parameter_title(a).lower()}: something changed on the way, or the model "
            "lacks an effect."
        )
    return said


def _pairs(halves: Sequence[Scalar]) -> list[tuple[Any, Any]]:
    if not halves:
        return []
    return list(zip(halves[0].parameters, halves[1].parameters, strict=True))


def _apart(a: Any, b: Any) -> float:
    return float(abs(a.value - b.value) / np.hypot(a.sigma, b.sigma))


def _halves_table(halves: Sequence[Scalar]) -> Table:
    rows = []
    of_both = [p for half in halves for p in half.parameters]
    units = {key[0]: words.shown_group(g) for key, g in words.by_effect(of_both).items()}
    for a, b in _pairs(halves):
        both = float(np.hypot(a.sigma, b.sigma))
        unit = units[a.effect]
        rows.append((words.parameter_title(a), unit.unit, unit.value(a.value, both, sign=True),
                     unit.value(b.value, both, sign=True), f"{_apart(a, b):.1f}"))  # fmt: skip
    return Table(
        "The halves of the rests, each alone",
        ("parameter", "unit", "first half", "second half", "apart, sigma"),
        tuple(rows),
        text=2,
        note="At the noise that all rests show together. Half the rests see less, so each half "
        "alone is less certain than the whole.",
    )


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def _warnings(result: Scalar) -> list[str]:
    return list(dict.fromkeys((*result.recording.warnings, *result.warnings)))


# --- pictures -----------------------------------------------------------------------------------


def _plots(result: Scalar) -> list[Plot]:
    import matplotlib as mpl

    with mpl.rc_context(RC):
        plots = [_norm_plot(result), _directions(result)]
        if len(result.turns):
            plots.append(_closure_plot(result))
    return plots


def _norm_plot(result: Scalar) -> Plot:
    figure, (above, below) = canvas(2, 4.4)
    number = np.arange(1.0, len(result.rests) + 1.0)
    _stems(above, number, MM * result.norm[:, 0], MUTED)
    _stems(below, number, MM * result.norm[:, 1], XYZ[2])
    above.set_ylabel("as read, mm/s²")
    below.set_ylabel("calibrated, mm/s²")
    below.set_xlabel("rest")
    caption = "Size of the mean specific force in each rest, less gravity. Mind the two scales."
    return Plot("Error of gravity's size", caption, svg(figure, "lab-norm"))


def _stems(ax: Axes, x: Array, y: Array, colour: str) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.vlines(x, 0.0, y, color=colour, lw=1.6)
    ax.plot(x, y, "o", color=colour, markersize=5)
    ax.axhline(0.0, color=INK, lw=0.8)


def _closure_plot(result: Scalar) -> Plot:
    from matplotlib.ticker import MaxNLocator

    figure, (ax,) = canvas(1, 4.0)
    number = np.arange(1, len(result.turns) + 1)
    ax.plot(number, DEG * result.closure[:, 0], "o", color=MUTED, markersize=6, label="as read")
    ax.plot(number, DEG * result.closure[:, 1], "o", color=XYZ[2], markersize=6, label="calibrated")
    ax.set(ylim=(0.0, None), xlabel="turn", ylabel="angle, deg")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend(ax)
    caption = "Between gravity as the gyro carried it through the turn and where it is then."
    return Plot("Error of each turn", caption, svg(figure, "lab-turns"))


def _directions(result: Scalar) -> Plot:
    """Up in body axes: both halves of the sphere, by an equal-area projection."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.6, 3.9), layout="constrained")
    axes = figure.subplots(1, 2)
    f = result.rests.reading[:, 3:]
    up = f / np.linalg.norm(f, axis=1, keepdims=True)
    circle = np.linspace(0.0, 2.0 * np.pi, 100)
    for ax, sign, title in zip(axes, (1.0, -1.0), ("z up", "z down"), strict=True):
        for angle in (30.0, 60.0, 90.0):
            r = np.sqrt(2.0) * np.sin(np.radians(angle) / 2.0)
            ax.plot(r * np.cos(circle), r * np.sin(circle), color=MUTED, lw=0.6)
        own = np.flatnonzero(sign * up[:, 2] >= 0.0)
        r = np.sqrt(1.0 / (1.0 + np.abs(up[own, 2])))
        ax.plot(r * up[own, 0], r * up[own, 1], "o", color=XYZ[2], markersize=6)
        for i, radius in zip(own, r, strict=True):
            ax.annotate(f"{i + 1}", radius * up[i, :2], xytext=(4, 4), textcoords="offset points",
                        fontsize=9, color=MUTED)  # fmt: skip
        ax.set(aspect="equal", xlim=(-1.12, 1.12), ylim=(-1.12, 1.12), xticks=[], yticks=[])
        ax.grid(False)
        ax.set_title(title, fontsize=10.5)
        ax.set_xlabel("x up →")
        ax.set_ylabel("y up →")
    caption = (
        "Where up was in the device's axes in each rest; circles every 30° from z. "
        "The more evenly they are spread, the better."
    )
    return Plot("Attitudes of the rests", caption, svg(figure, "lab-directions"))

"""One self-contained HTML page that a person reads from top to bottom."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import handcal
from handcal import output
from handcal.device.apply import TOGETHER
from handcal.effects import catalogue
from handcal.show import words
from handcal.show.calibration import plots, summary, verdict_text
from handcal.show.calibration.shown import in_front, not_drawn, under_table
from handcal.show.doubts import nis_word
from handcal.show.drawing import AXES
from handcal.show.html_page import page
from handcal.types import Array, Parameter, Result

_MATRIX = ("gyro_scale", "gyro_misalignment", "accel_scale", "accel_misalignment")
_APPLIED = ("gyro_bias", "accel_bias", "gyro_g_sensitivity", *_MATRIX)


def write_report(result: Result, path: str | Path) -> None:
    """Write the report on a result as one HTML file; nothing in it needs a network."""
    output.write_text(path, render(result))


def render(result: Result) -> str:
    """The page as a string."""
    return page("report.html.j2", _context(result))


def _context(result: Result) -> dict[str, Any]:
    recording = result.recording
    turned = np.linalg.norm(recording.imu.gyro, axis=1)
    dt = np.diff(recording.imu.t)
    turns = float((turned[1:] * dt).sum() / (2 * np.pi))
    facts = [
        (f"{recording.duration_s:.0f} s", f"at {recording.rate_hz:.0f} Hz"),
        (f"{turns:.1f}", "turns in all"),
        (f"{len(result.rests)}", "rest" if len(result.rests) == 1 else "rests"),
        (f"{result.observations:,}".replace(",", "\u202f"), "observations"),
    ]
    front, rest = in_front(result.parameters)
    return {
        "name": Path(recording.path).name,
        "version": handcal.__version__,
        "streams": ", ".join(["IMU", *map(words.stream_title, recording.streams)]),
        "assumed": words.assume_sentence(result.assume, recording.streams),
        "verdict": verdict_text.verdict(result),
        "facts": facts,
        "groups": _rows(front),
        "notes": [*under_table(front, rest), *filter(None, [words.marker_sentence(result.marker)])],
        "not_shown": verdict_text.not_shown(result),
        "noise": [words.noise_line(n) for n in result.noise],
        "kinds": _kinds(result),
        "warnings": summary.all_warnings(result),
        "plots": plots.draw(result),
        "not_drawn": not_drawn(result.parameters),
        "apply": how_to_apply(result.parameters),
    }


def how_to_apply(parameters: Sequence[Parameter]) -> dict[str, Any]:
    """What the page says of undoing errors: the code, and what it leaves."""
    effects = dict.fromkeys(p.effect for p in parameters)
    others = {e: words.effect_title(e) for e in effects if e not in _APPLIED}
    known = catalogue()
    misread = any(e not in known or known[e].misreads for e in others)
    return {
        "code": code_of(parameters),
        "others": [t if " += " in e else t.lower() for e, t in others.items()],
        "together": TOGETHER.format("that") if misread else "",
        "g_sensitivity": "gyro_g_sensitivity" in effects,
        "matrices": any(e in _MATRIX for e in effects),
    }


def _rows(parameters: Sequence[Parameter]) -> list[dict[str, Any]]:
    groups = []
    for (effect, _), group in words.by_effect(parameters).items():
        unit = words.shown_group(group)
        rows = [
            {
                "name": words.parameter_name(p),
                "value": unit.value(p.value, p.sigma, sign=True),
                "sigma": unit.value(p.sigma, p.sigma),
                "prior": unit.value(p.prior_sigma),
                "shown": p.shown,
                "at": "–" if p.converged_at_s is None else f"{p.converged_at_s:.0f} s",
            }
            for p in group
        ]
        groups.append({"title": words.effect_title(effect), "unit": unit.unit, "rows": rows})
    return groups


def _kinds(result: Result) -> list[dict[str, Any]]:
    rows = []
    for kind, i in result.innovations.items():
        rho = summary.whiteness(i)
        rows.append(
            {
                "name": words.kind_title(kind),
                "updates": i.t.size,
                "skipped": i.skipped,
                "nis": "–" if i.mean_nis is None else f"{i.mean_nis:.2f}",
                "word": nis_word(i),
                "rho": "–" if rho is None else f"{round(rho, 2) + 0.0:+.2f}".replace("-", "−"),
            }
        )
    return rows


def error_matrices(parameters: Sequence[Parameter]) -> tuple[Array, Array, Array]:
    """What the sensors make of the truth: (I + S + M) of gyro and accelerometer, and G; (3, 3)."""
    gyro, accel, g = np.eye(3), np.eye(3), np.zeros((3, 3))
    into = {"gyro_scale": gyro, "gyro_misalignment": gyro, "accel_scale": accel,
            "accel_misalignment": accel, "gyro_g_sensitivity": g}  # fmt: skip
    for p in parameters:
        if p.effect in into:
            row, column = AXES.index(p.name[0]), AXES.index(p.name[-1])
            into[p.effect][row, column] += p.value
    return gyro, accel, g


def apply_code(result: Result) -> str:
    """Python that undoes biases, scales, misalignments and g-sensitivity, numbers filled in."""
    return code_of(result.parameters)


def code_of(parameters: Sequence[Parameter]) -> str:
    """The same of parameters that came from anywhere."""
    effects = {p.effect for p in parameters}
    gyro, accel, g = error_matrices(parameters)
    lines = ["import numpy as np", ""]
    for effect, unit in (("gyro_bias", "rad/s"), ("accel_bias", "m/s^2")):
        own = [p for p in parameters if p.effect == effect]
        # (what was not learnt would make readings no better)
        values = [p.value if p.shown else 0.0 for p in own]
        hidden = [p.name for p in own if not p.shown]
        left = f"; {words.listed(hidden)} not known well enough" if hidden else ""
        lines.append(f"{effect} = np.array({_numbers(values)})  # {unit}{left}")
    accel_true, gyro_true = "(accel - accel_bias)", "(gyro - gyro_bias)"
    if effects & {"accel_scale", "accel_misalignment"}:
        lines.append(f"accel_matrix = np.array({_numbers(accel.tolist())})")
        accel_true += " @ np.linalg.inv(accel_matrix).T"
    if "gyro_g_sensitivity" in effects:
        lines.append(f"g_sensitivity = np.array({_numbers(g.tolist())})  # (rad/s)/(m/s^2)")
        gyro_true = "(gyro - gyro_bias - accel_true @ g_sensitivity.T)"
    if effects & {"gyro_scale", "gyro_misalignment"}:
        lines.append(f"gyro_matrix = np.array({_numbers(gyro.tolist())})")
        gyro_true += " @ np.linalg.inv(gyro_matrix).T"
    for name, formula in (("accel_true", accel_true), ("gyro_true", gyro_true)):
        lines.append(f"{name} = {formula[1:-1] if formula.endswith(')') else formula}")
    return "\n".join(lines)


def _numbers(values: Any) -> str:
    if isinstance(values, list):
        return "[" + ", ".join(_numbers(v) for v in values) + "]"
    return f"{values:.6g}"

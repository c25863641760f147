"""A calibration against a known input as JSON, as a page and in the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.lab.known_input import BAD_CONDITION, MOUNTING, KnownInput
from handcal.lab.ten_tests import proposal
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.drawing import INK, MUTED, RC, XYZ, Plot, canvas, legend, svg
from handcal.show.lab.sheet import Sheet, Table
from handcal.types import CALIBRATION_SCHEMA, Array, Recording
from handcal.units import shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SENSORS = ("gyro", "accel")
TITLES = {"gyro": "Gyro", "accel": "Accelerometer"}
UNITS = {"gyro": "rad/s", "accel": "m/s^2"}
# Of two solutions, in usual sizes: rounding parts them below it, and no sigma is as small.
AGREED = 1e-6


@dataclass(frozen=True)
class TableErrors:
    """Standard deviations (k,) that errors of the table bring to the parameters: with the
    correlations of what they do, and as they would be without."""

    kept: Array
    left_out: Array
    said: str


def known_input_json(
    result: KnownInput, path: Path, recording: Recording | None, table: TableErrors | None
) -> dict[str, Any]:
    """``lab known-input --json``: what ``calibrate --json`` has, and the tests beside it."""
    better = proposal(result)
    residual = result.residual
    return {
        "schema": CALIBRATION_SCHEMA,
        "method": "known-input",
        "axes": result.axes,
        "recording": _recording_json(result, path, recording),
        "parameters": [summary.parameter_json(p) for p in result.parameters
                       if p.effect != MOUNTING],
        "mounting": [summary.parameter_json(p) for p in result.parameters if p.effect == MOUNTING],
        "covariance_of": [f"{p.effect} {p.name}" for p in result.parameters],
        "covariance": result.covariance.tolist(),
        "noise": [{"name": f"{s}_beyond_noise", "value": result.extra[s], "unit": UNITS[s]}
                  for s in SENSORS],
        "fit": {"log_evidence": None, "observations": len(result.A), "nis": {}, "whiteness": {}},
        "condition": result.condition,
        "kalman_difference": result.kalman,
        "tests": [{"reading": r, "residual_before": b, "residual_after": a}
                  for r, b, a in zip(result.bench.reading.tolist(), residual[:, :, 0].tolist(),
                                     residual[:, :, 1].tolist(), strict=True)],
        "table_errors": None if table is None else [
            {"effect": p.effect, "name": p.name, "sigma": float(s), "unit": p.unit}
            for p, s in zip(result.parameters, table.kept, strict=True)],
        "better_rates": None if better is None or not badly(result) else better[0].tolist(),
        "warnings": list(result.warnings),
    }  # fmt: skip


def _recording_json(result: KnownInput, path: Path, recording: Recording | None) -> dict[str, Any]:
    if recording is not None:
        return summary.recording_json(recording, "rest-only")
    return {"path": str(path), "duration_s": None, "imu_rate_hz": None,
            "streams": {"imu": {"samples": len(result.bench)}}, "assume": "rest-only"}  # fmt: skip


def badly(result: KnownInput) -> bool:
    """Whether the design magnifies noise."""
    return result.condition > BAD_CONDITION


def known_input_sheet(
    result: KnownInput, name: str, table: TableErrors | None, pictures: bool
) -> Sheet:
    """What a person sees."""
    m, k = result.A.shape
    facts = (
        (f"{len(result.bench)}", "tests"),
        (f"{k}", f"unknowns, from {m} readings"),
        (f"{result.condition:.3g}", "condition number (1 is the best)"),
        ("agree", "least squares and a Kalman filter")
        if result.kalman < AGREED
        else (f"{result.kalman:.1g}", "Kalman filter less least squares, in usual sizes"),
    )
    tables = [_residual_table(result)]
    if table is not None:
        tables.insert(0, _table_errors(result, table))
    better = proposal(result) if badly(result) else None
    if better is not None:
        tables.append(_better_table(better[0]))
    axes = "the IMU's (accelerometer x is body x)" if result.axes == "imu" else "the table's"
    return Sheet(
        f"Calibration of {name} against a known input",
        f"Axes: {axes}.",
        facts,
        tuple(_sentences(result, better)),
        result.parameters,
        tuple(tables),
        tuple(_plots(result)) if pictures else (),
        result.warnings,
    )


def _sentences(result: KnownInput, better: tuple[Array, Array] | None) -> list[str]:
    m, k = result.A.shape
    said = [
        f"Rank {k} of {k}: the tests tell all parameters apart. Least squares and a Kalman "
        f"filter over the same {m} readings "
        f"{'agree' if result.kalman < AGREED else f'differ by {result.kalman:.1g} usual sizes'}."
    ]
    for i, sensor in enumerate(SENSORS):
        if result.bench.used[3 * i]:
            rms = np.sqrt((result.residual[:, 3 * i : 3 * i + 3] ** 2).mean(axis=(0, 1)))
            unit = shown(UNITS[sensor], rms.tolist())
            said.append(
                f"{TITLES[sensor]}: off the known input by {unit.value(float(rms[0]))} {unit.unit} "
                f"(rms) as read, {unit.value(float(rms[1]))} {unit.unit} calibrated."
            )
    if better is not None:
        gain = better[1]
        said.append(
            f"Ten tests at the rates in the table below would tell every parameter of the gyro "
            f"{gain.min():.3g} to {gain.max():.3g} times better, for the same noise."
        )
    return said


def _residual_table(result: KnownInput) -> Table:
    rows = []
    for i, sensor in enumerate(SENSORS):
        if result.bench.used[3 * i]:
            for a in range(3):
                own = result.residual[:, 3 * i + a]
                unit = shown(UNITS[sensor], np.abs(own).max(axis=0).tolist())
                rms = np.sqrt((own**2).mean(axis=0))
                rows.append((f"{TITLES[sensor]} {'xyz'[a]}", unit.unit,
                             *(unit.value(float(v)) for v in rms),
                             unit.value(float(np.abs(own[:, 1]).max()))))  # fmt: skip
    columns = ("channel", "unit", "rms as read", "rms calibrated", "at most")
    return Table("What is left", columns, tuple(rows), text=2)


def _table_errors(result: KnownInput, errors: TableErrors) -> Table:
    rows = []
    for p, kept, alone in zip(result.parameters, errors.kept, errors.left_out, strict=True):
        unit = shown(p.unit, [float(max(kept, alone))])
        rows.append((words.parameter_title(p), unit.unit, unit.value(float(kept)),
                     unit.value(float(alone))))  # fmt: skip
    return Table(
        f"What the table's errors bring: {errors.said}",
        ("parameter", "unit", "sigma", "correlations left out"),
        tuple(rows),
        text=2,
        note="On top of the sigmas above. One axis misses all three readings of its pose, and a "
        "tilt of the base those of all poses; left out, these correlations mislead.",
    )


def _better_table(rates: Array) -> Table:
    rows = tuple((f"{i + 1}", *(f"{v:.0f}".replace("-", "−") for v in row))
                 for i, row in enumerate(np.degrees(rates)))  # fmt: skip
    columns = ("test", "x, deg/s", "y, deg/s", "z, deg/s")
    note = "No axis is faster than the fastest of the tests that were made."
    return Table("Ten tests that tell the gyro better", columns, rows, note=note)


def _plots(result: KnownInput) -> list[Plot]:
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return [_residual_plot(result, i) for i in range(2) if result.bench.used[3 * i]]


def _residual_plot(result: KnownInput, sensor: int) -> Plot:
    figure, (above, below) = canvas(2, 4.4)
    number = np.arange(1.0, len(result.bench) + 1.0)
    own = result.residual[:, 3 * sensor : 3 * sensor + 3]
    for ax, which, said in ((above, 0, "as read"), (below, 1, "calibrated")):
        unit = shown(UNITS[SENSORS[sensor]], np.abs(own[:, :, which]).ravel().tolist())
        for a in range(3):
            ax.plot(number, unit.factor * own[:, a, which], "o", color=XYZ[a], markersize=4.5,
                    label="xyz"[a])  # fmt: skip
        _zero(ax)
        ax.set_ylabel(f"{said}, {unit.unit}")
    legend(above)
    below.set_xlabel("test")
    title = f"{TITLES[SENSORS[sensor]]} against the known input"
    return Plot(title, "Mean reading less what is known, in each test. Mind the two scales.",
                svg(figure, f"lab-known-{sensor}"))  # fmt: skip


def _zero(ax: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.axhline(0.0, color=INK, lw=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.tick_params(axis="x", colors=MUTED)

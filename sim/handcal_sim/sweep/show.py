"""A sweep as tables in the terminal and as CSV."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from handcal_sim.sweep.compare import end_of
from handcal_sim.sweep.grid import MATCHED, NONE, inherited
from handcal_sim.sweep.printed import QUANTITIES

Document = Mapping[str, Any]
TITLES = {"convergence_s": "converged, s", "rms_error": "RMS error", "rms": "RMS"}
SENSORS = (
    ("gyro_bias", "Gyro bias, deg/h"), ("accel_bias", "Accelerometer bias, ug"),
    ("gyro_scale", "Gyro scale, ppm"), ("accel_scale", "Accelerometer scale, ppm"),
)  # fmt: skip


NARROW, FILE_WIDTH = 118, 140
# Below so many seeds one in twenty is none, and a central 95 % says nothing.
ENOUGH_SEEDS = 20
# Grids whose values the paper says, or the documentation.
PAPERS = ("paper", "turns")
# Ratio to the bound from which noise is not the cause.
FAR_OFF = 5.0
MOST_NAMED = 20  # cells whose names find room below a figure


def console() -> Console:
    """Standard output; a file is as wide as the tables."""
    wide = None if sys.stdout.isatty() else FILE_WIDTH
    return Console(highlight=False, width=wide)


def show(sweep: Document, console: Console) -> None:
    """A table for each sensor, what was chosen by evidence, motions beside each other."""
    found = {row["effect"] for cell in sweep["cells"] for row in cell["parameters"]}
    titles = dict(SENSORS)
    for effect in (*titles, *sorted(found - set(titles))):
        if effect in found:
            console.print(
                _sensor(sweep, effect, titles.get(effect, effect), console.width < NARROW)
            )
    if sweep["evidence"]:
        console.print(_evidence(sweep["evidence"]))
    if sweep["side_by_side"]:
        console.print(_side_by_side(sweep["side_by_side"]))
    for line in sentences(sweep):
        console.print(line, soft_wrap=True)


def sentences(sweep: Document) -> list[str]:
    """What the tables come to."""
    lines = []
    if sweep["printed"] and enough(sweep):
        said = ", ".join(
            f"{TITLES[name].partition(',')[0]} {count['inside']} of {count['n']}"
            for name, count in sweep["printed"].items()
        )
        lines.append(f"Printed values inside the central 95 % of {sweep['seeds']} seeds: {said}.")
    if sweep["cells"]:
        limits = ", ".join(f"{value:g} {unit}" for unit, value in sweep["thresholds"].items())
        lines.append(
            f"Values are medians over {sweep['seeds']} seeds (seed {sweep['seed']}); convergence "
            f"threshold {limits}."
        )
        lines += [*_columns(sweep), *_far_off(sweep["cells"])]
        if not enough(sweep):
            lines.append(
                f"{sweep['seeds']} seeds are too few for a central 95 % ({ENOUGH_SEEDS} would do), "
                "so no range is shown."
            )
        if sweep["grid"] not in PAPERS:
            lines += _all_cells(sweep["cells"])
        if any(cell["chosen_r_h_rad"] for cell in sweep["cells"]):
            lines.append("* R_h chosen by evidence from the innovations, anew in every run.")
    return lines


def _columns(sweep: Document) -> list[str]:
    """What the columns are, a line each."""
    ends = ends_shown(sweep)
    lines = [
        "RMS error: root mean square of estimate minus truth from convergence to the end (what the "
        "paper calls STD).",
        "RMS: root mean square of the estimate itself, about zero, over the same time.",
        "final: root mean square over the seeds of the error at the end.",
    ]
    if len(ends) > 1:
        lines.append(
            "settled: the same of handcal's own calibration, which goes over the recording until "
            "it settles."
        )
    return [
        *lines,
        f"ratio: {ends[-1]} over the Cramér-Rao bound.",
    ]


def _far_off(cells: Sequence[Document]) -> list[str]:
    """Which error that is there and not estimated stands behind a ratio far above 1."""
    worst, where = FAR_OFF, ""
    hidden: dict[str, None] = {}
    for cell in cells:
        effects = cell["world"]["effects"]
        unasked = [_effect(e, v) for e, v in effects if e not in cell["estimate"]]
        for row in cell["parameters"]:
            ratio = end_of(row)["over_bound"]
            if unasked and ratio > FAR_OFF:
                hidden |= dict.fromkeys(unasked)
            if unasked and ratio > worst:
                worst, where = ratio, f"{row['effect']} {row['name']}"
    if not hidden:
        return []
    verb = "is" if len(hidden) == 1 else "are"
    return [
        f"A ratio far above 1 (up to {worst:.2f}, {where}) is no noise: {', '.join(hidden)} {verb} "
        "in these worlds and not among what the filter estimates, and goes into the biases; the "
        "bound knows noise alone."
    ]


def enough(sweep: Document) -> bool:
    """Whether there are seeds enough to say where 95 % of them lie."""
    return bool(sweep["seeds"] >= ENOUGH_SEEDS)


def numbered(sweep: Document) -> bool:
    """Whether cells are told apart by their numbers: those of one's own grid, or very many."""
    return sweep["grid"] not in PAPERS or len(sweep["cells"]) > MOST_NAMED


def _all_cells(cells: Sequence[Document]) -> list[str]:
    """What is the same in all cells of a grid of one's own, and where it is from."""
    as_paper, otherwise = inherited(cells)
    lines = []
    for values, where in ((otherwise, "In all cells"), (as_paper, "As in paper 002, not varied")):
        if values:
            said = (
                f"{k} {', '.join(_effect(*e) for e in v) or 'none' if k == 'effects' else _word(v)}"
                for k, v in values.items()
            )
            lines.append(f"{where}: {', '.join(said)}.")
    return lines


def _effect(effect: str, values: Sequence[float]) -> str:
    """An effect of a world with its values: relative ones in ppm, others in SI."""
    factor, unit = (1e6, " ppm") if effect.endswith("_scale") else (1.0, "")
    return f"{effect} ({' '.join(f'{factor * v:g}' for v in values)}{unit})"


def _word(value: Any) -> str:
    """A value of a grid, in brief."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return f"({' '.join(_word(v) for v in value)})"
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def number(value: float | None) -> str:
    """Three or four digits, without an exponent up to a million."""
    if value is None:
        return "-"
    if value == 0.0 or abs(value) >= 1e6:
        return f"{value:.3g}"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def printed_beside(spread: Document) -> str:
    """A printed value, and whether it lies inside."""
    if spread["printed"] is None:
        return ""
    return f"{number(spread['printed'])} {'✓' if spread['inside'] else '✗'}"


def _table(title: str, *columns: str, left: int = 2) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        first: dict[str, Any] = {"max_width": 34} if k == 0 else {"no_wrap": True}
        table.add_column(column, justify="right" if k >= left else "left", **first)
    return table


def _sensor(sweep: Document, effect: str, title: str, narrow: bool) -> Table:
    shown = QUANTITIES[:2] if narrow else QUANTITIES
    beside = bool(sweep["printed"])
    columns = [c for q in shown for c in ((TITLES[q], "printed") if beside else (TITLES[q],))]
    table = _table(title, "", "R_h, rad", "", *columns, *ends_shown(sweep), "bound", "ratio",
                   left=3)  # fmt: skip
    group = ""
    for cell in sweep["cells"]:
        names = (cell["group"] if cell["group"] != group else "", r_h(cell))
        group = cell["group"]
        for row in (row for row in cell["parameters"] if row["effect"] == effect):
            values = []
            for q in shown:
                values.append(number(row[q]["median"]))
                if beside:
                    text = printed_beside(row[q])
                    values.append(f"[red]{text}[/]" if text.endswith("✗") else text)
            own = row["settled_error"]
            ends = [number(row["final_error"]["rms"]), *([number(own["rms"])] if own else [])]
            end = end_of(row)
            ends += [number(end["bound"]), f"{end['over_bound']:.2f}"]
            table.add_row(*names, row["name"], *values, *ends)
            names = ("", "")
    return table


def ends_shown(sweep: Document) -> list[str]:
    """Which final errors there are: of the online filter, of handcal's own calibration."""
    own = any(row["settled_error"] for cell in sweep["cells"] for row in cell["parameters"])
    return ["final", "settled"] if own else ["final"]


def r_h(cell: Document) -> str:
    """The R_h of a cell, rad; where evidence chose it, the median and an asterisk; a word where the
    grid has one."""
    if cell["chosen_r_h_rad"]:
        return f"{cell['chosen_r_h_rad']['median']:.3g}*"
    if cell["without_heading"]:
        return NONE
    true = math.radians(cell["world"]["heading_sigma_deg"])
    if cell["r_h_rad"] == true:
        return f"{MATCHED} ({true:.3g})"
    return f"{cell['r_h_rad']:g}"


def _evidence(rows: list[Document]) -> Table:
    table = _table("R_h by evidence against the best by hand: gyro z, final error, deg/h",
                   "", "R_h by evidence, rad", "error", "NEES", "R_h by hand", "error", "NEES",
                   "ratio", "bound")  # fmt: skip
    for row in rows:
        r = row["r_h_rad"]
        table.add_row(
            row["group"], f"{r['median']:.3f} ({r['low']:.3f} to {r['high']:.3f})",
            number(row["final_rms"]), number(row["nees"]), f"{row['best_r_h_rad']:g}",
            number(row["best_final_rms"]), number(row["best_nees"]), f"{row['over_best']:.3f}",
            number(row["bound"]),
        )  # fmt: skip
    return table


def _side_by_side(rows: list[Document]) -> Table:
    names = list(dict.fromkeys(name for row in rows for name in row["scenarios"]))
    columns = [c for name in names for c in (f"{name}, error", "bound")]
    table = _table("Motions side by side: gyro z, final error, deg/h", "heading", "R_h", *columns)
    for row in rows:
        sigma = row["heading_sigma_deg"]
        ends = [row["scenarios"].get(name) for name in names]
        values = [number(e[k]) if e else "" for e in ends for k in ("rms", "bound")]
        table.add_row("none" if sigma is None else f"{sigma:g}°", row["r_h"], *values)
    return table


def write_csv(sweep: Document, file: Path) -> None:
    """One row for each parameter of each cell."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        rows = [_flat(cell, row) for cell in sweep["cells"] for row in cell["parameters"]]
        writer = csv.DictWriter(stream, list(rows[0]) if rows else ["group"])
        writer.writeheader()
        writer.writerows(rows)


def _flat(cell: Document, row: Document) -> dict[str, Any]:
    chosen = cell["chosen_r_h_rad"]
    out: dict[str, Any] = {
        "group": cell["group"], "scenario": cell["world"]["scenario"],
        "heading_sigma_deg": "" if cell["without_heading"] else cell["world"]["heading_sigma_deg"],
        "r_h_rad": chosen["median"] if chosen else cell["r_h_rad"],
        "r_h_by": "evidence" if chosen else "hand",
        "parameter": f"{row['effect']}_{row['name']}", "unit": row["unit"], "truth": row["truth"],
    }  # fmt: skip
    for q in QUANTITIES:
        out |= {f"{q}_{k}": row[q][k] for k in ("median", "low", "high", "printed", "inside")}
    out |= {f"final_{k}": v for k, v in row["final_error"].items()}
    own = row["settled_error"] or dict.fromkeys(row["final_error"], "")
    return out | {f"settled_{k}": v for k, v in own.items()}

"""The page of a sweep: figures 6 to 16 of paper 002 redrawn, its tables, and what is beside.

Figures are matplotlib's; `sweep.write_page` turns them into a page in handcal's own style.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from handcal_sim.sweep.compare import end_of, gyro_z
from handcal_sim.sweep.show import (
    SENSORS,
    TITLES,
    ends_shown,
    enough,
    number,
    numbered,
    printed_beside,
    r_h,
    sentences,
)

Document = Mapping[str, Any]
# The colours that handcal's pages replace by those of their theme.
INK, MUTED = "#1c2330", "#5b6472"
XYZ = ("#c44e00", "#00875f", "#0067b3")
WIDTH, WIDE = 6.6, 13.6
QUANTITIES = tuple(TITLES)


@dataclass(frozen=True)
class Drawn:
    """A figure with its heading and caption."""

    title: str
    caption: str
    figure: Figure


def figures(sweep: Document) -> dict[str, list[Drawn]]:
    """By section: "overview" (wide), "paper" (those the paper shows), "others"."""
    cells = sweep["cells"]
    out: dict[str, list[Drawn]] = {"overview": [], "paper": [], "others": []}
    if not cells:
        return out
    out["overview"] = [_errors(sweep), _against_heading(sweep)]
    for k, cell in enumerate(cells, 1):
        section = "paper" if cell["figures"] else "others"
        for effect, place in (("accel_bias", 0), ("gyro_bias", 1)):
            label = f"Figure {cell['figures'][place]}: " if cell["figures"] else ""
            if numbered(sweep):
                label = f"Cell {k}: "
            out[section].append(_over_time(cell, effect, label, enough(sweep)))
    return out


def context(sweep: Document) -> dict[str, Any]:
    """The page's tables and sentences."""
    found = {row["effect"] for cell in sweep["cells"] for row in cell["parameters"]}
    titles = dict(SENSORS)
    effects = [e for e in titles if e in found] + sorted(found - set(titles))
    return {
        "title": "Paper 002, run again" if sweep["grid"] == "paper" else f"Sweep {sweep['grid']}",
        "seeds": sweep["seeds"], "sentences": sentences(sweep), "printed": bool(sweep["printed"]),
        "counts": [(TITLES[k].partition(",")[0], v) for k, v in sweep["printed"].items()
                   if enough(sweep)],
        "quantities": [TITLES[q][0].upper() + TITLES[q][1:] for q in QUANTITIES],
        "ends": [e.capitalize() for e in ends_shown(sweep)],
        "tables": [{"title": titles.get(e, e), "cells": _rows(sweep, e)} for e in effects],
        "evidence": [
            {"group": row["group"], "r_h": number(row["r_h_rad"]["median"]),
             "low": number(row["r_h_rad"]["low"]), "high": number(row["r_h_rad"]["high"]),
             "mine": number(row["final_rms"]), "nees": number(row["nees"]),
             "best_nees": number(row["best_nees"]), "hand": f"{row['best_r_h_rad']:g}",
             "best": number(row["best_final_rms"]), "ratio": f"{row['over_best']:.3f}",
             "bound": number(row["bound"])}
            for row in sweep["evidence"]
        ],
        "enough": enough(sweep),
        "key": [(k, cell["group"], r_h(cell)) for k, cell in enumerate(sweep["cells"], 1)]
        if numbered(sweep) else [],
        "motions": _motions(sweep["side_by_side"]),
    }  # fmt: skip


def _rows(sweep: Document, effect: str) -> list[dict[str, Any]]:
    out = []
    for k, cell in enumerate(sweep["cells"], 1):
        rows = []
        for row in (row for row in cell["parameters"] if row["effect"] == effect):
            own, end = row["settled_error"], end_of(row)
            rows.append({
                "name": row["name"],
                "values": [
                    {"median": number(row[q]["median"]),
                     "range": _range(row[q]) if enough(sweep) else "",
                     "printed": printed_beside(row[q])[:-2],
                     "inside": row[q]["inside"] if enough(sweep) else None}
                    for q in QUANTITIES
                ],
                "ends": [number(e["rms"]) for e in (row["final_error"], own) if e],
                "bound": number(end["bound"]),
                "ratio": f"{end['over_bound']:.2f}",
            })  # fmt: skip
        label = f"{k}. {cell['group']}" if numbered(sweep) else cell["group"]
        out.append({"group": label, "r_h": r_h(cell), "rows": rows})
    return out


def _range(spread: Document) -> str:
    if spread["low"] is None or spread["high"] is None:
        return ""
    return f"{number(spread['low'])} to {number(spread['high'])}"


def _motions(rows: Sequence[Document]) -> dict[str, Any] | None:
    if not rows:
        return None
    names = list(dict.fromkeys(name for row in rows for name in row["scenarios"]))
    lines = []
    for row in rows:
        sigma, ends = row["heading_sigma_deg"], [row["scenarios"].get(name) for name in names]
        values = [number(e[k]) if e else "" for e in ends for k in ("rms", "bound")]
        lines.append({"heading": "none" if sigma is None else f"{sigma:g}°", "r_h": row["r_h"],
                      "values": values})  # fmt: skip
    return {"names": names, "rows": lines}


def _canvas(rows: int, height: float, width: float = WIDTH) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    return figure, list(axes)


def _over_time(cell: Document, effect: str, label: str, banded: bool) -> Drawn:
    """Estimates over time: median, truth, median time of convergence; banded: with 95 %."""
    rows = [(k, row) for k, row in enumerate(cell["parameters"]) if row["effect"] == effect]
    scale, unit = (1e-3, "mg") if effect == "accel_bias" else (1.0, "deg/h")
    t = np.array(cell["t"])
    figure, axes = _canvas(len(rows), 4.6)
    for n, (ax, (k, row)) in enumerate(zip(axes, rows, strict=True)):
        low, median, high = (scale * np.array(cell["bands"][b][k])
                             for b in ("low", "median", "high"))  # fmt: skip
        if not banded:
            low = high = median
        ax.fill_between(t, low, high, color=XYZ[n], alpha=0.2, lw=0)
        ax.plot(t, median, color=XYZ[n])
        ax.axhline(scale * row["truth"], color=INK, lw=0.9, ls=(0, (4, 3)))
        at = row["convergence_s"]["median"]
        if at is not None:
            ax.axvline(at, color=MUTED, lw=0.9, ls=":")
        late = t > 0.1 * t[-1]
        values = np.r_[low[late], high[late], scale * row["truth"]]
        room = 0.08 * (values.max() - values.min())
        ax.set_ylim(values.min() - room, values.max() + room)
        ax.set_ylabel(f"{row['name']}, {unit}")
        ax.locator_params(axis="y", nbins=4)
    axes[-1].set_xlabel("time, s")
    figure.align_ylabels(axes)
    what = "Accelerometer" if effect == "accel_bias" else "Gyro"
    by = "R_h by evidence" if cell["chosen_r_h_rad"] else f"R_h {r_h(cell)}"
    title = f"{label}{what}, {cell['group']}" + ("" if cell["group"] == "no heading" else f", {by}")
    shown = "median and central 95\u202f% over seeds" if banded else "median over seeds"
    caption = f"Bias estimate: {shown}; dashed: truth; dotted: median time of convergence."
    return Drawn(title, caption, figure)


def _errors(sweep: Document) -> Drawn:
    """RMS error of every bias in every cell, with what is printed."""
    figure, axes = _canvas(2, 6.4, WIDE)
    labels = [f"{cell['group'].replace('heading ', '')}\n{r_h(cell)}"
              for cell in sweep["cells"]]  # fmt: skip
    x = np.arange(len(labels))
    printed = False
    for ax, effect, unit in zip(axes, ("gyro_bias", "accel_bias"), ("deg/h", "µg"), strict=True):
        for n in range(3):
            rows = [[r for r in cell["parameters"] if r["effect"] == effect][n]["rms_error"]
                    for cell in sweep["cells"]]  # fmt: skip
            median, low, high, said = (
                np.array([np.nan if row[k] is None else row[k] for row in rows], dtype=float)
                for k in ("median", "low", "high", "printed")
            )
            at = x + 0.25 * (n - 1)
            if enough(sweep):
                ax.vlines(at, low, high, color=XYZ[n], lw=7, alpha=0.3)
            ax.plot(at, median, "_", color=XYZ[n], ms=11, mew=2, label="xyz"[n])
            if np.isfinite(said).any():
                printed = True
                ax.plot(at, said, "x", color=INK, ms=5, mew=1.3,
                        label="printed" if n == 2 else None)  # fmt: skip
        ax.set(yscale="log", ylabel=f"{'gyro' if effect == 'gyro_bias' else 'accel.'}, {unit}")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
    few = not numbered(sweep)
    axes[-1].set_xticks(x, labels if few else [str(k + 1) for k in x])
    caption = (
        "RMS error about the truth from convergence to the end, what the paper calls STD: median "
        + ("(bar) and central 95\u202f% over seeds" if enough(sweep) else "(bar) over seeds")
        + (", and the paper's single draws (crosses)." if printed else ".")
        + (" Below: heading sigma and R_h in rad." if few else " Below: numbers of the cells.")
        + (" * by evidence." if any("*" in label for label in labels) and few else "")
    )
    title = "Figure 6: error of every bias" if sweep["grid"] == "paper" else "Error of every bias"
    return Drawn(title, caption, figure)


def _against_heading(sweep: Document) -> Drawn:
    """Final error of gyro z against heading sigma, with the bound, for each motion."""
    figure, (ax,) = _canvas(1, 4.4, WIDE)
    cells = [cell for cell in sweep["cells"] if not cell["without_heading"]]
    motions = list(dict.fromkeys(cell["world"]["scenario"] for cell in sweep["cells"]))
    for n, motion in enumerate(motions):
        colour = (XYZ[2], XYZ[0], XYZ[1])[n % 3]
        mine = [cell for cell in cells if cell["world"]["scenario"] == motion]
        for marker, kind, chosen in (("o", "by hand", False), ("D", "by evidence", True)):
            some = [cell for cell in mine if bool(cell["chosen_r_h_rad"]) == chosen]
            sigma = [cell["world"]["heading_sigma_deg"] for cell in some]
            end = [end_of(gyro_z(cell))["rms"] for cell in some]
            if some:
                look: dict[str, Any] = {"ms": 9, "mfc": "none"} if chosen else {"ms": 6}
                ax.plot(sigma, end, marker, color=colour, label=f"{motion}, R_h {kind}", **look)
        limits = sorted({(cell["world"]["heading_sigma_deg"], gyro_z(cell)["final_error"]["bound"])
                         for cell in mine})  # fmt: skip
        if limits:
            ax.plot(*np.array(limits).T, color=colour, lw=1.0, label=f"{motion}, bound")
        bare = [cell for cell in sweep["cells"]
                if cell["without_heading"] and cell["world"]["scenario"] == motion]  # fmt: skip
        if bare:
            ax.axhline(end_of(gyro_z(bare[0]))["rms"], color=colour, lw=1.0, ls=":",
                       label=f"{motion}, no heading")  # fmt: skip
    ax.set(xlabel="heading sigma, deg", ylabel="gyro z, deg/h", yscale="log")
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
    caption = ("Root mean square over seeds of the error of gyro z at the end, and the "
               "Cramér-Rao bound with the filter's own prior.")  # fmt: skip
    return Drawn("What heading does for gyro z", caption, figure)

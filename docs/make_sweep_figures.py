"""Draws the figures of docs/sweep.md, from a hundred seeds; `make docs` runs it. Ten minutes.

Finished cells are kept in the file that is named as an argument, if one is.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from make_figures import GREY, INK, STYLE, XYZ, save

from handcal_sim.sweep.cell import run_chunk
from handcal_sim.sweep.compare import document, end_of, gyro_z
from handcal_sim.sweep.grid import paper, turns, with_evidence
from handcal_sim.sweep.run import Kept, Plan, opened, run

SEEDS = 100
THRESHOLDS = {"deg/h": 50.0, "ug": 500.0, "ppm": 500.0}
Sweep = dict


def swept(kept: Kept) -> tuple[Sweep, Sweep]:
    """The paper's grid with R_h by evidence, and the two motions beside each other."""
    settled = with_evidence([replace(cell, settle=True) for cell in paper()])
    sweeps = []
    with opened("local", os.cpu_count() or 1) as workers:
        for name, cells in (("paper", settled), ("turns", turns())):
            plan = Plan(cells, SEEDS, 0, THRESHOLDS)
            results = run(plan, workers, run_chunk, kept, lambda _: None)
            if None in results:
                raise SystemExit("interrupted")
            sweeps.append(document(name, SEEDS, 0, THRESHOLDS, results))
    return sweeps[0], sweeps[1]


def over_time(sweep: Sweep) -> None:
    """Gyro z in the cells that the paper draws (figures 8, 10, 12, 14 and 16)."""
    cells = [cell for cell in sweep["cells"] if cell["figures"]]
    figure, axes = plt.subplots(1, len(cells), figsize=(11, 2.9), layout="constrained")
    for ax, cell in zip(axes, cells, strict=True):
        low, median, high = (np.array(cell["bands"][k][2]) for k in ("low", "median", "high"))
        ax.fill_between(cell["t"], low, high, color=XYZ[2], alpha=0.2, lw=0)
        ax.plot(cell["t"], median, color=XYZ[2])
        ax.axhline(gyro_z(cell)["truth"], color=INK, lw=0.9, ls="--")
        ax.set(title=cell["group"], xlabel="time, s", ylim=(-1500, 4500))
    axes[0].set_ylabel("gyro z, deg/h")
    save(figure, "sweep-time")


def r_h(sweep: Sweep) -> None:
    """Final error of gyro z over its bound against R_h: online filter and own calibration."""
    groups = [row["group"] for row in sweep["evidence"]]
    figure, axes = plt.subplots(1, len(groups), figsize=(11, 3.0), sharey=True,
                                layout="constrained")  # fmt: skip
    for ax, group in zip(axes, groups, strict=True):
        cells = [cell for cell in sweep["cells"] if cell["group"] == group]
        for cell in cells:
            auto = cell["chosen_r_h_rad"]
            x = auto["median"] if auto else cell["r_h_rad"]
            row = gyro_z(cell)
            for error, colour in ((row["final_error"], XYZ[0]), (row["settled_error"], XYZ[2])):
                ax.plot(x, error["over_bound"], "D" if auto else "o", ms=8 if auto else 6,
                        color=colour, mfc="none" if auto else colour)  # fmt: skip
        ax.axvline(np.radians(cells[0]["world"]["heading_sigma_deg"]), color=GREY, lw=0.8, ls=":")
        ax.axhline(1.0, color=INK, lw=0.8)
        ax.set(title=group, xlabel="R_h, rad", xscale="log", xlim=(0.03, 2.5), ylim=(0.8, 2.0))
    axes[0].set_ylabel("error / bound")
    for colour, name in ((XYZ[0], "online filter"), (XYZ[2], "own calibration")):
        axes[-1].plot([], [], "o", color=colour, label=name)
    axes[-1].plot([], [], "D", color=INK, mfc="none", label="R_h by evidence")
    axes[-1].legend(frameon=False, fontsize=8, loc="upper left")
    save(figure, "sweep-r-h")


def motions(sweep: Sweep) -> None:
    """Final error of gyro z with 21 states, by motion."""
    rows = sweep["in_parallel"]
    sigmas = [row["heading_sigma_deg"] for row in rows]
    headings = ["none" if sigma is None else f"{sigma:g}°" for sigma in sigmas]
    labels = [f"{h}\n{row['r_h'].removesuffix(' rad')}"
              for h, row in zip(headings, rows, strict=True)]  # fmt: skip
    figure, ax = plt.subplots(figsize=(11, 3.2), layout="constrained")
    x = np.arange(len(rows))
    for n, (name, colour) in enumerate((("z-turn", XYZ[0]), ("three-turns", XYZ[2]))):
        ends = [row["scenarios"][name] for row in rows]
        at = x + 0.36 * (n - 0.5)
        ax.bar(at, [e["rms"] for e in ends], 0.34, color=colour, label=name)
        ax.plot(at, [e["bound"] for e in ends], "_", color=INK, ms=14)
    ax.plot([], [], "_", color=INK, ms=14, label="bound")
    ax.set(yscale="log", ylabel="gyro z, deg/h", ylim=(4, 8000))
    ax.set_xticks(x, labels)
    ax.set_xlabel("heading sigma, and R_h in rad")
    ax.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    save(figure, "sweep-motions")


if __name__ == "__main__":
    plt.rcParams.update(STYLE)
    found = swept(Kept(Path(sys.argv[1]) if len(sys.argv) > 1 else None))
    over_time(found[0])
    r_h(found[0])
    motions(found[1])
    for cell in (*found[0]["cells"], *found[1]["cells"]):
        row = gyro_z(cell)
        print(cell["group"], cell["r_h"], {k: round(end_of(row)[k], 3) for k in end_of(row)})

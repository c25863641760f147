"""What the cells of a sweep say of each other. From and to plain documents."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from handcal_sim.sweep.printed import QUANTITIES

Document = Mapping[str, Any]
SCHEMA = "handcal-sim/sweep/1"


def gyro_z(cell: Document) -> Document:
    """The vertical gyro bias, which is what heading is for."""
    row: Document = cell["parameters"][2]
    return row


def end_of(row: Document) -> Document:
    """The final error of handcal's own calibration where there is one, else the online filter's."""
    end: Document = row["settled_error"] or row["final_error"]
    return end


def printed(cells: Iterable[Document]) -> dict[str, dict[str, int]]:
    """How many of the paper's values lie within the central 95 % over seeds, by quantity."""
    out = {name: {"inside": 0, "n": 0} for name in QUANTITIES}
    for cell in cells:
        for row in cell["parameters"]:
            for name in QUANTITIES:
                if row[name]["inside"] is not None:
                    out[name]["n"] += 1
                    out[name]["inside"] += row[name]["inside"]
    return {name: count for name, count in out.items() if count["n"]}


def chosen(cells: Sequence[Document]) -> list[dict[str, Any]]:
    """Each R_h chosen by evidence beside the best one set by hand, of the same group.

    Best by hand: the least RMS of the final error of gyro z over the same seeds and readings.
    """
    rows = []
    for group, members in itertools.groupby(cells, key=lambda cell: cell["group"]):
        every = list(members)
        hand = [cell for cell in every if cell["r_h_rad"] is not None]
        for cell in every:
            if cell["r_h_rad"] is None and hand:
                best = min(hand, key=lambda c: float(end_of(gyro_z(c))["rms"]))
                mine, other = end_of(gyro_z(cell)), end_of(gyro_z(best))
                rows.append({
                    "group": group, "heading_sigma_deg": cell["world"]["heading_sigma_deg"],
                    "r_h_rad": cell["chosen_r_h_rad"], "final_rms": mine["rms"],
                    "best_r_h_rad": best["r_h_rad"], "best_final_rms": other["rms"],
                    "over_best": mine["rms"] / other["rms"], "bound": mine["bound"],
                    "nees": mine["nees"], "best_nees": other["nees"],
                })  # fmt: skip
    return rows


def side_by_side(cells: Sequence[Document]) -> list[dict[str, Any]]:
    """Cells that differ in nothing but the motion: gyro z of each scenario."""
    rows: dict[Any, dict[str, Any]] = {}
    for cell in cells:
        world = {k: v for k, v in cell["world"].items() if k not in ("scenario", "duration_s")}
        same = (repr(sorted(world.items())), cell["r_h"], repr(cell["estimate"]))
        sigma = None if cell["without_heading"] else world["heading_sigma_deg"]
        row = rows.setdefault(
            same, {"heading_sigma_deg": sigma, "r_h": cell["r_h"], "scenarios": {}}
        )
        row["scenarios"].setdefault(cell["world"]["scenario"], end_of(gyro_z(cell)))
    return [row for row in rows.values() if len(row["scenarios"]) > 1]


def document(
    grid: str, seeds: int, seed: int, thresholds: Mapping[str, float], cells: Sequence[Document]
) -> dict[str, Any]:
    """The whole sweep, ready for JSON."""
    return {
        "schema": SCHEMA, "grid": grid, "seeds": seeds, "seed": seed,
        "thresholds": dict(thresholds), "printed": printed(cells), "evidence": chosen(cells),
        "side_by_side": side_by_side(cells), "cells": list(cells),
    }  # fmt: skip

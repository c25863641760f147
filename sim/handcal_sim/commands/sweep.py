"""The command `sweep`. What is slow to import is imported where it is used."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handcal.commands._registry import say
from handcal_sim.commands._progress import progress
from handcal_sim.commands._wrong_use import wrong_use

if TYPE_CHECKING:
    from handcal_sim.sweep.grid import Cell
    from handcal_sim.sweep.run import Plan

PAPER, TURNS = "paper", "turns"
UNITS = ("deg/h", "ug", "ppm")
INTERRUPTED = 130


def sweep(
    grid: Annotated[
        str,
        typer.Option(metavar="paper|turns|FILE.toml", help="What to run: paper 002; the same and "
                     "beside it one turn about each axis; "
                     "or a grid of your own."),
    ] = PAPER,
    seeds: Annotated[int, typer.Option(min=1, help="Monte Carlo runs per cell.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same result.")] = 0,
    choose_r_h: Annotated[
        bool,
        typer.Option("--choose-r-h", help="Add an R_h chosen by evidence to those set by hand."),
    ] = False,
    settle: Annotated[
        bool,
        typer.Option("--settle", help="Also run the full calibration on each run, besides the "
                     "online filter; six times as long. --choose-r-h implies it."),
    ] = False,
    threshold: Annotated[
        str,
        typer.Option(metavar="GYRO,ACCEL[,SCALE]",
                     help="Converged when 20 successive estimates vary by less: deg/h, ug, ppm."),
    ] = "50,500,500",
    executor: Annotated[
        str, typer.Option(metavar="local|dask://HOST:PORT", help="Where to compute: on this "
                     "machine or on a Dask cluster.")
    ] = "local",
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes, with --executor local; one per core if "
                     "not given.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.jsonl", help="Keep finished cells here, and continue from "
                     "them."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Everything as JSON.")
    ] = None,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="The tables as CSV.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="One page with figures and tables."),
    ] = None,
) -> None:  # fmt: skip
    """Monte Carlo over heading noise and the filter's R_h: paper 002, or a grid of your own."""
    from handcal.output import check_outputs
    from handcal.workers import WorkersDied
    from handcal_sim.sweep.compare import document
    from handcal_sim.sweep.run import Plan
    from handcal_sim.sweep.show import console, show

    check_outputs((out, json_file, csv_file, report), (Path(grid),))
    try:
        with wrong_use():
            plan = Plan(cells(grid, choose_r_h, settle), seeds, seed, _thresholds(threshold))
            results = run_plan(plan, executor, jobs or os.cpu_count() or 1, out)
    except WorkersDied as problem:
        say(str(problem))
        raise typer.Exit(1) from None
    finished = [result for result in results if result is not None]
    whole = document(grid, seeds, seed, plan.thresholds, finished)
    if len(finished) == len(results):  # (half a sweep takes no whole one's place)
        _write(whole, json_file, csv_file, report)
    show(whole, console())
    if len(finished) < len(results):
        kept = f"kept in {out}; the same command goes on from them" if out else \
            "lost but for what is shown (--out FILE keeps them)"  # fmt: skip
        say(f"interrupted: {len(finished)} of {len(results)} cells are finished, {kept}")
        raise typer.Exit(INTERRUPTED)


def _write(
    whole: dict[str, Any], json_file: Path | None, csv_file: Path | None, report: Path | None
) -> None:
    from handcal.output import whole as whole_file
    from handcal.output import write_text
    from handcal_sim.sweep.show import write_csv

    if json_file is not None:
        write_text(json_file, json.dumps(whole, indent=1) + "\n")
    if csv_file is not None:
        with whole_file(csv_file) as place:
            write_csv(whole, place)
    if report is not None:
        from handcal_sim.sweep.cell import write_page

        write_page(whole, report)


def cells(grid: str, choose_r_h: bool = False, settle: bool = False) -> list[Cell]:
    """What to run, by the name of a grid or its file. Errors: SimulationError, InputError."""
    from handcal.documents import reading
    from handcal_sim.errors import SimulationError
    from handcal_sim.sweep import grid as sweep_grid

    if grid in (PAPER, TURNS):
        found = sweep_grid.paper() if grid == PAPER else sweep_grid.turns()
    elif grid.endswith(".toml"):
        with reading(Path(grid)):
            found = sweep_grid.read_grid(Path(grid))
    else:
        raise SimulationError(f"--grid {grid}: there are {PAPER}, {TURNS} and FILE.toml")
    if settle or choose_r_h:
        found = [replace(cell, settle=True) for cell in found]
    return sweep_grid.with_evidence(found) if choose_r_h else found


def _thresholds(text: str) -> dict[str, float]:
    from handcal_sim.errors import SimulationError

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not 2 <= len(values) <= 3 or not all(0.0 < value < float("inf") for value in values):
        raise SimulationError(f"--threshold takes GYRO,ACCEL in deg/h and ug, not {text!r}")
    return dict(zip(UNITS, values, strict=False))


def run_plan(plan: Plan, executor: str, jobs: int, out: Path | None) -> list[Any]:
    """The cells of a plan, finished ones from the file; None for each that was interrupted."""
    from handcal.workers import opened
    from handcal_sim.sweep.run import Kept, chunk_of, run

    kept = Kept(out)
    before = sum(kept[plan.key(cell)] is not None for cell in plan.cells)
    if before:
        say(f"{before} of {len(plan.cells)} cells were finished before")
    with (
        opened(executor, jobs) as workers,
        progress(len(plan.cells) * plan.seeds, "runs", "runs") as told,
    ):
        return list(run(plan, workers, chunk_of, kept, told))

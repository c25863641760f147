"""Runs the cells of a sweep on any `concurrent.futures` executor, and keeps finished ones.

Cells are cut into chunks of seeds. A chunk whose process died is given out again; results
depend on seed and numbers alone, so neither the order nor the executor shows in them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handcal.workers import Workers, done
from handcal_sim.errors import SimulationError
from handcal_sim.sweep.grid import Cell, told
from handcal_sim.sweep.printed import QUANTITIES
from handcal_sim.sweep.score import Chunk, bands, beside, chunks, final, spread

SCHEMA = "handcal-sim/sweep-cell/1"
CHUNK = 5
Document = dict[str, Any]
_BEGINNING = f'{{"schema": "{SCHEMA}"'
Task = tuple[int, Sequence[int]]


@dataclass(frozen=True)
class Plan:
    """What is run: each cell with the seeds (seed, 0) to (seed, seeds - 1)."""

    cells: Sequence[Cell]
    seeds: int
    seed: int
    thresholds: Mapping[str, float]

    def key(self, cell: Cell) -> Document:
        """What a cell's result depends on."""
        return {"cell": cell.key, "seeds": self.seeds, "seed": self.seed,
                "thresholds": dict(self.thresholds)}  # fmt: skip


class Kept:
    """Finished cells in a file, one line of JSON each; a line cut off in the middle is none."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self.found: list[Document] = []
        if file is None or not file.exists():
            return
        text = file.read_text(encoding="utf-8", errors="replace")
        for line in text.splitlines():
            try:
                document = json.loads(line)
            except json.JSONDecodeError:
                continue
            if isinstance(document, dict) and document.get("schema") == SCHEMA:
                self.found.append(document)
        cut_off = text.startswith(_BEGINNING) or _BEGINNING.startswith(text)
        if text.strip() and not self.found and not cut_off:
            raise SimulationError(f"{file} holds no cells of a sweep; --out will not overwrite it")
        if text and not text.endswith("\n"):
            with file.open("a", encoding="utf-8") as stream:
                stream.write("\n")

    def __getitem__(self, key: Document) -> Document | None:
        """The cell with this key, None if it has not been finished."""
        return next((d for d in self.found if d["key"] == key), None)

    def add(self, document: Document) -> None:
        """Keep a finished cell, at once."""
        self.found.append(document)
        if self.file is not None:
            try:
                with self.file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(document) + "\n")
            except OSError as problem:
                raise OSError(problem.errno, problem.strerror, str(self.file)) from None


def chunk_of(
    cell: Cell, seed: int, numbers: Sequence[int], thresholds: Mapping[str, float]
) -> Chunk:
    """``run_chunk`` where it is called: who only gives it out need not load the filter first."""
    from handcal_sim.sweep.cell import run_chunk

    return run_chunk(cell, seed, numbers, thresholds)


def run(
    plan: Plan, workers: Workers, work: Callable[..., Chunk], kept: Kept,
    advance: Callable[[int], None],
) -> list[Document | None]:  # fmt: skip
    """Every cell's result in the order of the plan; after an interrupt None for unfinished ones.

    advance: told how many runs have been done since, those of kept cells included.
    """
    results = [kept[plan.key(cell)] for cell in plan.cells]
    tasks: list[Task] = []
    for i, found in enumerate(results):
        if found is None:
            tasks += [(i, numbers) for numbers in chunks(plan.seeds, CHUNK)]
        else:
            advance(plan.seeds)
    pieces: dict[int, list[Chunk]] = {}
    try:
        for (i, numbers), chunk in _computed(plan, workers, work, tasks):
            pieces.setdefault(i, []).append(chunk)
            advance(len(numbers))
            if sum(len(p.numbers) for p in pieces[i]) == plan.seeds:
                document = _again(summary(plan, plan.cells[i], pieces.pop(i)))
                kept.add(document)
                results[i] = document
    except KeyboardInterrupt:
        pass
    return results


def _computed(
    plan: Plan, workers: Workers, work: Callable[..., Chunk], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Chunk]]:
    """Chunks as they are done; those of a process that died are given out again."""

    def submit(executor: Executor, task: Task) -> Future[Chunk]:
        i, numbers = task
        return executor.submit(work, plan.cells[i], plan.seed, numbers, dict(plan.thresholds))

    return done(workers, submit, tasks)


def _again(document: Document) -> Document:
    """As it will be read from the file."""
    again: Document = json.loads(json.dumps(document))
    return again


# ---- what comes of it -------------------------------------------------------------------------


def summary(plan: Plan, cell: Cell, pieces: Sequence[Chunk]) -> Document:
    """A cell's result over its seeds, ready for JSON."""
    pieces = sorted(pieces, key=lambda piece: piece.numbers[0])
    one = pieces[0]
    scores = {name: np.concatenate([p.scores[name] for p in pieces]) for name in one.scores}
    series = np.concatenate([p.series for p in pieces]).astype(float)
    r_h = np.concatenate([p.r_h for p in pieces])
    parameters = []
    for k, (effect, name) in enumerate(one.names):
        row: Document = {"effect": effect, "name": name, "unit": one.units[k],
                         "truth": float(one.truth[k])}  # fmt: skip
        for q, quantity in enumerate(QUANTITIES):
            printed = cell.printed[k][q] if cell.printed and k < len(cell.printed) else None
            row[quantity] = beside(spread(scores[quantity][:, k]), printed)
        errors, sigmas = scores["final_error"][:, k], scores["sigma"][:, k]
        row["final_error"] = final(errors, sigmas, float(one.bound[k]))
        row["settled_error"] = None
        if "settled_error" in scores:
            errors, sigmas = scores["settled_error"][:, k], scores["settled_sigma"][:, k]
            row["settled_error"] = final(errors, sigmas, float(one.bound[k]))
        parameters.append(row)
    return {
        "schema": SCHEMA, "key": plan.key(cell), "group": cell.group, "r_h": cell.r_h,
        "r_h_rad": cell.r_h_rad, "chosen_r_h_rad": spread(r_h) if cell.r_h_rad is None else None,
        "world": asdict(cell.world), "estimate": list(cell.estimate), "filter": told(cell),
        "without_heading": cell.without_heading,
        "figures": list(cell.figures) if cell.figures else None, "parameters": parameters,
        "t": [round(float(t), 4) for t in one.t], "bands": bands(series),
    }  # fmt: skip

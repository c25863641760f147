"""``handcal.simulate`` and ``handcal.sweep``: the commands of these names, called from Python."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from handcal.api import Recording, read
from handcal.api.options import mapping
from handcal.api.words import spoken
from handcal.did_you_mean import did_you_mean
from handcal.types import InputError
from handcal_sim.commands._wrong_use import wrong_use
from handcal_sim.commands.sweep import PAPER, cells, run_plan
from handcal_sim.effects import parted
from handcal_sim.request import Request, simulated

THRESHOLDS = {"deg/h": 50.0, "ug": 500.0, "ppm": 500.0}


@spoken()
def simulate(
    scenario: str,
    *,
    seed: int = 0,
    effects: Mapping[str, Sequence[float] | float] | None = None,
    path: str | Path | None = None,
    **more: Any,
) -> Recording:
    """A recording of a simulated device in a simulated hand ("free-hand", "three-turns", ...).

    effects: {"gyro_scale": [0.01, 0, 0]}, SI, in the order of the catalogue's parameters. path: a
    file (.mcap) to write it to, with what was true beside it. Others as the options of ``handcal
    simulate``, by the names of ``handcal_sim.request.Request``: device="perfect", duration_s=20,
    mag=True, heading=False, ... Errors: InputError.
    """
    from handcal import output
    from handcal.recordings.export import check_ending
    from handcal_sim import foreign, mcap_writer

    known = [f.name for f in fields(Request) if f.name not in ("scenario", "seed", "effects")]
    for name in more:
        if name not in known:
            near = did_you_mean(name, known)
            raise InputError(f"simulate has no option '{name}'.{near} It has: {', '.join(known)}.")
    if path is not None:
        check_ending(Path(path))
        output.check_outputs((Path(path),))
    given = mapping("effects", effects or {}, '{"gyro_scale": [0.01, 0, 0]}')
    own, others = parted([f"{i}={_typed(v)}" for i, v in given.items()])
    more = {n: _typed(v) if isinstance(v, list | tuple) else v for n, v in more.items()}
    with wrong_use(), TemporaryDirectory() as folder:
        world, used = simulated(Request(scenario, seed, effects=own, **more))
        with output.whole(path or Path(folder) / "simulated.mcap") as place:
            if others:
                foreign.write(world, place, others, used)
            else:
                mcap_writer.write(world, place)
        made = read(path or Path(folder) / "simulated.mcap")
    return made if path is not None else replace(made, path=f"{scenario}-{seed}")


def _typed(values: Any) -> str:
    """Numbers as they are typed after an option."""
    return ",".join(map(str, values)) if isinstance(values, Sequence) else str(values)


@spoken()
def sweep(
    grid: str | Path = PAPER,
    *,
    seeds: int = 100,
    seed: int = 0,
    choose_r_h: bool = False,
    settle: bool = False,
    thresholds: Mapping[str, float] | None = None,
    jobs: int | None = None,
    out: str | Path | None = None,
) -> dict[str, Any]:
    """Monte Carlo over heading noise and R_h, "paper", "turns" or the path of a grid's TOML: what
    ``handcal sweep --json`` writes.

    seeds: runs of each cell. thresholds: {"deg/h": 50, "ug": 500, "ppm": 500}, below which 20
    successive estimates have converged. jobs: processes (all cores). out: a file (.jsonl) that
    keeps finished cells. Others as the command's. Errors: InputError, HandcalError.
    """
    from handcal_sim.sweep.compare import document
    from handcal_sim.sweep.run import Plan

    with wrong_use():
        plan = Plan(cells(str(grid), choose_r_h, settle), seeds, seed,
                    THRESHOLDS | dict(thresholds or {}))  # fmt: skip
        kept = None if out is None else Path(out)
        done = run_plan(plan, "local", jobs or os.cpu_count() or 1, kept)
    if any(one is None for one in done):
        raise KeyboardInterrupt
    return document(str(grid), seeds, seed, plan.thresholds, done)

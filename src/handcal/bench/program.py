"""Figures of the program as a whole: reading, starting, memory, and a whole sweep."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from handcal.bench.timing import (
    Figure,
    Found,
    Row,
    Skipped,
    Target,
    Tick,
    in_turns,
    peer,
    profile,
    run_handcal,
    run_python,
    side,
)
from handcal.recordings.inputs import load

READ_S = 600.0
HOUR_S, TEN_S = 3600.0, 600.0
RUNS = 1300


def simulated(scenario: str, path: Path, *options: str) -> Path:
    """A recording of that scenario in a file."""
    run_handcal("simulate", scenario, "--seed", "0", *options, "-o", path)
    return path


def reading(folder: Path, script: list[str | Path], rounds: int, tick: Tick) -> Found:
    """Imu messages read into a recording, beside the mcap library passing over them."""
    raw = simulated("static", folder / "static.mcap", "--no-heading", "--duration", f"{READ_S:g}")
    path = folder / "imu.mcap"
    run_handcal("import", raw, "-o", path)
    count = len(load(path).imu.t)

    def work() -> int:
        load(path)
        return count

    with peer([*script, path]) as other:
        cpu, _ = in_turns([side(work), other], rounds, tick)
    share = 100.0 * cpu[:, 1] / cpu[:, 0]
    title = "Imu messages read, against the mcap library's undecoded ones"
    return [
        Figure("reading", "Imu messages read", "thousand/s", 1e-3 / cpu[:, 0], "cpu"),
        Figure("reading", title, "%", share, "cpu", Target(75.0, False)),
    ]


# What is waited for, what its libraries take to load in the same round, and what is asked beyond.
STARTS: tuple[tuple[str, tuple[str, ...], str, float], ...] = (
    ("handcal --help", ("--help",), "typer, typer.rich_utils", 0.05),
    ("calibrate 30 s", ("calibrate", "{}"), "numpy, scipy.linalg, numba", 0.4),
)


def starting(folder: Path, rounds: int, tick: Tick) -> Found:
    """What a person waits for at the start: the help, and a first and a second calibration."""
    path = simulated("three-turns", folder / "turns.mcap")
    first, wall, cpu = np.empty(rounds), np.empty((2, rounds, 2)), np.empty((2, rounds))
    for _, arguments, modules, _ in STARTS:
        run_handcal(*(a.format(path) for a in arguments))
        run_python(f"import {modules}")
    for r in range(rounds):
        tick(f"round {r + 1} of {rounds}")
        with TemporaryDirectory() as cache:
            first[r] = run_handcal("calibrate", path, cache=Path(cache)).wall
        for k, (_, arguments, modules, _) in enumerate(STARTS):
            ran = run_handcal(*(a.format(path) for a in arguments))
            wall[k, r] = ran.wall, run_python(f"import {modules}").wall
            cpu[k, r] = ran.cpu
    title = "calibrate 30 s, nothing compiled yet"
    found: Found = [Figure("start", title, "s", first, "wall", Target(6.0, True))]
    for (title, _, modules, most), (own, loading), used in zip(
        STARTS, wall.transpose(0, 2, 1), cpu, strict=True
    ):
        found.append(Figure("start", title, "s", own.copy(), "wall"))
        beyond = f"{title}, beyond importing {modules}"
        found.append(Figure("start", beyond, "s", own - loading, "wall", Target(most, True)))
        found.append(Figure("start", f"{title}, over importing these", "x", own / loading, "wall"))
        if not np.isnan(used).any():
            found.append(Figure("start", f"{title}: of the processor", "s", used, "cpu"))
    for title, arguments, _, _ in STARTS:
        ran = run_handcal(*(a.format(path) for a in arguments), sampled=True)
        found += profile("start", title, ran)
    return found


# Long recordings: title, command, seconds simulated, processor seconds and megabytes asked at most.
LONG = (
    ("calibrate, one hour at 100 Hz, heading at 50 Hz", "calibrate", HOUR_S, 15.0, 400.0),
    ("explain, ten minutes of the same", "explain", TEN_S, 60.0, 1000.0),
)


def long_recordings(folder: Path, rounds: int, tick: Tick) -> Iterator[Row]:
    """Processor time and the most memory that a long recording takes, in one thread."""
    for title, command, seconds, most, megabytes in LONG:
        tick(title)
        options = ("--duration", f"{seconds:g}", "--heading-rate", "50")
        path = simulated("free-hand", folder / "long.mcap", *options)
        # (once beforehand, so that nothing is compiled in what is measured)
        ran = [run_handcal(command, path, sampled=True) for _ in range(1 + rounds)][1:]
        path.unlink()
        used, memory = np.array([r.cpu for r in ran]), np.array([r.memory for r in ran])
        if np.isnan(memory).any():
            yield Skipped("memory", title, "this system does not tell.")
            continue
        yield Figure("memory", title, "s", used, "cpu", Target(most, True))
        yield Figure("memory", f"{title}: memory", "MB", memory, "", Target(megabytes, True))
        yield from profile("memory", title, ran[-1])


def sweeping(rounds: int, tick: Tick) -> Found:
    """The whole grid of paper 002 with 100 seeds, on one core and on two."""
    title = f"paper grid, {RUNS:,} runs, on two cores"
    if (os.cpu_count() or 1) < 2:
        return [Skipped("sweep", title, "this machine has one core.")]
    command = ("sweep", "--grid", "paper", "--seeds", "100", "--jobs")
    run_handcal(*command[:-3], "--seeds", "1", "--jobs", "1")
    wall = np.empty((rounds, 2))
    for r in range(rounds):
        tick(f"round {r + 1} of {rounds}")
        for k, jobs in enumerate(("1", "2")):
            wall[r, k] = run_handcal(*command, jobs).wall
    ratio = wall[:, 0] / wall[:, 1]
    return [
        Figure("sweep", title, "s", wall[:, 1], "wall", Target(5.0, True)),
        Figure("sweep", "paper grid, one core over two", "x", ratio, "wall", Target(1.7, False)),
    ]

"""Figures of the filter and the smoother, beside other programs on the same readings."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handcal.bench.timing import (
    MEGA,
    Figure,
    Found,
    Missing,
    Row,
    Side,
    Skipped,
    Target,
    Tick,
    in_turns,
    peer,
    side,
)
from handcal.earth import local_earth
from handcal.estimate.assemble import build
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of as explained_case
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.filter import empty_track, initial_state, run_compiled, run_filterpy
from handcal.estimate.linear import Linear, linearise_about
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.smoother import smoothed_mean
from handcal.estimate.start import Start, from_rest
from handcal.estimate.trajectory import epochs, trajectory_of
from handcal.observations import Observation, Rows, catalogue, pseudo_times
from handcal.types import Array, Imu, IntArray, Recording, Series

LEVELS = {
    "gyro_noise": math.radians(0.005), "accel_noise": 2.5e-3, "position_noise": 0.02,
    "velocity_noise": 0.02, "heading_noise": math.radians(15.0),
    # (no hand sways, but the observation knows these)
    "sway": 1e-3, "sway_per_rate": 1e-3, "sway_time": 1.0,
}  # fmt: skip
# filterpy is slow: it gets the first so many samples.
FILTERPY_SAMPLES = 300
LENGTHS_S = (10.0, 100.0, 1000.0, 10000.0)
NOTHING: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Case:
    """A recording as a problem of 15 states, and where its filter starts."""

    problem: Problem
    start: Start


def case_of(recording: Recording, rate: float | None = None) -> Case:
    """Position, velocity and heading observed at every sample, or so many times a second."""
    known = catalogue()
    white = replace(known["fixed_position"], markov=None, markov_residual=0, wandering=())
    t = pseudo_times(recording, rate)
    still, yaw = np.zeros((len(t), 3)), _yaw_at(recording, t)[:, None]
    observed: list[tuple[Observation, Rows, tuple[tuple[str, str, float], ...]]] = [
        (white, Rows(t, still), ()),
        (known["zero_velocity"], Rows(t, still), ()),
        (known["heading"], Rows(t, yaw), ()),
    ]
    problem = build(recording, (), observed, *local_earth(None))
    return Case(problem, from_rest(recording, float(yaw[0, 0]), 0.1, np.zeros((0, 2))))


def _yaw_at(recording: Recording, t: Array) -> Array:
    """The recorded heading at times t, without steps, rad."""
    heading = recording.streams["heading"]
    return np.interp(t, heading.t, np.unwrap(heading.value[:, 0]))


def filtering(case: Case, engine: Callable[..., object], stop: int | None = None) -> Side:
    """The filter over a case with one of the engines; a step is an IMU sample."""
    problem = case.problem
    noise, state = noise_arrays(problem, LEVELS), initial_state(problem, case.start, LEVELS)
    track = empty_track(problem, NOTHING)

    def work() -> int:
        engine(problem, noise, state, track, stop)
        return (stop or len(problem.nodes.t)) - 1

    return side(work)


def linearised(case: Case) -> Linear:
    """The case about what the filter finds."""
    problem = case.problem
    track = empty_track(problem, epochs(problem))
    state = initial_state(problem, case.start, LEVELS)
    state = run_compiled(problem, noise_arrays(problem, LEVELS), state, track)
    nominal = trajectory_of(problem, track, state.bg, state.ba, state.extras)
    return linearise_about(problem, case.start, nominal)


def smoothing(case: Case, steps: int | None = None) -> Side:
    """One round of calibrate's smoother: integrate, linearise, filter, and back again.

    steps: what a round counts as; an epoch is one, if not given.
    """
    linear = linearised(case)

    def work() -> int:
        again = linearise_about(linear.problem, linear.start, linear.trajectory)
        smoothed_mean(again, LEVELS)
        return steps or len(linear.t)

    return side(work)


def against_dense(case: Case, peers: Path, work: Path, rounds: int, tick: Tick) -> Found:
    """The filter's time for a sample, and that over dense C++ that only predicts and updates."""
    group = "filter"
    found: Found = []
    with ExitStack() as stack:
        sides = [filtering(case, run_compiled)]
        try:
            program = _compiled(peers / "dense.cpp", work)
            sides += [stack.enter_context(peer([program, how])) for how in ("vectors", "plain")]
        except Missing as problem:
            found.append(Skipped(group, "filter over dense C++", str(problem)))
        cpu, _ = in_turns(sides, rounds, tick)
    title = "filter, 15 states, 6-dim update and heading at every sample"
    found.insert(0, Figure(group, title, "us", MEGA * cpu[:, 0], "cpu"))
    if len(sides) > 1:
        ratios = cpu[:, :1] / cpu[:, 1:]
        found += [
            Figure(group, "dense C++, predict and 6-dim update", "us", MEGA * cpu[:, 1], "cpu"),
            Figure(group, "filter over dense C++", "x", ratios[:, 0], "cpu", Target(2.0, True)),
            Figure(group, "filter over dense C++ in plain loops", "x", ratios[:, 1], "cpu"),
        ]  # fmt: skip
    return found


def epochs_against_dense(
    recording: Recording, peers: Path, work: Path, rounds: int, tick: Tick
) -> Found:
    """Explain's pass over a whole recording, epoch by epoch, over dense C++ for each sample."""
    begun = started(explained_case(recording))
    reduction, samples = reduce(begun.linear), len(recording.imu.t) - 1

    def whole() -> int:
        reduced_pass(reduction, begun.levels)
        return samples

    with peer([_compiled(peers / "dense.cpp", work), "vectors"]) as dense:
        cpu, _ = in_turns([side(whole), dense], rounds, tick)
    text = f"explain's pass over {samples:,} samples"
    return [
        Figure("epochs", text, "ms", 1e-3 * MEGA * samples * cpu[:, 0], "cpu"),
        Figure("epochs", f"{text}, over dense C++", "x", cpu[:, 0] / cpu[:, 1], "cpu",
               Target(1.0, True)),
    ]  # fmt: skip


def _compiled(source: Path, folder: Path) -> Path:
    """The program made of a C++ file for this very processor. Raises Missing."""
    if not source.is_file():
        raise Missing(no_peers(source.parent))
    named = os.environ.get("CXX")
    compiler = shutil.which(named) if named else shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        raise Missing("there is no C++ compiler (g++, clang++ or the one that CXX names).")
    program = folder / "dense"
    command = [compiler, "-O3", "-march=native", "-w", str(source), "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Missing(f"{Path(compiler).name} could not compile {source.name}.")
    return program


def no_peers(folder: Path) -> str:
    """Why nothing can be compared."""
    return f"there are no peer scripts in {folder}; handcal's sources have them (--peers DIR)."


def against_filterpy(case: Case, rounds: int, tick: Tick) -> Found:
    """The same equations, one step at a time on filterpy's KalmanFilter."""
    stop = min(FILTERPY_SAMPLES, len(case.problem.nodes.t))
    sides = [filtering(case, run_compiled), filtering(case, run_filterpy, stop)]
    cpu, _ = in_turns(sides, rounds, tick)
    ratio = cpu[:, 1] / cpu[:, 0]
    return [Figure("filterpy", "filterpy over filter", "x", ratio, "cpu", Target(10.0, False))]


def against_pyins(case: Case, script: list[str | Path], rounds: int, tick: Tick) -> Found:
    """pyins' feedback filter with position and velocity at every sample."""
    with peer(script) as other:
        cpu, _ = in_turns([filtering(case, run_compiled), other], rounds, tick)
    ratio = cpu[:, 1] / cpu[:, 0]
    return [
        Figure("pyins", "pyins, updates at every sample", "us", MEGA * cpu[:, 1], "cpu"),
        Figure("pyins", "pyins over filter", "x", ratio, "cpu", Target(1000.0, False)),
    ]


def against_gtsam(case: Case, script: list[str | Path], rounds: int, tick: Tick) -> Found:
    """An iteration of GTSAM's batch smoother beside a round of handcal's."""
    with peer(script) as other:
        cpu, wall = in_turns([smoothing(case), other], rounds, tick)
    return [
        Figure("gtsam", "smoother, one round, each epoch", "us", MEGA * cpu[:, 0], "cpu"),
        Figure("gtsam", "GTSAM's smoother, one iteration", "us", MEGA * cpu[:, 1], "cpu"),
        Figure("gtsam", "GTSAM over smoother", "x", cpu[:, 1] / cpu[:, 0], "cpu",
               Target(1.0, False)),
        Figure("gtsam", "GTSAM over smoother, by the clock", "x", wall[:, 1] / wall[:, 0], "wall",
               Target(1.0, False)),
    ]  # fmt: skip


def linear_cost(recording: Recording, rounds: int, tick: Tick) -> Iterator[Row]:
    """How much more a sample of a long recording costs than one of a short recording."""
    cases = [case_of(repeated(recording, length), 10.0) for length in LENGTHS_S]
    for title, made in (("filter", _filtered), ("smoother", _smoothed)):
        tick(title)
        sides = [made(case) for case in cases]
        cpu, _ = in_turns(sides, rounds, tick)
        spread = 100.0 * (cpu.max(axis=1) / cpu.min(axis=1) - 1.0)
        text = f"{title}: dearest over cheapest sample, {LENGTHS_S[0]:g} to {LENGTHS_S[-1]:,.0f} s"
        yield Figure("linear", text, "%", spread, "cpu", Target(15.0, True))
        for length, us in zip(LENGTHS_S, MEGA * cpu.T, strict=True):
            yield Figure("linear", f"{title}, a sample of {length:,.0f} s", "us", us, "cpu")


def _filtered(case: Case) -> Side:
    return filtering(case, run_compiled)


def _smoothed(case: Case) -> Side:
    return smoothing(case, len(case.problem.nodes.t) - 1)


def repeated(recording: Recording, seconds: float) -> Recording:
    """The readings over and over, for so long: as much work as a recording of that length."""
    imu = recording.imu
    n = round(seconds * recording.rate_hz) + 1
    at = np.arange(n) % (len(imu.t) - 1)
    t = np.arange(n) / recording.rate_hz
    yaw = _yaw_at(recording, imu.t)
    return Recording(
        recording.path,
        Imu(t, imu.gyro[at], imu.accel[at], imu.valid[at]),
        {"heading": Series(t, np.angle(np.exp(1j * yaw[at]))[:, None])},
    )


def write_readings(case: Case, path: Path) -> None:
    """The readings and noise levels as arrays, for the peers."""
    recording = case.problem.recording
    imu = recording.imu
    yaw = _yaw_at(recording, imu.t)
    arrays = {"t": imu.t, "gyro": imu.gyro, "accel": imu.accel, "yaw": yaw}
    levels = {name: np.array(level) for name, level in LEVELS.items()}
    np.savez(path, allow_pickle=False, **arrays, **levels)

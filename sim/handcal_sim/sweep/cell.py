"""One cell of a sweep: its world simulated, filtered, scored. It sees both sides.

The truth is simulated once without noise and shared by all seeds, as far as it is the same
for all; each run adds white noise to the readings and headings. What a run draws depends on
the seed, its world and its number alone, so that neither the order of runs nor the
processes they run in make a difference, and filters of one world get the same readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from handcal import output
from handcal.compiled import so3
from handcal.compiled.kernel import BASE
from handcal.earth import local_earth
from handcal.effects import select
from handcal.estimate.assemble import build
from handcal.estimate.consistency import bound
from handcal.estimate.derivatives import relinearised
from handcal.estimate.filter import State, Track, empty_track, initial_state, run_compiled
from handcal.estimate.linear import linearise_about
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.smoother import forward, relinearise
from handcal.estimate.start import Start
from handcal.estimate.trajectory import Trajectory, epochs, trajectory_of
from handcal.observations import Observation, Rows, catalogue
from handcal.types import Array, Imu, InputError, IntArray, Recording
from handcal_sim.phone import DEG, DEG_PER_HOUR, MG
from handcal_sim.scenario import World as Simulated
from handcal_sim.sweep.grid import NO_HEADING_RAD, Cell, World, noise_key
from handcal_sim.sweep.score import Chunk, scores
from handcal_sim.sweep.world import (
    angle_sigma,
    common,
    densities,
    injected,
    noise,
    same_for_all,
    simulated,
)

KINDS = ("fixed_position", "zero_velocity", "heading")
HEADING = KINDS.index("heading")
NO_SWAY = {"sway": 1e-3, "sway_per_rate": 1e-3, "sway_time": 1.0}
UNKNOWN_RAD, KNOWN_RAD = 10.0, 1e-6
R_H_LIMITS = (0.005, 20.0)
SERIES_POINTS = 151
UNITS = {"rad/s": ("deg/h", 1.0 / DEG_PER_HOUR), "m/s^2": ("ug", 1e3 / MG), "1": ("ppm", 1e6)}


@dataclass(frozen=True)
class Scene:
    """A world without its noise, ready for the filter.

    t (n,) s; readings (n, 6), yaw (m,) rad: without noise; start: true; problem: of those
    readings, its effects not linearised; truth: at the epochs, of all that is estimated.
    """

    t: Array
    readings: Array
    yaw: Array
    start: Start
    problem: Problem
    truth: Trajectory
    heading_rows: IntArray


@dataclass(frozen=True)
class Run:
    """Estimates x (n, m) at the samples, sigma (m,) at the end, R_h in rad, truth (m,); SI.

    Parameters are gyro biases, accelerometer biases, then those of `estimate`. settled:
    estimates and sigmas (m,) of handcal's own calibration, where that was asked for.
    """

    x: Array
    sigma: Array
    r_h: float
    truth: Array
    settled: tuple[Array, Array] | None


def run_chunk(
    cell: Cell, seed: int, numbers: Sequence[int], thresholds: Mapping[str, float]
) -> Chunk:
    """The runs of these numbers; thresholds of the convergence rule by unit."""
    scene = shared_scene(cell)
    shown = _shown(scene.problem)
    factor = np.array([f for _, f in shown])
    threshold = np.array([thresholds.get(unit, math.inf) for unit, _ in shown])
    truth = factor * _parameters(scene.truth)
    rows: dict[str, list[Array]] = {}
    r_h, series = [], []
    at = np.linspace(0, len(scene.t) - 1, min(SERIES_POINTS, len(scene.t))).round().astype(int)
    for number in numbers:
        one = run(cell, seed, number)
        row = scores(scene.t, factor * one.x, factor * one.truth, threshold)
        row["sigma"] = factor * one.sigma
        if one.settled is not None:
            row["settled_error"] = factor * (one.settled[0] - one.truth)
            row["settled_sigma"] = factor * one.settled[1]
        for name, values in row.items():
            rows.setdefault(name, []).append(values)
        r_h.append(one.r_h)
        series.append((factor * one.x[at]).astype(np.float32))
    limit = np.sqrt(factor**2 * np.diag(bound_of(cell))[9:])
    names = tuple((s.owner, s.name) for s in scene.problem.slots)
    names = (*((f"{sensor}_bias", a) for sensor in ("gyro", "accel") for a in "xyz"), *names)
    return Chunk(
        tuple(numbers), names, tuple(u for u, _ in shown), truth, limit,
        {name: np.array(values) for name, values in rows.items()},
        np.array(r_h), scene.t[at], np.array(series),
    )  # fmt: skip


def run(cell: Cell, seed: int, number: int) -> Run:
    """One run. With effects, the filter is run again about its own estimates.

    (1 % of a bias of 60 mg is 0.6 mg.)
    """
    rng = np.random.default_rng([seed, noise_key(cell.world), number])
    scene = shared_scene(cell)
    if not same_for_all(cell.world):
        scene = _scene(cell, rng)
    problem = noisy(scene, cell.world, rng)
    start = drawn_start(scene.start, rng) if cell.draw_start else scene.start
    if cell.estimate:
        problem = _linearised(problem, np.zeros(problem.constants), np.zeros(3), np.zeros(3))
    r_h = chosen_r_h(cell, problem, start) if cell.r_h_rad is None else cell.r_h_rad
    record = epochs(problem)
    state, track = filtered(cell, problem, start, r_h, record)
    if cell.estimate:
        problem = _linearised(problem, state.extras, state.bg, state.ba)
        state, track = filtered(cell, problem, start, r_h, record)
    sampled = np.searchsorted(problem.nodes.t[record], scene.t)
    x = np.hstack([track.bg, track.ba, track.extras])[sampled]
    end = settled(cell, problem, start, r_h, state, track) if cell.settle else None
    return Run(x, np.sqrt(np.diag(state.P)[9:]), r_h, _parameters(scene.truth), end)


def settled(
    cell: Cell, problem: Problem, start: Start, r_h: float, state: State, track: Track
) -> tuple[Array, Array]:
    """handcal's own calibration: the filter about a fixed trajectory, until that settles.

    Estimates and sigmas (m,) at the end. The online filter takes a little of its noise for
    signal, as if yaw showed without heading (docs/honesty.md); this does not.
    """
    levels = _levels(cell, r_h)
    nominal = trajectory_of(problem, track, state.bg, state.ba, state.extras)
    linear, _, _ = relinearise(linearise_about(problem, start, nominal), levels)
    last = forward(linear, levels, keep=False)
    value = _parameters(linear.trajectory) + last.x[-1][9:]
    return value, np.sqrt(np.diag(last.P[-1])[9:])


def filtered(
    cell: Cell, problem: Problem, start: Start, r_h: float, record: IntArray
) -> tuple[State, Track]:
    """The online filter over a problem with this R_h (rad)."""
    levels = _levels(cell, r_h)
    track = empty_track(problem, record)
    state = initial_state(problem, start, levels)
    return run_compiled(problem, noise_arrays(problem, levels), state, track), track


def chosen_r_h(cell: Cell, problem: Problem, start: Start) -> float:
    """The R_h (rad) under which the filter predicts the headings best.

    That is the maximum of their evidence, the sum of the log predictive densities of the
    innovations, over log R_h: what the readings say themselves of their noise.
    """
    from scipy.optimize import minimize_scalar  # (slow to import, and seldom asked for)

    nothing = np.zeros(0, dtype=np.int64)

    def cost(log_r_h: float) -> float:
        _, track = filtered(cell, problem, start, math.exp(log_r_h), nothing)
        return -float(track.loglik[problem.nodes.kind == HEADING].sum())

    limits = tuple(math.log(r) for r in R_H_LIMITS)
    found = minimize_scalar(cost, bounds=limits, method="bounded", options={"xatol": 0.01})
    return math.exp(float(found.x))


def bound_of(cell: Cell, wrapped: bool = True) -> Array:
    """Posterior Cramer-Rao bound (N, N) at the end, with true noise and the filter's prior.

    Without heading, the heading counts as little as in the filter. wrapped: an angle is read,
    which at 60 deg tells a little less than an unbounded number with that noise would.
    """
    return _bound(common(cell), cell.without_heading, wrapped)


@lru_cache(maxsize=32)
def _bound(cell: Cell, without: bool, wrapped: bool) -> Array:
    scene = shared_scene(cell)
    sigma = max(cell.world.heading_sigma_deg * DEG, 1e-4)
    if without:
        sigma = NO_HEADING_RAD
    elif wrapped:
        sigma = angle_sigma(sigma) if sigma > 0.1 else sigma
    limit: Array = bound(scene.problem, scene.start, scene.truth, _levels(cell, sigma))[-1]
    return limit


def shared_scene(cell: Cell) -> Scene:
    """The scene of a cell; where each run has a motion of its own, an example of it."""
    return _shared(common(cell))


@lru_cache(maxsize=32)
def _shared(cell: Cell) -> Scene:
    return _scene(cell, np.random.default_rng(noise_key(cell.world)))


def _scene(cell: Cell, rng: np.random.Generator) -> Scene:
    world = simulated(cell.world, rng)
    t, readings = world.imu.stamps, world.imu.values
    heading = world.streams["heading"]
    imu = Imu(
        t, np.ascontiguousarray(readings[:, :3]), np.ascontiguousarray(readings[:, 3:]),
        np.ones(len(t), dtype=bool),
    )  # fmt: skip
    at_rest = np.zeros((len(t), 3))
    rows = (Rows(t, at_rest), Rows(t, at_rest), Rows(heading.stamps, heading.values))
    observed = [(kind, row, ()) for kind, row in zip(_observations(), rows, strict=True)]
    effects = select(cell.estimate)
    for effect in effects:
        if effect.process is not None or effect.outliers or effect.levels:
            raise InputError(f"A sweep cannot estimate {effect.id}: it is noise, not a constant.")
    recording = Recording("simulated", imu)
    problem = build(recording, effects, observed, *local_earth(None), linearised=False)
    return Scene(
        t, readings, heading.values[:, 0], _start(cell, world), problem,
        _truth(problem, world), np.flatnonzero(problem.nodes.kind == HEADING),
    )  # fmt: skip


def _observations() -> tuple[Observation, ...]:
    """The paper's: the held point is where it was, but for white noise (no hand sways)."""
    known = catalogue()
    white: dict[str, Any] = {"markov": None, "markov_residual": 0, "wandering": None}
    return (replace(known[KINDS[0]], **white), known[KINDS[1]], known[KINDS[2]])


def _start(cell: Cell, world: Simulated) -> Start:
    """The true start, with the sigmas that the filter is told."""
    heading = cell.start_heading_deg * DEG
    return Start(
        world.truth.position[0], world.truth.velocity[0], world.truth.C_nb[0], None,
        position_sigma=cell.position_m, velocity_sigma=cell.velocity_m_s,
        tilt_sigma=max(cell.start_tilt_deg * DEG, KNOWN_RAD),
        yaw_sigma=min(max(heading, KNOWN_RAD), UNKNOWN_RAD),
        bias_sigma=np.repeat([cell.gyro_prior_deg_s * DEG, cell.accel_prior], 3),
    )  # fmt: skip


def drawn_start(true: Start, rng: np.random.Generator) -> Start:
    """A start whose error follows the prior that the filter is told."""
    sigma = np.array([true.tilt_sigma, true.tilt_sigma, true.yaw_sigma])
    return replace(
        true,
        p_n=true.p_n + true.position_sigma * rng.standard_normal(3),
        v_n=true.v_n + true.velocity_sigma * rng.standard_normal(3),
        C_nb=so3.matrix_exp(sigma * rng.standard_normal(3)) @ true.C_nb,
    )


def _truth(problem: Problem, world: Simulated) -> Trajectory:
    node = epochs(problem)
    at = np.searchsorted(world.t, problem.nodes.t[node]).clip(0, len(world.t) - 1)
    true, values = world.truth, injected(world)
    biases = [[values[f"{s}_bias", a] for a in "xyz"] for s in ("gyro", "accel")]
    return Trajectory(
        node, true.position[at], true.velocity[at], np.ascontiguousarray(true.C_nb[at]),
        np.array(biases[0]), np.array(biases[1]),
        np.array([values.get((s.owner, s.name), 0.0) for s in problem.slots]),
        np.zeros((len(node), 0)),
    )  # fmt: skip


def noisy(scene: Scene, world: World, rng: np.random.Generator) -> Problem:
    """The scene's problem with the noise of one run on its readings and headings."""
    hiss, error = noise(world, len(scene.t), len(scene.yaw), rng)
    readings, heading = scene.readings + hiss, so3.wrap(scene.yaw + error)
    gyro, accel = np.ascontiguousarray(readings[:, :3]), np.ascontiguousarray(readings[:, 3:])
    recording = scene.problem.recording
    recording = replace(recording, imu=replace(recording.imu, gyro=gyro, accel=accel))
    nodes = scene.problem.nodes
    z = nodes.z.copy()
    z[scene.heading_rows, 0] = heading[: len(scene.heading_rows)]
    if len(nodes.t) != len(scene.t):
        at = [np.interp(nodes.t, scene.t, readings[:, k]) for k in range(6)]
        gyro, accel = np.stack(at[:3], axis=1), np.stack(at[3:], axis=1)
    nodes = nodes._replace(gyro=gyro, accel=accel, z=z)
    return replace(scene.problem, recording=recording, nodes=nodes)


def _linearised(problem: Problem, constants: Array, bg: Array, ba: Array) -> Problem:
    """Effects about these values; their derivatives averaged, lest noise pose as motion."""
    none = np.zeros_like(problem.recording.imu.gyro)
    return relinearised(problem, constants, bg, ba, np.hstack([none, none]))


def _levels(cell: Cell, r_h: float) -> dict[str, float]:
    gyro, accel = densities(cell.world)
    return {
        "gyro_noise": gyro, "accel_noise": accel,
        "position_noise": cell.position_m, "velocity_noise": cell.velocity_m_s,
        "heading_noise": r_h, **NO_SWAY,
    }  # fmt: skip


def _parameters(truth: Trajectory) -> Array:
    return np.concatenate([truth.bg, truth.ba, truth.constants])


def _shown(problem: Problem) -> list[tuple[str, float]]:
    """Unit and factor from SI of each parameter."""
    units = ["rad/s"] * 3 + ["m/s^2"] * 3 + [s.unit for s in problem.slots]
    assert len(units) == problem.size - BASE + 6
    return [UNITS.get(unit, (unit, 1.0)) for unit in units]


def write_page(sweep: Mapping[str, Any], file: str | Path) -> None:
    """A whole sweep as one HTML page; nothing in it needs a network."""
    import matplotlib as mpl

    import handcal
    from handcal.show import drawing
    from handcal.show.html_page import page as rendered
    from handcal_sim.sweep import page

    with mpl.rc_context(drawing.RC):
        plots = {
            section: [
                drawing.Plot(d.title, d.caption, drawing.svg(d.figure, f"sweep-{section}-{n}"))
                for n, d in enumerate(drawn)
            ]
            for section, drawn in page.figures(sweep).items()
        }
    context = page.context(sweep) | {"plots": plots, "version": handcal.__version__}
    output.write_text(file, rendered("sweep.html.j2", context))

"""A world that obeys the filter's own model, for judging its consistency.

The motion is the simulator's truth; sensor noise, start errors, biases and the errors of
the pseudo-observations are drawn from exactly the distributions that the filter assumes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal.compiled import so3
from handcal.earth import local_earth
from handcal.estimate import smoother
from handcal.estimate.assemble import build
from handcal.estimate.filter import empty_track, initial_state, run_compiled
from handcal.estimate.linear import Linear, linearise_about
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.start import Start, levelled
from handcal.estimate.trajectory import Trajectory, epochs, trajectory_of
from handcal.observations import Rows, catalogue
from handcal.types import Array, Imu, Recording
from handcal_sim import simulate
from handcal_sim.motion import Start as Pose
from handcal_sim.phone import perfect_phone

LEVELS = {
    "gyro_noise": math.radians(0.01),
    "accel_noise": 2.5e-3,
    "position_noise": 0.02,
    "velocity_noise": 0.02,
    "heading_noise": math.radians(5.0),
    # not used without a Markov sway, but named by the observation
    "sway": 1e-3,
    "sway_per_rate": 1e-3,
    "sway_time": 1.0,
}
GYRO_BIAS = math.radians(1.0)
ACCEL_BIAS = 0.6
TILT = math.radians(1.0)
YAW = math.radians(10.0)
VELOCITY = 0.05
POSITION = 0.02
RATE = 20.0


@dataclass(frozen=True)
class World:
    """Truth at the epochs, and the problem with the start that the filter is given."""

    problem: Problem
    start: Start
    truth: Trajectory


def motion(scenario: str) -> tuple[Array, Array, Array, Array]:
    """Times (n,), true rate and force (n, 3) at 100 Hz, and C_nb (n, 3, 3), of a still hand."""
    world = simulate(scenario, seed=0, phone=perfect_phone(), start=Pose(), sway=0.0)
    return world.t, world.truth.omega, world.truth.f, world.truth.C_nb


def draw(truth: tuple[Array, Array, Array, Array], seed: int) -> World:
    """One realisation."""
    rng = np.random.default_rng(seed)
    t, omega, force, C = truth
    n, fs = len(t), 1.0 / float(np.median(np.diff(t)))
    bg, ba = GYRO_BIAS * rng.normal(size=3), ACCEL_BIAS * rng.normal(size=3)
    gyro = omega + bg + LEVELS["gyro_noise"] * math.sqrt(fs) * rng.normal(size=(n, 3))
    accel = force + ba + LEVELS["accel_noise"] * math.sqrt(fs) * rng.normal(size=(n, 3))
    recording = Recording("model world", Imu(t, gyro, accel, np.ones(n, dtype=bool)))
    k = np.flatnonzero(np.diff(np.floor(t * RATE + 1e-9), prepend=-1))
    yaw = so3.yaw_of(C[k]) + LEVELS["heading_noise"] * rng.normal(size=len(k))
    z = {
        "fixed_position": LEVELS["position_noise"] * rng.normal(size=(len(k), 3)),
        "zero_velocity": LEVELS["velocity_noise"] * rng.normal(size=(len(k), 3)),
        "heading": so3.wrap(yaw)[:, None],
    }
    white = replace(catalogue()["fixed_position"], markov=None, markov_residual=0)
    observed = [
        (white if kind == "fixed_position" else catalogue()[kind], Rows(t[k], rows), ())
        for kind, rows in z.items()
    ]
    problem = build(recording, (), observed, *local_earth(None))
    node = epochs(problem)
    zero = np.zeros((len(node), 3))
    at = Trajectory(node, zero, zero, C[node], bg, ba, np.zeros(0), np.zeros((len(node), 0)))
    return World(problem, _start(rng, C[0], bg, ba), at)


def _start(rng: np.random.Generator, C: Array, bg: Array, ba: Array) -> Start:  # noqa: ARG001
    """A start whose errors follow its prior, levelled on the biased accelerometer."""
    error = np.array([TILT, TILT, YAW]) * rng.normal(size=3)
    level = so3.matrix_exp(-error) @ C
    force = level.T @ np.array([0.0, 0.0, 9.80665]) + ba
    return Start(
        POSITION * rng.normal(size=3),
        VELOCITY * rng.normal(size=3),
        levelled(force, float(so3.yaw_of(level))),
        force,
        position_sigma=POSITION,
        velocity_sigma=VELOCITY,
        tilt_sigma=TILT,
        yaw_sigma=YAW,
        bias_sigma=np.repeat([GYRO_BIAS, ACCEL_BIAS], 3),
    )


def settle(world: World) -> tuple[Linear, smoother.Pass]:
    """The relinearised filter over one realisation."""
    problem, start = world.problem, world.start
    track = empty_track(problem, epochs(problem))
    state = initial_state(problem, start, LEVELS)
    state = run_compiled(problem, noise_arrays(problem, LEVELS), state, track)
    nominal = trajectory_of(problem, track, state.bg, state.ba, state.extras)
    linear, _, _ = smoother.relinearise(linearise_about(problem, start, nominal), LEVELS)
    return linear, smoother.forward(linear, LEVELS)


def errors(world: World, linear: Linear, last: smoother.Pass, j: int) -> Array:
    """True minus estimated state (15,) after epoch j of the last pass."""
    nominal, truth, x = linear.trajectory, world.truth, last.x[j]
    C = so3.matrix_exp(x[6:9]) @ nominal.C[j]
    return np.concatenate(
        [
            truth.p[j] - nominal.p[j] - x[0:3],
            truth.v[j] - nominal.v[j] - x[3:6],
            so3.matrix_log(truth.C[j] @ C.T),
            truth.bg - nominal.bg - x[9:12],
            truth.ba - nominal.ba - x[12:15],
        ]
    )

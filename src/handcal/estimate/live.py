"""The filter as it runs: frames of a recording, each from nothing but what came before it.

Noise levels alone are not found on the way: they come from a calibration of the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.compiled.kernel import BASE, MAX_DIM, corrected, fill_nav, linearise
from handcal.earth import local_earth
from handcal.effects import select
from handcal.estimate.filter import ENGINES, State, Track, empty_track
from handcal.estimate.observed import first_state, problem_of
from handcal.estimate.problem import Problem, constants_of, noise_arrays
from handcal.estimate.result import check_covariance
from handcal.observations import NAV, magnetometer
from handcal.types import Array, IntArray, Result


@dataclass(frozen=True)
class Observed:
    """One update at t (s): residual (d,) and sigma (d,) in SI, and its NIS."""

    t: float
    kind: str
    residual: Array
    sigma: Array
    nis: float


@dataclass(frozen=True)
class Frame:
    """What the filter knows at time t (s), enough to draw it.

    p_n (3,) m; q_nb (4,) w x y z; yaw rad; parameters and sigma (m,), ordered as in
    the layout shown; the updates since the last frame; the last measured heading
    since then, rad; the latest reading, gyro rad/s and accel m/s^2, each (3,).
    """

    t: float
    p_n: Array
    q_nb: Array
    yaw: float
    parameters: Array
    sigma: Array
    observed: tuple[Observed, ...] = ()
    heading: float | None = None
    gyro: Array | None = None
    accel: Array | None = None


def live_frames(
    result: Result,
    *,
    latitude: float | None = None,
    height: float = 0.0,
    engine: str = "compiled",
    rate_hz: float = 30.0,
) -> Iterator[Frame]:
    """Run the filter over the recording of ``result`` anew; at most ``rate_hz`` frames a second.

    The result gives noise levels, effects and kinds of observation; the filter begins
    level, knowing no more than the prior. latitude (rad) and height (m) as for ``calibrate``.
    Errors: HandcalError where the readings fit no motion so badly that a variance is lost.
    """
    biases = ("gyro_bias", "accel_bias")
    problem, start = problem_of(
        result.recording,
        select([p.effect for p in result.parameters if p.effect not in biases]),
        tuple(result.innovations),
        result.rests,
        local_earth(latitude, height),
        None,
    )
    levels = {n.name: n.value for n in result.noise}
    noise, run = noise_arrays(problem, levels), ENGINES[engine]
    track = empty_track(problem, np.zeros(0, dtype=np.int64))
    state = first_state(problem, start, levels)
    tick = np.floor((problem.nodes.t - problem.nodes.t[0]) * rate_hz + 1e-9)
    for node in np.flatnonzero(np.diff(tick, prepend=-1.0) > 0):
        first = problem.nodes.first[state.node + 1]
        state = run(problem, noise, state, track, stop=int(node) + 1)
        check_covariance(state.P, float(problem.nodes.t[state.node]))
        rows = np.arange(first, problem.nodes.first[node + 1])
        yield frame_of(problem, state, track, rows[~np.isnan(track.nis[rows])])


def frame_of(problem: Problem, state: State, track: Track, rows: IntArray) -> Frame:
    """The state with the observations ``rows`` that were used since the last frame."""
    nodes, imu = problem.nodes, problem.recording.imu
    ids = {e.id for e in problem.effects}
    m = BASE + sum(s.owner in ids for s in problem.slots)
    t = float(nodes.t[state.node])
    observed, heading = [], None
    for q in rows:
        kind = problem.observations[nodes.kind[q]]
        residual, sigma = track.residual[q, : kind.dim], track.sigma[q, : kind.dim]
        at = float(nodes.t[np.searchsorted(nodes.first, q, side="right") - 1])
        observed.append(Observed(at, kind.kind, residual, sigma, float(track.nis[q])))
        if kind.channels == ("heading",):
            heading = float(so3.wrap(nodes.z[q, 0]))
        elif kind.kind == "magnetometer":
            heading = _heading_of_field(problem, state, int(q))
    now = int(np.searchsorted(imu.t, t, side="right")) - 1
    return Frame(
        t,
        state.p,
        so3.quaternion_of(state.C[None])[0],
        float(so3.yaw_of(state.C)),
        np.r_[state.bg, state.ba, state.extras][: m - 9],
        np.sqrt(np.diag(state.P)[9:m]),
        tuple(observed),
        heading,
        imu.gyro[now],
        imu.accel[now],
    )


def _heading_of_field(problem: Problem, state: State, q: int) -> float | None:
    """What a magnetometer's reading q says of the heading at this attitude, rad, if it says
    anything."""
    nodes, i = problem.nodes, state.node
    nav, w, f = np.empty(NAV), np.empty(3), np.empty(3)
    corrected(nodes.gyro[i], nodes.J[i], 0, state.bg, state.extras, problem.ref, w)
    corrected(nodes.accel[i], nodes.J[i], 3, state.ba, state.extras, problem.ref, f)
    fill_nav(state.p, state.v, state.C, w, f, nav)
    r, H = np.zeros(MAX_DIM), np.zeros((MAX_DIM, problem.size))
    at = (nav, state.extras, nodes.z[q], nodes.J[i])
    if linearise(nodes.kind[q], problem.tables, *at, r, H) != 0:
        return None
    own = constants_of(problem, state.extras[: problem.constants], "magnetometer")
    north = nodes.z[q, magnetometer.HORIZONTAL] + own[:1]
    off = magnetometer.heading_off(state.C[None], r[None, :3], north)[0]
    return float(so3.wrap(so3.yaw_of(state.C) + off))

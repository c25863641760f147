"""The filter over long and violent motion: P stays a covariance, memory stays what it was.

The short forms of `make soak`, whose long ones are marked `prove`.
"""

from __future__ import annotations

import os
import resource
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_recording import sample

import handcal
from handcal.earth import local_earth
from handcal.effects import select
from handcal.estimate import smoother
from handcal.estimate.filter import ENGINES, State, empty_track
from handcal.estimate.observed import first_state, problem_of
from handcal.estimate.problem import Problem, noise_arrays
from handcal.estimate.result import check_covariance
from handcal.estimate.start import Start
from handcal.types import Array, HandcalError, Imu, Recording, Result

LEVELS = {"gyro_noise": 1e-3, "accel_noise": 1e-2, "sway": 0.004, "sway_per_rate": 0.004,
          "sway_time": 0.5, "position_noise": 3e-4}  # fmt: skip
FASTEST, STRONGEST = np.radians(2000.0), 16 * 9.80665
EFFECTS = ("gyro_scale", "accel_scale")
# Of a day that is never held as a whole: samples of a piece, and of what it has of its neighbours.
RATE_HZ, PIECE, OVER = 200.0, 12_000, 200
HOURS = float(os.environ.get("SOAK_HOURS", "2"))  # (make soak HOURS=24: eight minutes)


@dataclass(frozen=True)
class Seen:
    """The worst of a run, P scaled to a unit diagonal, and the state at its end."""

    asymmetry: float
    least: float
    grown: float
    steps: int
    end: Array


@pytest.fixture(scope="module")
def result() -> Result:
    recording = sample(n=300, streams=False)
    return handcal.calibrate(recording, EFFECTS, assume="fixed-point", noise=LEVELS)


def violent(n: int, seed: int) -> Recording:
    """Rates and forces up to the range of the sensors, steps from 1e-4 to 1 s."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(10 ** rng.uniform(-4, 0, n))
    gyro, accel = (rng.uniform(-top, top, (n, 3)) for top in (FASTEST, STRONGEST))
    calm = np.repeat(rng.random(n // 100 + 1) < 0.5, 100)[:n, None]
    gyro, accel = np.where(calm, 0.01 * gyro, gyro), np.where(calm, [0, 0, 9.80665], accel)
    return Recording("violent", Imu(t - t[0], gyro, accel, np.ones(n, dtype=np.bool_)), {}, 0)


def steady(hours: float, rate_hz: float = 200.0) -> Recording:
    """A hand that turns the device slowly all day, about an axis that stays level."""
    n = int(hours * 3600 * rate_hz)
    return of_samples(np.arange(n), np.random.default_rng(0), rate_hz)


def of_samples(at: Array, rng: np.random.Generator, rate_hz: float = RATE_HZ) -> Recording:
    """The samples ``at`` (n,) of that hand, with noise from rng."""
    n, t = len(at), at / rate_hz
    angle = 2.0 * np.sin(0.4 * t)
    gyro, accel = rng.normal(0, 1e-3, (n, 3)), rng.normal(0, 1e-2, (n, 3))
    gyro[:, 0] += 0.8 * np.cos(0.4 * t)
    accel[:, 1] += 9.80665 * np.sin(angle)
    accel[:, 2] += 9.80665 * np.cos(angle)
    return Recording("steady", Imu(t, gyro, accel, np.ones(n, dtype=np.bool_)), {}, 0)


def piece(k: int) -> Imu:
    """The k-th piece of that hand's day, with noise of its own."""
    at = np.arange(k * PIECE, (k + 1) * PIECE)
    return of_samples(at, np.random.default_rng([0, k])).imu


def joined(first: int, last: int) -> Recording:
    """Pieces first to last, and a second of those before and after; t begins at zero."""
    rows = [piece(k) for k in range(max(first - 1, 0), last + 2)]
    t, gyro, accel = (np.concatenate([getattr(r, n) for r in rows]) for n in ("t", "gyro", "accel"))
    own = slice(PIECE - OVER if first else 0, OVER - PIECE)
    imu = Imu(t[own] - t[own][0], gyro[own], accel[own], np.ones(len(t[own]), dtype=np.bool_))
    return Recording("steady", imu, {}, 0)


def streamed(result: Result, pieces: int) -> tuple[Seen, Array]:
    """The live filter over so many pieces, of which three are held at a time; P at its end."""
    state: State | None = None
    asymmetry, least, steps, held = 0.0, np.inf, 0, []
    for k in range(pieces):
        problem, start = problem_as(result, joined(k, k))
        noise = noise_arrays(problem, LEVELS)
        if state is None:
            state = first_state(problem, start, LEVELS)
        else:
            state = replace(state, node=_node(problem, OVER - 1))
        stop = _node(problem, PIECE + (OVER if k else 0) - 1) + 1
        steps += stop - 1 - state.node
        track = empty_track(problem, np.zeros(0, dtype=np.int64))
        state = ENGINES["compiled"](problem, noise, state, track, stop=stop)
        check_covariance(state.P, k * PIECE / RATE_HZ)
        one = worst_of(state.P)
        asymmetry, least = max(asymmetry, one[0]), min(least, one[1])
        held.append(resident_mb())
    assert state is not None
    settled = held[min(3, len(held) - 1) :]
    end = np.r_[state.p, state.bg, state.ba, state.extras]
    return Seen(asymmetry, least, max(settled) / settled[0] - 1, steps, end), state.P


def _node(problem: Problem, sample: int) -> int:
    """The last node of a sample, from the beginning of the recording."""
    return int(np.searchsorted(problem.nodes.t, sample / RATE_HZ + 1e-6)) - 1


def resident_mb() -> float:
    """Memory that this process has now (where /proc tells it), MB."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def problem_as(result: Result, recording: Recording) -> tuple[Problem, Start]:
    """The problem of a recording with the result's observations and no rests."""
    kinds = tuple(result.innovations)
    return problem_of(
        recording, select(list(EFFECTS)), kinds, np.zeros((0, 2)), local_earth(None, 0.0), None
    )


def worst_of(P: Array) -> tuple[float, float]:
    """Of P scaled to a unit diagonal: the largest asymmetry, the least eigenvalue."""
    used = np.flatnonzero(np.diag(P) != 0)
    P = P[np.ix_(used, used)]
    scale = np.sqrt(np.diag(P))
    P = P / scale / scale[:, None]
    return float(np.abs(P - P.T).max()), float(np.linalg.eigvalsh(0.5 * (P + P.T))[0])


def seen(result: Result, recording: Recording, every: int) -> Seen:
    """Run the live filter, looking at P after every so many steps."""
    problem, start = problem_as(result, recording)
    noise, run = noise_arrays(problem, LEVELS), ENGINES["compiled"]
    track = empty_track(problem, np.zeros(0, dtype=np.int64))
    state = first_state(problem, start, LEVELS)
    asymmetry, least, before = 0.0, np.inf, None
    stops = [*range(every, len(problem.nodes.t), every), len(problem.nodes.t)]
    for stop in stops:
        state = run(problem, noise, state, track, stop=stop)
        check_covariance(state.P, float(problem.nodes.t[state.node]))
        one = worst_of(state.P)
        asymmetry, least = max(asymmetry, one[0]), min(least, one[1])
        rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        before = rss if before is None else before
    end = np.r_[state.p, state.bg, state.ba, state.extras]
    return Seen(asymmetry, least, rss / before - 1, len(problem.nodes.t), end)


def first_state_of(result: Result) -> State:
    """Before the first reading."""
    problem, start = problem_as(result, violent(300, 0))
    return first_state(problem, start, LEVELS)


def check(found: Seen) -> None:
    print(f"\n{found.steps} steps: asymmetry {found.asymmetry:.1e}, least eigenvalue "
          f"{found.least:.1e}, memory grown {100 * found.grown:.1f} %")  # fmt: skip
    assert np.isfinite(found.end).all()
    assert found.asymmetry < 1e-12
    assert found.least > -1e-12


@pytest.mark.parametrize("seed", range(3))
def test_p_stays_a_covariance_in_violent_motion(result: Result, seed: int) -> None:
    check(seen(result, violent(3000, seed), 100))


def test_minutes_need_no_memory_and_ends_as_at_one_go(result: Result) -> None:
    recording = steady(0.1)
    in_steps, at_once = (seen(result, recording, k) for k in (500, 10**9))
    check(in_steps)
    assert in_steps.grown < 0.05
    np.testing.assert_array_equal(in_steps.end, at_once.end)


@pytest.mark.prove
def test_a_million_violent_steps(result: Result) -> None:
    """A variance of velocity 1e28 times the bias's is beyond float64: where P is lost, it is said
    (of seed 5 after 95,140 steps)."""
    said = 0
    for seed in range(10):
        try:
            check(seen(result, violent(100_000, seed), 1000))
        except HandcalError as error:
            print(f"\nseed {seed}: {error}")
            said += 1
    assert said < 5


@pytest.mark.parametrize("wrong", [-4e-11, np.nan])
def test_a_covariance_that_is_lost_is_said(
    result: Result, wrong: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    P = first_state_of(result).P
    check_covariance(P, 1.0)
    P[9, 9] = wrong
    with pytest.raises(HandcalError, match="lost its covariance"):
        check_covariance(P, 1.0)
    forward = smoother.forward

    def lost(*arguments: Any, **options: Any) -> smoother.Pass:
        passed = forward(*arguments, **options)
        passed.P[len(passed.P) // 2, 9, 9] = wrong
        return passed

    monkeypatch.setattr(smoother, "forward", lost)
    with pytest.raises(HandcalError, match="lost its covariance"):
        handcal.calibrate(result.recording, EFFECTS, assume="fixed-point", noise=LEVELS)


@pytest.mark.prove
def test_two_hours_at_200_hz(result: Result) -> None:
    found = seen(result, steady(2.0), 50_000)
    check(found)
    assert found.grown < 0.05


def same_as_at_one_go(result: Result, pieces: int) -> None:
    """The end of a streamed run, beside that of the same samples held as one recording."""
    found, P = streamed(result, pieces)
    whole, start = problem_as(result, joined(0, pieces - 1))
    state = first_state(whole, start, LEVELS)
    track = empty_track(whole, np.zeros(0, dtype=np.int64))
    stop = _node(whole, pieces * PIECE - 1) + 1
    state = ENGINES["compiled"](whole, noise_arrays(whole, LEVELS), state, track, stop=stop)
    end = np.r_[state.p, state.bg, state.ba, state.extras]
    sigma = np.sqrt(np.diag(P))
    sigma = np.r_[sigma[:3], sigma[9:15], sigma[15:]]
    off = (found.end - end) / sigma
    print(f"\nin pieces and at one go differ by {np.abs(off).max():.1e} sigmas, "
          f"variances of the biases by {np.abs(np.diag(state.P) / np.diag(P) - 1)[9:15].max():.1e}"
          )  # fmt: skip
    # (how rough readings are is judged by each piece)
    np.testing.assert_allclose(off, 0.0, atol=1e-2)
    more = np.abs(np.diag(state.P) / np.diag(P) - 1.0)
    assert more[9:15].max() < 1e-2
    # (the last look at the held point was not at the same moment)
    assert more.max() < 0.1


def test_what_comes_in_pieces_ends_as_what_is_held_as_a_whole(result: Result) -> None:
    same_as_at_one_go(result, 3)


@pytest.mark.prove
def test_hours_at_200_hz_that_nobody_holds(result: Result) -> None:
    """A day with SOAK_HOURS=24."""
    same_as_at_one_go(result, 30)
    found, _ = streamed(result, round(HOURS * 3600 * RATE_HZ / PIECE))
    check(found)
    assert found.grown < 0.05


def test_what_is_checked_can_fail(result: Result) -> None:
    recording = violent(300, 0)
    broken = replace(recording, imu=replace(recording.imu, gyro=recording.imu.gyro * np.nan))
    with pytest.raises((HandcalError, AssertionError, np.linalg.LinAlgError)):
        check(seen(result, broken, 100))

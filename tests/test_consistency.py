"""The filter is as good as it says: NEES, NIS and the Cramer-Rao bound, over many seeds.

Few seeds in the suite, two hundred in ``make prove``; bounds come from the chi-square
distribution alone and were fixed before the runs.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from model_world import LEVELS, draw, errors, motion, settle
from proved import proved

import handcal
from handcal.estimate.consistency import bound, chi2_bounds, nees
from handcal.types import Array
from handcal_sim import simulate, write

SCENARIOS = ("z-turn", "three-turns")
BLOCKS = {"position": 0, "velocity": 3, "attitude": 6, "gyro bias": 9, "accel bias": 12}
INSTANTS = (0.5, 5.0, 12.0, 20.0, 29.9)


def test_nees_of_a_known_error() -> None:
    P = np.array([[4.0, 1.0], [1.0, 9.0]])
    # by hand: P^-1 = [[9, -1], [-1, 4]] / 35
    assert nees(np.array([1.0, 2.0]), P) == pytest.approx((9 - 4 + 16) / 35, rel=1e-12)


def test_bounds_hold_their_level() -> None:
    low, high = chi2_bounds(30, level=0.9)
    draws = np.random.default_rng(0).chisquare(30, 20_000) / 30
    inside = ((draws > low) & (draws < high)).mean()
    assert abs(inside - 0.9) < 4 * math.sqrt(0.9 * 0.1 / 20_000)


def _model_world(scenario: str, seeds: int) -> None:
    truth = motion(scenario)
    ratios: dict[tuple[str, float], list[float]] = {}
    final, limits, nis = [], [], []
    for seed in range(seeds):
        world = draw(truth, seed)
        linear, last = settle(world)
        scalars = int(world.problem.tables.dim[linear.kind[linear.used]].sum())
        nis.append(float(np.nansum(last.nis)) / scalars)
        limit = bound(world.problem, world.start, world.truth, LEVELS)
        for instant in INSTANTS:
            j = int(np.searchsorted(linear.t, instant))
            e = errors(world, linear, last, j)
            for name, i in BLOCKS.items():
                block = slice(i, i + 3)
                value = nees(e[block], last.P[j][block, block]) / 3
                ratios.setdefault((name, instant), []).append(value)
        final.append(errors(world, linear, last, -1)[9:])
        limits.append(np.diag(limit[-1])[9:])
    low, high = chi2_bounds(3 * seeds, 0.99, tests=len(SCENARIOS) * len(ratios))
    print(f"\n{scenario}, {seeds} seeds: NIS {np.mean(nis):.4f}; NEES bounds {low:.3f} {high:.3f}")
    for name in BLOCKS:
        row = " ".join(f"{np.mean(ratios[name, i]):.3f}" for i in INSTANTS)
        print(f"  NEES {name:10s} at {INSTANTS} s: {row}")
    ratio = np.sqrt((np.array(final) ** 2).mean(axis=0) / np.mean(limits, axis=0))
    print(f"  RMS error over the bound, gyro x y z, accel x y z: {np.round(ratio, 3)}")
    outside = {k: np.mean(v) for k, v in ratios.items() if not low < np.mean(v) < high}
    assert not outside
    assert 0.98 < np.mean(nis) < 1.02
    _within(ratio, seeds)


def _within(ratio: Array, seeds: int) -> None:
    low, high = chi2_bounds(seeds, 0.99, tests=12)
    tight = seeds >= 200
    low, high = (0.84, 1.16) if tight else (math.sqrt(low), math.sqrt(high))
    assert np.all((ratio > low) & (ratio < high))


def _hand_world(scenario: str, seeds: int, folder: Path) -> None:
    total: dict[str, list[float]] = {"gyro bias": [], "accel bias": [], "both": []}
    for seed in range(seeds):
        world = simulate(scenario, seed=seed)
        path = folder / "hand.mcap"
        write(world, path)
        # (nothing but biases is there, and their joint covariance is on trial)
        result = handcal.calibrate(handcal.load(path), assume="fixed-point", only=True)
        known = world.parameters["effects"]
        truth = [p["value"] for k in ("gyro_bias", "accel_bias") for p in known[k]]
        e = np.array(truth) - np.array([p.value for p in result.parameters])
        total["gyro bias"].append(nees(e[:3], result.covariance[:3, :3]) / 3)
        total["accel bias"].append(nees(e[3:], result.covariance[3:, 3:]) / 3)
        total["both"].append(nees(e, result.covariance) / 6)
    spread = {k: float(np.std(v)) / math.sqrt(seeds) for k, v in total.items()}
    mean = {k: float(np.mean(v)) for k, v in total.items()}
    print(f"\n{scenario} in a swaying, trembling hand, {seeds} seeds: NEES per degree of freedom")
    print("  " + ", ".join(f"{k} {mean[k]:.3f} +- {spread[k]:.3f}" for k in mean))
    # 0.7 to 1.4 is asked; with few seeds, the spread of a chi-square mean comes on top
    slack = chi2_bounds(6 * seeds, 0.999) if seeds < 100 else (1.0, 1.0)
    assert 0.7 * slack[0] < mean["both"] < 1.4 * slack[1]


@pytest.mark.parametrize("scenario", ["z-turn", *proved("three-turns")])
def test_the_filter_is_consistent_in_its_own_world(scenario: str) -> None:
    _model_world(scenario, 24)


@pytest.mark.prove
@pytest.mark.parametrize("scenario", ["z-turn", "three-turns"])
def test_the_filter_is_consistent_in_a_hand(scenario: str, tmp_path: Path) -> None:
    _hand_world(scenario, 6, tmp_path)


@pytest.mark.prove
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_two_hundred_seeds_in_its_own_world(scenario: str) -> None:
    _model_world(scenario, 200)


@pytest.mark.prove
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_two_hundred_seeds_in_a_hand(scenario: str, tmp_path: Path) -> None:
    _hand_world(scenario, 200, tmp_path)

"""The slope of the evidence by every noise level, against differences of the evidence itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import select
from handcal.estimate import noise_levels, parallel
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.evidence import ReducedPass, Reduction, reduce, reduced_pass
from handcal.estimate.model import Fitted
from handcal.estimate.noise_levels import Score
from handcal.estimate.transfer import moved_to
from handcal.laws import with_motion
from handcal.search.noise_scan import looks_of
from handcal_sim import simulate
from handcal_sim.phone import Phone, capture_pose, consumer_phone

STEP = 1e-3
CASES = {
    "held": ("heading", ()),
    "correlated": ("heading", ("heading_correlated_noise", "gyro_scale")),
    "walking": ("heading", ("gyro_bias_walk", "accel_bias_walk")),
    "marker": ("pose", ("lever_arm",)),
}


def _seen(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), pose=capture_pose(rng))


def _fit(kind: str, effects: tuple[str, ...], seed: int) -> Fitted:
    world = simulate("free-hand", seed=seed, duration_s=15.0, phone=_seen)
    chosen = select(effects)
    return moved_to(started(case_of(recording_of(world, kind))), chosen)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", CASES)
def test_slope_of_the_evidence(name: str, seed: int) -> None:
    """To a thousandth of what a level's e-fold changes: the third derivative times STEP^2 is less.

    At levels half as large and twice as large too, away from where the slope is near zero.
    """
    f = _fit(*CASES[name], seed)
    names = sorted({lv.name for lv in f.linear.problem.levels})
    for factor in (0.5, 1.0, 2.0):
        levels = {n: factor * v for n, v in f.levels.items()}
        score = Score(reduce(f.linear), levels, names)
        value, slope = score(levels)
        assert value == pytest.approx(reduced_pass(score.reduction, levels).log_evidence)
        want = np.array([_difference(score, levels, n) for n in names])
        assert np.abs(slope - want).max() < 1e-3 * max(1.0, np.abs(want).max())
        assert np.abs(slope - want)[np.abs(want) < 10.0].max(initial=0.0) < 0.02


def test_levels_sought_in_a_part_first_are_those_of_the_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within what either search may leave, a hundredth of a nat, and in fewer passes of the whole
    than without."""
    f = _fit("heading", (), 0)
    reduction, names = reduce(f.linear), sorted({lv.name for lv in f.linear.problem.levels})
    counted = []

    def passed(some: Reduction, *more: Any, **options: Any) -> ReducedPass:
        counted.append(len(some.linear.t))
        return reduced_pass(some, *more, **options)

    monkeypatch.setattr(noise_levels, "reduced_pass", passed)
    whole, _ = noise_levels.estimate(reduction, f.levels, names)
    passes = len(counted)
    counted.clear()
    monkeypatch.setattr(noise_levels, "MANY", 100)
    begun, _ = noise_levels.estimate(reduction, f.levels, names)
    size = len(reduction.linear.t)
    assert min(counted) == size // noise_levels.PART
    assert counted.count(size) < passes
    gained = [reduced_pass(reduction, x).log_evidence for x in (whole, begun)]
    assert gained[0] == pytest.approx(gained[1], abs=0.1)  # (their priors take part in it)


def _difference(score: Score, levels: dict[str, float], name: str) -> float:
    up, down = (
        reduced_pass(score.reduction, levels | {name: levels[name] * math.exp(s)}).log_evidence
        for s in (STEP, -STEP)
    )
    return (up - down) / (2.0 * STEP)


def test_a_time_constant_is_among_them() -> None:
    """The cases hold levels that change transitions, or the test above would not see them."""
    f = _fit(*CASES["correlated"], 0)
    assert Score(
        reduce(f.linear), f.levels, sorted(lv.name for lv in f.linear.problem.levels)
    ).moving


@pytest.mark.parametrize("kind", ["heading", "pose"])
def test_slope_by_several_memories_at_once(kind: str) -> None:
    """Each tells its own: to a hundred-thousandth, the step of the difference squared times ten.

    (A one-sided difference of the pass itself, 1e-4 long, is off by a thousandth.)
    """
    f = _fit(kind, ("gyro_scale",), 0)
    errs = (with_motion.effect("gyro", (0, 1, 2), "turning"),
            with_motion.effect("accel", (0, 2), "attitude"))  # fmt: skip
    f = moved_to(f, (*select(("gyro_scale",)), *errs))
    names = sorted({lv.name for lv in f.linear.problem.levels})
    score = Score(reduce(f.linear), f.levels, names)
    slope = dict(zip(names, score(f.levels)[1], strict=True))
    for name in names:
        if name.endswith(("_memory", "sway_time")):
            want = _difference(score, dict(f.levels), name)
            assert slope[name] == pytest.approx(want, rel=1e-5, abs=1e-5), name


def test_looks_are_the_same_on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the last bit: each works on arrays of its own."""
    f = _fit("heading", ("gyro_scale",), 0)
    chosen = select(("gyro_scale",))
    noise = select(("gyro_bias_walk", "accel_bias_walk", "heading_correlated_noise"))
    looks = []
    for cores in (1, 2):
        monkeypatch.setattr(parallel.os, "cpu_count", lambda cores=cores: cores)
        looks.append(looks_of([f], chosen, noise, len(noise)))
    assert [(k.effects[-1].id, k.gain) for k in looks[0]] == [
        (k.effects[-1].id, k.gain) for k in looks[1]
    ]

"""The slope of the evidence by every noise level, against differences of the evidence itself."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import select
from handcal.estimate import noise_levels, parallel
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.evidence import ReducedPass, Reduction, reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted
from handcal.estimate.noise_levels import Score
from handcal.estimate.transfer import moved_to
from handcal.laws import with_motion
from handcal.observations.fixed_position import CREEP, CREEPING, SWAY, Sway
from handcal.observations.known_input import MOTION, InMotion
from handcal.recordings.inputs import load
from handcal.search.beyond_columns import other_ways
from handcal.search.drifting_point import begun
from handcal.search.noise_scan import looks_of
from handcal.types import Markov
from handcal_sim import simulate
from handcal_sim.mcap_writer import write
from handcal_sim.phone import Phone, capture_pose, consumer_phone
from handcal_sim.prove.draw import draw
from handcal_sim.prove.run import promised

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


@pytest.mark.prove
@pytest.mark.parametrize("number", [7, *range(7)])
@pytest.mark.parametrize("many", [noise_levels.MANY, 100])
def test_both_ways_to_share_a_sway_are_looked_at(
    number: int, many: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether a search begins where the hand sways whether it turns or not, or only as it turns, it
    ends as high to half a nat (of the first eight worlds with something that walks, two have a
    second summit, 3 and 28 nats lower, where one search from either side ended). Of a long
    recording (``many`` epochs) that is looked at in its first part alone."""
    monkeypatch.setattr(noise_levels, "MANY", many)
    world, answer = draw("walks", number, 0, promised)
    write(world, tmp_path / "walk.mcap", truth=False)
    base = begun([case_of(load(tmp_path / "walk.mcap"), "fixed-point")])
    wanted = [*base.effects, *select(tuple(answer.effects))]
    (f,) = fitted(base.parts, wanted).parts
    reduction, ends = reduce(f.linear), []
    for sway, per_rate in ((0.05, 2e-4), (2e-4, 0.05)):
        levels = {**f.levels, "sway": sway, "sway_per_rate": per_rate}
        found, _ = noise_levels.estimate(reduction, levels, [lv.name for lv in f.problem.levels])
        ends.append(reduced_pass(reduction, found).log_evidence)
    assert abs(ends[0] - ends[1]) < 0.5


def test_ends_of_a_part_that_the_whole_may_end_at() -> None:
    """The best, and others that are near in evidence and far in place."""
    far = 1.1 * noise_levels.FAR
    places = [(5.0, 0.0), (0.0, 0.0), (1.0, 0.9 * noise_levels.FAR), (2.0, far), (30.0, 2 * far)]
    ends = [(value, np.array([0.0, where]), np.eye(2)) for value, where in places]
    assert [end[0] for end in noise_levels._apart(ends)] == [0.0, 2.0]


def test_what_is_shared_is_kept_where_one_holds_it_all() -> None:
    x, rate = np.log([0.3, 0.013, 0.008]), 1.3
    whole = math.hypot(0.013, 0.008 * rate)
    for option in noise_levels._instead(x, 2, 1, rate):
        assert option[0] == x[0]
        assert math.hypot(np.exp(option[1]), np.exp(option[2]) * rate) == pytest.approx(
            whole, rel=2e-3
        )
        assert np.exp((option - x)[1:]).min() == pytest.approx(1.0 / noise_levels.NEARLY_NONE)


@pytest.mark.parametrize("process", [Sway(SWAY), Sway(SWAY, CREEP), InMotion()])
@pytest.mark.parametrize("moves", [True, False])
def test_what_a_process_weighs_without_its_matrices(process: Markov, moves: bool) -> None:
    """Short intervals and long ones, weights of any kind: as with the matrices written out."""
    rng = np.random.default_rng(0)
    dt, rate = rng.choice([1e-3, 0.02, 0.7, 6.0], 40), rng.uniform(0.0, 3.0, 40)
    names = [*(lv.name for lv in CREEPING.levels), *MOTION]
    many = [{n: float(rng.uniform(0.1, 2.0)) for n in names} for _ in range(3)]
    many.append(many[0] | {"sway": 0.3})
    by_Q, by_Phi = rng.standard_normal((2, 40, process.size, process.size))
    by_Phi = by_Phi if moves and isinstance(process, Sway) else by_Phi[:0]
    want = noise_levels.weighed(process, many, dt, rate, by_Phi, by_Q)
    found = process.weighed(many, dt, rate, by_Phi, by_Q)  # type: ignore[attr-defined]
    assert np.allclose(found, want, rtol=1e-10, atol=1e-12)


def test_one_noise_is_exchanged_for_another(tmp_path: Path) -> None:
    """An error that goes with the attitude absorbs most of a walk of the bias, and the walk gains
    nothing beside it. In its place the evidence rises. (About a poor first fit the wrong one was
    chosen, and the climb ended with it.)"""
    number = next(n for n in range(9) if "gyro_bias_walk" in draw("walks", n, 0)[1].effects)
    world, _ = draw("walks", number, 0)
    write(world, tmp_path / "walk.mcap", truth=False)
    base = begun([case_of(load(tmp_path / "walk.mcap"), "fixed-point")])
    wrong = with_motion.effect("gyro", (0, 1, 2), "attitude")
    model = fitted(base.parts, [*base.effects, wrong])
    ends = list(other_ways(model, 1.0, frozenset(), frozenset(base.ids)))
    best = max(ends, key=lambda m: m.log_evidence)
    assert best.log_evidence > model.log_evidence
    assert [i for i in best.ids if i not in base.ids] == ["gyro_bias_walk"]

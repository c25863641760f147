"""The suite `odometry`: what is drawn, and that its score can fail."""

import io
import math

import numpy as np
import pytest
import schemas
from prove_help import said, trial
from rich.console import Console

from handcal_sim.aiding import read_pose
from handcal_sim.companions import Pose
from handcal_sim.motion import evaluate, random_start
from handcal_sim.motion_carried import carried, strolled, way_of
from handcal_sim.prove import draw, score
from handcal_sim.prove.show import show


@pytest.mark.parametrize("number", range(6))
def test_poses_are_as_promised(number):
    world, answer = draw.draw("odometry", number, 4)
    perfect, seen = number % 2 == 1, answer.circumstances
    assert seen["perfect"] is perfect
    assert {"pose_drift", "pose_scale"} <= set(answer.effects) or perfect
    of_the_pose = set() if perfect else {"pose_drift", "pose_scale", "pose_delay"}
    assert set(answer.effects) <= {"lever_arm"} | of_the_pose
    assert set(world.streams) == {"pose"}
    gaps = np.diff(world.streams["pose"].stamps)
    assert 1.0 / 61.0 < np.median(gaps) < 1.0 / 29.0
    assert gaps.max() == pytest.approx(max(seen["lost_for_s"], np.median(gaps)), abs=0.06)
    steps = np.linalg.norm(np.diff(world.truth.position, axis=0), axis=1)
    assert np.sum(steps) > 0.9 * seen["way_m"]
    if not perfect:
        density, _ = answer.effects["pose_drift"].values()
        share = density * math.sqrt(3.0 * seen["duration_s"]) / seen["way_m"]
        assert 0.005 <= share <= 0.02
        assert abs(answer.effects["pose_scale"]["scale"]) <= 0.02
        assert answer.effects.get("pose_delay", {"delay": 0.0})["delay"] <= 0.03


def test_drift_goes_with_the_way_and_amounts_to_what_was_drawn():
    rng = np.random.default_rng(2)
    path = strolled(40.0, 1.5, rng)
    motion = carried(path, 1.0)(40.0, random_start(rng), rng)
    t = np.arange(0.0, 40.0, 0.1)
    sensor = Pose(position_walk=0.01 * way_of(path, 40.0) / math.sqrt(120.0), by_way=True)
    true = evaluate(motion, t).position
    off = np.stack([read_pose(sensor, motion, t, rng)[:, :3] - true for _ in range(200)])
    share = math.sqrt(np.mean(np.sum(off[:, -1] ** 2, axis=1))) / way_of(path, 40.0)
    assert share == pytest.approx(0.01, rel=0.15)
    # At rest in the beginning it does not wander.
    assert np.abs(off[:, t < 2.0]).max() < 1e-4


def test_a_jump_comes_with_the_loss():
    rng = np.random.default_rng(2)
    motion = carried(strolled(20.0, 1.0, rng), 1.0)(20.0, random_start(rng), rng)
    t, jump = np.arange(0.0, 20.0, 0.1), np.array([0.01, 0.02, 0.03])
    read = read_pose(Pose(lost_at_s=9.95, lost_for_s=1.0, jump=jump), motion, t, rng)
    off = read[:, :3] - evaluate(motion, t).position
    np.testing.assert_allclose(off[t < 9.9], 0.0, atol=1e-12)
    np.testing.assert_allclose(off[t > 10.0], np.tile(jump, (np.sum(t > 10.0), 1)), atol=1e-12)


def test_the_score_tells_perfect_trackers_from_others():
    truth = {"pose_drift": {"position": 0.01, "attitude": 1e-4}}
    trials = [
        trial("odometry", effects, document)
        for effects in ({}, truth)
        for document in (said("pose_drift"), said())
    ]
    proof = score.score(trials, 1)
    schemas.check(proof)
    figures = proof["further"]["odometry"]
    assert (figures["perfect_said_to_drift"]["count"], figures["drift_found"]["count"]) == (1, 1)
    assert proof["suites"][0]["met"] is False
    text = io.StringIO()
    show(proof, Console(file=text, width=160))
    assert "1 of 2 perfect trackers are said to drift" in text.getvalue()
    assert "not met" in text.getvalue()

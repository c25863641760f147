"""The suite `wild`: quick, wide, irregular, with pauses; as many effects as `mixed`."""

import numpy as np
import pytest
from prove_help import said, trial

from handcal_sim.motion import evaluate, random_start
from handcal_sim.motion_wild import wild
from handcal_sim.prove import draw, draw_wild, score
from handcal_sim.prove.suites import NEEDS


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_motion_is_wild_and_pauses(seed):
    rng = np.random.default_rng(seed)
    motion = wild(5.0)(40.0, random_start(rng), rng)
    t = np.arange(0.0, 40.0, 0.01)
    at = evaluate(motion, t)
    resting = np.any([(t >= a) & (t <= b) for a, b in motion.rests], axis=0)
    assert np.abs(at.omega_nb_b[resting]).max() < 1e-6
    speed = np.linalg.norm(at.omega_nb_b, axis=1)
    assert 3.0 < np.sqrt(np.mean(speed[~resting] ** 2)) < 8.0
    assert 9.0 < speed.max() < 35.0  # within the range of a consumer's gyro
    assert len(motion.rests) >= 4
    # A good part of the turning is quicker than twice a second.
    power = np.abs(np.fft.rfft(at.omega_nb_b, axis=0)) ** 2
    quick = power[np.fft.rfftfreq(len(t), 0.01) > 2.0].sum() / power.sum()
    assert 0.1 < quick < 0.8
    assert np.linalg.norm(at.C_nb[0] - at.C_nb, axis=(1, 2)).max() > 2.0  # 90 deg
    step = np.einsum("nji,njk->nik", at.C_nb[:-1], at.C_nb[1:])
    turned = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1) / 0.01
    middle = 0.5 * (at.omega_nb_b[1:] + at.omega_nb_b[:-1])
    np.testing.assert_allclose(turned, middle, atol=0.5)


def test_up_to_three_effects_of_any_kind_that_the_streams_allow(monkeypatch):
    monkeypatch.setattr(draw_wild, "simulated", lambda given, *_: given)
    monkeypatch.setattr(draw, "completed", lambda _world, drawn: drawn)
    counts = set()
    for number in range(80):
        given, answer = draw.draw("wild", number, 1)
        counts.add(len(answer.effects))
        assert all(NEEDS.get(n, frozenset()) <= given.streams for n in answer.effects)
        assert 3.0 <= answer.circumstances["rate_rad_s"] <= 7.0
    assert counts == {0, 1, 2, 3}


def test_the_score_asks_for_95_of_100():
    truth = {"gyro_scale": {"x": 0.01}}
    right, wrong = (trial("wild", truth, said(name)) for name in ("gyro_scale", "lever_arm"))
    assert score.suites([right] * 19 + [wrong])[0]["met"] is True
    assert score.suites([right] * 18 + [wrong] * 2)[0]["met"] is False

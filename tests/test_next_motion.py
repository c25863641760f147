"""The motion to make next: what it promises is what comes, and physics decides which it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of as recording_in

from handcal import motions
from handcal.compiled import so3
from handcal.earth import local_earth
from handcal.effects import Effect, Signals, select
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted, Model
from handcal.estimate.quadratic import Quadratic, log_evidence
from handcal.estimate.scan import scan
from handcal.estimate.transfer import moved_to
from handcal.explain import next_motion
from handcal.explain.next_motion import _believed, _informations, next_motions
from handcal.explanation import ENOUGH_TO_SHOW, Hypothesis, Missing
from handcal.live.turns import CHOICE, asked_for
from handcal.motions import MOTIONS, Motion, attitude, recording_of
from handcal.recordings import segment
from handcal.recordings.streams import STREAMS
from handcal.search.multistart import Found
from handcal.search.space import Space, expected_gain, rivals, space
from handcal.types import Array, Recording, Series
from handcal_sim import simulate
from handcal_sim.motion import Start

G_N = local_earth(None)[0]


def _found(recording: Recording, model: tuple[str, ...], *others: str) -> Found:
    """As if the search had ended at this model, these others being the candidates."""
    base = fitted([started(case_of(recording))], ())
    end = fitted(base.parts, select(model)) if model else base
    return _scanned(end, others)


def _scanned(end: Model, others: tuple[str, ...]) -> Found:
    options = [*end.effects, *select(others)]
    where = space(scan(end, options), options, {})
    return Found(end, where, {}, {})


def _set(effect: str, *others: str) -> Missing:
    return Missing(effect, effect, 0.99, 20.0, others, (), "", "")


def _hidden(found: Found, *effects: str) -> list[Hypothesis]:
    """Hypotheses on trial, with what the recording itself promises of them."""
    promised = {e: _promised(found.space, e) for e in effects}
    return [Hypothesis(e, e, 0.0, 0.0, promised[e], 0.0, "") for e in effects]


def _promised(where: Space, effect: str) -> float:
    return expected_gain(where, effect, frozenset(), np.ones(len(where.where[effect])))


def _motion(sentence: str) -> Motion:
    return next(m for m in MOTIONS if m.sentence == sentence)


def _axes(motion: Motion) -> int:
    """About how many independent axes it turns."""
    turned = [axis for axis, angle, _ in motion.turns if angle]
    return int(np.linalg.matrix_rank(np.array(turned))) if turned else 0


@pytest.fixture(scope="module")
def one_way() -> Found:
    """One turn about the vertical, one way: a gyro scale error, or one quadratic in the rate."""
    world = simulate("z-turn", seed=3, start=Start(), effects={"gyro_scale": [0.0, 0.0, 0.01]})
    return _found(recording_in(world, "heading"), ("gyro_scale",), "gyro_quadratic")


@pytest.fixture(scope="module")
def on_a_table() -> Found:
    """A device that lies still, at a steady temperature."""
    recording = recording_in(simulate("static", seed=1, duration_s=30.0), "heading")
    t = np.arange(31.0)
    warmth = {"temperature": Series(t, np.full((31, 1), 28.0))}
    recording = replace(recording, streams={**recording.streams, **warmth})
    options = ("lever_arm", "gyro_scale", "gyro_temperature", "accel_temperature")
    return _found(recording, (), *options)


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: m.sentence[:30])
def test_motions_are_motions(motion: Motion) -> None:
    t = np.linspace(0.0, motion.duration_s, 20001)
    C, omega = attitude(motion, t)
    step = so3.matrix_log(C[:-1].transpose(0, 2, 1) @ C[1:]) / np.diff(t)[:, None]
    assert np.abs(step - 0.5 * (omega[1:] + omega[:-1])).max() < 2e-3
    assert np.abs(omega[[0, -1]]).max() < 1e-9
    assert motion.duration_s <= 60.0
    recording = recording_of(motion, recording_in(simulate("z-turn"), "heading"), G_N)
    assert np.allclose(np.linalg.norm(recording.imu.accel, axis=1), 9.80665)
    assert np.allclose(recording.imu.accel[0], [0.0, 0.0, 9.80665])
    rests = segment.rests(recording)
    assert rests[0, 0] == 0.0
    assert rests[-1, 1] == recording.imu.t[-1]
    yaw = so3.yaw_of(attitude(motion, recording.streams["heading"].t)[0])
    assert np.allclose(recording.streams["heading"].value[:, 0], yaw)


def test_six_faces_are_six() -> None:
    motion = next(m for m in MOTIONS if "six faces" in m.sentence)
    begin = np.cumsum([0.0, *[s for _, _, s in motion.turns]])[:-1]
    rests = begin[[angle == 0.0 for _, angle, _ in motion.turns]]
    up = attitude(motion, rests + 1.0)[0][:, 2]
    assert sorted(map(tuple, np.round(up).astype(int))) == sorted(
        tuple(int(s) * (np.arange(3) == i)) for i in range(3) for s in (-1, 1)
    )


@pytest.mark.prove
def test_expected_gain_is_the_mean_over_readings() -> None:
    """Against readings drawn from what the model believes, without and with the right rival."""
    rng = np.random.default_rng(5)
    k = 5
    names = tuple((e, str(i)) for i, e in enumerate("aabbc"))
    old, new = (A @ A.T for A in (rng.normal(size=(k, k)), 2.0 * rng.normal(size=(k, k))))
    q = Quadratic(names, -3.0, rng.normal(size=k) + old @ np.ones(k), old)
    at = {"a": np.array([0, 1]), "b": np.array([2, 3]), "c": np.array([4])}
    where = Space(q, {e: _plain(e) for e in "abc"}, dict.fromkeys("abc", 0.0), at, {})
    truth, rival = (_believed(where, frozenset(s)) for s in ("ac", "bc"))
    gained: dict[str, list[float]] = {"ac": [], "bc": []}
    root = np.linalg.cholesky(truth.now.covariance)
    for _ in range(20000):
        u = truth.now.mean + root @ rng.normal(size=3)
        b = new[:, truth.index] @ u + np.linalg.cholesky(new) @ rng.normal(size=k)
        more = replace(q, b=q.b + b, G=q.G + new)
        for key, model in (("ac", truth), ("bc", rival)):
            gained[key].append(log_evidence(more, model.index) - model.now.log_evidence)
    for key, model in (("ac", truth), ("bc", rival)):
        x = np.array(gained[key])
        expected = next_motion.evidence_gained(q, new, truth, model)
        assert abs(x.mean() - expected) < 4.0 * x.std() / math.sqrt(len(x))
    difference = np.array(gained["ac"]) - np.array(gained["bc"])
    assert difference.mean() > 1.0


def _plain(name: str) -> Effect:
    return replace(select(["gravity"])[0], id=name)


def test_turns_back_or_at_another_speed_tell_scale_from_square(one_way: Found) -> None:
    alike = rivals(one_way.space, frozenset(["gyro_scale"]), "gyro_scale")["gyro_quadratic"]
    assert abs(alike) < ENOUGH_TO_SHOW  # or the recording itself would tell
    (told,) = next_motions(one_way, [_set("gyro_scale", "gyro_quadratic")], [], "cannot_tell")
    assert told.separates == ("gyro_scale", "gyro_quadratic")
    assert told.expected_gain > 20.0
    turns = [(axis, np.sign(angle)) for axis, angle, _ in _motion(told.motion).turns if angle]
    assert any((axis, -sign) in turns for axis, sign in turns)


def test_lying_still_tells_nothing_of_turns(one_way: Found) -> None:
    found = _informations(one_way, frozenset(["gyro_scale", "gyro_quadratic"]))
    still = next(G for m, G in found.items() if "still" in m.sentence)
    back = next(G for m, G in found.items() if "vertical" in m.sentence)
    both = one_way.space, frozenset(), "gyro_scale", "gyro_quadratic"
    where, rest, a, b = both
    assert next_motion._apart(where, still, rest, a, b) < 0.1
    assert next_motion._apart(where, back, rest, a, b) > ENOUGH_TO_SHOW


def test_the_promise_is_kept(one_way: Found) -> None:
    """The motion is made, with a scale error and noise: the evidence comes as was promised."""
    like, where, rng = one_way.model.parts[0], one_way.space, np.random.default_rng(2)
    (told,) = next_motions(one_way, [_set("gyro_scale", "gyro_quadratic")], [], "cannot_tell")
    motion = _motion(told.motion)
    models = [_believed(where, frozenset([e])) for e in ("gyro_scale", "gyro_quadratic")]
    now = models[0].now
    u = now.mean + np.linalg.cholesky(now.covariance) @ rng.normal(size=3)
    truth = replace(models[0], now=replace(now, mean=u, covariance=np.zeros((3, 3))))
    G = _informations(one_way, frozenset(["gyro_scale", "gyro_quadratic"]))[motion]
    promised = [next_motion.evidence_gained(where.quadratic, G, truth, m) for m in models]

    scale = u * select(["gyro_scale"])[0].prior_sigma
    recording = _read(next_motion._case(motion, like.case).recording, like, scale, rng)
    rate = motions.rate_of(like.case.recording.streams["heading"])
    thin = math.sqrt(STREAMS["heading"].planned_hz / rate)
    levels = {**like.levels, "heading_noise": like.levels["heading_noise"] * thin}
    made = started(replace(case_of(recording, like.case.assume), fixed=levels))
    kept = []
    for effect in select(["gyro_scale", "gyro_quadratic"]):
        both, alone = (
            fitted([moved_to(p, [effect]) for p in parts], [effect], noise_rounds=0).log_evidence
            for parts in ([like, made], [like])
        )
        kept.append(both - alone)
    assert promised[0] - promised[1] > 100.0
    assert kept[0] - kept[1] == pytest.approx(promised[0] - promised[1], rel=0.3)


def _read(recording: Recording, like: Fitted, scale: Array, rng: np.random.Generator) -> Recording:
    """The readings of a gyro with this scale error, and noise at the levels of a fit."""
    imu, heading = recording.imu, recording.streams["heading"]
    per_sample = math.sqrt(recording.rate_hz)
    gyro, accel = (
        like.levels[n] * per_sample * rng.normal(size=(len(imu.t), 3))
        for n in ("gyro_noise", "accel_noise")
    )
    signals = Signals(imu.t, imu.gyro, imu.accel)
    error = select(["gyro_scale"])[0].imu_error
    assert error is not None
    gyro = imu.gyro + gyro + error(scale, signals)[:, :3]
    noisy = heading.value + 0.4 * like.levels["heading_noise"] * rng.normal(
        size=heading.value.shape
    )
    streams = {"heading": Series(heading.t, so3.wrap(noisy))}
    return replace(recording, imu=replace(imu, gyro=gyro, accel=imu.accel + accel), streams=streams)


def test_of_the_turns_of_a_session_one_both_ways_separates_them(one_way: Found) -> None:
    set_ = [_set("gyro_scale", "gyro_quadratic")]
    (told,) = next_motions(one_way, set_, [], "cannot_tell", [a.motion for a in CHOICE])
    turns = asked_for(told.motion).motion.turns
    assert told.separates == ("gyro_scale", "gyro_quadratic")
    assert {np.sign(degrees) for axis, degrees, _ in turns if axis[2] and degrees} == {-1.0, 1.0}


@pytest.mark.prove
def test_no_motion_separates_a_gauge() -> None:
    """Equal scale errors of all accelerometers are gravity: no motion is better than silence."""
    effects = {"accel_scale": [0.004] * 3}
    recording = recording_in(simulate("free-hand", seed=2, effects=effects), "heading")
    found = _found(recording, ("gravity",), "accel_scale", "lever_arm")
    set_ = [_set("gravity", "accel_scale")]
    assert next_motions(found, set_, [], "cannot_tell") == ()
    # not for want of power: a third that is no gauge of theirs is separated from the first
    (told, *_) = next_motions(found, [_set("gravity", "accel_scale", "lever_arm")], [], "explained")
    assert told.separates == ("gravity", "lever_arm")


def test_a_lever_arm_needs_two_axes(on_a_table: Found) -> None:
    hidden = _hidden(on_a_table, "lever_arm")
    assert hidden[0].expected < ENOUGH_TO_SHOW
    (told,) = next_motions(on_a_table, [], hidden, "nothing_missing")
    assert told.separates == ("lever_arm",)
    assert told.expected_gain > ENOUGH_TO_SHOW
    assert _axes(_motion(told.motion)) >= 2
    at = on_a_table.space.where["lever_arm"]
    for motion, G in _informations(on_a_table, frozenset(["lever_arm"])).items():
        own = np.linalg.eigvalsh(G[np.ix_(at, at)])
        assert (own[0] > 1.0) == (_axes(motion) >= 2), motion.sentence


def test_only_warmth_shows_what_warmth_does(on_a_table: Found) -> None:
    hidden = _hidden(on_a_table, "gyro_temperature", "accel_temperature")
    assert all(h.expected < ENOUGH_TO_SHOW for h in hidden)
    (told,) = next_motions(on_a_table, [], hidden, "nothing_missing")
    assert _motion(told.motion).warming
    assert set(told.separates) == {"gyro_temperature", "accel_temperature"}
    wanted = frozenset(told.separates)
    for motion, G in _informations(on_a_table, wanted).items():
        assert G.any() == (motion.warming > 0.0) or np.abs(G).max() < 0.1, motion.sentence


def test_without_a_thermometer_nobody_is_told_to_warm_it(one_way: Found) -> None:
    found = _informations(one_way, frozenset(["gyro_scale"]))
    assert len(found) == len(MOTIONS) - 1
    assert not any(m.warming for m in found)


@pytest.mark.prove
def test_explain_says_it() -> None:
    """The whole way: one turn about the vertical leaves most of the physics unseen."""
    from handcal.explain import explain

    world = simulate("z-turn", seed=4, start=Start())
    found = explain([recording_in(world, "heading")])
    assert found.verdict == "nothing_missing"
    (told,) = found.next_motion
    low = {h.effect for h in found.hypotheses if h.expected < ENOUGH_TO_SHOW}
    assert set(told.separates) <= low
    assert {"accel_scale", "gyro_misalignment"} & set(told.separates)
    assert _axes(_motion(told.motion)) >= 2

"""Iron that stays in the room, and iron that changes: a magnetometer in a hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal import calibrate
from handcal.device.apply import NO_STREAM, NOT_ASKED, Learnt, apply
from handcal.device.conceal import conceal
from handcal.effects import Z_DIM, catalogue, observed_error
from handcal.effects._field import GRADIENT
from handcal.estimate.baseline import baseline
from handcal.estimate.case import Case, applicable, case_of, frozen_at
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.specification import document_of
from handcal.explain import explain
from handcal.explain.model_file import chosen_from
from handcal.explanation import Explanation
from handcal.model_score import PRIOR, WINDOW, prior
from handcal.search.jumps import sudden
from handcal.types import InputError, Recording
from handcal_sim import simulate
from handcal_sim.phone import (
    Clocking,
    Phone,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
    with_rate,
)
from handcal_sim.scenario import World

IRON = {
    "mag_hard_iron": [2e-5, -3e-5, 4e-5],
    "mag_soft_iron": [0.08, -0.05, -0.03, 0.04, -0.05, 0.06],
}
STEP = [2e-5, -1.5e-5, 2.5e-5, 11.0]


def compass(rng: np.random.Generator) -> Phone:
    """A consumer's phone that reads fifty times a second, its magnetometer half as often."""
    mag = replace(consumer_magnetometer(rng), clocking=Clocking(25.0))
    return replace(with_rate(consumer_phone(rng), 50.0), heading=None, mag=mag)


def watched(rng: np.random.Generator) -> Phone:
    """The same in sight of motion capture."""
    return replace(compass(rng), pose=capture_pose(rng))


def world_of(effects: dict[str, list[float]], seed: int, duration: float = 60.0) -> World:
    return simulate("free-hand", seed=seed, duration_s=duration, phone=compass, effects=effects)


def drawn(seed: int, sizes: dict[str, tuple[int, float]]) -> dict[str, list[float]]:
    """So many numbers of about that size for each effect, of either sign."""
    rng = np.random.default_rng(100 + seed)
    return {
        name: (size * rng.uniform(0.7, 1.3, n) * rng.choice([-1, 1], n)).tolist()
        for name, (n, size) in sizes.items()
    }


def check(found: Explanation, effect: str, truth: list[float], sigmas: float) -> None:
    entry = next(m for m in found.missing if m.effect == effect)
    assert entry.probability > 0.99
    for p, value in zip(entry.parameters, truth, strict=True):
        assert abs(p.value - value) < sigmas * p.sigma, (effect, p.name, p.value, p.sigma, value)


@pytest.fixture(scope="module")
def plain() -> Recording:
    return recording_of(world_of({"lever_arm": [0.1, -0.08, 0.06]}, 0, 24.0), "mag")


# --- what explain finds ---------------------------------------------------------------------------


@pytest.mark.prove
def test_a_step_is_found_and_can_be_written_down() -> None:
    """In twenty seconds; a model read again holds the step at the same moment."""
    found = explain([recording_of(world_of({"mag_step": STEP}, 0, 20.0), "mag")])
    assert found.verdict == "explained"
    assert [m.effect for m in found.missing] == ["mag_step"]
    check(found, "mag_step", STEP, 3.0)
    assert found.missing[0].parameters[-1].sigma < 0.1
    assert found.model is not None
    document = json.loads(json.dumps(document_of(found.model)))
    (held,) = (e for e in chosen_from(document).effects if "@" in e.id)
    assert len(held.parameters) == 3
    np.testing.assert_allclose(held.held, [np.nan, np.nan, np.nan, STEP[3]], atol=0.1)


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_found_beside_the_usual_irons(seed: int) -> None:
    at = float(np.random.default_rng(seed).uniform(15.0, 45.0))
    effects = {"mag_step": [*drawn(seed, {"mag_step": (3, 2e-5)})["mag_step"], at]}
    found = explain([recording_of(world_of({**effects, **IRON}, seed), "mag")])
    assert {m.effect for m in found.missing} == {"mag_step", *IRON}
    check(found, "mag_step", effects["mag_step"], 3.0)


@pytest.mark.prove
@pytest.mark.parametrize("iron", [{}, IRON], ids=["alone", "irons"])
@pytest.mark.parametrize("seed", range(6))
def test_a_gradient_is_found_at_the_end_of_an_arm(seed: int, iron: dict[str, list[float]]) -> None:
    """With the arm, and the soft iron draws the field as it is at the device."""
    effects = drawn(seed, {"mag_gradient": (5, 2e-5), "lever_arm": (3, 0.08)})
    found = explain([recording_of(world_of({**effects, **iron}, seed), "mag")])
    assert {m.effect for m in found.missing} == {*effects, *iron}
    check(found, "mag_gradient", effects["mag_gradient"], 3.0)
    if iron:
        # (the trace is the field's own strength)
        check(found, "mag_soft_iron", IRON["mag_soft_iron"], 4.0)


@pytest.mark.prove
@pytest.mark.parametrize("arm", [{}, {"lever_arm": [0.1, -0.07, 0.05]}], ids=["point", "arm"])
@pytest.mark.parametrize("seed", range(8))
def test_neither_is_found_where_it_is_not(seed: int, arm: dict[str, list[float]]) -> None:
    found = explain([recording_of(world_of({**IRON, **arm}, seed), "mag")])
    assert {m.effect for m in found.missing} == {*IRON, *arm}
    assert found.verdict == "explained"


# --- what they need -------------------------------------------------------------------------------


def test_a_gradient_needs_a_place() -> None:
    """A held point or a pose tells where the device is; rests alone do not, nor does a gyro."""
    gradient, step = catalogue()["mag_gradient"], catalogue()["mag_step"]
    world = simulate("travel", seed=0, duration_s=40.0, phone=watched)
    mag, both = recording_of(world, "mag"), recording_of(world, "mag", "pose")
    for recording, assume, there in (
        (mag, "fixed-point", True), (mag, "rest-only", False), (both, "fixed-point", True),
        (both, "rest-only", True),
    ):  # fmt: skip
        case = case_of(recording, assume)
        assert applicable(case, gradient) == there
        assert applicable(case, step)
    bare = replace(mag, streams={})
    assert not applicable(case_of(bare, "fixed-point"), gradient)
    with pytest.raises(InputError, match="depends on the position of the device"):
        calibrate(mag, ["mag_gradient"], assume="rest-only")


def test_each_kind_of_step_shares_its_own_odds(plain: Recording) -> None:
    """Moments of one are no rivals of those of the other; of a gyro there are as many as there are
    short windows, of a magnetometer as there are readings."""
    many = [frozen_at(catalogue()["mag_step"], np.array([0, 0, 0, at])) for at in (5.0, 9.0)]
    one = [frozen_at(catalogue()["gyro_bias_step"], np.array([0, 0, 0, 5.0]))]
    case = case_of(plain, "fixed-point")
    count = len(case.observed[case.kinds.index("magnetometer")][1].t)
    assert prior(one[0], [case]) == PRIOR - np.log(int(plain.duration_s / WINDOW))
    assert [prior(e, [case]) for e in many] == [PRIOR - np.log(count)] * 2
    assert prior(catalogue()["mag_gradient"], [case]) == PRIOR
    assert prior(catalogue()["mag_soft_iron"], [case]) == 0.0  # (every magnetometer has it)
    assert all(applicable(case, e) for e in (*many, *one))


# --- the mechanism --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stepped(plain: Recording) -> Case:
    rng = np.random.default_rng(0)
    return case_of(conceal(plain, {"mag_step": STEP}, rng), "fixed-point")


def test_a_step_shows_where_a_reading_was_least_expected(stepped: Case) -> None:
    base = baseline([stepped])
    (part,) = base.parts
    done = reduced_pass(reduce(part.linear), part.levels)
    moments = sudden(part, {"magnetometer"}, done)
    assert np.abs(moments - STEP[3]).min() < 0.06
    assert len(sudden(part, {"heading"}, done)) == 0


@pytest.mark.prove
def test_a_held_step_is_fitted_for_the_rest(stepped: Case) -> None:
    """Three numbers; right at the right moment, and the evidence falls at once beside it."""
    base, step = baseline([stepped]), catalogue()["mag_step"]
    right, wrong = (
        fitted(base.parts, [*base.effects, frozen_at(step, np.array([0.0, 0.0, 0.0, at]))])
        for at in (STEP[3], STEP[3] + 1.0)
    )
    own = [i for i, (owner, _) in enumerate(right.quadratic.names) if owner.startswith("mag_step")]
    assert len(own) == 3
    sigma = np.sqrt(np.diag(right.covariance))[own] * 2e-5
    assert np.all(np.abs(right.u[own] * 2e-5 - STEP[:3]) < 4.0 * sigma)
    assert right.log_evidence > wrong.log_evidence + 100.0


def test_what_a_held_step_adds() -> None:
    """The same as the whole effect at its moment."""
    step = catalogue()["mag_step"]
    held = frozen_at(step, np.array([0.0, 0.0, 0.0, STEP[3]]))
    assert held.id == "mag_step@11.000"
    assert held.imu_error is None
    z, nav = np.zeros((40, Z_DIM)), np.zeros((40, 21))
    z[:, -1] = np.arange(40.0)
    np.testing.assert_array_equal(
        observed_error(held, "magnetometer", np.array(STEP[:3]), nav, z, 3),
        observed_error(step, "magnetometer", np.array(STEP), nav, z, 3),
    )


def test_others_know_of_the_gradient(plain: Recording) -> None:
    """Where the field is linearised z holds the gradient, and zeros where the model has none."""
    base = baseline([case_of(plain, "fixed-point")])
    both = [catalogue()[i] for i in ("lever_arm", "mag_gradient")]
    found = fitted(base.parts, [*base.effects, *both], noise_rounds=0)
    for model, there in ((base, False), (found, True)):
        linear = model.parts[0].linear
        owners = [s.owner for s in linear.problem.slots]
        mine = linear.kind == [o.kind for o in linear.problem.observations].index("magnetometer")
        z = linear.problem.nodes.z[mine][:, GRADIENT : GRADIENT + 5]
        own = linear.trajectory.constants[[o == "mag_gradient" for o in owners]]
        assert len(own) == 5 * there
        np.testing.assert_array_equal(z, np.tile(own, (len(z), 1)) if there else 0.0 * z)


# --- put in, and taken off ------------------------------------------------------------------------


def test_a_concealed_gradient_is_that_of_the_simulator(plain: Recording) -> None:
    """As far as the arm and the way the field points are known: to a few percent."""
    truth = [2e-5, -3e-5, 1e-5, 2.5e-5, -2e-5]
    recording = conceal(plain, {"mag_gradient": truth}, np.random.default_rng(0))
    effects = {"lever_arm": [0.1, -0.08, 0.06], "mag_gradient": truth}
    wanted = recording_of(world_of(effects, 0, 24.0), "mag").streams["mag"].value
    was = plain.streams["mag"].value
    wrong = recording.streams["mag"].value - wanted
    assert np.sqrt((wrong**2).mean()) < 0.05 * np.sqrt(((wanted - was) ** 2).mean())
    bare = replace(plain, streams={})
    with pytest.raises(InputError, match="mag_gradient needs a stream mag"):
        conceal(bare, {"mag_gradient": truth}, np.random.default_rng(0))


def test_a_step_is_put_in_and_taken_off(plain: Recording) -> None:
    """Of the day, so with the biases alone; and where there is no magnetometer, not at all."""
    recording = conceal(plain, {"mag_step": STEP}, np.random.default_rng(0))
    mag, was = recording.streams["mag"], plain.streams["mag"]
    later = mag.t - plain.imu.t[0] >= STEP[3]
    np.testing.assert_allclose(mag.value - was.value, later[:, None] * STEP[:3], atol=1e-18)
    learnt = Learnt("x.json", {"mag_step": np.array(STEP)}, (("", np.zeros(6)),), ())
    done = apply(recording, learnt, biases=True)
    np.testing.assert_allclose(done.recording.streams["mag"].value, was.value, atol=1e-18)
    assert apply(recording, learnt).left[NOT_ASKED] == ("gyro_bias", "accel_bias", "mag_step")
    bare = apply(replace(recording, streams={}), learnt, biases=True)
    assert bare.left == {NO_STREAM: ("mag_step",)}

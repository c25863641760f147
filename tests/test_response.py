"""The one matrix of a fit: scans, looks at noise and moments of steps are projections of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import catalogue, imu_jacobian
from handcal.estimate.baseline import baseline, dense
from handcal.estimate.case import case_of, frozen_at
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic, log_evidence
from handcal.estimate.scan import scan
from handcal.estimate.transfer import moved_to
from handcal.laws import with_motion
from handcal.laws.law_effect import SIZE
from handcal.laws.short_windows import windows_of
from handcal.search.noise_scan import all_noise, looks_of
from handcal.search.response import (
    Columns,
    Response,
    held,
    noise_columns,
    response,
    step_columns,
)
from handcal.search.select import Priors, chosen, select, space_beside
from handcal.search.select_laws import best_laws, confirmed, courses_on
from handcal_sim import simulate

# Nats within which the matrix says what a pass of its own does: of walks and steps, which are
# smooth in a window or begin with one; and of what changes in it, as the motion does.
SLOW, QUICK = 0.5, 2.5
STEP, AT = "gyro_bias_step", 30.0
PLAIN = Priors(lambda _: 0.0)


@pytest.fixture(scope="module")
def model() -> Model:
    """Of a hand's recording with a step, and an error of the accelerometer that walks."""
    errors = {STEP: np.array([0.004, -0.002, 0.003, AT]), "accel_bias_walk": np.array([0.01])}
    world = simulate("free-hand", seed=0, duration_s=60.0, effects=errors)
    return dense(baseline([case_of(recording_of(world, "heading"))]))


@pytest.fixture(scope="module")
def matrix(model: Model) -> Response:
    return response(model, 1.0)


def _evidence(r: Response, model: Model, *more: Columns) -> float:
    """Of the model with noise or steps besides, by the matrix; priors as in one pass."""
    noise = {c.effect.id: c for c in more if c.effect.process is not None}
    steps = [c for c in more if c.effect.process is None]
    q = space_beside(r, PLAIN, noise, steps).quadratic
    return log_evidence(q, _places(q, {*model.chosen, *(c.effect.id for c in steps)}))


def _places(q: Quadratic, ids: set[str]) -> np.ndarray:
    return np.flatnonzero([owner in ids for owner, _ in q.names])


def test_named_effects_are_as_a_scan_has_them(model: Model, matrix: Response) -> None:
    q = scan(model, matrix.effects)
    at = matrix.named
    assert [matrix.quadratic.names[i] for i in at] == list(q.names)
    share = q.worth
    np.testing.assert_allclose(matrix.quadratic.b[at], q.b / share, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(
        matrix.quadratic.G[np.ix_(at, at)], q.G / share, rtol=1e-6, atol=1e-4
    )


def test_noise_is_what_a_look_of_the_filter_says(model: Model, matrix: Response) -> None:
    without = _evidence(matrix, model)
    told = []
    for e in all_noise():
        for look in looks_of(model.parts, model.effects, [e], 1):
            levels = {lv.name: look.parts[0].levels[lv.name] for lv in e.levels}
            if e not in matrix.noise or not held(e, levels, matrix.windows):
                continue
            gain = _evidence(matrix, model, noise_columns(matrix, e, levels)) - without
            near = QUICK if with_motion.is_with_motion(e.id) else SLOW
            assert gain == pytest.approx(look.gain, abs=near), e.id
            told.append(look.gain)
    assert max(told) > 20.0
    assert len(told) >= 4


@pytest.mark.parametrize("factor", [0.1, 0.3, 1.0, 3.0, 10.0])
def test_a_walk_at_any_level(model: Model, matrix: Response, factor: float) -> None:
    walk = catalogue()["accel_bias_walk"]
    (level,) = walk.levels
    levels = {level.name: factor * level.initial}
    wide = moved_to(model.parts[0], (*model.effects, walk))
    with_it = reduced_pass(reduce(wide.linear), {**wide.levels, **levels}).log_evidence
    plain = moved_to(model.parts[0], model.effects)
    gain = with_it - reduced_pass(reduce(plain.linear), plain.levels).log_evidence
    told = _evidence(matrix, model, noise_columns(matrix, walk, levels)) - _evidence(matrix, model)
    assert told == pytest.approx(gain, abs=SLOW)


@pytest.mark.parametrize("kind", ["turning", "attitude"])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_an_error_with_the_motion_of_any_memory(
    model: Model, matrix: Response, sensor: str, kind: str
) -> None:
    """Where it is integrated, also of a memory that is short against a window."""
    e = with_motion.effect(sensor, (0, 1, 2), kind)
    size, memory = e.levels
    wide, plain = moved_to(model.parts[0], (*model.effects, e)), model.parts[0]
    plain = moved_to(plain, model.effects)
    passes, without = reduce(wide.linear), _evidence(matrix, model)
    base = reduced_pass(reduce(plain.linear), plain.levels).log_evidence
    for times in (0.3, 1.0, 3.0, 10.0):
        levels = {size.name: 0.3 * size.initial, memory.name: times * memory.initial}
        gain = reduced_pass(passes, {**wide.levels, **levels}).log_evidence - base
        told = _evidence(matrix, model, noise_columns(matrix, e, levels)) - without
        assert told == pytest.approx(gain, abs=QUICK), times


@pytest.mark.parametrize("edge", [20, 90, 150])
def test_a_step_at_an_edge_is_a_sum_of_windows(model: Model, matrix: Response, edge: int) -> None:
    step = frozen_at(catalogue()[STEP], np.array([0.0, 0.0, 0.0, edge * matrix.windows.width]))
    q = scan(model, [step], worth=1.0)
    gain = log_evidence(q, _places(q, {*model.chosen, step.id})) - log_evidence(
        q, _places(q, set(model.chosen))
    )
    told = _evidence(matrix, model, step_columns(matrix, step, edge)) - _evidence(matrix, model)
    assert told == pytest.approx(gain, abs=SLOW)


@pytest.mark.parametrize("name", ["gyro_quadratic", "gyro_cross_products", "accel_asymmetry"])
def test_a_law_is_its_means_in_the_windows(model: Model, matrix: Response, name: str) -> None:
    """Of effects of the catalogue, whose columns are in the matrix as well."""
    effect = catalogue()[name]
    q = matrix.quadratic
    whole = log_evidence(q, _places(q, {*model.chosen, name}))
    signals = matrix.motion
    slopes = imu_jacobian(effect, np.zeros(len(effect.parameters)), signals) * effect.prior_sigma
    window = windows_of(signals.t, signals.t, matrix.windows.width)
    count = np.bincount(window)
    C = np.zeros((len(q.b), len(effect.parameters)))
    for (sensor, axis), at in matrix.windows.at.items():
        for k in range(len(effect.parameters)) if sensor < 2 else ():
            column = slopes[:, 3 * sensor + axis, k]
            C[at, k] = np.bincount(window, column) / count / SIZE[sensor]
    own = _places(q, set(model.chosen))
    V = np.hstack([np.eye(len(q.b))[:, own], C])
    names = tuple(("", str(k)) for k in range(V.shape[1]))
    in_windows = Quadratic(names, q.a, V.T @ q.b, V.T @ q.G @ V)
    assert log_evidence(in_windows, np.arange(len(names))) == pytest.approx(whole, abs=QUICK)


def test_noise_of_the_model_is_columns_again(model: Model) -> None:
    """What the matrix says of a model with a walk, with that taken out of the filter, is what its
    fit says; and a memory that is short against a window stays in the filter."""
    walk, sway = catalogue()["accel_bias_walk"], catalogue()["heading_correlated_noise"]
    grown = fitted(model.parts, [*model.effects, walk, sway])
    short = {sway.levels[0].name: 0.01, sway.levels[1].name: 0.1}
    grown = replace(
        grown, parts=tuple(replace(f, levels={**f.levels, **short}) for f in grown.parts)
    )
    r = response(grown, 1.0)
    assert set(r.levels) == {walk.id}
    assert [e.id for e in r.filtered] == [sway.id]


def test_both_are_found_at_once(model: Model) -> None:
    first, best = select(
        response(model),
        Priors(lambda e: -5.0 if not e.common else 0.0, always=model.chosen),
        model.chosen,
    )
    found = {i.split("@")[0]: i for i in best[0].ids - set(model.ids)}
    assert set(found) == {STEP, "accel_bias_walk"}
    assert float(found[STEP].split("@")[1]) == pytest.approx(AT, abs=1.0)
    assert best[0].score > first.score


def test_a_law_by_its_windows_is_what_a_scan_of_it_says(model: Model) -> None:
    """Of the best of thousands, where whatever windows get wrong would stand out."""
    r = response(model)
    priors = Priors(lambda e: -e.cost, always=model.chosen)
    choice = chosen(r, priors, model.chosen, {})
    found = [f for rivals in best_laws(r, priors, choice, courses_on(r)) for f in rivals]
    assert {f.effect.id.split("_")[0].split(" ")[0] for f in found} == {"gyro", "accel", "heading"}
    for law in found:
        assert law.nats == pytest.approx(confirmed(model, law, r.quadratic.worth), abs=QUICK)


def test_several_recordings_are_refused(model: Model) -> None:
    with pytest.raises(ValueError, match="one recording"):
        response(replace(model, parts=(*model.parts, *model.parts)))

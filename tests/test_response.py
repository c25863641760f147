"""The one matrix of a fit to one recording or two: scans, noise, moments of steps and laws are
projections of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import Effect, catalogue
from handcal.estimate.baseline import baseline, dense
from handcal.estimate.case import case_of, frozen_at
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic, log_evidence
from handcal.estimate.scan import scan
from handcal.estimate.transfer import moved_to
from handcal.laws import with_motion
from handcal.laws.short_windows import constants, means
from handcal.search.noise_scan import looks_of
from handcal.search.response import (
    Columns,
    Response,
    held,
    noise_columns,
    response,
    step_columns,
)
from handcal.search.select import Priors, chosen, processes_of, select, space_beside
from handcal.search.select_laws import NEAR, confirmed, courses_on, groups_of, laws_of
from handcal_sim import simulate

# Nats within which the matrix says what a pass of its own does: of walks and steps, which are
# smooth in a window or begin with one; and of what changes in it, as the motion does.
SLOW, QUICK = 0.5, 2.5
STEP, AT = "gyro_bias_step", 30.0
PLAIN = Priors(lambda _: 0.0)


@pytest.fixture(scope="module")
def model() -> Model:
    """Of a hand's recording with a step, and an error of the accelerometer that walks."""
    return _fitted(60.0)


@pytest.fixture(scope="module")
def matrix(model: Model) -> Response:
    return _full(model)


@pytest.fixture(scope="module", params=[(60.0,), (60.0, 30.0)], ids=["one", "two"])
def some(request: pytest.FixtureRequest) -> tuple[Model, Response]:
    """Of one recording, or of two."""
    model = _fitted(*request.param)
    return model, _full(model)


def _fitted(*seconds: float) -> Model:
    cases = []
    for seed, duration_s in enumerate(seconds):
        errors = {STEP: np.array([0.004, -0.002, 0.003, AT]), "accel_bias_walk": np.array([0.01])}
        world = simulate("free-hand", seed=seed, duration_s=duration_s, effects=errors)
        cases.append(case_of(recording_of(world, "heading")))
    return dense(baseline(cases))


def _full(model: Model) -> Response:
    """Its matrix, of which evidence counts in full."""
    return replace(response(model), worth=1.0)


def _filtered(
    model: Model, e: Effect | None = None, levels: Mapping[str, float] | None = None
) -> float:
    """Log-evidence by passes of the filter, with noise besides."""
    if e is not None:
        effects = (*model.effects, e)
        wide = [moved_to(f, effects) for f in model.parts]
        parts = tuple(replace(f, levels={**f.levels, **(levels or {})}) for f in wide)
        model = replace(model, effects=effects, parts=parts)
    q = scan(model, [], worth=1.0)
    return log_evidence(q, _places(q, set(model.chosen)))


def _evidence(r: Response, model: Model, *more: Columns) -> float:
    """Of the model with noise or steps besides, by the matrix; priors as in one pass."""
    noise = {c.effect.id: c for c in more if c.effect.process is not None}
    steps = [c for c in more if c.effect.process is None]
    q = space_beside(r, PLAIN, noise, steps).quadratic
    return log_evidence(q, _places(q, {*model.chosen, *(c.effect.id for c in steps)}))


def _places(q: Quadratic, ids: set[str]) -> np.ndarray:
    return np.flatnonzero([owner in ids for owner, _ in q.names])


def test_named_effects_are_as_a_scan_has_them(some: tuple[Model, Response]) -> None:
    model, matrix = some
    q = scan(model, matrix.effects, worth=1.0)
    at = matrix.named
    assert [matrix.quadratic.names[i] for i in at] == list(q.names)
    np.testing.assert_allclose(matrix.quadratic.b[at], q.b, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(matrix.quadratic.G[np.ix_(at, at)], q.G, rtol=1e-6, atol=1e-4)


def test_windows_add_up_to_constants(some: tuple[Model, Response]) -> None:
    """A constant on each axis, followed through a whole pass, is the sum of all its windows: alone,
    with each other, and with effects that have a name. (Biases are integrated out, so that nearly
    all of it cancels.)"""
    model, matrix = some
    whole = [constants(*channel, 1) for channel in matrix.windows.at]
    q = scan(model, [*matrix.effects, *whole], worth=1.0)
    own = [k for k, (owner, _) in enumerate(q.names) if owner.startswith("windows")]
    names = [q.names.index(matrix.quadratic.names[i]) for i in matrix.named]
    sums = np.zeros((len(own), len(matrix.quadratic.b)))
    for row, at in zip(sums, matrix.windows.at.values(), strict=True):
        row[at] = 1.0
    G = sums @ matrix.quadratic.G
    np.testing.assert_allclose(sums @ matrix.quadratic.b, q.b[own], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(G @ sums.T, q.G[np.ix_(own, own)], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(G[:, matrix.named], q.G[np.ix_(own, names)], rtol=1e-6, atol=1e-3)


@pytest.mark.prove
def test_its_evidence_is_worth_what_a_scan_of_all_names_says(model: Model) -> None:
    assert 0.0 < response(model).worth <= 1.0
    assert response(model).worth == pytest.approx(scan(model, response(model).effects).worth)


@pytest.mark.prove
def test_noise_is_what_a_look_of_the_filter_says(some: tuple[Model, Response]) -> None:
    model, matrix = some
    without, plain = _evidence(matrix, model), _filtered(model)
    told = []
    for e in matrix.noise:
        for look in looks_of(model.parts, model.effects, [e], 1):
            levels = {lv.name: look.parts[0].levels[lv.name] for lv in e.levels}
            each = [levels] * len(model.parts)
            if not held(e, each, matrix.windows):
                continue
            gain = _evidence(matrix, model, noise_columns(matrix, e, each)) - without
            near = QUICK if with_motion.is_with_motion(e.id) else SLOW
            told.append(_filtered(model, e, levels) - plain)
            assert gain == pytest.approx(told[-1], abs=near), e.id
    assert max(told) > 20.0
    assert len(told) >= 4


@pytest.mark.parametrize("factor", [0.1, 0.3, 1.0, 3.0, 10.0])
def test_a_walk_at_any_level(some: tuple[Model, Response], factor: float) -> None:
    model, matrix = some
    walk = catalogue()["accel_bias_walk"]
    (level,) = walk.levels
    levels = {level.name: factor * level.initial}
    noise = noise_columns(matrix, walk, [levels] * len(model.parts))
    told = _evidence(matrix, model, noise) - _evidence(matrix, model)
    assert told == pytest.approx(_filtered(model, walk, levels) - _filtered(model), abs=SLOW)


@pytest.mark.parametrize("kind", ["turning", "attitude"])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_an_error_with_the_motion_of_any_memory(
    model: Model, matrix: Response, sensor: str, kind: str
) -> None:
    """Where it is integrated, also of a memory that is short against a window."""
    e = with_motion.effect(sensor, (0, 1, 2), kind)
    size, memory = e.levels
    without, plain = _evidence(matrix, model), _filtered(model)
    for times in (0.3, 1.0, 3.0, 10.0):
        levels = {size.name: 0.3 * size.initial, memory.name: times * memory.initial}
        told = _evidence(matrix, model, noise_columns(matrix, e, [levels])) - without
        assert told == pytest.approx(_filtered(model, e, levels) - plain, abs=QUICK), times


@pytest.mark.parametrize("edge", [20, 90, 150])
def test_a_step_at_an_edge_is_a_sum_of_windows(model: Model, matrix: Response, edge: int) -> None:
    begin = matrix.windows.each[0].edges[edge] - matrix.windows.motion[0].t[0]
    step = frozen_at(catalogue()[STEP], np.array([0.0, 0.0, 0.0, begin]))
    q = scan(model, [step], worth=1.0)
    gain = log_evidence(q, _places(q, {*model.chosen, step.id})) - log_evidence(
        q, _places(q, set(model.chosen))
    )
    told = _evidence(matrix, model, step_columns(matrix, step, edge)) - _evidence(matrix, model)
    assert told == pytest.approx(gain, abs=SLOW)


@pytest.mark.parametrize("name", ["gyro_quadratic", "gyro_cross_products", "accel_asymmetry"])
def test_a_law_is_its_means_in_the_windows(some: tuple[Model, Response], name: str) -> None:
    """Of effects of the catalogue, whose columns are in the matrix as well, and in a scan."""
    model, matrix = some
    effect, q = catalogue()[name], matrix.quadratic
    of_scan = scan(model, [effect], worth=1.0)
    whole = log_evidence(of_scan, _places(of_scan, {*model.chosen, name}))
    assert log_evidence(q, _places(q, {*model.chosen, name})) == pytest.approx(whole, abs=1e-3)
    C = np.zeros((len(q.b), len(effect.parameters)))
    for sensor in (0, 1):
        parts = [
            means(effect, sensor, s, w.of(s.t), w.count).reshape(3, w.count, -1)
            for w, s in zip(matrix.windows.each, matrix.windows.motion, strict=True)
        ]
        C[matrix.windows.of(sensor)] = np.concatenate(parts, axis=1).reshape(-1, C.shape[1])
    own = _places(q, set(model.chosen))
    V = np.hstack([np.eye(len(q.b))[:, own], C])
    names = tuple(("", str(k)) for k in range(V.shape[1]))
    in_windows = Quadratic(names, q.a, V.T @ q.b, V.T @ q.G @ V)
    assert log_evidence(in_windows, np.arange(len(names))) == pytest.approx(whole, abs=QUICK)


@pytest.mark.prove
def test_noise_of_the_model_is_columns_again(model: Model) -> None:
    """What the matrix says of a model with a walk, with that taken out of the filter, is what its
    fit says; and a memory that is short against a window stays in the filter."""
    walk, sway = catalogue()["accel_bias_walk"], catalogue()["heading_correlated_noise"]
    grown = fitted(model.parts, [*model.effects, walk, sway])
    short = {sway.levels[0].name: 0.01, sway.levels[1].name: 0.1}
    grown = replace(
        grown, parts=tuple(replace(f, levels={**f.levels, **short}) for f in grown.parts)
    )
    r = response(grown)
    assert set(r.levels) == {walk.id}
    assert [e.id for e in r.filtered] == [sway.id]


def test_both_are_found_at_once(model: Model) -> None:
    r = response(model)
    priors = Priors(lambda e: -5.0 if not e.common else 0.0, always=model.chosen)
    first, best = select(r, priors, processes_of(r), model.chosen)
    found = {i.split("@")[0]: i for i in best.ids - set(model.ids)}
    assert set(found) == {STEP, "accel_bias_walk"}
    assert float(found[STEP].split("@")[1]) == pytest.approx(AT, abs=1.0)
    assert best.score > first.score


@pytest.mark.prove
def test_a_law_by_its_windows_is_what_a_scan_of_it_says(some: tuple[Model, Response]) -> None:
    """Of the best of thousands, where whatever windows get wrong would stand out. Each is near the
    best of its group, and another one. (A law over a derivative is evaluated at 40 Hz.)"""
    model, r = some[0], response(some[0])
    priors = Priors(lambda e: -e.cost, always=model.chosen)
    choice = chosen(r, priors, model.chosen, {})
    found = [
        next(groups_of(laws_of(r, priors, choice, sensor, courses)))
        for sensor, courses in courses_on(r.windows).items()
    ]
    sensors = {f.effect.id.split("_")[0].split(" ")[0] for rivals in found for f in rivals}
    assert sensors == {"gyro", "accel", "heading"}
    for rivals in found:
        told = {f.effect.id: f.nats for f in rivals}
        assert len(told) == len(rivals)
        assert all(rivals[0].score >= f.score > rivals[0].score - NEAR for f in rivals)
        wanted = {f.effect.id: confirmed(model, f, r.worth) for f in rivals}
        assert told == pytest.approx(wanted, abs=QUICK, rel=0.25)

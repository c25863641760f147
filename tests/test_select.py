"""The search on a matrix, on matrices of which the best set is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np
import pytest

from handcal.effects import Effect, Param, Signals, catalogue
from handcal.estimate.fit import diverged
from handcal.estimate.quadratic import Quadratic
from handcal.laws import short_windows, with_motion
from handcal.laws.law_effect import SIZE
from handcal.model_score import prior
from handcal.search import select as on_matrix
from handcal.search.climb import Change
from handcal.search.response import (
    Columns,
    Response,
    Windows,
    covariance,
    noise_columns,
    step_columns,
)
from handcal.search.select import (
    Choice,
    Priors,
    best_sets,
    missed,
    processes_of,
    select,
    space_beside,
    step_gains,
)
from handcal.search.space import space

# Windows of a third of a second; how well a window tells of its channel, in units of its ``SIZE``.
COUNT, WIDTH, TOLD = 90, 1.0 / 3.0, 30.0
KEYS = [(sensor, axis) for sensor in (0, 1) for axis in range(3)]
NOISE = ("gyro_bias_walk", "accel_bias_walk")


def _priors() -> Priors:
    return Priors(lambda e: prior(e, []))


def _effect(name: str, count: int) -> Effect:
    parameters = tuple(Param(f"p{k}", "", 1.0) for k in range(count))
    return Effect(name, name, parameters, "", "", "", "")


def _response(
    seed: int, errors: Mapping[tuple[int, int], np.ndarray], parts: int = 1
) -> tuple[Response, np.ndarray]:
    """A matrix of windows of two sensors in some recordings, beside them four effects, which go
    with courses that are smooth; and these courses (channels, parts * COUNT) for each parameter.
    errors (parts * COUNT,) of channels, SI.
    """
    rng, count = np.random.default_rng(seed), parts * COUNT
    effects = [_effect(name, 2) for name in ("alpha", "beta", "gamma", "delta")]
    edges = np.arange(COUNT + 1) * WIDTH
    t = (np.arange(count) + 0.5) * WIDTH
    shapes = rng.normal(size=(8, len(KEYS), 1)) * np.sin(
        rng.uniform(0.3, 3.0, (8, 1, 1)) * t + rng.uniform(0.0, 6.0, (8, 1, 1))
    )
    J = TOLD * np.hstack([shapes.reshape(8, -1).T, np.eye(len(KEYS) * count)])
    truth = np.zeros((len(KEYS), count))
    for key, error in errors.items():
        truth[KEYS.index(key)] = error / SIZE[key[0]]
    y = TOLD * truth.ravel() + rng.normal(size=len(J))
    names = [(e.id, p.name) for e in effects for p in e.parameters]
    names += [(f"windows: {s} {a}", f"w{k}") for s, a in KEYS for k in range(count)]
    at = {key: 8 + k * count + np.arange(count) for k, key in enumerate(KEYS)}
    turning = np.zeros((COUNT, 3))
    turning[:, 2] = 1.0 + np.sin(edges[:-1])
    motion = Signals(edges[:-1], turning, np.zeros((COUNT, 3)))
    each = short_windows.Windows(edges, np.arange(COUNT))
    noise = [catalogue()[i] for i in NOISE] + [with_motion.effect("gyro", (0, 1, 2), "attitude")]
    q = Quadratic(tuple(names), 0.0, J.T @ y, J.T @ J)
    told = {k: np.zeros(3) for k in (0, 1)}
    windows = Windows([each] * parts, [motion] * parts, at, told)
    nothing = diverged((), ())
    return Response(nothing, q, 1.0, tuple(effects), tuple(noise), {}, (), windows, {}, []), shapes


def _named(seed: int, sizes: Mapping[int, float], parts: int = 1) -> Response:
    """A matrix of recordings with effects: sizes of their parameters by number."""
    _, shapes = _response(seed, {}, parts)
    whole = np.einsum("p,pnk->nk", [sizes.get(k, 0.0) for k in range(8)], shapes)
    errors = {key: whole[n] * SIZE[key[0]] for n, key in enumerate(KEYS)}
    return _response(seed, errors, parts)[0]


def _selected(
    r: Response, priors: Priors | None = None, start: Iterable[str] = ()
) -> tuple[Choice, Choice]:
    """The choice at the start, and the best."""
    return select(r, priors or _priors(), processes_of(r), start)


def _walks(seed: int, density: float, count: int = COUNT) -> dict[tuple[int, int], np.ndarray]:
    """An error of the accelerometer that walks on each axis."""
    rng = np.random.default_rng([seed, 1])
    walks = np.cumsum(rng.normal(size=(3, count)) * density * np.sqrt(WIDTH), axis=1)
    return {(1, axis): walks[axis] for axis in range(3)}


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_the_names_that_are_there_and_no_others(seed: int, parts: int) -> None:
    _, best = _selected(_named(seed, {0: 0.3, 1: -0.2, 4: 0.4}, parts))
    assert best.ids == {"alpha", "gamma"}


def test_two_recordings_name_what_neither_does() -> None:
    """What one tells of it does not pay for it; what both do pays."""
    one, two = (_named(0, {0: 0.3}, parts) for parts in (1, 2))
    where = space_beside(two, Priors(lambda _: 0.0), {})
    odds = 0.75 * (where.score([]) - where.score(["alpha"]))
    found = [_selected(r, Priors(lambda _: odds))[1].ids for r in (one, two)]
    assert found == [frozenset(), {"alpha"}]


@pytest.mark.parametrize("seed", range(5))
def test_of_nothing_nothing(seed: int) -> None:
    assert not _selected(_named(seed, {}))[1].ids


@pytest.mark.parametrize("seed", range(5))
def test_a_step_has_its_moment_and_is_no_walk(seed: int) -> None:
    after = np.arange(COUNT) >= 40 + seed
    _, best = _selected(_response(seed, {(0, 1): 0.01 * after})[0])
    assert best.ids == {f"gyro_bias_step@{(40 + seed) * WIDTH:.3f}"}


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_a_walk_is_no_step_and_has_its_density(seed: int, parts: int) -> None:
    """In two recordings it begins anew, and has one density."""
    density, several = 0.01, [_walks(seed + 5 * n, 0.01) for n in range(parts)]
    errors = {key: np.concatenate([w[key] for w in several]) for key in several[0]}
    _, best = _selected(_response(seed, errors, parts)[0])
    assert best.ids == {"accel_bias_walk"}
    (level,) = {v for own in best.noise["accel_bias_walk"].levels for v in own.values()}
    assert density / 2.0 < level < 2.0 * density


def test_a_name_a_step_and_a_walk_at_once() -> None:
    _, shapes = _response(0, {})
    errors = {key: 0.3 * shapes[2, n] * SIZE[key[0]] for n, key in enumerate(KEYS)}
    errors[0, 0] = errors[0, 0] + 0.02 * (np.arange(COUNT) >= 30)
    for key, walk in _walks(0, 0.02).items():
        errors[key] = errors[key] + walk
    first, best = _selected(_response(0, errors)[0])
    assert best.ids == {"beta", f"gyro_bias_step@{30 * WIDTH:.3f}", "accel_bias_walk"}
    assert best.score > first.score + 100.0
    # (each of them is missed, the name the most)
    lost = missed(_response(0, errors)[0], _priors(), best)
    assert min(lost.values()) > 5.0
    assert lost.keys() == best.ids


def test_what_the_model_has_and_does_not_need_goes() -> None:
    first, best = _selected(_named(0, {0: 0.3, 1: -0.2}), start=["alpha", "beta"])
    assert first.names == {"alpha", "beta"}
    assert best.names == {"alpha"}


def test_what_is_refused_stays_out_and_what_is_always_there_stays() -> None:
    priors = Priors(lambda e: prior(e, []), frozenset({"alpha"}), frozenset({"delta"}))
    _, best = _selected(_named(0, {0: 0.3, 1: -0.2}), priors, ["delta"])
    assert "alpha" not in best.ids
    assert "delta" in best.ids


def test_of_a_change_that_fails_half_is_tried() -> None:
    """The surest half of what comes, until one comes alone; what goes then stays."""
    come, go = [(_effect(name, 1), ()) for name in "abcde"], frozenset("xy")
    halves = [Change(come, go)]
    while (half := halves[-1].half()) is not None:
        halves.append(half)
    assert [len(c.come) for c in halves] == [5, 2, 1, 1]
    assert [c.go for c in halves] == [go, go, go, frozenset()]
    assert [c.names for c in halves] == [{*"abcde"}, {"a", "b"}, {"a"}, {"a"}]
    assert Change([], go).half() is None
    assert Change([], go).names == go


@pytest.mark.parametrize("seed", range(20))
def test_no_set_is_better_than_the_best(seed: int) -> None:
    """Of eight effects, among which some are nearly sums of others."""
    rng = np.random.default_rng(seed)
    effects = [_effect(f"e{k}", 1) for k in range(8)]
    J = rng.normal(size=(40, 8))
    J[:, 5] = J[:, 0] + J[:, 1] + 0.2 * rng.normal(size=40)
    J[:, 6] = J[:, 2] - J[:, 3] + 0.2 * rng.normal(size=40)
    y = J[:, :4] @ (rng.choice([0.0, 1.0], 4) * rng.normal(size=4)) + rng.normal(size=40)
    q = Quadratic(tuple((e.id, "p0") for e in effects), 0.0, J.T @ y, J.T @ J)
    where = space(q, effects, {e.id: -2.0 for e in effects})
    all_ = [frozenset(s) for n in range(9) for s in combinations([e.id for e in effects], n)]
    assert best_sets(where, [frozenset()], frozenset())[0] == max(all_, key=where.score)


def test_noise_integrated_out_is_the_density_of_its_covariance() -> None:
    """Of all its eigenvectors, against the density of the readings (windows that are whitened)."""
    walk = catalogue()["gyro_bias_walk"]
    walked = np.cumsum(np.random.default_rng(0).normal(size=COUNT)) * 0.0003 * np.sqrt(WIDTH)
    r, _ = _response(0, {(0, 0): walked})
    levels = {walk.levels[0].name: 0.0003}
    value = space_beside(r, _priors(), {walk.id: noise_columns(r, walk, [levels])}).score(())
    K = covariance(walk, levels, *r.windows.courses[0]) / SIZE[0] ** 2
    want = 0.0
    for axis in range(3):
        at = r.windows.at[0, axis]
        y = r.quadratic.b[at] / TOLD
        S = np.eye(COUNT) + TOLD**2 * K
        want += 0.5 * float(y @ y - y @ np.linalg.solve(S, y)) - 0.5 * np.linalg.slogdet(S)[1]
    assert value == pytest.approx(want, abs=0.5)  # (what the smallest eigenvectors hold)


def test_a_look_at_steps_says_what_each_of_them_gains() -> None:
    r, _ = _response(3, {(0, 2): 0.01 * (np.arange(COUNT) >= 50)})
    step = catalogue()["gyro_bias_step"]
    b, G = on_matrix.windows_beside(r, frozenset(), {}, 0)
    nats = step_gains(b, G, step.prior_sigma[0] / SIZE[0])
    for edge in (1, 50, COUNT - 1):
        c: Columns = step_columns(r, step, edge)
        own = np.block([[c.F.T @ r.quadratic.G[np.ix_(i, j)] @ c.F for j in c.at] for i in c.at])
        A = np.eye(3) + own
        want = 0.5 * c.b @ np.linalg.solve(A, c.b) - 0.5 * np.linalg.slogdet(A)[1]
        assert nats[edge] == pytest.approx(want, abs=1e-6)
    assert np.argmax(nats) == 50

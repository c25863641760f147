"""Columns beside one pass of the filter, against a pass that has them all among its constants."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from worlds import recording_of

from handcal.effects import Effect, Param, Signals, select
from handcal.effects._linear import added
from handcal.estimate import columns
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic, local
from handcal.estimate.robust import excess
from handcal.estimate.scan import grounds, scan
from handcal.estimate.transfer import moved_to
from handcal.laws import over_drivers, short_windows, vocabulary
from handcal.laws.drivers import DRIVERS, HEADING, usable
from handcal.laws.law_effect import SIZE
from handcal.search.candidates import candidates
from handcal_sim import simulate
from handcal_sim.phone import (
    Phone,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
    trusted_reference,
)

# A stream that is folded, one that is and sees three axes, a pose, and nothing that is integrated.
SCENES = {
    "heading": ("gyro_scale", "gyro_bias_walk", "heading_delay"),
    "mag": ("gyro_scale",),
    "pose": ("accel_delay",),
    "reference": ("gyro_scale", "accel_scale"),
}


def _phone(rng: np.random.Generator) -> Phone:
    return replace(
        consumer_phone(rng),
        mag=consumer_magnetometer(rng),
        pose=capture_pose(rng),
        reference=trusted_reference(rng),
    )


@pytest.fixture(scope="module", params=SCENES)
def model(request: pytest.FixtureRequest) -> Model:
    world = simulate("free-hand", seed=0, duration_s=12.0, phone=_phone)
    first = baseline([case_of(recording_of(world, request.param))])
    done = fitted(first.parts, [*first.effects, *select(SCENES[request.param])], noise_rounds=0)
    # (linearised anew, as the pass with more effects is)
    return replace(done, parts=tuple(moved_to(f, done.effects) for f in done.parts))


def _whole(model: Model, absent: list[Effect]) -> Quadratic:
    """The scan as one pass over a problem that has all effects."""
    (part,) = model.parts
    everything = [*model.effects, *absent]
    wide = moved_to(part, everything)
    done = reduced_pass(reduce(wide.linear), wide.levels)
    q = local(done, frozenset(e.id for e in everything)).quadratic
    worth = 1.0 / excess(done, frozenset(e.id for e in model.effects))
    return Quadratic(q.names, q.a, worth * q.b, worth * q.G, worth)


def test_columns_are_what_a_pass_with_them_has(model: Model) -> None:
    have = set(model.ids)
    signals = over_drivers.signals_of(model.parts[0])
    imu = [d for d in DRIVERS.values() if usable(d, signals)]
    laws = [b.effect for d in imu for b in over_drivers.over(d, signals, (0, 1))][::5]
    (ground,) = grounds(model)
    named = [e for e in candidates(model.parts, model.effects, ground.done) if e.id not in have]
    past = []
    if "heading" in model.parts[0].case.kinds:
        drivers = vocabulary.further(signals, HEADING)
        past = [b.effect for d in drivers for b in over_drivers.over(d, signals, (HEADING,))]
    for absent in (named, laws, past[::20]) if past else (named, laws):
        whole, found = _whole(model, absent), scan(model, absent, grounds(model))
        at = [found.names.index(n) for n in whole.names]
        scale = np.sqrt(1.0 + np.diag(whole.G))
        np.testing.assert_allclose(found.b[at] / scale, whole.b / scale, atol=1e-8)
        G = found.G[np.ix_(at, at)] / np.outer(scale, scale)
        np.testing.assert_allclose(G, whole.G / np.outer(scale, scale), atol=1e-8)
        assert found.a == pytest.approx(whole.a, abs=1e-6)
        assert found.worth == pytest.approx(whole.worth, rel=1e-8)
        # (what has no effect at all would be the same in any way)
        new = [i for i, n in enumerate(whole.names) if n[0] not in have]
        assert np.mean(np.diag(whole.G)[new] > 1e-3) > 0.7


def test_constants_of_each_window_add_up_to_what_acts_throughout(model: Model) -> None:
    """From any window on they do what a constant does that begins there, and all of them what one
    does that is always there."""
    (ground,) = grounds(model)
    windows = short_windows.windows_about(ground)
    count, t = windows.count, windows.edges
    for sensor in (0, 1):
        q = short_windows.looked_at(model.ids, ground, windows, [sensor])
        for axis, begin in product(range(3), (0, count // 3, count // 2)):
            own = {(f"windows: {sensor} {axis}", f"w{n}") for n in range(begin, count)}
            at = [n for n, name in enumerate(q.names) if name in own]
            step = _from(sensor, axis, t[begin])
            whole = scan(model, [step], [ground], 1.0)
            assert len(at) == count - begin
            G, b = q.G[np.ix_(at, at)].sum(), q.b[at].sum()
            assert pytest.approx(whole.G[-1, -1], rel=0.02) == G
            assert abs(b - whole.b[-1]) < 0.05 * math.sqrt(1.0 + whole.G[-1, -1])


def _from(sensor: int, axis: int, begin: float) -> Effect:
    """A constant error of a channel from a time on, as large as that of a window."""

    def features(signals: Signals) -> list[tuple[int, int, np.ndarray]]:
        return [(3 * sensor + axis, 0, 1.0 * (signals.t >= begin)[:, None])]

    return Effect(
        id="from", title="", story="", source="", motion="", validated="",
        parameters=(Param("size", "", SIZE[sensor]),), features=features,
        imu_error=added(features),
    )  # fmt: skip


def test_few_at_once_come_to_the_same(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    (ground,) = grounds(model)
    on_trial = candidates(model.parts, model.effects, ground.done)
    named = [e for e in on_trial if e.id not in model.ids]
    whole = scan(model, named)
    asked = []
    slopes_of = columns.slopes_of
    monkeypatch.setattr(columns, "SLOPES", 1.0)
    monkeypatch.setattr(columns, "slopes_of", lambda *a: asked.append(a[1]) or slopes_of(*a))
    some = scan(model, named)
    assert [len(effects) for effects in asked] == [1] * sum(
        e.imu_error is not None for e in named
    ) * len(model.parts)
    assert some.names == whole.names
    assert np.array_equal(some.b, whole.b)
    assert np.array_equal(some.G, whole.G)

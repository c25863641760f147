"""Laws without a name that devices have in common."""

from __future__ import annotations

import numpy as np
import pytest

from handcal.fleet import results
from handcal.fleet.laws import asked, laws_json, laws_of, write_law
from handcal.fleet.store import opened
from handcal.laws.of_devices import Known, all_laws
from handcal.population.by_model import Model
from handcal.population.laws import better, common_law
from handcal.population.stacked import Stack
from handcal.user_effects import effects_from

CUBE = "gyro_xyz += k * omega_i^3"


def fleet(rng, true, devices=20, each=2, sigma=0.6):
    """Values and sigmas (n, laws) of recordings that each tell every law's constant to so many
    usual sizes; the law ``true`` is there at a fifth of its usual size."""
    laws = asked()
    who = [f"d{d}" for d in range(devices) for _ in range(each)]
    s = np.tile(sigma * laws.usual, (len(who), 1))
    value = s * rng.standard_normal(s.shape)
    at = [laws.said(i) for i in range(len(laws.usual))].index(true)
    if true:
        value[:, at] += 0.2 * laws.usual[at] * 3.0
    return laws, value, s, who, at


def test_a_law_that_no_recording_shows_is_found_over_the_devices(tmp_path):
    for seed in range(3):
        laws, value, sigma, who, at = fleet(np.random.default_rng(seed), CUBE)
        found = common_law(laws, value, sigma, who, len(laws.usual))
        assert found is not None
        assert found.index == at
        assert found.stack.best_alone < 8.0  # (of 1700 laws one has that by chance in each device)
        size = 0.6 * laws.usual[at]
        assert abs(found.population.mean - size) < 4.0 * found.population.mean_sigma
    path = write_law(found, tmp_path / "laws", "law_of_m", "m")
    with effects_from(path.parent):
        from handcal.effects import known_effect

        effect = known_effect("law_of_m")
        assert effect.motion == "One that changes omega_i much."
        assert effect.source == "found in 20 devices of m by handcal fleet"
        assert effect.title == f"Law of {CUBE.replace(' += ', ': ')}"
        assert effect.parameters[0].prior_sigma == pytest.approx(
            np.hypot(found.population.mean, found.population.deviation), rel=0.1
        )


def test_each_model_has_a_file_of_its_own(tmp_path):
    """The search for a free name took all memory there is."""
    laws, value, sigma, who, _ = fleet(np.random.default_rng(0), CUBE)
    found = common_law(laws, value, sigma, who, len(laws.usual))
    models = [Model(name, 40, 20, (), (), (), (), found) for name in ("A 1", "a-1", "b")]
    models.append(Model("none", 40, 20, (), (), ()))
    results._write_laws(opened(tmp_path / "out"), models)
    written = sorted(p.name for p in (tmp_path / "out/laws").iterdir())
    assert written == ["law_of_a_1.py", "law_of_a_1_2.py", "law_of_b.py"]


def test_what_is_not_there_is_not_found():
    laws, value, sigma, who, at = fleet(np.random.default_rng(5), CUBE)
    value[:, at] = sigma[:, at] * np.random.default_rng(6).standard_normal(len(who))
    assert common_law(laws, value, sigma, who, len(laws.usual)) is None


def test_what_the_catalogue_explains_as_well_has_a_name():
    laws, value, sigma, who, _ = fleet(np.random.default_rng(0), CUBE)
    found = common_law(laws, value, sigma, who, len(laws.usual))
    assert found is not None
    gain = found.stack.gain
    assert better(found, [Stack("gyro_scale", gain - 1.0, 0.0, 1.0, 20, 1.0)])
    assert not better(found, [Stack("gyro_scale", gain + 1.0, 0.0, 1.0, 20, 1.0)])
    (named,) = {i for i in range(len(laws.usual)) if laws.said(i) == "gyro_xyz += k * omega_i^2"}
    assert laws.named(named)  # (gyro_quadratic)


def test_what_is_kept_is_what_was_told():
    count = len(all_laws())
    value = np.arange(count, dtype=float)
    sigma = np.where(np.arange(count) % 7, 1.0, np.nan)
    kept = laws_json(Known(value, sigma))
    again = laws_of(kept)
    assert again is not None
    assert np.array_equal(again[0], value)
    assert np.array_equal(again[1], sigma, equal_nan=True)
    assert laws_of(kept | {"count": count - 1}) is None
    assert laws_of(None) is None

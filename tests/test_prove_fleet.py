"""A simulated fleet: what is drawn, and how it is scored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import schemas

from handcal_sim.prove.fleet import lines, score
from handcal_sim.prove.fleet_world import (
    CUBE,
    LARGE,
    MODELS,
    ODD_WAYS,
    SLOPE,
    SPREADS,
    devices,
    recorded,
    written,
)
from handcal_sim.prove.trial import share


def test_devices_are_drawn_as_their_models_say():
    made = devices(400, np.random.default_rng(0))
    assert [sum(d.odd == way for d in made) for way in ODD_WAYS] == [4, 4, 3, 3, 3, 3]
    for model in MODELS:
        own = [d for d in made if d.model == model and not d.odd]
        scales = np.array([d.effects["gyro_scale"] for d in own])
        assert abs(scales.mean()) < 4.0 * scales.std() / np.sqrt(scales.size)
        if model != "tails":
            # (of some 285 numbers a spread is known to 4.2 %)
            assert 0.87 < scales.std() / SPREADS["gyro_scale"] < 1.13
        assert all((d.law > 0.5 * CUBE) == (model == "law") for d in own)
        assert all(d.slope == (SLOPE if model == "warm" else 0.0) for d in own)


def test_a_law_and_the_temperature_are_in_the_readings():
    (device,) = (d for d in devices(4, np.random.default_rng(0)) if d.model == "law")
    with_law, without = recorded(device, 3), recorded(replace(device, law=0.0), 3)
    added = with_law.imu.values - without.imu.values
    assert np.allclose(added[:, :3], device.law * with_law.truth.omega**3, atol=1e-9)
    assert not added[:, 3:].any()


def test_what_is_written_is_a_manifest_of_recordings_some_of_them_broken(tmp_path):
    truth = written(5, 0, tmp_path)
    assert (truth["recordings"], len(truth["broken"]), len(truth["odd"])) == (5, 1, 1)
    rows = (tmp_path / "manifest.txt").read_text().splitlines()
    assert rows[0] == "path,device,model,started"
    assert len(rows) == 6
    assert sum(p.stat().st_size == 100 for p in tmp_path.glob("*.mcap")) == 1


def test_a_score_counts_and_follows_its_schema():
    def population(mean, low, high):
        return {"effect": "gyro_scale", "name": "x", "mean": mean, "mean_sigma": 1e-3,
                "spread_from": low, "spread_to": high}  # fmt: skip

    told = {
        "models": [
            {"name": "plain", "populations": [population(0.002, 0.004, 0.006)], "odd": [],
             "law": None, "changes": []},
            {"name": "law", "populations": [population(0.004, 0.006, 0.007)],
             "law": {"formula": "gyro_xyz += k * omega_i^3"}, "changes": [],
             "odd": [{"who": "a", "kind": "device", "by_chance": 1e-9},
                     {"who": "b", "kind": "device", "by_chance": 1e-3},
                     {"who": "x/r7.mcap", "kind": "recording", "by_chance": 0.1, "like": "b"}]},
            {"name": "warm", "populations": [], "odd": [], "law": None,
             "changes": [{"effect": "gyro_bias", "name": "x", "slope": SLOPE + 2e-5,
                          "slope_sigma": 1e-5, "shares": {"turn_on": 0.5, "ageing": 0.0,
                                                          "temperature": 0.5, "step": 0.0}}]},
        ],
        "failures": [{"path": "x/r3.mcap"}],
    }  # fmt: skip
    truth = {"devices": ["a", "b"], "odd": {"a": "gyro_scale"}, "broken": ["r3.mcap"],
             "mislabelled": {"r7.mcap": ["a", "b"], "r8.mcap": ["b", "a"]}}  # fmt: skip
    row = {"model": "plain", "priors": "plain", "motion": "z-turn", "effects": {"gyro_scale": 0.5},
           "all": 0.7, "all_best": 0.6, "estimates": 15, "leave_room": 0, "room": None,
           "room_best": None, "foretold": share(7, 8) | {"median_gain": 1.0}}  # fmt: skip
    taught = {"seconds": 20.0, "rows": [row]}
    few = {"fleets": 1, "means_within_3_sigma": share(6, 6), "spreads_within": share(5, 6)}
    found = score(told, truth) | {"taught": taught, "smaller": few}
    schemas.check({"schema": "handcal-sim/prove-fleet/1", "n": 4, "seed": 0} | found)
    assert found["means_within_3_sigma"]["count"] == 1
    assert found["spreads_within"]["count"] == 1
    assert found["law_found"]
    assert found["laws_elsewhere"] == 0
    assert (found["odd"]["count"], found["broken"]["count"]) == (1, 1)
    assert found["odd"]["places"] == {"a: gyro_scale": 1}
    assert [found["mislabelled"][k] for k in ("count", "whose", "others")] == [1, 1, 0]
    assert np.isclose(found["slopes"][0], 2.0)
    assert any("found" in line for line in lines({"n": 4, "seed": 0} | found))
    assert all(8.0 * SPREADS[effect] < size for effect, size in LARGE.items())

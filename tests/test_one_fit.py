"""``explain`` ends in the fit that ``calibrate --from`` repeats, to the last bit; several
recordings of a device are calibrated together; models are compared by their evidence."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import schemas
from worlds import recording_of, slow

import handcal
from handcal.effects import select
from handcal.estimate.baseline import baseline
from handcal.estimate.calibration import ONLY, calibrate_together, recalibrate
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.explain import Explanation, explain
from handcal.explain.model_file import chosen_from, read
from handcal.show.calibration.summary import OWN, calibration_json
from handcal.show.explanation.document import explanation_json
from handcal.types import InputError, Recording
from handcal_sim import simulate

SEALED = Path(__file__).resolve().parents[1] / "recordings"
# Explained by nothing, by one effect, by a term without a name, by two effects; the real ones are
# of six devices.
QUICK = (
    "sealed_04",
    *(pytest.param(f"sealed_{k}", marks=pytest.mark.prove) for k in ("02", "03", "06")),
)
REAL = (
    "devices/array_6_imu5", "devices/euroc_v203", "devices/phone_oscillations1",
    "devices/phone_oscillations3", "devices/android_fullpitch", "devices/openaxes_circle250",
)  # fmt: skip


def made(effects: dict[str, list[float]], seed: int, seconds: float = 45.0) -> Recording:
    world = simulate("free-hand", seed=seed, duration_s=seconds, phone=slow, effects=effects)
    return recording_of(world, "heading")


def told(recordings: list[Recording], found: Explanation) -> tuple[dict[str, Any], dict[str, Any]]:
    """What explain says, and what calibrate says from that, both through JSON."""
    said = json.loads(json.dumps(explanation_json(found)))
    results = recalibrate(recordings, chosen_from(said["model"]))
    calibrated = json.loads(json.dumps(calibration_json(results)))
    schemas.check(said)
    schemas.check(calibrated)
    return said, calibrated


def fitted_values(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Parameters as they were fitted. (As they would be with what was found alone is another
    question: explain knows what it found, calibrate has what is shown instead.)"""
    return [{k: v for k, v in p.items() if k != "given_model"} for p in document["parameters"]]


def check_equal(recordings: list[Recording]) -> dict[str, Any]:
    """What explain says."""
    found = explain(recordings)
    said, again = told(recordings, found)
    assert fitted_values(said) == fitted_values(again)
    assert said["model"] == again["model"]
    if len(recordings) == 1:
        assert said["noise"] == again["noise"]
    for one, other in zip(said.get("recordings", []), again.get("recordings", []), strict=True):
        assert (fitted_values(one), one["noise"]) == (fitted_values(other), other["noise"])
    return said


@pytest.mark.parametrize("name", QUICK)
def test_calibrate_repeats_what_explain_ended_with(name: str) -> None:
    check_equal([handcal.load(SEALED / f"{name}.mcap")])


@pytest.mark.prove
@pytest.mark.parametrize(
    "effects",
    [
        {"gyro_bias_step": [0.012, 0.011, -0.006, 19.0]},
        {"heading_outliers": [0.1]},
        {"gyro_scale": [0.14, -0.12, 0.1], "heading_delay": [0.2]},
    ],
    ids=lambda e: "+".join(e),
)
def test_moments_wrong_readings_and_starts_far_away_are_in_the_model(
    effects: dict[str, list[float]],
) -> None:
    check_equal([made(effects, 0)])


@pytest.mark.prove
def test_of_two_recordings_too() -> None:
    scale = {"gyro_scale": [0.012, -0.01, 0.009]}
    check_equal([made(scale, 0), made(scale, 1)])


@pytest.mark.prove
@pytest.mark.parametrize("name", REAL)
def test_of_real_devices(name: str, real_recordings: Path) -> None:
    check_equal([handcal.load(real_recordings / f"{name}.mcap")])


# --- several recordings ------------------------------------------------------------------------


@pytest.mark.prove
def test_recordings_of_a_device_tell_its_effects_together() -> None:
    """Twice the information: sigmas fall by the root of two, within what motions differ; biases
    stay each recording's own."""
    scale = {"gyro_scale": [0.012, -0.01, 0.009]}
    pair = [made(scale, seed, 25.0) for seed in (0, 1)]
    alone = [handcal.calibrate(r, ("gyro_scale",), assume="fixed-point", only=True) for r in pair]
    both = calibrate_together(pair, ("gyro_scale",), assume="fixed-point", only=True)
    for axis, true in zip("xyz", scale["gyro_scale"], strict=True):
        p, q = (r.parameter("gyro_scale", axis) for r in both)
        # (each recording's own trajectory was linearised about its own value of it)
        assert (p.value, p.sigma) == pytest.approx((q.value, q.sigma), rel=1e-9)
        information = sum(r.parameter("gyro_scale", axis).sigma ** -2 for r in alone)
        assert p.sigma == pytest.approx(1.0 / math.sqrt(information), rel=0.2)
        assert abs(p.value - true) < 4.0 * p.sigma
    first, second = (r.parameter("gyro_bias", "x") for r in both)
    assert first.value != second.value
    document = calibration_json(both)
    assert [p["effect"] for p in document["parameters"]] == ["gyro_scale"] * 3
    assert all({p["effect"] for p in r["parameters"]} == set(OWN) for r in document["recordings"])


@pytest.mark.prove
def test_the_effects_of_a_model_are_calibrated_from_another_recording() -> None:
    """What happened at one moment of the first is no part of that, but of its own repetition."""
    effects = {"gyro_scale": [0.012, -0.01, 0.009], "gyro_bias_step": [0.012, 0.011, -0.006, 19.0]}
    said = check_equal([made(effects, 0)])
    assert "gyro_bias_step" in {m["effect"] for m in said["missing"]}
    (other,) = recalibrate([made({"gyro_scale": effects["gyro_scale"]}, 3, 40.0)],
                           chosen_from(said["model"]))  # fmt: skip
    effects_said = {p["effect"] for p in said["parameters"]}
    assert {p.effect for p in other.parameters} == effects_said - {"gyro_bias_step"}
    assert {*OWN, "gyro_scale", "gyro_g_sensitivity"} < effects_said
    for axis, true in zip("xyz", effects["gyro_scale"], strict=True):
        p = other.parameter("gyro_scale", axis)
        assert abs(p.value - true) < 4.0 * p.sigma


@pytest.mark.parametrize("only", [True, False])
def test_what_was_calibrated_is_repeated_with_as_much_beside_it(only: bool) -> None:
    """An arm alone, which is all that could be told of what is observed; or all there is."""
    recording = replace(made({}, 0, 20.0), streams={})
    (first,) = calibrate_together([recording], ("lever_arm",), assume="fixed-point", only=only)
    written = json.loads(json.dumps(calibration_json(first)))["model"]
    (again,) = recalibrate([recording], chosen_from(written))
    assert again.parameters == first.parameters
    assert {p.effect for p in again.parameters} > {*OWN}
    assert len({p.effect for p in again.parameters}) == (3 if only else 9)
    for result in (first, again):
        assert any(w == f"{ONLY} and lever_arm." for w in result.warnings) == only


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"model": 3}', '{"model": {}}', '{"model": {"effects": [{"id": 1}]}}']
)
def test_a_file_without_a_model_is_a_sentence(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"model|JSON"):
        read(path)


# --- evidence ----------------------------------------------------------------------------------

ADDED = ("gyro_quadratic", "accel_scale", "lever_arm", "gyro_bias_walk", "accel_delay")


def drops(recording: Recording) -> dict[str, float]:
    """Nats by which each effect lowers the evidence beyond what its parameters cost and one nat."""
    base = handcal.calibrate(recording, assume="fixed-point", only=True)
    out = {}
    for effect in ADDED:
        more = handcal.calibrate(recording, (effect,), assume="fixed-point", only=True)
        own = [p for p in more.parameters if p.effect == effect]
        # (of a walk: what its level costs, which is no parameter)
        occam = 0.5 * sum(2.0 * math.log(max(p.prior_sigma / p.sigma, 1.0)) for p in own)
        out[effect] = base.log_evidence - more.log_evidence - occam - 1.0
    return out


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, *range(1, 12)])
def test_an_effect_that_is_not_there_costs_its_parameters_at_most(seed: int) -> None:
    assert max(drops(made({}, seed, 30.0)).values()) < 0.0


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(3))
def test_so_beside_a_law_that_nobody_wrote_down(seed: int) -> None:
    """A gyro that errs with the size of the rate, by 1 %."""
    clean = made({}, seed, 30.0)
    error = 0.01 * np.linalg.norm(clean.imu.gyro, axis=1)[:, None]
    strange = replace(clean, imu=replace(clean.imu, gyro=clean.imu.gyro + error))
    assert max(drops(strange).values()) < 0.0


@pytest.mark.prove
@pytest.mark.parametrize("name", ["broad_01_slow_rotation", *REAL])
def test_so_on_real_devices(name: str, real_recordings: Path) -> None:
    found = drops(handcal.load(real_recordings / f"{name}.mcap"))
    print(f"\n{name}: {found}")
    assert max(found.values()) < 0.0


@pytest.mark.prove
def test_a_fit_that_goes_there_and_back_takes_shorter_steps(real_recordings: Path) -> None:
    """About a phone that is swung, whose arm and delay are not in the model, whole steps went to
    and fro, and evidence with them, by 165 nats."""
    phone = handcal.load(real_recordings / "devices" / "phone_oscillations1.mcap")
    base = baseline([case_of(phone, "fixed-point")])
    found = fitted(base.parts, select(["accel_scale"]))
    assert found.settled or found.swing < 2.0

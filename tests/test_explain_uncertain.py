"""What explain says of how little it knows: noise from a few of its own lengths, and numbers that
lean on the absence of what the motion cannot show."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from worlds import recording_of

from handcal.effects import catalogue, select
from handcal.estimate import case
from handcal.estimate.baseline import started
from handcal.estimate.fit import fitted
from handcal.estimate.robust import inflation
from handcal.explain import assembled, explain
from handcal.explain.leaning import leaning
from handcal.explanation import Hypothesis
from handcal.show.explanation.document import explanation_json
from handcal.show.explanation.terminal import print_explanation
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, consumer_phone, with_rate

NOISE = catalogue()["heading_correlated_noise"]


def slow(rng: np.random.Generator) -> Phone:
    phone = consumer_phone(rng)
    assert phone.heading is not None
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(10.0)))


@pytest.mark.prove
def test_correlated_noise_of_a_few_lengths() -> None:
    """Nine correlation times long, 12 seeds: within 3.5 sigma, where the curvature was out by 7."""
    z = []
    for seed in range(12):
        world = simulate(
            "free-hand", seed=seed, duration_s=35.0, phone=slow,
            effects={NOISE.id: [0.19, 4.0]},
        )  # fmt: skip
        for m in explain([recording_of(world, "heading")]).missing:
            if m.effect == NOISE.id:
                z += [
                    (p.value - v) / p.sigma for p, v in zip(m.parameters, (0.19, 4.0), strict=True)
                ]
    print(np.round(z, 1))
    assert len(z) >= 20
    assert np.abs(z).max() < 3.5


def sentences(
    motion: str,
    seconds: float,
    hardly: set[str],
    named: Sequence[str] = (),
    excess: Mapping[str, float] | None = None,
) -> list[str]:
    world = simulate(motion, seed=0, duration_s=seconds, phone=slow)
    effects = select(named)
    (part,) = fitted([started(case.case_of(recording_of(world, "heading")))], effects).parts
    return leaning(part, effects, hardly, (), excess or {})


def test_a_bias_that_holds_only_without_a_drift_says_so() -> None:
    """Turning about z alone, a heading that drifts and a gyro's bias are one and the same; about
    all axes they are two."""
    (said,) = sentences("z-turn", 30.0, {"heading_drift"})
    assert "gyro's bias" in said
    assert "z: " in said
    assert "compass drift" in said
    assert sentences("free-hand", 60.0, {"heading_drift"}) == []
    assert sentences("z-turn", 30.0, set()) == []


def test_an_absence_that_nothing_speaks_for_is_assumed_too() -> None:
    """A phone's gyro bias was off by fifty sigmas beside a g-sensitivity that gained five nats,
    which of its usual size promised fifteen."""
    world = simulate("z-turn", seed=0, duration_s=30.0, phone=slow)
    model = fitted([started(case.case_of(recording_of(world, "heading")))], ())
    for gained, said in ((1.0, 1), (-1.0, 0)):
        drift = Hypothesis("heading_drift", "Compass drift", 0.0, gained, 100.0, 0.1, "")
        told = assembled._warnings(model, model, [], [drift], inflation(model))
        assert sum("gyro's bias" in x for x in told) == said


def test_a_scale_that_holds_only_without_a_quadratic_error_says_so() -> None:
    """Turning about one axis after another, each at one rate and one way, a scale error and a
    quadratic one are the same number. (Of devices with ten errors, scales were off by ten sigmas
    beside a quadratic error that nobody could see.)"""
    said = sentences("three-turns", 80.0, {"gyro_quadratic"}, ["gyro_scale"])
    (of_scale,) = [s for s in said if s.startswith("Gyro scale error")]
    known, then = re.findall(r"([\d.]+), [\d.]+ %", of_scale)
    assert float(then) > 3.0 * float(known)
    assert "(gyro quadratic error)" in of_scale
    assert sentences("free-hand", 60.0, {"gyro_quadratic"}, ["gyro_scale"]) == []


@pytest.mark.prove
def test_a_warning_has_the_sigmas_of_the_table() -> None:
    """Where an effect's scores scatter beyond the information matrix, its sigmas are wider by as
    much in the table of parameters: so they are in the warning."""
    plain, wider = (
        float(re.findall(r"([\d.]+), [\d.]+ %", of_scale)[0])
        for excess in ({}, {"gyro_scale": 4.0})
        for of_scale in sentences("three-turns", 80.0, {"gyro_quadratic"}, ["gyro_scale"], excess)
        if of_scale.startswith("Gyro scale error")
    )
    assert wider == pytest.approx(2.0 * plain, rel=0.05)  # (two digits)


@pytest.mark.prove
def test_a_fast_imu_is_not_called_slow(capsys: pytest.CaptureFixture[str]) -> None:
    """Terminal and JSON have the sensor's rate (exports take densities to samples by it), not that
    of the means that were fitted: they had half of it."""
    world = simulate("z-turn", seed=0, duration_s=12.0, phone=lambda r: with_rate(slow(r), 400.0))
    given = recording_of(world, "heading")
    explained = explain([given])
    print_explanation(explained, Console())
    assert " s at 400 Hz;" in capsys.readouterr().out
    said = explanation_json(explained)["recording"]
    assert said["imu_rate_hz"] == pytest.approx(given.rate_hz)
    assert said["streams"]["imu"]["samples"] == len(given.imu.t)


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(4))
def test_a_lag_that_nobody_can_place_is_not_taken_off_the_gyro(seed: int) -> None:
    """A late accelerometer and a slow gyro are nearly the same in slow turns; where the evidence
    was for the gyro by a few nats, correcting it left three times its error."""
    delay = {"accel_delay": [-0.028], "lever_arm": [-0.11, -0.08, -0.1]}
    world = simulate("three-turns", seed=seed, duration_s=80.0, effects=delay)
    found = explain([recording_of(world, "heading")])
    late = found.missing[0]
    assert late.effect == "accel_delay"
    assert set(late.indistinguishable_from) <= {"gyro_bandwidth"}
    assert abs(late.parameters[0].value + 0.028) < 4.0 * late.parameters[0].sigma

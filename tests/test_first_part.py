"""What a long recording is asked about: what does well in its first part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import recording_of

from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.first_part import LEAST_S, MOST, first_part
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.laws.best_law import survey
from handcal.laws.drivers import DRIVERS, usable
from handcal.types import Series
from handcal_sim import simulate
from handcal_sim.phone import Phone, consumer_phone, with_rate


def _slow(rng: np.random.Generator) -> Phone:
    return with_rate(consumer_phone(rng), 50.0)


def _base(duration_s: float, seed: int = 0, law: bool = False) -> Model:
    world = simulate("free-hand", seed=seed, duration_s=duration_s, phone=_slow, effects={})
    recording = recording_of(world, "heading")
    heading = recording.streams["heading"]
    recording = replace(recording, streams={"heading": Series(heading.t[::5], heading.value[::5])})
    if law:
        imu = recording.imu
        gyro = imu.gyro + np.outer(0.002 * imu.gyro[:, 0] * imu.accel[:, 1], [0.0, 0.0, 1.0])
        recording = replace(recording, imu=replace(imu, gyro=gyro))
    return baseline([case_of(recording)])


def test_a_short_recording_has_no_first_part() -> None:
    assert first_part(_base(20.0)) is None


def test_the_first_part_is_that_of_the_whole() -> None:
    """Its trajectory, and what is observed of it, up to the moment where it ends."""
    base = _base(100.0)
    part = first_part(base)
    assert part is not None
    (f,), (whole,) = part.parts, base.parts
    lasts = f.case.recording.duration_s
    assert LEAST_S - 0.1 < lasts < MOST * whole.case.recording.duration_s + 0.1
    n = len(f.t) - 1  # (the last epoch is where it was cut)
    assert np.array_equal(f.t[:n], whole.t[:n])
    assert f.trajectory.C[:n] == pytest.approx(whole.trajectory.C[:n])
    # nothing is to be fitted: the same readings about the same trajectory
    linear, of_whole = f.linear, whole.linear
    assert linear.r[: linear.first[n]] == pytest.approx(of_whole.r[: linear.first[n]], abs=1e-6)
    moved = fitted(part.parts, base.effects, noise_rounds=0)
    assert np.abs(moved.parts[0].trajectory.C[:n] - f.trajectory.C[:n]).max() < 0.02


def test_a_law_that_is_there_is_among_those_that_the_whole_is_asked_about() -> None:
    about = survey(_base(100.0, law=True))
    looks = [look for look, _ in about.of((), [])]
    asked = {e.id for look in looks for e in look.effects}
    assert "basis: 0 0 omega_{j} * f_{k}" in asked
    # (what is slow a first part does not show)
    assert any(i.startswith("basis: 0 ") and i.endswith("f_{i} * t") for i in asked)
    usual = [d for d in DRIVERS.values() if usable(d, about.signals)]
    assert len([i for i in asked if i.startswith("basis: 0 ")]) < 0.5 * len(usual)
    # what was scanned is not scanned again
    assert [look for look, _ in about.of((), [])] == looks

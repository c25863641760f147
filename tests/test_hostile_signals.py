"""Readings wrong in themselves: repaired and said, or refused; never a confident number."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz import read_grid

import handcal
from handcal.allan import analysis as allan
from handcal.device import apply
from handcal.explain import explain
from handcal.lab import scalar
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import _checks, _range, of_arrays
from handcal.types import Array, HandcalError, InputError, Recording
from handcal_sim import simulate, write
from handcal_sim.errors import SimulationError

Readings = tuple[Array, Array, Array]
Attack = Callable[[Array, Array, Array], Readings]


@pytest.fixture(scope="module")
def readings(tmp_path_factory: pytest.TempPathFactory) -> Readings:
    """A gyro without any scale error, turned about each axis."""
    path = tmp_path_factory.mktemp("signals") / "x.mcap"
    write(simulate("three-turns", seed=5, duration_s=30.0), path)
    imu = handcal.load(path).imu
    return imu.t, imu.gyro, imu.accel


def holes(fraction: float, value: float) -> Attack:
    def attack(t: Array, gyro: Array, accel: Array) -> Readings:
        hit = np.random.default_rng(0).random(len(t)) < fraction
        return t, np.where(hit[:, None], value, gyro), accel

    return attack


def gap(seconds: float) -> Attack:
    """In mid-turn: the stamps jump."""
    return lambda t, gyro, accel: (t + np.where(np.arange(len(t)) < len(t) // 2, 0, seconds),
                                   gyro, accel)  # fmt: skip


def slower(t: Array, gyro: Array, accel: Array) -> Readings:
    keep = (np.arange(len(t)) < len(t) // 2) | (np.arange(len(t)) % 4 == 0)
    return t[keep], gyro[keep], accel[keep]


def stuck(x: Array) -> Array:
    return np.where((np.arange(len(x)) < len(x) // 2)[:, None], x, x[len(x) // 2])


REFUSED: dict[str, tuple[Attack, str]] = {
    "nothing but NaN": (holes(1.0, np.nan), "not one"),
    "reversed": (lambda t, g, a: (t[::-1], g, a), "backwards"),
    "one stamp": (lambda t, g, a: (0 * t, g, a), "1 IMU samples"),
    "epoch jump": (gap(1.7e9), "clock was set"),
    "epoch back": (gap(-1000.0), "backwards"),
    "zeros": (lambda t, g, a: (t, 0 * g, 0 * a), "zero throughout"),
    "gyro zeros": (lambda t, g, a: (t, 0 * g, a), "zero throughout"),
    "accel of one axis dead": (lambda t, g, a: (t, g, a * [1, 1, 0]), "at rest"),
    "deg/s": (lambda t, g, a: (t, np.degrees(g), a), "deg/s"),
    "57 times too little": (lambda t, g, a: (t, np.radians(g), a), "rad/s"),
    "g": (lambda t, g, a: (t, g, a / 9.80665), "is g"),
    "accel saturated": (lambda t, g, a: (t, g, np.clip(a, -5, 5)), "end of its measuring range"),
}
DOUBTFUL: dict[str, Attack] = {
    "10 % NaN": holes(0.1, np.nan),
    "10 % infinite": holes(0.1, np.inf),
    "repeated stamps": lambda t, g, a: (np.repeat(t[::2], 2)[: len(t)], g, a),
    "1 ms gap": gap(0.001),
    "1 s gap": gap(1.0),
    "60 s gap": gap(60.0),
    "another rate": slower,
    "gyro stuck": lambda t, g, a: (t, stuck(g), a),
    "accel stuck": lambda t, g, a: (t, g, stuck(a)),
    "gyro of one axis dead": lambda t, g, a: (t, g * [0, 1, 1], a),
    "gyro saturated": lambda t, g, a: (t, np.clip(g, -0.3, 0.3), a),
    "gyro saturated a little": lambda t, g, a: (t, np.clip(g, -0.8, 0.8), a),
    "accel saturated a little": lambda t, g, a: (t, g, np.clip(a, -9, 9)),
}
# Of each kind one, that the quick suite calibrates; the others are for `make prove`.
OFTEN = ("10 % NaN", "repeated stamps", "another rate", "gyro stuck", "gyro saturated")
SAID = {
    "10 % NaN": "NaN", "10 % infinite": "infinite", "repeated stamps": "2 readings every",
    "1 s gap": "", "60 s gap": "",
    "accel saturated a little": "end of its measuring range",
    "gyro of one axis dead": "gyroscope's x never moves", "gyro stuck": "gyroscope reads one value",
    "accel stuck": "accelerometer reads one value", "gyro saturated": "end of its measuring range",
    "gyro saturated a little": "end of its measuring range",
}  # fmt: skip


def recorded(attack: Attack, readings: Readings) -> Recording:
    return of_arrays("x", *attack(*readings), {})


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_readings_is_refused_with_the_reason(name: str, readings: Readings) -> None:
    attack, reason = REFUSED[name]
    with pytest.raises(InputError, match=reason):
        recorded(attack, readings)


@pytest.mark.parametrize(
    "name", [n if n in OFTEN else pytest.param(n, marks=pytest.mark.prove) for n in DOUBTFUL]
)
def test_what_is_doubtful_gives_no_confident_number(name: str, readings: Readings) -> None:
    """The true gyro scale error is zero: what comes out as surely something else is a lie."""
    recording = recorded(DOUBTFUL[name], readings)
    if name in SAID:
        assert SAID[name] in " ".join(recording.warnings)
        assert recording.warnings
    for further in (allan.analyse, scalar.scalar):  # (rests of seconds: too little for either)
        with pytest.raises(HandcalError):
            further(recording)
    refused = ""
    try:
        result = handcal.calibrate(recording, ["gyro_scale"], only=True)
    except HandcalError as error:
        refused = str(error)
    if refused:
        assert SAID.get(name, "") in refused
        return
    for p in result.parameters:
        if p.effect == "gyro_scale":
            assert abs(p.value) < 4 * p.sigma, p


SCALE = 0.01
LEARNT = {
    "schema": "handcal/calibration/1",
    "parameters": [{"effect": "gyro_scale", "name": a, "value": SCALE, "sigma": 1e-4, "unit": "1",
                    "observable": True} for a in "xyz"],
}  # fmt: skip


@pytest.mark.parametrize("name", ["10 % NaN", "another rate", "gyro stuck", "gyro saturated"])
def test_what_is_doubtful_has_errors_taken_off_and_comes_back(
    name: str, readings: Readings, tmp_path: Path
) -> None:
    """`apply`: what there is, is corrected; nothing is made up for what is not there."""
    recording = recorded(DOUBTFUL[name], readings)
    corrected = apply.apply(recording, apply.of_document("x.json", LEARNT)).recording
    write_mcap(corrected, tmp_path / "x.mcap")
    back = handcal.load(tmp_path / "x.mcap").imu
    assert np.isfinite(back.gyro).all()
    # (what counts as missing stays as it is)
    read, share = recording.imu.valid, 1.0 + SCALE * recording.imu.valid[:, None]
    assert read.mean() > 0.2
    np.testing.assert_allclose(back.gyro, recording.imu.gyro / share, rtol=1e-9)
    np.testing.assert_array_equal(back.accel, recording.imu.accel)
    np.testing.assert_allclose(back.t, recording.imu.t, rtol=0, atol=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("name", DOUBTFUL)
def test_what_is_doubtful_is_explained_with_doubt_or_not(name: str, readings: Readings) -> None:
    """The device errs by nothing but biases. A hole of a minute and a gyro at the end of its
    range ended in a traceback."""
    recording = recorded(DOUBTFUL[name], readings)
    try:
        found = explain([recording], budget=20.0)
    except HandcalError:
        return
    assert found.missing == ()
    if found.unnamed:
        assert found.verdict == "unexplained"
        assert set(recording.warnings) <= set(found.warnings)
        assert recording.warnings


@pytest.mark.parametrize("hz", [25.0, 100.0])
@pytest.mark.parametrize("tremor", [0.0, 0.05])
def test_a_coarse_sensor_at_rest_is_not_stuck(hz: float, tremor: float) -> None:
    """Ten seconds on a table, or in a hand, between turns: whole seconds in which one value is
    read, with steps of 0.1 to 1 deg/s and of 0.02 to 0.3 m/s^2."""
    t = np.arange(round(30 * hz)) / hz
    turning = (t % 15.0) > 10.0
    rng = np.random.default_rng(0)
    angle = np.cumsum(np.where(turning, np.sin(2 * np.pi * (t % 5.0) / 5.0), 0.0)) / hz
    gyro = 0.004 + 1e-4 * rng.normal(size=(len(t), 3))
    gyro[:, 0] += np.gradient(angle, t) + tremor * 0.05 * np.sin(9.0 * t)
    accel = 9.80665 * np.c_[np.zeros(len(t)), np.sin(angle), np.cos(angle)]
    accel += 0.01 * rng.normal(size=accel.shape) + tremor * np.sin(7.0 * t)[:, None]
    for q_gyro in np.radians([0.1, 0.3, 1.0]):
        for q_accel in (1e-6, 0.02, 0.3):
            coarse = [q * np.round(x / q) for x, q in ((gyro, q_gyro), (accel, q_accel))]
            assert _checks.stuck(t, *coarse)[0] == [], (q_gyro, q_accel)
            assert _range.at_range_end(t, *coarse)[0] == [], (q_gyro, q_accel)
    held = slice(round(11.5 * hz), round(13.5 * hz))  # (in mid-turn)
    for k, name in enumerate(("gyroscope", "accelerometer")):
        both = [gyro.copy(), accel.copy()]
        both[k][held] = both[k][held.start]
        assert name in " ".join(_checks.stuck(t, *both)[0])


def test_a_number_too_long_to_be_one_is_a_sentence(tmp_path) -> None:
    """Found by `make fuzz`."""
    path = tmp_path / "x.toml"
    for text in ("[common]\nduration_s = " + "1" * 5000, "a = " + "[" * 5000):
        path.write_text(text)
        with pytest.raises(SimulationError, match="not TOML"):
            read_grid(path)

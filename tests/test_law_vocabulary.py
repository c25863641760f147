"""Drivers of the further vocabulary: their names say all that they are."""

import numpy as np
import pytest

from handcal.effects import Signals
from handcal.laws.driver_code import HELPERS, steps_to
from handcal.laws.grammar import text_of
from handcal.laws.vocabulary import driver_of

NAMES = [
    "(omega_{i} / max(|omega|, 0.2))",
    "(omega_{k} / max(|omega|, 0.3465))",
    "(memory(1.361 s) of tanh(f_{i} / 0.5))",
    "(memory(0.4 s) of tanh(omega_{i} / 0.1) - tanh(omega_{i} / 0.1))",
    "(frozen(0.8217 rad/s of |omega|) of f_{j} - f_{j})",
    "omega_{i} * (memory(2.45 s) of f_{k})",
]


def signals() -> Signals:
    rng = np.random.default_rng(0)
    t = np.arange(500) / 100.0
    turns = np.column_stack([np.sin((n + 1) * t + n) for n in range(3)])
    return Signals(t=t, gyro=turns + 0.01 * rng.normal(size=(500, 3)), accel=9.8 * turns[:, ::-1])


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_that_of_its_driver_and_its_code_makes_the_same(name):
    driver, s = driver_of(name), signals()
    assert driver.name == name
    assert driver.at(driver.number).name == name
    assert driver.at(2.0 * driver.number).kind == driver.kind
    where = {"np": np, "signals": s, "i": 1} | functions()
    for line in steps_to("x", name):
        exec(line.replace("{i}", "i"), where)
    np.testing.assert_allclose(where["x"], driver.of(s, 1), atol=1e-9)


def functions():
    where = {"np": np, "Array": np.ndarray}
    for source in HELPERS.values():
        exec(source, where)
    return where


@pytest.mark.parametrize("slow", [0.1, 0.4])
def test_below_its_number_a_turn_has_less_of_an_axis(slow):
    s = signals()
    along = driver_of(f"(omega_{{i}} / max(|omega|, {slow:g}))").of(s, 2)
    size = np.linalg.norm(s.gyro, axis=1)
    np.testing.assert_allclose(along * np.maximum(size, slow), s.gyro[:, 2], atol=1e-12)


@pytest.mark.parametrize("name", ["tanh(f_{i} / 0.3)", "(omega_{i} / max(|omega|, 0.34567))"])
def test_a_name_that_no_driver_has_is_none(name):
    with pytest.raises(KeyError):
        driver_of(name)


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (("bump", (-1.5, 2.0)), "exp(-(({x} + 1.5) / 2)^2 / 2)"),
        (("bump", (1.5, 2.0)), "exp(-(({x} - 1.5) / 2)^2 / 2)"),
        (("beyond", (-0.25,)), "max({x} + 0.25, 0)"),
    ],
)
def test_what_begins_below_zero_is_written_with_a_plus(part, text):
    assert text_of(part) == text

"""Courses over time and over direction without a name, found from a spline."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from proved import proved
from worlds import likeliest_laws, recording_of, slow

from handcal.compiled.jit import call_residual
from handcal.effects import TIME, Z_DIM, Signals
from handcal.estimate.baseline import baseline
from handcal.estimate.case import case_of
from handcal.estimate.quadratic import Quadratic
from handcal.explain import explain
from handcal.laws import courses, shapes
from handcal.types import Array
from handcal_sim import simulate
from handcal_sim.phone import Clocking, Phone, Thermometer, consumer_phone, with_rate

SPAN = 80.0


def warming(rng: np.random.Generator) -> Phone:
    phone = with_rate(consumer_phone(rng), 50.0)
    assert phone.heading is not None
    heading = replace(phone.heading, clocking=Clocking(10.0))
    return replace(phone, heading=heading, thermometer=Thermometer(reported=True))


FAMILIES = (*courses.OVER_TIME, *courses.OVER_YAW)
NUMBERS = (
    np.array([30.0, 6.0]),
    np.array([20.0, 41.0]),
    np.array([25.0, 0.7]),
    np.array([0.03, 0.0015, 0.7]),
    np.array([25.0, 11.0, 0.7]),
    np.array([12.0]),
    np.array([31.0, 8.0]),
    np.array([23.0, 9.0, 11.0]),
    np.array([21.0, 9.0]),
    np.array([0.4, 5.0]),
)
COURSES = tuple(zip(FAMILIES, NUMBERS, strict=True))
# What comes again.
AGAIN = (
    (courses.OVER_TIME[0], np.array([13.0, 3.0, 38.0, 61.0])),
    (courses.OVER_TIME[1], np.array([9.0, 17.0, 31.0, 42.0, 60.0, 66.0])),
    (courses.OVER_TIME[6], np.array([9.0, 5.0, 33.0, 58.0])),
)


def _heading_error(effect: shapes.Effect, k: Array, t: float, yaw: float) -> float:
    nav, z, r = np.zeros(40), np.zeros(Z_DIM), np.zeros(3)
    nav[6], nav[9], z[TIME] = np.cos(yaw), np.sin(yaw), t
    assert call_residual(int(effect.observation_error["heading"]), nav, k, z, r) == 0
    return -float(r[0])


@pytest.mark.parametrize(("family", "numbers"), [*COURSES, *AGAIN])
def test_a_compiled_course_is_the_course(family: courses.Family, numbers: Array) -> None:
    over_yaw = family in courses.OVER_YAW
    basis = shapes.heading_bases(SPAN)[int(over_yaw)]
    effect = shapes.term_of(basis, family, numbers)
    for x in np.linspace(0.3, 79.7, 40):
        yaw = (x / SPAN - 0.5) * 2.0 * np.pi
        here = yaw if over_yaw else x
        expected = family.values(numbers, np.array([here, here + 1e-9]))[0]
        assert _heading_error(effect, np.array([0.3]), x, yaw) == pytest.approx(
            0.3 * expected, abs=1e-12
        )


@pytest.mark.parametrize("which", [0, 1])
def test_a_spline_goes_through_smooth_courses(which: int) -> None:
    """Between the knots too: a cubic spline errs by at most 5/384 h^4 times the fourth
    derivative, 3 / width^4 for a bump of height one."""
    basis = shapes.heading_bases(SPAN)[which]
    h = basis.grid[1] - basis.grid[0]
    if which == 0:
        width = 3.0 * h
        numbers, bound = np.array([37.3, width]), 5.0 / 384.0 * 3.0 * (h / width) ** 4
    else:
        sharp = 6.0  # (the fourth derivative of exp(s cos) is at most 3 s^2 + s)
        numbers, bound = np.array([0.4, sharp]), 5.0 / 384.0 * (3.0 * sharp**2 + sharp) * h**4
    family = basis.families[0]
    k = basis.through @ family.values(numbers, basis.grid)
    for x in np.linspace(0.3, 79.7, 200):
        yaw = (x / SPAN - 0.5) * 2.0 * np.pi
        expected = family.values(numbers, np.array([yaw if which else x]))[0]
        assert abs(_heading_error(basis.effect, k, x, yaw) - expected) < 1.1 * bound


def test_an_imu_channels_spline_goes_through_a_bump() -> None:
    basis = shapes.imu_basis(4, SPAN)
    t = 5.0 + np.linspace(0.0, SPAN, 801)
    numbers = np.array([37.3, 8.0])
    k = basis.through @ courses.OVER_TIME[0].values(numbers, basis.grid)
    assert basis.effect.imu_error is not None
    error = basis.effect.imu_error(k, Signals(t, np.zeros((801, 3)), np.zeros((801, 3))))
    h = basis.grid[1]
    expected = courses.OVER_TIME[0].values(numbers, t - 5.0)
    assert np.abs(error[:, 4] - expected).max() < 1.1 * 5.0 / 384.0 * 3.0 * (h / 8.0) ** 4
    assert not error[:, [0, 1, 2, 3, 5]].any()


@pytest.mark.parametrize("seed", [0, *proved(1, 2, 3)])
@pytest.mark.parametrize(("family", "numbers"), [*COURSES, *AGAIN])
def test_the_planted_course_is_found(family: courses.Family, numbers: Array, seed: int) -> None:
    """What white readings say of a course ten times as large as their noise at each knot."""
    rng = np.random.default_rng(seed)
    basis = shapes.heading_bases(SPAN)[int(family in courses.OVER_YAW)]
    m = len(basis.effect.parameters)
    k = basis.through @ family.values(numbers, basis.grid)
    G = 100.0 * np.eye(m + 1)
    # one parameter that is known already, and errs towards the course
    G[0, 1:] = G[1:, 0] = 30.0 * k / np.linalg.norm(k)
    truth = np.r_[-0.5, k]
    b = G @ truth + np.linalg.cholesky(G) @ rng.standard_normal(m + 1)
    names = (("known", "k"), *((basis.effect.id, p.name) for p in basis.effect.parameters))
    effect, gain = shapes.closest(basis, Quadratic(names, 0.0, b, G), np.array([0]))[0]
    information = (100.0 - 900.0 / 101.0) * float(k @ k)
    # (the mean of the log of the likelihood ratio, less Occam's factor; its sigma, and what
    # adjusting two numbers gains)
    freedom = shapes.FREEDOM * max(1, len(numbers) - 1)
    expected = 0.5 * information - 0.5 * np.log1p(information) - freedom
    assert abs(gain - expected) < 4.0 * np.sqrt(information) + 5.0
    assert family.formula(numbers).split("(")[0] == effect.id.split("k * ")[1].split("(")[0]


def test_courses_of_other_families_that_come_near_are_told_too() -> None:
    """Fits tell a saw from what it resembles on a grid of seconds."""
    basis = shapes.heading_bases(SPAN)[0]
    saw = next(f for f in courses.OVER_TIME if f.name == "saw")
    k = basis.through @ saw.values(np.array([9.2, 0.4]), basis.grid)
    names = tuple((basis.effect.id, p.name) for p in basis.effect.parameters)
    quadratic = Quadratic(names, 0.0, 100.0 * k, 100.0 * np.eye(len(k)))
    found = shapes.closest(basis, quadratic, np.zeros(0, dtype=np.int64))
    kinds = [effect.made[0] for effect, _ in found if effect.made is not None]
    gained = [gain for _, gain in found]
    assert len(set(kinds)) == len(found) == shapes.CLOSER
    assert "saw" in kinds
    assert gained == sorted(gained, reverse=True)
    first, gain = shapes.closest(basis, quadratic, np.zeros(0, dtype=np.int64))[0]
    assert (first.id, gain) == (found[0][0].id, gained[0])


@pytest.mark.prove
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_passes_by_is_unexplained(sign: float) -> None:
    """A magnet that comes and goes is no noise that lasts."""
    world = simulate("free-hand", seed=0, duration_s=60.0, phone=slow, effects={}, sway=1.0)
    recording = recording_of(world, "heading")
    heading = recording.streams["heading"]
    t = heading.t - recording.imu.t[0]
    value = heading.value.copy()
    value[:, 0] += sign * 0.5 * np.exp(-0.5 * ((t - 24.0) / 3.0) ** 2)
    streams = {**recording.streams, "heading": replace(heading, value=value)}
    found = explain([replace(recording, streams=streams)])
    assert found.verdict == "unexplained"
    assert found.missing == ()
    (bump,) = found.unnamed
    at, width = (float(x) for x in re.findall(r"([\d.]+) s\)", bump.formula))
    # (a centre is known to the width over the ratio of height to sigma)
    assert at == pytest.approx(24.0, abs=5.0 * 3.0 * bump.sigma / 0.5)
    assert width == pytest.approx(3.0, abs=5.0 * 3.0 * bump.sigma / 0.5)
    assert bump.value == pytest.approx(sign * 0.5, abs=4.0 * bump.sigma)


@pytest.mark.prove
@pytest.mark.parametrize("square", [False, True])
def test_a_heading_that_errs_with_the_temperature_is_told(square: bool) -> None:
    """A walk or an attitude error stood in for it while a heading saw no thermometer."""
    world = simulate("free-hand", seed=0, duration_s=40.0, phone=warming, effects={})
    recording = recording_of(world, "heading", "temperature")
    heading, warmth = recording.streams["heading"], recording.streams["temperature"]
    x = 4.0 * np.sin(warmth.t / 9.0) + 3.0 * np.sin(warmth.t / 4.3)
    error = np.interp(heading.t, warmth.t, 0.03 * (0.2 * x**2 if square else x))
    streams = {
        "heading": replace(heading, value=heading.value + error[:, None]),
        "temperature": replace(warmth, value=25.0 + x[:, None]),
    }
    law, *_ = likeliest_laws(baseline([case_of(replace(recording, streams=streams))]))
    assert law.id == f"heading += k * (T - 25){'^2' * square}"


def test_a_course_whose_arithmetic_is_lost_is_no_candidate() -> None:
    """Information below none, which a gap of a minute left of a difference: there was no course
    at all, and explain ended in a traceback."""
    basis = shapes.heading_bases(SPAN)[0]
    names = tuple((basis.effect.id, p.name) for p in basis.effect.parameters)
    lost = Quadratic(names, 0.0, np.ones(len(names)), -1e6 * np.eye(len(names)))
    _, gain = shapes.closest(basis, lost, np.zeros(0, dtype=np.int64))[0]
    assert gain == -np.inf


@pytest.mark.parametrize("direction", [-2.0, 0.3, 1.1])
def test_a_sine_of_the_heading_is_no_lobe(direction: float) -> None:
    """A lobe may be as wide as one of e^2 to one, by the square root of two: wider ones are what
    hard iron does."""
    basis = shapes.heading_bases(SPAN)[1]
    k = basis.through @ np.cos(basis.grid - direction)
    # (a constant offset of the heading is free)
    free = 4e3 * (np.eye(len(k)) - 1.0 / len(k))
    names = tuple((basis.effect.id, p.name) for p in basis.effect.parameters)
    quadratic = Quadratic(names, 0.0, 0.05 * free @ k, free)
    found, _ = shapes.closest(basis, quadratic, np.zeros(0, dtype=np.int64))[0]
    assert found.made is not None
    kind, (at, sharp) = found.made
    assert kind == "lobe"
    assert np.cos(at - direction) == pytest.approx(1.0, abs=0.02) or np.cos(
        at - direction
    ) == pytest.approx(-1.0, abs=0.02)
    assert sharp >= 2.0 / np.sqrt(2.0)

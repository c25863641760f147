"""Effects by name: which field of the simulated world each parameter is.

Ids, names, order and units are those that users know; values are set, not added.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim.errors import SimulationError, UnknownWord
from handcal_sim.phone import Phone
from handcal_sim.sensors import Earth

AXES = "xyz"


@dataclass(frozen=True)
class Setup:
    """All that an effect may change."""

    phone: Phone
    earth: Earth


@dataclass(frozen=True)
class Parameter:
    """Its name and unit, and its place: a field, and an index within that if it is an array."""

    name: str
    unit: str
    field: str
    index: tuple[int, ...] = ()


def _vector(field: str, unit: str, names: Sequence[str] = AXES) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, unit, field, (i,)) for i, name in enumerate(names))


def _scalar(field: str, unit: str, name: str) -> tuple[Parameter, ...]:
    return (Parameter(name, unit, field),)


def _matrix(field: str, unit: str, names: Sequence[str]) -> tuple[Parameter, ...]:
    """Entries of a (3, 3) matrix by two axes, or one for the diagonal."""
    places = [(AXES.index(name[0]), AXES.index(name[-1])) for name in names]
    return tuple(Parameter(n, unit, field, place) for n, place in zip(names, places, strict=True))


def _products(field: str, unit: str) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{axis}_{pair}", unit, field, (i, j))
        for i, axis in enumerate(AXES)
        for j, pair in enumerate(("xy", "yz", "xz"))
    )


_ALL_NINE = [i + j for i in AXES for j in AXES]
_GYRO, _ACCEL = "rad/s", "m/s^2"
_H = "phone.heading_errors"

EFFECTS: dict[str, tuple[Parameter, ...]] = {
    "gyro_bias": _vector("phone.gyro.bias", _GYRO),
    "accel_bias": _vector("phone.accel.bias", _ACCEL),
    "gyro_scale": _matrix("phone.gyro.response", "1", AXES),
    "accel_scale": _matrix("phone.accel.response", "1", AXES),
    "gyro_misalignment": _matrix(
        "phone.gyro.response", "rad", ["xy", "xz", "yx", "yz", "zx", "zy"]
    ),
    "accel_misalignment": _matrix("phone.accel.response", "rad", ["yx", "zx", "zy"]),
    "gyro_g_sensitivity": _matrix("phone.gyro.g_sensitivity", "(rad/s)/(m/s^2)", _ALL_NINE),
    "gyro_quadratic": _vector("phone.gyro.quadratic", "s/rad"),
    "gyro_cross_products": _products("phone.gyro.cross_products", "s/rad"),
    "accel_cross_products": _products("phone.accel.cross_products", "s^2/m"),
    "accel_asymmetry": _vector("phone.accel.asymmetry", "1"),
    "lever_arm": _vector("phone.lever_arm", "m"),
    "size_effect": _matrix("phone.accel.places", "m", _ALL_NINE),
    "gyro_temperature": _vector("phone.gyro.temperature", "(rad/s)/K"),
    "accel_temperature": _vector("phone.accel.temperature", "(m/s^2)/K"),
    "accel_delay": _scalar("phone.accel.delay_s", "s", "delay"),
    "gyro_bandwidth": _scalar("phone.gyro.lag_s", "s", "tau"),
    "gyro_bias_walk": _scalar("phone.gyro.walk", "(rad/s)/sqrt(s)", "density"),
    "accel_bias_walk": _scalar("phone.accel.walk", "(m/s^2)/sqrt(s)", "density"),
    "gyro_bias_step": _vector("phone.gyro.step", _GYRO)
    + _scalar("phone.gyro.step_at_s", "s", "at"),
    "heading_hard_iron": _vector(f"{_H}.hard_iron", "rad", ["sin", "cos"]),
    "heading_soft_iron": _vector(f"{_H}.soft_iron", "rad", ["sin", "cos"]),
    "mag_hard_iron": _vector("phone.mag.hard_iron", "tesla"),
    "mag_soft_iron": _matrix("phone.mag.soft_iron", "1", ["xx", "yy", "zz", "xy", "xz", "yz"]),
    "mag_gradient": _matrix("phone.mag.gradient", "tesla/m", ["xx", "yy", "xy", "xz", "yz"]),
    "mag_step": _vector("phone.mag.step", "tesla") + _scalar("phone.mag.step_at_s", "s", "at"),
    "heading_delay": _scalar(f"{_H}.delay_s", "s", "delay"),
    "pose_delay": _scalar("phone.pose.delay_s", "s", "delay"),
    "pose_scale": _scalar("phone.pose.scale", "1", "scale"),
    "pose_drift": (
        *_scalar("phone.pose.position_walk", "m/sqrt(s)", "position"),
        *_scalar("phone.pose.attitude_walk", "rad/sqrt(s)", "attitude"),
    ),
    "heading_drift": _scalar(f"{_H}.drift", _GYRO, "rate"),
    "heading_correlated_noise": _scalar(f"{_H}.correlated", "rad", "sigma")
    + _scalar(f"{_H}.correlated_tau_s", "s", "tau"),
    "heading_outliers": _scalar(f"{_H}.outliers", "1", "fraction"),
    "gravity": _scalar("earth.gravity_error", _ACCEL, "delta"),
    "earth_rate": _vector("earth.rate_error", _GYRO, ["north", "up"]),
    "clock_rate": _scalar("phone.clock_ppm", "1e-6", "ppm"),
}

# Not a magnetometer's, and what a magnetometer has instead.
_OF_A_HEADING = {
    "heading_hard_iron": "; see mag_hard_iron",
    "heading_soft_iron": "; see mag_soft_iron",
    "heading_correlated_noise": "",
}
_NOT_NEGATIVE = {"tau", "density", "sigma", "fraction"}


def parted(effects: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Effects, as typed, that are this simulator's own, and those that are not."""
    own = tuple(e for e in effects if e.partition("=")[0].strip() in EFFECTS)
    return own, tuple(e for e in effects if e not in own)


def parse_effect(text: str) -> tuple[str, tuple[float, ...]]:
    """`ID=v,v,...` as an id and its values; SimulationError says what is expected."""
    name, equals, values = text.partition("=")
    name = name.strip()
    expected = _expected(name)
    try:
        numbers = tuple(float(value) for value in values.split(","))
    except ValueError:
        numbers = ()
    if not equals or not numbers:
        raise SimulationError(f"--effect {text!r}: expected {expected}")
    check(name, numbers)
    return name, numbers


def check(name: str, values: Sequence[float]) -> None:
    """SimulationError unless these are values for this effect."""
    expected = _expected(name)
    parameters = EFFECTS[name]
    if len(values) != len(parameters):
        raise SimulationError(
            f"{name} takes {len(parameters)} value(s), not {len(values)}: {expected}"
        )
    if not all(math.isfinite(value) for value in values):
        raise SimulationError(f"{name} takes finite numbers: {expected}")
    for parameter, value in zip(parameters, values, strict=True):
        if parameter.name in _NOT_NEGATIVE and value < 0.0:
            raise SimulationError(f"{name}: {parameter.name} must not be negative")
    if name == "heading_outliers" and values[0] > 1.0:
        raise SimulationError("heading_outliers: fraction must not exceed 1")
    if name == "clock_rate" and abs(values[0]) > 1e5:
        raise SimulationError("clock_rate: ppm must lie within 100000 either way")
    if name == "heading_correlated_noise" and values[1] == 0.0:
        raise SimulationError("heading_correlated_noise: tau must be above 0")


def _expected(name: str) -> str:
    if name not in EFFECTS:
        raise UnknownWord("effect", name, EFFECTS)
    names = ",".join(parameter.name for parameter in EFFECTS[name])
    of = unit(name)
    return f"{name}={names} " + ("without unit" if of == "1" else f"in {of}")


def unit(name: str) -> str:
    """The unit of an effect's parameters, or one for each where they differ."""
    units = [parameter.unit for parameter in EFFECTS[name]]
    return units[0] if len(set(units)) == 1 else ",".join(units)


def apply(setup: Setup, effects: Mapping[str, Sequence[float]]) -> Setup:
    """The setup with these effects set."""
    for name, values in effects.items():
        check(name, values)
        _check_sensor(setup.phone, name)
        for parameter, value in zip(EFFECTS[name], values, strict=True):
            setup = _set(setup, parameter.field.split("."), parameter.index, float(value), name)
    return setup


def _check_sensor(phone: Phone, name: str) -> None:
    if phone.heading is not None or not name.startswith("heading_"):
        return
    if phone.mag is None:
        raise SimulationError(f"{name} needs a heading sensor or a magnetometer")
    if name in _OF_A_HEADING:
        raise SimulationError(f"{name} needs a heading sensor{_OF_A_HEADING[name]}")


def _set(owner: Any, path: list[str], index: tuple[int, ...], value: float, effect: str) -> Any:
    head, rest = path[0], path[1:]
    old = getattr(owner, head)
    if old is None:
        raise SimulationError(f"{effect} needs a sensor that is not there: {head}")
    if rest:
        return replace(owner, **{head: _set(old, rest, index, value, effect)})
    if not index:
        return replace(owner, **{head: value})
    new = np.array(old, dtype=float)
    new[index] = value
    return replace(owner, **{head: tuple(new.tolist()) if isinstance(old, tuple) else new})


def values_of(setup: Setup, name: str) -> list[float] | None:
    """What the effect's parameters are in this setup; None without the sensor."""
    found = []
    for parameter in EFFECTS[name]:
        owner: Any = setup
        for step in parameter.field.split("."):
            owner = None if owner is None else getattr(owner, step)
        if owner is None:
            return None
        found.append(float(np.asarray(owner)[parameter.index]))
    return found

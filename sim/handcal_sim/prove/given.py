"""What every suite of a blind trial draws with: circumstances, devices, sizes, answers."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim.companions import Clocking, Heading
from handcal_sim.effects import EFFECTS
from handcal_sim.motion import Scenario
from handcal_sim.phone import (
    DEG,
    MG,
    Phone,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
    trusted_reference,
    with_rate,
)
from handcal_sim.prove.suites import GAUGES, NEEDS, OF_THE_WORLD, POSITIVE, SIZES, SUITES, Answer
from handcal_sim.scenario import World, simulate
from handcal_sim.sensors import EARTH_RATE

Gain = Callable[[World, str, Sequence[float]], float]


@dataclass(frozen=True)
class Ticket:
    """Which recording is asked for. gain: for `faint`, the nats that an effect promises there."""

    suite: str
    number: int
    seed: int
    gain: Gain | None = None


def generator(ticket: Ticket) -> np.random.Generator:
    """What a recording is drawn with."""
    return np.random.default_rng([ticket.seed, list(SUITES).index(ticket.suite), ticket.number])


def in_turn(names: Sequence[str], ticket: Ticket) -> str:
    """Every name equally often, in an order that differs from round to round."""
    turn, place = divmod(ticket.number, len(names))
    order = np.random.default_rng([ticket.seed, list(SUITES).index(ticket.suite), turn, 0])
    return names[int(order.permutation(len(names))[place])]


@dataclass(frozen=True)
class Circumstances:
    """A motion and a device, but for what is wrong with it. heading_hz 0: no heading;
    reference_hz 0: no second IMU."""

    scenario: str
    duration_s: float
    rate_hz: float
    sway: float
    noise: float
    heading_sigma_deg: float
    heading_hz: float
    mag: bool
    pose: bool
    thermometer: bool
    warming_K: float
    seed: int
    reference_hz: float = 0.0

    @property
    def streams(self) -> frozenset[str]:
        there = {"heading": self.heading_hz > 0.0, "mag": self.mag, "pose": self.pose,
                 "temperature": self.thermometer, "reference": self.reference_hz > 0.0}  # fmt: skip
        return frozenset(name for name, present in there.items() if present)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number of which the logarithm is anywhere between those of low and high."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def some(given: Circumstances, rng: np.random.Generator, most: int) -> list[str]:
    """As many effects as that at most, which this recording's streams can show."""
    # The Earth's rate is of a size of its own, which most motions cannot show.
    able = [n for n in SIZES if NEEDS.get(n, frozenset()) <= given.streams and n != "earth_rate"]
    if "reference" in given.streams:
        able = [n for n in (*able, "clock_rate") if n not in OF_THE_WORLD]
    while True:
        names = [str(name) for name in rng.choice(able, rng.integers(most + 1), replace=False)]
        if not any(gauge <= set(names) for gauge in GAUGES):
            return names


def with_streams(
    given: Circumstances, names: Sequence[str], rng: np.random.Generator
) -> Circumstances:
    """The same with the streams that these effects need; a thermometer sees 10 K or more."""
    needed = frozenset().union(*(NEEDS.get(name, frozenset()) for name in names))
    warming = float(rng.uniform(10.0, 18.0))
    if "temperature" in needed:
        given = replace(given, thermometer=True, warming_K=warming)
    if "mag" in needed:
        given = replace(given, mag=True, heading_hz=0.0)
    return replace(given, pose=given.pose or ("pose" in needed and not given.reference_hz))


def amplitudes(
    names: Sequence[str], given: Circumstances, rng: np.random.Generator
) -> dict[str, list[float]]:
    """Each parameter half to one and a half times its standard deviation, of either sign."""
    effects = {name: amplitude(name, given, rng) for name in names}
    if {"lever_arm", "size_effect"} <= set(names):
        # Together, places count from their own middle.
        rows = np.reshape(effects["size_effect"], (3, 3))
        effects["size_effect"] = (rows - rows.mean(axis=0)).ravel().tolist()
    return effects


def amplitude(name: str, given: Circumstances, rng: np.random.Generator) -> list[float]:
    """Values of one effect, in the order of its parameters."""
    if name == "earth_rate":
        latitude = float(rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 70.0)) * DEG
        return [EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)]
    parameters, sizes = EFFECTS[name], SIZES[name]
    values = []
    for k, parameter in enumerate(parameters):
        value = sizes[min(k, len(sizes) - 1)] * rng.uniform(0.5, 1.5)
        if parameter.name == "at":
            value = given.duration_s * rng.uniform(0.25, 0.75)
        elif parameter.name not in POSITIVE:
            value *= rng.choice([-1.0, 1.0])
        values.append(float(value))
    return values


def device(given: Circumstances, rng: np.random.Generator) -> Phone:
    """A consumer's phone of these rates, noise levels and streams; biases of any likely size."""
    phone = with_rate(consumer_phone(rng), given.rate_hz)
    mag, pose = consumer_magnetometer(rng), capture_pose(rng)
    gyro = replace(
        phone.gyro, bias=rng.normal(0.0, 1.0 * DEG, 3), noise=phone.gyro.noise * given.noise
    )
    accel = replace(
        phone.accel, bias=rng.uniform(-80.0, 80.0, 3) * MG, noise=phone.accel.noise * given.noise
    )
    phase, warm = rng.random(), phone.thermometer
    rise = given.warming_K / -math.expm1(-given.duration_s / warm.tau_s)
    heading = None
    if given.heading_hz > 0.0:
        clocking = Clocking(given.heading_hz, float(phase) / given.heading_hz)
        heading = Heading(given.heading_sigma_deg * DEG, clocking)
    reference = None
    if given.reference_hz > 0.0:
        clocking = Clocking(given.reference_hz, float(phase) / given.reference_hz)
        reference = replace(trusted_reference(rng), clocking=clocking)
    return replace(
        phone, gyro=gyro, accel=accel, heading=heading, reference=reference,
        mag=mag if given.mag else None,
        pose=replace(pose, clocking=Clocking(25.0, pose.clocking.phase_s)) if given.pose else None,
        thermometer=replace(warm, rise=rise, reported=given.thermometer),
    )  # fmt: skip


def _as_it_is(phone: Phone) -> Phone:
    return phone


def simulated(
    given: Circumstances,
    effects: Mapping[str, Sequence[float]],
    motion: Scenario | None = None,
    refit: Callable[[Phone], Phone] = _as_it_is,
    tremor: float = 1.0,
) -> World:
    """The world of these circumstances with these effects.

    motion: what makes it, where it goes by no name; refit: changes the device before its errors;
    tremor: of the hand, times as much as usual.
    """
    return simulate(
        motion or given.scenario, seed=given.seed, phone=lambda rng: refit(device(given, rng)),
        effects=effects, duration_s=given.duration_s, sway=given.sway,
        tremor=tremor,
    )  # fmt: skip


def answer(
    suite: str, group: str, given: Circumstances, effects: Mapping[str, Sequence[float]],
    stranger: Mapping[str, Any] | None = None,
) -> Answer:  # fmt: skip
    """Everything that was drawn, by name."""
    injected = {
        name: {p.name: v for p, v in zip(EFFECTS[name], values, strict=True)}
        for name, values in effects.items()
    }
    return Answer(suite, group, injected, stranger or {}, {}, dict(vars(given)))


def completed(world: World, drawn: Answer, warm: float | None = None) -> Answer:
    """The answer with the true biases (their means, where they walk, at the mean temperature),
    which are never a question but show honest sigmas, and with what iron looks like where north is
    off by the constant heading offset. warm: the mean temperature above 25 degC, K, where that is
    not the thermometer's."""
    present = world.parameters["effects"]
    walked = world.parameters["mean_walk"]
    if warm is None:
        told = world.streams.get("temperature")
        warm = 0.0 if told is None else float(told.values.mean()) - 25.0
    baseline = {}
    for sensor in ("gyro", "accel"):
        slopes = [p["value"] for p in present.get(f"{sensor}_temperature", ())] or [0.0] * 3
        baseline[f"{sensor}_bias"] = {
            p["name"]: p["value"] + mean + warm * slope
            for p, mean, slope in zip(
                present[f"{sensor}_bias"], walked[sensor], slopes, strict=True
            )
        }
    offset = world.parameters["phone"]["heading_errors"]["offset"]
    comparable = {}
    for name, periods in (("heading_hard_iron", 1), ("heading_soft_iron", 2)):
        if name in drawn.effects:
            iron = complex(drawn.effects[name]["sin"], drawn.effects[name]["cos"])
            # sin(yaw) seen from yaw + offset: both coefficients turn back by the offset.
            iron *= cmath.exp(-1j * periods * offset)
            comparable[name] = {"sin": iron.real, "cos": iron.imag}
    if "mag_soft_iron" in drawn.effects:
        comparable["mag_soft_iron"] = _traceless(drawn.effects["mag_soft_iron"])
    return replace(drawn, baseline=baseline, comparable=comparable)


def _traceless(bend: Mapping[str, float]) -> dict[str, float]:
    """The same bend in a field that is stronger by its mean, which no magnetometer can tell."""
    mean = (bend["xx"] + bend["yy"] + bend["zz"]) / 3.0
    axes = {"xx", "yy", "zz"}
    return {n: (v - mean if n in axes else v) / (1.0 + mean) for n, v in bend.items()}

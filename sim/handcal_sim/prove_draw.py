"""The draws of a blind trial: a recording, and the answer that nobody may see beforehand.

A recording is drawn from its seed, suite and number alone. What a suite is for, and which
share of right answers it asks for, stands in `prove_suites`.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim import strangers
from handcal_sim.effects import EFFECTS
from handcal_sim.phone import (
    DEG,
    MG,
    Clocking,
    Heading,
    Phone,
    capture_pose,
    consumer_magnetometer,
    consumer_phone,
    trusted_reference,
    with_rate,
)
from handcal_sim.profiles import Array
from handcal_sim.prove_suites import (
    BESIDE,
    EARTH_GROUP,
    FAINT_NATS,
    GAUGES,
    LARGE,
    NEEDS,
    OF_THE_WORLD,
    POSITIVE,
    SIZES,
    SUITES,
    Answer,
)
from handcal_sim.scenario import World, simulate
from handcal_sim.sensors import EARTH_RATE

Gain = Callable[[World, str, Sequence[float]], float]


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


def draw(suite: str, number: int, seed: int, gain: Gain | None = None) -> tuple[World, Answer]:
    """Recording `number` of a suite. gain: for `faint`, the nats that an effect promises there."""
    rng = np.random.default_rng([seed, list(SUITES).index(suite), number])
    world, drawn = _drawn(suite, number, seed, rng, gain)
    return world, completed(world, drawn)


def _drawn(
    suite: str, number: int, seed: int, rng: np.random.Generator, gain: Gain | None
) -> tuple[World, Answer]:
    given = circumstances(suite, rng)
    if suite == "faint":
        if gain is None:
            raise ValueError("the suite 'faint' needs to know what an effect promises")
        return _faint(given, number, rng, gain)
    if suite == "unknown":
        return _unknown(given, _next(list(strangers.KINDS), number, seed, suite), rng)
    if suite == "large":
        return _large(given, rng)
    if suite in ("one", "turn"):
        names = [_next(list(SIZES), number, seed, suite)]
    else:
        most = {"mixed": 3, "reference": 2}.get(suite, 0)
        names = _some(given, rng, most) if most else []
    names = list(dict.fromkeys([*names, *(BESIDE[n] for n in names if n in BESIDE)]))
    given = with_streams(given, names, rng)
    effects = amplitudes(names, given, rng)
    group = EARTH_GROUP if "earth_rate" in names else ""
    return simulated(given, effects), answer(suite, group, given, effects)


def _next(names: list[str], number: int, seed: int, suite: str) -> str:
    """Every name equally often, in an order that differs from round to round."""
    turn, place = divmod(number, len(names))
    order = np.random.default_rng([seed, list(SUITES).index(suite), turn, 0]).permutation(
        len(names)
    )
    return names[int(order[place])]


def circumstances(suite: str, rng: np.random.Generator) -> Circumstances:
    """Motion, rates, noise and hand; what is not asked for comes with some recordings."""
    scenario, duration = _motion(suite, rng)
    chance = rng.random(4)
    if suite == "reference":
        return _beside(scenario, duration, chance, rng)
    instead = suite in ("nothing", "mixed")
    mag = bool(instead and chance[0] < 0.12)
    heading = not (mag or (instead and chance[1] < 0.06))
    return Circumstances(
        scenario, round(duration, 1),
        rate_hz=round(_log_uniform(rng, 50.0, 400.0 if suite == "nothing" else 200.0)),
        sway=_log_uniform(rng, 0.3, 2.5),
        noise=_log_uniform(rng, 0.5, 2.0),
        heading_sigma_deg=_log_uniform(rng, 1.0, 30.0 if suite == "nothing" else 12.0),
        heading_hz=round(_log_uniform(rng, 10.0, 100.0)) if heading else 0.0,
        mag=mag, pose=bool(instead and chance[2] < 0.15), thermometer=bool(chance[3] < 0.35),
        warming_K=float(rng.uniform(2.0, 12.0)), seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _beside(
    scenario: str, duration: float, chance: Array, rng: np.random.Generator
) -> Circumstances:
    """A phone with a second IMU on its back, neither faster than 400 Hz, of other rates."""
    return Circumstances(
        scenario, round(duration, 1), rate_hz=round(_log_uniform(rng, 50.0, 400.0)), sway=1.0,
        noise=_log_uniform(rng, 0.5, 2.0), heading_sigma_deg=1.0, heading_hz=0.0, mag=False,
        pose=False, thermometer=bool(chance[3] < 0.35), warming_K=float(rng.uniform(10.0, 18.0)),
        seed=int(rng.integers(2**62)), reference_hz=round(_log_uniform(rng, 50.0, 400.0)),
    )  # fmt: skip


def _motion(suite: str, rng: np.random.Generator) -> tuple[str, float]:
    if suite == "turn":
        return "z-turn", 30.0
    if suite == "nothing":
        kind = str(rng.choice(["z-turn", "three-turns", "free-hand"], p=[0.4, 0.3, 0.3]))
        return kind, {"z-turn": 30.0, "three-turns": 84.0, "free-hand": rng.uniform(60, 120)}[kind]
    if suite == "reference":
        return str(rng.choice(["three-turns", "free-hand"])), rng.uniform(30.0, 90.0)
    if suite == "mixed":
        return str(rng.choice(["z-turn", "three-turns", "free-hand"])), rng.uniform(30.0, 120.0)
    return "free-hand", 84.0


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _some(given: Circumstances, rng: np.random.Generator, most: int) -> list[str]:
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
    effects = {name: _amplitude(name, given, rng) for name in names}
    if {"lever_arm", "size_effect"} <= set(names):
        # Together, places count from their own middle.
        rows = np.reshape(effects["size_effect"], (3, 3))
        effects["size_effect"] = (rows - rows.mean(axis=0)).ravel().tolist()
    return effects


def _amplitude(name: str, given: Circumstances, rng: np.random.Generator) -> list[float]:
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


def simulated(given: Circumstances, effects: Mapping[str, Sequence[float]]) -> World:
    """The world of these circumstances with these effects."""
    return simulate(
        given.scenario, seed=given.seed, phone=lambda rng: device(given, rng), effects=effects,
        duration_s=given.duration_s, sway=given.sway,
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


def completed(world: World, drawn: Answer) -> Answer:
    """The answer with the true biases, which are never a question but show honest sigmas, and
    with what iron looks like where north is off by the constant heading offset."""
    present = world.parameters["effects"]
    baseline = {
        name: {p["name"]: p["value"] for p in present[name]} for name in ("gyro_bias", "accel_bias")
    }
    offset = world.parameters["phone"]["heading_errors"]["offset"]
    comparable = {}
    for name, periods in (("heading_hard_iron", 1), ("heading_soft_iron", 2)):
        if name in drawn.effects:
            iron = complex(drawn.effects[name]["sin"], drawn.effects[name]["cos"])
            # sin(yaw) seen from yaw + offset: both coefficients turn back by the offset.
            iron *= cmath.exp(-1j * periods * offset)
            comparable[name] = {"sin": iron.real, "cos": iron.imag}
    return replace(drawn, baseline=baseline, comparable=comparable)


def _unknown(given: Circumstances, kind: str, rng: np.random.Generator) -> tuple[World, Answer]:
    if kind in strangers.NEEDS_TEMPERATURE:
        given = with_streams(given, ["accel_temperature"], rng)
    world, strange = strangers.estrange(kind, simulated(given, {}), rng)
    said = {"kind": kind, **strangers.said_of(strange)}
    return world, answer("unknown", "", given, {}, said)


def _large(given: Circumstances, rng: np.random.Generator) -> tuple[World, Answer]:
    names = [str(name) for name in rng.choice(list(LARGE), rng.integers(1, 4), replace=False)]
    given = with_streams(given, names, rng)
    effects = {
        name: [float(rng.choice([-1.0, 1.0]) * rng.uniform(*LARGE[name])) for _ in EFFECTS[name]]
        for name in names
    }
    for late in {"heading_delay", "pose_delay"} & set(names):
        effects[late] = [abs(v) for v in effects[late]]
    return simulated(given, effects), answer("large", "", given, effects)


def _faint(
    given: Circumstances, number: int, rng: np.random.Generator, gain: Gain
) -> tuple[World, Answer]:
    """One effect of any kind whose size promises so many nats in this recording."""
    nats = FAINT_NATS[number % len(FAINT_NATS)]
    names = [str(name) for name in rng.permutation([n for n in SIZES if n != "earth_rate"])]
    for name in names:
        there = with_streams(given, [name], rng)
        values = _scaled(name, _amplitude(name, there, rng), nats, simulated(there, {}), gain)
        if values is not None:
            drawn = answer("faint", f"{nats:g} nats", there, {name: values})
            return simulated(there, {name: values}), drawn
    raise ValueError("no effect shows in this recording, whatever its size")


def _scaled(
    name: str, values: list[float], nats: float, world: World, gain: Gain
) -> list[float] | None:
    """Values in proportion that promise `nats`; None where no reasonable size does.

    Nats grow with the square of the size, but for their constants: the steps converge fast.
    """
    fixed = [p.name in ("at", "tau") and len(values) > 1 for p in EFFECTS[name]]
    size = 1.0
    for _ in range(12):
        trial = [v if keep else v * size for v, keep in zip(values, fixed, strict=True)]
        promised = gain(world, name, trial)
        if abs(promised - nats) < 0.02 * nats:
            return trial
        size *= min(max(math.sqrt(nats / max(promised, 1e-9)), 0.2), 5.0)
        if not 1e-4 < size < 20.0 or (name == "heading_outliers" and values[0] * size > 0.9):
            return None
    return None

"""The suite `ordinary`: devices with all the errors of a data sheet, in the short and one-sided
motions that people make. Some have something rare besides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim.companions import Thermometer
from handcal_sim.motion import Scenario, free_hand, three_turns
from handcal_sim.motion_carried import carried, strolled
from handcal_sim.motion_ordinary import six_sides, two_axes, yaw_on_a_table
from handcal_sim.motion_phone import routine, swings
from handcal_sim.phone import DEG
from handcal_sim.prove.given import (
    Circumstances,
    Ticket,
    amplitudes,
    answer,
    completed,
    generator,
    log_uniform,
)
from handcal_sim.prove.ordinary_devices import COMMON, KINDS, SLOPES, Device, device
from handcal_sim.prove.suites import NEEDS, SIZES, Answer
from handcal_sim.scenario import World, simulate
from handcal_sim.strange.device import LAWS, Added, given, own_scene, said_of, with_laws
from handcal_sim.strangers import scene_of

SUITE = "ordinary"
# By name: what makes a motion (of its length and a generator), and how long people do it, s.
MOTIONS: Mapping[str, tuple[Callable[[float, np.random.Generator], Scenario], float]] = {
    "three axes": (lambda _, rng: (three_turns, free_hand, routine(False))[rng.integers(3)], 35.0),
    "yaw on a table": (lambda *_: yaw_on_a_table, 45.0),
    "two axes": (lambda *_: two_axes, 25.0),
    "swings": (lambda _, rng: swings(rng.uniform(25.0, 60.0) * DEG, rng.uniform(0.35, 1.2)), 30.0),
    "six sides": (lambda *_: six_sides, 55.0),
    "walk": (lambda s, rng: carried(strolled(s, rng.uniform(0.8, 2.0), rng),
                                    rng.uniform(0.2, 0.8)), 40.0),
}  # fmt: skip
STREAMS = ("heading", "mag", "pose", "none")
_STREAM_SHARES = (0.35, 0.3, 0.15, 0.2)
# Devices with one effect that few have, and with a law outside the catalogue.
RARE_SHARE, LAW_SHARE = 0.15, 0.10
# Not of the device: gravity, the Earth's rate, and what defines time itself.
RARE = tuple(n for n in SIZES if n not in (*COMMON, "gravity", "earth_rate", "clock_rate"))
# What happens once, and not in the next recording again.
ONCE = ("gyro_bias_step", "mag_step")
COLDEST, WARMEST = 5.0, 45.0
THERMOMETER, DRIFTS = 0.85, 0.5


@dataclass(frozen=True)
class Occasion:
    """One recording's circumstances: motion and length (s), the hand, degC at the start and how
    many K it drifts, whether the thermometer is read; seed: of all that is left."""

    motion: str
    duration_s: float
    sway: float
    start_degC: float
    drift_K: float
    thermometer: bool
    seed: int


@dataclass(frozen=True)
class Case:
    """rare: one effect besides the device's own, or none; laws: one law on its channels, or none;
    two occasions."""

    device: Device
    rare: Mapping[str, list[float]]
    laws: tuple[Added, ...]
    first: Occasion
    second: Occasion


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Each class with each motion in turn."""
    case = _case(ticket.number, rng)
    world = recorded(case)
    laws = [said_of(list(acting(case.laws, world)), scene_of(world))] if case.laws else []
    stranger = {"kind": laws[0]["law"], "laws": laws} if laws else None
    effects = {n: v for n, v in case.device.effects.items() if n not in SLOPES} | {**case.rare}
    said = answer(ticket.suite, "", _circumstances(case), effects, stranger)
    more = {**vars(case.first), "kind": case.device.kind, "stream": _stream(case.device),
            "rare": next(iter(case.rare), ""), "mean_K": _warm(world)}  # fmt: skip
    said = replace(said, circumstances={**said.circumstances, **more})
    said = completed(world, said, _warm(world))
    if not case.first.thermometer:
        others = {n: s for n, s in world.streams.items() if n != "temperature"}
        world = replace(world, streams=others)
    return world, said


def _warm(world: World) -> float:
    """Mean temperature above 25 degC, K."""
    return float(scene_of(world).warm.mean())


def case_of(ticket: Ticket) -> Case:
    """What a ticket stands for."""
    return _case(ticket.number, generator(ticket))


def recorded(case: Case, again: bool = False, silent: bool = False) -> World:
    """The first recording, or another one of the same device; silent: without white noise."""
    at = case.second if again else case.first
    effects = dict(case.device.effects)
    effects |= {n: v for n, v in case.rare.items() if not (again and n in ONCE)}
    rng = np.random.default_rng(at.seed)
    made, phone = MOTIONS[at.motion][0](at.duration_s, rng), case.device.phone
    warm = Thermometer(at.start_degC, at.drift_K, rng.uniform(20.0, 60.0), 0.05, reported=True)
    if silent:
        phone = replace(phone, gyro=replace(phone.gyro, noise=0.0, quantum=0.0),
                        accel=replace(phone.accel, noise=0.0, quantum=0.0))  # fmt: skip
    world = simulate(
        made, seed=at.seed, phone=replace(phone, thermometer=warm), effects=effects,
        duration_s=at.duration_s, sway=at.sway,
    )  # fmt: skip
    return with_laws(world, list(acting(case.laws, world)))


def acting(laws: tuple[Added, ...], world: World) -> tuple[Added, ...]:
    """A device's law, with what it adds in this world."""
    scene = scene_of(world) if laws else None
    return tuple(
        replace(one, error=one.k * one.strange.error_of(own_scene(scene, one.strange.channel)))
        for one in laws
        if scene is not None
    )


def _case(number: int, rng: np.random.Generator) -> Case:
    kind = KINDS[number % len(KINDS)]
    motions = list(MOTIONS)
    # (so that each class meets each motion within 18 recordings)
    place = (number + number // len(motions)) % len(motions)
    stream = str(rng.choice(STREAMS, p=_STREAM_SHARES))
    one = device(kind, frozenset({stream} - {"none"}), rng)
    first = _occasion(motions[place], rng)
    others = [m for m in motions if m != first.motion]
    second = _occasion(str(rng.choice(others)), rng)
    case, chance = Case(one, {}, (), first, second), rng.random()
    if chance < RARE_SHARE:
        return replace(case, rare=_rare(case, rng))
    return replace(case, laws=_law(case, rng)) if chance < RARE_SHARE + LAW_SHARE else case


def _occasion(motion: str, rng: np.random.Generator) -> Occasion:
    drift = rng.choice([-1.0, 1.0]) * log_uniform(rng, 0.5, 6.0) * (rng.random() < DRIFTS)
    thermometer = bool(rng.random() < THERMOMETER)
    # (a drift that no thermometer sees is a bias that walks, which is something rare)
    return Occasion(
        motion, round(MOTIONS[motion][1] * rng.uniform(0.8, 1.25), 1), log_uniform(rng, 0.5, 2.0),
        float(rng.uniform(COLDEST, WARMEST)), float(drift) * thermometer, thermometer,
        int(rng.integers(2**62)),
    )  # fmt: skip


def _rare(case: Case, rng: np.random.Generator) -> dict[str, list[float]]:
    there = _circumstances(case)
    able = [n for n in RARE if NEEDS.get(n, frozenset()) <= there.streams]
    name = str(rng.choice(able))
    return {name: amplitudes([name, "lever_arm"], there, rng)[name]}


def _law(case: Case, rng: np.random.Generator) -> tuple[Added, ...]:
    """A law, as large as is usual in a hand that turns freely, whatever it is in a recording."""
    warm = case.first.thermometer
    able = [law for law in LAWS.values() if (warm or not law.needs_temperature)
            and (law.sensor != "heading" or case.device.phone.heading is not None)]  # fmt: skip
    phone = replace(case.device.phone, thermometer=Thermometer(10.0, 25.0, 20.0))
    freely = simulate("free-hand", seed=int(rng.integers(2**62)), phone=phone, duration_s=60.0)
    return tuple(given(able[int(rng.integers(len(able)))], freely, rng))


def _stream(one: Device) -> str:
    return next((n for n in STREAMS[:3] if getattr(one.phone, n) is not None), "none")


def _circumstances(case: Case) -> Circumstances:
    phone, at = case.device.phone, case.first
    heading = phone.heading
    return Circumstances(
        at.motion, at.duration_s, phone.rate_hz, at.sway, noise=1.0,
        heading_sigma_deg=heading.sigma / DEG if heading else 0.0,
        heading_hz=heading.clocking.rate_hz if heading else 0.0,
        mag=phone.mag is not None, pose=phone.pose is not None, thermometer=at.thermometer,
        warming_K=at.drift_K, seed=at.seed,
    )  # fmt: skip

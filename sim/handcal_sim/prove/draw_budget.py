"""The suite `budget`: a device with all the errors of a datasheet at once, recorded twice.

The first recording is explained. The second one is never written: it only asks how much of the
gyro's error the explanation would have taken off there (`left`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim import hand, leftover
from handcal_sim.effects import Setup, apply
from handcal_sim.losses import losing
from handcal_sim.motion import build, random_start
from handcal_sim.phone import Phone
from handcal_sim.prove.given import (
    Circumstances,
    Ticket,
    amplitudes,
    answer,
    device,
    generator,
    log_uniform,
)
from handcal_sim.prove.suites import NEEDS, Answer
from handcal_sim.scenario import World, simulate
from handcal_sim.sensors import ASSUMED

# What every datasheet states, and what comes with it. Not drawn: what defines time itself (a slow
# gyro, a fast clock), what happens once (a step), and what is not the device's (gravity).
ALWAYS = ("gyro_scale", "gyro_misalignment", "gyro_g_sensitivity", "accel_scale",
          "accel_misalignment", "lever_arm")  # fmt: skip
AT_TIMES = (
    "gyro_quadratic", "gyro_cross_products", "accel_cross_products", "accel_asymmetry",
    "size_effect", "gyro_temperature", "accel_temperature", "accel_delay", "gyro_bias_walk",
    "accel_bias_walk", "heading_hard_iron", "heading_soft_iron", "heading_delay",
    "mag_hard_iron", "mag_soft_iron", "pose_delay", "pose_scale",
)  # fmt: skip


@dataclass(frozen=True)
class Budget:
    """Circumstances and effects of the first recording; the device without its effects, share of
    samples that get lost; seed and sway of the second recording."""

    given: Circumstances
    effects: Mapping[str, list[float]]
    phone: Phone
    lost: float
    second_seed: int
    second_sway: float


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """The first recording."""
    budget = planned(rng)
    given = budget.given
    world = simulate(
        given.scenario, seed=given.seed, phone=budget.phone, effects=budget.effects,
        duration_s=given.duration_s, sway=given.sway,
    )  # fmt: skip
    said = answer(ticket.suite, "", given, budget.effects)
    more = {"lost": budget.lost, "interval_jitter_s": budget.phone.interval_jitter_s}
    return losing(world, budget.lost, rng), replace(
        said, circumstances={**said.circumstances, **more}
    )


def planned(rng: np.random.Generator) -> Budget:
    """Everything that is drawn of both recordings but the readings."""
    given = _circumstances(rng)
    able = [n for n in AT_TIMES if NEEDS.get(n, frozenset()) <= given.streams]
    some = rng.choice(able, rng.integers(2, 7), replace=False)
    effects = amplitudes([*ALWAYS, *(str(name) for name in some)], given, rng)
    if "pose_delay" in effects:
        effects["pose_delay"] = [abs(effects["pose_delay"][0])]
    phone = _rough(device(given, rng), rng)
    lost, seed = log_uniform(rng, 1e-3, 0.02), int(rng.integers(2**62))
    return Budget(given, effects, phone, lost, seed, log_uniform(rng, 0.5, 2.0))


def left(ticket: Ticket, document: Mapping[str, Any]) -> dict[str, float]:
    """Of the second recording: the gyro's error, rad/s, before and after what the explanation of
    the first one says is taken off, and the share that is left."""
    if "error" in document:
        return {}
    budget = planned(generator(ticket))
    given, rng = budget.given, np.random.default_rng(budget.second_seed)
    motion = build("free-hand", given.duration_s, random_start(rng), rng)
    motion = hand.in_hand(motion, hand.random_hand(rng, budget.second_sway), rng)
    true = apply(Setup(budget.phone, ASSUMED), budget.effects).phone
    found = leftover.estimated(true, document["parameters"])
    t = np.arange(0.0, given.duration_s, 0.01)
    before, after = leftover.gyro_error_left(true, found, motion, t)
    return {"before": before, "after": after, "share_left": after / before}


def _circumstances(rng: np.random.Generator) -> Circumstances:
    mag = bool(rng.random() < 0.25)
    return Circumstances(
        str(rng.choice(["free-hand", "three-turns"])), round(rng.uniform(60.0, 120.0), 1),
        rate_hz=round(log_uniform(rng, 50.0, 500.0)), sway=log_uniform(rng, 0.5, 2.0),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=log_uniform(rng, 1.0, 8.0),
        heading_hz=0.0 if mag else round(log_uniform(rng, 10.0, 100.0)), mag=mag,
        pose=bool(rng.random() < 0.3), thermometer=bool(rng.random() < 0.5),
        warming_K=float(rng.uniform(10.0, 18.0)), seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _rough(phone: Phone, rng: np.random.Generator) -> Phone:
    """Coarser converters and less regular instants and stamps."""
    coarse = float(rng.choice([1.0, 2.0, 4.0]))
    gyro = replace(phone.gyro, quantum=coarse * phone.gyro.quantum)
    accel = replace(phone.accel, quantum=coarse * phone.accel.quantum)
    return replace(
        phone, gyro=gyro, accel=accel,
        interval_jitter_s=float(rng.uniform(0.01, 0.08)) / phone.rate_hz,
        stamp_jitter_s=log_uniform(rng, 1e-5, 2e-4),
    )  # fmt: skip

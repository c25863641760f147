"""The suite `strange`: one or two laws outside the catalogue, beside none to two known effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from handcal_sim.phone import Phone
from handcal_sim.profiles import Array
from handcal_sim.prove.given import (
    Circumstances,
    Ticket,
    amplitudes,
    answer,
    generator,
    in_turn,
    log_uniform,
    simulated,
    some,
)
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World
from handcal_sim.strange.device import LATEST, LAWS, Added, given, own_scene, said_of, with_laws
from handcal_sim.strange.law import Law
from handcal_sim.strange.left import left_of, left_share
from handcal_sim.strangers import Scene, scene_of

Knot = tuple[float, float]

MOST = 2
# How often a second law errs on other channels.
_SECOND = 0.2


@dataclass(frozen=True)
class Case:
    """A recording: its circumstances, known effects, laws, and the world that holds them."""

    given: Circumstances
    effects: Mapping[str, list[float]]
    laws: tuple[list[Added], ...]
    world: World


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Each law in turn."""
    case = _case(ticket, rng)
    scene = scene_of(case.world)
    laws = [said_of(added, scene) for added in case.laws]
    stranger = {"kind": " + ".join(law["law"] for law in laws), "laws": laws}
    return case.world, answer(ticket.suite, "", case.given, case.effects, stranger)


def left(ticket: Ticket, document: Mapping[str, Any]) -> dict[str, float]:
    """By law, in their order: the share of its error that the explanation leaves."""
    if "error" in document:
        return {}
    case = case_of(ticket)
    return _by_law([left_share(added, case.world, document) for added in case.laws])


def columns(one: Added, world: World, free: bool) -> Array:
    """What a law adds to its channel by its size and, where these are free, by each change of its
    numbers (n, 1 or more)."""
    if not free:
        return one.error[:, None]
    scene = own_scene(scene_of(world), one.strange.channel)
    return np.column_stack([one.error, one.k * one.strange.by_numbers(scene)])


def left_of_sizes(
    ticket: Ticket, parameters: Sequence[Mapping[str, Any]], sizes: Sequence[Sequence[float]],
    free: bool,
) -> dict[str, float]:  # fmt: skip
    """The same where the laws themselves were told, and found is of each by how much too large and,
    where these are free, by how much its numbers are others."""
    case = case_of(ticket)

    def told(size: Sequence[float], law: Added, _: Scene) -> Array:
        return np.asarray(columns(law, case.world, free) @ np.asarray(size))

    return _by_law([
        left_of(added, case.world, parameters, partial(told, size))
        for added, size in zip(case.laws, sizes, strict=True)
    ])  # fmt: skip


def _by_law(shares: Sequence[float | None]) -> dict[str, float]:
    return {f"left_{n}": share for n, share in enumerate(shares, start=1) if share is not None}


def case_of(ticket: Ticket) -> Case:
    """What a ticket stands for, known effects and laws apart."""
    return _case(ticket, generator(ticket))


def _case(ticket: Ticket, rng: np.random.Generator) -> Case:
    first = LAWS[in_turn(LATEST if ticket.suite == "latest" else list(LAWS), ticket)]
    second = _second(first, rng)
    chosen = [first] if second is None else [first, second]
    there = _circumstances(any(law.needs_temperature for law in chosen), rng)
    effects = amplitudes(some(there, rng, MOST), there, rng)
    knots = _warm_and_cold(there, rng)

    def refit(phone: Phone) -> Phone:
        return replace(phone, thermometer=replace(phone.thermometer, knots=knots))

    world = simulated(there, effects, refit=refit)
    laws = tuple(given(law, world, rng) for law in chosen)
    together = [one for added in laws for one in added]
    return Case(there, effects, laws, with_laws(world, together))


def _second(first: Law, rng: np.random.Generator) -> Law | None:
    """A law of another sensor, now and then."""
    others = [law for law in LAWS.values() if law.sensor != first.sensor]
    return others[int(rng.integers(len(others)))] if rng.random() < _SECOND else None


def _circumstances(warm: bool, rng: np.random.Generator) -> Circumstances:
    """A phone with a heading at 100 Hz, turned freely for 84 s."""
    return Circumstances(
        "free-hand", 84.0, rate_hz=100.0, sway=log_uniform(rng, 0.3, 2.0),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=log_uniform(rng, 1.0, 6.0),
        heading_hz=round(log_uniform(rng, 20.0, 100.0)), mag=False, pose=False,
        thermometer=bool(rng.random() < 0.35) or warm, warming_K=float(rng.uniform(10.0, 18.0)),
        seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _warm_and_cold(there: Circumstances, rng: np.random.Generator) -> tuple[Knot, ...]:
    """A temperature that rises and falls, without which its rate would be its size over again."""
    when = np.linspace(0.0, there.duration_s, 6)
    level = np.column_stack([rng.permutation([0.0, 0.5, 1.0]), rng.permutation([0.1, 0.6, 0.9])])
    warm = rng.uniform(15.0, 22.0) + there.warming_K * level.ravel()
    return tuple(zip(when.tolist(), warm.tolist(), strict=True))

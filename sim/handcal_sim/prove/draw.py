"""The draws of a blind trial: a recording, and the answer, which stays hidden until the end.

A recording is drawn from its seed, suite and number alone. What a suite is for, and which
share of right answers it asks for, stands in `prove_suites`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from handcal_sim import strangers
from handcal_sim.effects import EFFECTS
from handcal_sim.profiles import Array
from handcal_sim.prove import (
    draw_budget,
    draw_odometry,
    draw_ordinary,
    draw_people,
    draw_phone,
    draw_strange,
    draw_wild,
)
from handcal_sim.prove.given import (
    Circumstances,
    Gain,
    Ticket,
    amplitude,
    amplitudes,
    answer,
    completed,
    generator,
    in_turn,
    log_uniform,
    simulated,
    some,
    with_streams,
)
from handcal_sim.prove.suites import (
    BESIDE,
    EARTH_GROUP,
    FAINT_NATS,
    IN_PART,
    LARGE,
    SIZES,
    WALKS,
    Answer,
)
from handcal_sim.scenario import World

Drawing = Callable[[Ticket, np.random.Generator], tuple[World, Answer]]


def draw(suite: str, number: int, seed: int, gain: Gain | None = None) -> tuple[World, Answer]:
    """Recording `number` of a suite. gain: for `faint`, the nats that an effect promises there."""
    ticket = Ticket(suite, number, seed, gain)
    world, drawn = _DRAWINGS[suite](ticket, generator(ticket))
    return world, drawn if drawn.baseline else completed(world, drawn)


def _several(most: int) -> Drawing:
    """As many effects as that at most."""

    def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
        given = circumstances(ticket.suite, rng)
        return _with(some(given, rng, most) if most else [], ticket, given, rng)

    return drawn


def _each(names: Sequence[str]) -> Drawing:
    """Every one of these effects in turn."""

    def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
        given = circumstances(ticket.suite, rng)
        return _with([in_turn(names, ticket)], ticket, given, rng)

    return drawn


def _in_part(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Every such effect in turn, all its parameters but one zero."""
    name = in_turn(list(IN_PART), ticket)
    given = with_streams(circumstances(ticket.suite, rng), [name], rng)
    values = amplitude(name, given, rng)
    one = int(rng.integers(len(values)))
    effects = {name: [v if k == one else 0.0 for k, v in enumerate(values)]}
    return simulated(given, effects), answer(ticket.suite, "", given, effects)


def _with(
    names: list[str], ticket: Ticket, given: Circumstances, rng: np.random.Generator
) -> tuple[World, Answer]:
    names = list(dict.fromkeys([*names, *(BESIDE[n] for n in names if n in BESIDE)]))
    given = with_streams(given, names, rng)
    effects = amplitudes(names, given, rng)
    group = EARTH_GROUP if "earth_rate" in names else ""
    return simulated(given, effects), answer(ticket.suite, group, given, effects)


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
        rate_hz=round(log_uniform(rng, 50.0, 400.0 if suite == "nothing" else 200.0)),
        sway=log_uniform(rng, 0.3, 2.5),
        noise=log_uniform(rng, 0.5, 2.0),
        heading_sigma_deg=log_uniform(rng, 1.0, 30.0 if suite == "nothing" else 12.0),
        heading_hz=round(log_uniform(rng, 10.0, 100.0)) if heading else 0.0,
        mag=mag, pose=bool(instead and chance[2] < 0.15), thermometer=bool(chance[3] < 0.35),
        warming_K=float(rng.uniform(2.0, 12.0)), seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _beside(
    scenario: str, duration: float, chance: Array, rng: np.random.Generator
) -> Circumstances:
    """A phone with a second IMU on its back, neither faster than 400 Hz, of other rates."""
    return Circumstances(
        scenario, round(duration, 1), rate_hz=round(log_uniform(rng, 50.0, 400.0)), sway=1.0,
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=1.0, heading_hz=0.0, mag=False,
        pose=False, thermometer=bool(chance[3] < 0.35), warming_K=float(rng.uniform(10.0, 18.0)),
        seed=int(rng.integers(2**62)), reference_hz=round(log_uniform(rng, 50.0, 400.0)),
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


def _unknown(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    given = circumstances(ticket.suite, rng)
    kind = in_turn(list(strangers.KINDS), ticket)
    if kind in strangers.NEEDS_TEMPERATURE:
        given = with_streams(given, ["accel_temperature"], rng)
    world, strange = strangers.estrange(kind, simulated(given, {}), rng)
    said = {"kind": kind, **strangers.said_of(strange)}
    return world, answer("unknown", "", given, {}, said)


def _large(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    given = circumstances(ticket.suite, rng)
    names = [str(name) for name in rng.choice(list(LARGE), rng.integers(1, 4), replace=False)]
    given = with_streams(given, names, rng)
    effects = {
        name: [float(rng.choice([-1.0, 1.0]) * rng.uniform(*LARGE[name])) for _ in EFFECTS[name]]
        for name in names
    }
    for late in {"heading_delay", "pose_delay"} & set(names):
        effects[late] = [abs(v) for v in effects[late]]
    return simulated(given, effects), answer("large", "", given, effects)


def _faint(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """One effect of any kind whose size promises so many nats in this recording."""
    given, number, gain = circumstances(ticket.suite, rng), ticket.number, ticket.gain
    if gain is None:
        raise ValueError("the suite 'faint' needs to know what an effect promises")
    nats = FAINT_NATS[number % len(FAINT_NATS)]
    names = [str(name) for name in rng.permutation([n for n in SIZES if n != "earth_rate"])]
    for name in names:
        there = with_streams(given, [name], rng)
        values = _scaled(name, amplitude(name, there, rng), nats, simulated(there, {}), gain)
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


_DRAWINGS: Mapping[str, Drawing] = {
    "nothing": _several(0),
    "one": _each(list(SIZES)),
    "mixed": _several(3),
    "unknown": _unknown,
    "turn": _each(list(SIZES)),
    "faint": _faint,
    "reference": _several(2),
    "large": _large,
    "phone": draw_phone.drawn,
    "odometry": draw_odometry.drawn,
    "people": draw_people.drawn,
    "budget": draw_budget.drawn,
    "wild": draw_wild.drawn,
    "strange": draw_strange.drawn,
    "axis": _in_part,
    "walks": _each(WALKS),
    "latest": draw_strange.drawn,
    "ordinary": draw_ordinary.drawn,
}

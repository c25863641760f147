"""The suite `people`: nothing is wrong with the sensors, but somebody does what people do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim import motion_people as do
from handcal_sim.companions import Passing
from handcal_sim.losses import paused
from handcal_sim.motion import Scenario, free_hand, three_turns
from handcal_sim.motion_phone import routine
from handcal_sim.phone import DEG, Phone
from handcal_sim.prove.given import Circumstances, Ticket, answer, log_uniform, simulated
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World


@dataclass(frozen=True)
class Doing:
    """act: what it does to the motion; base: the only motion it goes with; and what it does
    besides: iron passes, the app pauses, the hand trembles."""

    act: do.Act | None = None
    base: Scenario | None = None
    iron: bool = False
    pause: bool = False
    tremor: bool = False


DOINGS: Mapping[str, Doing] = {
    "steps aside": Doing(do.steps_aside),
    "lifts": Doing(do.lifts),
    "walks": Doing(do.walks),
    "bumps": Doing(do.bumps),
    "puts down": Doing(do.puts_down, free_hand),
    "drops slowly": Doing(do.drops_slowly),
    "passes iron": Doing(iron=True),
    "pauses": Doing(pause=True),
    "one axis": Doing(base=do.one_axis),
    "stops early": Doing(do.stops_early, free_hand),
    "trembles": Doing(tremor=True),
    "changes hands": Doing(do.changes_hands),
    "swivels": Doing(do.swivels),
    "rides a lift": Doing(do.rides_a_lift),
}
_BASES = (free_hand, three_turns, routine(quarters=True))
_SECOND = 0.3  # how often a second thing is done


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Each doing in turn, at times with another one that goes with any motion."""
    first = list(DOINGS)[ticket.number % len(DOINGS)]
    others = [k for k, doing in DOINGS.items() if doing.base is None and k != first]
    names = [first, *([str(rng.choice(others))] if rng.random() < _SECOND else [])]
    doings = [DOINGS[name] for name in names]
    given = _circumstances(rng)
    base = doings[0].base or _BASES[rng.choice(3, p=[0.5, 0.25, 0.25])]
    motion = do.people(base, [doing.act for doing in doings if doing.act is not None])
    iron = any(doing.iron for doing in doings)
    tremor = float(rng.uniform(4.0, 10.0)) if any(doing.tremor for doing in doings) else 1.0
    pause = (0.0, 0.0)
    if any(doing.pause for doing in doings):
        at = rng.uniform(0.2, 0.7) * given.duration_s
        pause = (at, at + log_uniform(rng, 0.3, 5.0))
    passing = _passing(given, rng)

    def refit(phone: Phone) -> Phone:
        return _beside_iron(phone, passing) if iron else phone

    world = simulated(given, {}, motion, refit, tremor)
    said = answer(ticket.suite, "", given, {})
    more = {"doings": names, "iron": iron, "tremor": tremor, "pause": list(pause)}
    return paused(world, *pause), replace(said, circumstances={**said.circumstances, **more})


def _circumstances(rng: np.random.Generator) -> Circumstances:
    mag = bool(rng.random() < 0.5)
    return Circumstances(
        "people", round(rng.uniform(25.0, 90.0), 1),
        rate_hz=round(log_uniform(rng, 50.0, 400.0)), sway=log_uniform(rng, 0.5, 2.0),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=log_uniform(rng, 1.0, 12.0),
        heading_hz=0.0 if mag else round(log_uniform(rng, 10.0, 100.0)), mag=mag, pose=False,
        thermometer=False, warming_K=0.0, seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _passing(given: Circumstances, rng: np.random.Generator) -> Passing:
    """15 to 50 deg of heading, or 10 to 40 uT from any side, for some seconds."""
    at, width = rng.uniform(0.25, 0.75) * given.duration_s, rng.uniform(1.0, 4.0)
    way = rng.standard_normal(3)
    field = rng.uniform(10e-6, 40e-6) * way / np.linalg.norm(way)
    angle = np.array([rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 50.0) * DEG])
    return Passing(float(at), float(width), field if given.mag else angle)


def _beside_iron(phone: Phone, passing: Passing) -> Phone:
    if phone.mag is not None:
        return replace(phone, mag=replace(phone.mag, passing=passing))
    assert phone.heading is not None
    return replace(phone, heading=replace(phone.heading, passing=passing))

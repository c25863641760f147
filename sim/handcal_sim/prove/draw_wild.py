"""The suite `wild`: none to three effects in motion that is anything but careful."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handcal_sim.motion_wild import wild
from handcal_sim.prove.given import (
    Circumstances,
    Ticket,
    amplitudes,
    answer,
    log_uniform,
    simulated,
    some,
    with_streams,
)
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World

MOST = 3


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """As many effects as `mixed` has, of the same sizes."""
    given = _circumstances(rng)
    quick = log_uniform(rng, 3.0, 7.0)
    names = some(given, rng, MOST)
    given = with_streams(given, names, rng)
    effects = amplitudes(names, given, rng)
    said = answer(ticket.suite, "", given, effects)
    said = replace(said, circumstances={**said.circumstances, "rate_rad_s": quick})
    return simulated(given, effects, wild(quick)), said


def _circumstances(rng: np.random.Generator) -> Circumstances:
    chance = rng.random(4)
    mag = bool(chance[0] < 0.12)
    heading = not (mag or chance[1] < 0.06)
    return Circumstances(
        "wild", round(rng.uniform(30.0, 90.0), 1),
        rate_hz=round(log_uniform(rng, 80.0, 400.0)), sway=log_uniform(rng, 0.3, 1.5),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=log_uniform(rng, 1.0, 12.0),
        heading_hz=round(log_uniform(rng, 10.0, 100.0)) if heading else 0.0, mag=mag,
        pose=bool(chance[2] < 0.15), thermometer=bool(chance[3] < 0.35),
        warming_K=float(rng.uniform(2.0, 12.0)), seed=int(rng.integers(2**62)),
    )  # fmt: skip

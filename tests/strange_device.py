"""Recordings of one simulated device that errs by a law which no catalogue has."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from worlds import recording_of

from handcal.types import Recording
from handcal_sim import simulate, strangers
from handcal_sim.phone import Clocking, Phone, consumer_phone, with_rate
from handcal_sim.scenario import World


def phone_of(device: int) -> Phone:
    """A consumer's phone that reads fifty times a second, its heading ten times."""
    phone = with_rate(consumer_phone(np.random.default_rng(device)), 50.0)
    return dataclasses.replace(
        phone, heading=dataclasses.replace(phone.heading, clocking=Clocking(10.0))
    )


def turned(device: int, motions: Sequence[int], duration_s: float) -> list[World]:
    """The device in a hand, another motion each time."""
    return [
        simulate("free-hand", seed=m, phone=lambda _: phone_of(device), duration_s=duration_s)
        for m in motions
    ]


def errs_by(
    kind: str, worlds: Sequence[World], device: int
) -> list[tuple[Recording, strangers.Strange]]:
    """The recordings of these worlds with the law in them, and what it adds."""
    return [
        (dataclasses.replace(recording_of(world, "heading"), path=f"{kind}-{number}.mcap"), strange)
        for number, (world, strange) in enumerate(strangers.of_one_device(kind, worlds, device))
    ]

"""The suite `odometry`: a phone carried freely beside its own camera's estimate of the pose."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from handcal_sim.companions import Clocking
from handcal_sim.motion_carried import carried, strolled, way_of
from handcal_sim.phone import DEG, Phone
from handcal_sim.prove.given import Circumstances, Ticket, answer, log_uniform, simulated
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World

Effects = dict[str, list[float]]


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Every other number has a perfect tracker: nothing but its noise."""
    perfect = ticket.number % 2 == 1
    given = _circumstances(rng)
    path = strolled(given.duration_s, log_uniform(rng, 0.5, 2.5), rng)
    way = way_of(path, given.duration_s)
    motion = carried(path, rng.uniform(0.5, 1.3))
    tracking = _tracking(given, perfect, rng)
    effects = ({} if perfect else _odometry(way, given.duration_s, rng)) | _marker(rng)

    def refit(phone: Phone) -> Phone:
        assert phone.pose is not None
        return replace(phone, pose=replace(phone.pose, **tracking))

    said = answer(ticket.suite, "", given, effects)
    more = {"perfect": perfect, "way_m": way, "pose_hz": tracking["clocking"].rate_hz,
            "lost_for_s": tracking["lost_for_s"], "jump": tracking["jump"].tolist()}  # fmt: skip
    return simulated(given, effects, motion, refit), replace(
        said, circumstances={**said.circumstances, **more}
    )


def _circumstances(rng: np.random.Generator) -> Circumstances:
    return Circumstances(
        "carried", round(rng.uniform(30.0, 120.0), 1),
        rate_hz=round(log_uniform(rng, 50.0, 400.0)), sway=log_uniform(rng, 0.5, 2.0),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=0.0, heading_hz=0.0, mag=False,
        pose=True, thermometer=False, warming_K=0.0, seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _tracking(given: Circumstances, perfect: bool, rng: np.random.Generator) -> dict[str, Any]:
    """Noise and rate; in a third, tracking is lost for about a second, half of that with a jump
    of some cm after it where the tracker is not perfect."""
    hz = round(rng.uniform(30.0, 60.0))
    lost = rng.random() < 1.0 / 3.0
    jump = rng.normal(0.0, 0.02, 3) * (lost and not perfect and rng.random() < 0.5)
    return {
        "sigma_m": log_uniform(rng, 0.5e-3, 3e-3),
        "sigma_rad": log_uniform(rng, 0.05, 0.2) * DEG,
        "clocking": Clocking(hz, float(rng.random()) / hz),
        "by_way": True,
        "lost_at_s": float(rng.uniform(0.2, 0.8)) * given.duration_s,
        "lost_for_s": float(rng.uniform(0.7, 1.5)) if lost else 0.0,
        "jump": jump,
    }


def _odometry(way: float, duration: float, rng: np.random.Generator) -> Effects:
    """Drift of 0.5 to 2 % of the way and of 0.2 to 1 deg a minute (each axis), a metre that is off
    by up to 2 %, and in half of them a delay of up to 30 ms."""
    lost = log_uniform(rng, 0.005, 0.02) * way
    turned = log_uniform(rng, 0.2, 1.0) * DEG
    effects = {
        "pose_drift": [lost / math.sqrt(3.0 * duration), turned / math.sqrt(60.0)],
        "pose_scale": [float(rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.02))],
    }
    if rng.random() < 0.5:
        effects["pose_delay"] = [float(rng.uniform(0.005, 0.03))]
    return effects


def _marker(rng: np.random.Generator) -> Effects:
    """In half of them the pose is that of the camera, 2 to 12 cm from the IMU."""
    way = rng.standard_normal(3)
    arm = rng.uniform(0.02, 0.12) * way / np.linalg.norm(way)
    return {"lever_arm": arm.tolist()} if rng.random() < 0.5 else {}

"""The worlds of a sweep: the device of paper 002 with other errors, and the noise of one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from handcal_sim.companions import Clocking, Heading
from handcal_sim.motion import Start
from handcal_sim.phone import DEG, DEG_PER_HOUR, MG, paper_phone, with_rate
from handcal_sim.profiles import Array
from handcal_sim.scenario import World as Simulated
from handcal_sim.scenario import simulate
from handcal_sim.sweep.grid import Cell, World

_SAME_MOTION = ("z-turn", "three-turns", "static")
_RANDOM_EFFECTS = {"gyro_bias_walk", "accel_bias_walk", "heading_correlated_noise",
                   "heading_outliers"}  # fmt: skip


def same_for_all(world: World) -> bool:
    """Every seed has the same truth: nothing but white noise is drawn."""
    random = _RANDOM_EFFECTS & {name for name, _ in world.effects}
    return world.sway == 0.0 and world.scenario in _SAME_MOTION and not random


def simulated(world: World, rng: np.random.Generator) -> Simulated:
    """What the device would record without white noise."""
    phone = with_rate(paper_phone(), world.rate_hz)
    bias = {"gyro": np.array(world.gyro_bias_deg_h) * DEG_PER_HOUR,
            "accel": np.array(world.accel_bias_mg) * MG}  # fmt: skip
    phone = replace(
        phone,
        gyro=replace(phone.gyro, bias=bias["gyro"], noise=0.0),
        accel=replace(phone.accel, bias=bias["accel"], noise=0.0, response=np.zeros((3, 3))),
        heading=Heading(0.0, Clocking(world.heading_rate_hz)),
    )
    return simulate(
        world.scenario, seed=rng, phone=phone, effects=dict(world.effects),
        duration_s=world.duration_s, start=Start(), sway=world.sway,
    )  # fmt: skip


def injected(world: Simulated) -> Mapping[tuple[str, str], float]:
    """True values, SI, by effect and name of the parameter."""
    effects = world.parameters["effects"]
    return {(e, p["name"]): p["value"] for e, parameters in effects.items() for p in parameters}


def noise(
    world: World, samples: int, headings: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """White noise of the readings (samples, 6) in rad/s and m/s^2, of headings (headings,) rad."""
    gyro, accel = densities(world)
    sigma = np.repeat([gyro, accel], 3) * np.sqrt(world.rate_hz)
    heading = world.heading_sigma_deg * DEG
    readings = sigma * rng.standard_normal((samples, 6))
    return readings, heading * rng.standard_normal(headings)


def densities(world: World) -> tuple[float, float]:
    """Noise of gyro and accelerometer, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz)."""
    return world.arw * DEG, world.vrw * 1e-3 * MG


def angle_sigma(sigma: float) -> float:
    """Sigma (rad) of the Gaussian that tells as much as an angle with this noise does.

    A heading is known up to whole turns: its noise is a wrapped normal distribution, whose
    Fisher information is below 1 / sigma^2 (by 8 % at 60 deg, by nothing at 30).
    """
    x = np.linspace(-np.pi, np.pi, 4001)
    turns = 2.0 * np.pi * np.arange(-8, 9)[:, None]
    density = np.exp(-0.5 * ((x + turns) / sigma) ** 2)
    slope = -((x + turns) / sigma**2 * density).sum(axis=0)
    p = density.sum(axis=0)
    seen = p > 0.0
    information = np.trapezoid(np.where(seen, slope**2 / np.where(seen, p, 1.0), 0.0), x)
    return float(np.sqrt(np.trapezoid(p, x) / information))


def common(cell: Cell) -> Cell:
    """What cells have in common that differ in nothing but R_h: a scene and a bound."""
    return replace(
        cell, r_h_rad=None, draw_start=False, settle=False, group="", printed=None, figures=None
    )

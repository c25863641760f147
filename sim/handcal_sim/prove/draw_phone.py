"""The suite `phone`: phones in hands with a raw magnetometer, and the motions that people make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim import motion_phone
from handcal_sim.companions import Clocking
from handcal_sim.effects import EFFECTS
from handcal_sim.motion import Scenario
from handcal_sim.phone import DEG, Phone
from handcal_sim.profiles import Array
from handcal_sim.prove.given import Circumstances, Ticket, answer, log_uniform, simulated
from handcal_sim.prove.suites import Answer
from handcal_sim.scenario import World

# One standard deviation of errors that a phone's own calibration leaves; parameters alike.
SMALL = {"gyro_scale": 0.005, "gyro_misalignment": 0.005, "accel_scale": 0.005,
         "accel_misalignment": 0.005, "gyro_g_sensitivity": 1.8e-4}  # fmt: skip


@dataclass(frozen=True)
class Habit:
    """A motion, and how far the phone is from the joint that it goes about, m (0 to 0: the phone's
    own middle)."""

    name: str
    motion: Callable[[np.random.Generator], Scenario]
    reach_m: tuple[float, float]


HABITS = (
    Habit("swings at arm's length", lambda rng: motion_phone.swings(
        rng.uniform(25.0, 50.0) * DEG, rng.uniform(0.35, 0.8)), (0.45, 0.7)),
    Habit("swings from the wrist", lambda rng: motion_phone.swings(
        rng.uniform(30.0, 60.0) * DEG, rng.uniform(0.6, 1.4)), (0.05, 0.15)),
    Habit("full turns", lambda _: motion_phone.routine(quarters=False), (0.0, 0.0)),
    Habit("quarter turns", lambda _: motion_phone.routine(quarters=True), (0.0, 0.0)),
    Habit("figure of eight from the elbow", lambda rng: motion_phone.figure_of_eight(
        rng.uniform(40.0, 70.0) * DEG, rng.uniform(0.3, 0.6)), (0.25, 0.4)),
    Habit("figure of eight from the wrist", lambda rng: motion_phone.figure_of_eight(
        rng.uniform(40.0, 80.0) * DEG, rng.uniform(0.4, 0.8)), (0.05, 0.15)),
)  # fmt: skip


def drawn(ticket: Ticket, rng: np.random.Generator) -> tuple[World, Answer]:
    """Every habit in turn."""
    habit = HABITS[ticket.number % len(HABITS)]
    given = _circumstances(habit, rng)
    motion, mag_hz = habit.motion(rng), round(log_uniform(rng, 10.0, 100.0))
    varies = _symmetric(rng, log_uniform(rng, 14e-6, 28e-6)), rng.random() < 1.0 / 3.0
    effects = _iron(rng) | _of_the_imu(habit, rng)
    if varies[1]:
        effects["mag_gradient"] = varies[0][[0, 1, 0, 0, 1], [0, 1, 1, 2, 2]].tolist()
    said = answer(ticket.suite, "", given, effects)
    return simulated(given, effects, motion, _reads_mag(mag_hz)), replace(
        said, circumstances={**said.circumstances, "mag_hz": mag_hz}
    )


def again(ticket: Ticket, answer: Answer, rng: np.random.Generator) -> World:
    """Another recording of the same phone: the next habit, another hand, another room."""
    habit = HABITS[(ticket.number + 1) % len(HABITS)]
    given = _circumstances(habit, rng)
    motion = habit.motion(rng)
    effects = {name: list(values.values()) for name, values in answer.effects.items()}
    effects.pop("mag_gradient", None)
    if habit.reach_m[1] > 0.0:
        effects["lever_arm"] = list(motion_phone.joint_to_phone(rng.uniform(*habit.reach_m), rng))
    return simulated(given, effects, motion, _reads_mag(answer.circumstances["mag_hz"]))


def _reads_mag(mag_hz: float) -> Callable[[Phone], Phone]:
    """The phone with a magnetometer of that rate."""

    def refit(phone: Phone) -> Phone:
        assert phone.mag is not None
        clocking = Clocking(mag_hz, phone.mag.clocking.phase_s)
        return replace(phone, mag=replace(phone.mag, clocking=clocking))

    return refit


def _circumstances(habit: Habit, rng: np.random.Generator) -> Circumstances:
    return Circumstances(
        habit.name, round(log_uniform(rng, 20.0, 120.0), 1),
        rate_hz=round(log_uniform(rng, 53.0, 400.0)), sway=log_uniform(rng, 0.3, 2.0),
        noise=log_uniform(rng, 0.5, 2.0), heading_sigma_deg=0.0, heading_hz=0.0, mag=True,
        pose=False, thermometer=False, warming_K=0.0, seed=int(rng.integers(2**62)),
    )  # fmt: skip


def _iron(rng: np.random.Generator) -> dict[str, list[float]]:
    """Iron in the phone, and a magnetometer that is late."""
    way = rng.standard_normal(3)
    hard = log_uniform(rng, 30e-6, 300e-6) * way / np.linalg.norm(way)
    soft = _symmetric(rng, log_uniform(rng, 0.02, 0.15))
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return {"mag_hard_iron": hard.tolist(), "mag_soft_iron": soft[rows, columns].tolist(),
            "heading_delay": [log_uniform(rng, 0.02, 0.15)]}  # fmt: skip


def _symmetric(rng: np.random.Generator, size: float) -> Array:
    """(3, 3), symmetric, without trace; `size` is what it does at the most to a unit vector."""
    S = rng.standard_normal((3, 3))
    S = S + S.T - 2.0 / 3.0 * np.trace(S) * np.eye(3)
    scaled: Array = S * size / np.abs(np.linalg.eigvalsh(S)).max()
    return scaled


def _of_the_imu(habit: Habit, rng: np.random.Generator) -> dict[str, list[float]]:
    """None, one or two small errors; the way from the joint, or for turns about the phone's own
    middle in half of those with errors an IMU that is 3 to 15 cm from it."""
    count = int(rng.integers(3))
    effects = {
        str(name): (SMALL[str(name)] * rng.choice([-1.0, 1.0], size) * rng.uniform(0.5, 1.5, size))
        for name in rng.choice(list(SMALL), count, replace=False)
        for size in [len(EFFECTS[str(name)])]
    }
    if habit.reach_m[1] > 0.0:
        effects["lever_arm"] = motion_phone.joint_to_phone(rng.uniform(*habit.reach_m), rng)
    elif count and rng.random() < 0.5:
        effects.pop(next(iter(effects)))
        way = rng.standard_normal(3)
        effects["lever_arm"] = rng.uniform(0.03, 0.15) * way / np.linalg.norm(way)
    return {name: values.tolist() for name, values in effects.items()}

"""Simulated worlds handed to handcal in memory, and small helpers of the core's tests."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from handcal.earth import local_earth
from handcal.effects import Effect, select
from handcal.estimate.assemble import build
from handcal.estimate.model import Model
from handcal.estimate.problem import Problem
from handcal.estimate.start import Start, from_pose, from_rest
from handcal.model_score import prior
from handcal.observations import Scene, catalogue
from handcal.search.budget import Budget
from handcal.search.climb import Climb, Made, climbed
from handcal.search.response import response
from handcal.search.select import Priors, chosen
from handcal.search.select_laws import courses_on, groups_of, laws_of
from handcal.types import Imu, Recording, Series
from handcal_sim.phone import Clocking, Phone, consumer_phone, with_rate
from handcal_sim.scenario import World


def slow(rng: np.random.Generator) -> Phone:
    """A consumer's phone that reads fifty times a second, its heading ten times."""
    phone = with_rate(consumer_phone(rng), 50.0)
    assert phone.heading is not None
    return replace(phone, heading=replace(phone.heading, clocking=Clocking(10.0)))


def recording_of(world: World, *streams: str) -> Recording:
    """What the reader would make of the world's file, with only the streams named."""
    imu = Imu(
        world.imu.stamps,
        np.ascontiguousarray(world.imu.values[:, :3]),
        np.ascontiguousarray(world.imu.values[:, 3:]),
        np.ones(len(world.imu.stamps), dtype=bool),
    )
    found = {}
    for name in streams:
        stream = world.streams[name]
        value = np.asarray(stream.values, dtype=float)
        if name == "pose":
            # the simulator's quaternions are x y z w, as in ROS; handcal's are w x y z
            value = value[:, [0, 1, 2, 6, 3, 4, 5]]
        found[name] = Series(np.asarray(stream.stamps), np.ascontiguousarray(value))
    return Recording("simulated", imu, found)


def injected(world: World, effect: str) -> np.ndarray:
    """True values of an effect's parameters, in order."""
    return np.array([p["value"] for p in world.parameters["effects"][effect]])


def true_levels(world: World) -> dict[str, float]:
    """Noise levels as the simulator applied them, under handcal's names.

    Sway: the simulator's spectrum falls as 1 / (1 + (f / 0.4 Hz)^2)^2, that of a critically
    damped oscillator of that frequency. Tremor (8 to 12 Hz) is white to the eye of 20 Hz.
    Pose noise of motion capture includes a distortion that the simulator does not have.
    """
    phone, hand = world.parameters["phone"], world.parameters["hand"]
    rate = phone["rate_hz"]

    def density(sensor: dict) -> float:
        # white noise and the rounding of the converter (uniform)
        return float(np.hypot(sensor["noise"], sensor["quantum"] / np.sqrt(12.0 * rate)))

    levels = {
        "gyro_noise": max(density(phone["gyro"]), 1e-6),
        "accel_noise": max(density(phone["accel"]), 1e-5),
        "position_noise": max(hand["tremor_m"], 2e-5),
        "sway": max(hand["sway_m"], 1e-4),
        "sway_per_rate": max(hand["sway_per_rate_m"], 1e-4),
        "sway_time": 1.0 / (2.0 * np.pi * 0.4),
    }
    if phone["heading"] is not None:
        levels["heading_noise"] = max(phone["heading"]["sigma"], 1e-4)
    if phone["mag"] is not None:
        mag = phone["mag"]
        levels["mag_noise"] = max(mag["sigma"], 2e-8)
        levels["mag_disturbance"] = 5e-8
    if phone["pose"] is not None:
        levels["pose_position_noise"] = phone["pose"]["sigma_m"]
        levels["pose_attitude_noise"] = phone["pose"]["sigma_rad"]
        levels["pose_position_distortion"] = 2e-5
        levels["pose_attitude_distortion"] = 1e-4
    return levels


def problem_of(
    recording: Recording,
    effects: Sequence[str] = (),
    kinds: Sequence[str] = ("fixed_position", "heading"),
    rests: np.ndarray | None = None,
    latitude: float | None = None,
) -> tuple[Problem, Start]:
    """A problem with just these observations, and a start levelled on the first readings."""
    rests = np.zeros((0, 2)) if rests is None else rests
    scene = Scene(rests, "heading" in kinds or "magnetometer" in kinds)
    yaw = 0.0
    if "heading" in kinds:
        yaw = float(recording.streams["heading"].value[0, 0])
    start = from_rest(recording, yaw, 0.5 if scene.has_heading else 1e-6, rests)
    observed = []
    for kind in kinds:
        observation = catalogue()[kind]
        rows = observation.rows(recording, scene)
        assert rows is not None
        constants = tuple((c.name, c.unit, c.prior_sigma) for c in observation.constants(scene))
        observed.append((observation, rows, constants))
        if kind == "pose":
            start = from_pose(rows.t, rows.z)
    return build(recording, select(effects), observed, *local_earth(latitude)), start


def part_of(recording: Recording, begin: float, end: float) -> Recording:
    """The recording from begin to end, s, with its time kept."""
    imu = recording.imu
    keep = (imu.t >= begin) & (imu.t <= end)
    cut = Imu(imu.t[keep], imu.gyro[keep], imu.accel[keep], imu.valid[keep])
    streams = {}
    for name, series in recording.streams.items():
        k = (series.t >= begin) & (series.t <= end)
        streams[name] = Series(series.t[k], series.value[k])
    return Recording(recording.path, cut, streams)


def climbed_from(model: Model, kept: Collection[str]) -> Model:
    """The end of a climb from a model, with effects that are kept whatever they gain."""
    c = Climb(frozenset(kept), frozenset(), Budget(), Made())
    return climbed(c, model, lambda *_: None)


def likeliest_laws(model: Model) -> list[Effect]:
    """Laws beside a model without noise by its matrix, in groups by sensor, the best one first."""
    r = response(model)
    odds = partial(prior, cases=[f.case for f in model.parts])
    priors = Priors(odds, always=model.chosen)
    choice = chosen(r, priors, model.chosen, {})
    found = [
        list(groups_of(laws_of(r, priors, choice, sensor, courses)))
        for sensor, courses in courses_on(r.windows).items()
    ]
    ranked = sorted((groups for groups in found if groups), key=lambda groups: -groups[0][0].score)
    return [law.effect for groups in ranked for group in groups for law in group]

"""A fleet of simulated devices of four models, whose truth is known.

Of each device several recordings, days apart and at other temperatures. *plain*: errors spread as
in a datasheet; *tails*: the same with a tail (Student's t with 4 degrees of freedom); *law*:
every gyro axis has a cubic error, about two sigma of one recording; *warm*: the gyro's bias goes
with the temperature, alike in all of its devices. (*fine*, a fleet of its own: *plain* with smaller
spreads.) One device in twenty is odd, in one of several
ways, one file in fifty is broken, one in a hundred stands under the name of another device.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim import simulate
from handcal_sim.mcap_writer import write
from handcal_sim.phone import DEG, Phone, consumer_phone
from handcal_sim.profiles import Array
from handcal_sim.scenario import Stream, World
from handcal_sim.strangers import scene_of

MODELS = ("plain", "tails", "law", "warm")
# A model of its own, as its maker calibrated it: a quarter of the others' spreads.
FINE, FINER = "fine", 0.25
GRAVITY = 9.80665  # m/s^2, of an accelerometer that counts in g
# What makes a device odd, one after the other: an axis that reads so much too much, one that is so
# far from where it should be (rad), and what is done to its readings before they are written.
LARGE = {"gyro_scale": 0.06, "gyro_misalignment": 4.0 * DEG, "accel_scale": 0.04}
SPOILT: Mapping[str, Callable[[Array], Array]] = {
    "gyro y reversed": lambda v: v * [1.0, -1.0, 1.0, 1.0, 1.0, 1.0],
    "accelerometer x and y exchanged": lambda v: v[:, [0, 1, 2, 4, 3, 5]],
    "accelerometer in g": lambda v: v / [1.0, 1.0, 1.0, GRAVITY, GRAVITY, GRAVITY],
}
ODD_WAYS = (*LARGE, *SPOILT)
# Standard deviations of the true errors of the devices of every model, by effect.
SPREADS = {"gyro_scale": 0.005, "gyro_misalignment": 0.3 * DEG, "accel_scale": 0.004,
           "accel_misalignment": 0.3 * DEG}  # fmt: skip
DOF = 4.0
# Of the cubic law, s^2/rad^2: mean and spread over the devices.
CUBE, CUBE_SPREAD = 2.4e-4, 0.24e-4
# Of the gyro's bias, (rad/s)/K, in *warm*; standard deviation from one switching on to the next.
SLOPE, TURN_ON = 0.02 * DEG, 0.03 * DEG
ODD_SHARE, BROKEN_SHARE, MISLABELLED_SHARE = 0.05, 0.02, 0.01
# A recording: length, s, and how the hand turns the device.
SECONDS, SCENARIO = 20.0, "free-hand"
# Recordings of one device, and devices of a model at the fewest: of less there is no population.
EACH, FEWEST = 10, 5
BEGINNING = datetime(2026, 1, 5, 9, 0, tzinfo=UTC)


@dataclass(frozen=True)
class Device:
    """effects: its true errors by id; law: the constant of the cubic; slope: of the gyro's bias by
    temperature; bias: of the gyro at 25 degC (3,); odd: whether one axis is far off."""

    name: str
    model: str
    effects: Mapping[str, Array]
    law: float
    slope: float
    bias: Array
    odd: str


def spread_of(model: str, effect: str) -> float:
    """Scale of the density that true errors of a model's devices are drawn from."""
    return SPREADS[effect] * (FINER if model == FINE else 1.0)


def devices(count: int, rng: np.random.Generator, models: Sequence[str] = MODELS) -> list[Device]:
    """As many devices, of each model in turn."""
    strange = rng.permutation(count)[: max(1, round(ODD_SHARE * count))].tolist()
    odd = {n: ODD_WAYS[i % len(ODD_WAYS)] for i, n in enumerate(strange)}
    sizes = {"gyro_scale": 3, "gyro_misalignment": 6, "accel_scale": 3, "accel_misalignment": 3}
    out = []
    for n in range(count):
        model = models[n % len(models)]
        draw: Callable[[int], Array] = rng.standard_normal
        if model == "tails":
            draw = lambda k: rng.standard_t(DOF, k)  # noqa: E731
        effects = {e: spread_of(model, e) * draw(k) for e, k in sizes.items()}
        way = odd.get(n, "")
        if way in LARGE:
            effects[way][int(rng.integers(3))] += LARGE[way]
        law = rng.normal(CUBE, CUBE_SPREAD) if model == "law" else 0.0
        bias = rng.normal(0.0, 0.3 * DEG, 3)
        slope = SLOPE if model == "warm" else 0.0
        out.append(Device(f"{model}-{n:03d}", model, effects, float(law), slope, bias, way))
    return out


def recorded(
    device: Device, seed: int, seconds: float = SECONDS, scenario: str = SCENARIO
) -> World:
    """One recording of a device, at a temperature of its own."""
    rng = np.random.default_rng(seed)
    warm = float(rng.uniform(10.0, 35.0))
    bias = device.bias + device.slope * (warm - 25.0) + TURN_ON * rng.standard_normal(3)

    def phone(own: np.random.Generator) -> Phone:
        made = consumer_phone(own)
        return replace(
            made, gyro=replace(made.gyro, bias=bias),
            thermometer=replace(made.thermometer, start=warm, rise=0.0, reported=True),
        )  # fmt: skip

    effects = {k: v.tolist() for k, v in device.effects.items()}
    world = simulate(scenario, seed=seed, phone=phone, duration_s=seconds, effects=effects)
    values = world.imu.values.copy()
    values[:, :3] += device.law * scene_of(world).omega ** 3
    return replace(world, imu=Stream(world.imu.stamps, SPOILT.get(device.odd, np.array)(values)))


def written(n: int, seed: int, folder: Path, models: Sequence[str] = MODELS) -> dict[str, Any]:
    """n recordings and a manifest in a folder, and what is true of them."""
    rng = np.random.default_rng(seed)
    made = devices(max(FEWEST * len(models), n // EACH), rng, models)
    order = rng.permutation(n)
    broken = set(order[: max(1, round(BROKEN_SHARE * n))].tolist())
    elsewhere = set(order[len(broken) :][: round(MISLABELLED_SHARE * n)].tolist())
    rows, mislabelled = [], {}
    for i in range(n):
        device = made[i % len(made)]
        world = recorded(device, int(rng.integers(2**62)))
        path = folder / f"r{i:04d}.mcap"
        write(world, path, truth=False)
        if i in broken:
            path.write_bytes(path.read_bytes()[:100])
        days = 20.0 * (i // len(made)) + float(rng.uniform(0.0, 10.0))
        started = BEGINNING + timedelta(days=days)
        said = device
        if i in elsewhere:
            said = made[(i + len(models)) % len(made)]  # (the next one of its model)
            mislabelled[path.name] = [said.name, device.name]
        rows.append((path.name, said.name, said.model, started.isoformat(timespec="seconds")))
    with (folder / "manifest.txt").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("path", "device", "model", "started"), *rows])
    return {
        "recordings": n, "broken": sorted(f"r{i:04d}.mcap" for i in broken),
        "devices": [d.name for d in made], "odd": {d.name: d.odd for d in made if d.odd},
        "mislabelled": mislabelled,
    }  # fmt: skip

"""A motion, a hand and a device together: what was true and what was read."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim import aiding, hand, lab, sensors
from handcal_sim import effects as catalogue
from handcal_sim.companions import Clocking, Pose
from handcal_sim.errors import SimulationError, UnknownWord
from handcal_sim.hand import Hand
from handcal_sim.motion import SCENARIOS, Motion, Scenario, Start, build, random_start
from handcal_sim.phone import Phone, consumer_phone
from handcal_sim.profiles import Array
from handcal_sim.sensors import ASSUMED, Earth, ImuReadings, Truth

# Each part draws from a generator of its own: changing one leaves the others' draws alone,
# so that two worlds of one seed differ by nothing but what was asked for.
_PARTS = (
    "device", "start", "motion", "hand", "clock", "gyro", "accel", "gyro_walk", "accel_walk",
    "heading", "mag", "temperature", "pose", "reference",
)  # fmt: skip


@dataclass(frozen=True)
class Stream:
    """stamps (n,) s since the start on the stream's own clock; values (n, d)."""

    stamps: Array
    values: Array


@dataclass(frozen=True)
class World:
    """A simulated recording.

    imu: gyro and accelerometer readings (n, 6). streams: heading (n, 1), mag (n, 3),
    temperature (n, 1), pose (n, 7: position, quaternion x y z w), reference (n, 6).
    t: (n,) true instants of the IMU samples; truth: the IMU's place at those.
    parameters: everything that was injected, ready for JSON; a walking bias begins at its
    value under `effects` and has the mean of that plus `mean_walk`.
    """

    imu: Stream
    streams: Mapping[str, Stream]
    t: Array
    truth: Truth
    parameters: Mapping[str, Any]


def simulate(
    scenario: str | Scenario = "z-turn",
    *,
    seed: int | np.random.Generator = 0,
    phone: Phone | Callable[[np.random.Generator], Phone] = consumer_phone,
    effects: Mapping[str, Sequence[float]] | None = None,
    duration_s: float | None = None,
    start: Start | Callable[[np.random.Generator], Start] = random_start,
    sway: float = 1.0,
    creep: float = 0.0,
    tremor: float = 1.0,
    earth: Earth = ASSUMED,
    equipment: lab.Equipment | None = None,
) -> World:
    """What a device records in a hand, or on laboratory equipment.

    scenario: a name, or what makes the motion from its length, its start and a generator.
    phone and start: given, or drawn by a function of a generator. effects: by id, values in
    the order of its parameters; they replace the phone's. sway: 0 holds perfectly still,
    1 is usual. creep: by how much the arm drifts slowly, m. tremor: times as much as usual.
    equipment: errors and rate of a laboratory set-up. SimulationError on what cannot be.
    """
    if not 0.0 <= sway < math.inf:
        raise SimulationError(f"sway {sway:g} is not a factor of 0 or more")
    rngs = _generators(seed)
    device = phone(rngs["device"]) if callable(phone) else phone
    setup = catalogue.apply(catalogue.Setup(device, earth), effects or {})
    began = start(rngs["start"]) if callable(start) else start
    motion = _motion(scenario, duration_s, began, equipment, rngs["motion"])
    holder = hand.somebodys(rngs["hand"], sway, tremor, creep)
    if motion.knots:
        chamber = replace(setup.phone.thermometer, knots=motion.knots, reported=True)
        setup = replace(setup, phone=replace(setup.phone, thermometer=chamber))
    if sway > 0.0 and motion.commanded is None:
        motion = hand.in_hand(motion, holder, rngs["hand"])
    device, earth = setup.phone, setup.earth
    stamps, t = _instants(device, motion.duration_s, rngs["clock"])
    truth = sensors.truth_at(motion, earth, device.lever_arm, t)
    read = sensors.read_imu(device, motion, earth, t, truth, rngs)
    streams = _streams(device, motion, earth, (stamps, t), rngs)
    parameters = _parameters(setup, motion, began, holder, read, effects or {})
    imu = Stream(stamps, np.hstack([read.gyro, read.accel]))
    return World(imu, streams, t, truth, parameters)


def _motion(
    name: str | Scenario,
    duration_s: float | None,
    start: Start,
    equipment: lab.Equipment | None,
    rng: np.random.Generator,
) -> Motion:
    """The scenario of that name; SimulationError says which there are."""
    if callable(name):
        if duration_s is None:
            raise SimulationError("a motion without a name needs a duration")
        return name(duration_s, start, rng)
    if name in lab.SETUPS:
        return lab.build(name, duration_s, start, equipment or lab.Equipment(), rng)
    if equipment is not None:
        raise SimulationError(f"{name} is done by hand: {', '.join(lab.SETUPS)} have equipment")
    if name not in SCENARIOS:
        raise UnknownWord("scenario", name, (*SCENARIOS, *lab.SETUPS))
    return build(name, duration_s, start, rng)


def _generators(seed: int | np.random.Generator) -> dict[str, np.random.Generator]:
    root = np.random.default_rng(seed)
    return dict(zip(_PARTS, root.spawn(len(_PARTS)), strict=True))


def _instants(phone: Phone, duration: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Stamps and true instants of the IMU's samples, s."""
    regular = np.arange(math.floor(duration * phone.rate_hz + 1e-9) + 1) / phone.rate_hz
    jitter, wrong = rng.standard_normal((2, len(regular)))
    # A fifth of the interval at the most, so that stamps stay in order.
    most = 0.2 / phone.rate_hz
    own = regular + np.clip(phone.interval_jitter_s * jitter, -most, most)
    stamps = np.maximum(own + np.clip(phone.stamp_jitter_s * wrong, -most, most), 0.0)
    return stamps, own / (1.0 + 1e-6 * phone.clock_ppm)


def _streams(
    phone: Phone,
    motion: Motion,
    earth: Earth,
    imu: tuple[Array, Array],
    rngs: dict[str, np.random.Generator],
) -> dict[str, Stream]:
    """Whatever else this device reports. Pose and reference have the true clock."""
    fast = 1.0 + 1e-6 * phone.clock_ppm

    def on_device(clocking: Clocking) -> tuple[Array, Array]:
        if clocking.rate_hz == 0.0:
            return imu
        stamps = _regular(clocking, motion.duration_s)
        return stamps, stamps / fast

    streams = {}
    if phone.heading is not None:
        stamps, t = on_device(phone.heading.clocking)
        read = aiding.read_heading(phone.heading, phone.heading_errors, motion, t, rngs["heading"])
        streams["heading"] = Stream(stamps, read)
    if phone.mag is not None:
        stamps, t = on_device(phone.mag.clocking)
        # Without a heading sensor, errors of heading are those of the magnetometer.
        of_mag = phone.heading_errors if phone.heading is None else None
        read = aiding.read_mag(phone.mag, of_mag, motion, phone.lever_arm, t, rngs["mag"])
        streams["mag"] = Stream(stamps, read)
    if phone.thermometer.reported or _warms(phone):
        stamps, t = on_device(phone.thermometer.clocking)
        true = sensors.temperature(phone.thermometer, t)
        noise = phone.thermometer.sigma * rngs["temperature"].standard_normal(len(t))
        streams["temperature"] = Stream(stamps, (true + noise)[:, None])
    if phone.pose is not None:
        streams["pose"] = _tracked(phone.pose, motion, rngs["pose"])
    if phone.reference is not None:
        stamps = _regular(phone.reference.clocking, motion.duration_s)
        read = aiding.read_reference(phone.reference, motion, earth, stamps, rngs["reference"])
        streams["reference"] = Stream(stamps, read)
    return streams


def _tracked(pose: Pose, motion: Motion, rng: np.random.Generator) -> Stream:
    """Poses, but for those where tracking is lost."""
    stamps = _regular(pose.clocking, motion.duration_s)
    read = aiding.read_pose(pose, motion, stamps, rng)
    since = stamps - pose.lost_at_s
    there = (since < 0.0) | (since >= pose.lost_for_s)
    return Stream(stamps[there], read[there])


def _regular(clocking: Clocking, duration: float) -> Array:
    count = math.floor((duration - clocking.phase_s) * clocking.rate_hz + 1e-9) + 1
    return np.arange(count) / clocking.rate_hz + clocking.phase_s


def _warms(phone: Phone) -> bool:
    return bool(np.any(phone.gyro.temperature) or np.any(phone.accel.temperature))


def _parameters(
    setup: catalogue.Setup,
    motion: Motion,
    start: Start,
    holder: Hand,
    read: ImuReadings,
    asked: Mapping[str, Sequence[float]],
) -> dict[str, Any]:
    """All that was injected: by effect, in the order and the units that users know."""
    present = {}
    for name, parameters in catalogue.EFFECTS.items():
        values = catalogue.values_of(setup, name)
        if name in asked or name.endswith("_bias") or (values and _acts(name, values)):
            assert values is not None
            present[name] = [
                {"name": p.name, "value": value, "unit": p.unit}
                for p, value in zip(parameters, values, strict=True)
            ]
    return {
        "schema": "handcal-sim/truth/1",
        "scenario": motion.name,
        "duration_s": motion.duration_s,
        "rests": [list(rest) for rest in motion.rests],
        "asked": {name: [float(v) for v in values] for name, values in asked.items()},
        "effects": present,
        "mean_walk": {
            "gyro": read.gyro_walk.mean(axis=0).tolist(),
            "accel": read.accel_walk.mean(axis=0).tolist(),
        },
        "start": _plain(start),
        "hand": _plain(holder),
        "earth": _plain(setup.earth),
        "phone": _plain(setup.phone),
    }


def _acts(name: str, values: list[float]) -> bool:
    """Whether these values make a difference; a time constant or a moment alone does not."""
    weights = values[:1] if name == "heading_correlated_noise" else values
    weights = values[:3] if name == "gyro_bias_step" else weights
    return any(value != 0.0 for value in weights)


def _plain(thing: Any) -> Any:
    """Dataclasses and arrays as JSON would have them; infinity as null."""
    if dataclasses.is_dataclass(thing):
        return {f.name: _plain(getattr(thing, f.name)) for f in dataclasses.fields(thing)}
    if isinstance(thing, np.ndarray):
        return thing.tolist()
    if isinstance(thing, tuple):
        return [_plain(x) for x in thing]
    if isinstance(thing, float) and not math.isfinite(thing):
        return None
    return thing

"""What a user asks for in a user's units, turned into a world."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from handcal_sim.companions import Clocking, Reference
from handcal_sim.effects import parse_effect
from handcal_sim.errors import SimulationError
from handcal_sim.lab import ARCMIN, ARCSEC, SETUPS, Equipment
from handcal_sim.motion import Start, random_start
from handcal_sim.phone import (
    DEG,
    DEG_PER_HOUR,
    MG,
    Phone,
    capture_pose,
    consumer_magnetometer,
    make_phone,
    trusted_reference,
    with_rate,
)
from handcal_sim.profiles import Array
from handcal_sim.scenario import World, simulate
from handcal_sim.sensors import ASSUMED, Earth, earth_at


@dataclass(frozen=True)
class Request:
    """None: whatever is usual for the device."""

    scenario: str
    seed: int | None = None
    device: str = "consumer"
    effects: tuple[str, ...] = ()
    rate_hz: float | None = None
    duration_s: float | None = None
    heading: bool = True
    heading_sigma_deg: float | None = None
    heading_rate_hz: float | None = None
    bias_gyro_deg_h: str | None = None
    bias_accel_mg: str | None = None
    temperature: bool = False
    mag: bool = False
    pose: bool = False
    reference: bool = False
    sway: float | None = None
    latitude_deg: float | None = None
    height_m: float = 0.0
    start_heading_deg: float | None = None
    start_tilt_deg: str | None = None
    clockwise: bool | None = None
    table_errors: str | None = None
    spin_deg_s: float | None = None


def simulated(request: Request) -> tuple[World, int]:
    """The world that was asked for and the seed it came from; SimulationError on bad values."""
    seed = request.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    if seed < 0:
        raise SimulationError("--seed must not be negative")
    if not request.heading and (request.heading_sigma_deg, request.heading_rate_hz) != (None, None):
        raise SimulationError("--no-heading leaves nothing for --heading-sigma and --heading-rate")
    effects: dict[str, tuple[float, ...]] = {}
    for text in request.effects:
        name, values = parse_effect(text)
        if name in effects:
            raise SimulationError(f"{name} is given twice")
        effects[name] = values
    usual = 0.0 if request.device == "paper" else 1.0
    world = simulate(
        request.scenario,
        seed=seed,
        phone=lambda rng: _phone(request, set(effects), rng),
        effects=effects,
        duration_s=request.duration_s,
        start=lambda rng: _start(request, rng),
        sway=usual if request.sway is None else request.sway,
        earth=_earth(request),
        equipment=_equipment(request),
    )
    return world, seed


def _equipment(request: Request) -> Equipment | None:
    if request.table_errors is None and request.spin_deg_s is None:
        return None
    angle, tilt = _numbers("--table-errors", request.table_errors or "0,0", 2)
    rate = Equipment().spin if request.spin_deg_s is None else request.spin_deg_s * DEG
    if angle < 0.0 or tilt < 0.0 or not 0.0 < rate < 2000.0 * DEG:
        raise SimulationError("--table-errors must not be negative, --spin is below 2000 deg/s")
    return Equipment(float(angle) * ARCSEC, float(tilt) * ARCMIN, rate)


def _earth(request: Request) -> Earth:
    if request.latitude_deg is None:
        if request.height_m:
            raise SimulationError("--height needs --latitude: gravity depends on both")
        return ASSUMED
    if not (abs(request.latitude_deg) <= 90.0 and abs(request.height_m) <= 1e5):
        raise SimulationError("no such place: --latitude is in deg, --height in m")
    return earth_at(request.latitude_deg * DEG, request.height_m)


def _phone(request: Request, effects: set[str], rng: np.random.Generator) -> Phone:
    """The device with what was asked for, and with the sensors that its effects need."""
    phone = make_phone(request.device, rng)
    # Drawn whether used or not, so that one option does not change what another draws.
    mag, pose = consumer_magnetometer(rng), capture_pose(rng)
    reference = trusted_reference(rng)
    if request.rate_hz is not None:
        phone = with_rate(phone, request.rate_hz)
    if request.bias_gyro_deg_h is not None:
        bias = DEG_PER_HOUR * _numbers("--bias-gyro-deg-h", request.bias_gyro_deg_h, 3)
        phone = replace(phone, gyro=replace(phone.gyro, bias=bias))
    if request.bias_accel_mg is not None:
        bias = MG * _numbers("--bias-accel-mg", request.bias_accel_mg, 3)
        phone = replace(phone, accel=replace(phone.accel, bias=bias))
    if request.temperature:
        phone = replace(phone, thermometer=replace(phone.thermometer, reported=True))
    return replace(
        _with_heading(phone, request),
        mag=mag if request.mag or any(e.startswith("mag_") for e in effects) else None,
        pose=pose if request.pose or "pose_delay" in effects else None,
        reference=_known(request, reference),
    )


def _known(request: Request, trusted: Reference) -> Reference | None:
    """On a table the input is known without noise; how the device is clamped is not."""
    if request.scenario in SETUPS:
        return Reference(C_br=trusted.C_br)
    return trusted if request.reference else None


def _with_heading(phone: Phone, request: Request) -> Phone:
    if not request.heading or phone.heading is None:
        return replace(phone, heading=None)
    heading = phone.heading
    if request.heading_sigma_deg is not None:
        if not 0.0 <= request.heading_sigma_deg < math.inf:
            raise SimulationError(
                "--heading-sigma must not be negative; --no-heading leaves heading out"
            )
        heading = replace(heading, sigma=request.heading_sigma_deg * DEG)
    if request.heading_rate_hz is not None:
        if not 0.0 < request.heading_rate_hz <= 2000.0:
            raise SimulationError("--heading-rate must lie between 0 and 2000 Hz")
        phase = heading.clocking.phase_s % (1.0 / request.heading_rate_hz)
        heading = replace(heading, clocking=Clocking(request.heading_rate_hz, phase))
    return replace(phone, heading=heading)


def _start(request: Request, rng: np.random.Generator) -> Start:
    start = random_start(rng)
    if request.device == "paper":
        start = Start()
    if request.start_heading_deg is not None:
        (heading,) = DEG * _numbers("--start-heading", str(request.start_heading_deg), 1)
        start = replace(start, heading=float(heading))
    if request.start_tilt_deg is not None:
        pitch, roll = DEG * _numbers("--start-tilt", request.start_tilt_deg, 2)
        start = replace(start, pitch=float(pitch), roll=float(roll))
    if request.clockwise is not None:
        start = replace(start, direction=-1 if request.clockwise else 1)
    return start


def _numbers(option: str, text: str, count: int) -> Array:
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.all(np.isfinite(values)):
        raise SimulationError(f"{option} takes {count} number(s) with commas between, not {text!r}")
    return values

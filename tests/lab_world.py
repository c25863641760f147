"""Recordings of a simulated laboratory, in memory: what an MCAP file would hand over."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from handcal.commands import _app
from handcal.types import Imu, Recording, Series
from handcal_sim import simulate
from handcal_sim.lab import Equipment
from handcal_sim.phone import Phone, Reference, consumer_phone, trusted_reference

BIASES = {"accel_bias": [0.1, -0.2, 0.3], "gyro_bias": [0.01, -0.02, 0.005]}
ERRORS = {
    "accel_scale": [0.004, -0.003, 0.002],
    "accel_misalignment": [0.002, -0.003, 0.001],
    "gyro_scale": [0.01, -0.005, 0.003],
    "gyro_misalignment": [0.001, 0.002, -0.001, 0.003, -0.002, 0.001],
}
NAMES = {"gyro_misalignment": ("xy", "xz", "yx", "yz", "zx", "zy"),
         "accel_misalignment": ("yx", "zx", "zy")}  # fmt: skip
TRUTH = {
    (effect, name): value
    for effect, values in (BIASES | ERRORS).items()
    for name, value in zip(NAMES.get(effect, "xyz"), values, strict=True)
}


def recording(setup, seed=0, perfect=False, rate_hz=100.0, effects=BIASES | ERRORS, **settings):
    """What a device on that equipment records; a perfect one has no noise."""

    def phone(rng):
        if perfect:
            return Phone(rate_hz=rate_hz, reference=Reference())
        clamped = Reference(C_br=trusted_reference(rng).C_br)
        return replace(consumer_phone(rng), heading=None, reference=clamped)

    equipment = Equipment(**settings) if settings else None
    return of_world(simulate(setup, seed=seed, phone=phone, effects=effects, equipment=equipment))


def of_world(world):
    """A simulated world as the reader would hand it over."""
    read = np.ascontiguousarray(world.imu.values)
    imu = Imu(world.imu.stamps, read[:, :3].copy(), read[:, 3:].copy(), np.ones(len(read), bool))
    streams = {n: Series(s.stamps, s.values) for n, s in world.streams.items()
               if n in ("reference", "temperature")}  # fmt: skip
    return Recording("simulated", imu, streams)


def command(monkeypatch, capsys, *arguments):
    """The command line in this process: status, standard output, standard error."""
    monkeypatch.setattr(sys, "argv", ["handcal", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        _app.main()
    said = capsys.readouterr()
    return stop.value.code, said.out, said.err


def off(parameters, sigmas=False):
    """Estimates less what was injected, by sensor (arrays), in their sigmas if told so."""
    out = {"gyro": [], "accel": []}
    for p in parameters:
        true = TRUTH.get((p.effect, p.name))
        if true is not None:
            miss = p.value - true
            out[p.effect.split("_")[0]].append(miss / p.sigma if sigmas else miss)
    return {sensor: np.array(values) for sensor, values in out.items()}

"""A fleet of simulated devices of four models, given to ``handcal fleet``, and what it tells of
them beside the truth.

Of each device several recordings, days apart and at other temperatures. *plain*: errors spread as
in a datasheet; *tails*: the same with a tail (Student's t with 4 degrees of freedom); *law*:
every gyro axis has a cubic error, about 2.5 sigma of one recording; *warm*: the gyro's bias goes
with the temperature, alike in all of its devices. One device in twenty is odd, in one of several
ways, one file in fifty is broken, one in a hundred stands under the name of another device.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim import simulate
from handcal_sim.mcap_writer import write
from handcal_sim.phone import DEG, Phone, consumer_phone
from handcal_sim.profiles import Array
from handcal_sim.prove.trial import share
from handcal_sim.scenario import Stream, World
from handcal_sim.strangers import scene_of

MODELS = ("plain", "tails", "law", "warm")
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
# Seconds that each recording's search may take: what a fleet shows stands beside what was found in
# each, and no single one shows what is faint.
BUDGET = 1.5
# Of a new device, s: it leaves room for what was learned of others.
SHORT = 20.0
BEGINNING = datetime(2026, 1, 5, 9, 0, tzinfo=UTC)
# Share of populations that are to be within three sigma.
WITHIN = 3.0


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


def devices(count: int, rng: np.random.Generator) -> list[Device]:
    """As many devices, of each model in turn."""
    strange = rng.permutation(count)[: max(1, round(ODD_SHARE * count))].tolist()
    odd = {n: ODD_WAYS[i % len(ODD_WAYS)] for i, n in enumerate(strange)}
    sizes = {"gyro_scale": 3, "gyro_misalignment": 6, "accel_scale": 3, "accel_misalignment": 3}
    out = []
    for n in range(count):
        model = MODELS[n % len(MODELS)]
        draw: Callable[[int], Array] = rng.standard_normal
        if model == "tails":
            draw = lambda k: rng.standard_t(DOF, k)  # noqa: E731
        effects = {e: SPREADS[e] * draw(k) for e, k in sizes.items()}
        way = odd.get(n, "")
        if way in LARGE:
            effects[way][int(rng.integers(3))] += LARGE[way]
        law = rng.normal(CUBE, CUBE_SPREAD) if model == "law" else 0.0
        bias = rng.normal(0.0, 0.3 * DEG, 3)
        slope = SLOPE if model == "warm" else 0.0
        out.append(Device(f"{model}-{n:03d}", model, effects, float(law), slope, bias, way))
    return out


def recorded(device: Device, seed: int, seconds: float = SECONDS) -> World:
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
    world = simulate(SCENARIO, seed=seed, phone=phone, duration_s=seconds, effects=effects)
    values = world.imu.values.copy()
    values[:, :3] += device.law * scene_of(world).omega ** 3
    return replace(world, imu=Stream(world.imu.stamps, SPOILT.get(device.odd, np.array)(values)))


def written(n: int, seed: int, folder: Path) -> dict[str, Any]:
    """n recordings and a manifest in a folder, and what is true of them."""
    rng = np.random.default_rng(seed)
    made = devices(max(FEWEST * len(MODELS), n // EACH), rng)
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
            said = made[(i + len(MODELS)) % len(made)]  # (the next one of its model)
            mislabelled[path.name] = [said.name, device.name]
        rows.append((path.name, said.name, said.model, started.isoformat(timespec="seconds")))
    with (folder / "manifest.txt").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("path", "device", "model", "started"), *rows])
    return {
        "recordings": n, "broken": len(broken),
        "devices": [d.name for d in made], "odd": {d.name: d.odd for d in made if d.odd},
        "mislabelled": mislabelled,
    }  # fmt: skip


def run(n: int, seed: int, folder: Path, workers: int) -> dict[str, Any]:
    """The score of ``handcal fleet`` on such a fleet. Errors: CalledProcessError where it fails."""
    source, out = folder / "recordings", folder / "fleet"
    source.mkdir(parents=True, exist_ok=True)
    truth = written(n, seed, source)
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    command = ["fleet", "--manifest", str(source / "manifest.txt"), "--out", str(out),
               "--budget", str(BUDGET)]  # fmt: skip
    subprocess.run(
        [sys.executable, "-m", "handcal", *command, "--workers", str(workers)],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    told = json.loads((out / "fleet.json").read_text("utf-8"))
    taught = taught_by(out / "priors.toml", max(8, n // 10), seed, folder)
    return (
        {"schema": "handcal-sim/prove-fleet/1", "n": n, "seed": seed} | score(told, truth) | taught
    )


def taught_by(priors: Path, count: int, seed: int, folder: Path) -> dict[str, Any]:
    """What the priors of *plain* are worth for new devices of that model, and of *tails*, of which
    they know nothing: root mean squares of errors with them over those without, by effect and over
    all, errors in the devices' spreads."""
    from handcal.device.priors import prior, read

    learned = prior(read(priors), MODELS[0])
    rng = np.random.default_rng([seed, 1])
    made = devices(len(MODELS) * count, rng)
    out = {}
    for model in MODELS[:2]:
        new = [d for d in made if d.model == model and not d.odd]
        pairs = [_errors(d, int(rng.integers(2**62)), learned, folder / "new.mcap") for d in new]
        squares = {e: np.mean([[np.mean(p[e] ** 2) for p in pair] for pair in pairs], axis=0)
                   for e in SPREADS}  # fmt: skip
        squares["all"] = np.mean(list(squares.values()), axis=0)
        out[model] = {e: float(np.sqrt(with_ / without)) for e, (without, with_) in squares.items()}
    return {"taught": {"recordings": count, "seconds": SHORT, **out}}


def _errors(
    device: Device, seed: int, learned: Any, path: Path
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Errors of a short recording's estimates, by effect, in the devices' spreads: without what was
    learned, and with."""
    import handcal

    write(recorded(device, seed, SHORT), path, truth=False)
    recording = handcal.load(path)
    out = []
    for before in (None, learned):
        found = handcal.calibrate(recording, list(SPREADS), before=before)
        by_effect: dict[str, list[float]] = {e: [] for e in SPREADS}
        for p in found.parameters:
            if p.effect in by_effect:
                by_effect[p.effect].append(p.value)
        out.append({e: (np.array(v) - device.effects[e]) / SPREADS[e]
                    for e, v in by_effect.items()})  # fmt: skip
    return out[0], out[1]


def score(told: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """What fleet.json tells beside what is true."""
    models = {m["name"]: m for m in told["models"]}
    spread = [_covered(models[m]) for m in MODELS if m in models]
    means, spreads = ([x for one in spread for x in one[k]] for k in range(2))
    odd = [o["who"] for m in told["models"] for o in sorted(m["odd"], key=lambda o: o["by_chance"])
           if o["kind"] == "device"]  # fmt: skip
    first = odd[: max(len(truth["odd"]), round(1.5 * len(truth["odd"])))]
    laws = {name: m["law"]["formula"] for name, m in models.items() if m.get("law")}
    warm = [c for c in models.get("warm", {}).get("changes", []) if c["effect"] == "gyro_bias"]
    return {
        "devices": len(truth["devices"]),
        "means_within_3_sigma": share(sum(means), len(means)),
        "spreads_within": share(sum(spreads), len(spreads)),
        "laws": laws, "law_found": "omega_i^3" in laws.get("law", ""),
        "laws_elsewhere": sum(name != "law" for name in laws),
        "odd": share(len(set(first) & set(truth["odd"])), len(truth["odd"])),
        "broken": share(len(told["failures"]), truth["broken"]),
        "slopes": [(c["slope"] - SLOPE) / c["slope_sigma"] for c in warm if c["slope_sigma"]],
        "shares": {c["name"]: c["shares"] for c in warm},
    }  # fmt: skip


def _covered(model: Mapping[str, Any]) -> tuple[list[bool], list[bool]]:
    """Of each scale error whether the mean is within three sigma of nought, of which the devices
    were drawn, and whether the interval of the spread holds the one they were drawn with. (Of a
    tail the spread is that of its density.)"""
    told = [p for p in model["populations"] if p["effect"] in ("gyro_scale", "accel_scale")]
    means = [abs(p["mean"]) < WITHIN * p["mean_sigma"] for p in told]
    spreads = [p["spread_from"] <= SPREADS[p["effect"]] <= p["spread_to"] for p in told]
    return means, spreads


def lines(found: Mapping[str, Any]) -> list[str]:
    """The score in words."""

    def counted(name: str) -> str:
        s = found[name]
        return f"{s['count']} of {s['n']}"

    slopes = ", ".join(f"{z:+.1f}" for z in found["slopes"])
    return [
        f"{found['n']} recordings of {found['devices']} devices, seed {found['seed']}",
        f"means of populations within three sigma: {counted('means_within_3_sigma')}",
        f"95 % intervals that hold the spread: {counted('spreads_within')}",
        f"law common to one model: {'found' if found['law_found'] else 'missed'} "
        f"({found['laws'] or 'none'}); in other models: {found['laws_elsewhere']}",
        f"odd devices among the first: {counted('odd')}",
        f"broken files that are rows: {counted('broken')}",
        f"RMS errors of {found['taught']['recordings']} new recordings of {SHORT:g} s, with what "
        f"*plain* taught over without: {_ratios(found['taught']['plain'])}; of another model: "
        f"{_ratios(found['taught']['tails'])}",
        f"slope of the gyro's bias by temperature, sigmas off: {slopes or 'not told'}",
    ]


def _ratios(found: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {ratio:.2f}" for name, ratio in found.items())

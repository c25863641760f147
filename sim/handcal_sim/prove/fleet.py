"""A fleet of simulated devices (``fleet_world``), given to ``handcal fleet``, and what it tells of
them beside the truth."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from handcal_sim.prove import fleet_taught
from handcal_sim.prove.fleet_world import EACH, FEWEST, FINE, MODELS, SLOPE, SPREADS, written
from handcal_sim.prove.trial import share

# Seconds that each recording's search may take: what a fleet shows stands beside what was found in
# each, and no single one shows what is faint.
BUDGET = 1.5
# Share of populations that are to be within three sigma.
WITHIN = 3.0
# Odd devices are asked for among so many times as many of the list's first.
AMONG = 1.5
# Devices of one model that make a smaller fleet.
SMALL = 10
# For so many recordings of the fleet there is one of the fleet of *fine* (200 for 2,000), and one
# new device of each model (100, which are 200 recordings to calibrate).
FINE_SHARE, NEW_SHARE = 10, 20


def run(n: int, seed: int, folder: Path, workers: int) -> dict[str, Any]:
    """The score of ``handcal fleet`` on such a fleet; in the same folder again it goes on. Errors:
    CalledProcessError where it fails."""
    truth = _told(n, seed, folder, workers, MODELS)
    few = max(FEWEST * EACH, n // FINE_SHARE)
    _told(few, seed, folder / FINE, workers, (FINE,))
    out = folder / "fleet"
    told = json.loads((out / "fleet.json").read_text("utf-8"))
    plain, fine = out / "priors.toml", folder / FINE / "fleet" / "priors.toml"
    priors = {MODELS[0]: (plain, MODELS[0]), MODELS[1]: (plain, MODELS[0]), FINE: (fine, FINE)}
    return (
        {"schema": "handcal-sim/prove-fleet/1", "n": n, "seed": seed}
        | score(told, truth)
        | {"smaller": smaller(folder / "recordings" / "manifest.txt", out, truth)}
        | fleet_taught.taught_by(priors, max(8, n // NEW_SHARE), seed, folder)
    )


def _told(n: int, seed: int, folder: Path, workers: int, models: Sequence[str]) -> dict[str, Any]:
    """Recordings of a fleet, given to ``handcal fleet``, and what is true of them."""
    source = folder / "recordings"
    source.mkdir(parents=True, exist_ok=True)
    truth = written(n, seed, source, models)
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    command = ["fleet", "--manifest", str(source / "manifest.txt"), "--out", str(folder / "fleet"),
               "--budget", str(BUDGET)]  # fmt: skip
    subprocess.run(
        [sys.executable, "-m", "handcal", *command, "--workers", str(workers)],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    return truth


def score(told: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """What fleet.json tells beside what is true."""
    models = {m["name"]: m for m in told["models"]}
    spread = [_covered(models[m]) for m in MODELS if m in models]
    means, spreads = ([x for one in spread for x in one[k]] for k in range(2))
    laws = {name: m["law"]["formula"] for name, m in models.items() if m.get("law")}
    warm = [c for c in models.get("warm", {}).get("changes", []) if c["effect"] == "gyro_bias"]
    failed = {Path(f["path"]).name for f in told["failures"]}
    every = [o for m in told["models"] for o in m["odd"]]
    return {
        "devices": len(truth["devices"]),
        "means_within_3_sigma": share(sum(means), len(means)),
        "spreads_within": share(sum(spreads), len(spreads)),
        "laws": laws, "law_found": "omega_i^3" in laws.get("law", ""),
        "laws_elsewhere": sum(name != "law" for name in laws),
        "odd": _first(every, truth["odd"]),
        "mislabelled": _mislabelled(every, truth["mislabelled"]),
        "broken": share(len(failed & set(truth["broken"])), len(truth["broken"])),
        "slopes": [(c["slope"] - SLOPE) / c["slope_sigma"] for c in warm if c["slope_sigma"]],
        "shares": {c["name"]: c["shares"] for c in warm},
    }  # fmt: skip


def _first(every: list[Mapping[str, Any]], odd: Mapping[str, str]) -> dict[str, Any]:
    """How many of the odd devices are among the first, and at which place each is."""
    ranked = [o["who"] for o in sorted(every, key=lambda o: o["by_chance"])
              if o["kind"] in ("device", "refused")]  # fmt: skip
    among = max(len(odd), round(AMONG * len(odd)))
    place = {f"{who}: {way}": ranked.index(who) + 1 if who in ranked else None
             for who, way in odd.items()}  # fmt: skip
    return share(len(set(ranked[:among]) & set(odd)), len(odd)) | {
        "told": len(ranked),
        "places": place,
    }


def _mislabelled(every: list[Mapping[str, Any]], truth: Mapping[str, list[str]]) -> dict[str, Any]:
    """How many recordings of another device are told, and of how many it is said whose they are;
    others: how many more are told."""
    told = {Path(o["who"]).name: o["like"] for o in every if o["kind"] == "recording"}
    known = sum(told.get(name) == whose for name, (_, whose) in truth.items())
    return share(len(set(told) & set(truth)), len(truth)) | {
        "whose": known,
        "others": len(set(told) - set(truth)),
    }


def _covered(model: Mapping[str, Any]) -> tuple[list[bool], list[bool]]:
    """Of each scale error whether the mean is within three sigma of nought, of which the devices
    were drawn, and whether the interval of the spread holds the one they were drawn with. (Of a
    tail the spread is that of its density.)"""
    told = [p for p in model["populations"] if p["effect"] in ("gyro_scale", "accel_scale")]
    means = [abs(p["mean"]) < WITHIN * p["mean_sigma"] for p in told]
    spreads = [p["spread_from"] <= SPREADS[p["effect"]] <= p["spread_to"] for p in told]
    return means, spreads


def smaller(manifest: Path, out: Path, truth: Mapping[str, Any]) -> dict[str, Any]:
    """Of as many fleets of ten devices of one model as there are in the large one (no odd device in
    them): how often a mean is within three sigma, and how often an interval holds the spread."""
    from handcal.population.by_model import models

    means, spreads = list[bool](), list[bool]()
    fleets = 0
    for few in _tens(manifest, out, truth):
        fleets += 1
        (model,) = models(few)
        told = {"populations": [
            {"effect": c.effect, "mean": c.population.mean, "mean_sigma": c.population.mean_sigma,
             "spread_from": c.population.low, "spread_to": c.population.high}
            for c in model.common
        ]}  # fmt: skip
        for have, new in zip((means, spreads), _covered(told), strict=True):
            have += new
    return {"fleets": fleets, "means_within_3_sigma": share(sum(means), len(means)),
            "spreads_within": share(sum(spreads), len(spreads))}  # fmt: skip


def _tens(manifest: Path, out: Path, truth: Mapping[str, Any]) -> Iterator[list[Any]]:
    """What the recordings of ten devices of one model tell, as the fleet kept it."""
    from handcal.fleet.record import DONE, Source
    from handcal.fleet.results import reading_of

    whose = {}
    for line in manifest.read_text("utf-8").splitlines()[1:]:
        path, device, model, started = line.split(",")
        whose[path] = Source(path, model, device, started)
    kept: dict[str, list[Any]] = {}
    for file in sorted((out / "recordings").glob("*.json")):
        record = json.loads(file.read_text("utf-8"))
        source = whose[Path(record["path"]).name]
        wrong = source.place in truth["mislabelled"] or source.device in truth["odd"]
        if record["status"] == DONE and not wrong:
            kept.setdefault(source.device, []).append(reading_of(source, record))
    for model in MODELS:
        own = [d for d in truth["devices"] if d.startswith(model) and d in kept]
        for first in range(0, len(own) - SMALL + 1, SMALL):
            yield [r for d in own[first : first + SMALL] for r in kept[d]]


def lines(found: Mapping[str, Any]) -> list[str]:
    """The score in words."""

    def counted(s: Mapping[str, Any]) -> str:
        return f"{s['count']} of {s['n']}"

    slopes = ", ".join(f"{z:+.1f}" for z in found["slopes"])
    odd, wrong, small, taught = (found[k] for k in ("odd", "mislabelled", "smaller", "taught"))
    places = ", ".join(f"{k} ({v or 'not told'})" for k, v in odd["places"].items())
    return [
        f"{found['n']} recordings of {found['devices']} devices, seed {found['seed']}",
        f"means of populations within three sigma: {counted(found['means_within_3_sigma'])}",
        f"95 % intervals that hold the spread: {counted(found['spreads_within'])}",
        f"of {small['fleets']} fleets of {SMALL} devices: means "
        f"{counted(small['means_within_3_sigma'])}, spreads {counted(small['spreads_within'])}",
        f"law common to one model: {'found' if found['law_found'] else 'missed'} "
        f"({found['laws'] or 'none'}); in other models: {found['laws_elsewhere']}",
        f"odd devices among the first: {counted(odd)} ({odd['told']} told); {places}",
        f"recordings of another device: {counted(wrong)}, {wrong['whose']} with whose they are; "
        f"others: {wrong['others']}",
        f"broken files that are rows: {counted(found['broken'])}",
        f"slope of the gyro's bias by temperature, sigmas off: {slopes or 'not told'}",
        *fleet_taught.lines(taught),
    ]  # fmt: skip

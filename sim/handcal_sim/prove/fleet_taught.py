"""What priors that a fleet taught are worth for devices that it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim.mcap_writer import write
from handcal_sim.profiles import Array
from handcal_sim.prove.fleet_world import (
    DOF,
    MODELS,
    SCENARIO,
    SPREADS,
    Device,
    devices,
    recorded,
    spread_of,
)
from handcal_sim.prove.trial import share

Mask = np.ndarray[Any, np.dtype[np.bool_]]
# Of a new device, s: it leaves room for what was learned of others.
SHORT = 20.0
# An estimate that is known by itself to so much of the devices' spread leaves room: with the spread
# known, its error is at the best 0.8 of what it was, 1 / sqrt(1 + ROOM^2).
ROOM = 0.75
# A free hand tells nearly all numbers; still, a turn and still again tell few of them.
MOTIONS = (SCENARIO, "z-turn")
# Without priors, with what was learned, with what the devices were drawn from.
WITHOUT, LEARNED, TRUE = range(3)


@dataclass(frozen=True)
class One:
    """One new device: errors of the first recording's estimates in the devices' spreads, by what
    was known before (3, k); sigmas without (k,); the second recording's evidence after it (3,)."""

    errors: Array
    sigmas: Array
    evidence: Array


def taught_by(
    priors: Mapping[str, tuple[Path, str]], count: int, seed: int, folder: Path
) -> dict[str, Any]:
    """What priors are worth for new devices.

    priors: by model of the new devices the file, and of which of its models it is asked. Of each
    device two recordings: one of each of ``MOTIONS``, then one by a free hand. Told of both
    motions: root mean squares of the first one's errors with the priors over those without, by
    effect, of all, and of those estimates that leave room; the same with the density that the
    devices were drawn from (``best``); and how often the second is the better foretold by what the
    first then says.
    """
    from handcal.device.priors import prior, read

    rows = []
    for model, (path, known) in priors.items():
        learned = prior(read(path), known)
        rng = np.random.default_rng([seed, 1])
        models = MODELS if model in MODELS else (model,)
        made = devices(len(models) * count, rng, models)
        new = [d for d in made if d.model == model and not d.odd]
        for motion in MOTIONS:
            ones = [
                _of_one(d, rng.integers(2**62, size=2).tolist(), motion,
                        (None, learned, _drawn_from(model)), folder / "new.mcap")
                for d in new
            ]  # fmt: skip
            rows.append({"model": model, "priors": known, "motion": motion, **_row(ones)})
    return {"taught": {"seconds": SHORT, "rows": rows}}


def _row(ones: Sequence[One]) -> dict[str, Any]:
    squares = np.array([one.errors**2 for one in ones])  # (devices, 3, k)
    of = np.array([e for e in SPREADS for _ in range(_size(e))])
    room = np.array([one.sigmas for one in ones]) >= ROOM
    gains = np.array([one.evidence[LEARNED] - one.evidence[WITHOUT] for one in ones])

    def ratio(which: Mask, before: int) -> float | None:
        if not which.any():
            return None
        with_, without = (squares[:, k][which].mean() for k in (before, WITHOUT))
        return float(np.sqrt(with_ / without))

    every = np.ones_like(room)
    return {
        "effects": {e: ratio(every & (of == e), LEARNED) for e in SPREADS},
        "all": ratio(every, LEARNED), "all_best": ratio(every, TRUE),
        "estimates": int(room.size), "leave_room": int(room.sum()),
        "room": ratio(room, LEARNED), "room_best": ratio(room, TRUE),
        "foretold": share(int((gains > 0.0).sum()), len(gains))
        | {"median_gain": float(np.median(gains))},
    }  # fmt: skip


def _of_one(
    device: Device, seeds: Sequence[int], motion: str, known: Sequence[Any], path: Path
) -> One:
    import handcal

    recordings = []
    for seed, scenario in zip(seeds, (motion, SCENARIO), strict=True):
        write(recorded(device, seed, SHORT, scenario), path, truth=False)
        recordings.append(handcal.load(path))
    errors, evidence, sigmas = [], [], []
    for before in known:
        found = handcal.calibrate(recordings[0], list(SPREADS), before=before)
        own = {e: [p for p in found.parameters if p.effect == e] for e in SPREADS}
        spread = {e: spread_of(device.model, e) for e in SPREADS}
        errors.append(np.concatenate([
            (np.array([p.value for p in own[e]]) - device.effects[e]) / spread[e] for e in SPREADS
        ]))  # fmt: skip
        sigmas.append(np.array([p.sigma / spread[e] for e in SPREADS for p in own[e]]))
        second = handcal.calibrate(recordings[1], list(SPREADS), before=_after(found))
        evidence.append(second.log_evidence)
    return One(np.array(errors), sigmas[WITHOUT], np.array(evidence))


def _size(effect: str) -> int:
    return len(_names(effect))


def _names(effect: str) -> list[str]:
    from handcal.effects import catalogue

    return [p.name for p in catalogue()[effect].parameters]


def _drawn_from(model: str) -> Any:
    """The normal density with the variance of that which a model's devices are drawn from."""
    from handcal.types import Prior

    names = tuple((e, n) for e in SPREADS for n in _names(e))
    tail = np.sqrt(DOF / (DOF - 2.0)) if model == MODELS[1] else 1.0
    sigma = np.array([tail * spread_of(model, e) for e, _ in names])
    return Prior(names, np.zeros(len(names)), np.diag(sigma**2))


def _after(found: Any) -> Any:
    """What a calibration says of what stays with the device, as what is known before the next."""
    from handcal.types import Prior

    at = [i for i, p in enumerate(found.parameters) if p.effect in SPREADS]
    names = tuple((found.parameters[i].effect, found.parameters[i].name) for i in at)
    mean = np.array([found.parameters[i].value for i in at])
    return Prior(names, mean, found.covariance[np.ix_(at, at)])


def lines(taught: Mapping[str, Any]) -> list[str]:
    """The same in words, one row a model and motion."""

    def said(x: float | None) -> str:
        return "none" if x is None else f"{x:.2f}"

    return [
        f"new devices of {r['model']!r}, {taught['seconds']:g} s of {r['motion']}, with what "
        f"{r['priors']!r} taught over without: all {said(r['all'])} (at the best "
        f"{said(r['all_best'])}), {r['leave_room']} of {r['estimates']} estimates that leave room "
        f"{said(r['room'])} (at the best {said(r['room_best'])}); the next one better foretold "
        f"{r['foretold']['count']} of {r['foretold']['n']}, {r['foretold']['median_gain']:+.1f} "
        "nats in the median"
        for r in taught["rows"]
    ]

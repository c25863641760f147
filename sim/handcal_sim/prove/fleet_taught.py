"""What priors that a fleet taught are worth for devices that it has not seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handcal_sim.mcap_writer import write
from handcal_sim.profiles import Array
from handcal_sim.prove.fleet_world import MODELS, SPREADS, Device, devices, recorded
from handcal_sim.prove.trial import share

# Of a new device, s: it leaves room for what was learned of others.
SHORT = 20.0
# An estimate that is known by itself to so much of the devices' spread leaves room: with the spread
# known, its error is at the best 0.8 of what it was, 1 / sqrt(1 + ROOM^2).
ROOM = 0.75


def taught_by(priors: Path, count: int, seed: int, folder: Path) -> dict[str, Any]:
    """What the priors of *plain* are worth for new devices of that model, and of *tails*, of which
    they know nothing. Of each device two recordings: root mean squares of the first one's errors
    with them over those without, by effect, over all, and over those estimates that leave room,
    errors in the devices' spreads; and how often the second is the better foretold by what the
    first then says."""
    from handcal.device.priors import prior, read

    learned = prior(read(priors), MODELS[0])
    rng = np.random.default_rng([seed, 1])
    made = devices(len(MODELS) * count, rng)
    out: dict[str, Any] = {}
    for model in MODELS[:2]:
        new = [d for d in made if d.model == model and not d.odd]
        pairs = [
            _of_one(d, rng.integers(2**62, size=2).tolist(), learned, folder / "new.mcap")
            for d in new
        ]
        squares = {e: np.array([[one[e] ** 2 for one in pair[0]] for pair in pairs])
                   for e in SPREADS}  # fmt: skip
        means = {e: s.mean(axis=(0, 2)) for e, s in squares.items()}
        means["all"] = np.mean(list(means.values()), axis=0)
        room = np.concatenate([
            squares[e].swapaxes(1, 2)[np.array([pair[2][e] for pair in pairs]) >= ROOM]
            for e in SPREADS
        ])  # fmt: skip
        if len(room):
            means["room"] = room.mean(axis=0)
        out[f"{model}_room"] = len(room)
        out[model] = {e: float(np.sqrt(with_ / without)) for e, (without, with_) in means.items()}
        gains = np.array([p[1] for p in pairs])
        out[f"{model}_foretold"] = share(int((gains > 0).sum()), len(gains)) | {
            "median_gain": float(np.median(gains))
        }
    return {"taught": {"recordings": count, "seconds": SHORT, **out}}


def _of_one(
    device: Device, seeds: list[int], learned: Any, path: Path
) -> tuple[list[dict[str, Array]], float, dict[str, Array]]:
    """Errors of a short recording's estimates, by effect, in the devices' spreads: without what was
    learned, and with; by how many nats what it then says of the device foretells the other
    recording better; and the sigmas without, in the spreads."""
    import handcal

    recordings = []
    for seed in seeds:
        write(recorded(device, seed, SHORT), path, truth=False)
        recordings.append(handcal.load(path))
    errors, score, sigmas = [], [], []
    for before in (None, learned):
        found = handcal.calibrate(recordings[0], list(SPREADS), before=before)
        own = {e: [p for p in found.parameters if p.effect == e] for e in SPREADS}
        errors.append({e: (np.array([p.value for p in own[e]]) - device.effects[e]) / SPREADS[e]
                       for e in SPREADS})  # fmt: skip
        sigmas.append({e: np.array([p.sigma for p in own[e]]) / SPREADS[e] for e in SPREADS})
        second = handcal.calibrate(recordings[1], list(SPREADS), before=_after(found))
        score.append(second.log_evidence)
    return errors, score[1] - score[0], sigmas[0]


def _after(found: Any) -> Any:
    """What a calibration says of what stays with the device, as what is known before the next."""
    from handcal.types import Prior

    at = [i for i, p in enumerate(found.parameters) if p.effect in SPREADS]
    names = tuple((found.parameters[i].effect, found.parameters[i].name) for i in at)
    mean = np.array([found.parameters[i].value for i in at])
    return Prior(names, mean, found.covariance[np.ix_(at, at)])

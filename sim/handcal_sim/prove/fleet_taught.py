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


def taught_by(priors: Path, count: int, seed: int, folder: Path) -> dict[str, Any]:
    """What the priors of *plain* are worth for new devices of that model, and of *tails*, of which
    they know nothing. Of each device two recordings: root mean squares of the first one's errors
    with them over those without, by effect and over all, errors in the devices' spreads; and how
    often the second is the better foretold by what the first then says."""
    from handcal.device.priors import prior, read

    learned = prior(read(priors), MODELS[0])
    rng = np.random.default_rng([seed, 1])
    made = devices(len(MODELS) * count, rng)
    out = {}
    for model in MODELS[:2]:
        new = [d for d in made if d.model == model and not d.odd]
        pairs = [
            _of_one(d, rng.integers(2**62, size=2).tolist(), learned, folder / "new.mcap")
            for d in new
        ]
        errors = [p[0] for p in pairs]
        squares = {e: np.mean([[np.mean(one[e] ** 2) for one in pair] for pair in errors], axis=0)
                   for e in SPREADS}  # fmt: skip
        squares["all"] = np.mean(list(squares.values()), axis=0)
        out[model] = {e: float(np.sqrt(with_ / without)) for e, (without, with_) in squares.items()}
        gains = np.array([p[1] for p in pairs])
        out[f"{model}_foretold"] = share(int((gains > 0).sum()), len(gains)) | {
            "median_gain": float(np.median(gains))
        }
    return {"taught": {"recordings": count, "seconds": SHORT, **out}}


def _of_one(
    device: Device, seeds: list[int], learned: Any, path: Path
) -> tuple[list[dict[str, Array]], float]:
    """Errors of a short recording's estimates, by effect, in the devices' spreads: without what was
    learned, and with; and by how many nats what it then says of the device foretells the other
    recording better."""
    import handcal

    recordings = []
    for seed in seeds:
        write(recorded(device, seed, SHORT), path, truth=False)
        recordings.append(handcal.load(path))
    errors, score = [], []
    for before in (None, learned):
        found = handcal.calibrate(recordings[0], list(SPREADS), before=before)
        by_effect: dict[str, list[float]] = {e: [] for e in SPREADS}
        for p in found.parameters:
            if p.effect in by_effect:
                by_effect[p.effect].append(p.value)
        errors.append({e: (np.array(v) - device.effects[e]) / SPREADS[e]
                       for e, v in by_effect.items()})  # fmt: skip
        second = handcal.calibrate(recordings[1], list(SPREADS), before=_after(found))
        score.append(second.log_evidence)
    return errors, score[1] - score[0]


def _after(found: Any) -> Any:
    """What a calibration says of what stays with the device, as what is known before the next."""
    from handcal.types import Prior

    at = [i for i, p in enumerate(found.parameters) if p.effect in SPREADS]
    names = tuple((found.parameters[i].effect, found.parameters[i].name) for i in at)
    mean = np.array([found.parameters[i].value for i in at])
    return Prior(names, mean, found.covariance[np.ix_(at, at)])

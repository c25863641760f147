"""A file of priors: what was learned of each model of device, as TOML that can be read.

Each parameter has the mean and the spread of its population, its tail, and of how many devices it
was learned. What `calibrate`, `explain` and `fleet` begin with is the normal density of the same
mean and standard deviation, widened by what is not known of both: a new device of the model is one
more draw. A parameter that is not in the file is as uncertain as is usual.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handcal import output
from handcal.device.file import MOST_BYTES, Name
from handcal.did_you_mean import did_you_mean
from handcal.documents import own_toml
from handcal.effects import catalogue
from handcal.types import InputError, Prior

SCHEMA = "handcal/priors/1"
NORMAL, STUDENT = "normal", "student_t"


@dataclass(frozen=True)
class Learned:
    """One parameter: mean and its sigma, spread and its sigma (SI), dof of the tail (inf: normal),
    and of how many devices it was learned."""

    mean: float
    mean_sigma: float
    spread: float
    spread_sigma: float
    dof: float
    devices: int

    @property
    def sigma(self) -> float:
        """Standard deviation of what a new device of the model may have, SI."""
        tail = 1.0 if math.isinf(self.dof) else self.dof / (self.dof - 2.0)
        return math.sqrt((self.spread**2 + self.spread_sigma**2) * tail + self.mean_sigma**2)


@dataclass(frozen=True)
class Priors:
    """path and sha256 of the file; models: parameters by name of the model; learned_from: of each
    model how many recordings and devices."""

    path: str
    models: Mapping[str, Mapping[Name, Learned]]
    learned_from: Mapping[str, Mapping[str, int]]
    sha256: str = ""


def read(path: Path) -> Priors:
    """The priors of a file. Errors: InputError."""
    document, sha256 = own_toml(path, SCHEMA, "file of priors", "`handcal fleet`", MOST_BYTES)
    try:
        models = {str(m["name"]): m for m in document.get("model", [])}
        learned = {n: dict(map(_entry, m.get("parameter", []))) for n, m in models.items()}
        origin = {n: {k: int(m[k]) for k in ("recordings", "devices")} for n, m in models.items()}
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({str(error)[:80]}).") from None
    return Priors(str(path), learned, origin, sha256)


def _entry(entry: Mapping[str, Any]) -> tuple[Name, Learned]:
    name = (str(entry["effect"]), str(entry["name"]))
    effect = catalogue().get(name[0])
    if effect is None or name[1] not in {p.name for p in effect.parameters}:
        raise ValueError(f"nothing is known of {'.'.join(name)[:60]} here")
    keys = ("mean", "mean_sigma", "spread", "spread_sigma")
    numbers = [float(entry[k]) for k in keys]
    dof = math.inf if entry["tail"] == NORMAL else float(entry["dof"])
    mean, mean_sigma, spread, spread_sigma = numbers
    one = Learned(mean, mean_sigma, spread, spread_sigma, dof, int(entry["devices"]))
    if entry["tail"] not in (NORMAL, STUDENT) or not dof > 2.0:
        raise ValueError(f"the tail of {'.'.join(name)}")
    if not (all(map(math.isfinite, numbers)) and min(numbers[1:]) >= 0.0 and one.sigma > 0.0):
        raise ValueError(f"the numbers of {'.'.join(name)}")
    return name, one


def chosen(priors: Priors, model: str | None) -> str:
    """The model that is asked for, or the only one. Errors: InputError."""
    if model is None:
        if len(priors.models) == 1:
            return next(iter(priors.models))
        raise InputError(
            f"{priors.path} holds priors of {', '.join(priors.models) or 'no model'}: say which, "
            "--model NAME."
        )
    if model not in priors.models:
        near = did_you_mean(model, priors.models)
        raise InputError(f"{priors.path} has no model '{model}'.{near}")
    return model


def prior(priors: Priors, model: str) -> Prior:
    """What is known of a new device of a model."""
    found = priors.models[model]
    names = tuple(found)
    mean = np.array([found[n].mean for n in names])
    sigma = np.array([found[n].sigma for n in names])
    source = {"priors": priors.path, "model": model, "sha256": priors.sha256}
    return Prior(names, mean, np.diag(sigma**2), source | dict(priors.learned_from[model]))


def write(
    path: Path, models: Mapping[str, Mapping[Name, Learned]],
    learned_from: Mapping[str, Mapping[str, int]], said: Sequence[str] = (),
) -> None:  # fmt: skip
    """Write a file of priors. Errors: HandcalError."""
    text = [
        "# What a fleet taught of each model: `--priors` of calibrate, explain and fleet.",
        "# SI; spread: scale of the density of true errors, the estimates' sigmas taken out.",
        *(f"# {line}" for line in said),
        f"schema = {json.dumps(SCHEMA)}",
    ]
    for name, parameters in models.items():
        text += ["", "[[model]]", f"name = {json.dumps(name, ensure_ascii=False)}",
                 *(f"{k} = {v}" for k, v in learned_from[name].items())]  # fmt: skip
        text += [line for n, one in parameters.items() for line in _written(n, one)]
    output.write_text(path, "\n".join(text) + "\n")


def _written(name: Name, one: Learned) -> list[str]:
    tail = [f'tail = "{NORMAL}"']
    if not math.isinf(one.dof):
        tail = [f'tail = "{STUDENT}"', f"dof = {one.dof!r}"]
    numbers = [f"{k} = {float(getattr(one, k))!r}"
               for k in ("mean", "mean_sigma", "spread", "spread_sigma")]  # fmt: skip
    return ["", "[[model.parameter]]", f'effect = "{name[0]}"', f'name = "{name[1]}"', *numbers,
            *tail, f"devices = {one.devices}"]  # fmt: skip
